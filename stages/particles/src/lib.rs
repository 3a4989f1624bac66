//! The `particles` stage: settles particles on F = 0 until they form a near-hexagonal lattice of
//! local spacing h.
//!
//! Implements section 3 of Kim, Chen and Hansen 2012: neighbours, energy, damped Newton steps,
//! projection, density control and the stop test. The same seeds, fields and parameters give the
//! same bytes with any number of threads on the CPU, and in every run on the same GPU adapter.

pub mod args;
mod checkpoint;
mod coarse;
mod constants;
mod cpu;
mod density;
pub mod gpu;
mod implicit;
mod log;
mod matching;
mod movement;
mod neighbourhood;
#[cfg(test)]
mod reference;
pub mod run;
#[cfg(test)]
mod scenes;
mod settle;
mod state;

pub use constants::{DEFECT_WINDOW, INITIAL_LAMBDA, REORDER_INTERVAL};
pub use cpu::{OnStrata, settle, settle_interfaces};
pub use implicit::{Implicit, Interfaces};
pub use settle::{Binning, Engine, Order, Parameters, PassOutcome, PassRecord, Summary, settle_with};
pub use state::Fields;
