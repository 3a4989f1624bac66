//! The history that every output carries: what made it, with which parameters, from what.
//!
//! It holds nothing that varies between two equal runs: no times, no folders, no thread counts, no output names.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What made a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct History {
    /// Name of the stage.
    pub tool: String,
    /// Its version.
    pub version: String,
    /// Its command line, with file names for paths and without the options that do not change the result.
    pub command_line: String,
    /// Parameters as they applied, defaults and seed included.
    pub parameters: serde_json::Value,
    /// What it was made from.
    pub inputs: Vec<Input>,
}

/// A file that something was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// File name, without folders.
    pub path: String,
    /// BLAKE3 hash of its bytes, in hexadecimal.
    pub blake3: String,
    /// Its own history, where it carries one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub history: Option<Box<History>>,
}

impl Input {
    /// Hashes a file.
    pub fn of_file(path: &Path, history: Option<History>) -> Result<Self> {
        Ok(Self { path: file_name(path), blake3: hash_file(path)?, history: history.map(Box::new) })
    }
}

/// BLAKE3 hash of a file's bytes, in hexadecimal; of a folder (a DICOM series), that of the names and hashes of the files in it, by name.
pub fn hash_file(path: &Path) -> Result<String> {
    if path.is_dir() {
        return hash_folder(path);
    }
    let hash = || -> std::io::Result<blake3::Hash> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(std::fs::File::open(path)?)?;
        Ok(hasher.finalize())
    };
    hash()
        .map(|hash| hash.to_hex().to_string())
        .map_err(|error| Error::file(path, "read", &error, "check that the file is there and readable"))
}

fn hash_folder(folder: &Path) -> Result<String> {
    let cannot =
        |error: std::io::Error| Error::file(folder, "read", &error, "check that the folder is there and readable");
    let entries = std::fs::read_dir(folder).map_err(cannot)?;
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.map(|entry| entry.path())).collect::<std::io::Result<_>>().map_err(cannot)?;
    files.retain(|path| path.is_file());
    files.sort();
    let mut hasher = blake3::Hasher::new();
    for file in files {
        hasher.update(format!("{}\0{}\n", file_name(&file), hash_file(&file)?).as_bytes());
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// The last part of a path.
pub fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// The command line as the history keeps it: `OUTPUT` for the names in `outputs`, file names for the other paths, and
/// none of the shared options that do not change the result.
pub fn canonical_command_line(tool: &str, arguments: impl Iterator<Item = String>, outputs: &[PathBuf]) -> String {
    let mut words = vec![tool.to_owned()];
    let mut arguments = arguments;
    while let Some(argument) = arguments.next() {
        let (name, value) = match argument.split_once('=') {
            Some((name, value)) if name.starts_with("--") => (name, Some(value)),
            _ => (argument.as_str(), None),
        };
        let short_flags = name.len() > 1 && name.starts_with('-') && name[1..].chars().all(|c| c == 'v' || c == 'q');
        match name {
            "--verbose" | "--quiet" | "--force" => {}
            _ if short_flags => {}
            "--threads" | "--max-memory" | "--report" | "--progress" => {
                if value.is_none() {
                    arguments.next();
                }
            }
            _ => words.push(match value {
                Some(value) => format!("{name}={}", shorten(value, outputs)),
                None => shorten(&argument, outputs),
            }),
        }
    }
    words.join(" ")
}

fn shorten(word: &str, outputs: &[PathBuf]) -> String {
    let path = Path::new(word);
    if outputs.iter().any(|output| output == path) {
        "OUTPUT".to_owned()
    } else if word.contains(std::path::MAIN_SEPARATOR) || word.contains('/') {
        file_name(path)
    } else {
        word.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_does_not_depend_on_folders_outputs_or_threads() {
        let line = |words: &[&str], output: &str| {
            canonical_command_line("seed", words.iter().map(|word| (*word).to_owned()), &[PathBuf::from(output)])
        };
        let first = line(
            &["/a/in.vti", "-o", "/a/out.bin", "--seed", "3", "-vv", "--threads=4", "--max-memory", "8G", "--force"],
            "/a/out.bin",
        );
        let second = line(&["b/in.vti", "-o", "other.bin", "--seed", "3", "--report", "r.json"], "other.bin");
        assert_eq!(first, "seed in.vti -o OUTPUT --seed 3");
        assert_eq!(first, second);
        assert_eq!(line(&["--iso=-500", "-5"], "x"), "seed --iso=-500 -5");
    }

    #[test]
    fn a_file_hash_is_that_of_its_bytes() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("in.bin");
        std::fs::write(&path, b"abc").expect("written");
        let input = Input::of_file(&path, None).expect("hashed");
        assert_eq!(input.path, "in.bin");
        assert_eq!(input.blake3, blake3::hash(b"abc").to_hex().to_string());
        let error = Input::of_file(&folder.path().join("absent"), None).expect_err("absent");
        assert!(error.what.contains("absent"), "{error}");
    }
}
