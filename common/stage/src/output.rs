//! Atomic writing of a stage's outputs, with user-facing errors.

use crate::error::Result;
use std::io::{self, Write};
use std::path::Path;

/// Fails if an output exists (unless `force` is set) or if its folder cannot be written to.
///
/// # Errors
/// An error in three parts.
pub fn check_output(path: &Path, force: bool) -> Result<()> {
    Ok(isoparticles_file::output::check_output(path, force)?)
}

/// Writes a file atomically; see [`isoparticles_file::output::write_atomically`].
///
/// # Errors
/// An error in three parts.
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    Ok(isoparticles_file::output::write_atomically(path, write)?)
}
