//! The `reconstruct` program: settled particles become a watertight triangle mesh.

use isoparticles_reconstruct::run::{Args, run};
use isoparticles_stage::cli::run_stage;
use std::process::ExitCode;

fn main() -> ExitCode {
    run_stage::<Args>("reconstruct", run)
}
