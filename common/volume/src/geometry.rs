//! World geometry of a volume: the only place that turns grid positions into world positions.
//!
//! Three frames: *index* (voxel centres at whole numbers), *grid* (index times spacing; axis aligned,
//! right-handed, origin at the centre of voxel (0, 0, 0); what every stage computes in) and *world* (LPS
//! millimetres when the file names an anatomical space, as ITK and 3D Slicer have it; else the file's own).

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// The world frame that a volume's directions and origin are given in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Space {
    /// Left, posterior, superior: DICOM's and ITK's world; RAS and LAS files are converted to it on reading.
    Lps,
    /// The file names no anatomical space; its numbers are taken as they are.
    Unnamed,
}

/// Size, spacing, directions, origin and space of a regular grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// Voxels along each axis, x fastest.
    pub size: [usize; 3],
    /// Distance of neighbouring voxel centres along each axis, in mm; positive.
    pub spacing: DVec3,
    /// Unit vectors of the three grid axes in the world, one per column; its determinant is negative for a
    /// left-handed volume.
    pub directions: DMat3,
    /// World position of the centre of voxel (0, 0, 0), in mm.
    pub origin: DVec3,
    /// The world frame.
    pub space: Space,
}

impl Geometry {
    /// Axis-aligned geometry with its origin at zero.
    pub fn axis_aligned(size: [usize; 3], spacing: DVec3) -> Self {
        Self { size, spacing, directions: DMat3::IDENTITY, origin: DVec3::ZERO, space: Space::Unnamed }
    }

    /// Number of voxels.
    pub fn voxel_count(&self) -> usize {
        self.size.iter().product()
    }

    /// Linear index of a voxel, x fastest.
    #[inline]
    pub fn linear(&self, i: usize, j: usize, k: usize) -> usize {
        (k * self.size[1] + j) * self.size[0] + i
    }

    /// Grid position of an index position.
    #[inline]
    pub fn index_to_grid(&self, index: DVec3) -> DVec3 {
        index * self.spacing
    }

    /// Index position of a grid position.
    #[inline]
    pub fn grid_to_index(&self, grid: DVec3) -> DVec3 {
        grid / self.spacing
    }

    /// World position of a grid position.
    pub fn grid_to_world(&self, grid: DVec3) -> DVec3 {
        self.origin + self.directions * grid
    }

    /// Grid position of a world position.
    pub fn world_to_grid(&self, world: DVec3) -> DVec3 {
        self.directions.inverse() * (world - self.origin)
    }

    /// World direction of a grid-frame normal (the inverse transpose, for directions that are not orthogonal).
    pub fn normal_to_world(&self, normal: DVec3) -> DVec3 {
        (self.directions.inverse().transpose() * normal).normalize_or_zero()
    }

    /// Whether the way to the world mirrors, so that triangle windings must be turned round.
    pub fn is_left_handed(&self) -> bool {
        self.directions.determinant() < 0.0
    }

    /// Smallest spacing, in mm.
    pub fn min_spacing(&self) -> f64 {
        self.spacing.min_element()
    }

    /// Geometric mean spacing, in mm: what this project calls "a voxel" when it measures length.
    pub fn mean_spacing(&self) -> f64 {
        (self.spacing.x * self.spacing.y * self.spacing.z).cbrt()
    }

    /// Grid position of the centre of the last voxel.
    #[inline]
    pub fn upper_corner(&self) -> DVec3 {
        self.index_to_grid(DVec3::new(self.size[0] as f64 - 1.0, self.size[1] as f64 - 1.0, self.size[2] as f64 - 1.0))
    }

    /// The same grid with `margin` more voxels on every face (grid positions shift by `margin * spacing`).
    pub fn padded(&self, margin: usize) -> Self {
        let shift = self.index_to_grid(DVec3::splat(-(margin as f64)));
        Self { size: self.size.map(|n| n + 2 * margin), origin: self.grid_to_world(shift), ..self.clone() }
    }

    /// The grid of a box of `size` voxels from the voxel `first` on.
    pub fn cropped(&self, first: [usize; 3], size: [usize; 3]) -> Self {
        let corner = self.index_to_grid(DVec3::from_array(first.map(|n| n as f64)));
        Self { size, origin: self.grid_to_world(corner), ..self.clone() }
    }
}
