//! The `seed` program: reads the fields, places the seeds by [`crate::sampling`] or
//! [`crate::vertices`], fills in the report and writes the file. [`compute()`] does not access
//! files, so it can be called as a library.

pub use crate::args::{Args, From};
use crate::limits::check_prediction;
use crate::sampling::{BYTES_PER_PARTICLE, Summary, seed_surface, seed_vertices};
use crate::vertices::{BYTES_PER_NODE, FINEST, vertices};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, FieldKind, check_same_grid, read_field};
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind};
use isoparticles_volume::Image;
use serde_json::{Value, json};
use std::sync::Arc;

/// Runs the stage.
///
/// # Errors
/// If a file cannot be read or written; and the errors of [`compute()`].
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    let step = context.step("read");
    let (distance, sizing) =
        rayon::join(|| DistanceField::read(&args.distfield), || read_field(&args.sizefield, FieldKind::Sizing));
    let (distance, sizing) = (distance?, sizing?);
    context.add_inputs([(&args.distfield, distance.history().cloned()), (&args.sizefield, sizing.history.clone())])?;
    drop(step);
    let made = compute(args, &distance, &sizing, context)?;
    let _step = context.step("write");
    made.write(&args.output)?;
    Ok(Outcome::Passed)
}

/// Seeds the surface of one object or the strata of several materials. Messages call the fields by
/// the paths in `args`.
///
/// # Errors
/// If the fields are on different grids, if there is no surface, if an option does not fit the
/// surface, if there is not enough memory, or if the run is interrupted.
pub fn compute(args: &Args, distance: &DistanceField, sizing: &Field, context: &Context) -> Result<ParticleFile> {
    check_same_grid((&args.distfield, distance.geometry()), (&args.sizefield, &sizing.image.geometry))?;
    context.check_interrupt()?;
    let sizing = SizingField::new(Arc::clone(&sizing.image));
    let (particles, strata, meta) = match distance {
        DistanceField::Object(field) => {
            let (particles, meta) = of_object(args, &field.image, &sizing, context)?;
            (particles, None, meta)
        }
        DistanceField::Materials(file) => {
            let (particles, strata, meta) = crate::materials::compute(args, &file.materials, sizing, context)?;
            (particles, Some(strata), meta)
        }
    };
    context.report("seeding", meta.clone());
    context.check_interrupt()?;
    let (kind, history) = (ParticleKind::Seeds, context.history());
    Ok(ParticleFile { kind, particles, strata, meta, history, extra: Vec::new() })
}

/// Seeds the surface of one object. Also returns the metadata of the file.
fn of_object(
    args: &Args,
    distance: &Image<f32>,
    sizing: &SizingField,
    context: &Context,
) -> Result<(ParticleSet, Value)> {
    let step = context.step("spline");
    let surface = CubicSpline::new(distance);
    drop(step);
    let (particles, summary) = match args.from {
        From::PoissonDisk => by_poisson_disks(args, distance, &surface, sizing, context)?,
        From::MarchingCubes => at_vertices(args, distance, &surface, sizing, context)?,
    };
    if particles.positions.is_empty() {
        return Err(Error::input(
            format!("{}: has no surface to seed", args.distfield.display()),
            "seeds are placed on F = 0, and no point on it was found",
            "check ISO or LABELS (distfield --iso, --labels)",
        ));
    }
    if summary.underpopulated_components > 0 {
        context.warn(format!(
            "{} of {} components are too small for their h and got extra particles; to mesh them better, lower SIZE, \
             MIN_SIZE or EPSILON (sizefield --uniform, --min-size, --epsilon)",
            summary.underpopulated_components, summary.components
        ));
    }
    context.summary("particles", particles.positions.len());
    if let Some(vertices) = summary.vertices {
        context.summary("vertices of marching cubes", vertices);
        context.summary("  cells along a voxel's edge", summary.refinement.unwrap_or(1));
    }
    context.summary("components", summary.components);
    context.summary("not projected", summary.not_projected);
    Ok((particles, json!(summary)))
}

/// Seeds the surface by Poisson-disk sampling.
fn by_poisson_disks(
    args: &Args,
    distance: &Image<f32>,
    surface: &CubicSpline,
    sizing: &SizingField,
    context: &Context,
) -> Result<(ParticleSet, Summary)> {
    let step = context.step("marching cubes");
    let mesh = marching_cubes(distance, 0.0);
    check_prediction(args, || sizing.count_on(&mesh.vertices, &mesh.triangles), context)?;
    drop(step);
    let scaled = args.count.map(|count| sizing.scaled((predicted(sizing, surface, context) / count as f64).sqrt()));
    Ok(seed_surface(&mesh, surface, (scaled.as_ref().unwrap_or(sizing), sizing), context.seed(), context)?)
}

/// Seeds the surface at marching-cubes vertices.
fn at_vertices(
    args: &Args,
    distance: &Image<f32>,
    surface: &CubicSpline,
    sizing: &SizingField,
    context: &Context,
) -> Result<(ParticleSet, Summary)> {
    check_prediction(args, || predicted(sizing, surface, context), context)?;
    let has_room = |nodes: usize| {
        context.check_memory(
            BYTES_PER_NODE * nodes as f64,
            &format!("{}: a finer grid of {nodes} nodes for --count", args.distfield.display()),
            "lower COUNT (--count), or leave out --from marching-cubes",
        )
    };
    let found = vertices(distance, surface, args.count.map(|n| n as usize), has_room, context)?;
    if let Some(count) = args.count.filter(|&count| found.available > 0 && (found.available as u64) < count) {
        return Err(Error::input(
            format!(
                "--count {count}: marching cubes on {} gives {} vertices on a grid {FINEST} times as fine as the \
                 voxels",
                args.distfield.display(),
                found.available
            ),
            "--from marching-cubes places each seed at a different vertex",
            format!("set COUNT (--count) to {} or less, or leave out --from marching-cubes", found.available),
        ));
    }
    context.check_memory(
        BYTES_PER_PARTICLE * found.points.len() as f64,
        &format!("{}: seeding {} vertices of marching cubes", args.distfield.display(), found.points.len()),
        "set COUNT (--count), or leave out --from marching-cubes",
    )?;
    Ok(seed_vertices(&found, surface, sizing, context.seed(), context)?)
}

/// Predicts the number of particles by integration over F = 0, as a step timed in the report.
fn predicted(sizing: &SizingField, surface: &CubicSpline, context: &Context) -> f64 {
    let _step = context.step("predict the count");
    sizing.predicted_count(surface)
}
