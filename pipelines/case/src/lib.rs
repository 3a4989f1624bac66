//! The truth about a case: which volume, what was asked for, which stage made what, and what has to be made again.
//!
//! A case is a chain of stages over one volume; its results lie in the folder OUT/NAME. [`run::make`] compares what each
//! stage's result depends on (options, program, files, the stages before) with what the status of the last run says of it,
//! takes away what no longer holds, runs the stages from there on, and keeps [`status::Status`] in step with the folder: a file
//! of the case that the last run neither made nor confirmed is not there. The Makefile calls the program of this crate.

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
