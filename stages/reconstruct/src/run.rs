//! The program: reads the inputs, meshes one object, and writes the surface and the report. Passes
//! many materials and points without a field on to their own modules.

pub use crate::args::Args;
use crate::args::check_each;
use crate::finish::attributes;
use crate::input::{about, read_settled};
use crate::offending::offending;
use crate::options::Method;
use crate::output::{check_offenders, describe_mesh, write};
use crate::points_alone;
use crate::reconstruct::{Reconstruction, reconstruct};
use crate::volumes;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::point_cloud::is_point_cloud;
use isoparticles_mesh::surface::check_surface_name;
use isoparticles_stage::cli::{Context, Outcome, particles_bytes};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{FieldKind, check_same_grid, read_field};
use isoparticles_stage::materials_file::is_materials;
use isoparticles_stage::meta::{self, DistanceMeta, SurfaceMeta};
use serde_json::json;
use std::path::Path;

/// Runs the stage.
///
/// # Errors
/// If files cannot be read or written or do not belong together, if a distance field is missing or
/// does not fit the particles, or if the run is interrupted; and the errors of [`reconstruct()`].
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    check_surface_name(&args.output)?;
    check_offenders(args)?;
    let particles = args.particles.display();
    match (&args.distfield, args.method) {
        (None, Method::TightCocone) => points_alone::run(args, context),
        (None, Method::Restricted) => Err(Error::input(
            format!("{particles}: no distance field is given"),
            "--method restricted needs it to separate inside from outside",
            "pass --distfield F.vti, or use --method tight-cocone to mesh the points without a field",
        )),
        (Some(field), _) if is_point_cloud(&args.particles) => Err(Error::input(
            format!("{particles}: is a point cloud, but {} is the distance field of a volume", field.display()),
            "a point cloud has no position in the grid of the field",
            "omit --distfield and use --method tight-cocone, or pass the particles made from the field",
        )),
        (Some(field), _) if is_materials(field) => crate::materials::run::run(args, field, context),
        (Some(field), _) => {
            check_each(args, field)?;
            on_field(args, field, context)
        }
    }
}

fn on_field(args: &Args, distfield: &Path, context: &Context) -> Result<Outcome> {
    let step = context.step("read");
    let (particles, (field, sizing)) = rayon::join(
        || read_settled(args, context),
        || {
            let sizing = || args.sizefield.as_deref().map(|path| read_field(path, FieldKind::Sizing)).transpose();
            rayon::join(|| read_field(distfield, FieldKind::Distance), sizing)
        },
    );
    let (particles, field, sizing) = (particles?.particles, field?, sizing?);
    check_same_grid((&args.particles, &particles.geometry), (distfield, &field.image.geometry))?;
    let count = particles.positions.len();
    context.check_memory(
        particles_bytes(count as f64, field.image.geometry.voxel_count()),
        &format!("{}: {count} particles", args.particles.display()),
        "reduce their number: sizefield --min-size, --scale or --quality coarse",
    )?;
    let sizing = match (&args.sizefield, sizing) {
        (Some(path), Some(sizing)) => {
            check_same_grid((path, &sizing.image.geometry), (distfield, &field.image.geometry))?;
            context.add_inputs([(distfield, field.history.clone()), (path, sizing.history)])?;
            Some(SizingField::new(sizing.image))
        }
        _ => {
            context.add_input(distfield, field.history.clone())?;
            None
        }
    };
    let told: DistanceMeta = meta::typed(distfield, &field.meta, "distfield")?;
    drop(step);
    let options = args.options(&told);
    let made = reconstruct(&particles, &field.image, sizing.as_ref(), &options, context)
        .map_err(|error| about(&args.particles, error))?;
    context.check_interrupt()?;
    tell(&made, context);

    let surface = attributes(&made.mesh, &made.field, &made.sizes, &told.cap_planes);
    let volumes = json!(volumes::of_object(&told, made.checked.object().volume));
    context.report("volumes", volumes.clone());
    let notes = [("topology", json!(made.topology)), ("refine", json!(made.refined)), ("volumes", volumes)];
    let meta = SurfaceMeta {
        version: meta::VERSION,
        source: told.source,
        border: told.border,
        failed_checks: made.failed.clone(),
        components: made.topology.field.components,
        materials: Vec::new(),
        notes: notes.into_iter().map(|(name, note)| (name.to_owned(), note)).collect(),
    };
    let offending = offending(&made.mesh, &made.checked, made.field.geometry(), options.keeps_voxels);
    write(args, context, &surface, &meta, offending, made.failed)
}

/// Adds the results to the report and to the closing table, and issues the warnings.
fn tell(made: &Reconstruction, context: &Context) {
    let Reconstruction { checked, topology, refined, .. } = made;
    context.report("prepare", json!(made.prepared));
    context.report("refine", json!(refined));
    context.report("cocone", json!(made.cocone));
    context.report("parted_vertices", made.parted);
    context.report("improve", json!(made.improved));
    context.report("check", json!(checked));
    context.report("topology", json!(topology));
    if let Some(cocone) = &made.cocone {
        points_alone::warn(cocone, context);
    }
    made.doubtful.iter().for_each(|doubt| context.warn(doubt));
    describe_mesh(checked, &topology.expected(), [made.taken, made.prepared.dropped()], context);
    context.summary("points added", format!("{} in {} rounds", refined.points(), refined.rounds));
}
