//! Reports tests that cannot run on this machine. `make test` counts them.

use std::io::Write;
use std::path::{Path, PathBuf};

/// Environment variable with the path of the file that records skips. Each line of the file
/// consists of the test, a tab and the reason.
pub const NOTED_IN: &str = "ISOPARTICLES_SKIPS";

/// Reports on the terminal that a test did not run, and records the skip for `make test`. The
/// report bypasses the output capture of the test harness.
pub fn skip(what: &str, reason: &str) {
    // A closed stderr is not a failure.
    let _ = writeln!(std::io::stderr(), "SKIP {what}: {reason}");
    let Some(path) = std::env::var_os(NOTED_IN) else { return };
    let binary = std::env::current_exe().ok().and_then(|path| Some(path.file_stem()?.to_string_lossy().into_owned()));
    let thread = std::thread::current();
    // The harness names the thread of each test after the test.
    let test = format!("{}::{}", binary.unwrap_or_default(), thread.name().unwrap_or(what));
    let mut file = std::fs::File::options().create(true).append(true).open(path).expect("the file of skips");
    file.write_all(format!("{test}\t{what}: {reason}\n").as_bytes()).expect("noted");
}

/// Returns the folder of the real volumes: ISOPARTICLES_DATA, or else `../shared/data` relative to
/// the repository's root.
#[must_use]
pub fn real_volumes_folder() -> PathBuf {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    std::env::var_os("ISOPARTICLES_DATA").map_or(beside, PathBuf::from)
}

/// Returns the path of the real volume with this file name. If the file is missing, records a skip
/// and returns `None`.
#[must_use]
pub fn real_volume(name: &str) -> Option<PathBuf> {
    let path = real_volumes_folder().join(name);
    if path.exists() {
        return Some(path);
    }
    skip(name, &format!("{} is not there", path.display()));
    None
}
