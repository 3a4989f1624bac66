//! World geometry of a volume. This is the only module that converts grid positions to world
//! positions.
//!
//! There are three frames. In the *index* frame, voxel centres have integer coordinates.
//! Coordinates in the *grid* frame are index coordinates times the spacing. This frame is
//! axis-aligned and right-handed, and its origin is the centre of voxel (0, 0, 0). All stages
//! compute in the grid frame. The *world* frame is in millimetres. If the file specifies an
//! anatomical space, readers return LPS, as in ITK, and output may be in RAS. Otherwise, it is the
//! file's own frame.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Index positions that differ by less than this are the same. Headers with single-precision
/// numbers place voxels up to 300 mm from the origin with an error of 3e-5 mm, which is 6e-4 voxels
/// of 0.05 mm.
pub(crate) const INDEX_TOLERANCE: f64 = 1e-3;

/// The world frame in which the directions and origin of a volume are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Space {
    /// Left, posterior, superior: the world frame of DICOM and ITK. RAS and LAS coordinates in
    /// files are converted to LPS when read.
    Lps,
    /// The file does not specify an anatomical space. Its coordinates are used unchanged.
    Unnamed,
    /// Right, anterior, superior: the world frame of NIfTI, nibabel and FreeSurfer.
    Ras,
}

impl Space {
    /// Returns the name of an anatomical frame.
    pub fn name(self) -> Option<&'static str> {
        match self {
            Self::Lps => Some("LPS"),
            Self::Ras => Some("RAS"),
            Self::Unnamed => None,
        }
    }

    /// Returns the signs that convert coordinates to another anatomical frame: those of x and y
    /// change between LPS and RAS. No coordinate is rounded. Without an anatomical frame, all are
    /// 1.
    pub fn signs_to(self, space: Self) -> DVec3 {
        match (self, space) {
            (Self::Lps, Self::Ras) | (Self::Ras, Self::Lps) => DVec3::new(-1.0, -1.0, 1.0),
            _ => DVec3::ONE,
        }
    }
}

/// Size, spacing, directions, origin and space of a regular grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// Number of voxels along each axis. The x axis varies fastest.
    pub size: [usize; 3],
    /// Distance in mm between neighbouring voxel centres along each axis. Always positive.
    pub spacing: DVec3,
    /// Unit vectors of the three grid axes in the world frame, one per column. The determinant is
    /// negative if the axes are left-handed.
    pub directions: DMat3,
    /// World position in mm of the centre of voxel (0, 0, 0).
    pub origin: DVec3,
    /// The world frame.
    pub space: Space,
}

impl Geometry {
    /// Creates an axis-aligned geometry with its origin at zero.
    pub fn axis_aligned(size: [usize; 3], spacing: DVec3) -> Self {
        Self { size, spacing, directions: DMat3::IDENTITY, origin: DVec3::ZERO, space: Space::Unnamed }
    }

    /// Returns the grid in another anatomical frame ([`Space::signs_to`]). A grid without an
    /// anatomical frame does not change.
    #[must_use]
    pub fn in_space(self, space: Space) -> Self {
        if self.space.name().is_none() || space.name().is_none() {
            return self;
        }
        let signs = self.space.signs_to(space);
        let DMat3 { x_axis, y_axis, z_axis } = self.directions;
        let directions = DMat3::from_cols(x_axis * signs, y_axis * signs, z_axis * signs);
        Self { directions, origin: self.origin * signs, space, ..self }
    }

    /// Returns the number of voxels.
    pub fn voxel_count(&self) -> usize {
        self.size.iter().product()
    }

    /// Returns the linear index of a voxel. The x axis varies fastest.
    #[inline]
    pub fn linear(&self, i: usize, j: usize, k: usize) -> usize {
        (k * self.size[1] + j) * self.size[0] + i
    }

    /// Returns the grid position of the centre of the voxel with this linear index.
    #[inline]
    pub fn node_to_grid(&self, node: usize) -> DVec3 {
        let [nx, ny, _] = self.size;
        self.index_to_grid(DVec3::new((node % nx) as f64, (node / nx % ny) as f64, (node / nx / ny) as f64))
    }

    /// Converts an index position to a grid position.
    #[inline]
    pub fn index_to_grid(&self, index: DVec3) -> DVec3 {
        index * self.spacing
    }

