//! Checks whether data fits in the free memory, before memory is allocated for it.

use crate::error::{Error, Result};
use crate::memory::available_memory;
use std::path::Path;

/// Checks that `bytes` more bytes of memory can be allocated for the file `path`. Always succeeds
/// if the amount of free memory is unknown.
///
/// # Errors
/// If fewer than `bytes` bytes of memory are free.
pub fn check_memory(path: &Path, bytes: u64) -> Result<()> {
    match available_memory() {
        Some(available) if bytes > available => {
            Err(Error::TooLarge { path: path.to_path_buf(), promised: bytes, available })
        }
        _ => Ok(()),
    }
}
