//! Plans the stages of a case: their command lines, and the hashes that determine which stages have
//! to run again.

use crate::folder::{Belongings, CHECKPOINT, CaseFolder, PICTURES, REPORT, STAGES, report_name};
use crate::inputs::{self, hash_program};
use crate::read;
use crate::settings::Settings;
use crate::status::{Input, Status};
use isoparticles_stage::error::{Error, Result};
use std::ffi::OsString;
use std::path::PathBuf;

/// Paths of the stage programs.
#[derive(Clone, Debug)]
pub struct Programs {
    /// Folder of the Rust stages and of `phantom`.
    pub bin: PathBuf,
    /// `tetmesh-check`; its page and index programs are in the same folder.
    pub tetmesh_check: PathBuf,
    /// Files that make up `tetmesh-check`. If their contents change, the tetrahedra are
    /// regenerated.
    pub tetmesh_files: Vec<PathBuf>,
    /// Files that make up the page program.
    pub page_files: Vec<PathBuf>,
}

impl Programs {
    /// Returns the program that converts volumes.
    #[must_use]
    pub fn read(&self) -> PathBuf {
        self.tetmesh_check.with_file_name(read::PROGRAM)
    }

    /// Returns the program that generates a page.
    #[must_use]
    pub fn page(&self) -> PathBuf {
        self.beside("-page")
    }

    /// Returns the program that generates the index.
    #[must_use]
    pub fn index(&self) -> PathBuf {
        self.beside("-index")
    }

    fn beside(&self, ending: &str) -> PathBuf {
        let mut name = self.tetmesh_check.clone().into_os_string();
        name.push(ending);
        PathBuf::from(name)
    }
}

/// The volume of a case.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Volume {
    /// A file or folder at this path.
    At(PathBuf),
    /// A volume that the program `phantom` generates.
    Phantom,
}

/// A program and its arguments.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Command {
    /// The program.
    pub program: PathBuf,
    /// Arguments of the program.
    pub arguments: Vec<OsString>,
}

