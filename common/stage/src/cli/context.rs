//! The context of a running stage, which collects the data for its history and report.

use super::command_line::canonical_command_line;
use super::report::{self, Report};
use super::{CommonArgs, Listener, Outcome, Progress, ProgressMode, ProgressState, StageArgs, interrupt};
use crate::error::{Error, Result};
use crate::output::check_output;
use indicatif::MultiProgress;
use isoparticles_file::history::{History, Input};
use isoparticles_file::monitor::Monitor;
use rayon::prelude::*;
use serde_json::Value;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Version of all stages, which are released together.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The context of one run: prints messages and progress, times steps, and creates the history and
/// the report.
pub struct Context {
    /// Name of the stage.
    pub tool: &'static str,
    /// The shared options.
    pub common: CommonArgs,
    command_line: String,
    /// Number of threads; `None` for the size of the current thread pool.
    threads: Option<usize>,
    started: Instant,
    bars: MultiProgress,
    listener: Option<Arc<Listener>>,
    state: Mutex<State>,
}

/// Data collected during a run, for the history, the report and the closing table.
#[derive(Default)]
struct State {
    outputs: Vec<PathBuf>,
    parameters: serde_json::Map<String, Value>,
    inputs: Vec<Input>,
    steps: Vec<(String, f64)>,
    warnings: Vec<String>,
    results: serde_json::Map<String, Value>,
    closing: Vec<(String, String)>,
    /// Peak memory of the processes that the run started, in bytes.
    peak_of_children: Option<u64>,
}

/// Guard that times a step. The step ends when the guard is dropped.
#[must_use = "the step ends when this is dropped"]
pub struct Step<'a> {
    context: &'a Context,
    name: String,
    started: Instant,
}

impl Context {
    /// Creates a context for one run. `parameters` should be a JSON object.
    pub fn new(tool: &'static str, command_line: String, common: CommonArgs, parameters: Value) -> Self {
        let mut map = match parameters {
            Value::Object(map) => map,
            Value::Null => serde_json::Map::new(),
            other => std::iter::once(("value".to_owned(), other)).collect(),
        };
        map.entry("seed").or_insert_with(|| common.seed.into());
        let state = State { parameters: map, ..State::default() };
        Self {
            tool,
            common,
            command_line,
            threads: None,
            started: Instant::now(),
            bars: MultiProgress::new(),
            listener: None,
            state: Mutex::new(state),
        }
    }

