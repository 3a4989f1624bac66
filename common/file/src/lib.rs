//! Files that are there whole or not at all, and what rides along in them.
//!
//! [`output`] writes to a temporary name and renames; [`history`] says what a file was made from, and how; [`limit`] refuses what does not
//! fit in memory before it is allocated; [`monitor`] is how long work is watched and stopped. The crates that read and write volumes and meshes rest on this one, so that none of them needs
//! the frame of a stage program (`isoparticles-stage`), which rests on it as well.
//!
//! ```
//! use isoparticles_file::{history::hash_file, output::write_atomically};
//!
//! let path = std::env::temp_dir().join(format!("isoparticles-example-{}.txt", std::process::id()));
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
