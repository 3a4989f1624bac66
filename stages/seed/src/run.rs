//! The `seed` program: parses the options, reads the fields, places the seeds by
//! [`crate::sampling`] or [`crate::vertices`], fills in the report and writes the file.
//! [`compute()`] does not access files, so it can be called as a library.

use crate::sampling::{BYTES_PER_PARTICLE, COMPONENT_MINIMUM, Summary, seed_surface, seed_vertices};
use crate::vertices::{BYTES_PER_NODE, FINEST, vertices};
use clap::{Parser, ValueEnum};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::cli::{CommonArgs, Context, FILES, METHOD, Outcome, StageArgs};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, FieldKind, check_same_grid, read_field};
use isoparticles_stage::ground::Ground;
use isoparticles_stage::particle_file::{ParticleFile, ParticleKind};
use isoparticles_volume::Image;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Source of the seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum From {
    /// Random positions at the density that the size field specifies.
    PoissonDisk,
    /// All marching-cubes vertices of the distance field, as in the paper; density control deletes
    /// surplus particles.
    MarchingCubes,
}

/// Places the initial particles on every component of the isosurface F = 0, at approximately the
/// density that the size field specifies
#[derive(Debug, Parser)]
#[command(
    name = "seed",
    version,
    after_help = "Example:\n  seed heart.distfield.vti heart.sizefield.vti -o heart.seeds.bin\n\n\
        Paper: section 3.1 and Eq. 5. The paper seeds as with --from marching-cubes; adding --count gives the seeds of its synthetic test (Table 3)."
)]
pub struct Args {
    /// Distance field, or indicators of several materials, written by distfield
    #[arg(value_name = "F.vti", help_heading = FILES)]
    pub(crate) distfield: PathBuf,
    /// Size field on the same grid, written by sizefield
    #[arg(value_name = "S.vti", help_heading = FILES)]
    pub(crate) sizefield: PathBuf,
    /// Particle file to write
    #[arg(short, long, value_name = "seeds.bin", help_heading = FILES)]
    pub(crate) output: PathBuf,
    /// Source of the seeds (one object only)
    #[arg(long, value_enum, default_value_t = From::PoissonDisk, help_heading = METHOD)]
    pub(crate) from: From,
    /// Number of particles to seed, 4 or more, instead of the number that the size field requires;
    /// approximate, because each component receives some particles. With --from marching-cubes, the
    /// number is exact: evenly spread vertices are used, from a finer grid if there are too few
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(4..), help_heading = METHOD)]
    pub(crate) count: Option<u64>,
    #[command(flatten)]
    common: CommonArgs,
}

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        &self.common
    }

    fn outputs(&self) -> Vec<PathBuf> {
        vec![self.output.clone()]
    }

    fn parameters(&self) -> Value {
        json!({ "from": self.from, "count": self.count })
    }
}

/// Runs the stage.
///
/// # Errors
/// If a file cannot be read or written; and the errors of [`compute()`].
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    let step = context.step("read");
    let (ground, sizing) =
        rayon::join(|| Ground::read(&args.distfield), || read_field(&args.sizefield, FieldKind::Sizing));
    let (ground, sizing) = (ground?, sizing?);
    context.add_inputs([(&args.distfield, ground.history().cloned()), (&args.sizefield, sizing.history.clone())])?;
    drop(step);
    let made = compute(args, &ground, sizing, context)?;
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
pub fn compute(args: &Args, ground: &Ground, sizing: Field, context: &Context) -> Result<ParticleFile> {
    check_same_grid((&args.distfield, ground.geometry()), (&args.sizefield, &sizing.image.geometry))?;
    context.check_interrupt()?;
    let sizing = SizingField::new(sizing.image);
    let (particles, strata, meta) = match ground {
        Ground::Object(field) => {
            let (particles, meta) = of_object(args, &field.image, &sizing, context)?;
            (particles, None, meta)
        }
        Ground::Materials(file) => {
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

/// Returns an error if h is too large for the object, or if the particles do not fit into memory.
/// Calls `predicted` only if --count is not given.
pub(crate) fn check_prediction(args: &Args, predicted: impl FnOnce() -> f64, context: &Context) -> Result<()> {
    let sizes = args.sizefield.display();
    let count = args.count.map_or_else(predicted, |count| count as f64);
    // a missing surface has its own error message
    if count > 0.0 && count < COMPONENT_MINIMUM as f64 && args.count.is_none() {
        return Err(Error::input(
            format!("{sizes}: h is too large for the object: it gives {count:.1} particles on the whole surface"),
            format!("a closed surface needs at least {COMPONENT_MINIMUM} particles"),
            "lower SIZE or MIN_SIZE (sizefield --uniform, --min-size), or leave them out: the defaults follow the \
             object",
        ));
    }
    context.check_memory(
        BYTES_PER_PARTICLE * count,
        &format!("{sizes}: seeding {count:.0} particles"),
        "raise SIZE or MIN_SIZE (sizefield --uniform, --min-size), lower COUNT (--count), or set \
         SIZEFIELD_OPTIONS=\"--scale 2\"",
    )
}
