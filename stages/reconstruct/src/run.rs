//! The program in three steps: reads the inputs, computes the mesh of one object or of many
//! materials, and writes the surface. [`compute`] does not use any files.

pub use crate::args::Args;
use crate::args::check_field;
use crate::check::CheckReport;
use crate::finish::{attributes, attributes_of_materials};
pub use crate::input::Inputs;
use crate::input::{about, warn_unless_settled};
pub use crate::materials::each::{MaterialSurface, MaterialSurfaces};
use crate::materials::reconstruct::reconstruct as reconstruct_materials;
use crate::materials::subject::Materials;
use crate::offending::offending;
use crate::options::{Method, Options};
pub use crate::output::Made;
use crate::output::{check_offenders, describe_mesh};
use crate::points_alone::{self, Points};
use crate::reconstruct::{Joining, Reconstruction, reconstruct};
use crate::subject::{Object, Topology};
use crate::update::{Reference, update};
use crate::volumes::{Volumes, of_materials, of_object};
use isoparticles_field::particle_set::Strata;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::point_cloud::is_point_cloud;
use isoparticles_mesh::surface::{Surface, SurfaceFile, check_surface_name};
use isoparticles_stage::cli::{Context, FIT_BUT_FOR, Outcome, particles_bytes};
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, check_same_grid};
use isoparticles_stage::materials_file::{MaterialsFile, is_materials};
use isoparticles_stage::meta::{self, Border, DistanceMeta, MaterialsMeta, Source, SurfaceMeta};
use isoparticles_stage::particle_file::ParticleFile;
use isoparticles_stage::space::{file_space, parameter};
use isoparticles_volume::Geometry;
use serde_json::{Map, json};
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

/// Updates a finished surface. The fields and the optional `reference` are in the world frame
/// of the surface.
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
        refuse_failed(args, previous)?;
    }
    let surface = &previous.surface;
    let reference = reference.map_or_else(|| Reference::new(distance, context).map(Arc::new), Ok)?;
    match (distance, &*reference) {
        (DistanceField::Object(field), Reference::Object(reference)) => {
            let (spline, topology) = &**reference;
            let (told, options) = meta_of_object(args, field)?;
            let samples = (!options.open_border).then_some(&*field.image);
            let made = update(surface, &Object { field: spline, topology, samples }, &sizing, &options, context);
            finish(args, made, &Given::Object(told, spline), &options, context)
        }
        (DistanceField::Materials(file), Reference::Materials(nodes)) => {
            let (told, options) = meta_of_materials(args, file)?;
            let subject = Materials { indicators: &file.materials, nodes, table: file.materials.table() };
            let made = update(surface, &subject, &sizing, &options, context);
            finish(args, made, &Given::Materials(told, file), &options, context)
        }
        _ => unreachable!("the reference of another field"),
    }
}

/// Returns an error if a surface has failed a check. An update takes the junction curves and the
/// merged vertices from the surface, so faults of these pass its checks.
///
/// # Errors
/// If the metadata lists a failed check or cannot be read.
fn refuse_failed(args: &Args, previous: &SurfaceFile) -> Result<()> {
    let told: SurfaceMeta = meta::typed(&args.particles, &previous.meta, "reconstruct")?;
    match told.failed_checks.first() {
        None => Ok(()),
        Some(first) => Err(Error::input(
            format!("{}: a check has failed: {first}", args.particles.display()),
            "an update takes the junction curves from the surface, and its checks cannot find their faults",
            "update a surface that has passed, or change the options of the stages until it passes",
        )),
    }
}

/// Computes the surface from particles, their field and an optional size field.
fn compute_on_field(
    args: &Args,
    file: &ParticleFile,
    distance: &DistanceField,
    sizing: Option<&Field>,
    context: &Context,
) -> Result<Made> {
    warn_unless_settled(args, file, context);
    if distance.is_materials() {
        strata(args, file)?;
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
        DistanceField::Object(field) => {
            let (told, options) = meta_of_object(args, field)?;
            let step = context.step("spline");
            let spline = CubicSpline::new(&field.image);
            drop(step);
            let made = reconstruct(particles, (&spline, &field.image), sizing.as_ref(), &options, context);
            finish(args, made, &Given::Object(told, &spline), &options, context)
        }
        DistanceField::Materials(given) => {
            let (told, options) = meta_of_materials(args, given)?;
            let (particles, table) = ((particles, strata(args, file)?), given.materials.table());
            let made = reconstruct_materials(particles, &given.materials, table, sizing.as_ref(), &options, context);
            finish(args, made, &Given::Materials(told, given), &options, context)
        }
    }
}

/// Returns the strata of the particles.
///
/// # Errors
/// If the particles have no strata.
fn strata<'a>(args: &Args, file: &'a ParticleFile) -> Result<&'a Strata> {
    file.strata.as_ref().ok_or_else(|| {
        Error::input(
            format!("{}: the particles have no strata", args.particles.display()),
            "each particle needs the materials that meet at it",
            "pass the particles made from the same materials",
        )
    })
}

/// Returns the metadata of the field of one object, and the options for it.
fn meta_of_object(args: &Args, field: &Field) -> Result<(DistanceMeta, Options)> {
    let told: DistanceMeta = meta::typed(args.field_names()[0], &field.meta, "distfield")?;
    let (keeps_voxels, open_border) = (told.keeps_voxels(), told.border == Some(Border::Open));
    Ok((told, Options { keeps_voxels, open_border, ..args.options() }))
}

