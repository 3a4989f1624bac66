//! The flag that requests a run to stop. Stage programs set it on SIGINT and SIGTERM; code that
//! writes files checks it.

use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Requests the run to stop. Returns whether that was already requested.
pub fn request() -> bool {
    INTERRUPTED.swap(true, Ordering::SeqCst)
}

/// Whether the run should stop.
pub fn requested() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}
