//! The `distfield` program: a volume and an iso value, or labels, become the signed distance field F.

use isoparticles_common::cli::run_stage;
use isoparticles_distfield::run::{Args, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    run_stage::<Args>("distfield", run)
}
