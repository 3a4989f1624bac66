//! Files that are there whole or not at all, and what rides along in them.
//!
//! [`output`] writes to a temporary name and renames; [`history`] says what a file was made from, and how; [`limit`] refuses what does not
//! fit in memory before it is allocated. The crates that read and write volumes and meshes rest on this one, so that none of them needs
//! the frame of a stage program (`isoparticles-stage`), which rests on it as well.

pub mod error;
pub mod history;
pub mod interrupt;
pub mod limit;
pub mod memory;
pub mod output;
