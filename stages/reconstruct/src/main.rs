//! The program `reconstruct`: turns settled particles into a closed triangle mesh.

use isoparticles_reconstruct::run::{Args, run};
use isoparticles_stage::cli::run_stage;
use std::process::ExitCode;

fn main() -> ExitCode {
    run_stage::<Args>("reconstruct", run)
}
