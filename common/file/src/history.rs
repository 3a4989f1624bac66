//! The history stored in every output file: the program, its parameters and its input files. The
//! history of an input file includes the histories of its own inputs.
//!
//! Identical runs produce identical histories, because a history contains no times, folder names,
//! thread counts or output names.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Describes how a file was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct History {
    /// Name of the stage program.
    pub tool: String,
    /// Version of the stage program.
    pub version: String,
    /// Command line of the program, with paths reduced to file names and output paths replaced with
    /// `OUTPUT`. Options that do not affect the result are omitted.
    pub command_line: String,
    /// All parameters in effect, including defaults and the seed.
    pub parameters: serde_json::Value,
    /// The input files.
    pub inputs: Vec<Input>,
}

/// An input file of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// File name without its folder.
    pub path: String,
    /// BLAKE3 hash of the contents as a hexadecimal string; see [`hash_file`].
    pub blake3: String,
    /// History of the input file, if the file contains one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub history: Option<Box<History>>,
}

impl Input {
    /// Creates the entry for a file or folder, including its hash.
    pub fn of_file(path: &Path, history: Option<History>) -> Result<Self> {
        Ok(Self { path: file_name(path), blake3: hash_file(path)?, history: history.map(Box::new) })
    }
}

/// Computes the BLAKE3 hash of a file as a hexadecimal string. For a folder (a DICOM series),
/// hashes a list of the names and hashes of its files, sorted by name. Subfolders are ignored.
pub fn hash_file(path: &Path) -> Result<String> {
    if path.is_dir() {
        return hash_folder(path);
    }
    let hash = || -> io::Result<blake3::Hash> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(std::fs::File::open(path)?)?;
        Ok(hasher.finalize())
    };
    hash()
        .map(|hash| hash.to_hex().to_string())
        .map_err(|error| Error::system(path, "read", error, "check that the file is there and readable"))
}

/// Computes the BLAKE3 hash of the file that `write` would write, like [`hash_file`].
///
/// # Errors
/// If `write` fails.
pub fn hash_written(write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<String> {
    // BLAKE3 is several times faster on blocks of this size than on single numbers
    let mut hasher = BufWriter::with_capacity(1 << 18, blake3::Hasher::new());
    write(&mut hasher)?;
    let hasher = hasher.into_inner().map_err(io::IntoInnerError::into_error)?;
    Ok(hasher.finalize().to_hex().to_string())
}

fn hash_folder(folder: &Path) -> Result<String> {
    let cannot = |error: io::Error| Error::system(folder, "read", error, "check that the folder is there and readable");
    let entries = std::fs::read_dir(folder).map_err(cannot)?;
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.map(|entry| entry.path())).collect::<io::Result<_>>().map_err(cannot)?;
    files.retain(|path| path.is_file());
    files.sort();
    let mut hasher = blake3::Hasher::new();
    for file in files {
        hasher.update(format!("{}\0{}\n", file_name(&file), hash_file(&file)?).as_bytes());
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// Returns the last component of a path.
pub fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_hash_is_that_of_its_bytes() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("in.bin");
        std::fs::write(&path, b"abc").expect("written");
        let input = Input::of_file(&path, None).expect("hashed");
        assert_eq!(input.path, "in.bin");
        assert_eq!(input.blake3, blake3::hash(b"abc").to_hex().to_string());
        let error = Input::of_file(&folder.path().join("absent"), None).expect_err("absent");
        assert!(error.to_string().contains("absent"), "{error}");
    }
}
