//! Coarser grids over an object: what a wide Gaussian leaves is told as well by voxels two, four, ... times as long, in an eighth of the time
//! and memory for each doubling.

use crate::occupancy::Occupancy;
use rayon::prelude::*;

/// Weights of the four coarse values round a fine voxel's centre, which lies a quarter of the way from the second to the third (Catmull and Rom: through
/// the values, with a continuous slope).
const QUARTER: [f32; 4] = [-0.070_312_5, 0.867_187_5, 0.226_562_5, -0.023_437_5];

/// An object on its own grid and on coarser ones, each with voxels twice as long as the one before.
pub struct Pyramid {
    grids: Vec<Occupancy>,
}

impl Pyramid {
    /// So many grids, or fewer where there are too few voxels.
    pub fn new(finest: Occupancy, count: usize) -> Self {
        let mut grids = vec![finest];
        while grids.len() < count && grids[grids.len() - 1].geometry.size.iter().all(|&n| n > 1) {
            grids.push(grids[grids.len() - 1].halved());
        }
        Self { grids }
    }

    /// The grid of a number, or the coarsest.
    pub fn grid(&self, number: usize) -> &Occupancy {
        &self.grids[number.min(self.grids.len() - 1)]
    }

    /// The number of the coarsest grid whose longest voxel edge is no longer than that, mm; else that of the finest.
    pub fn coarsest_below(&self, longest: f64) -> usize {
        let is_fine = |grid: &Occupancy| grid.geometry.spacing.max_element() <= longest;
        self.grids.iter().rposition(is_fine).unwrap_or(0)
    }

    /// The finest grid alone.
    pub fn into_finest(mut self) -> Occupancy {
        self.grids.swap_remove(0)
    }

    /// Values on one grid as they are on a finer one.
    pub fn refined(&self, mut values: Vec<f32>, from: usize, to: usize) -> Vec<f32> {
        for number in (to..from.min(self.grids.len() - 1)).rev() {
            values = doubled(&values, self.grids[number + 1].geometry.size, self.grids[number].geometry.size);
        }
        values
    }
}

/// Values at the centres of voxels half as long.
fn doubled(from: &[f32], coarse: [usize; 3], fine: [usize; 3]) -> Vec<f32> {
    let mut to = vec![0.0; fine.iter().product()];
    let (plane, row) = (coarse[0] * coarse[1], coarse[0]);
    to.par_chunks_mut(fine[0] * fine[1]).enumerate().for_each_init(
        || (vec![0.0; plane], vec![0.0; row]),
        |(slice, line), (k, to)| {
            blend(around(k, coarse[2]).map(|(at, weight)| (&from[at * plane..][..plane], weight)), slice);
            for (j, to) in to.chunks_mut(fine[0]).enumerate() {
                blend(around(j, coarse[1]).map(|(at, weight)| (&slice[at * row..][..row], weight)), line);
                for (i, to) in to.iter_mut().enumerate() {
                    *to = around(i, coarse[0]).iter().map(|&(at, weight)| weight * line[at]).sum();
                }
            }
        },
    );
    to
}

/// The coarse values round a fine one along an axis, and their weights.
fn around(fine: usize, coarse: usize) -> [(usize, f32); 4] {
    let (base, is_upper) = (fine / 2, fine % 2 == 1);
    std::array::from_fn(|n| {
        // the nearest coarse centre is the second of four, seen from the side that the fine one lies on
        let steps = n as isize - 1;
        let at = base as isize + if is_upper { steps } else { -steps };
        (at.clamp(0, coarse as isize - 1) as usize, QUARTER[n])
    })
}

/// The weighted sum of slices.
fn blend(from: [(&[f32], f32); 4], to: &mut [f32]) {
    let [a, b, c, d] = from;
    for (n, to) in to.iter_mut().enumerate() {
        *to = a.1 * a.0[n] + b.1 * b.0[n] + c.1 * c.0[n] + d.1 * d.0[n];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::occupancy::WHOLE;
    use glam::DVec3;
    use isoparticles_common::geometry::Geometry;

    #[test]
    fn straight_values_are_met_between_coarse_centres() {
        let size = [21, 16, 19];
        let finest = Occupancy {
            geometry: Geometry::axis_aligned(size, DVec3::new(1.0, 0.5, 2.0)),
            shares: vec![WHOLE; size.iter().product()],
        };
        let pyramid = Pyramid::new(finest, 3);
        assert_eq!(pyramid.grid(2).geometry.size, [6, 4, 5]);
        assert_eq!((pyramid.coarsest_below(4.0), pyramid.coarsest_below(7.9), pyramid.coarsest_below(8.0)), (1, 1, 2));
        assert_eq!(pyramid.coarsest_below(0.1), 0);
        let straight = |p: DVec3| 3.0 + 0.5 * p.x - 0.7 * p.y + 0.2 * p.z;
        let at = |grid: usize, n: usize| {
            let geometry = &pyramid.grid(grid).geometry;
            let [nx, ny, _] = geometry.size;
            let index = DVec3::new((n % nx) as f64, (n / nx % ny) as f64, (n / (nx * ny)) as f64);
            straight(geometry.grid_to_world(geometry.index_to_grid(index)))
        };
        let coarse = (0..pyramid.grid(2).shares.len()).map(|n| at(2, n) as f32).collect();
        let fine = pyramid.refined(coarse, 2, 0);
        // away from the faces, where coarse values are missing
        let is_within = |n: usize| {
            let at = [n % 21, n / 21 % 16, n / 336];
            (0..3).all(|axis| (6..size[axis] - 7).contains(&at[axis]))
        };
        let within: Vec<usize> = (0..fine.len()).filter(|&n| is_within(n)).collect();
        assert!(within.len() > 50);
        assert!(within.iter().all(|&n| (f64::from(fine[n]) - at(0, n)).abs() < 1e-4));
    }
}
