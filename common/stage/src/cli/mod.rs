//! What every stage program shares: the common options, the exit codes, and the frame that a run happens in.
//!
//! A stage derives `clap::Parser` for its own options, flattens [`CommonArgs`] into them, implements [`StageArgs`]
//! and hands its work to [`run_stage`].

pub mod check;
mod command_line;
mod context;
pub mod interrupt;
mod memory;
mod monitor;
mod progress;
mod report;
pub mod shell;
pub mod values;

pub use context::{Context, Step};
pub use memory::particles_bytes;
pub use progress::Progress;

use crate::error::{Error, Kind, Result};
use crate::output;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Help heading of the block of options that every stage has.
pub const SHARED_OPTIONS: &str = "Shared options";
/// Help heading of the files a stage reads and writes.
pub const FILES: &str = "Files";
/// Help heading of the options that change the result.
pub const METHOD: &str = "Method";
/// Help heading of the options that change what is checked, not what is made.
pub const CHECKS: &str = "Checks";
/// Beginning of the warning that names elements beyond a limit which the user accepts. The verdict
/// of the case repeats it.
pub const FIT_BUT_FOR: &str = "fit but for ";

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ProgressMode {
    /// A bar on a terminal, else lines.
    #[default]
    Auto,
    /// A bar that is redrawn in place.
    Bar,
    /// A plain line every few seconds.
    Lines,
    /// Nothing.
    None,
}

// The options that every stage has, under the same names.
#[expect(missing_docs, reason = "clap prints a doc comment of flattened options as the description of the program")]
#[derive(Clone, Debug, Default, clap::Args)]
pub struct CommonArgs {
    /// Say more on stderr (-vv: still more)
    #[arg(short, long, action = clap::ArgAction::Count, help_heading = SHARED_OPTIONS)]
    pub verbose: u8,
    /// Print only warnings and errors, and no progress
    #[arg(short, long, conflicts_with = "verbose", help_heading = SHARED_OPTIONS)]
    pub quiet: bool,
    /// Replace outputs that exist already; without it they are kept and the run is refused
    #[arg(long, help_heading = SHARED_OPTIONS)]
    pub force: bool,
    /// CPU threads to use, 0 for all cores; the result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = SHARED_OPTIONS)]
    pub threads: usize,
    /// Most memory that the run may take, such as 8G or 500M: when more is expected it is refused before it starts, with
    /// the figure [default: what the machine has free]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = SHARED_OPTIONS)]
    pub max_memory: Option<u64>,
    /// Seed of the random numbers, any whole number from 0; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = SHARED_OPTIONS)]
    pub seed: u64,
    /// Write what was done, measured and checked to this JSON file (always replaced)
    #[arg(long, value_name = "FILE.json", help_heading = SHARED_OPTIONS)]
    pub report: Option<PathBuf>,
    /// How to show progress on stderr
    #[arg(long, value_enum, value_name = "HOW", default_value_t = ProgressMode::Auto, help_heading = SHARED_OPTIONS)]
    pub progress: ProgressMode,
}

/// What [`run_stage`] needs to know of a stage's options.
pub trait StageArgs {
    /// The flattened shared options.
    fn common(&self) -> &CommonArgs;

    /// The files this run will write (not the report). They are checked before the work starts, and left out of the
    /// history, so that the same input gives the same bytes whatever the output is called.
    fn outputs(&self) -> Vec<PathBuf>;

    /// The stage's parameters as they apply, defaults included, as a JSON object without output paths; the seed is
    /// added by [`run_stage`]. What is resolved later goes through [`Context::set_parameter`].
    fn parameters(&self) -> serde_json::Value;

    /// Refuses the options that a run would refuse, before any work; returns what is known, with
    /// what the options add.
    ///
    /// # Errors
    /// As a run with these options would.
    fn check_options(&self, known: check::Known) -> Result<check::Known> {
        Ok(known)
    }
}

/// How a run that wrote its output ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Everything is as it should be: exit code 0.
    Passed,
    /// The output is there, but these checks failed: exit code 1.
    ChecksFailed(Vec<String>),
}

impl Outcome {
    /// `Passed` when there is no failed check.
    pub fn from_failed_checks(failed: Vec<String>) -> Self {
        if failed.is_empty() { Self::Passed } else { Self::ChecksFailed(failed) }
    }
}

/// Exit code of a run; what each number means is in docs/developer/architecture.md.
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

/// Stack of a thread, bytes: that of the main thread on Linux.
const STACK: usize = 8 << 20;

/// Runs a stage program: reads the command line, sets up threads and signals, checks the outputs, does the work, prints
/// the closing table and the error, writes the report and returns the exit code.
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
            // clap sends help and version to stdout and usage errors to stderr; a closed pipe is no failure of ours.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    let outputs = args.outputs();
    let command_line = command_line::canonical_command_line(tool, std::env::args().skip(1), &outputs);
    let mut common = args.common().clone();
    let report = check_report(common.report.as_deref(), &outputs);
    if report.is_err() {
        // Not even to tell of the error may a file be replaced that is no report.
        common.report = None;
    }
    let context = Context::new(tool, command_line, common, args.parameters()).with_outputs(outputs);
    interrupt::install();
    let ready = report.and_then(|()| prepare(&args, &context));
    // on a thread of the pool: from any other, each of thousands of parallel loops would put it to sleep and wake it up again
    let result = ready.and_then(|()| rayon::scope(|_| run(&args, &context)));
    let result = context.close(result);
    ExitCode::from(exit_code(&result))
}

/// Refuses a report that would replace an output of this run, or a file that is no report.
fn check_report(report: Option<&Path>, outputs: &[PathBuf]) -> Result<()> {
    let Some(path) = report else { return Ok(()) };
    output::check_output(path, true)?;
    let mut start = [b'{'];
    if path.is_file() {
        // An empty file leaves the brace; nothing is lost with it.
        let _ = std::fs::File::open(path).and_then(|mut file| std::io::Read::read(&mut file, &mut start));
    }
    if outputs.iter().any(|output| output == path || same_file(output, path)) || start != [b'{'] {
        return Err(Error::input(
            format!("{}: is not the place for the report", path.display()),
            "an output or a file that is no report would be replaced",
            "give --report a name of its own, such as case.report.json",
        ));
    }
    Ok(())
}

/// Whether two names are those of one existing file.
fn same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// Everything that can be refused before the work starts.
fn prepare<A: StageArgs>(args: &A, context: &Context) -> Result<()> {
    let common = args.common();
    // 0 is a thread for each core
    let pool = rayon::ThreadPoolBuilder::new().num_threads(common.threads).stack_size(STACK);
    if pool.build_global().is_err() {
        context.verbose("the thread pool was set up already; --threads has no effect");
    }
    let outputs = args.outputs();
    for (position, path) in outputs.iter().enumerate() {
        if outputs[..position].contains(path) {
            return Err(Error::input(
                format!("{}: is named for two outputs", path.display()),
                "the second would replace the first",
                "give each output a name of its own",
            ));
        }
        output::check_output(path, common.force)?;
    }
    Ok(())
}
