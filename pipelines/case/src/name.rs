//! Derives the name of a case from its volume.

use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::masks;
use std::path::Path;

/// File name suffixes that are not part of the name of the results, besides those of masks. The
/// first match is removed, so `.ome.tif` comes before `.tif`.
const ENDINGS: [&str; 11] =
    [".ome.tiff", ".ome.tif", ".ome.zarr", ".tiff", ".tif", ".npy", ".dcm", ".zarr", ".hdf5", ".h5", ".mat"];

/// Returns the name of a volume's results: the file or folder name without a known suffix.
///
/// # Errors
/// If the remaining name is not a valid folder name.
pub fn of_volume(path: &Path) -> Result<String> {
    // A path such as `..` or `.` has no file name until it is resolved.
    let path = if path.file_name().is_some() { path.to_path_buf() } else { path.canonicalize().unwrap_or_default() };
    let file = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let lower = file.to_ascii_lowercase();
    let mut endings = masks::ENDINGS.iter().chain(&ENDINGS);
    let ending = endings.find(|ending| lower.ends_with(*ending) && lower.len() > ending.len());
    let name = &file[..file.len() - ending.map_or(0, |ending| ending.len())];
    check(name)?;
    Ok(name.to_owned())
}

/// Checks that a name is valid for a folder in OUT.
///
/// # Errors
/// If the name is empty, hidden, starts with `-`, or contains a path separator or a line break.
pub fn check(name: &str) -> Result<()> {
    if name.is_empty() || name.starts_with(['.', '-']) || name.contains(['/', '\\', '\n']) {
        return Err(Error::input(
            format!("NAME={name}: is not a valid name"),
            "the results go to the folder NAME in OUT",
            "set NAME to letters, digits, dots, spaces, - and _, with a letter or digit first",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_known_endings_are_taken_off() {
        for (path, name) in [
            ("a/patient.001.nrrd", "patient.001"),
            ("patient.002.nii.gz", "patient.002"),
            ("left lung.seg.nrrd", "left lung"),
            ("CT.NRRD", "CT"),
            ("old.hdr.gz", "old"),
            ("cells.ome.tiff", "cells"),
            ("series/", "series"),
            ("cells.ome.zarr/", "cells"),
            ("v1.2", "v1.2"),
            (".nrrd", ""),
        ] {
            match of_volume(Path::new(path)) {
                Ok(found) => assert_eq!(found, name, "{path}"),
                Err(error) => assert!(name.is_empty() && error.what.contains("NAME="), "{path}: {error}"),
            }
        }
    }
}
