//! Tests that cannot run here say so, and are counted at the end of `make test`.

use std::io::Write;

/// Environment variable with the name of the file that skips are noted in, one a line: test, tab, reason.
pub const NOTED_IN: &str = "ISOPARTICLES_SKIPS";

/// Says on the terminal, past the capture of the test's output, that a test did not run, and notes it where `make test` counts.
pub fn skip(what: &str, reason: &str) {
    // A closed stderr is no reason to fail.
    let _ = writeln!(std::io::stderr(), "SKIP {what}: {reason}");
    let Some(path) = std::env::var_os(NOTED_IN) else { return };
    let binary = std::env::current_exe().ok().and_then(|path| Some(path.file_stem()?.to_string_lossy().into_owned()));
    let thread = std::thread::current();
    // The harness runs each test on a thread of its name; one test may skip in several places.
    let test = format!("{}::{}", binary.unwrap_or_default(), thread.name().unwrap_or(what));
    let mut file = std::fs::File::options().create(true).append(true).open(path).expect("the file of skips");
    file.write_all(format!("{test}\t{what}: {reason}\n").as_bytes()).expect("noted");
}
