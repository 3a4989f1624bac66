//! Errors of surface and point files.

use std::fmt::Display;
use std::path::Path;

/// An error in a surface or point file. The message names the file and the problem.
/// [`Error::reason`] explains why the problem matters, and [`Error::remedy`] explains how to solve
/// it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read or written, is damaged, or is not of the required kind.
    #[error(transparent)]
    File(#[from] isoparticles_file::error::Error),
    /// An error in a VTK XML file. Surfaces and volumes share this format.
    #[error(transparent)]
    Vtk(#[from] isoparticles_volume::Error),
}

/// Result of an operation on a surface or point file.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Returns an explanation of why the error matters.
    pub fn reason(&self) -> String {
        match self {
            Self::File(error) => error.reason(),
            Self::Vtk(error) => error.reason(),
        }
    }

    /// Returns instructions for solving the problem.
    pub fn remedy(&self) -> String {
        match self {
            Self::File(error) => error.remedy(),
            Self::Vtk(error) => error.remedy(),
        }
    }
}

/// Creates an error about the contents of a file.
pub(crate) fn bad(path: &Path, problem: impl Display, reason: impl Into<String>, remedy: impl Into<String>) -> Error {
    isoparticles_file::error::Error::contents(path, problem, reason, remedy).into()
}