    /// Creates the context of a program that parses its command line itself, such as one in Python.
    /// `words` are its arguments, `output` is its main output, and `silent` names options with a
    /// value that the history omits.
    ///
    /// # Errors
    /// If the report must not be written to its path.
    pub fn for_program(
        tool: &'static str,
        words: Vec<String>,
        output: PathBuf,
        silent: &[&str],
        common: CommonArgs,
    ) -> Result<Self> {
        let outputs = [output];
        super::check_report(common.report.as_deref(), &outputs)?;
        let command_line = canonical_command_line(tool, words.into_iter(), &outputs, silent);
        let threads = match common.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        };
        Ok(Self { threads: Some(threads), ..Self::new(tool, command_line, common, Value::Null) })
    }

    /// Creates the context of a stage that runs as a library. It prints nothing. `args` was parsed
    /// from `words`.
    pub fn for_listener(tool: &'static str, args: &impl StageArgs, words: &[String], listener: Arc<Listener>) -> Self {
        let command_line = canonical_command_line(tool, words.iter().cloned(), &args.outputs(), &[]);
        let context = Self::new(tool, command_line, args.common().clone(), args.parameters());
        Self { listener: Some(listener), ..context }
    }

    /// Creates a context that prints nothing, for tests.
    pub fn silent(tool: &'static str) -> Self {
        let common = CommonArgs { quiet: true, seed: 1, ..CommonArgs::default() };
        Self::new(tool, tool.to_owned(), common, Value::Null)
    }

    /// Returns the seed of the random numbers.
    pub fn seed(&self) -> u64 {
        self.common.seed
    }

    /// Prints a line on stderr unless `--quiet` is set.
    pub fn info(&self, message: impl AsRef<str>) {
        if !self.common.quiet {
            self.print(message.as_ref());
        }
    }

    /// Prints a line on stderr if `--verbose` is set.
    pub fn verbose(&self, message: impl AsRef<str>) {
        if self.common.verbose > 0 {
            self.print(message.as_ref());
        }
    }

    /// Prints a warning on stderr, even with `--quiet`, and adds it to the report.
    pub fn warn(&self, message: impl Into<String>) {
        let message = message.into();
        self.print(&format!("warning: {message}"));
        self.state().warnings.push(message);
    }

    /// Times a step until the returned guard is dropped. The times of steps with the same name are
    /// added up.
    pub fn step(&self, name: impl Into<String>) -> Step<'_> {
        let name = name.into();
        if let Some(listener) = &self.listener {
            let (step, message) = (name.clone(), String::new());
            listener.show(ProgressState { stage: self.tool, step, done: 0, total: None, message });
        }
        Step { context: self, name, started: Instant::now() }
    }

    /// Adds the time of a step that has ended. The times of steps with the same name are added up.
    pub fn add_step(&self, name: &str, seconds: f64) {
        self.verbose(format!("{name}: {seconds:.2} s"));
        let mut state = self.state();
        match state.steps.iter_mut().find(|(known, _)| known == name) {
            Some((_, total)) => *total += seconds,
            None => state.steps.push((name.to_owned(), seconds)),
        }
    }

    /// Shows the progress of a computation, with a percentage if `total` is known.
    pub fn progress(&self, total: Option<u64>, label: &str) -> Progress {
        if let Some(listener) = &self.listener {
            return Progress::told(listener, self.tool, label, total);
        }
        if self.common.quiet {
            return Progress::nothing(label, total);
        }
        let terminal = || std::io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb");
        match self.common.progress {
            ProgressMode::None => Progress::nothing(label, total),
            ProgressMode::Lines => Progress::lines(label, total),
            ProgressMode::Bar => Progress::bar(&self.bars, label, total),
            ProgressMode::Auto if terminal() => Progress::bar(&self.bars, label, total),
            ProgressMode::Auto => Progress::lines(label, total),
        }
    }

    /// Returns whether the user or the listener has interrupted the run.
    pub fn interrupted(&self) -> bool {
        self.listener.as_ref().map_or_else(interrupt::requested, |listener| listener.is_cancelled())
    }

    /// Returns an error (exit code 130) if the user has interrupted the run. Long loops call this
    /// function regularly.
    pub fn check_interrupt(&self) -> Result<()> {
        Ok(Monitor::check(self)?)
    }

    /// Adds a value to the `results` of the report.
    pub fn report(&self, key: impl Into<String>, value: impl Into<Value>) {
        self.state().results.insert(key.into(), value.into());
    }

    /// Adds a value, such as the GPU adapter or the number of particles, to the closing table and
    /// the report.
    pub fn summary(&self, key: impl Into<String>, value: impl ToString) {
        let (key, value) = (key.into(), value.to_string());
        self.state().results.insert(key.clone(), Value::String(value.clone()));
        self.add_row(key, value);
    }

    /// Adds a row to the closing table.
    pub fn add_row(&self, key: String, value: String) {
        self.state().closing.push((key, value));
    }

    /// Sets the peak memory of the processes that the run has started, in bytes.
    pub fn set_peak_of_children(&self, bytes: u64) {
        self.state().peak_of_children = Some(bytes);
    }

    /// Returns the number of threads.
    pub fn threads(&self) -> usize {
        self.threads.unwrap_or_else(rayon::current_num_threads)
    }

    /// Checks files that the run will write, and stores their paths, because none may be an input.
    ///
    /// # Errors
    /// If an output exists and `--force` is not set, if it cannot be written, or if a path is used
    /// twice.
    pub fn check_outputs(&self, outputs: &[PathBuf]) -> Result<()> {
        for (position, path) in outputs.iter().enumerate() {
            if outputs[..position].contains(path) {
                return Err(Error::input(
                    format!("{}: is used for two outputs", path.display()),
                    "the second would replace the first",
                    "use a different name for each output",
                ));
            }
            check_output(path, self.common.force)?;
        }
        self.state().outputs.extend_from_slice(outputs);
        Ok(())
    }

    /// Sets a parameter that is determined during the run. It appears in the history and the
    /// report.
    pub fn set_parameter(&self, key: impl Into<String>, value: impl Into<Value>) {
        self.state().parameters.insert(key.into(), value.into());
    }

    /// Adds an input file and its history to the history and the report of this run. Returns the
    /// hash of the file, or an error if the file cannot be read or is an output of this run.
    pub fn add_input(&self, path: &Path, history: Option<History>) -> Result<String> {
        let [hash] = self.add_inputs([(path, history)])?;
        Ok(hash)
    }

    /// Adds several input files, like [`Context::add_input`]. The files are hashed in parallel and
    /// recorded in the given order.
    pub fn add_inputs<const N: usize>(&self, inputs: [(&Path, Option<History>); N]) -> Result<[String; N]> {
        for (path, _) in &inputs {
            if self.state().outputs.iter().any(|output| super::same_file(output, path)) {
                return Err(Error::input(
                    format!("{}: is both an input and an output", path.display()),
                    "the input would be replaced",
                    "use another name for the output",
                ));
            }
        }
        let hashed = inputs.into_par_iter().map(|(path, history)| Input::of_file(path, history));
        let mut hashes = [const { String::new() }; N];
        for (hash, input) in hashes.iter_mut().zip(hashed.collect::<Vec<_>>()) {
            let input = input?;
            hash.clone_from(&input.blake3);
            self.state().inputs.push(input);
        }
        Ok(hashes)
    }

    /// Adds an input that is not a file: `name` as a file name, the hash that its file would have,
    /// and its history.
    pub fn add_value(&self, name: String, blake3: String, history: Option<History>) {
        self.state().inputs.push(Input { path: name, blake3, history: history.map(Box::new) });
    }

    /// Returns the history for the outputs of this run. Call this function after all parameters and
    /// inputs have been added.
    pub fn history(&self) -> History {
        let state = self.state();
        History {
            tool: self.tool.to_owned(),
            version: VERSION.to_owned(),
            command_line: self.command_line.clone(),
            parameters: Value::Object(state.parameters.clone()),
            inputs: state.inputs.clone(),
        }
    }

    /// Prints the closing table, writes the report and prints the error, if any. If the report
    /// cannot be written, the result of a successful run is replaced by an error.
    pub(super) fn close(&self, result: Result<Outcome>) -> Result<Outcome> {
        self.close_with(result, |path, report| report::write(path, &report))
    }

    /// Ends the run like a stage program. `write` writes the report to its path.
    ///
    /// # Errors
    /// If `result` is an error, or if the report cannot be written.
    pub fn close_with(
        &self,
        result: Result<Outcome>,
        write: impl FnOnce(&Path, Value) -> Result<()>,
    ) -> Result<Outcome> {
        if result.is_ok() {
            self.info(self.closing_table());
        }
        let written = match &self.common.report {
            Some(path) => write(path, self.report_of(&result)),
            None => Ok(()),
        };
        if let Ok(Outcome::ChecksFailed(checks)) = &result {
            for check in checks {
                self.print(&format!("check failed: {check}"));
            }
        }
        let result = match written {
            Ok(()) => result,
            Err(error) => result.and(Err(error)),
        };
        if let Err(error) = &result {
            self.print(&format!("error: {error}"));
        }
        result
    }

    /// Returns the warnings so far.
    pub fn warnings(&self) -> Vec<String> {
        self.state().warnings.clone()
    }

    /// Returns the report of a run with this result, as `--report` writes it.
    pub fn report_of(&self, result: &Result<Outcome>) -> Value {
        let history = self.history();
        let state = self.state();
        let report = Report {
            history: &history,
            threads: self.threads(),
            seconds: self.started.elapsed().as_secs_f64(),
            peak_memory: state.peak_memory(),
            steps: &state.steps,
            warnings: &state.warnings,
            results: &state.results,
            result,
        };
        report.json()
    }

    fn closing_table(&self) -> String {
        let state = self.state();
        let mut rows: Vec<(String, String)> =
            state.steps.iter().map(|(name, seconds)| (name.clone(), format!("{seconds:.2} s"))).collect();
        rows.push(("total".to_owned(), format!("{:.2} s", self.started.elapsed().as_secs_f64())));
        if let Some(bytes) = state.peak_memory() {
            rows.push(("peak memory".to_owned(), format!("{:.0} MiB", bytes as f64 / (1024.0 * 1024.0))));
        }
        rows.push(("threads".to_owned(), self.threads().to_string()));
        rows.extend(state.closing.iter().cloned());
        let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        let lines: Vec<String> = rows.iter().map(|(name, value)| format!("  {name:width$}  {value}")).collect();
        format!("{}:\n{}", self.tool, lines.join("\n"))
    }

    fn print(&self, text: &str) {
        if self.listener.is_some() {
            return;
        }
        // if stderr is closed, the run continues
        self.bars.suspend(|| {
            let _ = writeln!(std::io::stderr(), "{text}");
        });
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Returns the peak memory of this process or of a process that it started, whichever is
    /// larger, in bytes.
    fn peak_memory(&self) -> Option<u64> {
        isoparticles_file::memory::peak_memory().max(self.peak_of_children)
    }
}

