//! Runs a case: finds the stages that have to run, removes results that are out of date, runs the
//! stages and updates the status.

use crate::command::{Programs, Volume, open_border};
use crate::folder::{Belongings, CHECKPOINT, CaseFolder, PAGE, STAGES, belongings, report_name};
use crate::inputs::{self, hash_program};
use crate::program::{self, Ended};
use crate::settings::Settings;
use crate::stages::{Plan, Planned, plan};
use crate::status::{FORMAT, Input, Problem, Stage, State, Status, VERSION, VOLUME, Verdict};
use crate::{check, name, read, updates, verdict};
use isoparticles_stage::error::{Error, Result};
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A case as described by its settings. None of its files has been read yet.
#[derive(Debug)]
pub struct Case {
    /// Folder of the results.
    pub folder: CaseFolder,
    /// The volume to mesh.
    pub volume: Volume,
    /// The settings.
    pub settings: Settings,
}

impl Case {
    /// Returns the case that the settings describe.
    ///
    /// # Errors
    /// If the settings specify no volume, or if the name of the results is invalid.
    pub fn new(settings: Settings) -> Result<Self> {
        let volume = match (settings.get("PHANTOM"), settings.get("INPUT")) {
            (Some(_), _) => Volume::Phantom,
            (None, Some(path)) => Volume::At(PathBuf::from(path)),
            (None, None) => {
                return Err(Error::input(
                    "INPUT is not set",
                    "INPUT is the volume to mesh",
                    format!("set INPUT, for example: {} mesh INPUT=v.nrrd ISO=300", program::front()),
                ));
            }
        };
        let name = match (settings.get("NAME"), settings.case_file(), &volume) {
            (Some(name), _, _) | (None, Some(name), _) => name.to_owned(),
            (None, None, Volume::At(path)) => name::of_volume(path)?,
            (None, None, Volume::Phantom) => "phantom".to_owned(),
        };
        name::check(&name)?;
        let folder = CaseFolder::new(&out(&settings), &name);
        Ok(Self { folder, volume, settings })
    }

    /// Checks the settings before any work starts.
    ///
    /// # Errors
    /// If the volume is missing, if none of ISO, LABELS and MATERIALS is set, or if INSIDE is
    /// combined with labels.
    pub fn check(&self) -> Result<()> {
        if let Volume::At(path) = &self.volume
            && !path.exists()
        {
            return Err(Error::input(
                format!("{}: not found", path.display()),
                "this is the volume to mesh",
                "check INPUT; for a case of pipelines/, set DATA to the folder of the volumes",
            ));
        }
        read::check(&self.volume, &self.settings)?;
        let of_labels = ["LABELS", "MATERIALS"].into_iter().find(|key| self.settings.get(key).is_some());
        if self.settings.get("ISO").is_none() && of_labels.is_none() {
            return Err(Error::input(
                "neither ISO nor LABELS nor MATERIALS is set",
                "one of them selects what to mesh",
                format!(
                    "set ISO=value, LABELS=1,2 or MATERIALS=all ({} info INPUT=... proposes values)",
                    program::front()
                ),
            ));
        }
        if let Some(key) = of_labels.filter(|_| self.settings.get("INSIDE").is_some()) {
            return Err(Error::input(
                format!("INSIDE and {key} are both set"),
                "INSIDE selects a side of the iso value, and labels have none",
                format!("set INSIDE with ISO, or {key} without INSIDE"),
            ));
        }
        Ok(())
    }

    /// Checks that the settings allow a goal whose last stage is `stage`.
    ///
    /// # Errors
    /// If the goal requires tetrahedra, but the settings give an open surface.
    pub(crate) fn check_goal(&self, stage: &str) -> Result<()> {
        // With many materials, distfield itself rejects an open border.
        let of_one_object = self.settings.get("MATERIALS").is_none();
        let Some(set_by) = open_border(&self.settings).filter(|_| stage == "tetmesh-check" && of_one_object) else {
            return Ok(());
        };
        Err(Error::input(
            format!("{set_by} gives an open surface"),
            "tetrahedra cannot fill an open surface; nothing was removed or started",
            format!("use `{} surface` to stop at the triangles, or BORDER=cap to close the surface", program::front()),
        ))
    }
}

