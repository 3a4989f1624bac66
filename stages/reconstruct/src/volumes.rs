//! Volumes of each material in mm^3: of the voxels and of F (from the metadata of `distfield`), and
//! of the mesh. The surface file passes these rows on to `tetmesh-check`.

use crate::check::RegionReport;
use isoparticles_stage::meta::{DistanceMeta, MaterialsMeta};
use serde::Serialize;
use serde_json::Value;

/// The volumes of one object, or of one material.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Volumes {
    /// Name of the material; `object` for one object.
    name: String,
    /// Volume of the voxels without dropped parts. `None` if unknown, as for an isosurface without
    /// a scale.
    voxels_mm3: Option<f64>,
    /// Volume of F < 0.
    field_mm3: Option<f64>,
    /// Volume inside the mesh.
    mesh_mm3: f64,
}

/// Returns the row of one object. `mesh_mm3` is the volume inside its mesh.
pub(crate) fn of_object(told: &DistanceMeta, mesh_mm3: f64) -> Vec<Volumes> {
    let dropped = told.notes.get("dropped").and_then(|dropped| dropped["volume"].as_f64()).unwrap_or(0.0);
    let voxels_mm3 = told.volume_before.map(|volume| volume - dropped);
    let field_mm3 = told.notes.get("volume").and_then(Value::as_f64);
    vec![Volumes { name: "object".to_owned(), voxels_mm3, field_mm3, mesh_mm3 }]
}

/// Returns a row for each material of the mesh except the outside.
pub(crate) fn of_materials(told: &MaterialsMeta, meshes: &[RegionReport]) -> Vec<Volumes> {
    let table = told.notes.get("table").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let row = |entry: &Value| {
        let name = entry["name"].as_str().filter(|_| entry["number"] != 0)?;
        let mesh = meshes.iter().find(|mesh| mesh.name == name)?;
        let [voxels_mm3, field_mm3] = ["volume_before", "volume"].map(|key| entry[key].as_f64());
        Some(Volumes { name: name.to_owned(), voxels_mm3, field_mm3, mesh_mm3: mesh.volume })
    };
    table.iter().filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn rows_contain_the_volumes_of_the_field_metadata() {
        let told = json!({"volume_before": 12.0, "volume": 11.5, "dropped": {"volume": 2.0}});
        let told: DistanceMeta = serde_json::from_value(told).expect("a note");
        let row = |name: &str, voxels_mm3, field_mm3, mesh_mm3| Volumes {
            name: name.to_owned(),
            voxels_mm3,
            field_mm3,
            mesh_mm3,
        };
        assert_eq!(of_object(&told, 9.0), [row("object", Some(10.0), Some(11.5), 9.0)]);
        assert_eq!(of_object(&DistanceMeta::default(), 9.0), [row("object", None, None, 9.0)]);

        let table = json!({"table": [
            {"name": "outside", "number": 0, "volume": 5.0},
            {"name": "bone", "number": 1, "volume_before": 3.0, "volume": 3.5},
            {"name": "lost", "number": 2, "volume_before": 1.0, "volume": 0.0},
        ]});
        let told: MaterialsMeta = serde_json::from_value(table).expect("a note");
        let mesh = |name: &str, volume| RegionReport { name: name.to_owned(), volume, ..RegionReport::default() };
        let meshes = [mesh("outside", -3.2), mesh("bone", 3.2)];
        assert_eq!(of_materials(&told, &meshes), [row("bone", Some(3.0), Some(3.5), 3.2)]);
    }
}
