//! Describes the wheel's `isoparticles` command to clap, for shell completions and man pages. The
//! command itself is in pipelines/wheel, where a test compares it with this description.

use crate::keys::{Form, KEYS, Key};
use clap::builder::PossibleValuesParser;
use clap::{Arg, Command, ValueHint};
use isoparticles_stage::cli::shell::CommandLine;
use isoparticles_stage::error::{Error, Result};
use std::path::Path;

/// Names of the stages, each with a short description.
const STAGES: [(&str, &str); 6] = [
    ("distfield", "Compute the signed distance field F of a volume"),
    ("sizefield", "Compute the target edge length h from F"),
    ("seed", "Place the initial particles from F and h"),
    ("particles", "Move the particles until they settle"),
    ("reconstruct", "Connect the particles to form a triangle mesh, and check it"),
    ("tetmesh-check", "Fill the surface with tetrahedra, check them and solve test problems"),
];

/// Reads a description of the command line of a stage, as written by `STAGE --command-line`.
///
/// # Errors
/// If the file cannot be read or does not contain a command line.
pub fn stage(path: &Path) -> Result<CommandLine> {
    let text =
        std::fs::read(path).map_err(|error| Error::file(path, "read", &error, "write it with STAGE --command-line"))?;
    serde_json::from_slice(&text).map_err(|error| {
        Error::of_file(
            path,
            format!("is not a command line: {error}"),
            "it must be the output of a stage",
            "write it with STAGE --command-line",
        )
    })
}

/// Returns the command line of `isoparticles` for completions and man pages. It includes all
/// options of the stages in `known`, and accepts any arguments after the other stages.
#[must_use]
pub fn command(known: &[CommandLine]) -> Command {
    let options = || KEYS.iter().filter(|key| !["CASE", "INPUT"].contains(&key.name)).map(option);
    let of_volume = |name: &'static str, about: &'static str| {
        let volume =
            Arg::new("VOLUME").value_hint(ValueHint::AnyPath).help("Volume file, or folder of DICOM slices or masks");
        Command::new(name).about(about).arg(volume).args(options())
    };
    let of_name = |name: &'static str, about: &'static str| {
        let results = Arg::new("RESULTS").value_name("NAME").help("Name of the results");
        Command::new(name).about(about).arg(results).args(options())
    };
    let list = Arg::new("LIST.csv")
        .value_hint(ValueHint::FilePath)
        .help("CSV file with one column per parameter and one row per case");
    let limit = Arg::new("time-limit")
        .long("time-limit")
        .value_name("TIME")
        .help("Time limit for each case, such as 90s, 30m or 2h");
    let goal = Arg::new("goal").long("goal").help("Goal of each case").value_parser(PossibleValuesParser::new([
        "distfield",
        "sizefield",
        "seed",
        "particles",
        "surface",
        "mesh",
    ]));
    let stages = STAGES.map(|(name, about)| {
        if let Some(known) = known.iter().find(|known| known.name == name) {
            return known.command().about(about);
        }
        let more = Arg::new("ARGUMENTS").num_args(0..).allow_hyphen_values(true).value_hint(ValueHint::AnyPath);
        Command::new(name).about(about).arg(more.help("See `isoparticles STAGE --help`"))
    });
    let convert = Command::new("convert").about("Write a volume as a VTK image (.vti)").args([
        Arg::new("VOLUME").value_hint(ValueHint::AnyPath).help("Volume file, or folder of DICOM slices or masks"),
        Arg::new("output").short('o').long("output").value_name("V.vti").value_hint(ValueHint::FilePath),
    ]);
    let read = Command::new("read").about("Write an HDF5, MATLAB or Zarr file as a VTK image (.vti)").args([
        Arg::new("FILE").value_hint(ValueHint::AnyPath).help("HDF5 or MATLAB file, or folder of a Zarr store"),
        Arg::new("output").short('o').long("output").value_name("V.vti").value_hint(ValueHint::FilePath),
        Arg::new("dataset").long("dataset").value_name("NAME").help("Array to read: a path, a variable or a level"),
        Arg::new("spacing").long("spacing").value_name("MM").help("Spacing of a file that does not contain it, mm"),
    ]);
    Command::new("isoparticles")
        .version(env!("CARGO_PKG_VERSION"))
        .about("Volumes in, simulation-ready meshes out")
        .after_help("Example: isoparticles mesh ct.nii.gz --labels 1 -o out")
        .disable_help_subcommand(true)
        .subcommand(of_volume("info", "Describe a volume and suggest options"))
        .subcommand(convert)
        .subcommand(read)
        .subcommand(of_volume("mesh", "Mesh a volume with tetrahedra and write a report page"))
        .subcommand(of_volume("surface", "Mesh only the surface of a volume"))
        .subcommand(of_name("verdict", "Print the outcome of a case"))
        .subcommand(of_name("page", "Regenerate the page of a case"))
        .subcommand(of_name("clean", "Remove the results folder of a case"))
        .subcommand(of_name("demo", "Mesh a phantom"))
        .subcommand(view())
        .subcommand(Command::new("index").about("Write an index page of all cases").args(options()))
        .subcommand(
            Command::new("batch")
                .about("Mesh the case in each row of a list")
                .args([list, limit, goal])
                .args(options()),
        )
        .subcommands(stages)
        .subcommand(Command::new("help").about("List all goals and options"))
}

