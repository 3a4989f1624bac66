//! Checks the command lines of the stages with `--check-options` before anything is removed or
//! started.

use crate::command::{Command, Programs, Volume};
use crate::folder::{CaseFolder, STAGES, report_name};
use crate::program;
use crate::run::Case;
use crate::stages::{Planned, commands, runs};
use crate::status::{Problem, State, Status};
use isoparticles_stage::cli::check::{CHECK_OPTIONS, Known};
use isoparticles_stage::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Checks the command lines of the stages that are about to run. If the case has no earlier results
/// that the run would remove, errors in the content of the volume are ignored here; the run reports
/// them on the page of the case.
///
/// # Errors
/// If a stage rejects its command line.
pub fn planned(stages: &[Planned], case: &Case, before: Option<&Status>) -> Result<()> {
    let made = |stage: &str| !stages.iter().any(|planned| planned.name() == stage);
    // If this run makes the volume, an existing file may be out of date and is not read.
    let volume = made("phantom") && made("read");
    let materials = if made("distfield") { materials_made(&case.folder) } else { None };
    let mut known = Known { materials, volume };
    let may_lose = before.is_some_and(|status| status.stages.iter().any(|stage| stage.state == State::Done));
    for planned in stages {
        let asked = |known: &Known| ask(planned.name(), &planned.commands, known);
        known = match asked(&known) {
            Err(_) if known.volume && !may_lose => asked(&Known { volume: false, ..known })?,
            answer => answer?,
        };
    }
    Ok(())
}

/// Returns the names of the materials in the report of `distfield`.
fn materials_made(folder: &CaseFolder) -> Option<Vec<String>> {
    let text = std::fs::read(folder.path.join(report_name("distfield"))).ok()?;
    let report: serde_json::Value = serde_json::from_slice(&text).ok()?;
    let table = report["parameters"]["materials"].as_array().map(Vec::as_slice).unwrap_or_default();
    table.iter().map(|material| material["name"].as_str().map(str::to_owned)).collect()
}

/// Cache of the results of `--check-options`, by commands and known facts. Most cases of
/// a list have the same options, so most calls are avoided.
#[derive(Default)]
pub struct Answers(BTreeMap<(Vec<Command>, String), Result<Known>>);

impl Answers {
    /// Checks the options of a case for the stages up to `goal`. The check does not depend on the
    /// volume or the folder of the case.
    ///
    /// # Errors
    /// If a stage rejects its options, or the settings do not allow the goal.
    pub fn check(&mut self, case: &Case, goal: &str, programs: &Programs) -> Result<()> {
        case.check_goal(goal)?;
        // The same folder for all cases, so that equal options give equal command lines.
        let folder = CaseFolder::new(Path::new("OUT"), "NAME");
        let mut known = Known::default();
        for stage in STAGES.iter().map(|stage| stage.stage) {
            // `read` is not checked: it needs its input, and its options affect no other stage.
            if stage == "read" || !runs(stage, &case.volume) {
                continue;
            }
            let (commands, _) = commands(stage, &folder, &Volume::Phantom, &case.settings, programs);
            // A missing program is reported by the run itself.
            if commands.iter().all(|command| command.program.exists()) {
                let told = serde_json::json!(known).to_string();
                let answer = self.0.entry((commands.clone(), told));
                known = answer.or_insert_with(|| ask(stage, &commands, &known)).clone()?;
            }
            if stage == goal {
                break;
            }
        }
        Ok(())
    }
}

/// Runs the commands of a stage with `--check-options`. Returns the known facts about the case for
/// the next stage, including facts that this stage adds.
fn ask(stage: &str, commands: &[Command], known: &Known) -> Result<Known> {
    commands.iter().try_fold(known.clone(), |known, command| ask_one(stage, command, &known))
}

fn ask_one(stage: &str, Command { program, arguments }: &Command, known: &Known) -> Result<Known> {
    let mut words = vec![CHECK_OPTIONS.into(), serde_json::json!(known).to_string().into()];
    words.extend_from_slice(arguments);
    let output = program::output(program, &words)?;
    if output.status.success()
        && let Ok(known) = serde_json::from_slice(&output.stdout)
    {
        return Ok(known);
    }
    let told = Problem::last_in(&String::from_utf8_lossy(&output.stderr));
    let Some(error) = told else {
        return Err(Error::input(
            format!("{stage}: failed to check its options ({})", output.status),
            "nothing was removed or started",
            format!("see {} --help", program.display()),
        ));
    };
    let why = format!("{}; nothing was removed or started", error.why);
    Err(Error::input(format!("{stage}: {}", error.what), why, error.next))
}
