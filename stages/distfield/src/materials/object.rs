//! Ends a single object at planes. F and -F become the indicators of two materials, the object and
//! the outside, because only materials can have sharp rims.

use super::cut::{survey_cut, with_planes};
use super::grid::LabelGrid;
use super::survey::{Survey, distance_limit, voxel_volumes};
use crate::Border;
use crate::args::{Args, BorderChoice};
use crate::choose::Object;
use crate::faces::face_plane;
use isoparticles_field::materials::{Bound, Indicator, Material, MaterialId, Materials};
use isoparticles_stage::cli::Context;
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::error::Result;
use isoparticles_stage::materials_file::{MaterialsFile, Shown};
use isoparticles_stage::meta::{self, DistanceMeta, MaterialsMeta};
use isoparticles_volume::{Image, LayerLabel};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

/// Name of the material.
const OBJECT: &str = "object";

/// Ends an object at the planes of `--border flat` and `--cut`. `field` contains samples of F,
/// which continues beyond the planes, and `told` is its metadata.
///
/// # Errors
/// If a plane does not meet the object, if the name of a plane is taken, if the planes remove the
/// whole object, or if the run is interrupted.
pub(crate) fn object_with_planes(
    args: &Args,
    field: Image<f32>,
    object: &Object,
    told: DistanceMeta,
    context: &Context,
) -> Result<MaterialsFile> {
    let step = context.step("planes");
    let grid = labelled(&field);
    let materials = match object {
        Object::Labels(labels) => indicators(field, labels),
        Object::Iso(..) => indicators(field, &[]),
    };
    let is_flat = args.border == BorderChoice::Flat;
    let at_border: Vec<Bound> = told.cap_planes.iter().filter(|_| is_flat).map(face_plane).collect();
    let whole = voxel_volumes(&grid, &at_border, 2)[1];
    let materials = with_planes(materials, &args.cut, at_border)?;
    let found = survey_cut(&materials, &grid, &args.cut, context)?;
    drop(step);
    for pair in &found.interfaces {
        let names = pair.materials.map(|id| materials.table()[id.index()].name.as_str());
        context.summary(format!("  {} | {}", names[0], names[1]), format!("{} mm^2", significant(pair.area)));
    }
    let meta = MaterialsMeta {
        version: meta::VERSION,
        source: told.source,
        border: Some(args.border.into()),
        margin: Some(args.margin.into()),
        distance_limit: Some(distance_limit(materials.geometry())),
        scale: told.scale.filter(|scale| *scale > 0.0),
        notes: notes(&materials, &told, whole, &found),
    };
    let shown = Shown { material: found.material, interface_distance: found.interface_distance };
    Ok(MaterialsFile { materials, shown, meta: json!(meta), history: Some(context.history()) })
}

/// Returns the material of each node by the sign of F: the object where F < 0.
fn labelled(field: &Image<f32>) -> LabelGrid {
    let numbers = field.data.par_iter().map(|&f| u16::from(f < 0.0)).collect();
    LabelGrid { geometry: field.geometry.clone(), numbers, border: Border::Open, margin: 0 }
}

/// Returns the outside and the object, which has some labels, as materials with the indicators -F
/// and F.
fn indicators(mut field: Image<f32>, labels: &[LayerLabel]) -> Materials {
    let size = field.geometry.size;
    let object = Material { name: OBJECT.to_owned(), labels: labels.to_vec() };
    let outside = Material { name: super::choice::OUTSIDE.to_owned(), labels: Vec::new() };
    let (inner, filled) = Indicator::new(&field, [0; 3], size, false);
    field.data.par_iter_mut().for_each(|f| *f = -*f);
    let (outer, surroundings) = Indicator::new(&field, [0; 3], size, true);
    let both = vec![(outside, outer, surroundings), (object, inner, filled)];
    Materials::new(field.geometry, both).expect("two indicators on one grid")
}

/// Returns the notes on the materials that later stages and users read. `whole` is the volume of
/// the voxels with F < 0 (mm^3) before the object is cut (`--cut`).
fn notes(materials: &Materials, told: &DistanceMeta, whole: f64, found: &Survey) -> Map<String, Value> {
    // assumption: the cuts remove the same fraction of the input voxels and of those with F < 0
    let kept = found.voxel_volumes[1] / whole;
    let dropped = told.notes.get("dropped").and_then(|dropped| dropped["volume"].as_f64()).unwrap_or(0.0);
    let before = told.volume_before.map(|volume| kept * (volume - dropped));
    let row = |id: usize| {
        let (name, volume) = (&materials.table()[id].name, found.volumes[id]);
        let volume_before = before.filter(|_| id != MaterialId::OUTSIDE.index());
        let labels = &materials.table()[id].labels;
        json!({ "number": id, "name": name, "labels": labels, "volume_before": volume_before, "volume": volume })
    };
    let table: Vec<Value> = (0..materials.indicators().len()).map(row).collect();
    let notes =
        [("table", json!(table)), ("interfaces", json!(found.interfaces)), ("junctions", json!(found.junctions))];
    let own = told.notes.iter().map(|(key, value)| (key.clone(), value.clone()));
    own.chain(notes.map(|(key, value)| (key.to_owned(), value))).collect()
}