/// Returns the folder OUT, which contains the folders of all cases.
#[must_use]
pub fn out(settings: &Settings) -> PathBuf {
    PathBuf::from(settings.get("OUT").unwrap_or("out"))
}

/// Runs a case up to the stage `goal`. The returned status records the outcome, even if a stage
/// failed.
///
/// # Errors
/// If the run cannot start, in which case earlier results are unchanged, or if a file of the case
/// cannot be written or removed.
pub fn make(case: &Case, goal: &str, programs: &Programs) -> Result<Status> {
    case.check()?;
    case.check_goal(goal)?;
    let folder = &case.folder;
    let _lock = if folder.path.is_dir() { Some(folder.lock()?) } else { None };
    let before = Status::read(&folder.status_path());
    let plan = plan(folder, &case.settings, &case.volume, programs, before.as_ref())?;
    if let Some(before) = &before {
        refuse_another_volume(case, before, &plan)?;
    }
    let to_run = to_run(folder, goal, &plan, before.as_ref());
    check::planned(plan.stages.get(to_run.clone()).unwrap_or_default(), case, before.as_ref())?;
    let _lock = match _lock {
        Some(lock) => lock,
        None => folder.lock()?,
    };
    program::listen();
    let mut run = Run::begin(case, goal, to_run, plan, before)?;
    run.go()?;
    run.finish(programs)?;
    Ok(run.status)
}

/// Returns the indices of the stages that have to run: from the first stage without a valid result
/// up to the goal.
fn to_run(folder: &CaseFolder, goal: &str, plan: &Plan, before: Option<&Status>) -> Range<usize> {
    let holds = |planned: &Planned| {
        let earlier = before.and_then(|status| status.stage(planned.name()));
        earlier.is_some_and(|stage| stage.state == State::Done && stage.key == planned.key && folder.is_intact(stage))
    };
    let first = plan.stages.iter().position(|planned| !holds(planned)).unwrap_or(plan.stages.len());
    let goal = plan.stages.iter().position(|planned| planned.name() == goal);
    first..goal.map_or(plan.stages.len(), |position| position + 1)
}

/// Returns an error if the run would replace the results of a different volume.
fn refuse_another_volume(case: &Case, before: &Status, plan: &Plan) -> Result<()> {
    let described = |input: Option<&Input>| input.map_or("a phantom".to_owned(), |it| it.path.display().to_string());
    let then = before.volume().filter(|_| before.stage("phantom").is_none());
    let now = plan.inputs.iter().find(|input| input.role == VOLUME);
    let same = match (then, now) {
        (Some(then), Some(now)) => then.path == now.path || then.hash == now.hash,
        (then, now) => then.is_some() == now.is_some(),
    };
    if same {
        return Ok(());
    }
    let name = &case.folder.name;
    Err(Error::input(
        format!(
            "{}: contains the results of {}, but this run meshes {}",
            case.folder.path.display(),
            described(then),
            described(now),
        ),
        format!("both have the name {name}, and the earlier results would be replaced"),
        format!(
            "set another NAME for this run, or remove the earlier results ({} clean NAME='{name}')",
            program::front()
        ),
    ))
}

/// A run in progress.
struct Run<'a> {
    case: &'a Case,
    plan: Plan,
    status: Status,
    /// Indices of the stages to run; empty if all results are valid.
    to_run: Range<usize>,
}

