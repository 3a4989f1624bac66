//! File handling shared by the crates that read and write volumes and meshes, and by the common
//! code of the stage programs (`isoparticles-stage`).
//!
//! [`output`] writes files atomically: it writes to a temporary file and then renames it.
//! [`history`] records how a file was made. [`limit`] rejects data that does not fit in the free
//! memory, before memory is allocated for it. [`monitor`] reports the progress of long computations
//! and stops them on request.
//!
//! ```
//! use isoparticles_file::{history::hash_file, output::write_atomically};
//!
//! let path =
//!     std::env::temp_dir().join(format!("isoparticles-example-{}.txt", std::process::id()));
//! write_atomically(&path, |file| file.write_all(b"all of it, or nothing"))?;
//! assert_eq!(hash_file(&path)?.len(), 64);
//! # std::fs::remove_file(&path).ok();
//! # Ok::<(), isoparticles_file::error::Error>(())
//! ```

pub mod error;
pub mod history;
pub mod interrupt;
pub mod limit;
pub mod memory;
pub mod monitor;
pub mod output;
