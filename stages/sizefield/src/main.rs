//! The `sizefield` program: parse, run, exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    isoparticles_stage::cli::run_stage("sizefield", isoparticles_sizefield::run::run)
}
