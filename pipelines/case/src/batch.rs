//! Runs many cases from a list: a CSV file with one column per key and one row per case.
//!
//! Each row runs in a separate process of this program, so a crash does not affect other rows. Each
//! process writes its own log. If a row fails, the error is reported and the next row starts. Valid
//! results of earlier runs are kept, so a stopped batch resumes where it left off. The outputs are
//! `OUT/batch.csv`, which has one line per row, and an index of all cases.

use crate::check::Answers;
use crate::command::{Programs, Volume};
use crate::folder::CaseFolder;
use crate::keys::{self, KEYS};
use crate::program::{self, Ended};
use crate::run::{Case, out, problem, stage_of_goal};
use crate::settings::Settings;
use crate::status::{FORMAT, Problem, Stage, State, Status, VERSION, Verdict};
use crate::{index, verdict};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::output::write_atomically;
use isoparticles_volume::Crop;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Folder in OUT that contains the logs of the rows. [`crate::name::check`] rejects this name, so
/// no case can have it.
pub(crate) const LOGS: &str = ".batch";

/// First character of comment lines.
const COMMENT: char = '#';

/// Keys that cannot be columns, because they apply to the whole batch.
const BATCH_KEYS: [&str; 3] = ["CASE", "OUT", "VERBOSITY"];

/// A list of cases, and how to run it.
#[derive(Debug)]
pub struct Batch<'a> {
    /// Path of the CSV file.
    pub list: &'a Path,
    /// `KEY=VALUE` settings for all rows. The cells of a row take precedence.
    pub common: &'a [String],
    /// Other variable names of the caller. The message about a misspelled key may suggest one of
    /// them.
    pub known: &'a [String],
    /// Goal of each case, such as `mesh` or `surface`.
    pub goal: &'a str,
    /// Time limit of each case. A case that exceeds it is interrupted, and the next batch resumes
    /// the case.
    pub limit: Option<Duration>,
}

/// Parses a time limit.
///
/// # Errors
/// If `text` is not a duration with a unit.
pub fn time_limit(text: &str) -> Result<Duration> {
    humantime::parse_duration(text).map_err(|error| {
        Error::input(
            format!("TIME_LIMIT={text}: {error}"),
            "TIME_LIMIT is the time after which a case is stopped",
            "write a number with a unit, such as 90s, 30m or 2h",
        )
    })
}

/// A row of the list.
#[derive(Debug)]
pub(crate) struct Row {
    /// Line number in the file, starting at 1.
    pub line: u64,
    /// `KEY=VALUE` setting of each non-empty cell.
    pub cells: Vec<String>,
    /// Name of the results, or `line N` if the name is unknown.
    pub name: String,
    /// The case, or the error that prevents it from starting.
    pub case: Result<Case>,
}

impl Row {
    /// Returns the path of the volume, or `None` if the row is invalid or its volume is a phantom.
    pub(crate) fn input(&self) -> Option<&Path> {
        match &self.case {
            Ok(Case { volume: Volume::At(path), .. }) => Some(path),
            _ => None,
        }
    }
}

/// Outcome of a row.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Ending {
    /// Name of the case.
    pub name: String,
    /// Line number in the list, starting at 1.
    pub line: u64,
    /// `passed`, `warning`, `failed`, `error`, `interrupted`, or `out of time`.
    pub verdict: String,
    /// Exit code of the run; `None` if nothing ran or a signal ended the run.
    pub exit_code: Option<i32>,
    /// Duration in seconds.
    pub seconds: f64,
    /// The outcome in one sentence.
    pub headline: String,
    /// Instructions for the user; empty if there is nothing to do.
    pub next: String,
    /// Path of the volume.
    pub input: String,
    /// Log file with the output of the row's programs; empty if nothing ran.
    pub log: String,
}

