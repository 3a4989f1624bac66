//! The `particles` program: parses the command line, runs the stage and returns the exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    isoparticles_particles::gpu::display::leave_alone();
    isoparticles_stage::cli::run_stage("particles", isoparticles_particles::run::run)
}
