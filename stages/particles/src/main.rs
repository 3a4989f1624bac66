//! The `particles` program: parse, run, exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    isoparticles_particles::gpu::display::leave_alone();
    isoparticles_stage::cli::run_stage("particles", isoparticles_particles::run::run)
}
