//! Runs a list of cases under a job scheduler: lists the command of each stage of each row, and
//! collects the outcomes.
//!
//! [`crate::batch`] parses the list, so a list has the same meaning for a scheduler and for a
//! batch. The scheduler (`pipelines/Snakefile`) decides when and where each stage of a row runs.
//! The status file of each case records the outcome.

use crate::batch::{self, Batch, Ending, LOGS, Row};
use crate::command::{self, Programs, Volume};
use crate::folder::{CaseFolder, PAGE, STAGES};
use crate::inputs::{self, hash_program};
use crate::program;
use crate::read;
use crate::run::{Case, UNNAMED, goal_of_stage, out, problem, stage_of_goal};
use crate::settings::Settings;
use crate::stages;
use crate::status::{Problem, Stage, State, Status, Verdict};
use crate::verdict;
use isoparticles_stage::error::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Folder in OUT for the scheduler's files and the logs of the stages. Names of cases cannot start
/// with a dot.
pub const FOLDER: &str = ".cluster";

/// A row of the list in the form that the scheduler reads.
#[derive(Debug, Serialize)]
struct ListedRow {
    name: String,
    line: u64,
    /// Settings of the row, and settings of the command line that the row does not override.
    settings: BTreeMap<String, String>,
    /// Command that predicts the cost of the mesh; `None` for a phantom or a missing volume.
    info: Option<Vec<String>>,
    /// Error of a row that cannot start.
    error: Option<Problem>,
    stages: Vec<ListedStage>,
    /// Command that generates the page of the case.
    page: Option<Vec<String>>,
    /// Working directory of all commands.
    folder: PathBuf,
}

#[derive(Debug, Serialize)]
struct ListedStage {
    /// Name of the stage.
    stage: &'static str,
    /// Files that the stage reads, apart from the results of earlier stages.
    inputs: Vec<PathBuf>,
    /// Options of the stage and the hash of its program; if they change, the stage runs again.
    depends: Vec<String>,
    command: Vec<String>,
}

/// Describes each row of a list in one line of JSON.
///
/// Removes the scheduler's marker files (`OUT/.cluster/made/NAME/STAGE`) if the corresponding
/// result is missing or was made with other settings. The scheduler tracks markers instead of
/// results, because it changes the modification times of all files that it tracks.
///
/// # Errors
/// If the list is invalid; see [`Batch::make`].
pub fn rows(batch: &Batch<'_>, programs: &Programs) -> Result<Vec<String>> {
    let this = std::env::current_exe().map_err(|error| {
        Error::input(format!("{error}"), "each stage runs this program", "start it with its full path")
    })?;
    let out = out(&Settings::read(&[], batch.common, None, batch.known)?);
    let hashes: BTreeMap<&str, String> = wanted(batch)
        .into_iter()
        .map(|stage| {
            let mut files = command::program_of(stage, programs).1;
            if stage == "distfield" {
                files.extend(UNNAMED.iter().flat_map(|stage| command::program_of(stage, programs).1));
            }
            (stage, hash_program(&files))
        })
        .collect();
    let told = |row: &Row| {
        let command = |goal: &str| {
            let words = batch.arguments(goal, row, programs);
            std::iter::once(this.clone().into_os_string()).chain(words).map(text).collect::<Vec<_>>()
        };
        let mut told = ListedRow {
            name: row.name.clone(),
            line: row.line,
            settings: BTreeMap::new(),
            // A volume that must be converted cannot be described before its first stage.
            info: row
                .input()
                .filter(|path| path.exists() && !read::is_needed(path))
                .map(|path| info(row, path, &out, programs)),
            error: row.case.as_ref().err().map(problem),
            stages: Vec::new(),
            page: None,
            folder: std::env::current_dir().unwrap_or_default(),
        };
        if let Ok(case) = &row.case {
            told.settings = case.settings.parameters();
            told.settings
                .extend(case.settings.get("THREADS").map(|threads| ("THREADS".to_owned(), threads.to_owned())));
            told.page = Some(command("page"));
            forget_marks(case, &out, &wanted(batch))?;
            told.stages = wanted(batch)
                .into_iter()
                .map(|stage| {
                    let mut depends = stages::depends_on(stage, &case.settings);
                    depends.push(hashes[stage].clone());
                    ListedStage {
                        stage,
                        inputs: inputs_of(stage, case),
                        depends,
                        command: command(goal_of_stage(stage)),
                    }
                })
                .collect();
        }
        serde_json::to_string(&told).map_err(|error| {
            Error::input(format!("line {}: {error}", row.line), "the row cannot be written as JSON", "report this bug")
        })
    };
    let rows = batch.checked(programs)?;
    batch::tell_refused(&rows);
    rows.iter().map(told).collect()
}

