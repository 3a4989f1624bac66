//! A flag that requests the end of the run. Stage programs set the flag on SIGINT, SIGTERM and
//! SIGHUP, and code that writes files checks the flag.

use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Requests the end of the run. Returns whether a stop had already been requested.
pub fn request() -> bool {
    INTERRUPTED.swap(true, Ordering::SeqCst)
}

/// Returns whether a stop has been requested.
pub fn requested() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}
