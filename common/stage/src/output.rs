//! Outputs of a stage: there whole or not at all, with the errors that a user reads.

use crate::error::Result;
use std::io::{self, Write};
use std::path::Path;

/// Refuses an output that exists (without `force`) or whose folder cannot be written to.
///
/// # Errors
/// In three parts.
pub fn check_output(path: &Path, force: bool) -> Result<()> {
    Ok(isoparticles_file::output::check_output(path, force)?)
}

/// Writes a file so that it appears under its name only when it is complete ([`isoparticles_file::output::write_atomically`]).
///
/// # Errors
/// In three parts.
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    Ok(isoparticles_file::output::write_atomically(path, write)?)
}
