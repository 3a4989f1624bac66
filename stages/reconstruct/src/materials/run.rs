//! The program for many materials: reads the indicators, particles and target edge lengths,
//! reconstructs and checks the interfaces, and writes the report and the surfaces.

use super::reconstruct::{Reconstruction, reconstruct};
use crate::args::{Args, check_method};
use crate::input::{about, read_settled, read_sizing};
use crate::interfaces::Interfaces;
use crate::offending::offending;
use crate::output::{check_offenders, describe_mesh, write};
use crate::volumes::of_materials;
use isoparticles_field::materials::{Material, MaterialId};
use isoparticles_mesh::quality::radius_ratios;
use isoparticles_mesh::surface::{DataArray, Surface, write_surface};
use isoparticles_stage::cli::{Context, FIT_BUT_FOR, Outcome, particles_bytes};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::check_same_grid;
use isoparticles_stage::materials_file::read_materials;
use isoparticles_stage::meta::{self, Border, MaterialsMeta, Source, SurfaceMeta};
use isoparticles_volume::Geometry;
use serde_json::{Map, json};
use std::collections::BTreeSet;
use std::path::Path;

/// Runs the stage on the indicators of many materials.
///
/// # Errors
/// If a file cannot be read or written, the files do not belong together, the particles are not on
/// their strata, an option applies to one object only, or the run is interrupted.
pub fn run(args: &Args, path: &Path, context: &Context) -> Result<Outcome> {
    check_method(args, path)?;
    check_offenders(args)?;
    let step = context.step("read");
    let file = read_settled(args, context)?;
    let Some(strata) = file.strata else {
        return Err(Error::input(
            format!("{}: the particles have no strata", args.particles.display()),
            "each particle needs the materials that meet at it",
            "pass the particles made from the same materials",
        ));
    };
    let given = read_materials(path)?;
    let geometry = given.materials.geometry().clone();
    check_same_grid((&args.particles, &file.particles.geometry), (path, &geometry))?;
    let told: MaterialsMeta = meta::typed(path, &given.meta, "distfield")?;
    if told.border == Some(Border::Open) {
        return Err(Error::input(
            format!("{}: the materials are open at the border of the volume", path.display()),
            "interfaces of many materials must be closed there",
            "run distfield with --border cap",
        ));
    }
    let count = file.particles.positions.len();
    context.check_memory(
        particles_bytes(count as f64, geometry.voxel_count()),
        &format!("{}: {count} particles", args.particles.display()),
        "reduce their number: sizefield --min-size or --quality coarse",
    )?;
    context.add_input(path, given.history.clone())?;
    let sizing = args.sizefield.as_deref().map(|size| read_sizing(size, (path, &geometry), context)).transpose()?;
    drop(step);
    // without a scale, voxel centres keep their materials
    let options = crate::options::Options { keeps_voxels: told.scale.is_none(), ..args.general_options() };
    let table = given.materials.table();
    let made = reconstruct((&file.particles, &strata), &given.materials, table, sizing.as_ref(), &options, context)
        .map_err(|error| about(&args.particles, error))?;
    context.check_interrupt()?;
    tell(&made, context);

    let surface = attributes(&made, &geometry);
    let volumes = json!(of_materials(&told, &made.checked.regions));
    context.report("volumes", volumes.clone());
    let mut notes = Map::new();
    notes.insert("volumes".to_owned(), volumes);
    notes.insert("refine".to_owned(), json!(made.refined));
    notes.insert(
        "interfaces".to_owned(),
        json!(made.checked.pairs.iter().map(|pair| &pair.between).collect::<Vec<_>>()),
    );
    let meta = SurfaceMeta {
        version: meta::VERSION,
        source: Some(Source::Labels),
        border: told.border,
        failed_checks: made.failed.clone(),
        components: made.pieces.iter().map(|own| own.components).sum(),
        materials: table.to_vec(),
        notes,
    };
    if args.output.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("vtp")) {
        context.warn(format!(
            "{}: only .vtp files store the names of the materials; .stl files do not store the materials of the triangles either",
            args.output.display()
        ));
    }
    if let Some(folder) = &args.each {
        write_each(folder, args, &made, table, &geometry, context)?;
    }
    let failed = made.failed.clone();
    if failed.is_empty()
        && let Some(forced) = made.checked.forced()
    {
        context.warn(format!("{FIT_BUT_FOR}{} accepted triangles: {forced}", made.checked.poor_between_curves.len()));
    }
    let offending = offending(&made.interfaces.mesh, &made.checked, &geometry, options.keeps_voxels);
    write(args, context, &surface, &meta, offending, failed)
}

