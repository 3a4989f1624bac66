//! The `isoparticles-volume` program: `info` describes a volume and predicts the cost of meshing
//! it, and `convert` writes the volume as a VTK image.

mod convert;
mod info;

use isoparticles_stage::cli::{CommonArgs, Context, FILES, Outcome, StageArgs, run_stage};
use isoparticles_stage::error::Result;
use isoparticles_volume::{ReadOptions, Volume, read_volume_with};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::process::ExitCode;

/// Describe a volume, or convert it to a VTK image
#[derive(Clone, Debug, clap::Parser)]
#[command(
    name = "isoparticles-volume",
    version,
    after_help = "Example: describe a volume and predict the cost of a mesh\n  isoparticles-volume info lungs_label.nrrd\n\
                  Example: convert a volume for another program\n  isoparticles-volume convert ct.nii.gz -o ct.vti"
)]
struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum Verb {
    Info(info::Args),
    Convert(convert::Args),
}

/// The volume to read.
#[derive(Clone, Debug, clap::Args)]
struct Input {
    /// Volume to read: NRRD (.nrrd, .nhdr, .seg.nrrd), NIfTI (.nii, .nii.gz), Analyze (.hdr),
    /// FreeSurfer (.mgz, .mgh), MetaImage (.mha, .mhd), TIFF (.tif), NumPy (.npy), VTK image
    /// (.vti), or a folder of DICOM slices, of TIFF slices or of masks, one file per object
    #[arg(value_name = "VOLUME", help_heading = FILES)]
    path: PathBuf,
    /// Series to read if the folder contains several, given by its description, number or UID
    #[arg(long, value_name = "NAME", help_heading = FILES)]
    series: Option<String>,
}

impl Input {
    fn read(&self, context: &Context) -> Result<Volume> {
        let step = context.step("read");
        let volume =
            read_volume_with(&self.path, &ReadOptions { series: self.series.as_deref(), ..ReadOptions::default() })?;
        context.add_input(&self.path, None)?;
        drop(step);
        volume.remarks.iter().for_each(|remark| context.warn(remark));
        Ok(volume)
    }
}

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        match &self.verb {
            Verb::Info(args) => &args.common,
            Verb::Convert(args) => &args.common,
        }
    }

    fn outputs(&self) -> Vec<PathBuf> {
        match &self.verb {
            Verb::Info(args) => args.json_file().map(PathBuf::from).into_iter().collect(),
            Verb::Convert(args) => vec![args.output.clone()],
        }
    }

    fn parameters(&self) -> Value {
        match &self.verb {
            Verb::Info(args) => args.parameters(),
            Verb::Convert(args) => json!({ "series": args.input.series, "space": args.space }),
        }
    }
}

fn main() -> ExitCode {
    run_stage::<Args>("isoparticles-volume", |args, context| {
        match &args.verb {
            Verb::Info(args) => info::run(args, context)?,
            Verb::Convert(args) => convert::run(args, context)?,
        }
        Ok(Outcome::Passed)
    })
}
