//! The stage `read`, which converts volumes in formats that the other stages do not read: HDF5,
//! MATLAB and Zarr. The program is written in Python and is installed beside `tetmesh-check`.

use crate::command::{Programs, Volume, options};
use crate::program::{self, Ended};
use crate::settings::Settings;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::foreign_content;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Name of the program.
pub(crate) const PROGRAM: &str = "isoparticles-read";

/// Returns whether a volume must be converted.
pub(crate) fn is_needed(volume: &Path) -> bool {
    foreign_content(volume).is_some()
}

/// Returns whether `INPUT` is a volume that must be converted.
pub(crate) fn is_set(settings: &Settings) -> bool {
    settings.get("PHANTOM").is_none() && settings.get("INPUT").is_some_and(|path| is_needed(Path::new(path)))
}

/// Returns the settings for the programs that read a converted volume. The settings of other
/// volumes are unchanged.
#[must_use]
pub fn settings_after(settings: &Settings) -> Settings {
    if is_set(settings) { settings.without("SPACING") } else { settings.clone() }
}

/// Checks that DATASET is set only for a volume with named arrays.
///
/// # Errors
/// If it is set for another volume.
pub(crate) fn check(volume: &Volume, settings: &Settings) -> Result<()> {
    let has_arrays = matches!(volume, Volume::At(path) if is_needed(path));
    match settings.get("DATASET").filter(|_| !has_arrays) {
        None => Ok(()),
        Some(dataset) => Err(Error::input(
            format!("DATASET={dataset} is set, but the volume has no named arrays"),
            "DATASET selects an array of an HDF5, MATLAB or Zarr file",
            "leave out DATASET, or check INPUT",
        )),
    }
}

/// A converted volume in a temporary folder. Dropping this value deletes the folder.
#[derive(Debug)]
pub struct Converted(tempfile::TempDir);

impl Converted {
    /// Returns the path of the volume.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        self.0.path().join("input.vti")
    }
}

/// Converts a volume for `isoparticles-volume info`, if this is needed.
///
/// # Errors
/// If DATASET is set for a volume without named arrays, or if the volume cannot be converted. The
/// program has then printed why the conversion failed.
pub fn for_info(volume: &Path, settings: &Settings, programs: &Programs) -> Result<Option<Converted>> {
    check(&Volume::At(volume.to_path_buf()), settings)?;
    if !is_needed(volume) {
        return Ok(None);
    }
    let folder = tempfile::tempdir().map_err(|error| {
        Error::file(&std::env::temp_dir(), "create a folder", &error, "set TMPDIR to a folder with free space")
    })?;
    let converted = Converted(folder);
    let mut words: Vec<OsString> = vec![volume.into(), "-o".into(), converted.path().into(), "-q".into()];
    words.extend(options("read", settings).into_iter().map(OsString::from));
    match program::run(&programs.read(), &words)? {
        Ended::Code(0) => Ok(Some(converted)),
        _ => Err(Error::input(
            format!("{}: was not converted", volume.display()),
            "only converted volumes can be described",
            "see the message above",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(words: &[String]) -> Settings {
        Settings::read(words, &[], None, &[]).expect("fit together")
    }

    #[test]
    fn a_foreign_volume_is_converted_first() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("scan.h5");
        std::fs::write(&path, b"\x89HDF\r\n\x1a\n").expect("written");
        let input = format!("INPUT={}", path.display());
        let settings = settings(&[input, "DATASET=/volume".to_owned()]);
        assert_eq!(options("read", &settings), ["--dataset", "/volume"]);
        assert!(is_set(&settings) && !options("distfield", &settings).contains(&"--dataset".to_owned()));
        check(&Volume::At(path), &settings).expect("has arrays");
    }

    #[test]
    fn a_dataset_of_another_volume_is_refused() {
        let settings = settings(&["INPUT=v.nrrd".to_owned(), "DATASET=0".to_owned()]);
        let error = check(&Volume::At("v.nrrd".into()), &settings).expect_err("no arrays");
        assert!(error.what.contains("DATASET=0"), "{error}");
    }
}
