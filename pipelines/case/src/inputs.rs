//! Finds the files that a case depends on: its volume, the data files of the volume, and every file
//! named in an option.

use crate::settings::Settings;
use crate::status::{Identity, Input, Status, VOLUME};
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::{Crop, data_files};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Role, in the status, of data files that a detached header names.
const VOLUME_DATA: &str = "data of the volume";

/// Options of the stages whose value is the path of an output.
const OUTPUT_OPTIONS: [&str; 8] =
    ["-o", "--output", "--report", "--log", "--checkpoint", "--pictures", "--json", "--truth"];

/// Returns the path, size, modification time and hash of the volume and of its data files. If
/// `before` lists a file with the same size and modification time, its hash is reused.
///
/// # Errors
/// If a file cannot be read.
pub fn of_volume(volume: &Path, before: Option<&Status>) -> Result<Vec<Input>> {
    with_data(volume, [VOLUME, VOLUME_DATA], before)
}

/// Returns the mask that CROP names and its data files, if CROP does not describe a box.
///
/// # Errors
/// If a file cannot be read.
pub fn of_crop(settings: &Settings, before: Option<&Status>) -> Result<Vec<Input>> {
    crop_mask(settings).map_or(Ok(Vec::new()), |mask| with_data(&mask, ["mask of CROP"; 2], before))
}

/// Returns the path of the mask that CROP names, if CROP does not describe a box.
#[must_use]
pub fn crop_mask(settings: &Settings) -> Option<PathBuf> {
    settings.get("CROP")?.parse().ok().and_then(|crop: Crop| crop.mask().map(Path::to_path_buf))
}

/// Returns a volume and its data files. `roles` are the roles of the volume and of its data files.
fn with_data(volume: &Path, roles: [&str; 2], before: Option<&Status>) -> Result<Vec<Input>> {
    let mut inputs = vec![input(roles[0], volume, before)?];
    if volume.is_file() {
        // An unreadable header is reported by the stage.
        for path in data_files(volume).unwrap_or_default().iter().filter(|path| path.is_file()) {
            inputs.push(input(roles[1], path, before)?);
        }
    }
    Ok(inputs)
}

/// Returns the files named in the setting `key`, such as `DISTFIELD_OPTIONS`, and the data files
/// that belong to their headers.
///
/// # Errors
/// If a file cannot be read.
pub fn named_in(settings: &Settings, key: &str, before: Option<&Status>) -> Result<Vec<Input>> {
    let role = format!("named in {key}");
    let mut inputs = Vec::new();
    for path in files_in_words(&settings.words(key)) {
        inputs.extend(with_data(&path, [role.as_str(); 2], before)?);
    }
    Ok(inputs)
}

/// Returns the paths of the volume and its data files, without hashes; empty if the volume is
/// missing.
#[must_use]
pub fn paths_of_volume(volume: &Path) -> Vec<PathBuf> {
    if !volume.exists() {
        return Vec::new();
    }
    let data = if volume.is_file() { data_files(volume).unwrap_or_default() } else { Vec::new() };
    std::iter::once(volume.to_path_buf()).chain(data.into_iter().filter(|path| path.is_file())).collect()
}

/// Returns the paths of all files named in the setting `key`, and of their data files.
#[must_use]
pub fn paths_named_in(settings: &Settings, key: &str) -> Vec<PathBuf> {
    files_in_words(&settings.words(key)).iter().flat_map(|path| paths_of_volume(path)).collect()
}

/// Returns every existing file whose path is a word, or a part of a word between separators (`=`,
/// `:` and `,`). Accepts a folder only as the value of an option that takes a volume, and skips the
/// values of output options.
fn files_in_words(words: &[String]) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = Vec::new();
    let mut option = "";
    for word in words {
        let (name, value) = match word.split_once('=') {
            Some((name, value)) if name.starts_with('-') => (name, value),
            _ if word.starts_with('-') => (word.as_str(), ""),
            _ => (option, word.as_str()),
        };
        option = if word.starts_with('-') { word } else { "" };
        if OUTPUT_OPTIONS.contains(&name) {
            continue;
        }
        for path in parts(value).map(PathBuf::from) {
            // A volume may be a folder of slices, so only options that take a volume accept a
            // folder.
            let takes_volume = name.ends_with("-volume") || name == "--crop";
            let counts = path.is_file() || (takes_volume && path.is_dir());
            if counts && !found.contains(&path) {
                found.push(path);
            }
        }
    }
    found
}

