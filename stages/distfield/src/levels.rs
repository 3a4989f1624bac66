//! One level set of the smoothed share of a Gaussian: where the level is that keeps the volume of each place.

use crate::gaussian::smooth;
use crate::occupancy::{Occupancy, WHOLE};
use glam::DVec3;
use rayon::prelude::*;

/// Width of the window in which the volume is kept, in standard deviations of the smoothing: what bends within it may be rounded.
const WINDOW: f64 = 2.0;

/// Least width of the window, voxels: in a smaller one the steps of labels are what is kept.
const LEAST_WINDOW: f64 = 2.0;

/// Rounds that find the level. After six the volumes of heart and lungs are kept to 0.1 %.
const ROUNDS: usize = 6;

/// Furthest that the level moves in a round.
const LONGEST_STEP: f64 = 0.15;

/// Share of a level surface's density that is added to it, so that the level stays where no surface is near. That of a plane is 0.5.
const REGULAR: f64 = 0.02;

/// Least distance of the level from that of nothing and that of everything. What shows less is thinner than the mesh can carry: a ball of 1.2, a tube of 0.8
/// standard deviations, round which there is room for twelve vertices and for four.
pub const LEAST_LEVEL: f64 = 0.3;

/// The share smoothed by a Gaussian.
pub fn smoothed_share(occupancy: &Occupancy, sigma: DVec3) -> Vec<f32> {
    let share = |n: usize| f32::from(occupancy.shares[n]) / f32::from(WHOLE);
    let mut smoothed: Vec<f32> = (0..occupancy.shares.len()).into_par_iter().map(share).collect();
    smooth(&mut smoothed, occupancy.geometry.size, sigma.to_array());
    smoothed
}

/// The smoothed share less the level that keeps the volume of each place. `sigma` is in voxels.
pub fn level_set(mut smoothed: Vec<f32>, occupancy: &Occupancy, sigma: DVec3) -> Vec<f32> {
    let size = occupancy.geometry.size;
    let share = |n: usize| f32::from(occupancy.shares[n]) / f32::from(WHOLE);
    let window = sigma.to_array().map(|sigma| (WINDOW * sigma).max(LEAST_WINDOW));
    let mut level = vec![0.5f32; smoothed.len()];
    for _ in 0..ROUNDS {
        let mut excess = vec![0.0f32; smoothed.len()];
        let mut density = vec![0.0f32; smoothed.len()];
        excess.par_iter_mut().zip(&mut density).enumerate().for_each(|(n, (excess, density))| {
            let width = change_across(&smoothed, size, n).max(1e-4);
            let part = 0.5 + (smoothed[n] - level[n]) / width;
            *excess = part.clamp(0.0, 1.0) - share(n);
            *density = if (0.0..1.0).contains(&part) { 1.0 / width } else { 0.0 };
        });
        smooth(&mut excess, size, window);
        smooth(&mut density, size, window);
        level.par_iter_mut().zip(&excess).zip(&density).for_each(|((level, excess), density)| {
            let step = f64::from(*excess) / (f64::from(*density) + REGULAR);
            let moved = f64::from(*level) + step.clamp(-LONGEST_STEP, LONGEST_STEP);
            *level = moved.clamp(LEAST_LEVEL, 1.0 - LEAST_LEVEL) as f32;
        });
    }
    smoothed.par_iter_mut().zip(&level).for_each(|(smoothed, level)| *smoothed -= level);
    smoothed
}

/// By how much values differ across a voxel: the sum of the slopes along the axes.
fn change_across(values: &[f32], size: [usize; 3], n: usize) -> f32 {
    let at = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
    let stride = [1, size[0], size[0] * size[1]];
    (0..3)
        .map(|axis| {
            let low = values[n - stride[axis] * usize::from(at[axis] > 0)];
            let high = values[n + stride[axis] * usize::from(at[axis] + 1 < size[axis])];
            0.5 * (high - low).abs()
        })
        .sum()
}
