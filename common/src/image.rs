//! A regular grid of values with its geometry.

use crate::geometry::Geometry;

/// Values on a regular grid, x fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<T> {
    /// Where the voxels are.
    pub geometry: Geometry,
    /// One value a voxel, x fastest.
    pub data: Vec<T>,
}

impl<T: Copy> Image<T> {
    /// An image filled with one value.
    pub fn filled(geometry: Geometry, value: T) -> Self {
        let data = vec![value; geometry.voxel_count()];
        Self { geometry, data }
    }

    /// Value of a voxel.
    pub fn at(&self, i: usize, j: usize, k: usize) -> T {
        self.data[self.geometry.linear(i, j, k)]
    }
}