impl<'a> Run<'a> {
    /// Starts a run: keeps the valid results, marks the other results as stale and removes them.
    fn begin(case: &'a Case, goal: &str, to_run: Range<usize>, plan: Plan, before: Option<Status>) -> Result<Self> {
        let folder = &case.folder;
        let earlier = |planned: &Planned| before.as_ref().and_then(|status| status.stage(planned.name()));
        let next = to_run.start;
        let mut stages = Vec::new();
        for (position, planned) in plan.stages.iter().enumerate() {
            stages.push(match earlier(planned) {
                Some(stage) if position < next => Stage { made: false, ..stage.clone() },
                Some(stage) if stage.state != State::NotReached => Stage::nothing(planned.name(), State::Stale),
                _ => Stage::nothing(planned.name(), State::NotReached),
            });
        }
        let mut inputs = plan.inputs.clone();
        if next > 0 && case.volume == Volume::Phantom {
            inputs.extend(before.as_ref().and_then(Status::volume).cloned());
        }
        let (page, page_key) = before.as_ref().map_or_else(Default::default, |b| (b.page.clone(), b.page_key.clone()));
        let status = Status {
            format: FORMAT.to_owned(),
            version: VERSION,
            name: folder.name.clone(),
            goal: goal_of_stage(goal).to_owned(),
            verdict: Verdict::Running,
            headline: "A run is in progress.".to_owned(),
            inputs,
            parameters: case.settings.parameters(),
            stages,
            page,
            page_key,
        };
        let checkpoint = plan.stages.get(next).filter(|planned| {
            planned.name() == "particles" && earlier(planned).is_some_and(|stage| stage.key == planned.key)
        });
        let checkpoint = checkpoint.is_some();
        let mut run = Self { case, plan, status, to_run };
        run.remove_stale(before.as_ref(), checkpoint)?;
        Ok(run)
    }

    /// Removes the files of all stages without a valid result. If `checkpoint` is true, keeps the
    /// checkpoint and the log of `particles`.
    fn remove_stale(&mut self, before: Option<&Status>, checkpoint: bool) -> Result<()> {
        let folder = &self.case.folder;
        let earlier = |stage: &Belongings| before.and_then(|status| status.stage(stage.stage));
        let holds = |stage: &Belongings| {
            self.status.stage(stage.stage).is_some_and(|stage| stage.state == State::Done)
                // A volume in the folder of the results may belong to the user.
                || (stage.stage == "phantom" && self.case.volume != Volume::Phantom)
        };
        let stale: Vec<&Belongings> = STAGES.iter().filter(|stage| !holds(stage)).collect();
        if stale.iter().any(|stage| !folder.made_before(stage, earlier(stage)).is_empty()) || !self.to_run.is_empty() {
            self.status.page = None;
            self.write()?;
            folder.remove(&folder.file_name(PAGE))?;
        }
        for stage in stale {
            let keep: &[&str] =
                if stage.stage == "particles" && checkpoint { &[CHECKPOINT, "passes.csv"] } else { &[] };
            folder.remove_files_of(stage, earlier(stage), keep)?;
        }
        self.write()
    }

    fn write(&self) -> Result<()> {
        self.status.write(&self.case.folder.status_path())
    }

    /// Runs the stages that have to run, and stops after the first stage that does not succeed.
    fn go(&mut self) -> Result<()> {
        let confirmed: Vec<&str> = self.plan.stages[..self.to_run.start].iter().map(Planned::name).collect();
        if !confirmed.is_empty() {
            say(&format!("up to date: {}", confirmed.join(", ")));
        }
        for position in self.to_run.clone() {
            if program::stop_requested() {
                self.status.stages[position].state = State::Interrupted;
                break;
            }
            self.run_stage(position)?;
            self.write()?;
            if self.status.stages[position].state != State::Done {
                break;
            }
        }
        Ok(())
    }

