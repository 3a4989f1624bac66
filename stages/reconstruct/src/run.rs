//! The program in three steps: reads the inputs, computes the mesh of one object or of many
//! materials, and writes the surface. [`compute`] does not use any files.

pub use crate::args::Args;
use crate::args::check_field;
use crate::finish::attributes;
pub use crate::input::Inputs;
use crate::input::{about, warn_unless_settled};
use crate::materials;
pub use crate::materials::each::{MaterialSurface, MaterialSurfaces};
use crate::offending::offending;
use crate::options::{Method, Options};
pub use crate::output::Made;
use crate::output::{check_offenders, describe_mesh};
use crate::points_alone::{self, Points};
use crate::reconstruct::{Joining, Reconstruction, reconstruct};
use crate::update::{Reference, update};
use crate::volumes;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::point_cloud::is_point_cloud;
use isoparticles_mesh::surface::{SurfaceFile, check_surface_name};
use isoparticles_stage::cli::{Context, Outcome, particles_bytes};
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, check_same_grid};
use isoparticles_stage::materials_file::is_materials;
use isoparticles_stage::meta::{self, DistanceMeta, SurfaceMeta};
use isoparticles_stage::particle_file::ParticleFile;
use isoparticles_stage::space::{file_space, parameter};
use serde_json::json;
use std::sync::Arc;

/// Runs the stage.
///
/// # Errors
/// If the options do not fit the inputs, if files cannot be read or written, and the errors of
/// [`compute`].
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    check_surface_name(&args.output)?;
    check_offenders(args)?;
    check_files(args)?;
    let inputs = Inputs::read(args, context)?;
    compute(args, inputs, context)?.write(args, context)
}

/// Returns an error if the options do not fit each other or the kinds of the input files.
fn check_files(args: &Args) -> Result<()> {
    let particles = args.particles.display();
    match (&args.distfield, args.method) {
        (None, Method::TightCocone) => Ok(()),
        (None, Method::Restricted) => Err(Error::input(
            format!("{particles}: no distance field is given"),
            "--method restricted needs it to separate inside from outside",
            "pass --distfield F.vti, or use --method tight-cocone to mesh the points without a field",
        )),
        (Some(field), _) if !args.update && is_point_cloud(&args.particles) => Err(Error::input(
            format!("{particles}: is a point cloud, but {} is the distance field of a volume", field.display()),
            "a point cloud has no position in the grid of the field",
            "omit --distfield and use --method tight-cocone, or pass the particles made from the field",
        )),
        (Some(field), _) => check_field(args, field, is_materials(field)),
    }
}

/// Computes and checks the surface, and adds the results to the report. Messages call the inputs by
/// the paths in `args`. Without a field, the method is Tight Cocone.
///
/// # Errors
/// If the inputs do not belong together or need too much memory, if no mesh can be made from them,
/// or if the run is interrupted. A mesh that fails a check is not an error
/// ([`SurfaceMeta::failed_checks`]).
pub fn compute(args: &Args, inputs: Inputs, context: &Context) -> Result<Made> {
    match inputs {
        Inputs::Cloud(cloud) => {
            let file = cloud.history.as_ref().and_then(file_space);
            points_alone::compute(args, Points::of_cloud(cloud), file, context)
        }
        Inputs::Particles(file) => {
            warn_unless_settled(args, &file, context);
            let of_file = file_space(&file.history);
            points_alone::compute(args, Points::of_particles(file.particles), of_file, context)
        }
        Inputs::Field { mut particles, mut distance, mut sizing } => {
            if let Some(choice) = args.space {
                let file = distance.history().and_then(file_space);
                let space = choice.of(distance.geometry().clone(), file)?.space;
                particles.particles.geometry = particles.particles.geometry.in_space(space);
                distance = distance.in_space(space);
                sizing = sizing.map(|sizing| sizing.in_space(space));
            }
            compute_on_field(args, &particles, &distance, sizing.as_ref(), context)
        }
        Inputs::Surface { previous, distance, sizing, reference } => {
            let space = previous.surface.space;
            let reference = reference.filter(|_| distance.geometry().space == space);
            let fields = (&distance.in_space(space), reference);
            compute_update(args, &previous, fields, &sizing.in_space(space), context)
        }
    }
}

/// Updates a finished surface. `distance`, `sizing` and `reference`, if given, are in the world
/// frame of the surface.
fn compute_update(
    args: &Args,
    previous: &SurfaceFile,
    (distance, reference): (&DistanceField, Option<Arc<Reference>>),
    sizing: &Field,
    context: &Context,
) -> Result<Made> {
    let ([path, size_path], geometry) = (args.field_names(), distance.geometry());
    if previous.surface.space != geometry.space {
        return Err(Error::input(
            format!("{}: is not in the same space as {}", args.particles.display(), path.display()),
            "their positions cannot be compared",
            "pass the distance field from which the surface was made",
        ));
    }
    check_same_grid((size_path, &sizing.image.geometry), (path, geometry))?;
    context.set_parameter("space", parameter(geometry.space));
    let count = previous.surface.mesh.vertices.len();
    context.check_memory(
        particles_bytes(count as f64, geometry.voxel_count()),
        &format!("{}: {count} vertices", args.particles.display()),
        "raise --max-memory",
    )?;
    let sizing = SizingField::new(Arc::clone(&sizing.image));
    if distance.is_materials() {
        materials::compute::refuse_failed(args, previous)?;
    }
    let surface = &previous.surface;
    let reference = reference.map_or_else(|| Reference::new(distance, context).map(Arc::new), Ok)?;
    match (distance, &*reference) {
        (DistanceField::Object(field), Reference::Object(spline, topology)) => {
            let told: DistanceMeta = meta::typed(path, &field.meta, "distfield")?;
            let options = args.options(&told);
            let made = update(surface, &field.image, (spline, topology), &sizing, &options, context)
                .map_err(|error| about(&args.particles, error))?;
            finished(made, &told, &options, context)
        }
        (DistanceField::Materials(given), Reference::Materials(nodes)) => {
            materials::compute::compute_update(args, surface, (given, nodes), &sizing, context)
        }
        _ => unreachable!("the reference of another field"),
    }
}

