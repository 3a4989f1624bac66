//! Many cases from a list: a CSV file with a column a key and a row a case.
//!
//! Each row is made by a run of this program of its own, so that none can harm another, with a log of its own. A row that
//! cannot be made is told and the next one begun. What a row made before holds, as for any case: a batch that was stopped goes
//! on where it was. The end is `OUT/batch.csv` with a line a row, and the index over all of them.

use crate::check::Answers;
use crate::folder::CaseFolder;
use crate::keys::{self, KEYS};
use crate::program::{self, Ended};
use crate::run::{Case, out, problem, stage_of_goal};
use crate::settings::Settings;
use crate::stages::{Programs, Volume};
use crate::status::{FORMAT, Problem, Stage, State, Status, VERSION, Verdict};
use crate::{index, verdict};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::output::write_atomically;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Folder within OUT for the logs of the rows; no case can have its name ([`crate::name::check`]).
pub(crate) const LOGS: &str = ".batch";

/// What a line begins with that is no row.
const COMMENT: char = '#';

/// Keys that hold for the whole batch, and so cannot be columns.
const FOR_ALL: [&str; 3] = ["CASE", "OUT", "VERBOSITY"];

/// What to make of a list.
#[derive(Debug)]
pub struct Batch<'a> {
    /// The list.
    pub list: &'a Path,
    /// `KEY=VALUE` for all rows; a row's own cells come before it.
    pub common: &'a [String],
    /// Names that the caller knows besides the keys.
    pub known: &'a [String],
    /// How far each case goes: a goal of this program.
    pub goal: &'a str,
    /// How long a case may take; after it the case is stopped as by an interrupt, and goes on from there the next time.
    pub limit: Option<Duration>,
}

/// Reads how long a case may take.
///
/// # Errors
/// When it is no time with a unit.
pub fn time_limit(text: &str) -> Result<Duration> {
    humantime::parse_duration(text).map_err(|error| {
        Error::input(
            format!("TIME_LIMIT={text}: {error}"),
            "it is how long a case may take before it is stopped",
            "write a number with a unit, such as 90s, 30m or 2h",
        )
    })
}

/// A row of the list.
#[derive(Debug)]
pub(crate) struct Row {
    /// Its line in the file, from 1.
    pub line: u64,
    /// `KEY=VALUE` of the cells that are not empty.
    pub cells: Vec<String>,
    /// The name of its results; the line where it has none.
    pub name: String,
    /// The case, or why it cannot be made, where that is known before any work.
    pub case: Result<Case>,
}

impl Row {
    /// The volume, as far as it is known.
    pub(crate) fn input(&self) -> Option<&Path> {
        match &self.case {
            Ok(Case { volume: Volume::At(path), .. }) => Some(path),
            _ => None,
        }
    }
}

/// How a row ended.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Ending {
    /// Name of the case.
    pub name: String,
    /// Line in the list, from 1.
    pub line: u64,
    /// `passed`, `warning`, `failed`, `error`, `interrupted`, or `out of time`.
    pub verdict: String,
    /// Exit code of its run; none where there was no run, or a signal ended it.
    pub exit_code: Option<i32>,
    /// How long it took, in seconds.
    pub seconds: f64,
    /// What came out, in a sentence.
    pub headline: String,
    /// What to do, where something is to be done.
    pub next: String,
    /// The volume.
    pub input: String,
    /// File with what its programs said; empty where none was run.
    pub log: String,
}

impl Ending {
    /// That of a row of which nothing has been made.
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

    /// Whether the case is made and every check passed.
    #[must_use]
    pub fn is_fit(&self) -> bool {
        ["passed", "warning"].contains(&self.verdict.as_str())
    }
}

