//! What can go wrong with a file.

use std::io;
use std::path::{Path, PathBuf};

/// What is wrong with a file. The text says which file and what; [`Error::reason`] why that matters and [`Error::remedy`] what can be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system does not let the file be used.
    #[error("{}: cannot {doing}: {source}", path.display())]
    System {
        /// The file or folder.
        path: PathBuf,
        /// What was tried, such as "read".
        doing: String,
        /// What the operating system says.
        source: io::Error,
        /// What can be done.
        remedy: String,
    },
    /// The file cannot be written; nothing half written is left.
    #[error("{}: cannot write: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// A file is to be written where a folder is.
    #[error("{}: is a folder", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// A file is there that may not be replaced.
    #[error("{}: exists already", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The run was asked to stop while the file was written; nothing half written is left.
    #[error("{}: interrupted while writing", path.display())]
    Interrupted {
        /// The file.
        path: PathBuf,
    },
    /// A header promises more than there is memory for.
    #[error("{}: its header promises {} MiB of voxels", path.display(), promised >> 20)]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// What the header promises, bytes.
        promised: u64,
        /// Memory that can be had, bytes.
        available: u64,
    },
    /// The file is not what its format demands, or not what is needed.
    #[error("{}: {problem}", path.display())]
    Contents {
        /// The file.
        path: PathBuf,
        /// What is at fault, with its value and its place.
        problem: String,
        /// Why that matters.
        reason: String,
        /// What can be done.
        remedy: String,
    },
}

/// Result of work on a file.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The operating system's error on a file.
    pub fn system(path: &Path, doing: &str, source: io::Error, remedy: impl Into<String>) -> Self {
        Self::System { path: path.to_path_buf(), doing: doing.to_owned(), source, remedy: remedy.into() }
    }

    /// What a file holds is not usable.
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

    /// Why it matters.
    pub fn reason(&self) -> String {
        match self {
            Self::System { .. } => "the file is needed".to_owned(),
            Self::Write { .. } => "without it the result of the run is lost; nothing half written is left".to_owned(),
            Self::Folder { .. } => "the output is a file".to_owned(),
            Self::Exists { .. } => "an existing output is kept".to_owned(),
            Self::Interrupted { .. } => "the work was stopped before its output was complete".to_owned(),
            Self::TooLarge { available, .. } => format!("only {} MiB of memory are free", available >> 20),
            Self::Contents { reason, .. } => reason.clone(),
        }
    }

    /// What can be done.
    pub fn remedy(&self) -> String {
        let remedy = match self {
            Self::System { remedy, .. } | Self::Contents { remedy, .. } => remedy,
            Self::Write { source, .. } => match source.kind() {
                io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
                    "make room on the disk, or write to another one"
                }
                io::ErrorKind::NotFound => "make the folder first, or correct the name",
                _ => "check the folder's permissions, or write somewhere else",
            },
            Self::Folder { .. } => "give the name of a file",
            Self::Exists { .. } => "give another name",
            Self::Interrupted { .. } => "start again",
            Self::TooLarge { .. } => {
                "crop or resample the volume, or use a larger machine; if the volume is small, its header is damaged"
            }
        };
        remedy.to_owned()
    }
}
