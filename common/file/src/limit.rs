//! Refuses data that does not fit in memory before it is allocated.

use crate::error::{Error, Result};
use crate::memory::available_memory;
use std::path::Path;

/// Checks that `bytes` more memory can be allocated for the file `path`. Always succeeds if the
/// free memory is unknown.
///
/// # Errors
/// If less memory is free.
pub fn check_memory(path: &Path, bytes: u64) -> Result<()> {
    match available_memory() {
        Some(available) if bytes > available => {
            Err(Error::TooLarge { path: path.to_path_buf(), promised: bytes, available })
        }
        _ => Ok(()),
    }
}
