//! Tests that cannot run here say so, and are counted at the end of `make test`.

use std::io::Write;
use std::path::{Path, PathBuf};

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

/// Where the real volumes lie: `../shared/data` from the repository's root, or what ISOPARTICLES_DATA says.
#[must_use]
pub fn real_volumes_folder() -> PathBuf {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    std::env::var_os("ISOPARTICLES_DATA").map_or(beside, PathBuf::from)
}

/// A real volume by its file's name, or a note that the test skips.
#[must_use]
pub fn real_volume(name: &str) -> Option<PathBuf> {
    let path = real_volumes_folder().join(name);
    if path.exists() {
        return Some(path);
    }
    skip(name, &format!("{} is not there", path.display()));
    None
}
