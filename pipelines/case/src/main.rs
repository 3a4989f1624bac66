//! The `isoparticles-case` program, which the Makefile calls for every goal of a case.

use clap::Parser;
use isoparticles_case::batch::{Batch, Ending};
use isoparticles_case::command::{Programs, READING_BY_KEY, Volume, words_by_key};
use isoparticles_case::folder::CaseFolder;
use isoparticles_case::run::{self, Case, make, out, stage_of_goal};
use isoparticles_case::settings::Settings;
use isoparticles_case::status::Status;
use isoparticles_case::{batch, cluster, front, index, keys, name, program, read, verdict};
use isoparticles_stage::cli::shell;
use isoparticles_stage::error::{Error, Result};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make a case: run the stages whose results are missing or out of date, and record the state in
/// OUT/NAME/NAME.status.json.
///
/// Goals: distfield, sizefield, seed, particles, surface and mesh run the stages up to the named
/// result. The other goals are page, verdict, info, clean, index, and keys, which lists the
/// settings, one key per line. batch makes the case in each row of a list. For a scheduler, rows
/// prints the commands of a list, one line of JSON per row, and summary collects the outcomes and
/// writes the index. Exit codes: 0 if the result was made and every check passed; 1 if the result
/// was made, but a check failed; 2 for invalid usage or input; 3 if there is no usable GPU; 130 if
/// interrupted. The exit code of a batch is 1 if the exit code of any row is not 0.
///
/// Example: isoparticles-case mesh INPUT=heart.nrrd LABELS=1 SIZE=2.5
#[derive(Debug, Parser)]
#[command(name = "isoparticles-case", version)]
struct Arguments {
    /// Goal, such as mesh, page or batch.
    goal: String,
    /// Settings given by the user.
    #[arg(value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Name of the case file from which the --preset values come.
    #[arg(long, value_name = "NAME")]
    case_file: Option<String>,
    /// Settings from the case file. Settings given by the user take precedence.
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    preset: Vec<String>,
    /// Names of other variables of the caller, for "did you mean" suggestions.
    #[arg(long, value_name = "NAME", num_args = 0.., value_delimiter = ' ')]
    known: Vec<String>,
    /// List of the cases in a batch: a CSV file with one column per key and one row per case. INPUT
    /// and a mask in CROP are relative to the folder of the list. Settings on the command line
    /// apply to rows that do not set them.
    #[arg(long, value_name = "FILE.csv")]
    list: Option<PathBuf>,
    /// Goal of each case in a batch.
    #[arg(long, value_name = "GOAL", default_value = "mesh")]
    as_far_as: String,
    /// Time limit for each case in a batch, such as 90s, 30m or 2h. A case that exceeds it is
    /// stopped; the next run of the batch resumes it.
    #[arg(long, value_name = "TIME")]
    time_limit: Option<String>,
    /// Folder that contains the stage programs.
    #[arg(long, value_name = "DIR", default_value = "target/release")]
    bin: PathBuf,
    /// Do not repeat a stage whose checks failed before with the same settings, because they would
    /// fail again.
    #[arg(long)]
    retry: bool,
    /// Path of the tetmesh-check program. Its page and index programs must be in the same folder.
    #[arg(long, value_name = "PROGRAM", default_value = ".venv/bin/tetmesh-check")]
    tetmesh_check: PathBuf,
    /// Files that make up tetmesh-check, if the program file does not contain all of its code. If
    /// their content changes, the tetrahedra are made again.
    #[arg(long, value_name = "FILE", num_args = 0..)]
    tetmesh_files: Vec<PathBuf>,
    /// Files that make up the page program. If their content changes, the page is made again.
    #[arg(long, value_name = "FILE", num_args = 0..)]
    page_files: Vec<PathBuf>,
}

