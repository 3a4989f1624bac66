//! The `distfield` program: a volume and an iso value, or labels, become the signed distance field F.

use isoparticles_distfield::run::{Args, run};
use isoparticles_stage::cli::run_stage;
use std::process::ExitCode;

fn main() -> ExitCode {
    run_stage::<Args>("distfield", run)
}
