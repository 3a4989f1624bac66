//! The `isoparticles-volume` program: `info` describes a volume and predicts the cost of meshing
//! it, and `convert` writes the volume as a VTK image.

mod convert;
mod info;

use isoparticles_stage::cli::{CommonArgs, Outcome, StageArgs, run_stage};
use serde_json::Value;
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
            Verb::Convert(args) => args.parameters(),
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