/// Returns every part of a word between two separators, where both ends of the word count as
/// separators. The word itself is one of these parts.
fn parts(word: &str) -> impl Iterator<Item = &str> {
    let cut = |c: char| matches!(c, '=' | ':' | ',');
    let starts = std::iter::once(0).chain(word.match_indices(cut).map(|(at, separator)| at + separator.len()));
    let starts: Vec<usize> = starts.collect();
    let ends: Vec<usize> = word.match_indices(cut).map(|(at, _)| at).chain(std::iter::once(word.len())).collect();
    let pairs = starts
        .into_iter()
        .flat_map(move |start| ends.clone().into_iter().filter(move |end| *end > start).map(move |end| (start, end)));
    pairs.map(|(start, end)| &word[start..end])
}

/// Returns the current size, modification time and hash of a file or folder. The hash of an
/// unchanged file is reused.
fn input(role: &str, path: &Path, before: Option<&Status>) -> Result<Input> {
    let unreadable = |error: &std::io::Error| Error::file(path, "read", error, "check its name and permissions");
    let path = path.canonicalize().map_err(|error| unreadable(&error))?;
    let role = role.to_owned();
    if path.is_dir() {
        let (bytes, hash) = hash_folder(&path).map_err(|error| unreadable(&error))?;
        return Ok(Input { role, path, bytes, hash, modified: 0 });
    }
    let identity = Identity::of(&path).ok_or_else(|| {
        Error::input(
            format!("{}: is not a regular file", path.display()),
            "changes between runs cannot be detected",
            "copy it to a regular file",
        )
    })?;
    let Identity { bytes, modified } = identity;
    let known = before.and_then(|status| {
        status.inputs.iter().find(|old| old.path == path && old.bytes == bytes && old.modified == modified)
    });
    let hash = match known {
        Some(old) => old.hash.clone(),
        None => hash_file(&path).map_err(|error| unreadable(&error))?,
    };
    Ok(Input { role, path, bytes, hash, modified })
}

/// Returns the BLAKE3 hash of a file's bytes, in hexadecimal.
pub(crate) fn hash_file(path: &Path) -> std::io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(std::fs::File::open(path)?)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Returns the total size in bytes of the files under a folder, and the hash of their names and
/// contents.
fn hash_folder(folder: &Path) -> std::io::Result<(u64, String)> {
    let (mut hasher, mut bytes) = (blake3::Hasher::new(), 0);
    let mut folders = vec![folder.to_path_buf()];
    let mut files = Vec::new();
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next)? {
            let path = entry?.path();
            // A symbolic link to a folder may create a cycle.
            if path.is_dir() && !path.is_symlink() {
                folders.push(path);
            } else if path.is_file() {
                files.push(path);
            }
        }
    }
    files.sort();
    for file in files {
        bytes += file.metadata()?.len();
        hasher.update(file.strip_prefix(folder).unwrap_or(&file).as_os_str().as_encoded_bytes());
        hasher.update(&[0]);
        hasher.update(hash_file(&file)?.as_bytes());
    }
    Ok((bytes, hasher.finalize().to_hex().to_string()))
}

/// Returns a hash of the files of a program, in hexadecimal. An unreadable file counts as empty.
pub(crate) fn hash_program(files: &[PathBuf]) -> String {
    let mut hasher = blake3::Hasher::new();
    for file in files {
        let mut content = Vec::new();
        // An unreadable program cannot be started either. The error is reported when the program is
        // started.
        let _ = std::fs::File::open(file).and_then(|mut file| file.read_to_end(&mut content));
        hasher.update(&content.len().to_le_bytes()).update(&content);
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_found_wherever_an_option_names_them() {
        let folder = tempfile::tempdir().expect("folder");
        let file = |name: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, name).expect("written");
            path
        };
        let (mask, points, log) = (file("a mask.nrrd"), file("x,y=1.vtp"), file("log.csv"));
        let words = [
            "--refine".to_owned(),
            format!("mask:{}=1.5", mask.display()),
            format!("--refine=points:{}", points.display()),
            "--log".to_owned(),
            log.display().to_string(),
            format!("--report={}", log.display()),
            "--quality".to_owned(),
            "fine".to_owned(),
            folder.path().display().to_string(),
        ];
        assert_eq!(files_in_words(&words), [mask, points]);
        let labels = ["--labels-volume".to_owned(), folder.path().display().to_string()];
        assert_eq!(files_in_words(&labels), [folder.path()]);
    }

    #[test]
    fn a_folder_counts_by_its_files() {
        let folder = tempfile::tempdir().expect("folder");
        std::fs::write(folder.path().join("1.dcm"), "one").expect("written");
        let first = of_volume(folder.path(), None).expect("hashed");
        std::fs::write(folder.path().join("2.dcm"), "two").expect("written");
        let second = of_volume(folder.path(), None).expect("hashed");
        assert_eq!((first[0].bytes, second[0].bytes), (3, 6));
        assert_ne!(first[0].hash, second[0].hash);
    }
}
