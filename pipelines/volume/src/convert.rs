//! Writes a volume as a VTK image.

use crate::Input;
use isoparticles_stage::cli::{CommonArgs, Context, FILES};
use isoparticles_stage::error::Result;
use isoparticles_volume::write_volume;
use std::path::PathBuf;

/// Write a volume as a VTK image file
///
/// The voxels keep their type. The image has the same world coordinates as the meshes (LPS for
/// anatomical volumes) and contains the label names.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    pub(crate) input: Input,
    /// VTK image file to write
    #[arg(short, long, value_name = "V.vti", help_heading = FILES)]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) common: CommonArgs,
}

/// Reads and writes the volume.
pub(crate) fn run(args: &Args, context: &Context) -> Result<()> {
    let volume = args.input.read(context)?;
    let _step = context.step("write");
    Ok(write_volume(&args.output, &volume, &context.history())?)
}