    /// Runs one stage and records the outcome.
    fn run_stage(&mut self, position: usize) -> Result<()> {
        let (folder, planned) = (&self.case.folder, &self.plan.stages[position]);
        let command = planned.command_line();
        let key = planned.key.clone();
        let stage =
            Stage { made: true, command: Some(command.clone()), key, ..Stage::nothing(planned.name(), State::Running) };
        self.status.stages[position] = stage.clone();
        self.write()?;
        say(&command);
        // Files that exist at this point belong to the user and are left in place, except files
        // with the stage's fixed names. These are the checkpoint and the log from which a stopped
        // run resumes, and files that a stage wrote after its run was killed.
        let mut others = folder.files_of(planned.belongings);
        others.retain(|name| !folder.is_usual(planned.belongings, name));
        let started = Instant::now();
        let ended = updates::run(folder, &planned.commands);
        let seconds = Some(started.elapsed().as_secs_f64());
        let mut stage = Stage { seconds, ..stage };
        let report = planned.report.as_deref().and_then(|name| Report::read(&folder.path.join(name)));
        match ended {
            Ok(ended) => judge(&mut stage, ended, report.as_ref(), &folder.file(planned.belongings.output)),
            Err(error) => (stage.state, stage.error) = (State::Error, Some(problem(&error))),
        }
        if stage.state == State::Done {
            // A finished run needs no checkpoint.
            folder.remove(&folder.file_name(CHECKPOINT))?;
            stage.outputs = folder.files_of(planned.belongings);
            stage.outputs.retain(|name| !others.contains(name));
            if planned.name() == "phantom" {
                let path = folder.file(planned.belongings.output);
                self.status.inputs.extend(inputs::of_volume(&path, None)?);
            }
        } else {
            stage.kept = folder.set_aside(planned.belongings, &others)?;
            if let Some(error) = &stage.error
                && report.is_none()
            {
                complain(&format!(
                    "error: {}\n  why it matters: {}\n  what to do: {}",
                    error.what, error.why, error.next
                ));
            }
            for kept in stage.kept.iter().filter(|name| name.contains(".failed.")) {
                complain(&format!("{}: its output is kept as {}", stage.stage, folder.path.join(kept).display()));
            }
        }
        stage.report = report_left(folder, planned, &stage);
        stage.identities = folder.identities(&stage.outputs);
        self.status.stages[position] = stage;
        Ok(())
    }

    /// Sets the verdict and generates the page.
    fn finish(&mut self, programs: &Programs) -> Result<()> {
        program::note_stop();
        (self.status.verdict, self.status.headline) = verdict::of(&self.status);
        let folder = &self.case.folder;
        let page = folder.file(PAGE);
        let told = (&self.status.verdict, &self.status.stages, &self.status.parameters, &self.status.inputs);
        let told = serde_json::to_string(&told).unwrap_or_default() + &hash_program(&programs.page_files);
        // The page is the same whether this run or an earlier run made a result, so the key must be
        // the same too.
        let told = told.replace("\"made\":true", "\"made\":false");
        let key = blake3::hash(told.as_bytes()).to_hex().to_string();
        if key == self.status.page_key && self.status.page.is_some() && page.exists() {
            return self.write();
        }
        self.status.page_key = key;
        make_page(folder, &mut self.status, programs)
    }
}

/// Generates the page of a case if the page program is installed, and writes the status with the
/// file name of the page.
///
/// # Errors
/// If the status cannot be written, or an old page cannot be removed.
pub fn make_page(folder: &CaseFolder, status: &mut Status, programs: &Programs) -> Result<()> {
    let (program, page) = (programs.page(), folder.file_name(PAGE));
    folder.remove(&page)?;
    if !program.exists() {
        status.page = None;
        say(&format!("no page: {} is missing (make env installs it)", program.display()));
        return status.write(&folder.status_path());
    }
    status.page = Some(page.clone());
    status.write(&folder.status_path())?;
    let (from, to) = (folder.status_path().into_os_string(), folder.file(PAGE).into_os_string());
    let ended = program::run(&program, &[from, "-o".into(), to, "--force".into()]);
    if !matches!(ended, Ok(Ended::Code(0))) || !folder.file(PAGE).exists() {
        complain(&format!("warning: {}: the page was not made", program.display()));
        status.page = None;
        folder.remove(&page)?;
        status.write(&folder.status_path())?;
    }
    Ok(())
}

/// Returns the path of the report that a stage wrote, if there is one. The report of
/// `tetmesh-check` is a result of the case; the folder of reports gets a copy of it.
fn report_left(folder: &CaseFolder, planned: &Planned, stage: &Stage) -> Option<String> {
    let name = planned.report.clone()?;
    let common = report_name(planned.name());
    if name == common {
        return folder.path.join(&name).is_file().then_some(name);
    }
    let left = stage.outputs.iter().chain(&stage.kept).find(|file| file.ends_with(".json"))?;
    // The copy lets programs find the reports of all stages in one folder. The result does not
    // depend on the copy, so errors are ignored.
    let _ = std::fs::copy(folder.path.join(left), folder.path.join(common));
    Some(left.clone())
}

/// A stage's report in JSON.
struct Report(serde_json::Value);

