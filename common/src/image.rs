//! A regular grid of values with its geometry.

use crate::geometry::Geometry;
use glam::DVec3;

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

    /// Samples of a function of the position in the grid frame, mm.
    pub fn sampled(geometry: Geometry, f: impl Fn(DVec3) -> T) -> Self {
        let [nx, ny, nz] = geometry.size;
        let mut data = Vec::with_capacity(geometry.voxel_count());
        for k in 0..nz {
            for j in 0..ny {
                data.extend((0..nx).map(|i| f(geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64)))));
            }
        }
        Self { geometry, data }
    }

    /// Value of a voxel.
    pub fn at(&self, i: usize, j: usize, k: usize) -> T {
        self.data[self.geometry.linear(i, j, k)]
    }
}
