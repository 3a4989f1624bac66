//! Refuses what does not fit in memory before it is allocated.

use crate::error::{Error, Result};
use crate::memory::available_memory;
use std::path::Path;

/// Refuses `bytes` more of memory when the machine cannot give them.
///
/// # Errors
/// When less than that is free.
pub fn check_memory(path: &Path, bytes: u64) -> Result<()> {
    match available_memory() {
        Some(available) if bytes > available => Err(bad(
            path,
            format!("its header promises {} MiB of voxels", bytes >> 20),
            format!("only {} MiB of memory are free", available >> 20),
            "crop or resample the volume, or use a larger machine; if the volume is small, its header is damaged",
        )),
        _ => Ok(()),
    }
}

/// An input error about a file.
pub fn bad(path: &Path, what: impl std::fmt::Display, why: impl Into<String>, next: impl Into<String>) -> Error {
    Error::input(format!("{}: {what}", path.display()), why, next)
}