/// Returns the goal that shows a case in the browser.
fn view() -> Command {
    Command::new("view").about("Look at a case in the browser and refine it there").args([
        Arg::new("CASE").value_hint(ValueHint::AnyPath).help("Name or folder of a case, or a volume"),
        Arg::new("out").short('o').long("out").value_name("DIR").value_hint(ValueHint::DirPath),
        Arg::new("name").long("name").value_name("NAME").help("Name of the results of a volume"),
        Arg::new("port").long("port").value_name("PORT").help("Port of the page on this computer"),
        Arg::new("browser").long("browser").num_args(0).help("Open the page in the browser"),
    ])
}

fn long(key: &Key) -> String {
    key.name.to_lowercase().replace('_', "-")
}

/// Converts a key into an option: `MIN_SIZE` becomes `--min-size`.
fn option(key: &Key) -> Arg {
    // clap needs names with a static lifetime. The leak is harmless because the program ends after
    // printing.
    let arg = Arg::new(key.name).long(&*long(key).leak()).value_name(key.name).allow_hyphen_values(true).help(key.what);
    let arg = if key.name == "OUT" { arg.short('o').value_hint(ValueHint::DirPath) } else { arg };
    match key.form {
        Form::OneOf(words) => arg.value_parser(PossibleValuesParser::new(words)),
        _ => arg,
    }
}

#[cfg(test)]
mod tests {
    use super::command;
    use isoparticles_stage::cli::shell::{CommandLine, StageOption};

    #[test]
    fn the_command_line_is_sound_and_takes_what_the_documents_show() {
        command(&[]).debug_assert();
        let line = "isoparticles mesh ct.nii.gz --labels 1,2 --border open --iso -500 -o out";
        command(&[]).try_get_matches_from(line.split(' ')).expect("as docs/user/install.md has it");
        assert!(command(&[]).try_get_matches_from(["isoparticles", "mesh", "ct.nrrd", "--border", "closed"]).is_err());
    }

    #[test]
    fn what_a_stage_tells_follows_its_name() {
        let option = |long: &str, value: Option<&str>, words: &[&str]| StageOption {
            long: long.to_owned(),
            value: value.map(str::to_owned),
            words: words.iter().map(|&word| word.to_owned()).collect(),
            ..StageOption::default()
        };
        let options = vec![
            option("mode", Some("M"), &["fast", "slow"]),
            option("iso", Some("X"), &[]),
            option("force", None, &[]),
        ];
        let told = [CommandLine { name: "distfield".to_owned(), options }];
        command(&told).debug_assert();
        let fits = |line: &str| command(&told).try_get_matches_from(line.split(' ')).is_ok();
        assert!(fits("isoparticles distfield a.nrrd --iso -5 --mode slow --force"));
        assert!(!fits("isoparticles distfield a.nrrd --mode none") && !fits("isoparticles distfield --is 3"));
        assert!(fits("isoparticles sizefield --is 3"));
    }
}
