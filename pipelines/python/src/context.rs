//! The context of a run of `tetmesh-check` or `isoparticles-read`: messages, steps, progress,
//! history and report, as in the stages written in Rust.

use crate::arrays::compute;
use crate::errors::raised;
use isoparticles_stage::cli::{self, CommonArgs, Outcome, ProgressMode, exit_code, values};
use isoparticles_stage::error::{Error, Kind};
use isoparticles_stage::history::file_name;
use isoparticles_stage::limit;
use isoparticles_stage::output::{self, write_atomically};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// The programs that use this context.
const TOOLS: [&str; 2] = ["tetmesh-check", "isoparticles-read"];

/// Options with a value that do not affect the result.
const SILENT: [&str; 4] = ["--pictures", "--export", "--max-seconds", "--solve-seconds"];

/// The parsed command line, as far as the context needs it.
#[derive(FromPyObject)]
pub(crate) struct Parsed {
    output: PathBuf,
    verbose: u8,
    quiet: bool,
    force: bool,
    threads: usize,
    max_memory: Option<u64>,
    seed: u64,
    report: Option<PathBuf>,
    progress: String,
}

/// The exception that ended a run.
#[derive(FromPyObject)]
pub(crate) struct Failure {
    what: OsString,
    why: OsString,
    next: OsString,
}

/// Converts a text from Python. It may contain a path that is not valid UTF-8.
fn lossy(text: &OsString) -> String {
    text.to_string_lossy().into_owned()
}

/// Messages, steps and results of a run.
#[pyclass(frozen, subclass, module = "isoparticles._native")]
pub(crate) struct Context {
    context: Arc<cli::Context>,
    /// Parameters in effect, for the history and the report.
    #[pyo3(get)]
    parameters: Py<PyDict>,
    /// Results for the report.
    #[pyo3(get)]
    results: Py<PyDict>,
    /// Rows that are added to the closing table: pairs of texts.
    #[pyo3(get)]
    closing: Py<PyList>,
    /// Input files for the history.
    inputs: Py<PyList>,
}

#[pymethods]
impl Context {
    /// Creates the context of a run of the program `tool` with these words on the command line.
    #[new]
    #[pyo3(signature = (words, parsed, tool="tetmesh-check"))]
    fn new(py: Python<'_>, words: Vec<OsString>, parsed: Parsed, tool: &str) -> PyResult<Self> {
        let tool = TOOLS.into_iter().find(|known| *known == tool);
        let tool = tool.ok_or_else(|| PyValueError::new_err("no such program"))?;
        let progress = <ProgressMode as clap::ValueEnum>::from_str(&parsed.progress, false);
        let common = CommonArgs {
            verbose: parsed.verbose,
            quiet: parsed.quiet,
            force: parsed.force,
            threads: parsed.threads,
            max_memory: parsed.max_memory,
            seed: parsed.seed,
            report: parsed.report,
            progress: progress.map_err(PyValueError::new_err)?,
        };
        let context =
            cli::Context::for_program(tool, words.iter().map(lossy).collect(), parsed.output, &SILENT, common);
        let context = context.map_err(|error| raised(py, error))?;
        let parameters = PyDict::new(py);
        parameters.set_item("seed", context.seed())?;
        Ok(Self {
            context: Arc::new(context),
            parameters: parameters.unbind(),
            results: PyDict::new(py).unbind(),
            closing: PyList::empty(py).unbind(),
            inputs: PyList::empty(py).unbind(),
        })
    }

    /// Number of threads.
    #[getter]
    fn threads(&self) -> usize {
        self.context.threads()
    }

