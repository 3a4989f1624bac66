//! Keeps track of a case: its volume, its settings, the stage that made each file, and the results
//! that must be made again.
//!
//! A case is a sequence of stages that process one volume. The results are in the folder OUT/NAME.
//! [`run::make`] compares the options, program, files and earlier stages that each result depends
//! on with the status of the last run. It removes results that are out of date, runs the stages
//! that make them, and updates [`status::Status`] at each step. So every result in the folder was
//! made or confirmed by the last run. The Makefile calls the program of this crate.

mod advice;
pub mod batch;
pub mod check;
pub mod cluster;
pub mod folder;
pub mod front;
pub mod index;
pub mod inputs;
pub mod keys;
pub mod name;
pub mod program;
pub mod run;
pub mod settings;
pub mod stages;
pub mod status;
pub mod verdict;
