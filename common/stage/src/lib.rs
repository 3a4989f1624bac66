//! What makes a program a stage of isoparticles.
//!
//! [`cli`] has the options that every stage has, its exit codes, progress and report; [`error`] the error in three parts that a user
//! reads; [`field_file`] and [`particle_file`] the files that go from stage to stage.

pub mod cli;
pub mod field_file;
pub mod particle_file;
pub mod quality;

pub use isoparticles_file::{error, history, output};
