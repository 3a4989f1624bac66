//! Reads and writes `NAME.status.json`, which records the state of a case. The page of the case and
//! the index are generated from this file (docs/developer/formats.md).

use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::output::write_atomically;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Value of the `format` field.
pub const FORMAT: &str = "isoparticles-status";
/// Version of the layout.
pub const VERSION: u32 = 1;
/// Role of the volume itself among the inputs.
pub const VOLUME: &str = "volume";

/// State of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// All requested results exist, and every check passed.
    Passed,
    /// All requested results exist and every check passed, but there are warnings.
    Warning,
    /// A check failed.
    Failed,
    /// A stage stopped with an error.
    Error,
    /// The run was stopped before it finished.
    Interrupted,
    /// A run is in progress or was killed; [`crate::folder::CaseFolder::settle`] corrects the
    /// status of a killed run.
    Running,
}

/// State of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// The output exists, and all checks passed.
    Done,
    /// The output was made, but a check failed.
    Failed,
    /// The stage stopped with an error.
    Error,
    /// The stage was stopped.
    Interrupted,
    /// The stage is running.
    Running,
    /// An earlier result was out of date and was removed.
    Stale,
    /// The stage has not been run.
    #[serde(rename = "not reached")]
    NotReached,
}

/// Size and modification time of a file, used to detect changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Length in bytes.
    pub bytes: u64,
    /// Time of the last modification in nanoseconds since 1970.
    pub modified: u64,
}

impl Identity {
    /// Returns the identity of a file, or `None` if there is no such file.
    pub fn of(path: &Path) -> Option<Self> {
        let metadata = std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file)?;
        let modified = metadata.modified().ok()?.duration_since(std::time::UNIX_EPOCH).ok()?;
        Some(Self { bytes: metadata.len(), modified: u64::try_from(modified.as_nanos()).ok()? })
    }
}

/// A file that the case depends on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    /// Role, such as `volume`, `data of the volume` or `named in SIZEFIELD_OPTIONS`.
    pub role: String,
    /// Absolute path.
    pub path: PathBuf,
    /// Length in bytes; for a folder, the sum over its files.
    pub bytes: u64,
    /// BLAKE3 hash of the content; for a folder, of the names and hashes of its files.
    pub hash: String,
    /// Time of the last modification in nanoseconds since 1970; 0 for a folder.
    pub modified: u64,
}

/// An error message in three parts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// The problem.
    pub what: String,
    /// Why the problem matters.
    pub why: String,
    /// Instructions for the user.
    pub next: String,
}

impl Problem {
    /// Returns the last three-part error in the output of a program.
    pub(crate) fn last_in(text: &str) -> Option<Self> {
        let lines: Vec<&str> = text.lines().collect();
        let at = lines.iter().rposition(|line| line.starts_with("error: "))?;
        let part = |start: &str| {
            lines[at..].iter().find_map(|line| line.trim_start().strip_prefix(start)).unwrap_or_default().to_owned()
        };
        Some(Self { what: part("error: "), why: part("why it matters: "), next: part("what to do: ") })
    }
}

/// One stage of a case.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// Name of the stage.
    pub stage: String,
    /// State of the stage.
    pub state: State,
    /// True if the last run made the result, and false if it only confirmed an earlier result.
    pub made: bool,
    /// Exit code; `None` if a signal ended the program or the stage never ran.
    pub exit_code: Option<i32>,
    /// Duration in seconds.
    pub seconds: Option<f64>,
    /// The command line, quoted for a shell.
    pub command: Option<String>,
    /// Name of the report, if there is one. This path and the other file names in this struct are
    /// relative to the folder of the case.
    pub report: Option<String>,
    /// Files that the stage made.
    pub outputs: Vec<String>,
    /// Files of a failed stage that are kept for inspection. No later stage reads them.
    pub kept: Vec<String>,
    /// Warnings of the stage.
    pub warnings: Vec<String>,
    /// The checks that failed.
    pub failed_checks: Vec<String>,
    /// The error that ended the stage.
    pub error: Option<Problem>,
    /// Hash of everything that the result depends on. The stage runs again if the hash changes.
    pub key: String,
    /// Sizes and modification times of the outputs, by file name, to detect changes.
    pub identities: BTreeMap<String, Identity>,
}

impl Stage {
    /// Returns a stage without results.
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

/// Content of the status file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Always [`FORMAT`].
    pub format: String,
    /// Always [`VERSION`].
    pub version: u32,
    /// Name of the case.
    pub name: String,
    /// Goal of the last run.
    pub goal: String,
    /// State of the case.
    pub verdict: Verdict,
    /// State of the case in one sentence.
    pub headline: String,
    /// The files that the case depends on.
    pub inputs: Vec<Input>,
    /// Settings from the user and the case file.
    pub parameters: BTreeMap<String, String>,
    /// The stages in order; `phantom` or `read` comes first if one of them makes the volume.
    pub stages: Vec<Stage>,
    /// File name of the page of the case, if there is one.
    pub page: Option<String>,
    /// Hash of everything that the page depends on.
    pub page_key: String,
}

impl Status {
    /// Reads a status. Returns `None` if the file cannot be read or its format or version is
    /// unknown.
    pub fn read(path: &Path) -> Option<Self> {
        let status: Self = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
        (status.format == FORMAT && status.version == VERSION).then_some(status)
    }

    /// Writes the file atomically.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(|error| {
            Error::input(
                format!("{}: {error}", path.display()),
                "the status cannot be written as JSON",
                "report this bug",
            )
        })?;
        write_atomically(path, |file| writeln!(file, "{text}"))
    }

    /// Returns the stage called `name`, if there is one.
    pub fn stage(&self, name: &str) -> Option<&Stage> {
        self.stages.iter().find(|stage| stage.stage == name)
    }

    /// Returns the input entry of the volume itself, or `None` for a phantom that has not been
    /// generated yet.
    pub fn volume(&self) -> Option<&Input> {
        self.inputs.iter().find(|input| input.role == VOLUME)
    }
}