/// Returns the interfaces in the world frame, with attributes of vertices (h, number of materials
/// that meet) and triangles (the two materials, radius ratio).
fn attributes(made: &Reconstruction, geometry: &Geometry) -> Surface {
    let Interfaces { mesh, between, .. } = &made.interfaces;
    let mut surface = Surface::from_grid(mesh, geometry);
    let meeting = made.interfaces.materials_at_vertices().iter().map(|ids| ids.len() as i64).collect();
    surface.point_data = vec![DataArray::scalars("h", made.sizes.clone()), DataArray::integers("materials", meeting)];
    let side = |n: usize| between.iter().map(|pair| i64::from(pair[n].0)).collect();
    surface.cell_data = vec![
        DataArray::integers("material_inside", side(0)),
        DataArray::integers("material_outside", side(1)),
        DataArray::scalars("radius_ratio", radius_ratios(mesh)),
    ];
    surface
}

/// Writes the closed surface of each material except the outside. Neighbouring surfaces have the
/// same vertices on their common interface.
fn write_each(
    folder: &Path,
    args: &Args,
    made: &Reconstruction,
    table: &[Material],
    geometry: &Geometry,
    context: &Context,
) -> Result<()> {
    let step = context.step("write each");
    std::fs::create_dir_all(folder).map_err(|error| {
        Error::input(
            format!("{}: cannot create the folder: {error}", folder.display()),
            "the surfaces of the materials are written to this folder",
            "choose a folder that you can write to",
        )
    })?;
    let ending = args.output.extension().map_or_else(|| "vtp".into(), |ending| ending.to_string_lossy().into_owned());
    let mut names = BTreeSet::new();
    for id in made.interfaces.materials().into_iter().filter(|id| *id != MaterialId::OUTSIDE) {
        let material = &table[id.index()];
        let name = file_name(&material.name, id, &mut names);
        let (mesh, vertices, triangles) = made.interfaces.surface_of(id);
        let mut surface = Surface::from_grid(&mesh, geometry);
        let beyond = |&t: &u32| {
            let [inside, outside] = made.interfaces.between[t as usize];
            i64::from(if inside == id { outside.0 } else { inside.0 })
        };
        let sizes = vertices.iter().map(|&v| made.sizes[v as usize]).collect();
        let whole = vertices.iter().map(|&v| i64::from(v)).collect();
        surface.point_data = vec![DataArray::scalars("h", sizes), DataArray::integers("vertex", whole)];
        surface.cell_data = vec![
            DataArray::integers("material_outside", triangles.iter().map(beyond).collect()),
            DataArray::scalars("radius_ratio", radius_ratios(&mesh)),
        ];
        let meta = SurfaceMeta {
            version: meta::VERSION,
            source: Some(Source::Labels),
            notes: Map::from_iter([("material".to_owned(), json!(material))]),
            ..SurfaceMeta::default()
        };
        write_surface(&folder.join(format!("{name}.{ending}")), &surface, &json!(meta), &context.history())?;
    }
    drop(step);
    Ok(())
}

/// Returns a file name for a material. Characters other than letters, digits, `-` and `.` become
/// `_`. A name in `taken` gets the number of the material as a suffix.
fn file_name(name: &str, id: MaterialId, taken: &mut BTreeSet<String>) -> String {
    let plain: String =
        name.chars().map(|c| if c.is_alphanumeric() || c == '-' || c == '.' { c } else { '_' }).collect();
    let plain = if plain.trim_matches(['.', '_']).is_empty() { format!("material_{}", id.0) } else { plain };
    let mut unique = plain;
    // some file systems ignore case
    while !taken.insert(unique.to_lowercase()) {
        unique = format!("{unique}_{}", id.0);
    }
    unique
}

/// Adds the results to the report and the closing table, and warns of remaining violations.
fn tell(made: &Reconstruction, context: &Context) {
    let Reconstruction { checked, taken, refined, improved, .. } = made;
    context.report("prepare", json!(taken));
    context.report("refine", json!(refined));
    context.report("improve", json!(improved));
    context.report("check", json!(checked));
    context.report("topology", json!(made.pieces));
    let lost = &taken.particles;
    let dropped = lost.not_projected + lost.crowded + taken.encroaching;
    describe_mesh(checked, "", [lost.particles.saturating_sub(dropped), dropped], context);
    let missing: usize = made.pieces.iter().map(|own| own.missing.len()).sum();
    let specks: usize = made.pieces.iter().map(|own| own.missing_specks).sum();
    context.summary("components missing, specks missing", format!("{missing}, {specks}"));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_of_materials_are_unique() {
        let mut taken = BTreeSet::new();
        let names = ["a_b_3", "a b", "A_b", "..."];
        let files: Vec<String> =
            (1..).zip(names).map(|(id, name)| file_name(name, MaterialId(id), &mut taken)).collect();
        assert_eq!(files, ["a_b_3", "a_b", "A_b_3_3", "material_4"]);
    }
}
