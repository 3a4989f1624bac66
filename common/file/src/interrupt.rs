//! The flag that says that the run shall stop. A stage program sets it on SIGINT and SIGTERM; whatever writes files looks at it.

use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Asks the run to stop; returns whether it had been asked before.
pub fn request() -> bool {
    INTERRUPTED.swap(true, Ordering::SeqCst)
}

/// Whether the run shall stop.
pub fn requested() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}