impl Report {
    fn read(path: &Path) -> Option<Self> {
        Some(Self(serde_json::from_slice(&std::fs::read(path).ok()?).ok()?))
    }

    fn texts(&self, key: &str) -> Vec<String> {
        let texts = self.0[key].as_array().map(Vec::as_slice).unwrap_or_default();
        texts.iter().filter_map(|text| text.as_str().map(str::to_owned)).collect()
    }

    fn error(&self) -> Option<Problem> {
        serde_json::from_value(self.0.get("error")?.clone()).ok()
    }
}

/// Records in `stage` how its program ended.
fn judge(stage: &mut Stage, ended: Ended, report: Option<&Report>, output: &Path) {
    if let Some(report) = report {
        stage.warnings = report.texts("warnings");
        stage.failed_checks = report.texts("failed_checks");
        stage.error = report.error();
    }
    let name = &stage.stage;
    let unexplained = |what: String, next: &str| {
        let why = "later stages need its result".to_owned();
        Some(Problem { what, why, next: next.to_owned() })
    };
    stage.exit_code = if let Ended::Code(code) = ended { Some(code) } else { None };
    stage.state = match ended {
        Ended::Code(0) if output.is_file() => State::Done,
        Ended::Code(1) => State::Failed,
        Ended::Code(130) => State::Interrupted,
        Ended::Signal(_) if program::stop_requested() => State::Interrupted,
        _ => State::Error,
    };
    if stage.state != State::Error || stage.error.is_some() {
        return;
    }
    stage.error = match ended {
        Ended::Code(0) => unexplained(
            format!("{name}: ended successfully, but {} is missing", output.display()),
            "run the case again; if it happens again, report this bug",
        ),
        Ended::Code(code) => unexplained(
            format!("{name}: ended with exit code {code} and wrote no report"),
            "see its messages above; often an option is unknown",
        ),
        Ended::Signal(signal) => unexplained(
            format!("{name}: was terminated by signal {signal}"),
            "if the signal is 9, memory ran out: raise SIZE or MIN_SIZE, or use a machine with more memory; \
             otherwise report this bug",
        ),
    };
}

pub(crate) fn problem(error: &Error) -> Problem {
    Problem { what: error.what.clone(), why: error.why.clone(), next: error.next.clone() }
}

/// Prints a line on stdout.
fn say(text: &str) {
    // A closed pipe must not end the run.
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// Prints a line on stderr.
fn complain(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Stages that are part of the goal `distfield`.
pub(crate) const UNNAMED: [&str; 2] = ["phantom", "read"];

/// Returns the last stage that a goal requires.
#[must_use]
pub fn stage_of_goal(goal: &str) -> Option<&'static str> {
    match goal {
        "mesh" => Some("tetmesh-check"),
        "surface" => Some("reconstruct"),
        _ => STAGES.iter().map(|stage| stage.stage).find(|stage| *stage == goal && !UNNAMED.contains(stage)),
    }
}

/// Returns the name of the goal whose last stage is `stage`.
pub(crate) fn goal_of_stage(stage: &str) -> &str {
    match stage {
        "tetmesh-check" => "mesh",
        "reconstruct" => "surface",
        stage => stage,
    }
}

/// Generates the page of a case from its current status.
///
/// # Errors
/// If there is no status, or a run is in progress.
pub fn page(folder: &CaseFolder, programs: &Programs) -> Result<Status> {
    let mut status = status_of(folder)?;
    let _lock = folder.lock()?;
    make_page(folder, &mut status, programs)?;
    Ok(status)
}

/// Returns the status of a case from an earlier run.
///
/// # Errors
/// If there is no status.
pub fn status_of(folder: &CaseFolder) -> Result<Status> {
    folder.settle()?.ok_or_else(|| {
        Error::input(
            format!("{}: not found", folder.status_path().display()),
            "this file records the outcome of the case",
            format!("run `{} mesh NAME={} ...` first, or check CASE, NAME and OUT", program::front(), folder.name),
        )
    })
}

/// Returns the path of a stage's output in the folder of the case.
#[must_use]
pub fn output_of(folder: &CaseFolder, stage: &str) -> PathBuf {
    folder.file(belongings(stage).output)
}
