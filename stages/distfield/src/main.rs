//! The `distfield` program: computes the signed distance field F from a volume and an iso value, or
//! from labels.

use isoparticles_distfield::run::{Args, run};
use isoparticles_stage::cli::run_stage;
use std::process::ExitCode;

fn main() -> ExitCode {
    run_stage::<Args>("distfield", run)
}