/// One stage, ready to run.
#[derive(Debug)]
pub struct Planned {
    /// The files of the stage.
    pub belongings: &'static Belongings,
    /// The commands, which run one after the other.
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

impl Command {
    /// Returns the command line, quoted for a shell.
    fn line(&self) -> String {
        let words = std::iter::once(self.program.as_os_str()).chain(self.arguments.iter().map(OsString::as_os_str));
        let quoted = words.map(|word| {
            let word = word.to_string_lossy();
            shlex::try_quote(&word).map_or_else(|_| word.to_string(), |quoted| quoted.into_owned())
        });
        quoted.collect::<Vec<_>>().join(" ")
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
        inputs.extend(inputs::named_in(settings, options_key(name), before)?);
        if name == "reconstruct" {
            inputs.extend(inputs::named_in(settings, "RESIZE", before)?);
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

/// Returns the regions of the RESIZE setting if `stage` is `reconstruct`, which applies them.
fn resizes(stage: &str, settings: &Settings) -> Vec<String> {
    if stage == "reconstruct" { settings.words("RESIZE") } else { Vec::new() }
}

/// Returns the HXT setting if `stage` is `tetmesh-check`. The same options give different
/// tetrahedra with and without Gmsh.
fn hxt<'a>(stage: &str, settings: &'a Settings) -> Option<&'a str> {
    settings.get("HXT").filter(|_| stage == "tetmesh-check")
}

/// Returns the program of a stage, and the files that make up the program.
#[must_use]
pub fn program_of(stage: &str, programs: &Programs) -> (PathBuf, Vec<PathBuf>) {
    match stage {
        "tetmesh-check" => (programs.tetmesh_check.clone(), programs.tetmesh_files.clone()),
        "read" => (programs.read(), vec![programs.read()]),
        _ => (programs.bin.join(stage), vec![programs.bin.join(stage)]),
    }
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
    let commands = if regions.is_empty() { vec![first] } else { updates(first, folder, &regions, settings, programs) };
    (commands, report)
}

/// Returns the commands that change the surface of `first` in several regions, one after the other.
/// The files of each step have the names that the results of the case would have, so their
/// histories do not depend on the number of regions.
fn updates(
    first: Command,
    folder: &CaseFolder,
    regions: &[String],
    settings: &Settings,
    programs: &Programs,
) -> Vec<Command> {
    let word = OsString::from;
    let file = |ending: &str| folder.file(ending).into_os_string();
    let step =
        |at: usize, ending: &str| folder.path.join(UPDATES[at % 2]).join(folder.file_name(ending)).into_os_string();
    let (size, surface) = ("sizefield.vti", "surface.vtp");
    let mut commands = vec![first];
    replace(&mut commands[0].arguments, &file(surface), &step(0, surface));
    for (before, region) in regions.iter().enumerate() {
        let is_last = before + 1 == regions.len();
        let previous = if before == 0 { file(size) } else { step(before, size) };
        let sized = if is_last { resized(folder) } else { step(before + 1, size) };
        let made = if is_last { file(surface) } else { step(before + 1, surface) };
        let program = programs.bin.join("sizefield");
        let own = [
            file("distfield.vti"),
            word("--update"),
            previous,
            word("--resize"),
            word(region),
            word("-o"),
            sized.clone(),
        ];
        let report = folder.path.join(report_name("reconstruct")).into_os_string();
        let arguments = own.into_iter().chain(shared(settings, "sizefield")).chain([word("--report"), report.clone()]);
        commands.push(Command { program, arguments: arguments.collect() });
        let own = [
            word("--update"),
            step(before, surface),
            word("--distfield"),
            file("distfield.vti"),
            word("--sizefield"),
            sized,
            word("-o"),
            made,
        ];
        let options = options("reconstruct", settings).into_iter().map(OsString::from);
        let arguments =
            own.into_iter().chain(options).chain(shared(settings, "reconstruct")).chain([word("--report"), report]);
        commands.push(Command { program: programs.bin.join("reconstruct"), arguments: arguments.collect() });
    }
    commands
}

/// Folders of the files of every other update, within the folder of the case. A run removes them
/// when all updates are done.
pub const UPDATES: [&str; 2] = ["updates/0", "updates/1"];

/// Returns the path of the size field after all updates.
fn resized(folder: &CaseFolder) -> OsString {
    folder.path.join("updates").join(folder.file_name("sizefield.vti")).into_os_string()
}

fn replace(words: &mut [OsString], from: &OsString, to: &OsString) {
    words.iter_mut().filter(|word| *word == from).for_each(|word| word.clone_from(to));
}

/// Returns the name of the key with further options for a stage, or an empty string if there is
/// none.
pub(crate) fn options_key(stage: &str) -> &'static str {
    match stage {
        "phantom" => "PHANTOM",
        "distfield" => "DISTFIELD_OPTIONS",
        "sizefield" => "SIZEFIELD_OPTIONS",
        "particles" => "PARTICLES_OPTIONS",
        "reconstruct" => "RECONSTRUCT_OPTIONS",
        "tetmesh-check" => "TETMESH_OPTIONS",
        _ => "",
    }
}

/// Options for reading the volume, each with the key that sets it.
pub const READING_BY_KEY: [(&str, &str); 4] =
    [("--series", "SERIES"), ("--spacing", "SPACING"), ("--crop", "CROP"), ("--downsample", "DOWNSAMPLE")];

/// Returns the words of the options whose keys are set.
pub fn words_by_key(pairs: &[(&str, &str)], settings: &Settings) -> Vec<String> {
    let word = |(option, key): &(&str, &str)| Some([(*option).to_owned(), settings.get(key)?.to_owned()]);
    pairs.iter().filter_map(word).flatten().collect()
}

/// Returns the options of a stage, each with the key that sets it. If a key is not set, the stage
/// uses its own default.
fn options_by_key(stage: &str) -> &'static [(&'static str, &'static str)] {
    match stage {
        "read" => &[("--dataset", "DATASET"), ("--spacing", "SPACING")],
        "distfield" => &[
            ("--iso", "ISO"),
            ("--labels", "LABELS"),
            ("--inside", "INSIDE"),
            ("--border", "BORDER"),
            ("--space", "SPACE"),
        ],
        "sizefield" => &[
            ("--epsilon", "EPSILON"),
            ("--delta", "DELTA"),
            ("--uniform", "SIZE"),
            ("--min-size", "MIN_SIZE"),
            ("--max-size", "MAX_SIZE"),
            ("--vertices", "VERTICES"),
            ("--quality", "QUALITY"),
        ],
        "seed" => &[("--count", "COUNT"), ("--seed", "SEED")],
        "particles" => &[("--backend", "BACKEND"), ("--seed", "SEED")],
        "tetmesh-check" => &[("--order", "TET_ORDER"), ("--for", "FOR")],
        _ => &[],
    }
}

/// Options of `distfield` that set the level of detail, with their keys. Only the first key that is
/// set is used.
const SCALE_BY_KEY: [(&str, &str); 4] = [
    ("--scale", "SCALE"),
    ("--scale-for-size", "SIZE"),
    ("--scale-for-vertices", "VERTICES"),
    ("--quality", "QUALITY"),
];

