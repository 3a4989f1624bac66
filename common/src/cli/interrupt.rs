//! The flag that SIGINT and SIGTERM set. Long loops look at it; the second signal ends the program at once.

use crate::error::{Error, Result};
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static INSTALL: Once = Once::new();

/// Starts to listen for SIGINT, SIGTERM and SIGHUP (once in a process).
pub fn install() {
    INSTALL.call_once(|| {
        let handler = || {
            if INTERRUPTED.swap(true, Ordering::SeqCst) {
                crate::io::output::remove_temporaries();
                std::process::exit(130);
            }
        };
        // Without a handler the default action of the signal applies: the program ends, which is what was asked for.
        let _ = ctrlc::set_handler(handler);
    });
}

/// Whether the user has asked to stop.
pub fn requested() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Fails when the user has asked to stop.
pub fn check(tool: &str) -> Result<()> {
    if requested() { Err(Error::interrupted(format!("{tool}: interrupted"))) } else { Ok(()) }
}
