//! What shells and `man` read of a program, made of its own command line: `--completions SHELL` and `--man-page [SUBCOMMAND]`, alone on the
//! command line.
//!
//! They stand beside the options, not among them, because a stage cannot run without its files; `make completions` calls them.

use crate::error::Error;
use clap::{Command, ValueEnum};
use clap_complete::Shell;
use std::io::Write;
use std::process::ExitCode;

/// Prints what was asked for, and gives the exit code; `None` when the command line asks for something else.
pub fn told(command: impl FnOnce() -> Command) -> Option<ExitCode> {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let words: Vec<_> = arguments.iter().map(|word| word.to_str().unwrap_or_default()).collect();
    let text = match *words.as_slice() {
        ["--man-page"] => man_page(command(), None),
        ["--man-page", subcommand] => man_page(command(), Some(subcommand)),
        ["--completions", shell] => match Shell::from_str(shell, true) {
            Ok(shell) => completions(shell, command()),
            Err(_) => {
                eprintln!("error: {}", unknown(shell));
                return Some(ExitCode::from(2));
            }
        },
        _ => return None,
    };
    // A closed pipe is no failure of ours.
    let _ = std::io::stdout().write_all(&text);
    Some(ExitCode::SUCCESS)
}

fn unknown(shell: &str) -> Error {
    let known: Vec<_> = Shell::value_variants().iter().map(ToString::to_string).collect();
    Error::input(
        format!("--completions {shell}: no such shell"),
        "each shell has a language of its own",
        format!("choose one of {}", known.join(", ")),
    )
}

/// The script that completes the program's options in a shell.
fn completions(shell: Shell, mut command: Command) -> Vec<u8> {
    let (name, mut text) = (command.get_name().to_owned(), Vec::new());
    clap_complete::generate(shell, &mut command, name, &mut text);
    text
}

/// The program's page of the manual, or that of one of its subcommands, in roff; empty where there is no such subcommand.
fn man_page(mut command: Command, subcommand: Option<&str>) -> Vec<u8> {
    command.build();
    let page = match subcommand {
        Some(name) => command.find_subcommand(name).cloned(),
        None => Some(command),
    };
    let mut text = Vec::new();
    if let Some(page) = page {
        clap_mangen::Man::new(page).render(&mut text).expect("memory takes all of it");
    }
    text
}
