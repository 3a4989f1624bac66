//! `NAME.status.json`: the truth about a case, from which its page and the index are made (docs/developer/formats.md).

use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::output::write_atomically;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What the file calls itself.
pub const FORMAT: &str = "isoparticles-status";
/// Version of its layout.
pub const VERSION: u32 = 1;

/// How a case stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Everything asked for is made, and every check passed.
    Passed,
    /// The same, with warnings.
    Warning,
    /// A check failed.
    Failed,
    /// A stage could not do its work.
    Error,
    /// Stopped before the end.
    Interrupted,
    /// A run is under way (or was killed: see [`crate::folder::CaseFolder::settle`]).
    Running,
}

/// How a stage of a case stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Its output is there and its checks passed.
    Done,
    /// Its output was made, but a check failed.
    Failed,
    /// It could not do its work.
    Error,
    /// It was stopped.
    Interrupted,
    /// It is at work.
    Running,
    /// An earlier result was no longer true and was removed.
    Stale,
    /// It has not been run.
    #[serde(rename = "not reached")]
    NotReached,
}

/// What tells whether a file is still the one that was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Length.
    pub bytes: u64,
    /// Last change, nanoseconds since 1970.
    pub modified: u64,
}

impl Identity {
    /// That of a file, if it is there.
    pub fn of(path: &Path) -> Option<Self> {
        let metadata = std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file)?;
        let modified = metadata.modified().ok()?.duration_since(std::time::UNIX_EPOCH).ok()?;
        Some(Self { bytes: metadata.len(), modified: u64::try_from(modified.as_nanos()).ok()? })
    }
}

/// A file that the case depends on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    /// What it is for: `volume`, `data of the volume`, `named in SIZEFIELD_OPTIONS`.
    pub role: String,
    /// Absolute path.
    pub path: PathBuf,
    /// Length; of a folder, that of its files together.
    pub bytes: u64,
    /// BLAKE3 hash of the content; of a folder, of the names and hashes of its files.
    pub hash: String,
    /// Last change, nanoseconds since 1970; 0 of a folder.
    pub modified: u64,
}

/// An error in three parts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// What happened.
    pub what: String,
    /// Why it matters.
    pub why: String,
    /// What to do next.
    pub next: String,
}

/// One stage of a case.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// Name of the stage.
    pub stage: String,
    /// How it stands.
    pub state: State,
    /// Whether the last run made it, or only confirmed what an earlier one had made.
    pub made: bool,
    /// Exit code; none where it was ended by a signal or never ran.
    pub exit_code: Option<i32>,
    /// How long it took.
    pub seconds: Option<f64>,
    /// The command, as it could be typed.
    pub command: Option<String>,
    /// Its report, if there is one. Names of files are relative to the folder of the case.
    pub report: Option<String>,
    /// The files that it made.
    pub outputs: Vec<String>,
    /// What a failed stage left, to be looked at; nothing goes on with it.
    pub kept: Vec<String>,
    /// Its warnings.
    pub warnings: Vec<String>,
    /// The checks that failed.
    pub failed_checks: Vec<String>,
    /// The error that ended it.
    pub error: Option<Problem>,
    /// Hash of everything that the result depends on: it runs again when this changes.
    pub key: String,
    /// What tells whether the files are still those that it made, by name.
    pub identities: BTreeMap<String, Identity>,
}

impl Stage {
    /// A stage that has made nothing.
    pub fn nothing(stage: &str, state: State) -> Self {
        Self {
            stage: stage.to_owned(),
            state,
            made: false,
            exit_code: None,
            seconds: None,
            command: None,
            report: None,
            outputs: Vec::new(),
            kept: Vec::new(),
            warnings: Vec::new(),
            failed_checks: Vec::new(),
            error: None,
            key: String::new(),
            identities: BTreeMap::new(),
        }
    }
}

/// The whole file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// Name of the case.
    pub name: String,
    /// How far the last run was to go.
    pub goal: String,
    /// How the case stands.
    pub verdict: Verdict,
    /// The same in one sentence.
    pub headline: String,
    /// The files that the case depends on.
    pub inputs: Vec<Input>,
    /// What the user and the case file set.
    pub parameters: BTreeMap<String, String>,
    /// The stages in order; `phantom` first where the volume is made.
    pub stages: Vec<Stage>,
    /// The page about the case, if it was made.
    pub page: Option<String>,
    /// Hash of everything that the page depends on.
    pub page_key: String,
}

impl Status {
    /// Reads a status; `None` when there is none, or none that this version understands.
    pub fn read(path: &Path) -> Option<Self> {
        let status: Self = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
        (status.format == FORMAT && status.version == VERSION).then_some(status)
    }

    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(|error| {
            Error::input(
                format!("{}: {error}", path.display()),
                "the status cannot be put into JSON",
                "report this bug",
            )
        })?;
        write_atomically(path, |file| writeln!(file, "{text}"))
    }

    /// A stage by its name.
    pub fn stage(&self, name: &str) -> Option<&Stage> {
        self.stages.iter().find(|stage| stage.stage == name)
    }

    /// The volume's own entry; none of a phantom that was not made.
    pub fn volume(&self) -> Option<&Input> {
        self.inputs.iter().find(|input| input.role == crate::inputs::VOLUME)
    }
}
