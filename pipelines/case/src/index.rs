//! Generates the index of all cases in a folder from their status files.

use crate::command::Programs;
use crate::folder::CaseFolder;
use crate::program::{self, Ended};
use isoparticles_stage::error::{Error, Result};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Marks killed runs in a folder as interrupted. Returns the status files of the cases in the
/// folder, sorted by name.
///
/// # Errors
/// If there is no status file, or the corrected status of a killed run cannot be written.
pub fn status_files(out: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(out).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    let mut files = Vec::new();
    for name in names {
        let folder = CaseFolder::new(out, &name);
        if folder.settle()?.is_some() {
            files.push(folder.status_path());
        }
    }
    if files.is_empty() {
        return Err(Error::input(
            format!("{}: no cases", out.display()),
            "the index is made from OUT/NAME/NAME.status.json",
            format!("make a case first ({} demo), or set OUT to the folder of the cases", program::front()),
        ));
    }
    Ok(files)
}

/// Writes `index.html` and `index.csv` for the cases in a folder and the status files in `more`.
///
/// # Errors
/// If there are no cases, or the index program fails.
pub fn write(out: &Path, more: Vec<PathBuf>, programs: &Programs) -> Result<PathBuf> {
    let index = out.join("index.html");
    let cases = match status_files(out) {
        Err(_) if !more.is_empty() => more,
        cases => [cases?, more].concat(),
    };
    let mut arguments: Vec<OsString> = cases.into_iter().map(PathBuf::into_os_string).collect();
    arguments.extend(["-o".into(), index.clone().into_os_string(), "--force".into()]);
    match program::run(&programs.index(), &arguments)? {
        Ended::Code(0) => Ok(index),
        ended => Err(Error::input(
            format!("{}: ended with {ended:?}", programs.index().display()),
            "the index was not written",
            "see its messages above",
        )),
    }
}
