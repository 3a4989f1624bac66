//! Determines the box of voxels on which F is computed: the bounding box of the object, enlarged on
//! each face and clipped to the volume. Later steps treat this box as the volume. Beyond a face of
//! the box that is not a border of the volume, there is only background.
//!
//! The box contains the voxels that F near the surface depends on. Near the surface, F therefore
//! equals the F of the whole volume to within the accuracy stated at
//! [`ROOM`](isoparticles_field::spline::ROOM).

use crate::nearest::STRIDE;
use isoparticles_volume::{CutFaces, Volume, VoxelBox};

/// The grid on which F is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Grid {
    /// The bounding box of the object, enlarged by the voxels on which F depends.
    #[default]
    Object,
    /// The whole volume.
    Volume,
}

/// Moves the low corner of a box down to a node of the coarse grid of [`crate::nearest`], so that
/// the coarse grids of the box and of the whole volume coincide. Within a voxel of the surface of
/// `heart_label`, F then differs from the F of the whole volume by 2e-5 voxel (root mean square)
/// instead of 8e-4 voxel.
pub fn on_coarse_nodes(kept: VoxelBox) -> VoxelBox {
    VoxelBox { low: kept.low.map(|n| n - n % STRIDE), ..kept }
}

/// Returns the number of voxels to keep along each axis around the inside voxels of a scalar
/// volume.
pub fn room_of_spline() -> [usize; 3] {
    [isoparticles_field::spline::ROOM; 3]
}

/// Returns the faces cut by either of two successive crops, where the second box lies in the first.
pub fn cut_in_turn(first: CutFaces, second: CutFaces) -> CutFaces {
    std::array::from_fn(|a| [first[a][0] || second[a][0], first[a][1] || second[a][1]])
}

/// Crops a volume to a box. Returns the faces where the volume was cut.
pub fn crop(volume: &mut Volume, kept: VoxelBox) -> CutFaces {
    let whole = volume.geometry.size;
    volume.crop(kept.low, kept.size());
    kept.cut_faces(whole)
}
