//! Shell completions, manual pages and a machine-readable description of the options. All are
//! generated from clap's definition of the command line: `--completions SHELL [SUBCOMMAND]`,
//! `--man-page [SUBCOMMAND]` and `--command-line`. No other arguments are allowed.
//!
//! These flags are not regular options, because clap would then also require the stage's files.
//! `make completions` writes the scripts. With `--command-line`, a stage in any language describes
//! its options to a calling program ([`CommandLine`]).

use crate::error::Error;
use clap::{Arg, ArgAction, Command, ValueEnum, ValueHint};
use clap_complete::Shell;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::process::ExitCode;

/// The options of a stage, exchanged between programs as JSON.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CommandLine {
    /// Name of the program.
    pub name: String,
    /// The options, without the positional files.
    pub options: Vec<StageOption>,
}

/// An option of a stage.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageOption {
    /// Long name, without dashes.
    pub long: String,
    /// Short name, if there is one.
    pub short: Option<char>,
    /// Placeholder for the value, such as `<mm>`; `None` for a switch.
    pub value: Option<String>,
    /// Allowed values; empty if any value is allowed.
    pub words: Vec<String>,
    /// True if the value is a file or folder.
    pub is_path: bool,
    /// Help text.
    pub help: String,
}

impl CommandLine {
    /// Returns the options of a program that parses its command line with clap.
    fn of(command: &Command) -> Self {
        let told = |arg: &Arg| {
            let value = arg.get_value_names().and_then(|names| names.first()).map(ToString::to_string);
            let words = arg.get_possible_values().into_iter().map(|word| word.get_name().to_owned()).collect();
            Some(StageOption {
                long: arg.get_long()?.to_owned(),
                short: arg.get_short(),
                value: (!is_switch(arg)).then(|| value.unwrap_or_default()),
                words: if is_switch(arg) { Vec::new() } else { words },
                is_path: PATH_HINTS.contains(&arg.get_value_hint()),
                help: arg.get_help().map(ToString::to_string).unwrap_or_default(),
            })
        };
        Self {
            name: command.get_name().to_owned(),
            options: command.get_arguments().filter(|arg| !arg.is_hide_set()).filter_map(told).collect(),
        }
    }

    /// Converts this description to a subcommand of another program, with an argument for the
    /// positional files.
    #[must_use]
    pub fn command(&self) -> Command {
        // clap needs static strings; the leak is harmless because the program soon ends
        let kept = |text: &str| -> &'static str { text.to_owned().leak() };
        let arg = |option: &StageOption| {
            let arg = Arg::new(kept(&option.long)).long(kept(&option.long)).help(option.help.clone());
            let arg = option.short.into_iter().fold(arg, Arg::short);
            let Some(value) = &option.value else { return arg.action(ArgAction::Count) };
            let arg = arg.value_name(kept(value)).allow_hyphen_values(true);
            match option.words.as_slice() {
                [] if option.is_path => arg.value_hint(ValueHint::AnyPath),
                [] => arg,
                words => arg.value_parser(words.iter().map(|word| kept(word)).collect::<Vec<_>>()),
            }
        };
        let files = Arg::new("FILES")
            .num_args(0..)
            .value_hint(ValueHint::AnyPath)
            .help("Input files, in the order shown by --help");
        Command::new(kept(&self.name)).args(self.options.iter().map(arg)).arg(files)
    }
}

/// Value hints for files and folders.
const PATH_HINTS: [ValueHint; 3] = [ValueHint::AnyPath, ValueHint::FilePath, ValueHint::DirPath];

/// Returns whether an option takes no value. Returns false for the help and version switches of
/// clap.
fn is_switch(arg: &Arg) -> bool {
    matches!(arg.get_action(), ArgAction::SetTrue | ArgAction::SetFalse | ArgAction::Count)
}

/// Prints the completions, manual page or description requested on the command line, and returns
/// the exit code. Returns `None` for any other command line.
pub fn told(words: &[&str], command: impl FnOnce() -> Command) -> Option<ExitCode> {
    let text = match *words {
        ["--man-page"] => man_page(command(), None),
        ["--man-page", subcommand] => man_page(command(), Some(subcommand)),
        ["--command-line"] => {
            let mut text = serde_json::to_vec(&CommandLine::of(&command())).expect("texts are JSON");
            text.push(b'\n');
            text
        }
        ["--completions", shell, ref of @ ..] if of.len() < 2 => match Shell::from_str(shell, true) {
            Ok(shell) => completions(shell, command(), of.first().copied()),
            Err(_) => {
                eprintln!("error: {}", unknown(shell));
                return Some(ExitCode::from(2));
            }
        },
        _ => return None,
    };
    // ignore a closed pipe
    let _ = std::io::stdout().write_all(&text);
    Some(ExitCode::SUCCESS)
}

fn unknown(shell: &str) -> Error {
    let known: Vec<_> = Shell::value_variants().iter().map(ToString::to_string).collect();
    Error::input(
        format!("--completions {shell}: no such shell"),
        "each shell needs its own script",
        format!("choose one of {}", known.join(", ")),
    )
}

/// Generates the completion script for the options of the program or of one of its subcommands. A
/// subcommand is treated as a separate program. Returns an empty script if there is no such
/// subcommand.
fn completions(shell: Shell, command: Command, subcommand: Option<&str>) -> Vec<u8> {
    let command = match subcommand {
        Some(name) => command.find_subcommand(name).cloned(),
        None => Some(command),
    };
    let mut text = Vec::new();
    if let Some(mut command) = command {
        let name = command.get_name().to_owned();
        clap_complete::generate(shell, &mut command, name, &mut text);
    }
    text
}

/// Generates the manual page of the program or of one of its subcommands, in roff. Returns an empty
/// page if there is no such subcommand.
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
