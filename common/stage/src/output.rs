//! Writes the outputs of a stage atomically, with user-facing errors.

use crate::error::Result;
use std::io::{self, Write};
use std::path::Path;

/// Checks that an output can be written.
///
/// # Errors
/// If the output exists and `force` is false, if it is a folder, or if its folder is not writable.
pub fn check_output(path: &Path, force: bool) -> Result<()> {
    Ok(isoparticles_file::output::check_output(path, force)?)
}

/// Writes a file atomically. See [`isoparticles_file::output::write_atomically`].
///
/// # Errors
/// If the file cannot be written.
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    Ok(isoparticles_file::output::write_atomically(path, write)?)
}
