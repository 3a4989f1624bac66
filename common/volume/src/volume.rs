//! Volumes as read from a file: voxels of their original type on a grid.

use crate::geometry::Geometry;
use crate::segments::Segment;
use crate::voxels::Voxels;

/// A volume, x fastest, with its geometry.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Grid of the voxels.
    pub geometry: Geometry,
    /// Voxel values; those of the first layer if there are several.
    pub voxels: Voxels,
    /// The other layers, on the same grid, for segments that overlap. Only 3D Slicer's `.seg.nrrd`
    /// and `.vti` files made from it have such layers.
    pub more_layers: Vec<Voxels>,
    /// The named labels, in the order of the file.
    pub segments: Vec<Segment>,
    /// Assumptions of the reader, as text for the user.
    pub remarks: Vec<String>,
}

impl Volume {
    /// A volume with one layer and without names and remarks. `voxels` has one value per voxel of
    /// `geometry`.
    pub fn new(geometry: Geometry, voxels: Voxels) -> Self {
        Self { geometry, voxels, more_layers: Vec::new(), segments: Vec::new(), remarks: Vec::new() }
    }

    /// Crops all layers in place to the box of `size` voxels that starts at the voxel `first`.
    pub fn crop(&mut self, first: [usize; 3], size: [usize; 3]) {
        let whole = self.geometry.size;
        for voxels in std::iter::once(&mut self.voxels).chain(&mut self.more_layers) {
            voxels.crop(whole, first, size);
        }
        self.geometry = self.geometry.cropped(first, size);
    }
}
