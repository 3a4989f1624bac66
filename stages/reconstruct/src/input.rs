//! Reads particles and size fields, and records them as inputs.

use crate::args::Args;
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::{Error, Kind, Result};
use isoparticles_stage::field_file::{FieldKind, check_same_grid, read_field};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind, read_particles};
use isoparticles_volume::Geometry;
use std::path::Path;

/// Reads the particles and records them as an input. Warns if they are seeds or a checkpoint
/// instead of settled particles.
pub(crate) fn read_settled(args: &Args, context: &Context) -> Result<ParticleFile> {
    let kinds = [ParticleKind::Particles, ParticleKind::Seeds, ParticleKind::Checkpoint];
    let file = read_particles(&args.particles, &kinds)?;
    if file.kind != ParticleKind::Particles {
        let (path, kind) = (args.particles.display(), file.kind.name());
        context.warn(format!("{path}: contains {kind} instead of settled particles, so the triangles will be worse"));
    }
    context.add_input(&args.particles, Some(file.history.clone()))?;
    Ok(file)
}

/// Reads a size field and records it as an input. Returns an error if it is not on the grid of the
/// distance field.
pub(crate) fn read_sizing(path: &Path, distance: (&Path, &Geometry), context: &Context) -> Result<SizingField> {
    let field = read_field(path, FieldKind::Sizing)?;
    check_same_grid((path, &field.image.geometry), distance)?;
    context.add_input(path, field.history)?;
    Ok(SizingField::new(field.image))
}

/// Returns an error with the path of a file in front of its text. An interruption stays unchanged.
pub(crate) fn about(path: &Path, error: Error) -> Error {
    if error.kind == Kind::Interrupted {
        return error;
    }
    Error { what: format!("{}: {}", path.display(), error.what), ..error }
}
