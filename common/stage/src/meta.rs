//! What one stage tells the next, beside the values of its file: typed, versioned, and read for ever.
//!
//! Each struct is the `meta` of one file. What the next stage acts on has a field here; what is only told to people is in `notes`.
//! A file that another program wrote or saved again has no such note, and one from before there were versions lacks the fields that
//! came later: all of them may be missing.

use crate::error::{Error, Result};
use isoparticles_field::materials::Material;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::path::Path;

/// Version of the structs of this module that is written; 0 stands for files from before there were versions.
pub const VERSION: u32 = 1;

/// What a surface was made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Labels, each voxel centre on its side.
    Labels,
    /// The values of a scan and an iso value.
    Scalar,
    /// Points alone.
    Points,
}

/// What was done where the object meets the border of the volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Border {
    /// It was closed there by a plane.
    Cap,
    /// It was left open.
    Open,
}

/// Which face of the volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Where the index is lowest.
    Low,
    /// Where the index is highest.
    High,
}

/// A plane at which the object was cut where it meets the border of the volume.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CapPlane {
    /// Axis of the grid frame that it is orthogonal to, 0 to 2.
    pub axis: usize,
    /// The face that it closes.
    pub side: Side,
    /// Where it cuts that axis, grid frame, mm.
    pub position: f64,
}

/// What `distfield` tells of F.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DistanceMeta {
    /// Version of this struct.
    pub version: u32,
    /// What F was made from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
    /// What was done at the border.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub border: Option<Border>,
    /// The planes that close the object.
    pub cap_planes: Vec<CapPlane>,
    /// Length below which shape was smoothed away, mm; none or 0 where every voxel centre was kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Volume of what was read, mm^3, where it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub volume_before: Option<f64>,
    /// For people.
    #[serde(flatten)]
    pub notes: Map<String, Value>,
}

impl DistanceMeta {
    /// Whether shape was smoothed away, voxel centres and all.
    pub fn is_scaled(&self) -> bool {
        self.scale.is_some_and(|scale| scale > 0.0)
    }

    /// Whether every voxel centre keeps the side that its label gives it.
    pub fn keeps_voxels(&self) -> bool {
        self.source == Some(Source::Labels) && !self.is_scaled()
    }
}

/// What `distfield` tells of the indicators of many materials, beside what they are made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MaterialsMeta {
    /// Version of this struct.
    pub version: u32,
    /// What was done at the border.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub border: Option<Border>,
    /// Nodes on each face of the grid that are none of the volume's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margin: Option<usize>,
    /// Distance (mm) at which `interface_distance` ends.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_limit: Option<f64>,
    /// Length below which shape was smoothed away, mm; none where every voxel centre was kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// For people: the table of materials, pairs that touch, junctions.
    #[serde(flatten)]
    pub notes: Map<String, Value>,
}

/// What `sizefield` tells of h.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SizeMeta {
    /// Version of this struct.
    pub version: u32,
    /// Components of the surface.
    pub components: usize,
    /// Particles that h asks for.
    pub predicted_count: f64,
    /// For people: how h, the local feature size and the noise are distributed.
    #[serde(flatten)]
    pub notes: Map<String, Value>,
}

/// What `reconstruct` tells of a surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SurfaceMeta {
    /// Version of this struct.
    pub version: u32,
    /// What it was made from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
    /// What was done at the border.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub border: Option<Border>,
    /// Checks that it failed, in words.
    pub failed_checks: Vec<String>,
    /// Components that it should have.
    pub components: usize,
    /// The materials by their numbers, where they are many: `material_inside` and `material_outside` of the triangles name them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub materials: Vec<Material>,
    /// For people.
    #[serde(flatten)]
    pub notes: Map<String, Value>,
}

/// The typed form of what a file carries; null is the note of a file that carries none.
///
/// # Errors
/// When the note does not mean what this program takes it for, or is of a later version.
pub fn typed<T: DeserializeOwned + Default>(path: &Path, meta: &Value, stage: &str) -> Result<T> {
    if meta.is_null() {
        return Ok(T::default());
    }
    let again = || format!("run {stage} again to make it anew");
    let version = meta["version"].as_u64().unwrap_or(0);
    if version > u64::from(VERSION) {
        return Err(Error::of_file(
            path,
            format!("its note is of version {version}; this program reads versions up to {VERSION}"),
            "what it says may mean something else",
            again(),
        ));
    }
    T::deserialize(meta).map_err(|error| {
        Error::of_file(
            path,
            format!("its note cannot be read: {error}"),
            "it says how the file is to be taken",
            again(),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read<T: DeserializeOwned + Default>(meta: &Value) -> Result<T> {
        typed(Path::new("case.distfield.vti"), meta, "distfield")
    }

    #[test]
    fn notes_of_every_version_are_read() {
        let old = json!({
            "source": "labels", "border": "cap", "labels": "1, 2", "margin": 3,
            "cap_planes": [{ "axis": 2, "side": "low", "position": 4.5 }], "scale": 2.0, "volume_before": 12.5,
        });
        let meta: DistanceMeta = read(&old).expect("version 0");
        assert_eq!((meta.version, meta.source, meta.border), (0, Some(Source::Labels), Some(Border::Cap)));
        assert_eq!(meta.cap_planes, [CapPlane { axis: 2, side: Side::Low, position: 4.5 }]);
        assert!(meta.is_scaled() && !meta.keeps_voxels());
        assert_eq!(meta.notes["labels"], "1, 2");
        let now = DistanceMeta { version: VERSION, ..meta };
        assert_eq!(read::<DistanceMeta>(&json!(now)).expect("this version"), now);
        assert_eq!(read::<DistanceMeta>(&Value::Null).expect("no note"), DistanceMeta::default());
        let size: SizeMeta =
            read(&json!({"components": 2, "predicted_count": 812.0, "noise": {"min": 0.0}})).expect("h");
        assert_eq!((size.components, size.predicted_count, size.notes.len()), (2, 812.0, 1));
        let materials: MaterialsMeta = read(&json!({"version": 1, "border": "open", "margin": 5})).expect("materials");
        assert_eq!((materials.border, materials.margin, materials.notes.len()), (Some(Border::Open), Some(5), 0));
        let surface: SurfaceMeta =
            read(&json!({"source": "points", "failed_checks": [], "components": 1})).expect("surface");
        assert_eq!((surface.source, surface.components), (Some(Source::Points), 1));
    }

    #[test]
    fn what_means_something_else_is_refused() {
        let error = read::<DistanceMeta>(&json!({"version": VERSION + 1})).expect_err("later");
        assert!(error.what.contains("version 2") && error.next.contains("run distfield again"), "{error}");
        for wrong in [json!({"source": "guess"}), json!({"cap_planes": [{"axis": 9}]}), json!("text")] {
            assert!(
                read::<DistanceMeta>(&wrong).expect_err("wrong").what.contains("its note cannot be read"),
                "{wrong}"
            );
        }
    }
}
