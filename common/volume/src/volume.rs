//! Volumes as read from files: voxels in their original number type, on a grid.

use crate::geometry::Geometry;
use crate::segments::Segment;
use crate::voxels::Voxels;

/// A volume with its geometry. The x axis varies fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Grid of the voxels.
    pub geometry: Geometry,
    /// Voxel values of the first layer.
    pub voxels: Voxels,
    /// The other layers, which are on the same grid and contain overlapping segments. Only
    /// `.seg.nrrd` files of 3D Slicer and `.vti` files converted from them have such layers.
    pub more_layers: Vec<Voxels>,
    /// The named labels, in the same order as in the file.
    pub segments: Vec<Segment>,
    /// Messages to the user about assumptions of the reader.
    pub remarks: Vec<String>,
}

impl Volume {
    /// Creates a volume with one layer, without names or remarks. `voxels` must contain one value
    /// per voxel of `geometry`.
    pub fn new(geometry: Geometry, voxels: Voxels) -> Self {
        Self { geometry, voxels, more_layers: Vec::new(), segments: Vec::new(), remarks: Vec::new() }
    }

    /// Crops all layers in place to the box of `size` voxels whose first voxel is `first`.
    pub fn crop(&mut self, first: [usize; 3], size: [usize; 3]) {
        let whole = self.geometry.size;
        for voxels in std::iter::once(&mut self.voxels).chain(&mut self.more_layers) {
            voxels.crop(whole, first, size);
        }
        self.geometry = self.geometry.cropped(first, size);
    }
}
