//! Names of labels, and layers for overlapping segments.
//!
//! 3D Slicer stores overlapping segments in several layers, which are label volumes on the same
//! grid. A label is then unique only within its layer, so [`LayerLabel`] contains both the label
//! and the layer. Most volumes have a single layer.

use serde::{Deserialize, Serialize};

/// A label and its layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct LayerLabel {
    /// Index of the layer, starting at 0.
    pub layer: usize,
    /// The label, which is the value of its voxels in that layer.
    pub label: i64,
}

/// A named label.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Segment {
    /// Name, such as `left lung`.
    pub name: String,
    /// Label and layer.
    #[serde(flatten)]
    pub at: LayerLabel,
}
