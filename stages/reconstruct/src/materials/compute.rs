//! Meshes many materials by [`reconstruct`], and returns the surface of all interfaces. Adds the
//! results to the report.

use super::each::SIDES;
use super::nodes::Nodes;
use super::reconstruct::{Joining, Reconstruction, reconstruct};
use super::update::update;
use crate::args::Args;
use crate::input::about;
use crate::interfaces::Interfaces;
use crate::offending::offending;
use crate::options::Options;
use crate::output::{Made, describe_mesh};
use crate::volumes::of_materials;
use isoparticles_field::materials::MaterialId;
use isoparticles_field::particle_set::Strata;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::quality::radius_ratios;
use isoparticles_mesh::surface::{DataArray, Surface, SurfaceFile};
use isoparticles_stage::cli::{Context, FIT_BUT_FOR};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::materials_file::MaterialsFile;
use isoparticles_stage::meta::{self, Border, MaterialsMeta, Source, SurfaceMeta};
use isoparticles_stage::particle_file::ParticleFile;
use isoparticles_volume::Geometry;
use serde_json::json;

/// Meshes the interfaces between materials.
///
/// # Errors
/// If the particles have no strata or are not on them, if the materials are open at the border of
/// the volume, or if the run is interrupted.
pub(crate) fn compute(
    args: &Args,
    file: &ParticleFile,
    given: &MaterialsFile,
    sizing: Option<&SizingField>,
    context: &Context,
) -> Result<Made> {
    let strata = strata(args, file)?;
    let (told, options) = told(args, given)?;
    let names = given.materials.table();
    let made = reconstruct((&file.particles, strata), &given.materials, names, sizing, &options, context)
        .map_err(|error| about(&args.particles, error))?;
    finished(&made, given, &told, &options, context)
}

/// Returns an error if a surface has failed a check. An update takes the junction curves and the
/// merged vertices from the surface, so its checks cannot find their faults.
///
/// # Errors
/// If the metadata lists a failed check or cannot be read.
pub(crate) fn refuse_failed(args: &Args, previous: &SurfaceFile) -> Result<()> {
    let told: SurfaceMeta = meta::typed(&args.particles, &previous.meta, "reconstruct")?;
    match told.failed_checks.first() {
        None => Ok(()),
        Some(first) => Err(Error::input(
            format!("{}: a check has failed: {first}", args.particles.display()),
            "an update takes the junction curves from the surface, and its checks cannot find their faults",
            "update a surface that has passed, or change the options of the stages until this one does",
        )),
    }
}

/// Updates the interfaces of `previous` where h has changed to `sizing`.
///
/// # Errors
/// Those of [`update()`].
pub(crate) fn compute_update(
    args: &Args,
    previous: &Surface,
    (given, nodes): (&MaterialsFile, &Nodes),
    sizing: &SizingField,
    context: &Context,
) -> Result<Made> {
    let (told, options) = told(args, given)?;
    let (materials, names) = (&given.materials, given.materials.table());
    let made = update(previous, (materials, nodes), names, sizing, &options, context)
        .map_err(|error| about(&args.particles, error))?;
    finished(&made, given, &told, &options, context)
}

/// Returns the metadata of the materials, and the options for them.
fn told(args: &Args, given: &MaterialsFile) -> Result<(MaterialsMeta, Options)> {
    let [path, _] = args.field_names();
    let told: MaterialsMeta = meta::typed(path, &given.meta, "distfield")?;
    if told.border == Some(Border::Open) {
        return Err(Error::input(
            format!("{}: the materials are open at the border of the volume", path.display()),
            "interfaces of many materials must be closed there",
            "run distfield again with --border flat or --border cap",
        ));
    }
    // without a scale, the voxel centres of labels keep their materials
    let keeps_voxels = told.scale.is_none() && told.source.unwrap_or(Source::Labels) == Source::Labels;
    Ok((told, Options { keeps_voxels, ..args.general_options() }))
}

