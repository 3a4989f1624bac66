//! Shared parts of all stage programs: common options, exit codes, and the start and end of a run.
//!
//! A stage derives `clap::Parser` for its options, flattens [`CommonArgs`] into them, implements
//! [`StageArgs`], and passes its main function to [`run_stage`].

pub mod check;
mod command_line;
mod context;
pub mod interrupt;
mod listener;
mod memory;
mod monitor;
mod progress;
mod report;
pub mod shell;
pub mod values;

pub use context::{Context, Step};
pub use listener::{Listener, ProgressState};
pub use memory::particles_bytes;
pub use progress::Progress;

use crate::error::{Error, Kind, Result};
use crate::output;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Help heading of the options that all stages share.
pub const SHARED_OPTIONS: &str = "Shared options";
/// Help heading of the input and output files of a stage.
pub const FILES: &str = "Files";
/// Help heading of the options that affect the result.
pub const METHOD: &str = "Method";
/// Help heading of the options that affect only the checks.
pub const CHECKS: &str = "Checks";
/// Prefix of a warning about what violates a limit but is accepted with `ACCEPT_FORCED` or
/// `ACCEPT_LOSSES`. The verdict of the case repeats such warnings.
pub const FIT_BUT_FOR: &str = "fit but for ";

/// How to show progress.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ProgressMode {
    /// A bar on a terminal, otherwise lines.
    #[default]
    Auto,
    /// A progress bar that is redrawn in place.
    Bar,
    /// A line of plain text every few seconds.
    Lines,
    /// No progress.
    None,
}

// All stages have these options, with the same names.
#[expect(missing_docs, reason = "clap prints a doc comment of flattened options as the description of the program")]
#[derive(Clone, Debug, Default, clap::Args)]
pub struct CommonArgs {
    /// Print more to stderr (-vv for even more)
    #[arg(short, long, action = clap::ArgAction::Count, help_heading = SHARED_OPTIONS)]
    pub verbose: u8,
    /// Print only warnings and errors, without progress
    #[arg(short, long, conflicts_with = "verbose", help_heading = SHARED_OPTIONS)]
    pub quiet: bool,
    /// Overwrite existing output files; without this option, an existing output file is kept and
    /// reported as an error
    #[arg(long, help_heading = SHARED_OPTIONS)]
    pub force: bool,
    /// Number of CPU threads, 0 for all cores; does not affect the result
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = SHARED_OPTIONS)]
    pub threads: usize,
    /// Memory limit, such as 8G or 500M; a run that is expected to exceed it is rejected before it
    /// starts [default: the free memory of the machine]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = SHARED_OPTIONS)]
    pub max_memory: Option<u64>,
    /// Seed for random numbers, an integer of at least 0; the same seed gives byte-identical output
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = SHARED_OPTIONS)]
    pub seed: u64,
    /// Write a JSON report of all parameters, measurements and checks to this file; an existing
    /// file is always overwritten
    #[arg(long, value_name = "FILE.json", help_heading = SHARED_OPTIONS)]
    pub report: Option<PathBuf>,
    /// How to show progress on stderr
    #[arg(long, value_enum, value_name = "HOW", default_value_t = ProgressMode::Auto, help_heading = SHARED_OPTIONS)]
    pub progress: ProgressMode,
}

/// Command-line options of a stage, as [`run_stage`] requires them.
pub trait StageArgs {
    /// Returns the shared options.
    fn common(&self) -> &CommonArgs;

    /// Returns the files that this run will write, excluding the report. They are checked before
    /// the run starts. The history does not contain their names, so the same input gives the same
    /// bytes for any output name.
    fn outputs(&self) -> Vec<PathBuf>;

    /// Returns the parameters in effect, including defaults, as a JSON object without output paths.
    /// [`run_stage`] adds the seed. Parameters that are determined later are set with
    /// [`Context::set_parameter`].
    fn parameters(&self) -> serde_json::Value;

    /// Checks the options as a run would, but computes nothing. Returns `known`, extended with the
    /// information in the options.
    ///
    /// # Errors
    /// If a run would reject these options.
    fn check_options(&self, known: check::Known) -> Result<check::Known> {
        Ok(known)
    }
}

