//! The `reconstruct` program: settled particles become a watertight triangle mesh.

use isoparticles_common::cli::run_stage;
use isoparticles_reconstruct::run::{Args, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    run_stage::<Args>("reconstruct", run)
}
