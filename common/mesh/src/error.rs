//! Errors of surface and point files.

use std::fmt::Display;
use std::path::Path;

/// An error of a surface or point file. The text names the file and the problem, [`Error::reason`]
/// states why it matters, and [`Error::remedy`] what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read or written, is damaged, or is not of the required kind.
    #[error(transparent)]
    File(#[from] isoparticles_file::error::Error),
    /// An error in VTK XML, which surfaces and volumes share.
    #[error(transparent)]
    Vtk(#[from] isoparticles_volume::Error),
}

/// Result of an operation on a surface or point file.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Why the error matters.
    pub fn reason(&self) -> String {
        match self {
            Self::File(error) => error.reason(),
            Self::Vtk(error) => error.reason(),
        }
    }

    /// What to do about the error.
    pub fn remedy(&self) -> String {
        match self {
            Self::File(error) => error.remedy(),
            Self::Vtk(error) => error.remedy(),
        }
    }
}

/// An error in the contents of a file.
pub(crate) fn bad(path: &Path, problem: impl Display, reason: impl Into<String>, remedy: impl Into<String>) -> Error {
    isoparticles_file::error::Error::contents(path, problem, reason, remedy).into()
}
