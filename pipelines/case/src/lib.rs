//! Keeps track of a case: its volume, its settings, the stage that made each file, and the results
//! that are out of date.
//!
//! A case is a sequence of stages that process one volume. The results are in the folder OUT/NAME.
//! A result depends on the options, the program, the input files and the earlier stages;
//! [`run::make`] compares these with the status of the last run. It removes results that are out of
//! date, runs their stages again, and updates [`status::Status`] at each step. Every result in the
//! folder has therefore been made or confirmed by the last run. The Makefile calls the program of
//! this crate.

mod advice;
pub mod batch;
pub mod check;
pub mod cluster;
pub mod command;
pub mod folder;
pub mod front;
pub mod index;
pub mod inputs;
pub mod keys;
pub mod name;
pub mod program;
pub mod read;
pub mod run;
pub mod settings;
pub mod stages;
pub mod status;
mod updates;
pub mod verdict;
