//! Reads the input files and records them in the history.

use crate::args::Args;
use crate::update::Reference;
use isoparticles_mesh::point_cloud::{PointCloud, is_point_cloud, read_point_cloud};
use isoparticles_mesh::surface::{SurfaceFile, read_surface};
use isoparticles_stage::cli::Context;
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Kind, Result};
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind, read_particles};
use std::path::Path;
use std::sync::Arc;

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
    /// A finished surface to update.
    Surface {
        /// The surface in world coordinates.
        previous: SurfaceFile,
        /// The field from which the surface was made.
        distance: DistanceField,
        /// The new target edge length h on the grid of the field.
        sizing: Field,
        /// The reference that an earlier update has derived from `distance`, if there was one.
        reference: Option<Arc<Reference>>,
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
        let fields = || rayon::join(|| DistanceField::read(distfield), sizing);
        let (start, (distance, sizing)) = rayon::join(|| Start::read(args, context), fields);
        let (start, distance, sizing) = (start?, distance?, sizing?);
        let field = (&**distfield, distance.history().cloned());
        match (&args.sizefield, &sizing) {
            (Some(path), Some(sizing)) => drop(context.add_inputs([field, (path, sizing.history.clone())])?),
            _ => drop(context.add_inputs([field])?),
        }
        match (start, sizing) {
            (Start::Surface(previous), Some(sizing)) => {
                Ok(Self::Surface { previous, distance, sizing, reference: None })
            }
            (Start::Surface(_), None) => Err(no_size(args)),
            (Start::Particles(particles), sizing) => Ok(Self::Field { particles, distance, sizing }),
        }
    }
}

/// The particles to connect, or the surface to update.
#[expect(clippy::large_enum_variant, reason = "a run has only one value")]
enum Start {
    Particles(ParticleFile),
    Surface(SurfaceFile),
}

impl Start {
    fn read(args: &Args, context: &Context) -> Result<Self> {
        if !args.update {
            return particles(args, context).map(Self::Particles);
        }
        let file = read_surface(&args.particles)?;
        context.add_input(&args.particles, file.history.clone())?;
        Ok(Self::Surface(file))
    }
}

/// Returns the error of an update without a size field.
fn no_size(args: &Args) -> Error {
    Error::input(
        format!("{}: --update without a size field", args.particles.display()),
        "the size field shows where the surface must change",
        "pass --sizefield S.vti, which sizefield --update writes",
    )
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