/// Removes the markers of stages without a valid result, and the marker of a missing page.
fn forget_marks(case: &Case, out: &Path, stages: &[&str]) -> Result<()> {
    let status = case.folder.settle()?;
    for mark in stages.iter().chain(&["page"]) {
        let path = out.join(FOLDER).join("made").join(&case.folder.name).join(mark);
        let made = match *mark {
            "page" => case.folder.file(PAGE).exists(),
            stage => status.as_ref().is_some_and(|status| holds(status, case, stage)),
        };
        if path.exists() && !made {
            std::fs::remove_file(&path).map_err(|error| {
                Error::file(&path, "remove", &error, "delete it yourself; otherwise its stage is skipped")
            })?;
        }
    }
    Ok(())
}

/// Returns whether the result of a stage is unchanged and was made with the current settings.
fn holds(status: &Status, case: &Case, stage: &str) -> bool {
    let made = status.stage(stage).is_some_and(|it| it.state == State::Done && case.folder.is_intact(it));
    let then: Vec<String> = status.parameters.iter().map(|(key, value)| format!("{key}={value}")).collect();
    let same = |then: &Settings| stages::depends_on(stage, then) == stages::depends_on(stage, &case.settings);
    made && Settings::read(&then, &[], None, &[]).is_ok_and(|then| same(&then))
}

/// Returns the stages that the goal of a list requires, except `phantom` and `read`, which run in
/// the same job as `distfield`.
fn wanted(batch: &Batch<'_>) -> Vec<&'static str> {
    let last = stage_of_goal(batch.goal).unwrap_or("tetmesh-check");
    let stages: Vec<&str> = STAGES.iter().map(|it| it.stage).filter(|stage| !UNNAMED.contains(stage)).collect();
    let end = stages.iter().position(|stage| *stage == last).map_or(stages.len(), |at| at + 1);
    stages[..end].to_vec()
}

/// Returns the command that predicts the cost of meshing a volume.
fn info(row: &Row, volume: &Path, out: &Path, programs: &Programs) -> Vec<String> {
    let output = out.join(FOLDER).join("info").join(format!("{}.json", row.name));
    let program = programs.bin.join("isoparticles-volume").into_os_string();
    let mut command = vec![program, "info".into(), volume.as_os_str().to_owned()];
    let reading = row.case.iter().flat_map(|case| command::words_by_key(&command::READING_BY_KEY, &case.settings));
    command.extend(reading.map(OsString::from));
    command.extend(["--json".into(), output.into_os_string(), "--force".into()]);
    command.into_iter().map(text).collect()
}

fn inputs_of(stage: &str, case: &Case) -> Vec<PathBuf> {
    let mut paths = match (stage, &case.volume) {
        ("distfield", Volume::At(path)) => inputs::paths_of_volume(path),
        _ => Vec::new(),
    };
    paths.extend(command::keys_with_files(stage).flat_map(|key| inputs::paths_named_in(&case.settings, key)));
    if stage == "distfield" {
        paths.extend(inputs::crop_mask(&case.settings).iter().flat_map(|mask| inputs::paths_of_volume(mask)));
        paths.extend(inputs::paths_named_in(&case.settings, "PHANTOM"));
    }
    paths.iter().map(|path| absolute(path)).collect()
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf())
}

fn text(word: OsString) -> String {
    word.to_string_lossy().into_owned()
}

/// Collects the outcome of each row from its status file and logs, and writes `OUT/batch.csv`.
///
/// # Errors
/// If the list is invalid, or the summary cannot be written.
pub fn summary(batch: &Batch<'_>, programs: &Programs) -> Result<Vec<Ending>> {
    let out = out(&Settings::read(&[], batch.common, None, batch.known)?);
    let rows = batch.checked(programs)?;
    let refusals = out.join(LOGS);
    let _ = std::fs::remove_dir_all(&refusals);
    std::fs::create_dir_all(&refusals)
        .map_err(|error| Error::file(&refusals, "create", &error, "set OUT to another folder"))?;
    let endings = rows.iter().map(|row| ending(batch, row, &out)).collect::<Result<Vec<Ending>>>()?;
    batch::write_summary(&out.join("batch.csv"), &endings)?;
    Ok(endings)
}

