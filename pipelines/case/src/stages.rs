//! Plans the stages of a case: their commands, and the hashes that determine which stages have to
//! run again.

use crate::command::{Command, Programs, Volume, arguments, keys_with_files, options, program_of, resizes};
use crate::folder::{Belongings, CaseFolder, STAGES};
use crate::inputs::{self, hash_program};
use crate::read;
use crate::settings::Settings;
use crate::status::{Input, Status};
use crate::updates;
use isoparticles_stage::error::{Error, Result};

/// One stage, ready to run.
#[derive(Debug)]
pub struct Planned {
    /// The files of the stage.
    pub belongings: &'static Belongings,
    /// The commands of the stage, which run in this order.
    pub commands: Vec<Command>,
    /// Path of the report, relative to the folder of the case; `None` for the phantom.
    pub report: Option<String>,
    /// Hash of everything that the result depends on, including earlier stages.
    pub key: String,
}

impl Planned {
    /// Returns the name of the stage.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.belongings.stage
    }

    /// Returns the command lines, quoted for a shell, one per line.
    #[must_use]
    pub fn command_line(&self) -> String {
        self.commands.iter().map(Command::line).collect::<Vec<_>>().join("\n")
    }
}

/// All stages of a case in order, and the files that they depend on.
#[derive(Debug)]
pub struct Plan {
    /// The stages. The first one is `phantom` if the volume is a phantom, or `read` if the volume
    /// has to be converted.
    pub stages: Vec<Planned>,
    /// The volume and every file that an option names.
    pub inputs: Vec<Input>,
}

/// Plans the stages of a case.
///
/// # Errors
/// If a file that the case depends on cannot be read, or is one of the case's own results.
pub fn plan(
    folder: &CaseFolder,
    settings: &Settings,
    volume: &Volume,
    programs: &Programs,
    before: Option<&Status>,
) -> Result<Plan> {
    let mut plan = Plan { stages: Vec::new(), inputs: Vec::new() };
    let mut earlier = String::new();
    for belongings in &STAGES {
        let name = belongings.stage;
        if !runs(name, volume) {
            continue;
        }
        let mut inputs = match (name, volume) {
            ("read", Volume::At(path)) => inputs::of_volume(path, before)?,
            ("distfield", Volume::At(path)) if !read::is_needed(path) => inputs::of_volume(path, before)?,
            _ => Vec::new(),
        };
        if name == "distfield" {
            inputs.extend(inputs::of_crop(settings, before)?);
        }
        for key in keys_with_files(name) {
            inputs.extend(inputs::named_in(settings, key, before)?);
        }
        let options = options(name, settings);
        let hxt = hxt(name, settings);
        let (_, files) = program_of(name, programs);
        // The key depends on the content and extension of a file, not on its path.
        let contents: Vec<_> = inputs.iter().map(|input| (&input.hash, input.path.extension())).collect();
        let resizes = resizes(name, settings);
        let text =
            format!("{name}\n{options:?}{resizes:?}\n{hxt:?}\n{contents:?}\n{}\n{earlier}", hash_program(&files));
        let key = blake3::hash(text.as_bytes()).to_hex().to_string();
        earlier.clone_from(&key);
        plan.inputs.extend(inputs);
        let (commands, report) = commands(name, folder, volume, settings, programs);
        plan.stages.push(Planned { belongings, commands, report, key });
    }
    refuse_own_results(folder, &plan.inputs)?;
    Ok(plan)
}

/// Returns whether a stage is part of a case with this volume.
pub(crate) fn runs(stage: &str, volume: &Volume) -> bool {
    match stage {
        "phantom" => *volume == Volume::Phantom,
        "read" => matches!(volume, Volume::At(path) if read::is_needed(path)),
        _ => true,
    }
}

/// Returns the settings that may change the result of a stage, apart from input files and earlier
/// stages. The options of `phantom` and `read` count as settings of `distfield`.
#[must_use]
pub fn depends_on(stage: &str, settings: &Settings) -> Vec<String> {
    let mut words = if stage == "distfield" { settings.words("PHANTOM") } else { Vec::new() };
    if stage == "distfield" && read::is_set(settings) {
        words.extend(options("read", settings));
    }
    words.extend(options(stage, settings));
    words.extend(resizes(stage, settings));
    words.extend(hxt(stage, settings).map(str::to_owned));
    words
}

/// Returns the HXT setting if `stage` is `tetmesh-check`. The same options give different
/// tetrahedra with and without Gmsh.
fn hxt<'a>(stage: &str, settings: &'a Settings) -> Option<&'a str> {
    settings.get("HXT").filter(|_| stage == "tetmesh-check")
}

/// Returns the commands of a stage, and the path of its report.
#[must_use]
pub fn commands(
    stage: &str,
    folder: &CaseFolder,
    volume: &Volume,
    settings: &Settings,
    programs: &Programs,
) -> (Vec<Command>, Option<String>) {
    let (arguments, report) = arguments(stage, folder, volume, options(stage, settings), settings);
    let first = Command { program: program_of(stage, programs).0, arguments };
    let regions = resizes(stage, settings);
    let commands =
        if regions.is_empty() { vec![first] } else { updates::commands(first, folder, &regions, settings, programs) };
    (commands, report)
}

/// Returns an error if an input is a result of the same case, because it would be removed before it
/// is read.
fn refuse_own_results(folder: &CaseFolder, inputs: &[Input]) -> Result<()> {
    let Ok(path) = folder.path.canonicalize() else { return Ok(()) };
    let own = |input: &&Input| {
        let name = input.path.strip_prefix(&path).ok().map(|name| name.to_string_lossy().into_owned());
        name.is_some_and(|name| STAGES.iter().any(|stage| folder.files_of(stage).contains(&name)))
    };
    match inputs.iter().find(own) {
        None => Ok(()),
        Some(input) => Err(Error::input(
            format!("{}: is a result of the case {} itself", input.path.display(), folder.name),
            "results that are out of date are removed before a stage starts",
            "copy the file to another folder, or set another NAME for this run",
        )),
    }
}
