//! A flag that is set when the run should stop. Stage programs set it on SIGINT, SIGTERM and
//! SIGHUP. Long computations and code that writes files check it.

use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Sets the flag. Returns whether it was already set.
pub fn request() -> bool {
    INTERRUPTED.swap(true, Ordering::SeqCst)
}

/// Returns whether a stop has been requested.
pub fn requested() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}
