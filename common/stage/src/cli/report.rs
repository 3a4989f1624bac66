//! The JSON file that `--report` writes.

use super::{Outcome, exit_code};
use crate::error::{Error, Kind, Result};
use crate::output::write_atomically;
use isoparticles_file::history::History;
use serde_json::{Map, Value, json};
use std::path::Path;

/// The contents of a report.
pub(super) struct Report<'a> {
    pub(super) history: &'a History,
    pub(super) threads: usize,
    pub(super) seconds: f64,
    pub(super) peak_memory: Option<u64>,
    pub(super) steps: &'a [(String, f64)],
    pub(super) warnings: &'a [String],
    pub(super) results: &'a Map<String, Value>,
    pub(super) result: &'a Result<Outcome>,
}

/// Writes a report.
pub(super) fn write(path: &Path, report: &Value) -> Result<()> {
    let text = serde_json::to_string_pretty(report).map_err(|error| {
        Error::input(format!("{}: {error}", path.display()), "the report cannot be written as JSON", "report this bug")
    })?;
    write_atomically(path, |file| writeln!(file, "{text}"))
}

impl Report<'_> {
    /// Returns the report of a run, which may have failed.
    pub(super) fn json(&self) -> Value {
        let (outcome, failed, error) = match self.result {
            Ok(Outcome::Passed) => ("passed", &[][..], None),
            Ok(Outcome::ChecksFailed(checks)) => ("checks_failed", &checks[..], None),
            Err(error) if error.kind == Kind::Interrupted => ("interrupted", &[][..], Some(error)),
            Err(error) => ("error", &[][..], Some(error)),
        };
        let inputs: Vec<Value> =
            self.history.inputs.iter().map(|input| json!({"path": input.path, "blake3": input.blake3})).collect();
        let steps: Vec<Value> =
            self.steps.iter().map(|(name, seconds)| json!({"name": name, "seconds": seconds})).collect();
        json!({
            "tool": self.history.tool,
            "version": self.history.version,
            "command_line": self.history.command_line,
            "parameters": self.history.parameters,
            "inputs": inputs,
            "threads": self.threads,
            "seconds": self.seconds,
            "steps": steps,
            "peak_memory_bytes": self.peak_memory,
            "warnings": self.warnings,
            "outcome": outcome,
            "exit_code": exit_code(self.result),
            "failed_checks": failed,
            "error": error.map(|error| json!({"what": error.what, "why": error.why, "next": error.next})),
            "results": self.results,
        })
    }
}
