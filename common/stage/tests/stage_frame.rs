//! Tests the shared parts of all stage programs with a small program: exit codes, atomic outputs,
//! the report, reproducible bytes, and the response to signals.
//!
//! This test does not use the default harness, because its executable also serves as the small
//! program.

use isoparticles_stage::cli::check::Known;
use isoparticles_stage::cli::shell::CommandLine;
use isoparticles_stage::cli::{CommonArgs, Context, Outcome, StageArgs, run_stage};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::output::write_atomically;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Output, Stdio};
use std::time::Duration;

/// Environment variable that makes this executable run as the small program.
const CHILD: &str = "ISOPARTICLES_STAGE_FRAME_CHILD";

/// Tests the code that all stages share.
#[derive(clap::Parser)]
#[command(name = "trial", version)]
struct Args {
    input: PathBuf,
    #[arg(short, long)]
    output: PathBuf,
    #[arg(long, default_value = "pass")]
    mode: String,
    #[arg(long, default_value_t = 1000)]
    size: usize,
    #[command(flatten)]
    common: CommonArgs,
}

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        &self.common
    }

    fn outputs(&self) -> Vec<PathBuf> {
        vec![self.output.clone()]
    }

    fn parameters(&self) -> serde_json::Value {
        serde_json::json!({"mode": self.mode, "size": self.size})
    }

    fn check_options(&self, known: Known) -> Result<Known> {
        if self.mode == "refused" { Err(Error::input("--mode refused", "it is", "choose another")) } else { Ok(known) }
    }
}

