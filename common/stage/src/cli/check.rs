//! `STAGE --check-options KNOWN ...`: would the stage refuse this command line? Nothing is written,
//! and nothing is read but the volume, where it is known to be there.
//!
//! The program that runs the stages of a case asks each of them before it removes or starts
//! anything. Like `--command-line` the words stand beside the options, not among them. The exit
//! code is that of the refused run, or 0.

use super::{Outcome, exit_code};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::process::ExitCode;

/// First word of a command line that is only checked; what is known of the case follows as JSON
/// ([`Known`]).
pub const CHECK_OPTIONS: &str = "--check-options";

/// What is known of a case before its stages run. Each stage prints it on stdout for the next one,
/// with what it adds.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Known {
    /// Names of the materials, the outside first; empty for one object, `None` where only the
    /// volume tells.
    pub materials: Option<Vec<String>>,
    /// Whether the volume on the command line is there and may be read.
    pub volume: bool,
}

impl Known {
    /// Whether the case has many materials; `None` where that is not known.
    #[must_use]
    pub fn is_many(&self) -> Option<bool> {
        self.materials.as_ref().map(|names| !names.is_empty())
    }
}

/// Checks a command line that begins with [`CHECK_OPTIONS`] and gives the exit code; `None` for any
/// other command line.
pub fn asked<A: clap::Parser>(tool: &str, check: impl FnOnce(&A, Known) -> Result<Known>) -> Option<ExitCode> {
    let mut words = std::env::args_os().skip(1);
    if words.next()? != CHECK_OPTIONS {
        return None;
    }
    let known = words.next().unwrap_or_default();
    let parsed = A::try_parse_from(std::iter::once(tool.into()).chain(words)).map_err(|error| usage(tool, &error));
    let known = serde_json::from_str(&known.to_string_lossy()).map_err(|error| {
        Error::input(
            format!("{CHECK_OPTIONS}: {error}"),
            "JSON follows it",
            "call isoparticles-case, which asks for this",
        )
    });
    let checked = known.and_then(|known| check(&parsed?, known));
    match &checked {
        Ok(known) => println!("{}", serde_json::json!(known)),
        Err(error) => eprintln!("error: {error}"),
    }
    Some(ExitCode::from(exit_code(&checked.map(|_| Outcome::Passed))))
}

/// A usage error of clap in three parts, on one line each.
fn usage(tool: &str, error: &clap::Error) -> Error {
    let text = error.to_string();
    let end = ["\n\nUsage:", "\n\nFor more information"].iter().filter_map(|part| text.find(part)).min();
    let told = &text[..end.unwrap_or(text.len())];
    let what = told.trim_start_matches("error: ").split_whitespace().collect::<Vec<_>>().join(" ");
    Error::input(what, "the command line was not understood", format!("see {tool} --help"))
}
