//! Which voxels F is made of: those of the box of the object with some room round it, clipped at the volume's border. All that comes later sees that box as the
//! volume; where a face of it is no border of the volume, nothing but background lies beyond.
//!
//! The room is what F near the surface depends on, so that F is there what it is on the whole volume.

use crate::nearest::STRIDE;
use isoparticles_volume::{LayerLabel, Volume};
use rayon::prelude::*;

/// Which grid F is made on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Grid {
    /// The box of the object, with room round it.
    #[default]
    Object,
    /// The whole volume.
    Volume,
}

/// Which of the two faces across each axis of a box of voxels, the low one first, are no border of the volume.
pub type CutFaces = [[bool; 2]; 3];

/// Room of a spline, in voxels. Its mirror puts other voxels beyond a face than those that were there. Where they differ by d, a spline differs n nodes from the face by less
/// than d sqrt(3) z^(n + 1) / (1 - z), z = 2 - sqrt(3) (from the prefilter's impulse response, Unser 1999); for the n = 7 that are between the surface and the
/// face by 6e-5 d. A difference of ten times what values change by from voxel to voxel at the surface moves it by 0.0006 voxel, less than the zero set is pinned to.
const SPLINE_ROOM: usize = 8;

/// A box of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VoxelBox {
    /// First voxel along each axis.
    pub low: [usize; 3],
    /// Last voxel along each axis.
    pub high: [usize; 3],
}

impl VoxelBox {
    /// The box round what there is in each row along x: the first and the last voxel of row j + size y * k, if any.
    pub fn of_rows(size: [usize; 3], row: impl Fn(usize) -> Option<(usize, usize)> + Sync) -> Option<Self> {
        let [_, ny, nz] = size;
        let rows = (0..ny * nz).into_par_iter().with_min_len(ny).filter_map(|at| {
            let (first, last) = row(at)?;
            let (j, k) = (at % ny, at / ny);
            Some(Self { low: [first, j, k], high: [last, j, k] })
        });
        rows.reduce_with(Self::around)
    }

    /// The box round the labels of a volume for which `wanted` is true.
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

    /// The box round two.
    pub fn around(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|a| self.low[a].min(other.low[a])),
            high: std::array::from_fn(|a| self.high[a].max(other.high[a])),
        }
    }

    /// With more voxels on each face, within a grid of `size` voxels.
    pub fn with_room(self, room: [usize; 3], size: [usize; 3]) -> Self {
        Self {
            low: std::array::from_fn(|a| self.low[a].saturating_sub(room[a])),
            high: std::array::from_fn(|a| (self.high[a] + room[a]).min(size[a] - 1)),
        }
    }

    /// With its first voxels moved down to where the far field's coarse grid has nodes, so that this is a part of that of the whole volume: with
    /// other nodes F of `heart_label` differs within a voxel of the surface by 8e-4 voxel (root mean square), with these by 2e-5.
    pub fn on_coarse_nodes(self) -> Self {
        Self { low: self.low.map(|n| n - n % STRIDE), ..self }
    }

    /// Voxels along each axis.
    pub fn size(&self) -> [usize; 3] {
        std::array::from_fn(|a| self.high[a] + 1 - self.low[a])
    }

    /// Its faces that are no border of a grid of `size` voxels.
    pub fn cut_faces(&self, size: [usize; 3]) -> CutFaces {
        std::array::from_fn(|a| [self.low[a] > 0, self.high[a] + 1 < size[a]])
    }
}

/// Room round what is inside of an iso value.
pub fn room_of_spline() -> [usize; 3] {
    [SPLINE_ROOM; 3]
}

/// The faces that were cut at one time or another, the second box lying in the first.
pub fn cut_in_turn(first: CutFaces, second: CutFaces) -> CutFaces {
    std::array::from_fn(|a| [first[a][0] || second[a][0], first[a][1] || second[a][1]])
}

/// Crops a volume to a box; tells the faces at which it was cut.
pub fn crop(volume: &mut Volume, kept: VoxelBox) -> CutFaces {
    let whole = volume.geometry.size;
    volume.crop(kept.low, kept.size());
    kept.cut_faces(whole)
}
