//! Checkpoints: the current particles of a run and the records of all passes so far. [`resume`]
//! checks that a checkpoint has the same inputs and parameters as the current run.

use crate::settle::{Engine, Parameters, PassRecord};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind, read_particles};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;

/// Contents of a checkpoint in addition to the particles.
#[derive(Serialize, Deserialize)]
pub(crate) struct Progress {
    /// Parameters of the run.
    pub parameters: Parameters,
    /// Hashes of the seeds, the distance field and the size field.
    pub inputs: [String; 3],
    /// Records of all passes so far.
    pub records: Vec<PassRecord>,
    /// Backend, and the adapter if the backend is a GPU.
    #[serde(default = "cpu_engine")]
    pub engine: String,
}

/// Returns the name of the CPU engine, the default for checkpoints that do not name an engine.
pub(crate) fn cpu_engine() -> String {
    "cpu".to_owned()
}

/// Writes a checkpoint. `segments` are the curve segments of a multi-material seed file.
pub(crate) fn keep(
    path: &Path,
    engine: &mut dyn Engine,
    segments: &[[u32; 2]],
    progress: &Progress,
    context: &Context,
) -> Result<()> {
    let extra = serde_json::to_vec(progress).map_err(|error| {
        Error::input(
            format!("{}: cannot encode the log: {error}", path.display()),
            "the checkpoint contains the log",
            "report this bug",
        )
    })?;
    let (kind, meta, history) = (ParticleKind::Checkpoint, Value::Null, context.history());
    let particles = engine.particles()?;
    let strata = Strata { of: engine.strata().to_vec(), segments: segments.to_vec() };
    let strata = Some(strata).filter(|strata| !strata.of.is_empty());
    ParticleFile { kind, particles, strata, meta, history, extra }.write(path)
}

/// Reads a checkpoint and checks that it belongs to this run. Returns the particles, their strata
/// (only for many materials) and the records of the log. Warns if the checkpoint was made with
/// another engine.
pub(crate) fn resume(
    path: &Path,
    parameters: &Parameters,
    inputs: &[String; 3],
    engine: &str,
    context: &Context,
) -> Result<(ParticleSet, Option<Strata>, Vec<PassRecord>)> {
    let file = read_particles(path, &[ParticleKind::Checkpoint])?;
    let refuse = |what: &str| {
        Error::input(
            format!("{}: {what}", path.display()),
            "a run resumed from it would differ from an uninterrupted one",
            "delete the checkpoint or leave out --resume to start again, or use the inputs and parameters of the \
             checkpoint",
        )
    };
    let progress: Progress =
        serde_json::from_slice(&file.extra).map_err(|error| refuse(&format!("cannot be read: {error}")))?;
    if progress.inputs != *inputs {
        return Err(refuse("was made from other seeds or fields"));
    }
    if json!(progress.parameters) != json!(parameters) {
        return Err(refuse("was made with other parameters"));
    }
    if progress.engine != engine {
        context.warn(format!(
            "the checkpoint was made on another device ({}): the result will not be identical to that of an \
             uninterrupted run",
            progress.engine
        ));
    }
    context.info(format!("resuming after pass {}", progress.records.last().map_or(0, |r| r.pass)));
    Ok((file.particles, file.strata, progress.records))
}