/// Adds the results to the report, and returns the surface with its data.
fn finished(
    made: &Reconstruction,
    given: &MaterialsFile,
    told: &MaterialsMeta,
    options: &Options,
    context: &Context,
) -> Result<Made> {
    context.check_interrupt()?;
    tell(made, context);
    let geometry = given.materials.geometry();
    let pairs: Vec<_> = made.checked.pairs.iter().map(|pair| &pair.between).collect();
    let volumes = json!(of_materials(told, &made.checked.regions));
    context.report("volumes", volumes.clone());
    let refined = made.joining.as_ref().map(|joining| ("refine", json!(joining.refined)));
    let notes = [("volumes", volumes), ("interfaces", json!(pairs))].into_iter().chain(refined);
    let (table, caps) = given.materials.table().split_at(given.materials.indicators().len());
    let mut surface = attributes(made, geometry);
    made.kept.iter().for_each(|&(v, place)| surface.mesh.vertices[v as usize] = place);
    let meta = SurfaceMeta {
        version: meta::VERSION,
        source: Some(told.source.unwrap_or(Source::Labels)),
        border: told.border,
        failed_checks: made.failed.clone(),
        components: made.pieces.iter().map(|own| own.components).sum(),
        materials: table.to_vec(),
        caps: caps.iter().map(|cap| cap.name.clone()).collect(),
        notes: notes.map(|(name, note)| (name.to_owned(), note)).collect(),
    };
    let offending = offending(&made.interfaces.mesh, &made.checked, geometry, options.keeps_voxels);
    Ok(Made { surface, meta, offending })
}

/// Returns the strata of the particles.
///
/// # Errors
/// If the particles have no strata.
pub(crate) fn strata<'a>(args: &Args, file: &'a ParticleFile) -> Result<&'a Strata> {
    file.strata.as_ref().ok_or_else(|| {
        Error::input(
            format!("{}: the particles have no strata", args.particles.display()),
            "each particle needs the materials that meet at it",
            "pass the particles made from the same materials",
        )
    })
}

/// Returns the interfaces in the world frame, with attributes of vertices (h, number of materials
/// that meet) and triangles (the two regions, radius ratio, and the number of the plane in which
/// the triangle lies, from 1).
fn attributes(made: &Reconstruction, geometry: &Geometry) -> Surface {
    let Interfaces { mesh, between, first_beyond, .. } = &made.interfaces;
    let mut surface = Surface::from_grid(mesh, geometry);
    let meeting = made.interfaces.materials_at_vertices().iter().map(|ids| ids.len() as i64).collect();
    surface.point_data = vec![DataArray::scalars("h", made.sizes.clone()), DataArray::integers("materials", meeting)];
    let side = |n: usize| {
        let of = |t: u32| i64::from(made.interfaces.regions_of(t)[n].0);
        (0..between.len() as u32).map(of).collect()
    };
    surface.cell_data = vec![
        DataArray::integers(SIDES[0], side(0)),
        DataArray::integers(SIDES[1], side(1)),
        DataArray::scalars("radius_ratio", radius_ratios(mesh)),
    ];
    if let Some(first) = first_beyond {
        let cap = |pair: &[MaterialId; 2]| i64::from((pair[1].0 + 1).saturating_sub(first.0));
        surface.cell_data.push(DataArray::integers("cap", between.iter().map(cap).collect()));
    }
    surface
}

/// Adds the results to the report and the closing table, and warns of remaining violations.
fn tell(made: &Reconstruction, context: &Context) {
    let Reconstruction { checked, joining, improved, .. } = made;
    if let Some(Joining { taken, refined }) = joining {
        context.report("prepare", json!(taken));
        context.report("refine", json!(refined));
    }
    context.report("improve", json!(improved));
    context.report("check", json!(checked));
    context.report("topology", json!(made.pieces));
    describe_mesh(checked, "", context);
    let missing: usize = made.pieces.iter().map(|own| own.missing.len()).sum();
    let specks: usize = made.pieces.iter().map(|own| own.missing_specks).sum();
    context.summary("components missing, specks missing", format!("{missing}, {specks}"));
    match joining {
        Some(joining) => tell_joining(joining, context),
        None => context.summary("vertices kept", made.kept.len()),
    }
    if made.failed.is_empty()
        && let Some(forced) = checked.forced()
    {
        context.warn(format!("{FIT_BUT_FOR}{} accepted triangles: {forced}", checked.poor_between_curves.len()));
    }
}

fn tell_joining(Joining { taken, refined }: &Joining, context: &Context) {
    let lost = &taken.particles;
    let dropped = lost.not_projected + lost.crowded + taken.encroaching;
    let used = lost.particles.saturating_sub(dropped);
    context.summary("particles used, not used", format!("{used}, {dropped}"));
    context.summary(
        "points added",
        format!("{}, {} of them on junction curves", refined.inserted.values().sum::<usize>(), refined.on_curves),
    );
    if !refined.unresolved.is_empty() {
        let left: Vec<String> =
            refined.unresolved.iter().map(|(reason, n)| format!("{n} of {}", json!(reason))).collect();
        context.warn(format!(
            "refinement ended at its smallest radius with violations left: {}; where materials meet at small angles, or a layer ends in an edge, a smaller h helps \
             (sizefield without --uniform grades it by thickness)",
            left.join(", ")
        ));
    }
}