fn main() -> ExitCode {
    // Users call `isoparticles`, not this program, so completions and man pages describe that
    // command.
    if let Some(code) = told() {
        return code;
    }
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // clap prints help to stdout and usage errors to stderr. A closed pipe is not an error.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    match go(&arguments) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// Prints completions or a man page. Returns `None` if neither is requested. The arguments after
/// `--command-lines` are the paths of files that contain the output of `STAGE --command-line`.
fn told() -> Option<ExitCode> {
    let words: Vec<String> = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    let mut parts = words.splitn(2, |word| word == "--command-lines");
    let asked: Vec<&str> = parts.next()?.iter().map(String::as_str).collect();
    let stages: Result<Vec<_>> =
        parts.next().unwrap_or_default().iter().map(|path| front::stage(Path::new(path))).collect();
    match stages {
        Ok(stages) => shell::told(&asked, || front::command(&stages)),
        Err(error) => {
            eprintln!("error: {error}");
            Some(ExitCode::from(2))
        }
    }
}

impl Arguments {
    fn programs(&self) -> Programs {
        let mut tetmesh_files = self.tetmesh_files.clone();
        if tetmesh_files.is_empty() {
            tetmesh_files.push(self.tetmesh_check.clone());
        }
        Programs {
            bin: self.bin.clone(),
            tetmesh_check: self.tetmesh_check.clone(),
            tetmesh_files,
            page_files: self.page_files.clone(),
        }
    }
}

/// Performs a goal that applies to a list of cases.
fn go_through_list(arguments: &Arguments, programs: &Programs) -> Result<u8> {
    let Some(list) = &arguments.list else {
        return Err(Error::input(
            "LIST is not set",
            "LIST is the file with the cases to make",
            format!(
                "set LIST=cases.csv, a file whose header has some of {}",
                batch::columns().collect::<Vec<_>>().join(",")
            ),
        ));
    };
    let common: Vec<String> = arguments.preset.iter().chain(&arguments.set).cloned().collect();
    let (known, goal) = (&arguments.known, arguments.as_far_as.as_str());
    stage_named(goal)?;
    let limit = arguments.time_limit.as_deref().map(batch::time_limit).transpose()?;
    let batch = Batch { list, common: &common, known, goal, limit };
    match arguments.goal.as_str() {
        "rows" => {
            for row in cluster::rows(&batch, programs)? {
                println!("{row}");
            }
            Ok(0)
        }
        "summary" => close_batch(&batch, &cluster::summary(&batch, programs)?, programs),
        _ => close_batch(&batch, &batch.make(programs)?, programs),
    }
}

/// Performs the goal given on the command line. Returns the exit code.
fn go(arguments: &Arguments) -> Result<u8> {
    let programs = arguments.programs();
    if ["batch", "rows", "summary"].contains(&arguments.goal.as_str()) {
        return go_through_list(arguments, &programs);
    }
    let settings = Settings::read(&arguments.set, &arguments.preset, arguments.case_file.as_deref(), &arguments.known)?;
    match arguments.goal.as_str() {
        "index" => {
            let index = index::write(&out(&settings), Vec::new(), &programs)?;
            println!("index       {}", index.display());
            Ok(0)
        }
        "info" => info(settings, &programs),
        "keys" => {
            for key in keys::KEYS {
                println!("{}\t{}", key.name, key.what);
            }
            Ok(0)
        }
        "clean" => clean(&settings),
        "verdict" => {
            let folder = named(&settings)?;
            // The exit code is 0 for every verdict.
            print!("{}", verdict::closing(&folder, &run::status_of(&folder)?));
            Ok(0)
        }
        "page" => {
            let folder = named(&settings)?;
            let status = run::page(&folder, &programs)?;
            Ok(closing(&folder, &status))
        }
        goal => {
            let stage = stage_named(goal)?;
            let case = Case::new(settings)?;
            if arguments.retry
                && let Some(status) = cluster::failed_before(&case, stage)?
            {
                return Ok(closing(&case.folder, &status));
            }
            let status = make(&case, stage, &programs)?;
            Ok(closing(&case.folder, &status))
        }
    }
}

/// Returns the last stage that a goal requires.
fn stage_named(goal: &str) -> Result<&'static str> {
    stage_of_goal(goal).ok_or_else(|| {
        Error::input(
            format!("{goal}: no such goal"),
            "the goal selects what to do",
            "choose distfield, sizefield, seed, particles, surface, mesh, page, verdict, info, clean, index, keys, batch, rows or summary",
        )
    })
}

/// Prints the outcomes of a list of cases and writes their index. Returns the exit code.
fn close_batch(batch: &Batch<'_>, endings: &[Ending], programs: &Programs) -> Result<u8> {
    let code = batch::exit_code(endings);
    program::note_stop();
    print!("{}", batch::closing(endings));
    if programs.index().exists() {
        println!("index       {}", batch.index(programs)?.display());
    } else {
        println!("no index: {} is missing (make env installs it)", programs.index().display());
    }
    Ok(code)
}

/// Returns the folder of the case named by NAME or by the case file. If neither is set, returns the
/// folder that a run with these settings would use.
fn named(settings: &Settings) -> Result<CaseFolder> {
    match settings.get("NAME").or(settings.case_file()) {
        Some(name) => {
            name::check(name)?;
            Ok(CaseFolder::new(&out(settings), name))
        }
        None => Ok(Case::new(settings.clone())?.folder),
    }
}

/// Prints the closing lines and returns the exit code.
fn closing(folder: &CaseFolder, status: &Status) -> u8 {
    let code = verdict::exit_code(status);
    let text = verdict::closing(folder, status);
    if code == 0 {
        print!("{text}")
    } else {
        eprint!("{text}")
    }
    code
}

fn clean(settings: &Settings) -> Result<u8> {
    if settings.get("NAME").or(settings.case_file()).is_none() {
        return Err(Error::input(
            "neither CASE nor NAME is set",
            "clean removes the folder of one case",
            format!("name the case: {} clean NAME=name", program::front()),
        ));
    }
    let folder = named(settings)?;
    let word = if folder.clean()? { "removed" } else { "nothing in" };
    println!("{word}     {}", folder.path.display());
    Ok(0)
}

/// Prints the description of the volume and the predicted cost of meshing the object of the case.
fn info(settings: Settings, programs: &Programs) -> Result<u8> {
    let case = Case::new(settings)?;
    let volume = match &case.volume {
        Volume::At(path) => path.clone(),
        Volume::Phantom => run::output_of(&case.folder, "phantom"),
    };
    if case.volume == Volume::Phantom && !volume.exists() {
        return Err(Error::input(
            format!("{}: not made yet", volume.display()),
            "the volume of this case is a phantom, which distfield makes",
            format!("run '{} distfield' with the same settings first", program::front()),
        ));
    }
    let converted = read::for_info(&volume, &case.settings, programs)?;
    let volume = converted.as_ref().map_or(volume, read::Converted::path);
    let case = Case { settings: read::settings_after(&case.settings), ..case };
    let mut words = vec!["info".into(), volume.into_os_string()];
    let object = [("--labels", "LABELS"), ("--iso", "ISO"), ("--inside", "INSIDE")];
    let options = [&READING_BY_KEY[..], &object].map(|pairs| words_by_key(pairs, &case.settings));
    words.extend(options.into_iter().flatten().map(OsString::from));
    match program::run(&programs.bin.join("isoparticles-volume"), &words)? {
        program::Ended::Code(code) => Ok(u8::try_from(code).unwrap_or(2)),
        program::Ended::Signal(_) => Ok(130),
    }
}
