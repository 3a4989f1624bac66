//! Keeps track of a case: its volume, its settings, which stage made which file, and what must be
//! made again.
//!
//! A case is a chain of stages over one volume; its results are in the folder OUT/NAME.
//! [`run::make`] compares what each result depends on (options, program, files, earlier stages)
//! with the status of the last run. It removes results that are out of date, runs the stages from
//! there on, and updates [`status::Status`] at each step. So every result in the folder was made or
//! confirmed by the last run. The Makefile calls the program of this crate.

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
