//! Describes the options of the stages and the keys of a case, from which the Python package makes
//! its typed keyword arguments.

use crate::errors::raised;
use clap::builder::ValueParser;
use clap::{Arg, ArgAction, Command, CommandFactory};
use isoparticles_case::command;
use isoparticles_case::keys::{Form, KEYS};
use isoparticles_case::name::of_volume;
use isoparticles_case::settings::Settings;
use isoparticles_stage::cli::{FILES, SHARED_OPTIONS};
use pyo3::prelude::*;
use serde_json::{Value, json};
use std::any::TypeId;
use std::path::PathBuf;

/// The stages in order.
const STAGES: [&str; 5] = ["distfield", "sizefield", "seed", "particles", "reconstruct"];

/// The shared options that have a meaning without a terminal.
const SHARED: [&str; 3] = ["threads", "max-memory", "seed"];

/// Returns the options of every stage as JSON: a table of lists, by the name of the stage.
#[pyfunction]
pub(crate) fn options() -> String {
    let table: Value = STAGES.iter().map(|&stage| (stage.to_owned(), json!(of_command(&command(stage))))).collect();
    table.to_string()
}

fn command(stage: &str) -> Command {
    match stage {
        "distfield" => isoparticles_distfield::run::Args::command(),
        "sizefield" => isoparticles_sizefield::run::Args::command(),
        "seed" => isoparticles_seed::run::Args::command(),
        "particles" => isoparticles_particles::args::Args::command(),
        _ => isoparticles_reconstruct::run::Args::command(),
    }
}

fn of_command(command: &Command) -> Vec<Value> {
    command.get_arguments().filter(|arg| is_for_library(arg)).filter_map(described).collect()
}

/// Returns whether an option has a meaning for a stage that reads and writes no files.
fn is_for_library(arg: &Arg) -> bool {
    let name = arg.get_long().unwrap_or_default();
    let fits = match arg.get_help_heading() {
        Some(FILES) => ["series", "crop", "downsample"].contains(&name),
        Some(SHARED_OPTIONS) => SHARED.contains(&name),
        _ => name != "list-adapters",
    };
    fits && !arg.is_hide_set()
}

fn described(arg: &Arg) -> Option<Value> {
    let is_flag = matches!(arg.get_action(), ArgAction::SetTrue);
    let words: Vec<String> = arg.get_possible_values().iter().map(|word| word.get_name().to_owned()).collect();
    let default = arg.get_default_values().first().map(|value| value.to_string_lossy());
    Some(json!({
        "name": arg.get_long()?,
        "kind": if is_flag { "flag" } else { kind(arg.get_value_parser(), &words) },
        "words": if is_flag { Vec::new() } else { words },
        "repeated": matches!(arg.get_action(), ArgAction::Append),
        "hyphen": arg.is_allow_hyphen_values_set() || arg.is_allow_negative_numbers_set(),
        "default": default.filter(|_| !is_flag),
        "help": arg.get_help().map(ToString::to_string).unwrap_or_default(),
    }))
}

fn kind(parser: &ValueParser, words: &[String]) -> &'static str {
    let parsed = parser.type_id();
    match () {
        () if !words.is_empty() => "word",
        () if parsed == TypeId::of::<f64>() => "number",
        () if [TypeId::of::<u64>(), TypeId::of::<u32>(), TypeId::of::<u16>(), TypeId::of::<usize>()]
            .iter()
            .any(|id| parsed == *id) =>
        {
            "whole"
        }
        () => "text",
    }
}

/// Returns the keys of a case as JSON: a list of names, kinds, words and descriptions.
#[pyfunction]
pub(crate) fn case_keys() -> String {
    let described = |key: &isoparticles_case::keys::Key| {
        let (kind, words) = match key.form {
            Form::Text | Form::Words => ("text", &[][..]),
            Form::Number | Form::Positive | Form::NotNegative => ("number", &[][..]),
            Form::Whole(_) => ("whole", &[][..]),
            Form::OneOf(words) => ("word", words),
        };
        json!({"name": key.name, "kind": kind, "words": words, "help": key.what})
    };
    json!(KEYS.iter().map(described).collect::<Vec<_>>()).to_string()
}

/// Returns the options of each stage, as command-line words, for settings such as `LABELS=1,2`.
#[pyfunction]
pub(crate) fn case_words(py: Python<'_>, settings: Vec<String>) -> PyResult<Vec<(&'static str, Vec<String>)>> {
    let settings = Settings::read(&settings, &[], None, &[]).map_err(|error| raised(py, error))?;
    Ok(STAGES.iter().map(|&stage| (stage, command::options(stage, &settings))).collect())
}

/// Returns the name of the case of a volume.
#[pyfunction]
pub(crate) fn case_name(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    of_volume(&path).map_err(|error| raised(py, error))
}
