//! One error type for every stage: what happened (file, value), why it matters, what to do next.

use std::path::Path;

/// How a stage ends; the numbers are the exit codes of DESIGN section 3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Bad usage or input: exit code 2.
    Input,
    /// No usable GPU where one was demanded: exit code 3.
    Gpu,
    /// Interrupted: exit code 130.
    Interrupted,
}

/// An error in three parts.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{what}\n  why it matters: {why}\n  what to do: {next}")]
pub struct Error {
    /// How the program should exit.
    pub kind: Kind,
    /// What happened: the file and the value.
    pub what: String,
    /// Why the stage cannot go on.
    pub why: String,
    /// What the user can do next.
    pub next: String,
}

/// Result of anything that can fail in a stage.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Bad usage or input (exit code 2).
    pub fn input(what: impl Into<String>, why: impl Into<String>, next: impl Into<String>) -> Self {
        Self { kind: Kind::Input, what: what.into(), why: why.into(), next: next.into() }
    }

    /// No usable GPU (exit code 3).
    pub fn gpu(what: impl Into<String>, why: impl Into<String>, next: impl Into<String>) -> Self {
        Self { kind: Kind::Gpu, what: what.into(), why: why.into(), next: next.into() }
    }

    /// The user interrupted the run (exit code 130).
    pub fn interrupted(what: impl Into<String>) -> Self {
        Self {
            kind: Kind::Interrupted,
            what: what.into(),
            why: "the run was stopped before its output was complete".into(),
            next: "run the same command again; a checkpoint, if one was asked for, can be resumed".into(),
        }
    }

    /// An operating-system error on a file (exit code 2).
    pub fn file(path: &Path, doing: &str, source: &std::io::Error, next: impl Into<String>) -> Self {
        Self::input(format!("{}: cannot {doing}: {source}", path.display()), "the stage needs this file", next)
    }
}