    /// The warnings so far.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.context.warnings()
    }

    /// Prints a line on stderr unless `--quiet` is set.
    fn info(&self, message: OsString) {
        self.context.info(lossy(&message));
    }

    /// Prints a line on stderr if `--verbose` is set.
    fn verbose(&self, message: OsString) {
        self.context.verbose(lossy(&message));
    }

    /// Prints a warning on stderr and adds it to the report.
    fn warn(&self, message: OsString) {
        self.context.warn(lossy(&message));
    }

    /// Returns a context manager that times a step.
    fn step(&self, name: String) -> Step {
        Step { context: Arc::clone(&self.context), name, started: Instant::now() }
    }

    /// Shows the progress of a computation on stderr.
    fn progress(&self, label: &str) -> Progress {
        Progress(Mutex::new(Some(self.context.progress(None, label))))
    }

    /// Refuses a run that is expected to need more memory (in bytes) than allowed.
    fn check_memory(&self, py: Python<'_>, needed: f64, what: OsString, next: &str) -> PyResult<()> {
        self.context.check_memory(needed, &lossy(&what), next).map_err(|error| raised(py, error))
    }

    /// Refuses outputs that exist, unless `--force` is set, or that cannot be written. Stores the
    /// paths, because none may be an input.
    fn check_outputs(&self, py: Python<'_>, outputs: Vec<PathBuf>) -> PyResult<()> {
        self.context.check_outputs(&outputs).map_err(|error| raised(py, error))
    }

    /// Adds an input file, with its hash and the history that it contains.
    fn add_input(&self, py: Python<'_>, path: PathBuf, history: Bound<'_, PyAny>) -> PyResult<()> {
        let (context, file) = (Arc::clone(&self.context), path.clone());
        let hash = compute(py, move || context.add_input(&file, None))?.map_err(|error| raised(py, error))?;
        let entry = PyDict::new(py);
        entry.set_item("path", path.file_name())?;
        entry.set_item("blake3", hash)?;
        if !history.is_none() {
            entry.set_item("history", history)?;
        }
        self.inputs.bind(py).append(entry)
    }

    /// Adds an input that is not hashed as a file: its path, and the hash of its content.
    fn add_value(&self, py: Python<'_>, path: PathBuf, hash: String) -> PyResult<()> {
        let name = file_name(&path);
        let entry = PyDict::new(py);
        entry.set_item("path", &name)?;
        entry.set_item("blake3", &hash)?;
        self.context.add_value(name, hash, None);
        self.inputs.bind(py).append(entry)
    }

    /// Returns the history of the files that this run writes.
    fn history<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let known = self.context.history();
        let history = PyDict::new(py);
        history.set_item("tool", known.tool)?;
        history.set_item("version", known.version)?;
        history.set_item("command_line", known.command_line)?;
        history.set_item("parameters", &self.parameters)?;
        history.set_item("inputs", &self.inputs)?;
        Ok(history)
    }

    /// Prints the closing table or the error, writes the report, and returns the exit code.
    fn close(&self, py: Python<'_>, failed: Vec<String>, error: Option<Failure>, interrupted: bool) -> PyResult<u8> {
        for (name, value) in self.closing.extract::<Vec<(String, String)>>(py)? {
            self.context.add_row(name, value);
        }
        if let Ok(bytes) = peak_memory(py) {
            self.context.set_peak_of_children(bytes);
        }
        let result = match error {
            None => Ok(Outcome::from_failed_checks(failed)),
            Some(Failure { what, why, next }) => {
                let kind = if interrupted { Kind::Interrupted } else { Kind::Input };
                Err(Error { kind, what: lossy(&what), why: lossy(&why), next: lossy(&next) })
            }
        };
        let closed = self.context.close_with(result, |path, report| {
            let text = self.report(py, &report.to_string()).map_err(|error| {
                Error::of_file(path, error, "the report cannot be written as JSON", "report this bug")
            })?;
            write_atomically(path, |file| writeln!(file, "{text}"))
        });
        Ok(exit_code(&closed))
    }
}

impl Context {
    /// Completes a report, which is JSON, with the parameters and the results. Their entries keep
    /// the order of the Python dictionaries.
    fn report(&self, py: Python<'_>, report: &str) -> PyResult<String> {
        let json = py.import("json")?;
        let report = json.call_method1("loads", (report,))?;
        report.set_item("parameters", &self.parameters)?;
        report.set_item("results", &self.results)?;
        let options = PyDict::new(py);
        options.set_item("indent", 2)?;
        options.set_item("allow_nan", false)?;
        json.call_method("dumps", (report,), Some(&options))?.extract()
    }
}

/// Returns the peak memory of this process or of a process that it started, whichever is larger, in
/// bytes. On Windows, this fails, because Python has no module `resource` there.
fn peak_memory(py: Python<'_>) -> PyResult<u64> {
    let resource = py.import("resource")?;
    let mut peak = 0;
    for who in ["RUSAGE_SELF", "RUSAGE_CHILDREN"] {
        let usage = resource.call_method1("getrusage", (resource.getattr(who)?,))?;
        peak = peak.max(usage.getattr("ru_maxrss")?.extract()?);
    }
    Ok(if cfg!(target_os = "macos") { peak } else { 1024 * peak })
}

/// A context manager that times a step. The times of steps with the same name are added up.
#[pyclass(frozen, module = "isoparticles._native")]
pub(crate) struct Step {
    context: Arc<cli::Context>,
    name: String,
    started: Instant,
}

#[pymethods]
impl Step {
    fn __enter__(&self) {}

    #[pyo3(signature = (*_error))]
    fn __exit__(&self, _error: Bound<'_, PyAny>) {
        self.context.add_step(&self.name, self.started.elapsed().as_secs_f64());
    }
}

/// Progress of a computation on stderr.
#[pyclass(frozen, module = "isoparticles._native")]
pub(crate) struct Progress(Mutex<Option<cli::Progress>>);

#[pymethods]
impl Progress {
    /// Shows the state, such as `pass 3, 51,230 tetrahedra`. Lines that would follow too soon are
    /// omitted.
    fn show(&self, message: &str) {
        if let Some(progress) = &*self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            progress.message(message);
        }
    }

    /// Ends the display.
    fn close(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

/// Refuses an output that exists, unless `force` is set, or that cannot be written.
#[pyfunction]
pub(crate) fn check_output(py: Python<'_>, path: PathBuf, force: bool) -> PyResult<()> {
    output::check_output(&path, force).map_err(|error| raised(py, error))
}

/// Fails if `needed` bytes for the file `path` do not fit in the free memory.
#[pyfunction]
pub(crate) fn check_memory(py: Python<'_>, path: PathBuf, needed: u64) -> PyResult<()> {
    limit::check_memory(&path, needed).map_err(|error| raised(py, error.into()))
}

/// Parses a number of bytes, such as `8G`; K, M, G and T denote powers of 1024. The error is an
/// `argparse.ArgumentTypeError`.
#[pyfunction]
pub(crate) fn number_of_bytes(py: Python<'_>, text: &str) -> PyResult<u64> {
    match values::bytes(text) {
        Ok(bytes) => Ok(bytes),
        Err(must) => {
            let error = py.import("argparse")?.call_method1("ArgumentTypeError", (format!("'{text}' {must}"),))?;
            Err(PyErr::from_value(error))
        }
    }
}
