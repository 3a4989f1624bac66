//! Reads the input files and records them in the history.

use crate::args::Args;
use isoparticles_mesh::point_cloud::{PointCloud, is_point_cloud, read_point_cloud};
use isoparticles_stage::cli::Context;
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Kind, Result};
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind, read_particles};
use std::path::Path;

/// The contents of the input files. All numbers are finite.
#[expect(clippy::large_enum_variant, reason = "a run has only one value")]
pub enum Inputs {
    /// A point cloud of another program.
    Cloud(PointCloud),
    /// Particles without a field.
    Particles(ParticleFile),
    /// Particles with the field from which they were made.
    Field {
        /// Particles on the surface.
        particles: ParticleFile,
        /// The distance field of one object, or the indicators of many materials.
        distance: DistanceField,
        /// Target edge length h on the grid of the field, if given.
        sizing: Option<Field>,
    },
}

impl Inputs {
    /// Reads the input files and records them as inputs.
    ///
    /// # Errors
    /// If a file cannot be read, has the wrong kind, or is an output of this run.
    pub fn read(args: &Args, context: &Context) -> Result<Self> {
        let _step = context.step("read");
        let Some(distfield) = &args.distfield else {
            if !is_point_cloud(&args.particles) {
                return Ok(Self::Particles(particles(args, context)?));
            }
            let cloud = read_point_cloud(&args.particles)?;
            context.add_input(&args.particles, cloud.history.clone())?;
            return Ok(Self::Cloud(cloud));
        };
        let sizing = || args.sizefield.as_deref().map(|path| read_field(path, FieldKind::Sizing)).transpose();
        let (particles, (distance, sizing)) =
            rayon::join(|| particles(args, context), || rayon::join(|| DistanceField::read(distfield), sizing));
        let (particles, distance, sizing) = (particles?, distance?, sizing?);
        let field = (&**distfield, distance.history().cloned());
        match (&args.sizefield, &sizing) {
            (Some(path), Some(sizing)) => drop(context.add_inputs([field, (path, sizing.history.clone())])?),
            _ => drop(context.add_inputs([field])?),
        }
        Ok(Self::Field { particles, distance, sizing })
    }
}

/// Reads the particles and records them as an input.
fn particles(args: &Args, context: &Context) -> Result<ParticleFile> {
    let kinds = [ParticleKind::Particles, ParticleKind::Seeds, ParticleKind::Checkpoint];
    let file = read_particles(&args.particles, &kinds)?;
    context.add_input(&args.particles, Some(file.history.clone()))?;
    Ok(file)
}

/// Warns if the particles are seeds or a checkpoint instead of settled particles.
pub(crate) fn warn_unless_settled(args: &Args, file: &ParticleFile, context: &Context) {
    if file.kind != ParticleKind::Particles {
        let (path, kind) = (args.particles.display(), file.kind.name());
        context.warn(format!("{path}: contains {kind} instead of settled particles, so the triangles will be worse"));
    }
}

/// Returns an error with the path of a file in front of its text. An interruption stays unchanged.
pub(crate) fn about(path: &Path, error: Error) -> Error {
    if error.kind == Kind::Interrupted {
        return error;
    }
    Error { what: format!("{}: {}", path.display(), error.what), ..error }
}