    /// Converts a grid position to an index position.
    #[inline]
    pub fn grid_to_index(&self, grid: DVec3) -> DVec3 {
        grid / self.spacing
    }

    /// Returns whether a grid position lies within the bounding box of the voxel centres, with a
    /// tolerance of 0.001 times the spacing.
    #[inline(always)]
    pub fn holds(&self, grid: DVec3) -> bool {
        let index = self.grid_to_index(grid);
        (0..3).all(|axis| (-INDEX_TOLERANCE..=self.size[axis] as f64 - 1.0 + INDEX_TOLERANCE).contains(&index[axis]))
    }

    /// Converts a grid position to a world position.
    pub fn grid_to_world(&self, grid: DVec3) -> DVec3 {
        self.origin + self.directions * grid
    }

    /// Converts a world position to a grid position.
    pub fn world_to_grid(&self, world: DVec3) -> DVec3 {
        self.directions.inverse() * (world - self.origin)
    }

    /// Returns the matrix and the offset that convert index positions of another grid in the same
    /// world frame to those of this grid.
    pub fn index_from(&self, other: &Self) -> (DMat3, DVec3) {
        let at = |index: DVec3| self.grid_to_index(self.world_to_grid(other.grid_to_world(other.index_to_grid(index))));
        let origin = at(DVec3::ZERO);
        (DMat3::from_cols(at(DVec3::X) - origin, at(DVec3::Y) - origin, at(DVec3::Z) - origin), origin)
    }

    /// Converts a normal from the grid frame to the world frame. Uses the inverse transpose,
    /// because the axes may not be orthogonal.
    pub fn normal_to_world(&self, normal: DVec3) -> DVec3 {
        (self.directions.inverse().transpose() * normal).normalize_or_zero()
    }

    /// Returns whether the transformation to the world frame includes a reflection. In this case,
    /// the vertex order of triangles must be reversed.
    pub fn is_left_handed(&self) -> bool {
        self.directions.determinant() < 0.0
    }

    /// Returns the minimum spacing in mm.
    pub fn min_spacing(&self) -> f64 {
        self.spacing.min_element()
    }

    /// Returns the geometric mean of the spacings in mm. In this project, a length of one voxel
    /// means this length.
    pub fn mean_spacing(&self) -> f64 {
        (self.spacing.x * self.spacing.y * self.spacing.z).cbrt()
    }

    /// Returns the grid position of the centre of the last voxel.
    #[inline]
    pub fn upper_corner(&self) -> DVec3 {
        self.index_to_grid(DVec3::new(self.size[0] as f64 - 1.0, self.size[1] as f64 - 1.0, self.size[2] as f64 - 1.0))
    }

    /// Returns the world-frame bounding box of a box given by two opposite corners in the grid
    /// frame.
    pub fn world_box(&self, [low, high]: [DVec3; 2]) -> [DVec3; 2] {
        let corner = |n: usize| DVec3::from_array([0, 1, 2].map(|a| if n >> a & 1 == 0 { low[a] } else { high[a] }));
        let corners = (0..8).map(|n| self.grid_to_world(corner(n)));
        corners.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], p| [low.min(p), high.max(p)])
    }

    /// Returns the grid extended by `margin` voxels on every side. The grid coordinates of a voxel
    /// increase by `margin * spacing`.
    pub fn padded(&self, margin: usize) -> Self {
        let shift = self.index_to_grid(DVec3::splat(-(margin as f64)));
        Self { size: self.size.map(|n| n + 2 * margin), origin: self.grid_to_world(shift), ..self.clone() }
    }

    /// Returns the grid of a box of `size` voxels whose first voxel is `first`.
    pub fn cropped(&self, first: [usize; 3], size: [usize; 3]) -> Self {
        let corner = self.index_to_grid(DVec3::from_array(first.map(|n| n as f64)));
        Self { size, origin: self.grid_to_world(corner), ..self.clone() }
    }

    /// Returns the grid of the blocks of `factors` voxels. Its nodes are the centres of the blocks.
    pub fn downsampled(&self, factors: [usize; 3]) -> Self {
        let factor = DVec3::from_array(factors.map(|n| n as f64));
        Self {
            size: std::array::from_fn(|axis| self.size[axis] / factors[axis]),
            spacing: self.spacing * factor,
            origin: self.grid_to_world(self.index_to_grid(0.5 * (factor - 1.0))),
            ..self.clone()
        }
    }
}