/// Outcome of a run that wrote its output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All checks passed: exit code 0.
    Passed,
    /// The output was written, but these checks failed: exit code 1.
    ChecksFailed(Vec<String>),
}

impl Outcome {
    /// Returns `Passed` if there are no failed checks, and `ChecksFailed` otherwise.
    pub fn from_failed_checks(failed: Vec<String>) -> Self {
        if failed.is_empty() { Self::Passed } else { Self::ChecksFailed(failed) }
    }
}

/// Returns the exit code of a run. docs/developer/architecture.md lists all exit codes.
pub fn exit_code(result: &Result<Outcome>) -> u8 {
    match result {
        Ok(Outcome::Passed) => 0,
        Ok(Outcome::ChecksFailed(_)) => 1,
        Err(error) => match error.kind {
            Kind::Input => 2,
            Kind::Gpu => 3,
            Kind::Interrupted => 130,
        },
    }
}

/// Stack size of each thread in bytes, equal to the default for the main thread on Linux.
pub const STACK_BYTES: usize = 8 << 20;

/// Runs a stage program. Parses the command line, sets up threads and signals, checks the outputs,
/// calls `run`, prints the closing table and errors, writes the report, and returns the exit code.
pub fn run_stage<A: clap::Parser + StageArgs + Sync>(
    tool: &'static str,
    run: impl FnOnce(&A, &Context) -> Result<Outcome> + Send,
) -> ExitCode {
    let words: Vec<String> = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    if let Some(code) = shell::told(&words.iter().map(String::as_str).collect::<Vec<_>>(), A::command) {
        return code;
    }
    if let Some(code) = check::asked(tool, A::check_options) {
        return code;
    }
    let args = match A::try_parse() {
        Ok(args) => args,
        Err(error) => {
            // clap prints help and version on stdout and usage errors on stderr; ignore a closed
            // pipe
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    let outputs = args.outputs();
    let command_line = command_line::canonical_command_line(tool, std::env::args().skip(1), &outputs, &[]);
    let mut common = args.common().clone();
    let report = check_report(common.report.as_deref(), &outputs);
    if report.is_err() {
        // do not write the report of this error over a file that is not a report
        common.report = None;
    }
    let context = Context::new(tool, command_line, common, args.parameters());
    interrupt::install();
    let ready = report.and_then(|()| prepare(&args, &context));
    // Run on a thread of the pool. A thread outside the pool would be suspended and resumed once
    // for each of thousands of parallel loops.
    let result = ready.and_then(|()| rayon::scope(|_| run(&args, &context)));
    let result = context.close(result);
    ExitCode::from(exit_code(&result))
}

/// Refuses a report path that would replace an output of this run or a file that is not a report.
fn check_report(report: Option<&Path>, outputs: &[PathBuf]) -> Result<()> {
    let Some(path) = report else { return Ok(()) };
    output::check_output(path, true)?;
    let mut start = [b'{'];
    if path.is_file() {
        // reading an empty file leaves `start` unchanged, so an empty file may be replaced
        let _ = std::fs::File::open(path).and_then(|mut file| std::io::Read::read(&mut file, &mut start));
    }
    if outputs.iter().any(|output| output == path || same_file(output, path)) || start != [b'{'] {
        return Err(Error::input(
            format!("{}: cannot be used for the report", path.display()),
            "the report would replace an output, or a file that is not a report",
            "set --report to another file, such as case.report.json",
        ));
    }
    Ok(())
}

/// Returns whether two paths refer to the same existing file.
fn same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// Sets up the threads, and checks everything that can be checked before the run starts.
fn prepare<A: StageArgs>(args: &A, context: &Context) -> Result<()> {
    let common = args.common();
    // 0 means one thread per core
    let pool = rayon::ThreadPoolBuilder::new().num_threads(common.threads).stack_size(STACK_BYTES);
    if pool.build_global().is_err() {
        context.verbose("the thread pool already exists; --threads has no effect");
    }
    context.check_outputs(&args.outputs())
}
