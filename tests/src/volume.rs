//! Samples a scene as voxels: as a label map, a mask, or a scalar volume with the blurred edges and
//! noise of a scanner.

use crate::scene::Scene;
use glam::DVec3;
use isoparticles_field::random;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;

/// Width of the edge profile in units of the mean voxel spacing. The profile rises from 10 to 90 %
/// within ln 9 = 2.2 widths, or 2.75 voxels.
pub const EDGE_WIDTH_VOXELS: f64 = 1.25;

/// Stream number of the counter-based random numbers for the noise. Its bytes spell "noise!".
const NOISE_STREAM: u64 = 0x6e6f_6973_6521;

fn sampled<T: Copy + Send>(grid: &Geometry, f: impl Fn(DVec3, u64) -> T + Sync) -> Image<T> {
    let [nx, ny, _] = grid.size;
    let data = (0..grid.voxel_count())
        .into_par_iter()
        .map(|linear| {
            let (i, j, k) = (linear % nx, linear / nx % ny, linear / (nx * ny));
            f(grid.index_to_grid(DVec3::new(i as f64, j as f64, k as f64)), linear as u64)
        })
        .collect();
    Image { geometry: grid.clone(), data }
}

/// Returns a scalar volume: the edge profile from the outside to the inside intensity, plus
/// Gaussian noise of standard deviation `noise` (in intensity units).
pub fn scalar(scene: &dyn Scene, grid: &Geometry, noise: f64, seed: u64) -> Image<f32> {
    let width = EDGE_WIDTH_VOXELS * grid.mean_spacing();
    let (outside, inside) = scene.intensities();
    sampled(grid, |position, counter| {
        let clean = outside + (inside - outside) * scene.profile(position, width);
        (clean + noise * gaussian(seed, counter)) as f32
    })
}

/// Returns a label map.
pub fn labels(scene: &dyn Scene, grid: &Geometry) -> Image<u8> {
    sampled(grid, |position, _| scene.label(position))
}

/// Returns a mask that is true for voxels whose centre is inside.
pub fn mask(scene: &dyn Scene, grid: &Geometry) -> Image<bool> {
    sampled(grid, |position, _| scene.value(position) < 0.0)
}

/// Returns the scene's value at every voxel centre: the exact signed distance, if the scene
/// provides it.
pub fn values(scene: &dyn Scene, grid: &Geometry) -> Image<f32> {
    sampled(grid, |position, _| scene.value(position) as f32)
}

/// Returns the standard normal random number for a counter (Box and Muller 1958).
fn gaussian(seed: u64, counter: u64) -> f64 {
    let radius = (-2.0 * (1.0 - random::uniform(seed, NOISE_STREAM, 2 * counter)).ln()).sqrt();
    radius * (std::f64::consts::TAU * random::uniform(seed, NOISE_STREAM, 2 * counter + 1)).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Options, Shape, build};

    #[test]
    fn noise_has_the_asked_spread_and_depends_on_the_seed_alone() {
        let grid = Geometry::axis_aligned([24, 24, 24], DVec3::ONE);
        let scene = build(Shape::Ball, &grid, &Options::for_grid(&grid));
        let clean = scalar(scene.as_ref(), &grid, 0.0, 7);
        let noisy = scalar(scene.as_ref(), &grid, 20.0, 7);
        assert_eq!(noisy, scalar(scene.as_ref(), &grid, 20.0, 7));
        assert_ne!(noisy, scalar(scene.as_ref(), &grid, 20.0, 8));
        let differences: Vec<f64> =
            noisy.data.iter().zip(&clean.data).map(|(n, c)| f64::from(*n) - f64::from(*c)).collect();
        let count = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / count;
        let deviation = (differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / count).sqrt();
        // The tolerances, 0.7 for the mean and 0.5 for the standard deviation, are four standard
        // errors for 13,824 random numbers with a standard deviation of 20.
        assert!(mean.abs() < 0.7, "mean {mean}");
        assert!((deviation - 20.0).abs() < 0.5, "deviation {deviation}");
    }

    #[test]
    fn the_iso_value_lies_half_way() {
        let grid = Geometry::axis_aligned([32, 32, 32], DVec3::ONE);
        let scene = build(Shape::Ball, &grid, &Options::for_grid(&grid));
        let image = scalar(scene.as_ref(), &grid, 0.0, 0);
        let mask = mask(scene.as_ref(), &grid);
        assert!(image.data.iter().zip(&mask.data).all(|(value, inside)| (*value > 100.0) == *inside));
    }
}
