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

/// Length of the edge of a square that [`reversed_axes`] copies at a time. For values of 8 bytes,
/// the square takes 32 kB, which fit into a first-level cache.
const TILE: usize = 64;

/// Returns the values of a grid of `size` voxels (x fastest) in the order of the reversed axes: z
/// is then fastest. Copies squares through a buffer, because values at distances of a large power
/// of two evict each other from the cache.
pub(crate) fn reversed_axes<T: Copy + Default + Send + Sync>(values: &[T], size: [usize; 3]) -> Vec<T> {
    let [nx, ny, nz] = size;
    let mut reversed = vec![T::default(); values.len()];
    // a block contains the planes of up to TILE values of x
    reversed.par_chunks_mut(TILE * ny * nz).enumerate().for_each(|(block, planes)| {
        let (first, count) = (block * TILE, planes.len() / (ny * nz));
        let mut square = [T::default(); TILE * TILE];
        for (j, k) in (0..ny).flat_map(|j| (0..nz).step_by(TILE).map(move |k| (j, k))) {
            let depth = TILE.min(nz - k);
            for (n, row) in square.chunks_exact_mut(TILE).take(depth).enumerate() {
                let start = ((k + n) * ny + j) * nx + first;
                row[..count].copy_from_slice(&values[start..start + count]);
            }
            for i in 0..count {
                let row = &mut planes[(i * ny + j) * nz + k..][..depth];
                row.iter_mut().zip(square[i..].iter().step_by(TILE)).for_each(|(to, value)| *to = *value);
            }
        }
    });
    reversed
}

#[cfg(test)]
mod tests {
    use super::{reverse_slices, reversed_axes};

    #[test]
    fn reversed_axes_keep_every_value() {
        for [nx, ny, nz] in [[1, 1, 1], [2, 3, 4], [65, 2, 130], [130, 3, 63]] {
            let values: Vec<u32> = (0..(nx * ny * nz) as u32).collect();
            let reversed = reversed_axes(&values, [nx, ny, nz]);
            for (n, value) in values.iter().enumerate() {
                let (i, j, k) = (n % nx, n / nx % ny, n / nx / ny);
                assert_eq!(reversed[(i * ny + j) * nz + k], *value, "{i} {j} {k}");
            }
        }
    }

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
