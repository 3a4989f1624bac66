//! Makes the command lines of the stages: programs, options from the settings, and files.

use crate::folder::{CHECKPOINT, CaseFolder, PICTURES, REPORT, belongings, report_name};
use crate::read;
use crate::settings::Settings;
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

impl Command {
    /// Returns the command line, quoted for a shell.
    pub(crate) fn line(&self) -> String {
        let words = std::iter::once(self.program.as_os_str()).chain(self.arguments.iter().map(OsString::as_os_str));
        let quoted = words.map(|word| {
            let word = word.to_string_lossy();
            shlex::try_quote(&word).map_or_else(|_| word.to_string(), |quoted| quoted.into_owned())
        });
        quoted.collect::<Vec<_>>().join(" ")
    }
}

/// Returns the regions of the RESIZE setting if `stage` is `reconstruct`. Other stages ignore them.
pub(crate) fn resizes(stage: &str, settings: &Settings) -> Vec<String> {
    if stage == "reconstruct" { settings.words("RESIZE") } else { Vec::new() }
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

/// Returns the keys whose values may name input files of a stage, besides the volume.
pub(crate) fn keys_with_files(stage: &str) -> impl Iterator<Item = &'static str> {
    [options_key(stage)].into_iter().chain((stage == "reconstruct").then_some("RESIZE"))
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
pub(crate) fn arguments(
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
    words.extend([word("-o"), file(belongings(stage).output)]);
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

/// Returns the options that do not change the result of a stage: `--force`, and those for messages,
/// threads and memory.
pub(crate) fn shared(settings: &Settings, stage: &str) -> Vec<OsString> {
    let mut words = vec!["--force".to_owned()];
    words.extend(settings.words("VERBOSITY"));
    let memory = [("--max-memory", "MAX_MEMORY")].iter().filter(|_| stage != "tetmesh-check");
    words.extend([("--threads", "THREADS")].iter().chain(memory).flat_map(|pair| words_by_key(&[*pair], settings)));
    words.into_iter().map(OsString::from).collect()
}

/// Returns the path of the size field after all updates.
pub(crate) fn resized(folder: &CaseFolder) -> OsString {
    folder.path.join("updates").join(folder.file_name("sizefield.vti")).into_os_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::folder::STAGES;
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