/// Converts a value such as `lungs:2,heart:1+4` into options of `distfield`. A name without labels
/// is either `all` or a name defined in the file.
fn materials(choice: &str) -> impl Iterator<Item = String> {
    let named = choice.split(',').map(str::trim).filter(|one| !one.is_empty());
    named.flat_map(|one| ["--material".to_owned(), one.replacen(':', "=", 1)])
}

/// Returns the `--size` options in SIZEFIELD_OPTIONS. `distfield` derives scales from them.
fn sizes_of_materials(settings: &Settings) -> Vec<String> {
    let words = settings.words(options_key("sizefield"));
    let values = words.iter().enumerate().filter_map(|(n, word)| match word.strip_prefix("--size") {
        Some("") => words.get(n + 1).map(String::as_str),
        Some(rest) => rest.strip_prefix('='),
        None => None,
    });
    values.flat_map(|value| ["--size".to_owned(), value.to_owned()]).collect()
}

/// Returns the arguments of a stage that may change its result.
#[must_use]
pub fn options(stage: &str, settings: &Settings) -> Vec<String> {
    // A converted volume contains its spacing.
    let settings = &if stage == "distfield" { read::settings_after(settings) } else { settings.clone() };
    let mut words = if stage == "distfield" { words_by_key(&READING_BY_KEY, settings) } else { Vec::new() };
    words.extend(words_by_key(options_by_key(stage), settings));
    let more = settings.words(options_key(stage));
    // A scale or quality in DISTFIELD_OPTIONS takes precedence.
    let chosen = more.iter().any(|word| word.starts_with("--scale") || word.starts_with("--quality"));
    if stage == "distfield" && !chosen {
        let first = SCALE_BY_KEY.iter().find(|(_, key)| settings.get(key).is_some());
        words.extend(words_by_key(first.map(std::slice::from_ref).unwrap_or_default(), settings));
    }
    if stage == "distfield"
        && let Some(choice) = settings.get("MATERIALS")
    {
        words.extend(materials(choice));
        let has_scale = more.iter().any(|word| word == "--scale" || word.starts_with("--scale="));
        if !has_scale && settings.get("SCALE").is_none() {
            words.extend(sizes_of_materials(settings));
        }
    }
    let accepting: [(&[&str], &str, &str); 2] = [
        (&["distfield"], "ACCEPT_LOSSES", "--accept-losses"),
        (&["reconstruct", "tetmesh-check"], "ACCEPT_FORCED", "--accept-forced"),
    ];
    let accepted =
        accepting.iter().filter(|(stages, key, _)| stages.contains(&stage) && settings.get(key) == Some("yes"));
    words.extend(accepted.map(|(.., option)| (*option).to_owned()));
    words.extend(more);
    words
}

/// Returns the setting that leaves the surface open at the border of the volume, if there is one.
pub(crate) fn open_border(settings: &Settings) -> Option<&'static str> {
    if settings.get("BORDER") == Some("open") {
        return Some("BORDER=open");
    }
    let words = settings.words(options_key("distfield")).join(" ");
    ["--border open", "--border=open"]
        .iter()
        .any(|it| words.contains(it))
        .then_some("DISTFIELD_OPTIONS='--border open'")
}

/// Returns the complete arguments of a stage, and the path of its report.
fn arguments(
    stage: &str,
    folder: &CaseFolder,
    volume: &Volume,
    options: Vec<String>,
    settings: &Settings,
) -> (Vec<OsString>, Option<String>) {
    let file = |ending: &str| folder.file(ending).into_os_string();
    let word = OsString::from;
    let (distfield, sizefield) = (file("distfield.vti"), file("sizefield.vti"));
    let fields = [word("--distfield"), distfield.clone(), word("--sizefield"), sizefield.clone()];
    let mut words: Vec<OsString> = match stage {
        "phantom" => vec![word("--truth"), file("truth.json")],
        "read" | "distfield" => match volume {
            Volume::At(path) if stage == "distfield" && read::is_needed(path) => vec![file("input.vti")],
            Volume::At(path) => vec![path.clone().into_os_string()],
            Volume::Phantom => vec![file("nrrd")],
        },
        "sizefield" => vec![distfield],
        "seed" => vec![distfield, sizefield],
        "particles" => [file("seeds.bin")].into_iter().chain(fields).collect(),
        "reconstruct" => [file("particles.bin")].into_iter().chain(fields).collect(),
        _ => {
            let own = if settings.words("RESIZE").is_empty() { sizefield } else { resized(folder) };
            let mut words = vec![file("surface.vtp"), word("--sizefield"), own];
            // Mid-edge nodes are projected onto the interfaces, which requires F.
            if settings.get("TET_ORDER") == Some("2") {
                words.extend([word("--distfield"), distfield]);
            }
            words
        }
    };
    words.extend([word("-o"), file(crate::folder::belongings(stage).output)]);
    if stage == "particles" {
        // A stopped run resumes from its checkpoint.
        let checkpoint = file(CHECKPOINT);
        words.extend([word("--log"), file("passes.csv"), word("--checkpoint"), checkpoint, word("--resume")]);
    }
    words.extend(options.into_iter().map(OsString::from));
    if stage == "phantom" {
        words.push(word("--force"));
        return (words, None);
    }
    let report = if stage == "tetmesh-check" {
        words.extend([word("--pictures"), folder.path.join(PICTURES).into_os_string()]);
        folder.file_name(REPORT)
    } else {
        report_name(stage)
    };
    words.extend(shared(settings, stage));
    words.extend([word("--report"), folder.path.join(&report).into_os_string()]);
    (words, Some(report))
}

