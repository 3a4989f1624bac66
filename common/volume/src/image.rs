//! A regular grid of values with its geometry.

use crate::geometry::Geometry;
use glam::DVec3;
use rayon::prelude::*;

/// Values on a regular grid. The x axis varies fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<T> {
    /// Grid of the voxels.
    pub geometry: Geometry,
    /// One value per voxel. The x axis varies fastest.
    pub data: Vec<T>,
}

impl<T: Copy + Send + Sync> Image<T> {
    /// Creates an image with the same value in all voxels.
    pub fn filled(geometry: Geometry, value: T) -> Self {
        // uses all threads, because the first access to new memory is slow
        let data = (0..geometry.voxel_count()).into_par_iter().map(|_| value).collect();
        Self { geometry, data }
    }

    /// Evaluates a function of the grid position (mm) at every voxel centre.
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

    /// Returns the value of a voxel.
    pub fn at(&self, i: usize, j: usize, k: usize) -> T {
        self.data[self.geometry.linear(i, j, k)]
    }
}

/// Reverses the order of the slices, which have `length` values each, and keeps the order within
/// each slice. The first slice is then at the end of the vector, where a consumer can remove slices
/// one by one and release their memory.
pub fn reverse_slices<T>(values: &mut [T], length: usize) {
    let count = values.len() / length;
    for n in 0..count / 2 {
        let (low, high) = values.split_at_mut((count - 1 - n) * length);
        low[n * length..][..length].swap_with_slice(&mut high[..length]);
    }
}

#[cfg(test)]
mod tests {
    use super::reverse_slices;

    #[test]
    fn slices_are_reversed_as_they_are() {
        for count in 0..5 {
            let mut values: Vec<usize> = (0..3 * count).collect();
            reverse_slices(&mut values, 3);
            let expected: Vec<usize> = (0..count).rev().flat_map(|n| 3 * n..3 * n + 3).collect();
            assert_eq!(values, expected);
        }
    }
}
