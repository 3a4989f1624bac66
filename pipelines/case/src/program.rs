//! Runs programs to completion and forwards the signals that stop a run.

use isoparticles_stage::error::{Error, Result};
use std::ffi::OsString;
use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Output};
use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Returns the name of the user's command for messages: the value of ISOPARTICLES_FRONT, or else
/// `make`.
#[must_use]
pub fn front() -> String {
    std::env::var("ISOPARTICLES_FRONT").unwrap_or_else(|_| "make".to_owned())
}

/// Time that a program has to write its last checkpoint after an interrupt. A checkpoint of a
/// million particles takes at least 72 MB (nine 8-byte numbers per particle). Writing it at 10 MB/s
/// takes 7 s.
const GRACE_PERIOD: Duration = Duration::from_secs(60);
/// Interval at which a program with a time limit is polled. Polling adds at most 0.05 s to the
/// measured time of a row, which is printed with a resolution of 0.1 s.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Process ID of the running program; 0 if no program is running.
static RUNNING: AtomicU32 = AtomicU32::new(0);
static REQUESTED: AtomicBool = AtomicBool::new(false);
static INSTALL: Once = Once::new();

/// Installs a handler for SIGINT, SIGTERM and SIGHUP. The handler records a stop request and
/// interrupts the running program.
pub fn listen() {
    INSTALL.call_once(|| {
        // Without a handler, a signal ends this program immediately. The next run then reports that
        // this run was killed.
        let _ = ctrlc::set_handler(|| {
            REQUESTED.store(true, Ordering::SeqCst);
            interrupt(RUNNING.load(Ordering::SeqCst));
        });
    });
}

/// Returns whether the user has requested a stop.
#[must_use]
pub fn stop_requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}

/// Clears the stop request, so that the work after a stop, such as generating the page, can run.
pub fn note_stop() {
    REQUESTED.store(false, Ordering::SeqCst);
}

/// How a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The program ended with this exit code.
    Code(i32),
    /// Number of the signal that ended the program; 0 if the system does not report the number.
    Signal(i32),
}

/// Runs a program to completion. The program inherits stdout and stderr.
///
/// # Errors
/// If the program cannot be started.
pub fn run(program: &Path, arguments: &[OsString]) -> Result<Ended> {
    let mut command = Command::new(program);
    command.args(arguments);
    Ok(run_command(command, None)?.0)
}

/// Runs a program to completion with its output written to a file. Returns how the program ended,
/// and whether it exceeded the time limit. At the limit, the program is interrupted; after a
/// minute, it is interrupted again; after another minute, it is killed.
///
/// # Errors
/// If the program cannot be started.
pub fn run_logged(program: &Path, arguments: &[OsString], log: File, limit: Option<Duration>) -> Result<(Ended, bool)> {
    let mut command = Command::new(program);
    let errors = log.try_clone().map_err(|error| {
        Error::input(
            format!("the log of {}: {error}", program.display()),
            "the log records errors",
            "run the case again",
        )
    })?;
    command.args(arguments).stdout(log).stderr(errors);
    run_command(command, limit)
}

/// Runs a program to completion and returns its output.
///
/// # Errors
/// If the program cannot be started.
pub fn output(program: &Path, arguments: &[OsString]) -> Result<Output> {
    let mut command = Command::new(program);
    command.args(arguments).stdin(std::process::Stdio::null());
    command.output().map_err(|error| not_started(program, &error))
}

fn not_started(program: &Path, error: &std::io::Error) -> Error {
    Error::input(
        format!("{}: cannot be started: {error}", program.display()),
        "the case needs this program",
        "build it (make build env), or set BIN or TETMESH_CHECK to its path",
    )
}

fn run_command(mut command: Command, limit: Option<Duration>) -> Result<(Ended, bool)> {
    command.stdin(std::process::Stdio::null());
    #[cfg(unix)]
    {
        // In its own process group, the program does not receive Ctrl-C from the terminal, only one
        // signal from this process. A second signal would end it without its last checkpoint.
        use std::os::unix::process::CommandExt;
        command.process_group(0);
    }
    let mut child = command.spawn().map_err(|error| not_started(Path::new(command.get_program()), &error))?;
    RUNNING.store(child.id(), Ordering::SeqCst);
    if stop_requested() {
        interrupt(child.id());
    }
    let status = wait(&mut child, limit);
    RUNNING.store(0, Ordering::SeqCst);
    let (status, out_of_time) = status.map_err(|error| {
        Error::input(
            format!("{}: waiting for its end failed: {error}", command.get_program().display()),
            "its outcome is unknown",
            "run the case again",
        )
    })?;
    Ok((ended(status), out_of_time))
}

/// Waits for a program to end. After `limit`, interrupts and finally kills the program. The
/// returned flag is `true` if the limit was exceeded.
fn wait(child: &mut Child, limit: Option<Duration>) -> std::io::Result<(ExitStatus, bool)> {
    let Some(limit) = limit else { return Ok((child.wait()?, false)) };
    let started = Instant::now();
    let mut asked = 0;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok((status, asked > 0));
        }
        if started.elapsed() >= limit + asked * GRACE_PERIOD {
            match asked {
                0 | 1 => interrupt(child.id()),
                _ => child.kill()?,
            }
            asked += 1;
        }
        std::thread::sleep(POLL_INTERVAL);
    }
}

#[cfg(unix)]
fn ended(status: ExitStatus) -> Ended {
    use std::os::unix::process::ExitStatusExt;
    status.code().map_or_else(|| Ended::Signal(status.signal().unwrap_or(0)), Ended::Code)
}

#[cfg(not(unix))]
fn ended(status: ExitStatus) -> Ended {
    status.code().map_or(Ended::Signal(0), Ended::Code)
}

#[cfg(unix)]
fn interrupt(process: u32) {
    use nix::sys::signal::{Signal, kill};
    if let Some(process) = i32::try_from(process).ok().filter(|process| *process > 0) {
        // A process that has already ended needs no signal.
        let _ = kill(nix::unistd::Pid::from_raw(process), Signal::SIGINT);
    }
}

#[cfg(not(unix))]
fn interrupt(_process: u32) {}
