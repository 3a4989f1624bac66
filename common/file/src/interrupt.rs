//! A flag that requests the run to stop. Stage programs set the flag on SIGINT, SIGTERM and SIGHUP,
//! and code that writes files checks the flag.

use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Requests the run to stop. Returns whether a stop had already been requested.
pub fn request() -> bool {
    INTERRUPTED.swap(true, Ordering::SeqCst)
}

/// Returns whether a stop has been requested.
pub fn requested() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}