impl Ending {
    /// Returns the outcome of a row for which no program has run yet.
    pub(crate) fn of_nothing(row: &Row) -> Self {
        Self {
            name: row.name.clone(),
            line: row.line,
            verdict: word(Verdict::Error),
            exit_code: None,
            seconds: 0.0,
            headline: String::new(),
            next: String::new(),
            input: row.input().map_or_else(String::new, |path| path.display().to_string()),
            log: String::new(),
        }
    }

    /// Returns whether the run completed and every check passed.
    #[must_use]
    pub fn is_fit(&self) -> bool {
        ["passed", "warning"].contains(&self.verdict.as_str())
    }
}

impl Batch<'_> {
    /// Runs every row of the list and updates `OUT/batch.csv` after each row. A failed row does not
    /// stop the others.
    ///
    /// # Errors
    /// If the list is unreadable, a column is not a key, two rows have the same name, or the
    /// summary or a log cannot be written. Errors in the list are reported before any row runs.
    pub fn make(&self, programs: &Programs) -> Result<Vec<Ending>> {
        let settings = Settings::read(&[], self.common, None, self.known)?;
        let out = out(&settings);
        let rows = self.checked(programs)?;
        tell_refused(&rows);
        let logs = out.join(LOGS);
        // Logs of an earlier batch may belong to rows that are no longer in the list.
        let _ = std::fs::remove_dir_all(&logs);
        std::fs::create_dir_all(&logs)
            .map_err(|error| Error::file(&logs, "create", &error, "set OUT to another folder"))?;
        program::listen();
        let mut endings: Vec<Ending> = Vec::with_capacity(rows.len());
        for row in &rows {
            if program::stop_requested() {
                break;
            }
            let ending = self.make_row(row, &out, &logs, programs)?;
            tell(&ending, endings.len() + 1, rows.len());
            endings.push(ending);
            write_summary(&out.join("batch.csv"), &endings)?;
        }
        Ok(endings)
    }

    /// Writes an index of all cases in OUT and of the rows that could not start.
    ///
    /// # Errors
    /// If there are no cases, or the index program fails.
    pub fn index(&self, programs: &Programs) -> Result<PathBuf> {
        let out = out(&Settings::read(&[], self.common, None, self.known)?);
        let refused = std::fs::read_dir(out.join(LOGS)).into_iter().flatten().flatten().map(|entry| entry.path());
        let mut refused: Vec<PathBuf> =
            refused.filter(|path| path.extension().is_some_and(|it| it == "json")).collect();
        refused.sort();
        index::write(&out, refused, programs)
    }

    /// Reads the list, and checks the options of each row by running the stages with
    /// `--check-options`.
    pub(crate) fn checked(&self, programs: &Programs) -> Result<Vec<Row>> {
        let mut rows = self.read()?;
        let goal = stage_of_goal(self.goal).unwrap_or_default();
        let mut answers = Answers::default();
        for row in &mut rows {
            if let Ok(case) = &row.case
                && let Err(error) = answers.check(case, goal, programs)
            {
                row.case = Err(error);
            }
        }
        Ok(rows)
    }

    /// Parses the list.
    pub(crate) fn read(&self) -> Result<Vec<Row>> {
        let bad = |what: String, next: &str| {
            Error::input(format!("{}: {what}", self.list.display()), "LIST defines the cases to make", next)
        };
        let text = std::fs::read_to_string(self.list)
            .map_err(|error| Error::file(self.list, "read", &error, "set LIST to a CSV file"))?;
        let text = with_plain_lines(&text);
        let header =
            text.lines().find(|line| !line.trim().is_empty() && !line.starts_with(COMMENT)).unwrap_or_default();
        // In many locales, spreadsheet programs separate columns with semicolons.
        let delimiter = [',', ';', '\t'].into_iter().find(|mark| header.contains(*mark)).unwrap_or(',');
        let mut reader = csv::ReaderBuilder::new()
            .delimiter(delimiter as u8)
            .trim(csv::Trim::All)
            .comment(Some(COMMENT as u8))
            .flexible(true)
            .from_reader(text.as_bytes());
        let check = "write a header with names such as INPUT,LABELS,SIZE, and the same number of cells in every row";
        let columns: Vec<String> =
            reader.headers().map_err(|error| bad(error.to_string(), check))?.iter().map(str::to_owned).collect();
        for (position, column) in columns.iter().enumerate() {
            let set_by = format!("a column of {}", self.list.display());
            let key = keys::find(column, self.known, &set_by)?;
            if BATCH_KEYS.contains(&key.name) {
                let what = format!("{column} cannot be a column; it applies to all rows");
                return Err(bad(what, &format!("remove the column, and set {column}=... together with LIST")));
            }
            if columns[..position].contains(column) {
                return Err(bad(format!("two columns are named {column}"), "remove one of them"));
            }
        }
        let mut rows: Vec<Row> = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| bad(error.to_string(), check))?;
            if record.iter().all(str::is_empty) {
                continue;
            }
            let line = line_of(&text, record.position().map_or(0, |at| at.byte() as usize));
            if record.len() != columns.len() {
                let what = format!("a row has {} cells, the header {} (line: {line})", record.len(), columns.len());
                return Err(bad(what, check));
            }
            rows.push(self.row(line, columns.iter().map(String::as_str).zip(&record)));
        }
        if rows.is_empty() {
            return Err(bad("has no rows".to_owned(), check));
        }
        let mut lines = BTreeMap::new();
        for row in &rows {
            if let Some(first) = lines.insert(&row.name, row.line) {
                let what = format!("lines {first} and {} have the same name, {}", row.line, row.name);
                return Err(bad(what, "add a column NAME with different names, so that no results are replaced"));
            }
        }
        Ok(rows)
    }

    fn row<'a>(&self, line: u64, cells: impl Iterator<Item = (&'a str, &'a str)>) -> Row {
        // Volumes are relative to the folder of the list, so a list and its volumes can be moved
        // together.
        let is_mask = |value: &str| value.parse().is_ok_and(|crop: Crop| crop.mask().is_some());
        let cell = |(column, value): (&str, &str)| match column {
            "CROP" if !is_mask(value) => format!("CROP={value}"),
            "INPUT" | "CROP" => {
                format!("{column}={}", self.list.parent().unwrap_or(Path::new("")).join(value).display())
            }
            _ => format!("{column}={value}"),
        };
        let cells: Vec<String> = cells.filter(|(_, value)| !value.is_empty()).map(cell).collect();
        let settings = Settings::read_row(&cells, line, self.common, self.known);
        // A valid NAME of the row is used even if another cell is invalid.
        let named = cells.iter().find_map(|cell| cell.strip_prefix("NAME="));
        let named = named.filter(|name| crate::name::check(name).is_ok()).map(str::to_owned);
        let unnamed = || named.unwrap_or_else(|| format!("line {line}"));
        match settings.and_then(Case::new) {
            Ok(case) => Row { line, cells, name: case.folder.name.clone(), case: Ok(case) },
            Err(error) => Row { line, cells, name: unnamed(), case: Err(error) },
        }
    }

    fn make_row(&self, row: &Row, out: &Path, logs: &Path, programs: &Programs) -> Result<Ending> {
        let started = Instant::now();
        let log = logs.join(format!("{}.log", row.name));
        let folder = CaseFolder::new(out, &row.name);
        let mut ending = Ending::of_nothing(row);
        let refused = match &row.case {
            Err(error) => Some(problem(error)),
            Ok(_) => {
                let before = std::fs::read(folder.status_path()).ok();
                let file = std::fs::File::create(&log)
                    .map_err(|error| Error::file(&log, "write", &error, "set OUT to another folder"))?;
                let this = std::env::current_exe().map_err(|error| {
                    Error::input(format!("{error}"), "each case runs this program", "start it with its full path")
                })?;
                ending.log = log.display().to_string();
                let (ended, out_of_time) =
                    program::run_logged(&this, &self.arguments(self.goal, row, programs), file, self.limit)?;
                ending.seconds = started.elapsed().as_secs_f64();
                let code = match ended {
                    Ended::Code(code) => Some(code),
                    Ended::Signal(_) => None,
                };
                ending.exit_code = code;
                // A killed run cannot record that it was killed.
                folder.settle()?;
                let after = std::fs::read(folder.status_path()).ok();
                let status = Status::read(&folder.status_path());
                match status {
                    Some(status) if code == Some(0) || after != before => {
                        ending.verdict = word(status.verdict);
                        ending.headline = status.headline.clone();
                        let errors = status.stages.iter().filter_map(|stage| stage.error.as_ref());
                        ending.next = errors.map(|error| error.next.clone()).next().unwrap_or_default();
                        if out_of_time && verdict::exit_code(&status) == 130 {
                            ending.verdict = "out of time".to_owned();
                        }
                        None
                    }
                    _ => Some(last_error_in(&log)),
                }
            }
        };
        if let Some(error) = refused {
            let seen = Status::read(&folder.status_path()).is_some();
            if !seen {
                refused_status(row, &error).write(&logs.join(format!("{}.status.json", row.name)))?;
            }
            (ending.headline, ending.next) = (error.what, error.next);
        }
        Ok(ending)
    }

    /// Returns the arguments of this program for a run of a row up to `goal`.
    pub(crate) fn arguments(&self, goal: &str, row: &Row, programs: &Programs) -> Vec<OsString> {
        let mut arguments: Vec<OsString> = vec![goal.into()];
        arguments.extend(row.cells.iter().map(OsString::from));
        for setting in self.common {
            arguments.extend(["--preset".into(), setting.into()]);
        }
        for (option, path) in [("--bin", &programs.bin), ("--tetmesh-check", &programs.tetmesh_check)] {
            arguments.extend([option.into(), path.into()]);
        }
        for (option, files) in [("--tetmesh-files", &programs.tetmesh_files), ("--page-files", &programs.page_files)] {
            if !files.is_empty() {
                arguments.push(option.into());
                arguments.extend(files.iter().map(OsString::from));
            }
        }
        arguments
    }
}

