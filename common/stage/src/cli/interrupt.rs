//! SIGINT, SIGTERM and SIGHUP ask the run to stop. Long loops look at the flag; the second signal ends the program at once.

use isoparticles_file::error::{Error, Result};
use isoparticles_file::output;
use std::sync::Once;

pub use isoparticles_file::interrupt::requested;

static INSTALL: Once = Once::new();

/// Starts to listen for SIGINT, SIGTERM and SIGHUP (once in a process).
pub fn install() {
    INSTALL.call_once(|| {
        let handler = || {
            if isoparticles_file::interrupt::request() {
                output::remove_temporaries();
                std::process::exit(130);
            }
        };
        // Without a handler the default action of the signal applies: the program ends, which is what was asked for.
        let _ = ctrlc::set_handler(handler);
    });
}

/// Fails when the user has asked to stop.
pub fn check(tool: &str) -> Result<()> {
    if requested() { Err(Error::interrupted(format!("{tool}: interrupted"))) } else { Ok(()) }
}
