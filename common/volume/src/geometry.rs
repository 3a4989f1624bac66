//! World geometry of a volume. This is the only module that converts grid positions to world
//! positions.
//!
//! There are three frames. *Index*: voxel centres have integer coordinates. *Grid*: index times
//! spacing; axis-aligned, right-handed, with the origin at the centre of voxel (0, 0, 0). All
//! stages compute in it. *World*: LPS in millimetres, as in ITK and 3D Slicer, if the file names an
//! anatomical space; otherwise the file's own frame.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// The world frame of a volume's directions and origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Space {
    /// Left, posterior, superior: the world frame of DICOM and ITK. RAS and LAS files are converted
    /// to it when read.
    Lps,
    /// The file names no anatomical space; its coordinates are used unchanged.
    Unnamed,
}

/// Size, spacing, directions, origin and space of a regular grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// Number of voxels along each axis, x fastest.
    pub size: [usize; 3],
    /// Distance between neighbouring voxel centres along each axis, in mm; positive.
    pub spacing: DVec3,
    /// Unit vectors of the three grid axes in the world, one per column. The determinant is
    /// negative for a left-handed volume.
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

    /// Whether a grid position lies between the first and the last samples, or on them to a
    /// thousandth of the spacing.
    #[inline(always)]
    pub fn holds(&self, grid: DVec3) -> bool {
        let index = self.grid_to_index(grid);
        (0..3).all(|axis| (-1e-3..=self.size[axis] as f64 - 0.999).contains(&index[axis]))
    }

    /// World position of a grid position.
    pub fn grid_to_world(&self, grid: DVec3) -> DVec3 {
        self.origin + self.directions * grid
    }

    /// Grid position of a world position.
    pub fn world_to_grid(&self, world: DVec3) -> DVec3 {
        self.directions.inverse() * (world - self.origin)
    }

    /// World direction of a grid-frame normal. Uses the inverse transpose, because directions may
    /// not be orthogonal.
    pub fn normal_to_world(&self, normal: DVec3) -> DVec3 {
        (self.directions.inverse().transpose() * normal).normalize_or_zero()
    }

    /// Whether the map to the world mirrors, so that the order of triangle vertices must be
    /// reversed.
    pub fn is_left_handed(&self) -> bool {
        self.directions.determinant() < 0.0
    }

    /// Minimum spacing, in mm.
    pub fn min_spacing(&self) -> f64 {
        self.spacing.min_element()
    }

    /// Geometric mean of the spacings, in mm. This is the length of "a voxel" in this project.
    pub fn mean_spacing(&self) -> f64 {
        (self.spacing.x * self.spacing.y * self.spacing.z).cbrt()
    }

    /// Grid position of the centre of the last voxel.
    #[inline]
    pub fn upper_corner(&self) -> DVec3 {
        self.index_to_grid(DVec3::new(self.size[0] as f64 - 1.0, self.size[1] as f64 - 1.0, self.size[2] as f64 - 1.0))
    }

    /// The same grid with `margin` more voxels on every face. Grid positions shift by
    /// `margin * spacing`.
    pub fn padded(&self, margin: usize) -> Self {
        let shift = self.index_to_grid(DVec3::splat(-(margin as f64)));
        Self { size: self.size.map(|n| n + 2 * margin), origin: self.grid_to_world(shift), ..self.clone() }
    }

    /// The grid of a box of `size` voxels that starts at the voxel `first`.
    pub fn cropped(&self, first: [usize; 3], size: [usize; 3]) -> Self {
        let corner = self.index_to_grid(DVec3::from_array(first.map(|n| n as f64)));
        Self { size, origin: self.grid_to_world(corner), ..self.clone() }
    }
}
