//! Connects a run to a program that calls a stage as a library, instead of a terminal and signals.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Receives the progress of a run and can stop it. One thread runs the stage; another thread polls
/// [`Listener::latest`].
#[derive(Debug, Default)]
pub struct Listener {
    is_cancelled: AtomicBool,
    latest: Mutex<Option<ProgressState>>,
}

/// The state of the step that reported last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProgressState {
    /// Name of the stage.
    pub stage: &'static str,
    /// Name of the step.
    pub step: String,
    /// Completed work.
    pub done: u64,
    /// Total work, if known.
    pub total: Option<u64>,
    /// Details, such as the number of particles. May be empty.
    pub message: String,
}

impl Listener {
    /// Stops the run. It ends with an error at its next check.
    pub fn cancel(&self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }

    /// Returns whether the run has been stopped.
    pub fn is_cancelled(&self) -> bool {
        self.is_cancelled.load(Ordering::Relaxed)
    }

    /// Takes the latest progress. Returns `None` if there is none since the last call.
    pub fn latest(&self) -> Option<ProgressState> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    pub(super) fn show(&self, shown: ProgressState) {
        *self.latest.lock().unwrap_or_else(PoisonError::into_inner) = Some(shown);
    }
}