impl Batch<'_> {
    /// Makes every row of the list, then the summary and the index. A row that fails stops nothing.
    ///
    /// # Errors
    /// When the list as a whole cannot be meant: it cannot be read, a column is no key, two rows have one name. Nothing has been
    /// begun then. When the summary cannot be written.
    pub fn make(&self, programs: &Programs) -> Result<Vec<Ending>> {
        let settings = Settings::read(&[], self.common, None, self.known)?;
        let out = out(&settings);
        let rows = self.checked(programs)?;
        tell_refused(&rows);
        let logs = out.join(LOGS);
        // What an earlier batch left of rows that are perhaps no more.
        let _ = std::fs::remove_dir_all(&logs);
        std::fs::create_dir_all(&logs)
            .map_err(|error| Error::file(&logs, "make", &error, "choose another folder for the results (OUT=...)"))?;
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

    /// Writes the index over all cases in OUT and the rows that could not be begun.
    ///
    /// # Errors
    /// When there are none, or the program that writes it fails.
    pub fn index(&self, programs: &Programs) -> Result<PathBuf> {
        let out = out(&Settings::read(&[], self.common, None, self.known)?);
        let refused = std::fs::read_dir(out.join(LOGS)).into_iter().flatten().flatten().map(|entry| entry.path());
        let mut refused: Vec<PathBuf> =
            refused.filter(|path| path.extension().is_some_and(|it| it == "json")).collect();
        refused.sort();
        index::write(&out, refused, programs)
    }

    /// The rows of the list, each asked whether the stages take its options.
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

    /// The rows of the list.
    pub(crate) fn read(&self) -> Result<Vec<Row>> {
        let bad = |what: String, next: &str| {
            Error::input(format!("{}: {what}", self.list.display()), "it says which cases to make", next)
        };
        let text = std::fs::read_to_string(self.list)
            .map_err(|error| Error::file(self.list, "read", &error, "check LIST; it is a CSV file"))?;
        let text = with_plain_lines(&text);
        let header =
            text.lines().find(|line| !line.trim().is_empty() && !line.starts_with(COMMENT)).unwrap_or_default();
        // Spreadsheets of many countries part columns by semicolons.
        let delimiter = [',', ';', '\t'].into_iter().find(|mark| header.contains(*mark)).unwrap_or(',');
        let mut reader = csv::ReaderBuilder::new()
            .delimiter(delimiter as u8)
            .trim(csv::Trim::All)
            .comment(Some(COMMENT as u8))
            .flexible(true)
            .from_reader(text.as_bytes());
        let check = "write a header with names such as INPUT,LABELS,SIZE and as many cells in every row";
        let columns: Vec<String> =
            reader.headers().map_err(|error| bad(error.to_string(), check))?.iter().map(str::to_owned).collect();
        for (position, column) in columns.iter().enumerate() {
            let set_by = format!("a column of {}", self.list.display());
            let key = keys::find(column, self.known, &set_by)?;
            if FOR_ALL.contains(&key.name) {
                let what = format!("{column} is a column, and holds for all rows or none");
                return Err(bad(what, &format!("leave the column out, and say {column}=... beside LIST")));
            }
            if columns[..position].contains(column) {
                return Err(bad(format!("two columns are called {column}"), "leave one of them out"));
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
                let what = format!("the cases of line {first} and {} are both called {}", row.line, row.name);
                return Err(bad(what, "one would replace the other: give each a name of its own in a column NAME"));
            }
        }
        Ok(rows)
    }

    fn row<'a>(&self, line: u64, cells: impl Iterator<Item = (&'a str, &'a str)>) -> Row {
        let cell = |(column, value): (&str, &str)| match column {
            // From the list's own folder, so that a list and its volumes can be moved together.
            "INPUT" => format!("INPUT={}", self.list.parent().unwrap_or(Path::new("")).join(value).display()),
            _ => format!("{column}={value}"),
        };
        let cells: Vec<String> = cells.filter(|(_, value)| !value.is_empty()).map(cell).collect();
        let settings = Settings::read_row(&cells, line, self.common, self.known);
        // Known also where another cell is wrong.
        let named = cells.iter().find_map(|cell| cell.strip_prefix("NAME=")).map(str::to_owned);
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
                let file = std::fs::File::create(&log).map_err(|error| {
                    Error::file(&log, "write", &error, "choose another folder for the results (OUT=...)")
                })?;
                let this = std::env::current_exe().map_err(|error| {
                    Error::input(format!("{error}"), "each case is a run of this program", "call it by its path")
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
                // A run that was killed could not say so itself.
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

    /// What this program is told for a goal over a row.
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

/// The text with LF at the end of each line and no byte order mark.
fn with_plain_lines(text: &str) -> String {
    text.trim_start_matches('\u{feff}').replace("\r\n", "\n").replace('\r', "\n")
}

/// The line, from 1, of the record that the reader finds from `byte` on; the reader skips empty
/// lines and comments.
fn line_of(text: &str, byte: usize) -> u64 {
    let lines = text[byte..].split('\n');
    let skipped = lines.take_while(|line| line.is_empty() || line.starts_with(COMMENT)).count();
    (1 + text[..byte].matches('\n').count() + skipped) as u64
}

/// Columns that a list may have.
pub fn columns() -> impl Iterator<Item = &'static str> {
    KEYS.iter().map(|key| key.name).filter(|name| !FOR_ALL.contains(name))
}

/// Exit code of a batch over so many rows.
#[must_use]
pub fn exit_code(endings: &[Ending]) -> u8 {
    if program::stop_requested() {
        return 130;
    }
    u8::from(!endings.iter().all(Ending::is_fit))
}

/// The last lines on the terminal.
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

/// Tells which rows cannot be made, before any is begun.
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

/// A verdict as the status file says it.
pub(crate) fn word(verdict: Verdict) -> String {
    let value = serde_json::to_value(verdict).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}

/// The status of a row that could not be begun, for the index.
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

/// The last error in three parts that a log holds.
pub(crate) fn last_error_in(log: &Path) -> Problem {
    last_error(&std::fs::read_to_string(log).unwrap_or_default()).unwrap_or_else(|| Problem {
        what: "ended without a word of why".to_owned(),
        why: "nothing was made".to_owned(),
        next: format!("read {}", log.display()),
    })
}

/// The last error in three parts of what a program said.
pub(crate) fn last_error(text: &str) -> Option<Problem> {
    let lines: Vec<&str> = text.lines().collect();
    let at = lines.iter().rposition(|line| line.starts_with("error: "))?;
    let part = |start: &str| {
        lines[at..].iter().find_map(|line| line.trim_start().strip_prefix(start)).unwrap_or_default().to_owned()
    };
    Some(Problem { what: part("error: "), why: part("why it matters: "), next: part("what to do: ") })
}

/// Writes a line a row.
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

    /// Line and name of each row of a list, or the error.
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
        let expected = [(4, "a"), (8, "b\nb"), (11, "c")].map(|(line, name)| (line, name.to_owned()));
        for end in ["\n", "\r\n", "\r"] {
            for mark in ["", "\u{feff}"] {
                let list = format!("{mark}{}", list.replace('\n', end));
                assert_eq!(lines(&list).expect("a list"), expected, "{list:?}");
            }
        }
        let error = lines("NAME,INPUT\r\n\r\n# one\r\na,v.nrrd,1\r\n").expect_err("a cell too many");
        assert!(error.what.contains("3 cells") && error.what.contains("line: 4"), "{error}");
    }
}
