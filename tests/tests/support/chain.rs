//! Runs the stage programs that turn a volume into triangles.

use super::stage;
use crate::arguments;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Paths of the files of a case.
#[derive(Clone, Debug)]
pub struct Files {
    /// Signed distance field.
    pub distfield: PathBuf,
    /// Target edge length.
    pub sizefield: PathBuf,
    /// Report of `sizefield`.
    pub sizefield_report: PathBuf,
    /// Initial particles.
    pub seeds: PathBuf,
    /// Settled particles.
    pub particles: PathBuf,
    /// Triangles.
    pub surface: PathBuf,
}

impl Files {
    /// Returns the paths of the files of a case in `folder`.
    pub fn in_folder(folder: &Path) -> Self {
        let file = |name: &str| folder.join(name);
        Self {
            distfield: file("case.distfield.vti"),
            sizefield: file("case.sizefield.vti"),
            sizefield_report: file("case.sizefield.json"),
            seeds: file("case.seeds.bin"),
            particles: file("case.particles.bin"),
            surface: file("case.surface.vtp"),
        }
    }
}

/// Additional command-line options of each stage.
#[derive(Clone, Debug, Default)]
pub struct Wishes {
    /// Options of `distfield`, which must include the iso value, the labels or the materials.
    pub distfield: Vec<OsString>,
    /// Options of `sizefield`.
    pub sizefield: Vec<OsString>,
    /// Options of `particles`.
    pub particles: Vec<OsString>,
    /// Options of `reconstruct`.
    pub reconstruct: Vec<OsString>,
}

impl Wishes {
    /// Returns the options for a phantom's scalar volume. `size` sets a constant edge length in mm.
    pub fn scalar(size: Option<f64>) -> Self {
        Self::of(arguments!["--iso", "100"], size)
    }

    /// Returns the options for a phantom's label map. `size` sets a constant edge length in mm.
    pub fn label(size: Option<f64>) -> Self {
        Self::of(arguments!["--labels", "1"], size)
    }

    fn of(distfield: Vec<OsString>, size: Option<f64>) -> Self {
        let sizefield = size.map_or_else(Vec::new, |h| arguments!["--uniform", h.to_string()]);
        Self { distfield, sizefield, ..Self::default() }
    }
}

/// Runs distfield and sizefield.
#[track_caller]
pub fn fields(volume: &Path, folder: &Path, wishes: &Wishes) -> Files {
    let files = Files::in_folder(folder);
    let mut command = arguments![volume, "-o", &files.distfield];
    command.extend(wishes.distfield.clone());
    stage("distfield", command).expect_success("distfield");
    let report = &files.sizefield_report;
    let mut command = arguments![&files.distfield, "-o", &files.sizefield, "--report", report];
    command.extend(wishes.sizefield.clone());
    stage("sizefield", command).expect_success("sizefield");
    files
}

/// Runs all stages up to the triangles.
#[track_caller]
pub fn surface(volume: &Path, folder: &Path, wishes: &Wishes) -> Files {
    let files = fields(volume, folder, wishes);
    stage("seed", arguments![&files.distfield, &files.sizefield, "-o", &files.seeds]).expect_success("seed");
    let fields = arguments!["--distfield", &files.distfield, "--sizefield", &files.sizefield];
    let mut command = arguments![&files.seeds, "-o", &files.particles];
    command.extend(fields.clone());
    command.extend(wishes.particles.clone());
    stage("particles", command).expect_success("particles");
    let mut command = arguments![&files.particles, "-o", &files.surface];
    command.extend(fields);
    command.extend(wishes.reconstruct.clone());
    stage("reconstruct", command).expect_success("reconstruct");
    files
}