/// Returns `text` with LF line endings and without a byte order mark.
fn with_plain_lines(text: &str) -> String {
    text.trim_start_matches('\u{feff}').replace("\r\n", "\n").replace('\r', "\n")
}

/// Returns the line number, starting at 1, of the record that the CSV reader reports at `byte`. The
/// reader skips empty lines and comments, so the record may start after `byte`.
fn line_of(text: &str, byte: usize) -> u64 {
    let lines = text[byte..].split('\n');
    let skipped = lines.take_while(|line| line.is_empty() || line.starts_with(COMMENT)).count();
    (1 + text[..byte].matches('\n').count() + skipped) as u64
}

/// Returns the keys that may be columns of a list.
pub fn columns() -> impl Iterator<Item = &'static str> {
    KEYS.iter().map(|key| key.name).filter(|name| !BATCH_KEYS.contains(name))
}

/// Returns the exit code of a batch: 0 if every row passed all its checks, 1 if any row did not,
/// and 130 after an interrupt.
#[must_use]
pub fn exit_code(endings: &[Ending]) -> u8 {
    if program::stop_requested() {
        return 130;
    }
    u8::from(!endings.iter().all(Ending::is_fit))
}

/// Returns the closing summary for the terminal.
#[must_use]
pub fn closing(endings: &[Ending]) -> String {
    let fit = endings.iter().filter(|ending| ending.is_fit()).count();
    let mut text = format!("\n{fit} of {} cases are fit\n", endings.len());
    for ending in endings.iter().filter(|ending| !ending.is_fit()) {
        text += &format!("  line {:<4} {}: {}: {}\n", ending.line, ending.name, ending.verdict, ending.headline);
        if !ending.next.is_empty() {
            text += &format!("            what to do: {}\n", ending.next);
        }
        if !ending.log.is_empty() {
            text += &format!("            log: {}\n", ending.log);
        }
    }
    text
}

