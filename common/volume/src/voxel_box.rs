//! Boxes of voxels: bounding boxes of selected voxels, and the parts of a volume that are kept when
//! it is cropped.

use crate::segments::LayerLabel;
use crate::volume::Volume;
use rayon::prelude::*;

/// For each axis, whether the low and the high face of a voxel box are cuts through the volume
/// rather than borders of the volume.
pub type CutFaces = [[bool; 2]; 3];

/// A box of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VoxelBox {
    /// First voxel along each axis.
    pub low: [usize; 3],
    /// Last voxel along each axis.
    pub high: [usize; 3],
}

impl VoxelBox {
    /// Returns the bounding box of the voxels that `row` reports. `row` maps a row index,
    /// `j + size[1] * k`, to the first and last x index of these voxels in the row, if there are
    /// any.
    pub fn of_rows(size: [usize; 3], row: impl Fn(usize) -> Option<(usize, usize)> + Sync) -> Option<Self> {
        let [_, ny, nz] = size;
        let rows = (0..ny * nz).into_par_iter().with_min_len(ny).filter_map(|at| {
            let (first, last) = row(at)?;
            let (j, k) = (at % ny, at / ny);
            Some(Self { low: [first, j, k], high: [last, j, k] })
        });
        rows.reduce_with(Self::around)
    }

    /// Returns the bounding box of the voxels whose label satisfies `wanted`, over all layers.
    pub fn of_labels(volume: &Volume, wanted: impl Fn(LayerLabel) -> bool + Sync) -> Option<Self> {
        let size = volume.geometry.size;
        let layers = volume.layers().enumerate().filter_map(|(layer, voxels)| {
            Self::of_rows(size, |row| {
                let range = row * size[0]..(row + 1) * size[0];
                voxels.ends_of_labels(range, |label| wanted(LayerLabel { layer, label }))
            })
        });
        layers.reduce(Self::around)
    }

    /// Returns the bounding box of two boxes.
    pub fn around(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|a| self.low[a].min(other.low[a])),
            high: std::array::from_fn(|a| self.high[a].max(other.high[a])),
        }
    }

    /// Returns the box extended by `room` voxels on each face, clipped to a grid of `size` voxels.
    pub fn with_room(self, room: [usize; 3], size: [usize; 3]) -> Self {
        Self {
            low: std::array::from_fn(|a| self.low[a].saturating_sub(room[a])),
            high: std::array::from_fn(|a| (self.high[a] + room[a]).min(size[a] - 1)),
        }
    }

    /// Returns the number of voxels along each axis.
    pub fn size(&self) -> [usize; 3] {
        std::array::from_fn(|a| self.high[a] + 1 - self.low[a])
    }

    /// Returns the faces of the box that are not borders of a grid of `size` voxels.
    pub fn cut_faces(&self, size: [usize; 3]) -> CutFaces {
        std::array::from_fn(|a| [self.low[a] > 0, self.high[a] + 1 < size[a]])
    }
}