/// Returns the outcome of a row.
fn ending(batch: &Batch<'_>, row: &Row, out: &Path) -> Result<Ending> {
    let mut ending = Ending::of_nothing(row);
    let folder = CaseFolder::new(out, &row.name);
    let log_of = |stage: &str| out.join(FOLDER).join("logs").join(&row.name).join(format!("{stage}.log"));
    let refused = match &row.case {
        Err(error) => problem(error),
        Ok(case) => {
            let status = folder.settle()?.filter(|status| is_of(status, case));
            let stopped = |stage: &&str| {
                let stage = status.as_ref().and_then(|status| status.stage(stage));
                !stage.is_some_and(|stage| stage.state == State::Done && folder.is_intact(stage))
            };
            let stopped = wanted(batch).into_iter().find(stopped);
            let log = stopped.map(log_of).filter(|path| path.is_file());
            ending.log = log.as_ref().map_or_else(String::new, |path| path.display().to_string());
            match (status, case.check()) {
                (Some(status), Ok(())) => {
                    tell(&mut ending, &status, stopped);
                    return Ok(ending);
                }
                (_, Err(error)) => problem(&error),
                (None, Ok(())) => match log {
                    Some(log) => batch::last_error_in(&log),
                    None => {
                        ending.verdict = batch::word(Verdict::Interrupted);
                        Problem {
                            what: "was not started".to_owned(),
                            why: "the case has no result".to_owned(),
                            next: "run the list again".to_owned(),
                        }
                    }
                },
            }
        }
    };
    if Status::read(&folder.status_path()).is_none() {
        let path = out.join(LOGS).join(format!("{}.status.json", row.name));
        batch::refused_status(row, &refused).write(&path)?;
    }
    (ending.headline, ending.next) = (refused.what, refused.next);
    Ok(ending)
}

/// Returns whether a status was written for the current settings and volume of the case.
fn is_of(status: &Status, case: &Case) -> bool {
    let same_volume = match &case.volume {
        Volume::Phantom => true,
        Volume::At(path) => match (status.volume(), path.canonicalize()) {
            (Some(volume), Ok(path)) => volume.path == path,
            // The status of a run that was stopped at once contains no volume.
            (volume, _) => volume.is_none(),
        },
    };
    status.parameters == case.settings.parameters() && same_volume
}

/// Copies the outcome from a status to `ending`. `stopped` is the first stage without a valid
/// result, if any.
fn tell(ending: &mut Ending, status: &Status, stopped: Option<&str>) {
    ending.seconds = status.stages.iter().filter_map(|stage| stage.seconds).sum();
    ending.verdict = batch::word(status.verdict);
    ending.headline.clone_from(&status.headline);
    let errors = status.stages.iter().filter_map(|stage| stage.error.as_ref());
    ending.next = errors.map(|error| error.next.clone()).next().unwrap_or_default();
    match stopped {
        None => ending.exit_code = Some(verdict::exit_code(status).into()),
        // The last run succeeded, but a result that the goal of the list requires is missing.
        Some(stage) if ending.is_fit() => {
            ending.verdict = batch::word(Verdict::Interrupted);
            ending.headline = format!("{stage} has no result yet, or its result was removed.");
            "run the list again; valid results are kept".clone_into(&mut ending.next);
        }
        Some(_) => {
            if ending.verdict == batch::word(Verdict::Interrupted) {
                "run the list again to resume".clone_into(&mut ending.next);
            }
            ending.exit_code = Some(verdict::exit_code(status).into());
        }
    }
}