/// Prints the errors of the rows that cannot start. Called before any row runs.
pub(crate) fn tell_refused(rows: &[Row]) {
    for row in rows {
        if let Err(error) = &row.case {
            eprintln!("line {} of the list, {}: error: {error}", row.line, row.name);
        }
    }
}

fn tell(ending: &Ending, position: usize, total: usize) {
    println!("[{position}/{total}] {:<24} {:<12} {:>7.1} s", ending.name, ending.verdict, ending.seconds);
}

/// Returns a verdict as it is spelled in the status file.
pub(crate) fn word(verdict: Verdict) -> String {
    let value = serde_json::to_value(verdict).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}

/// Returns the status of a row that could not start. The index lists this status.
pub(crate) fn refused_status(row: &Row, error: &Problem) -> Status {
    let stage = Stage { error: Some(error.clone()), ..Stage::nothing("distfield", State::Error) };
    Status {
        format: FORMAT.to_owned(),
        version: VERSION,
        name: row.name.clone(),
        goal: "mesh".to_owned(),
        verdict: Verdict::Error,
        headline: error.what.clone(),
        inputs: Vec::new(),
        parameters: row
            .cells
            .iter()
            .filter_map(|cell| cell.split_once('='))
            .map(|(k, v)| (k.into(), v.into()))
            .collect(),
        stages: vec![stage],
        page: None,
        page_key: String::new(),
    }
}

