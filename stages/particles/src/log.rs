//! The log of a run: one line per pass, as CSV or JSON Lines.

use crate::settle::PassRecord;
use isoparticles_stage::error::{Error, Result};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// An open log. Lines are not buffered.
pub(crate) struct Log {
    path: PathBuf,
    file: File,
    json_lines: bool,
}

impl Log {
    /// Creates a log and writes the records of the passes already run. The format is JSON Lines if
    /// the name ends in `.jsonl`, otherwise CSV.
    pub(crate) fn create(path: &Path, records: &[PassRecord]) -> Result<Self> {
        let file = File::create(path).map_err(|e| failed(path, &e))?;
        let mut log = Self { path: path.into(), file, json_lines: path.extension().is_some_and(|e| e == "jsonl") };
        if !log.json_lines {
            log.line(
                "pass,energy,count,inserted,deleted,escaped,moved,tries_per_particle,neighbours,lattice_defects,seconds,scale",
            )?;
        }
        records.iter().try_for_each(|record| log.write(record))?;
        Ok(log)
    }

    /// Appends the line of one pass.
    pub(crate) fn write(&mut self, r: &PassRecord) -> Result<()> {
        let line = if self.json_lines {
            serde_json::json!(r).to_string()
        } else {
            format!(
                "{},{},{},{},{},{},{},{:.3},{:.2},{},{:.3},{}",
                r.pass,
                r.energy,
                r.count,
                r.inserted,
                r.deleted,
                r.escaped,
                r.moved,
                r.tries_per_particle,
                r.neighbours,
                r.lattice_defects,
                r.seconds,
                r.scale
            )
        };
        self.line(&line)
    }

    fn line(&mut self, line: &str) -> Result<()> {
        writeln!(self.file, "{line}").map_err(|e| failed(&self.path, &e))
    }
}

fn failed(path: &Path, error: &std::io::Error) -> Error {
    Error::file(path, "write the log", error, "check the folder and the free disk space, or leave out --log")
}
