//! File access errors. Each error contains a reason and a remedy for the user.

use std::io;
use std::path::{Path, PathBuf};

/// A file access error. The message names the file and the problem. [`Error::reason`] explains why
/// the problem matters, and [`Error::remedy`] explains how to solve it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system reported an error for a file or folder.
    #[error("{}: cannot {doing}: {source}", path.display())]
    System {
        /// The file or folder.
        path: PathBuf,
        /// The failed operation, such as "read".
        doing: String,
        /// The error of the operating system.
        source: io::Error,
        /// Instructions for the user.
        remedy: String,
    },
    /// The file could not be written. No partial file remains.
    #[error("{}: cannot write: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The output path is an existing folder.
    #[error("{}: is a folder", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// The output file already exists and must not be replaced.
    #[error("{}: already exists", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The run was interrupted while the file was being written. No partial file remains.
    #[error("{}: interrupted while writing", path.display())]
    Interrupted {
        /// The file.
        path: PathBuf,
    },
    /// The data that the header declares does not fit in the free memory.
    #[error("{}: its header declares {} MiB of voxels", path.display(), promised >> 20)]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Memory in bytes needed for the data that the header declares.
        promised: u64,
        /// Free memory in bytes.
        available: u64,
    },
    /// The contents violate the file format or do not meet the program's requirements.
    #[error("{}: {problem}", path.display())]
    Contents {
        /// The file.
        path: PathBuf,
        /// The problem, including the invalid value and its location.
        problem: String,
        /// The reason why the problem matters.
        reason: String,
        /// Instructions for the user.
        remedy: String,
    },
}

/// The result of a file operation.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Creates an error from an operating-system error. `doing` is the failed operation, such as
    /// "read".
    pub fn system(path: &Path, doing: &str, source: io::Error, remedy: impl Into<String>) -> Self {
        Self::System { path: path.to_path_buf(), doing: doing.to_owned(), source, remedy: remedy.into() }
    }

    /// Creates an error about the contents of a file.
    pub fn contents(
        path: &Path,
        problem: impl std::fmt::Display,
        reason: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Contents {
            path: path.to_path_buf(),
            problem: problem.to_string(),
            reason: reason.into(),
            remedy: remedy.into(),
        }
    }

    /// Returns an explanation of why the error matters.
    pub fn reason(&self) -> String {
        match self {
            Self::System { .. } => "this file is needed".to_owned(),
            Self::Write { .. } => "the result of the run is lost; no partial file is left".to_owned(),
            Self::Folder { .. } => "the output must be a file".to_owned(),
            Self::Exists { .. } => "existing files are not replaced".to_owned(),
            Self::Interrupted { .. } => "the run was stopped before its output was complete".to_owned(),
            Self::TooLarge { available, .. } => format!("only {} MiB of memory are free", available >> 20),
            Self::Contents { reason, .. } => reason.clone(),
        }
    }

    /// Returns instructions for solving the problem.
    pub fn remedy(&self) -> String {
        let remedy = match self {
            Self::System { remedy, .. } | Self::Contents { remedy, .. } => remedy,
            Self::Write { source, .. } => match source.kind() {
                io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
                    "free some disk space, or write to another disk"
                }
                io::ErrorKind::NotFound => "create the folder, or correct the name",
                _ => "check the folder's permissions, or write to another folder",
            },
            Self::Folder { .. } => "use the name of a file",
            Self::Exists { .. } => "use another name",
            Self::Interrupted { .. } => "run it again",
            Self::TooLarge { .. } => {
                "crop or resample the volume, or use a machine with more memory; if the volume is small, its header \
                 is damaged"
            }
        };
        remedy.to_owned()
    }
}
