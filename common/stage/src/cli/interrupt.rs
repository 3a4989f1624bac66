//! Handles SIGINT, SIGTERM and SIGHUP. The first signal sets a flag; long loops check it and stop
//! the run. The second signal ends the program immediately.

use isoparticles_file::output;
use std::sync::Once;

pub use isoparticles_file::interrupt::requested;

static INSTALL: Once = Once::new();

/// Installs the handler for SIGINT, SIGTERM and SIGHUP, once per process.
pub fn install() {
    INSTALL.call_once(|| {
        let handler = || {
            if isoparticles_file::interrupt::request() {
                output::remove_temporaries();
                std::process::exit(130);
            }
        };
        // If the handler cannot be installed, the signals keep their default action, which ends the
        // program.
        let _ = ctrlc::set_handler(handler);
    });
}
