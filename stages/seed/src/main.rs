//! The `seed` program: parse, run, exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    isoparticles_stage::cli::run_stage("seed", isoparticles_seed::run::run)
}
