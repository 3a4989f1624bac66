//! `STAGE --check-options KNOWN ...` checks whether the stage would refuse a command line. It
//! writes no files, and reads the volume only if the volume is known to exist.
//!
//! isoparticles-case runs this check for every stage of a case before it removes any file or starts
//! any stage. Like `--command-line`, `--check-options` is not a regular option. The exit code is 0
//! if the command line is accepted. Otherwise, it is the exit code that a run would return.

use super::{Outcome, exit_code};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::process::ExitCode;

/// First argument of a command line that the stage checks without running it. The second argument
/// is a [`Known`] as JSON.
pub const CHECK_OPTIONS: &str = "--check-options";

/// Information about a case that is available before its stages run. Each stage adds its own
/// information and prints the result on stdout for the next stage.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Known {
    /// Names of the materials, starting with the outside. Empty for a single object; `None` if the
    /// names depend on a volume that has not been read.
    pub materials: Option<Vec<String>>,
    /// True if the volume on the command line exists. The stage may then read the volume.
    pub volume: bool,
}

impl Known {
    /// Returns whether the case has several materials, or `None` if this is unknown.
    #[must_use]
    pub fn is_many(&self) -> Option<bool> {
        self.materials.as_ref().map(|names| !names.is_empty())
    }
}

/// Checks a command line that begins with [`CHECK_OPTIONS`] and returns the exit code. Returns
/// `None` for any other command line.
pub fn asked<A: clap::Parser>(tool: &str, check: impl FnOnce(&A, Known) -> Result<Known>) -> Option<ExitCode> {
    let mut words = std::env::args_os().skip(1);
    if words.next()? != CHECK_OPTIONS {
        return None;
    }
    let known = words.next().unwrap_or_default();
    let parsed = parse::<A>(tool, words);
    let known = serde_json::from_str(&known.to_string_lossy()).map_err(|error| {
        Error::input(
            format!("{CHECK_OPTIONS}: {error}"),
            "it must be followed by JSON",
            "run isoparticles-case, which uses this word",
        )
    });
    let checked = known.and_then(|known| check(&parsed?, known));
    match &checked {
        Ok(known) => println!("{}", serde_json::json!(known)),
        Err(error) => eprintln!("error: {error}"),
    }
    Some(ExitCode::from(exit_code(&checked.map(|_| Outcome::Passed))))
}

/// Parses the arguments of a stage.
///
/// # Errors
/// If the command line is invalid, as a three-part error.
pub fn parse<A: clap::Parser>(tool: &str, words: impl IntoIterator<Item = std::ffi::OsString>) -> Result<A> {
    A::try_parse_from(std::iter::once(tool.into()).chain(words)).map_err(|error| usage(tool, &error))
}

/// Converts a usage error of clap to a three-part error, with each part on one line.
fn usage(tool: &str, error: &clap::Error) -> Error {
    let text = error.to_string();
    let end = ["\n\nUsage:", "\n\nFor more information"].iter().filter_map(|part| text.find(part)).min();
    let told = &text[..end.unwrap_or(text.len())];
    let what = told.trim_start_matches("error: ").split_whitespace().collect::<Vec<_>>().join(" ");
    Error::input(what, "the command line is invalid", format!("see `{} --help`", command(tool)))
}

/// Returns the command with which the user starts this program: the value of ISOPARTICLES_FRONT
/// followed by `tool`. If the variable is not set, returns the path of the running program, because
/// programs built in a clone of the repository are not on the PATH.
fn command(tool: &str) -> String {
    let path = || std::env::args().next().unwrap_or_else(|| tool.to_owned());
    std::env::var("ISOPARTICLES_FRONT").map_or_else(|_| path(), |front| format!("{front} {tool}"))
}
