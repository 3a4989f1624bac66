//! Describes a volume: size, orientation, kind (scan or labels), values, labels with their volumes,
//! proposed iso values, and the predicted cost of meshing each object.

use isoparticles_stage::cli::{CommonArgs, Context, FILES, METHOD};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::output::write_atomically;
use isoparticles_survey::input::InputArgs;
use isoparticles_survey::kind::{Kind, KindChoice};
use isoparticles_survey::selection::Selection;
use isoparticles_survey::{Inside, Wishes, examine};
use serde_json::{Value, json};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// Describe a volume, and predict the cost of a mesh
///
/// Prints the size, orientation, kind (scan or labels), values, labels with their volumes, and
/// proposed iso values. Predicts the number of vertices, the time and the memory for the object
/// selected by --iso or --labels; without these options, for the union of all labels or for each
/// proposed iso value.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// Write the description as JSON to this file; `-` writes it to stdout instead of the text
    #[arg(long, value_name = "FILE.json|-", help_heading = FILES)]
    json: Option<PathBuf>,
    /// Iso value of the surface, in the unit of the voxel values; the object lies above it or, with
    /// --inside below, below it
    #[arg(long, value_name = "V", allow_negative_numbers = true, conflicts_with = "labels", help_heading = METHOD)]
    iso: Option<f64>,
    /// Side of the iso value on which the object lies
    #[arg(long, value_enum, value_name = "SIDE", default_value_t = Inside::Above, help_heading = METHOD)]
    inside: Inside,
    /// Labels whose union is the object, separated by commas or spaces: numbers, ranges such as
    /// 2..5, all (every label except 0), or names from the file
    #[arg(long, value_name = "A,B", allow_hyphen_values = true, help_heading = METHOD)]
    labels: Option<Selection>,
    /// Kind of volume; auto detects the kind from the voxel values
    #[arg(long, value_enum, value_name = "KIND", default_value_t = KindChoice::Auto, help_heading = METHOD)]
    kind: KindChoice,
    #[command(flatten)]
    pub(crate) common: CommonArgs,
}

impl Args {
    /// Returns the path of the JSON file, or `None` if no JSON is requested or it is written to
    /// stdout.
    pub(crate) fn json_file(&self) -> Option<&Path> {
        self.json.as_deref().filter(|path| *path != Path::new("-"))
    }

    pub(crate) fn parameters(&self) -> Value {
        let mut parameters = json!({
            "iso": self.iso, "labels": self.labels.as_ref().map(Selection::to_string), "kind": self.kind.given(),
        });
        self.input.add_to(&mut parameters);
        parameters
    }
}

/// Examines the volume and prints the description.
pub(crate) fn run(args: &Args, context: &Context) -> Result<()> {
    let object = args.iso.map(|_| Kind::Scan).or(args.labels.as_ref().map(|_| Kind::Labels));
    let volume = args.input.load_part(args.kind.given().or(object), context)?;
    let about_file = |error: Error| Error { what: format!("{}: {}", args.input.name(), error.what), ..error };
    let labels = args.labels.as_ref().map(|labels| labels.resolve(&volume)).transpose().map_err(about_file)?;
    let wishes = Wishes { labels, iso: args.iso.map(|iso| (iso, args.inside)), kind: args.kind.given() };
    let info = examine(&volume, &wishes, context)?;
    if args.json.is_some() {
        let text = serde_json::to_string_pretty(&info).map_err(|error| {
            Error::input(format!("the description is not valid JSON: {error}"), "--json writes it", "report this bug")
        })?;
        match args.json_file() {
            Some(path) => write_atomically(path, |file| writeln!(file, "{text}"))?,
            None => return print(&format!("{text}\n")),
        }
    }
    print(&info.text(&args.input.path.display().to_string()))
}

/// Writes to stdout. A closed pipe is not an error.
fn print(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Error::file(Path::new("stdout"), "write", &error, "check where stdout goes"))
        }
        _ => Ok(()),
    }
}
