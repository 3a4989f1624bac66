//! Writes a volume as a VTK image.

use isoparticles_stage::cli::{CommonArgs, Context, FILES, METHOD};
use isoparticles_stage::error::Result;
use isoparticles_stage::space::SpaceChoice;
use isoparticles_survey::input::InputArgs;
use isoparticles_survey::kind::KindChoice;
use isoparticles_volume::write_volume;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Write a volume as a VTK image file
///
/// The voxels keep their type, except for the means of --downsample. With the same --space, the
/// image has the same world coordinates as the meshes. It contains the label names.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// VTK image file to write
    #[arg(short, long, value_name = "V.vti", help_heading = FILES)]
    pub(crate) output: PathBuf,
    /// Kind of volume, which decides how --downsample joins voxels; auto detects the kind from the
    /// voxel values
    #[arg(long, value_enum, value_name = "KIND", default_value_t = KindChoice::Auto, help_heading = METHOD)]
    kind: KindChoice,
    /// World frame: lps, ras, or scanner, the frame of the input file. A volume without an
    /// anatomical space keeps its coordinates
    #[arg(long, value_enum, value_name = "FRAME", default_value_t = SpaceChoice::Lps, help_heading = METHOD)]
    pub(crate) space: SpaceChoice,
    #[command(flatten)]
    pub(crate) common: CommonArgs,
}

impl Args {
    pub(crate) fn parameters(&self) -> Value {
        let mut parameters = json!({ "space": self.space });
        if let Some(kind) = self.kind.given() {
            parameters["kind"] = json!(kind);
        }
        self.input.add_to(&mut parameters);
        parameters
    }
}

/// Reads and writes the volume.
pub(crate) fn run(args: &Args, context: &Context) -> Result<()> {
    let mut volume = args.input.load_part(args.kind.given(), context)?;
    volume.geometry = args.space.of(volume.geometry, Some(volume.file_space))?;
    let _step = context.step("write");
    Ok(write_volume(&args.output, &volume, &context.history())?)
}