/// Returns the last three-part error in a log file.
pub(crate) fn last_error_in(log: &Path) -> Problem {
    Problem::last_in(&std::fs::read_to_string(log).unwrap_or_default()).unwrap_or_else(|| Problem {
        what: "ended without an error message".to_owned(),
        why: "the case has no result".to_owned(),
        next: format!("read {}", log.display()),
    })
}

/// Writes the summary with one CSV line per row.
pub(crate) fn write_summary(path: &Path, endings: &[Ending]) -> Result<()> {
    write_atomically(path, |file| {
        let mut writer = csv::Writer::from_writer(file);
        endings.iter().try_for_each(|ending| writer.serialize(ending)).map_err(std::io::Error::other)?;
        writer.flush()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the line number and the name of each row of a list, or the error in the list.
    fn lines(list: &str) -> Result<Vec<(u64, String)>> {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("cases.csv");
        std::fs::write(&path, list).expect("written");
        let batch = Batch { list: &path, common: &[], known: &[], goal: "mesh", limit: None };
        Ok(batch.read()?.into_iter().map(|row| (row.line, row.name)).collect())
    }

    #[test]
    fn rows_have_the_lines_that_an_editor_shows() {
        let list =
            "# a comment\n\nNAME,INPUT,ISO\na,v.nrrd,1\n\n# \"another\n\n\"b\nb\",v.nrrd,2\n , ,\n\"c\",v.nrrd,3\n";
        // a name with a line break is not valid
        let expected = [(4, "a"), (8, "line 8"), (11, "c")].map(|(line, name)| (line, name.to_owned()));
        for end in ["\n", "\r\n", "\r"] {
            for mark in ["", "\u{feff}"] {
                let list = format!("{mark}{}", list.replace('\n', end));
                assert_eq!(lines(&list).expect("a list"), expected, "{list:?}");
            }
        }
        let error = lines("NAME,INPUT\r\n\r\n# one\r\na,v.nrrd,1\r\n").expect_err("a cell too many");
        assert!(error.what.contains("3 cells") && error.what.contains("line: 4"), "{error}");
    }

    #[test]
    fn names_with_paths_are_not_used_for_files() {
        let found = lines("NAME,INPUT\n../x,v.nrrd\ny,v.nrrd\n").expect("a list");
        assert_eq!(found, [(2, "line 2".to_owned()), (3, "y".to_owned())]);
    }
}