/// Returns the status of a case if a check of `stage` failed with the current settings, so that the
/// stage would fail again. Otherwise, returns `None`.
///
/// # Errors
/// If the corrected status of a killed run cannot be written.
pub fn failed_before(case: &Case, stage: &str) -> Result<Option<Status>> {
    let status = case.folder.settle()?.filter(|status| is_of(status, case));
    let failed =
        status.as_ref().and_then(|status| status.stage(stage)).is_some_and(|it: &Stage| it.state == State::Failed);
    if failed {
        println!(
            "{stage}: not run again, because its checks failed before and nothing has changed ({} mesh runs it)",
            program::front()
        );
    }
    Ok(status.filter(|_| failed))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes the list to a temporary folder. Calls `test` with a batch of this list and the path
    /// of the folder.
    fn with_list<T>(list: &str, test: impl FnOnce(&Batch<'_>, &Path) -> T) -> T {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("cases.csv");
        std::fs::write(&path, list).expect("written");
        std::fs::write(folder.path().join("v.nrrd"), "no volume").expect("written");
        let common = [format!("OUT={}", folder.path().join("out").display()), "SCALE=0".to_owned()];
        test(&Batch { list: &path, common: &common, known: &[], goal: "surface", limit: None }, folder.path())
    }

    fn programs() -> Programs {
        let [bin, tetmesh_check] = ["nowhere", "nowhere/tetmesh-check"].map(PathBuf::from);
        Programs { bin, tetmesh_check, tetmesh_files: Vec::new(), page_files: Vec::new() }
    }

    fn told(batch: &Batch<'_>) -> Vec<serde_json::Value> {
        let rows = rows(batch, &programs()).expect("the rows");
        rows.iter().map(|row| serde_json::from_str(row).expect("JSON")).collect()
    }

    #[test]
    fn a_row_is_told_with_what_its_stages_depend_on() {
        let list = |size: &str| {
            format!("NAME,INPUT,ISO,SIZE,SCALE\none,v.nrrd,3,{size},0\ntwo,gone.nrrd,3,,\nthree,v.nrrd,3,-1,\n")
        };
        let [first, second] = ["2", "3"].map(|size| with_list(&list(size), |batch, _| told(batch)));
        let names: Vec<_> = first[0]["stages"].as_array().expect("stages").iter().map(|it| &it["stage"]).collect();
        assert_eq!(names, ["distfield", "sizefield", "seed", "particles", "reconstruct"]);
        let depends = |rows: &[serde_json::Value], at: usize| rows[0]["stages"][at]["depends"].clone();
        assert_eq!(depends(&first, 0), depends(&second, 0), "SCALE is set, so F does not depend on SIZE");
        assert_ne!(depends(&first, 1), depends(&second, 1));
        assert_eq!(first[1]["settings"]["SCALE"], "0", "what is set beside the list");
        assert_eq!(first[0]["stages"][4]["command"][1], "surface");
        assert!(
            first[1]["info"].is_null() && first[1]["error"].is_null(),
            "its first stage tells that it is not there"
        );
        assert!(first[2]["error"]["what"].as_str().expect("an error").contains("line 4 of the list"), "{}", first[2]);
    }

    #[test]
    fn a_summary_reports_rows_not_begun_and_half_made() {
        with_list("NAME,INPUT,ISO\none,v.nrrd,3\ntwo,gone.nrrd,3\nhalf,v.nrrd,3\n", |batch, folder| {
            let half = CaseFolder::new(&folder.join("out"), "half");
            drop(half.lock().expect("locked"));
            let made = Stage::nothing("distfield", State::Done);
            let parameters = [("INPUT", folder.join("v.nrrd").display().to_string()), ("ISO", "3".to_owned())];
            let parameters = parameters.into_iter().chain([("SCALE", "0".to_owned()), ("NAME", "half".to_owned())]);
            let status = Status {
                format: crate::status::FORMAT.to_owned(),
                version: crate::status::VERSION,
                name: "half".to_owned(),
                goal: "distfield".to_owned(),
                verdict: Verdict::Passed,
                headline: "The distance field is complete; every check passed.".to_owned(),
                inputs: Vec::new(),
                parameters: parameters.map(|(key, value)| (key.to_owned(), value)).collect(),
                stages: vec![made],
                page: None,
                page_key: String::new(),
            };
            status.write(&half.status_path()).expect("written");
            let marks = ["distfield", "sizefield"].map(|stage| folder.join("out/.cluster/made/half").join(stage));
            std::fs::create_dir_all(marks[0].parent().expect("a folder")).expect("made");
            marks.iter().for_each(|mark| std::fs::write(mark, "").expect("written"));
            told(batch);
            assert_eq!(marks.map(|mark| mark.exists()), [true, false], "the size field is not there");

            let endings = summary(batch, &programs()).expect("the summary");
            let found: Vec<_> = endings.iter().map(|it| (it.name.as_str(), it.verdict.as_str())).collect();
            assert_eq!(found, [("one", "interrupted"), ("two", "error"), ("half", "interrupted")]);
            assert_eq!(endings[0].headline, "was not started");
            assert!(endings[1].headline.contains("gone.nrrd: not found"), "{}", endings[1].headline);
            assert!(endings[2].headline.starts_with("sizefield has no result yet"), "{}", endings[2].headline);
            assert!(folder.join("out/batch.csv").exists() && folder.join("out/.batch/two.status.json").exists());
        });
    }
}
