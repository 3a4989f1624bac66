//! The `sizefield` program: parses the arguments, runs the stage and returns the exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    isoparticles_stage::cli::run_stage("sizefield", isoparticles_sizefield::run::run)
}
