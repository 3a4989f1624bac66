//! The scale of each place: the largest at which the object, and the gap outside it, still show.
//!
//! A wall, a rod or a gap shows under a Gaussian when the smoothed share comes near that of a place all inside, or all outside. It must do so not at the surface
//! itself, where it is a half, but within some standard deviations of it: so a corner, which any Gaussian rounds, is not taken for something thin.
//! From thin places the scale grows at a bounded rate, so that no step is made.

use crate::gaussian::smooth;
use crate::levels::LEAST_LEVEL;
use crate::occupancy::{Occupancy, WHOLE};
use glam::DVec3;
use rayon::prelude::*;

/// The smoothed share that shows what is inside (and one less that, what is outside): in the middle of a wall of 1.7 standard deviations, a rod
/// of 1.35, a ball of 1.7 across the radius.
const SHOWN: f32 = 0.6;

/// The same at the smallest scale, where the alternative is to lose it: the level can reach it.
const SHOWN_AT_LEAST: f32 = LEAST_LEVEL as f32 + 0.05;

/// How far from the surface it must show, in standard deviations: from an edge of a right angle it is 1.07.
const WITHIN: f64 = 1.2;

/// Most that the scale grows from place to place, mm for each mm.
const GROWTH: f64 = 0.3;

/// Width of the smoothing of the scale, in smallest scales.
const BLUNT: f64 = 0.5;

/// What a Gaussian leaves of the surface in a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    /// There is none.
    NoSurface,
    /// What it bounds shows.
    Shown,
    /// What it bounds, inside or outside, is too thin to show.
    Hidden,
}

/// What shows of the surface, given the share smoothed by a Gaussian of this standard deviation, mm.
pub fn sights(occupancy: &Occupancy, smoothed: &[f32], sigma: f64, is_smallest: bool) -> Vec<Sight> {
    let (size, spacing) = (occupancy.geometry.size, occupancy.geometry.spacing);
    let shown = if is_smallest { SHOWN_AT_LEAST } else { SHOWN };
    let within = (WITHIN * sigma) as f32;
    let far_from = |is_shown: &(dyn Fn(f32) -> bool + Sync)| -> Vec<f32> {
        let mut distance: Vec<f32> =
            smoothed.par_iter().map(|&share| if is_shown(share) { 0.0 } else { f32::INFINITY }).collect();
        grow(&mut distance, size, spacing, 1.0);
        distance
    };
    let (inside, outside) = (far_from(&|share| share >= shown), far_from(&|share| share <= 1.0 - shown));
    let sight = |n: usize| match (is_surface(occupancy, n), inside[n].max(outside[n]) > within) {
        (false, _) => Sight::NoSurface,
        (true, false) => Sight::Shown,
        (true, true) => Sight::Hidden,
    };
    (0..smoothed.len()).into_par_iter().map(sight).collect()
}

/// Whether the surface runs through a voxel, or between it and a neighbour along an axis.
fn is_surface(occupancy: &Occupancy, n: usize) -> bool {
    let (size, own) = (occupancy.geometry.size, occupancy.shares[n]);
    let at = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
    let stride = [1, size[0], size[0] * size[1]];
    let differs = |near: usize| occupancy.is_inside(near) != occupancy.is_inside(n);
    (own > 0 && own < WHOLE)
        || (0..3).any(|axis| {
            (at[axis] > 0 && differs(n - stride[axis])) || (at[axis] + 1 < size[axis] && differs(n + stride[axis]))
        })
}

/// The scale everywhere, given what some places allow (infinite where nothing is asked): no larger than `largest`, and without steps.
pub fn spread(mut allowed: Vec<f32>, size: [usize; 3], spacing: DVec3, smallest: f64, largest: f64) -> Vec<f32> {
    grow(&mut allowed, size, spacing, GROWTH);
    allowed.par_iter_mut().for_each(|scale| *scale = scale.min(largest as f32));
    smooth(&mut allowed, size, (BLUNT * smallest / spacing).to_array());
    allowed
}

/// Lowers values until none is more than `slope` times the distance above another: the distance is that of the shortest way from voxel to voxel
/// over faces, edges and corners (up to 13 % above the straight one).
fn grow(values: &mut [f32], size: [usize; 3], spacing: DVec3, slope: f64) {
    let [nx, ny, nz] = size;
    let rise =
        |x: usize, y: usize, z: usize| (slope * (DVec3::new(x as f64, y as f64, z as f64) * spacing).length()) as f32;
    let mut least = vec![f32::INFINITY; nx];
    for is_upward in [true, false] {
        for row in 0..ny * nz {
            let row = if is_upward { row } else { ny * nz - 1 - row };
            let (j, k) = (row % ny, row / ny);
            least.copy_from_slice(&values[row * nx..(row + 1) * nx]);
            // the rows that come before this one: beside it in its slice, and the three of the slice before
            for (y, z) in [(-1, 0), (-1, -1), (0, -1), (1, -1)] {
                let (y, z): (isize, isize) = if is_upward { (y, z) } else { (-y, -z) };
                let (Some(b), Some(c)) = (j.checked_add_signed(y), k.checked_add_signed(z)) else { continue };
                if b < ny && c < nz {
                    let (straight, across) =
                        (rise(0, y.unsigned_abs(), z.unsigned_abs()), rise(1, y.unsigned_abs(), z.unsigned_abs()));
                    lower_by_row(&mut least, &values[(c * ny + b) * nx..][..nx], straight, across);
                }
            }
            let along = rise(1, 0, 0);
            for i in 1..nx {
                least[i] = least[i].min(least[i - 1] + along);
            }
            for i in (1..nx).rev() {
                least[i - 1] = least[i - 1].min(least[i] + along);
            }
            values[row * nx..(row + 1) * nx].copy_from_slice(&least);
        }
    }
}

/// Lowers a row to what a row beside it allows: straight across, and to the neighbours of that.
fn lower_by_row(row: &mut [f32], beside: &[f32], straight: f32, across: f32) {
    row.iter_mut().zip(beside).for_each(|(value, near)| *value = value.min(near + straight));
    row.iter_mut().skip(1).zip(beside).for_each(|(value, near)| *value = value.min(near + across));
    row.iter_mut().zip(beside.iter().skip(1)).for_each(|(value, near)| *value = value.min(near + across));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_over_neighbours_is_little_longer_than_the_straight_one() {
        let (size, spacing) = ([31, 29, 33], DVec3::new(1.0, 1.2, 0.8));
        let mut values = vec![f32::INFINITY; size.iter().product()];
        let source = [9, 14, 20];
        values[(source[2] * size[1] + source[1]) * size[0] + source[0]] = 2.0;
        grow(&mut values, size, spacing, 0.5);
        for (n, &value) in values.iter().enumerate() {
            let at = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
            let offset = DVec3::from_array(std::array::from_fn(|axis| at[axis] as f64 - source[axis] as f64)) * spacing;
            let straight = 2.0 + 0.5 * offset.length();
            assert!(f64::from(value) > straight - 1e-3 && f64::from(value) < 2.0 + 0.5 * 1.13 * offset.length() + 1e-3);
        }
    }
}