/// Returns the metadata of many materials, and the options for them.
fn meta_of_materials(args: &Args, file: &MaterialsFile) -> Result<(MaterialsMeta, Options)> {
    let [path, _] = args.field_names();
    let told: MaterialsMeta = meta::typed(path, &file.meta, "distfield")?;
    if told.border == Some(Border::Open) {
        return Err(Error::input(
            format!("{}: the materials are open at the border of the volume", path.display()),
            "interfaces of many materials must be closed there",
            "run distfield again with --border flat or --border cap",
        ));
    }
    // without a scale, the voxel centres of labels keep their materials
    let keeps_voxels = told.scale.is_none() && told.source.unwrap_or(Source::Labels) == Source::Labels;
    Ok((told, Options { keeps_voxels, ..args.options() }))
}

/// The field of a surface, with its metadata.
enum Given<'a> {
    /// One object, with F.
    Object(DistanceMeta, &'a CubicSpline),
    /// Many materials.
    Materials(MaterialsMeta, &'a MaterialsFile),
}

impl Given<'_> {
    fn geometry(&self) -> &Geometry {
        match self {
            Self::Object(_, spline) => spline.geometry(),
            Self::Materials(_, file) => file.materials.geometry(),
        }
    }

    fn volumes(&self, checked: &CheckReport) -> Vec<Volumes> {
        match self {
            Self::Object(told, _) => of_object(told, checked.object().volume),
            Self::Materials(told, _) => of_materials(told, &checked.regions),
        }
    }

    /// Returns the surface in world coordinates with its data, and the part of its metadata that
    /// depends on the kind of the field.
    fn surface(&self, made: &Reconstruction) -> (Surface, SurfaceMeta) {
        match self {
            Self::Object(told, spline) => {
                let surface = attributes(&made.interfaces.mesh, spline, &made.sizes, &told.cap_planes);
                let notes = Map::from_iter([("topology".to_owned(), json!(made.topology))]);
                let (source, border) = (told.source, told.border);
                (surface, SurfaceMeta { source, border, notes, ..SurfaceMeta::default() })
            }
            Self::Materials(told, file) => {
                let surface = attributes_of_materials(&made.interfaces, &made.sizes, self.geometry());
                let pairs: Vec<_> = made.checked.pairs.iter().map(|pair| &pair.between).collect();
                let notes = Map::from_iter([("interfaces".to_owned(), json!(pairs))]);
                let (table, caps) = file.materials.table().split_at(file.materials.indicators().len());
                let (materials, caps) = (table.to_vec(), caps.iter().map(|cap| cap.name.clone()).collect());
                let (source, border) = (Some(told.source.unwrap_or(Source::Labels)), told.border);
                (surface, SurfaceMeta { source, border, materials, caps, notes, ..SurfaceMeta::default() })
            }
        }
    }
}

/// Adds the results to the report, and returns the surface with its data.
fn finish(
    args: &Args,
    made: Result<Reconstruction>,
    given: &Given,
    options: &Options,
    context: &Context,
) -> Result<Made> {
    let made = made.map_err(|error| about(&args.particles, error))?;
    context.check_interrupt()?;
    tell(&made, context);
    let volumes = json!(given.volumes(&made.checked));
    context.report("volumes", volumes.clone());
    let (mut surface, mut meta) = given.surface(&made);
    made.kept.iter().for_each(|&(v, place)| surface.mesh.vertices[v as usize] = place);
    meta.notes.insert("volumes".to_owned(), volumes);
    meta.notes.extend(made.joining.iter().map(|joining| ("refine".to_owned(), json!(joining.refined))));
    let components = made.topology.components();
    let offending = offending(&made.interfaces.mesh, &made.checked, given.geometry(), options.keeps_voxels);
    let meta = SurfaceMeta { version: meta::VERSION, failed_checks: made.failed, components, ..meta };
    Ok(Made { surface, meta, offending })
}

/// Adds the results to the report and to the closing table, and issues the warnings.
fn tell(made: &Reconstruction, context: &Context) {
    let Reconstruction { checked, topology, joining, .. } = made;
    if let Some(joining) = joining {
        context.report("prepare", json!(joining.prepared));
        context.report("refine", json!(joining.refined));
        context.report("cocone", json!(joining.cocone));
        if let Some(cocone) = &joining.cocone {
            points_alone::warn(cocone, context);
        }
    }
    context.report("improve", json!(made.improved));
    context.report("check", json!(checked));
    context.report("topology", json!(topology));
    made.doubtful.iter().for_each(|doubt| context.warn(doubt));
    match topology {
        Topology::Object(report) => describe_mesh(checked, &report.expected(), context),
        Topology::Materials(pieces) => {
            describe_mesh(checked, "", context);
            let missing: usize = pieces.iter().map(|own| own.missing.len()).sum();
            let specks: usize = pieces.iter().map(|own| own.missing_specks).sum();
            context.summary("components missing, specks missing", format!("{missing}, {specks}"));
            let other = pieces.iter().filter(|own| own.euler_differs()).count();
            context.summary("materials of another Euler characteristic", other);
        }
    }
    match joining {
        Some(Joining { prepared, refined, .. }) => {
            let dropped = prepared.dropped();
            context.summary("particles used, not used", format!("{}, {dropped}", prepared.particles - dropped));
            let (points, rounds) = (refined.points(), refined.rounds);
            let on_curves = format!(", {} of them on junction curves", refined.on_curves);
            let on_curves = if refined.on_curves > 0 { &on_curves } else { "" };
            context.summary("points added", format!("{points} in {rounds} rounds{on_curves}"));
        }
        None => context.summary("vertices kept", made.kept.len()),
    }
    if made.failed.is_empty()
        && let Some(forced) = checked.forced()
    {
        context.warn(format!("{FIT_BUT_FOR}{} accepted triangles: {forced}", checked.poor_between_curves.len()));
    }
}