fn run(args: &Args, context: &Context) -> Result<Outcome> {
    context.add_input(&args.input, None)?;
    let step = context.step("work");
    let progress = context.progress(Some(2), "work");
    progress.add(1);
    match args.mode.as_str() {
        "gpu" => return Err(Error::gpu("no adapter", "--backend gpu was asked for", "use --backend cpu")),
        "wait" => {
            eprintln!("ready");
            while !context.interrupted() {
                std::thread::sleep(Duration::from_millis(5));
            }
            context.check_interrupt()?;
        }
        "deaf" => {
            eprintln!("ready");
            loop {
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        "endless" => write_atomically(&args.output, |file| {
            file.write_all(b"first")?;
            file.flush()?;
            eprintln!("ready");
            loop {
                file.write_all(&[0])?;
                file.flush()?;
            }
        })?,
        _ => {}
    }
    drop(step);
    context.set_parameter("resolved", 0.5);
    context.report("bytes", args.size);
    let history = serde_json::to_vec(&context.history()).expect("JSON");
    write_atomically(&args.output, |file| {
        file.write_all(&history)?;
        file.write_all(&vec![7; args.size])
    })?;
    let failed = if args.mode == "fail" { vec!["two holes".to_owned()] } else { Vec::new() };
    Ok(Outcome::from_failed_checks(failed))
}

fn main() -> ExitCode {
    if std::env::var_os(CHILD).is_some() {
        return run_stage::<Args>("trial", run);
    }
    exit_codes_and_files();
    options_are_checked_without_work();
    what_shells_and_man_read();
    same_bytes();
    the_report();
    #[cfg(unix)]
    {
        a_signal_leaves_nothing_half_written();
        a_full_disk_leaves_nothing_half_written();
    }
    println!("stage_frame: ok");
    ExitCode::SUCCESS
}

fn program(arguments: &[&str], folder: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    command.args(arguments).current_dir(folder).env(CHILD, "1").stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn start(arguments: &[&str], folder: &Path) -> Output {
    program(arguments, folder).output().expect("started")
}

fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("folder");
    std::fs::write(folder.path().join("in.txt"), b"input").expect("written");
    folder
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn exit_codes_and_files() {
    let folder = workplace();
    let code = |arguments: &[&str]| {
        let output = start(arguments, folder.path());
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    assert_eq!(code(&["in.txt", "-o", "a"]).0, Some(0));
    let (status, text) = code(&["in.txt", "-o", "a"]);
    assert_eq!(status, Some(2));
    assert!(text.contains("--force") && text.contains("what to do"), "{text}");
    let (status, text) = code(&["in.txt", "-o", "a", "--force"]);
    assert_eq!(status, Some(0));
    assert!(text.contains("work") && text.contains("threads") && text.contains("peak memory"), "{text}");
    assert_eq!(code(&["in.txt", "-o", "b", "--mode", "fail", "-q"]), (Some(1), "check failed: two holes\n".to_owned()));
    assert_eq!(code(&["absent.txt", "-o", "c"]).0, Some(2));
    assert_eq!(code(&["in.txt", "-o", "no/folder/c"]).0, Some(2));
    assert_eq!(code(&["in.txt", "-o", "c", "--mode", "gpu"]).0, Some(3));
    assert_eq!(code(&["in.txt", "-o", "c", "--no-such-option"]).0, Some(2));
    assert_eq!(code(&["in.txt", "-o", "c", "--report", "c"]).0, Some(2));
    assert_eq!(code(&["in.txt", "-o", "c", "--report", "no/folder/r.json"]).0, Some(2));
    assert_eq!(code(&["in.txt", "-o", "c", "--report", "in.txt"]).0, Some(2));
    assert_eq!(code(&["in.txt", "-o", "in.txt", "--force"]).0, Some(2));
    assert_eq!(std::fs::read(folder.path().join("in.txt")).expect("kept"), b"input");
    assert_eq!(code(&["in.txt", "-o", "c", "-q"]), (Some(0), String::new()));
    let help = start(&["--help"], folder.path());
    assert_eq!(help.status.code(), Some(0));
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    assert!(help.starts_with("Tests the code that all stages share"), "{help}");
    for option in [
        "--verbose",
        "--quiet",
        "--force",
        "--threads",
        "--max-memory",
        "--seed",
        "--report",
        "--progress",
        "--version",
    ] {
        assert!(help.contains(option), "{option}");
    }
    assert_eq!(start(&["--version"], folder.path()).status.code(), Some(0));
    assert_eq!(names(folder.path()), ["a", "b", "c", "in.txt"]);
}

fn options_are_checked_without_work() {
    let folder = workplace();
    let check = |arguments: &[&str]| {
        let known = r#"{"materials":["outside","a"],"volume":false}"#;
        let output = start(&[&["--check-options", known], arguments].concat(), folder.path());
        let [told, errors] = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
        (output.status.code(), told, errors)
    };
    let (code, told, errors) = check(&["absent.txt", "-o", "a", "--report", "r.json"]);
    assert_eq!((code, errors.as_str()), (Some(0), ""));
    let known: Known = serde_json::from_str(&told).expect("what is known, for the next stage");
    assert_eq!(known.materials.expect("names"), ["outside", "a"]);
    for (wrong, words) in [("--sise=3", "unexpected argument '--sise'"), ("--size=x", "invalid value 'x'")] {
        let (code, told, errors) = check(&["in.txt", "-o", "a", wrong]);
        assert_eq!((code, told.as_str()), (Some(2), ""));
        let lines: Vec<&str> = errors.lines().collect();
        assert!(lines.len() == 3 && lines[0].starts_with("error: ") && lines[0].contains(words), "{errors}");
    }
    assert_eq!(check(&["in.txt", "-o", "a", "--mode", "refused"]).0, Some(2), "what the stage itself refuses");
    assert_eq!(names(folder.path()), ["in.txt"]);
}

fn what_shells_and_man_read() {
    let folder = workplace();
    let told = |arguments: &[&str]| {
        let output = start(arguments, folder.path());
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned(), output.stderr)
    };
    for (shell, sign) in [("bash", "complete -F _trial"), ("zsh", "#compdef trial"), ("fish", "complete -c trial")] {
        let (status, text, _) = told(&["--completions", shell]);
        assert_eq!(status, Some(0));
        assert!(text.contains(sign) && text.contains("max-memory"), "{shell}: {text}");
    }
    let (status, page, _) = told(&["--man-page"]);
    assert_eq!(status, Some(0));
    assert!(page.contains(".TH trial 1") && page.contains("max\\-memory"), "{page}");
    let (status, line, _) = told(&["--command-line"]);
    let line: CommandLine = serde_json::from_str(&line).expect("a command line");
    assert_eq!((status, line.name.as_str()), (Some(0), "trial"));
    let option = |long: &str| line.options.iter().find(|option| option.long == long).expect("an option");
    let (output, force, progress) = (option("output"), option("force"), option("progress"));
    assert!(output.is_path && output.short == Some('o') && force.value.is_none());
    assert_eq!(progress.words, ["auto", "bar", "lines", "none"]);
    let (status, text, error) = told(&["--completions", "tcsh"]);
    assert_eq!((status, text.as_str()), (Some(2), ""));
    assert!(String::from_utf8_lossy(&error).contains("what to do: choose one of bash"));
    assert_eq!(names(folder.path()), ["in.txt"]);
}

/// Checks that the bytes of the output do not depend on the folder, the output name, the number of
/// threads or the time.
fn same_bytes() {
    let (first, second) = (workplace(), workplace());
    let input = second.path().join("in.txt");
    let output = second.path().join("another.out");
    assert!(start(&["in.txt", "-o", "a", "--threads", "1"], first.path()).status.success());
    let arguments = [input.to_str().expect("UTF-8"), "-o", output.to_str().expect("UTF-8"), "--threads=2", "-v"];
    assert!(start(&arguments, Path::new("/")).status.success());
    let bytes = std::fs::read(first.path().join("a")).expect("written");
    assert!(bytes == std::fs::read(&output).expect("written"));
    let text = String::from_utf8_lossy(&bytes).into_owned();
    assert!(text.contains("\"resolved\":0.5") && text.contains("\"seed\":1"), "{text}");
}

fn the_report() {
    let folder = workplace();
    let read = || -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(folder.path().join("r.json")).expect("report")).expect("JSON")
    };
    start(&["in.txt", "-o", "a", "--mode", "fail", "--report", "r.json", "-q"], folder.path());
    let report = read();
    assert_eq!(report["tool"], "trial");
    assert_eq!(report["outcome"], "checks_failed");
    assert_eq!(report["failed_checks"][0], "two holes");
    assert_eq!(report["parameters"]["resolved"], 0.5);
    assert_eq!(report["results"]["bytes"], 1000);
    assert_eq!(report["inputs"][0]["blake3"], blake3::hash(b"input").to_hex().as_str());
    assert_eq!(report["steps"][0]["name"], "work");
    start(&["in.txt", "-o", "a", "--report", "r.json", "-q"], folder.path());
    let report = read();
    assert_eq!((&report["outcome"], &report["exit_code"]), (&"error".into(), &2.into()));
    assert!(report["error"]["next"].as_str().is_some_and(|next| next.contains("--force")));
}

#[cfg(unix)]
fn a_signal_leaves_nothing_half_written() {
    use std::io::{BufRead, BufReader};
    // in mode "deaf", the program never checks for interrupts, so only the second signal ends it
    for (mode, signals) in
        [("wait", &["INT"][..]), ("wait", &["TERM"]), ("endless", &["INT"]), ("deaf", &["INT", "TERM"])]
    {
        let folder = workplace();
        std::fs::write(folder.path().join("out"), b"old").expect("written");
        let arguments = ["in.txt", "-o", "out", "--mode", mode, "--force", "-q", "--report", "r.json"];
        let mut child = program(&arguments, folder.path()).spawn().expect("started");
        let mut lines = BufReader::new(child.stderr.take().expect("stderr")).lines();
        assert_eq!(lines.next().expect("a line").expect("text"), "ready");
        for signal in signals {
            // use the shell's built-in kill, because some systems have no kill program
            let status = Command::new("sh").args(["-c", &format!("kill -{signal} {}", child.id())]).status();
            assert!(status.expect("sh").success());
            std::thread::sleep(Duration::from_millis(100));
        }
        let rest: Vec<String> = lines.map_while(std::io::Result::ok).collect();
        assert_eq!(child.wait().expect("ended").code(), Some(130), "{mode} {signals:?}: {rest:?}");
        assert_eq!(std::fs::read(folder.path().join("out")).expect("kept"), b"old");
        let expected: &[&str] = if mode == "deaf" { &["in.txt", "out"] } else { &["in.txt", "out", "r.json"] };
        assert_eq!(names(folder.path()), expected, "{mode}");
    }
}

/// Simulates a full disk with a limit on the file size.
#[cfg(unix)]
fn a_full_disk_leaves_nothing_half_written() {
    let folder = workplace();
    let program = std::env::current_exe().expect("this program");
    let script = format!("trap '' XFSZ; ulimit -f 64; exec '{}' in.txt -o out --size 1000000 -q", program.display());
    let output = Command::new("sh").args(["-c", &script]).current_dir(folder.path()).env(CHILD, "1").output();
    let output = output.expect("started");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("cannot write") && text.contains("no partial file is left"), "{text}");
    assert_eq!(names(folder.path()), ["in.txt"]);
}
