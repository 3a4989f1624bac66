//! Typed and versioned metadata that stages store in their files, in addition to the data.
//!
//! Each struct defines the `meta` of one file type. Later stages use the named fields. `notes`
//! contains information for users and is not used by the stages. Files written by other programs
//! have no metadata, and files without a version lack some fields, so every field is optional.

use crate::error::{Error, Result};
use isoparticles_field::materials::Material;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::path::Path;

/// Version of the metadata that is written. Files without a version have version 0.
pub const VERSION: u32 = 1;

/// The source of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Labels, which determine whether each voxel centre is inside or outside.
    Labels,
    /// The values of a scan and an iso value.
    Scalar,
    /// Points without a volume.
    Points,
}

/// Treatment of the object at the border of the volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Border {
    /// Closed by a plane, with a rounded rim.
    Cap,
    /// Closed by a plane, with a sharp rim.
    Flat,
    /// Left open.
    Open,
}

/// One of the two faces of the volume along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The face with the lowest index.
    Low,
    /// The face with the highest index.
    High,
}

/// A plane that closes the object at the border of the volume.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CapPlane {
    /// Axis of the grid frame perpendicular to the plane, 0 to 2.
    pub axis: usize,
    /// The face of the volume that the plane closes.
    pub side: Side,
    /// Position of the plane along the axis in mm, in the grid frame.
    pub position: f64,
}

/// Metadata that `distfield` stores with F.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DistanceMeta {
    /// Version of the metadata.
    pub version: u32,
    /// The source of F.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
    /// Treatment of the object at the border of the volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub border: Option<Border>,
    /// The planes that close the object.
    pub cap_planes: Vec<CapPlane>,
    /// Length scale of the smoothing in mm. `None` or 0 if the object was not smoothed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Volume of the input object in mm^3, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub volume_before: Option<f64>,
    /// Information for users.
    #[serde(flatten)]
    pub notes: Map<String, Value>,
}

impl DistanceMeta {
    /// Returns whether the object was smoothed. After smoothing, a voxel centre may lie on the
    /// wrong side of the surface.
    pub fn is_scaled(&self) -> bool {
        self.scale.is_some_and(|scale| scale > 0.0)
    }

    /// Returns whether every voxel centre lies on the side that its label specifies.
    pub fn keeps_voxels(&self) -> bool {
        self.source == Some(Source::Labels) && !self.is_scaled()
    }
}

/// Metadata that `distfield` stores with the indicators of several materials.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MaterialsMeta {
    /// Version of the metadata.
    pub version: u32,
    /// The source of the materials; labels if it is missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
    /// Treatment of the materials at the border of the volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub border: Option<Border>,
    /// Number of layers of grid nodes added beyond each face of the volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margin: Option<usize>,
    /// Upper bound in mm of the values in the point array `interface_distance`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_limit: Option<f64>,
    /// Largest length scale of the smoothing in mm. `None` if every voxel centre stays in its
    /// material.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Information for users: the table of materials, the pairs of adjacent materials, and the
    /// junctions.
    #[serde(flatten)]
    pub notes: Map<String, Value>,
}

/// Metadata that `sizefield` stores with h.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SizeMeta {
    /// Version of the metadata.
    pub version: u32,
    /// Number of components of the surface.
    pub components: usize,
    /// Number of particles predicted from h; `None` for a field that was only updated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predicted_count: Option<f64>,
    /// Information for users: the distributions of h, of the local feature size and of the noise.
    #[serde(flatten)]
    pub notes: Map<String, Value>,
}

/// Metadata that `reconstruct` stores with a surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SurfaceMeta {
    /// Version of the metadata.
    pub version: u32,
    /// The source of the surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
    /// Treatment of the object at the border of the volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub border: Option<Border>,
    /// Names of the planes at which the materials end. The triangle array `cap` contains the
    /// numbers of the planes, from 1.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub caps: Vec<String>,
    /// Descriptions of the failed checks.
    pub failed_checks: Vec<String>,
    /// Expected number of components.
    pub components: usize,
    /// The materials in the order of their numbers; empty for a single object. The triangle arrays
    /// `material_inside` and `material_outside` contain these numbers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub materials: Vec<Material>,
    /// Information for users.
    #[serde(flatten)]
    pub notes: Map<String, Value>,
}

/// Converts the `meta` of a file to the struct for its file type. Returns the default if `meta` is
/// null.
///
/// # Errors
/// If the metadata has the wrong type or a newer version.
pub fn typed<T: DeserializeOwned + Default>(path: &Path, meta: &Value, stage: &str) -> Result<T> {
    if meta.is_null() {
        return Ok(T::default());
    }
    let again = || format!("run {stage} again");
    let version = meta["version"].as_u64().unwrap_or(0);
    if version > u64::from(VERSION) {
        return Err(Error::of_file(
            path,
            format!("its metadata has version {version}; this program reads versions up to {VERSION}"),
            "later versions store the metadata differently",
            again(),
        ));
    }
    T::deserialize(meta).map_err(|error| {
        Error::of_file(
            path,
            format!("its metadata cannot be read: {error}"),
            "the metadata says how to interpret the file",
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
        assert_eq!((size.components, size.predicted_count, size.notes.len()), (2, Some(812.0), 1));
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
                read::<DistanceMeta>(&wrong).expect_err("wrong").what.contains("its metadata cannot be read"),
                "{wrong}"
            );
        }
    }
}