impl Drop for Step<'_> {
    fn drop(&mut self) {
        self.context.add_step(&self.name, self.started.elapsed().as_secs_f64());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_add_up_and_the_history_holds_the_seed() {
        let context = Context::silent("seed");
        drop(context.step("march"));
        drop(context.step("project"));
        drop(context.step("march"));
        context.set_parameter("epsilon", 0.5);
        let table = context.closing_table();
        assert_eq!(table.matches("march").count(), 1, "{table}");
        let history = context.history();
        assert_eq!(history.parameters, serde_json::json!({"seed": 1, "epsilon": 0.5}));
    }

    #[test]
    fn the_report_is_written_for_every_outcome() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("report.json");
        let outcomes = [
            (Ok(Outcome::Passed), "passed", 0),
            (Ok(Outcome::ChecksFailed(vec!["two holes".into()])), "checks_failed", 1),
            (Err(Error::input("a.nrrd: is empty", "b", "c")), "error", 2),
            (Err(Error::gpu("no adapter", "b", "c")), "error", 3),
            (Err(Error::interrupted("seed: interrupted")), "interrupted", 130),
        ];
        for (result, name, code) in outcomes {
            let mut context = Context::silent("seed");
            context.common.report = Some(path.clone());
            context.report("particles", 12);
            let result = context.close(result);
            assert_eq!(super::super::exit_code(&result), code);
            let report: Value = serde_json::from_slice(&std::fs::read(&path).expect("report")).expect("JSON");
            assert_eq!(report["outcome"], name);
            assert_eq!(report["exit_code"], code);
            assert_eq!(report["results"]["particles"], 12);
        }
    }
}