/// Computes the surface from particles, their field and the size field if given.
fn compute_on_field(
    args: &Args,
    file: &ParticleFile,
    distance: &DistanceField,
    sizing: Option<&Field>,
    context: &Context,
) -> Result<Made> {
    warn_unless_settled(args, file, context);
    if distance.is_materials() {
        materials::compute::strata(args, file)?;
    }
    let (particles, geometry) = (&file.particles, distance.geometry());
    let [path, size_path] = args.field_names();
    check_same_grid((&args.particles, &particles.geometry), (path, geometry))?;
    context.set_parameter("space", parameter(geometry.space));
    let count = particles.positions.len();
    let fewer = match distance {
        DistanceField::Object(_) => "reduce their number: sizefield --min-size, --scale or --quality coarse",
        DistanceField::Materials(_) => "reduce their number: sizefield --min-size or --quality coarse",
    };
    context.check_memory(
        particles_bytes(count as f64, geometry.voxel_count()),
        &format!("{}: {count} particles", args.particles.display()),
        fewer,
    )?;
    if let Some(sizing) = sizing {
        check_same_grid((size_path, &sizing.image.geometry), (path, geometry))?;
    }
    let sizing = sizing.map(|field| SizingField::new(Arc::clone(&field.image)));
    match distance {
        DistanceField::Object(field) => of_object(args, particles, field, sizing.as_ref(), context),
        DistanceField::Materials(field) => materials::compute::compute(args, file, field, sizing.as_ref(), context),
    }
}

/// Meshes one object.
fn of_object(
    args: &Args,
    particles: &ParticleSet,
    field: &Field,
    sizing: Option<&SizingField>,
    context: &Context,
) -> Result<Made> {
    let told: DistanceMeta = meta::typed(args.field_names()[0], &field.meta, "distfield")?;
    let options = args.options(&told);
    let made = reconstruct(particles, &field.image, sizing, &options, context)
        .map_err(|error| about(&args.particles, error))?;
    finished(made, &told, &options, context)
}

/// Adds the results for one object to the report, and returns the surface with its data.
fn finished(made: Reconstruction, told: &DistanceMeta, options: &Options, context: &Context) -> Result<Made> {
    context.check_interrupt()?;
    tell(&made, context);
    let volumes = json!(volumes::of_object(told, made.checked.object().volume));
    context.report("volumes", volumes.clone());
    let refined = made.joining.as_ref().map(|joining| ("refine", json!(joining.refined)));
    let notes = [("topology", json!(made.topology)), ("volumes", volumes)].into_iter().chain(refined);
    let mut surface = attributes(&made.mesh, &made.field, &made.sizes, &told.cap_planes);
    made.kept.iter().for_each(|&(v, place)| surface.mesh.vertices[v as usize] = place);
    let meta = SurfaceMeta {
        version: meta::VERSION,
        source: told.source,
        border: told.border,
        failed_checks: made.failed,
        components: made.topology.field.components,
        materials: Vec::new(),
        caps: Vec::new(),
        notes: notes.map(|(name, note)| (name.to_owned(), note)).collect(),
    };
    let offending = offending(&made.mesh, &made.checked, made.field.geometry(), options.keeps_voxels);
    Ok(Made { surface, meta, offending })
}

/// Adds the results to the report and to the closing table, and issues the warnings.
fn tell(made: &Reconstruction, context: &Context) {
    let Reconstruction { checked, topology, joining, .. } = made;
    if let Some(joining) = joining {
        context.report("prepare", json!(joining.prepared));
        context.report("refine", json!(joining.refined));
        context.report("cocone", json!(joining.cocone));
        context.report("parted_vertices", joining.parted);
        if let Some(cocone) = &joining.cocone {
            points_alone::warn(cocone, context);
        }
    }
    context.report("improve", json!(made.improved));
    context.report("check", json!(checked));
    context.report("topology", json!(topology));
    made.doubtful.iter().for_each(|doubt| context.warn(doubt));
    describe_mesh(checked, &topology.expected(), context);
    match joining {
        Some(Joining { prepared, taken, refined, .. }) => {
            context.summary("particles used, not used", format!("{taken}, {}", prepared.dropped()));
            context.summary("points added", format!("{} in {} rounds", refined.points(), refined.rounds));
        }
        None => context.summary("vertices kept", made.kept.len()),
    }
}
