//! What can go wrong with the file of a surface or of points.

use std::fmt::Display;
use std::path::Path;

/// What is wrong with the file of a surface or of points. The text says which file and what; [`Error::reason`] why that matters and
/// [`Error::remedy`] what can be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// It cannot be read or written, is damaged, or is not what is needed.
    #[error(transparent)]
    File(#[from] isoparticles_file::error::Error),
    /// The same, of a part that volumes have as well: VTK's XML.
    #[error(transparent)]
    Vtk(#[from] isoparticles_volume::Error),
}

/// Result of work on such a file.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Why it matters.
    pub fn reason(&self) -> String {
        match self {
            Self::File(error) => error.reason(),
            Self::Vtk(error) => error.reason(),
        }
    }

    /// What can be done.
    pub fn remedy(&self) -> String {
        match self {
            Self::File(error) => error.remedy(),
            Self::Vtk(error) => error.remedy(),
        }
    }
}

/// What a file holds is not usable.
pub(crate) fn bad(path: &Path, problem: impl Display, reason: impl Into<String>, remedy: impl Into<String>) -> Error {
    isoparticles_file::error::Error::contents(path, problem, reason, remedy).into()
}