/// Returns the options that all stages share.
fn shared(settings: &Settings, stage: &str) -> Vec<OsString> {
    let mut words = vec!["--force".to_owned()];
    words.extend(settings.words("VERBOSITY"));
    let memory = [("--max-memory", "MAX_MEMORY")].iter().filter(|_| stage != "tetmesh-check");
    words.extend([("--threads", "THREADS")].iter().chain(memory).flat_map(|pair| words_by_key(&[*pair], settings)));
    words.into_iter().map(OsString::from).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn told(set: &[&str]) -> String {
        let set: Vec<String> = set.iter().map(|word| (*word).to_owned()).collect();
        let settings = Settings::read(&set, &[], None, &[]).expect("fit together");
        let folder = CaseFolder::new(Path::new("out"), "case");
        let options = options("tetmesh-check", &settings);
        let (words, _) = arguments("tetmesh-check", &folder, &Volume::Phantom, options, &settings);
        words.iter().map(|word| word.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn accepted_faults_reach_the_stages_that_check_them() {
        let settings = |word: &str| Settings::read(&[word.to_owned()], &[], None, &[]).expect("fit together");
        let accepting = |word: &str, option: &str| {
            let settings = settings(word);
            let accepts = |stage: &&str| options(stage, &settings).contains(&option.to_owned());
            STAGES.iter().map(|belongings| belongings.stage).filter(accepts).collect::<Vec<_>>()
        };
        assert_eq!(accepting("ACCEPT_FORCED=yes", "--accept-forced"), ["reconstruct", "tetmesh-check"]);
        assert!(accepting("ACCEPT_FORCED=no", "--accept-forced").is_empty());
        assert_eq!(accepting("ACCEPT_LOSSES=yes", "--accept-losses"), ["distfield"]);
        assert!(accepting("ACCEPT_LOSSES=no", "--accept-losses").is_empty());
    }

    #[test]
    fn sizes_of_materials_reach_distfield_without_a_scale() {
        let sizes = |more: &[&str]| {
            let words = ["SIZEFIELD_OPTIONS=--size body=8 --delta 0.3 --size='left ear=1'"];
            let words: Vec<String> = words.iter().chain(more).map(|word| (*word).to_owned()).collect();
            let settings = Settings::read(&words, &[], None, &[]).expect("fit together");
            let options = options("distfield", &settings);
            options.iter().filter(|word| word.contains("body") || word.contains("ear")).cloned().collect::<Vec<_>>()
        };
        assert_eq!(sizes(&["MATERIALS=all"]), ["body=8", "left ear=1"]);
        for one_scale in [&["MATERIALS=all", "SCALE=0"], &["MATERIALS=all", "DISTFIELD_OPTIONS=--scale 3"]] {
            assert_eq!(sizes(one_scale), [""; 0]);
        }
        assert_eq!(sizes(&["LABELS=1"]), [""; 0], "one object");
    }

    #[test]
    fn the_program_of_for_reaches_tetmesh_check() {
        assert!(told(&["FOR=febio"]).contains("--for febio") && !told(&[]).contains("--for "));
        let error = Settings::read(&["FOR=gmsh".to_owned()], &[], None, &[]).expect_err("not a program");
        assert!(error.to_string().contains("simnibs"), "{error}");
    }

    #[test]
    fn quadratic_tetrahedra_get_the_distance_field() {
        let quadratic = told(&["TET_ORDER=2"]);
        assert!(quadratic.contains("--distfield out/case/case.distfield.vti") && quadratic.contains("--order 2"));
        assert!(!told(&[]).contains("--distfield") && !told(&["TET_ORDER=1"]).contains("--distfield"));
        assert!(told(&["TET_ORDER=2", "MATERIALS=all"]).contains("--distfield out/case/case.distfield.vti"));
    }
}
