//! What shells and `man` read of a program, made of its own command line: `--completions SHELL [SUBCOMMAND]`, `--man-page [SUBCOMMAND]` and
//! `--command-line`, alone on the command line.
//!
//! They stand beside the options, not among them, because a stage cannot run without its files; `make completions` calls them. By `--command-line` a stage, in
//! whichever language, tells the command that calls it what may follow its name ([`CommandLine`]).

use crate::error::Error;
use clap::{Arg, ArgAction, Command, ValueEnum, ValueHint};
use clap_complete::Shell;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::process::ExitCode;

/// What a stage may be given, as JSON between programs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CommandLine {
    /// Name of the program.
    pub name: String,
    /// Its options; files that have no name of an option are not told one by one.
    pub options: Vec<StageOption>,
}

/// An option of a stage.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageOption {
    /// Its name, without dashes.
    pub long: String,
    /// Its letter, if it has one.
    pub short: Option<char>,
    /// What follows it, such as `<mm>`; none for a switch.
    pub value: Option<String>,
    /// The words that may follow it; empty where anything may.
    pub words: Vec<String>,
    /// Whether a file or a folder follows it.
    pub is_path: bool,
    /// What it is for.
    pub help: String,
}

impl CommandLine {
    /// That of a program which clap reads the command line of.
    fn of(command: &Command) -> Self {
        let told = |arg: &Arg| {
            let value = arg.get_value_names().and_then(|names| names.first()).map(ToString::to_string);
            let words = arg.get_possible_values().into_iter().map(|word| word.get_name().to_owned()).collect();
            Some(StageOption {
                long: arg.get_long()?.to_owned(),
                short: arg.get_short(),
                value: (!is_switch(arg)).then(|| value.unwrap_or_default()),
                words: if is_switch(arg) { Vec::new() } else { words },
                is_path: PATHS.contains(&arg.get_value_hint()),
                help: arg.get_help().map(ToString::to_string).unwrap_or_default(),
            })
        };
        Self {
            name: command.get_name().to_owned(),
            options: command.get_arguments().filter(|arg| !arg.is_hide_set()).filter_map(told).collect(),
        }
    }

    /// The same as a subcommand of another program, its files included.
    #[must_use]
    pub fn command(&self) -> Command {
        // clap keeps names for as long as the program runs, which here is to print them
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
        let files = Arg::new("FILES").num_args(0..).value_hint(ValueHint::AnyPath).help("Files, by their places");
        Command::new(kept(&self.name)).args(self.options.iter().map(arg)).arg(files)
    }
}

/// What says of a value that it is a path.
const PATHS: [ValueHint; 3] = [ValueHint::AnyPath, ValueHint::FilePath, ValueHint::DirPath];

/// Whether nothing follows an option. Help and version, which clap has of itself, are in every program.
fn is_switch(arg: &Arg) -> bool {
    matches!(arg.get_action(), ArgAction::SetTrue | ArgAction::SetFalse | ArgAction::Count)
}

/// Prints what the words of the command line ask for, and gives the exit code; `None` when they ask for something else.
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

/// The script that completes the program's options in a shell, or those of one of its subcommands as of a program of that name; empty where
/// there is no such subcommand.
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
