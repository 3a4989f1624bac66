//! Volumes as they come from a file: voxels of their own type on a grid with its geometry.

use crate::geometry::Geometry;
use crate::segments::Segment;
use crate::voxels::Voxels;

/// A volume as read: x fastest, with the way to the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Where the voxels are.
    pub geometry: Geometry,
    /// Their values; the first layer where there are several.
    pub voxels: Voxels,
    /// The layers behind the first one, each on the same grid: where segments may overlap. Empty but for 3D Slicer's `.seg.nrrd`.
    pub more_layers: Vec<Voxels>,
    /// Labels that the file gives a name, in the file's order.
    pub segments: Vec<Segment>,
    /// What the reader had to assume, in words for the user.
    pub remarks: Vec<String>,
}

impl Volume {
    /// A volume of one layer without names and remarks; `voxels` has one value a voxel of `geometry`.
    pub fn new(geometry: Geometry, voxels: Voxels) -> Self {
        Self { geometry, voxels, more_layers: Vec::new(), segments: Vec::new(), remarks: Vec::new() }
    }

    /// Keeps a box of `size` voxels from the voxel `first` on, in all layers, in place.
    pub fn crop(&mut self, first: [usize; 3], size: [usize; 3]) {
        let whole = self.geometry.size;
        for voxels in std::iter::once(&mut self.voxels).chain(&mut self.more_layers) {
            voxels.crop(whole, first, size);
        }
        self.geometry = self.geometry.cropped(first, size);
    }
}
