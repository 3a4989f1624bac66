//! Writes the surfaces, the offending simplices and the closing table.

use crate::args::Args;
use crate::check::{CheckReport, Fault};
use crate::materials::each::{MaterialSurface, MaterialSurfaces};
use isoparticles_field::materials::MaterialId;
use isoparticles_mesh::surface::{Simplices, Surface, write_simplices, write_surface};
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::meta::SurfaceMeta;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Returns the path of the file with the offending simplices of the failed checks.
fn offenders(args: &Args) -> PathBuf {
    args.output.with_extension("offending.vtp")
}

/// Returns an error if the file of offending simplices, which is replaced or removed, is an input.
pub(crate) fn check_offenders(args: &Args) -> Result<()> {
    let path = offenders(args);
    let Ok(place) = path.canonicalize() else { return Ok(()) };
    let mut inputs = [Some(&args.particles), args.distfield.as_ref(), args.sizefield.as_ref()].into_iter().flatten();
    match inputs.find(|input| input.canonicalize().is_ok_and(|input| input == place)) {
        None => Ok(()),
        Some(input) => Err(Error::input(
            format!(
                "{}: this input has the name of the file for the offending simplices of {}",
                input.display(),
                args.output.display()
            ),
            "that file is replaced if a check fails, and removed if all checks pass",
            "rename the output or the input",
        )),
    }
}

/// A finished surface.
pub struct Made {
    /// The surface in world coordinates: of one object, or all interfaces between materials.
    pub surface: Surface,
    /// The metadata of the surface, with the failed checks.
    pub meta: SurfaceMeta,
    /// The simplices of the failed checks in world coordinates.
    pub offending: Option<Simplices>,
}

impl Made {
    /// Returns the closed surface of each material except the outside, built when the iterator
    /// reaches it. There are none for one object.
    pub fn each(&self) -> impl Iterator<Item = MaterialSurface<'_>> {
        MaterialSurfaces::new(&self.surface, &self.meta.materials).into_iter().flat_map(MaterialSurfaces::each)
    }

    /// Writes the surface and returns the outcome. If a check failed, also writes the offending
    /// simplices; otherwise removes their file.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, args: &Args, context: &Context) -> Result<Outcome> {
        let ending = args.output.extension().unwrap_or_default();
        if !self.meta.materials.is_empty() && !ending.eq_ignore_ascii_case("vtp") {
            context.warn(format!(
                "{}: only .vtp files store the names of the materials; .stl files do not store the materials of the triangles either",
                args.output.display()
            ));
        }
        if let Some(folder) = &args.each {
            self.write_each(folder, &ending.to_string_lossy(), context)?;
        }
        let step = context.step("write");
        let failed = self.meta.failed_checks.clone();
        write_surface(&args.output, &self.surface, &json!(self.meta), &context.history())?;
        let offenders = offenders(args);
        match &self.offending {
            Some(simplices) if !failed.is_empty() => {
                write_simplices(&offenders, simplices, &context.history())?;
                context.info(format!("the offending simplices are in {}", offenders.display()));
            }
            // a file of an earlier run would be misleading
            _ => remove_stale(&offenders, context),
        }
        drop(step);
        Ok(Outcome::from_failed_checks(failed))
    }

    /// Writes the closed surface of each material to a folder.
    fn write_each(&self, folder: &Path, ending: &str, context: &Context) -> Result<()> {
        let _step = context.step("write each");
        std::fs::create_dir_all(folder).map_err(|error| {
            Error::input(
                format!("{}: cannot create the folder: {error}", folder.display()),
                "the surfaces of the materials are written to this folder",
                "choose a folder that you can write to",
            )
        })?;
        let mut names = BTreeSet::new();
        for own in self.each() {
            let path = folder.join(format!("{}.{ending}", file_name(own.name, own.id, &mut names)));
            write_surface(&path, &own.surface, &json!(own.meta), &context.history())?;
        }
        Ok(())
    }
}

fn remove_stale(path: &Path, context: &Context) {
    if path.exists()
        && let Err(error) = std::fs::remove_file(path)
    {
        context.warn(format!("{}: cannot remove this file of an earlier run: {error}", path.display()));
    }
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

/// Adds the rows of the closing table that one object and many materials share. `expected` is
/// appended to the number of components of one object.
pub(crate) fn describe_mesh(checked: &CheckReport, expected: &str, context: &Context) {
    let (quality, junctions) = (&checked.quality, &checked.junctions);
    context.summary("vertices, triangles", format!("{}, {}", checked.vertices, checked.triangles));
    if let [object] = &checked.regions[..] {
        context.summary("components", format!("{}{expected}", object.components.len()));
        context.summary("Euler characteristic", object.euler);
        let (area, volume) = (significant(object.area), significant(object.volume));
        context.summary("area, mm^2; volume, mm^3", format!("{area}; {volume}"));
    } else {
        let (materials, pairs) = (checked.regions.len(), checked.pairs.len());
        context.summary("materials, pairs that touch", format!("{materials}, {pairs}"));
        let (edges, points) = (junctions.junction_edges, junctions.junction_points);
        let missing = checked.count(Fault::MissingSegments);
        context.summary(
            "junction edges, points",
            format!("{edges}, {points}; {missing} of {} segments missing", junctions.segments),
        );
    }
    context.summary(
        "radius ratio",
        format!("mean {:.4}, minimum {:.4}", quality.radius_ratio_mean, quality.radius_ratio_min),
    );
    context.summary("angles, degrees", format!("{:.1} to {:.1}", quality.angle_min, quality.angle_max));
    if let (Some(v), Some(c)) = (checked.vertex_distance, checked.centroid_distance) {
        let [vertices, mean, maximum] = [v.max, c.mean, c.max].map(significant);
        context.summary(
            "distance from F = 0, voxels",
            format!("vertices at most {vertices}; centroids mean {mean}, maximum {maximum}"),
        );
    }
    if let Some(nodes) = checked.counts.get(&Fault::NodesOnWrongSide) {
        context.summary("voxel centres on the wrong side", nodes);
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
