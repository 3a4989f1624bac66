//! Computes the verdict of a case, a sentence that explains the verdict, and the closing lines for
//! the terminal.

use crate::advice::{advice_for, known_advice};
use crate::folder::CaseFolder;
use crate::status::{Stage, State, Status, Verdict};
use isoparticles_stage::cli::FIT_BUT_FOR;
use std::fmt::Write;

/// Returns the verdict that follows from the states of the stages, and a sentence that explains the
/// verdict.
#[must_use]
pub fn of(status: &Status) -> (Verdict, String) {
    let stages = &status.stages;
    let at = |state: State| stages.iter().find(|stage| stage.state == state);
    if let Some(stage) = at(State::Error) {
        let what = stage.error.as_ref().map_or("no error message", |error| error.what.as_str());
        return (Verdict::Error, format!("{} stopped with an error: {what}", stage.stage));
    }
    if let Some(stage) = at(State::Failed) {
        return (Verdict::Failed, failed(stage));
    }
    if let Some(stage) = at(State::Interrupted) {
        return (Verdict::Interrupted, format!("Stopped in {}; run it again to resume.", stage.stage));
    }
    let made = stages.iter().rev().find(|stage| stage.state == State::Done);
    let Some(made) = made else { return (Verdict::Interrupted, "Stopped before its first stage.".to_owned()) };
    let result = match made.stage.as_str() {
        "tetmesh-check" => "The surface and its tetrahedra are complete",
        "reconstruct" => "The surface is complete",
        "distfield" => "The distance field is complete",
        "sizefield" => "The size field is complete",
        "seed" => "The seeds are complete",
        "particles" => "The particles are settled",
        _ => "The volume is complete",
    };
    let warnings = || stages.iter().flat_map(|stage| &stage.warnings);
    let accepted: Vec<&str> = warnings().filter_map(|words| words.strip_prefix(FIT_BUT_FOR)).collect();
    if !accepted.is_empty() {
        return (Verdict::Warning, format!("{result}; {FIT_BUT_FOR}{}.", accepted.join(" and ")));
    }
    match warnings().count() {
        0 => (Verdict::Passed, format!("{result}; every check passed.")),
        1 => (Verdict::Warning, format!("{result}; every check passed, with a warning.")),
        count => (Verdict::Warning, format!("{result}; every check passed, with {count} warnings.")),
    }
}

fn failed(stage: &Stage) -> String {
    match stage.failed_checks.as_slice() {
        [] => format!("{}: a check failed.", stage.stage),
        [check] => format!("{}: a check failed: {check}", stage.stage),
        [first, others @ ..] => format!("{}: {} checks failed: {first}; ...", stage.stage, others.len() + 1),
    }
}

/// Returns the closing lines for the terminal: results, failures, warnings, status and page.
#[must_use]
pub fn closing(folder: &CaseFolder, status: &Status) -> String {
    let word = match status.verdict {
        Verdict::Passed => "passed",
        Verdict::Warning => "passed with warnings",
        Verdict::Failed => "NOT FIT: a check failed",
        Verdict::Error => "ERROR",
        Verdict::Interrupted => "INTERRUPTED",
        Verdict::Running => "still running",
    };
    let mut text = format!("\n{}: {word}\n  {}\n", status.name, status.headline);
    let mut line = |label: &str, value: &dyn std::fmt::Display| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {label:<11} {value}");
    };
    let path = |name: &str| folder.path.join(name);
    for (label, stage) in [("surface", "reconstruct"), ("tetrahedra", "tetmesh-check")] {
        let done = status.stage(stage).filter(|stage| stage.state == State::Done);
        if done.is_some() {
            line(label, &folder.file(crate::folder::belongings(stage).output).display());
        }
    }
    for stage in &status.stages {
        for check in &stage.failed_checks {
            line("failed", &format!("{}: {check}", stage.stage));
            if let Some(advice) = advice_for(check, &status.parameters) {
                line("what to do", &advice);
            }
        }
        if let Some(error) = &stage.error {
            line("what to do", &error.next);
        }
        for name in stage.kept.iter().filter(|name| !name.contains('/')) {
            line("kept", &path(name).display());
        }
    }
    for stage in &status.stages {
        for warning in &stage.warnings {
            line("warning", &format!("{}: {warning}", stage.stage));
            // Warnings of all other stages already contain advice.
            let advice = known_advice(warning, &status.parameters).filter(|_| stage.stage == "tetmesh-check");
            if let Some(advice) = advice {
                line("what to do", &advice);
            }
        }
    }
    line("status", &folder.status_path().display());
    if let Some(page) = &status.page {
        line("page", &path(page).display());
    }
    text
}

/// Returns the exit code: 0 if the case passed, 1 if a check failed, 2 after an error, 3 without a
/// usable GPU, and 130 if the run was interrupted or is in progress.
#[must_use]
pub fn exit_code(status: &Status) -> u8 {
    match status.verdict {
        Verdict::Passed | Verdict::Warning => 0,
        Verdict::Failed => 1,
        Verdict::Error => {
            let gpu = status.stages.iter().any(|stage| stage.state == State::Error && stage.exit_code == Some(3));
            if gpu { 3 } else { 2 }
        }
        Verdict::Interrupted | Verdict::Running => 130,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use std::path::Path;

    /// Returns the status of a case with these stages.
    fn status(stages: Vec<Stage>) -> Status {
        Status {
            format: String::new(),
            version: 1,
            name: "case".to_owned(),
            goal: "mesh".to_owned(),
            verdict: Verdict::Running,
            headline: String::new(),
            inputs: Vec::new(),
            parameters: BTreeMap::from([("SIZE".to_owned(), "2".to_owned())]),
            stages,
            page: None,
            page_key: String::new(),
        }
    }

    #[test]
    fn advice_follows_each_failed_check() {
        let mut stage = Stage::nothing("reconstruct", State::Failed);
        stage.failed_checks = vec!["2 pairs of intersecting triangles".to_owned()];
        let text = closing(&CaseFolder::new(Path::new("out"), "case"), &status(vec![stage]));
        let lines: Vec<&str> = text.lines().map(str::trim_start).collect();
        let at = lines.iter().position(|line| line.starts_with("failed ")).expect("a failed check");
        assert!(lines[at + 1].starts_with("what to do ") && lines[at + 1].contains("a smaller SIZE"), "{text}");
    }

    #[test]
    fn the_verdict_names_accepted_elements() {
        let mut stage = Stage::nothing("tetmesh-check", State::Done);
        let mut status = status(vec![stage.clone()]);
        assert_eq!(of(&status).0, Verdict::Passed);
        stage.warnings = vec!["another".to_owned(), format!("{FIT_BUT_FOR}2 accepted tetrahedra: flat")];
        status.stages = vec![stage];
        let (verdict, headline) = of(&status);
        assert_eq!(verdict, Verdict::Warning);
        assert!(headline.ends_with("complete; fit but for 2 accepted tetrahedra: flat."), "{headline}");
    }
}
