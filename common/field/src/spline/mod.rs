//! The implicit function F: the interpolating cubic B-spline through samples on a grid, with
//! analytic gradient and Hessian.
//!
//! The coefficients are computed by the exact recursive prefilter (Unser, Aldroubi and Eden 1993;
//! pole sqrt(3) - 2, mirror boundary), so F interpolates the samples. Without the prefilter, the
//! radius R of a ball (in voxels) would shrink by 1/(3R) voxels.

use glam::{DMat3, DVec3};
use isoparticles_volume::{Geometry, Image};
use prefilter::{filter_across, filter_slice, scatter};
use rayon::prelude::*;

pub(crate) mod bezier;
mod bricks;
mod prefilter;
mod stencil;

pub use bricks::{BrickSpline, BrickSplineBuilder, Layer};
pub use prefilter::{Coefficients, SlabFilter};
pub(crate) use stencil::Stencil;
use stencil::mirror;

/// Maximum number of Newton steps in a projection. Steps are limited to half a voxel; near F = 0,
/// each step doubles the number of correct digits. On the strata of the brain crop in
/// `materials/complex/follow.rs`, projections that converge take at most 15 steps. On F = 0 of
/// `trabecular_bone`, they take at most 21 steps, from positions up to a voxel away and with a
/// tolerance of 1e-9 voxel.
pub const PROJECTION_STEPS: usize = 25;

/// Maximum squared gradient at which a projection fails, corresponding to a slope of 1e-4. F is a
/// distance, so its slope is 1 nearly everywhere. At a slope of 1e-4, F / slope does not
/// approximate a distance: a value of 1e-4 voxel would give a step of one voxel.
pub const LEAST_SQUARED_GRADIENT: f64 = 1e-8;

/// Minimum distance in voxels from a surface to a face of the grid. At this distance, the spline
/// near the surface is almost the same as on a larger grid. The mirror boundary replaces the values
/// beyond the face. If the mirrored values have an error of d, the error of the spline n nodes from
/// the face is less than d sqrt(3) z^(n + 1) / (1 - z), with z = 2 - sqrt(3) (impulse response of
/// the prefilter, Unser 1999). With n = 7, this is 6e-5 d. If d is ten times the difference between
/// adjacent voxels at the surface, the surface moves by 0.0006 voxel.
pub const ROOM: usize = 8;

/// The interpolating cubic B-spline over a grid. Positions are in the grid frame, derivatives per
/// mm.
#[derive(Clone, Debug)]
pub struct CubicSpline {
    geometry: Geometry,
    /// Mean spacing in mm. Stored because computing it takes a cube root, and projections need it
    /// millions of times.
    voxel: f64,
    coefficients: Vec<f32>,
}

/// Value, gradient and Hessian of F at one point.
#[derive(Clone, Copy, Debug)]
pub struct Jet {
    /// F.
    pub value: f64,
    /// Gradient, per mm.
    pub gradient: DVec3,
    /// Hessian (symmetric), per mm squared.
    pub hessian: DMat3,
}

impl CubicSpline {
    /// Creates the spline through the samples of an image.
    pub fn new(image: &Image<f32>) -> Self {
        let mut coefficients = image.data.clone();
        let [nx, ny, nz] = image.geometry.size;
        coefficients
            .par_chunks_mut(nx * ny)
            .for_each_init(|| vec![0.0f64; nx * ny], |scratch, slice| filter_slice(slice, nx, ny, scratch));
        if nz > 1 {
            let planes = filter_across(&coefficients.chunks(nx * ny).collect::<Vec<_>>(), nx, 0..nz);
            scatter(&planes, nx, &mut coefficients);
        }
        Self::from_coefficients(image.geometry.clone(), coefficients)
    }

    /// Creates the spline from coefficients that are already prefiltered.
    pub fn from_coefficients(geometry: Geometry, coefficients: Vec<f32>) -> Self {
        assert_eq!(geometry.voxel_count(), coefficients.len(), "one coefficient a voxel");
        Self { voxel: geometry.mean_spacing(), geometry, coefficients }
    }

    /// Returns the grid.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Returns the mean voxel spacing in mm.
    pub fn voxel(&self) -> f64 {
        self.voxel
    }

    /// Returns the spline coefficients, x fastest.
    pub fn coefficients(&self) -> &[f32] {
        &self.coefficients
    }

    /// Returns F at a grid position (clamped to the volume).
    pub fn value(&self, grid: DVec3) -> f64 {
        Stencil::new(&self.geometry, grid).value(&self.coefficients)
    }

    /// Returns F and its gradient at a grid position (clamped to the volume).
    #[inline(always)]
    pub fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        Stencil::new(&self.geometry, grid).value_gradient(&self.coefficients, self.geometry.spacing)
    }

    /// Returns a first-order estimate of the distance from F = 0 in mm, negative inside:
    /// F / |grad F| ([`distance_estimate`]).
    pub fn distance_estimate(&self, grid: DVec3) -> f64 {
        let (value, gradient) = self.value_gradient(grid);
        distance_estimate(value, gradient)
    }

    /// Returns F, its gradient and its Hessian at a grid position (clamped to the volume). Inlined,
    /// so that it is compiled for the instruction set of the caller.
    #[inline(always)]
    pub fn jet(&self, grid: DVec3) -> Jet {
        Stencil::new(&self.geometry, grid).jet(&self.coefficients, self.geometry.spacing)
    }

    /// Moves a point onto F = 0 by Newton steps along the gradient (Eq. 5 with its sign corrected).
    /// `limit` is the maximum distance from `start` in mm. Returns `None` if the point moves
    /// farther or ends outside the volume, if the gradient vanishes, or if [`PROJECTION_STEPS`]
    /// steps do not reduce |F| and the first-order distance to `tolerance` (mm).
    pub fn project(&self, start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        self.project_with_gradient(start, limit, tolerance).map(|(p, _)| p)
    }

    /// Projects a point like [`Self::project`], and also returns the gradient of F at the result.
    #[inline(always)]
    pub fn project_with_gradient(&self, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        let longest = 0.5 * self.voxel;
        let mut p = start;
        for _ in 0..PROJECTION_STEPS {
            let (f, g) = self.value_gradient(p);
            let g2 = g.length_squared();
            // also rejects NaN gradients
            if g2.partial_cmp(&LEAST_SQUARED_GRADIENT) != Some(std::cmp::Ordering::Greater) {
                return None;
            }
            if f.abs() <= tolerance * g2.sqrt().min(1.0) {
                return self.geometry.holds(p).then_some((p, g));
            }
            p += (-g * (f / g2)).clamp_length_max(longest);
            if p.distance_squared(start) > limit * limit {
                return None;
            }
        }
        None
    }
}

/// Minimum gradient length used as a divisor. It keeps the distance estimate finite where F is flat
/// and the gradient does not determine a distance.
pub const LEAST_GRADIENT: f64 = 1e-12;

/// Returns a first-order estimate of the distance in mm from F = 0, given the value and gradient of
/// F at a point: F / |grad F| (Taubin 1994), negative inside. The estimate is exact where F is
/// linear or a signed distance. Elsewhere its error is of second order in the distance.
pub fn distance_estimate(value: f64, gradient: DVec3) -> f64 {
    value / gradient.length().max(LEAST_GRADIENT)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn smooth(p: DVec3) -> f64 {
        (0.3 * p.x).sin() * (0.2 * p.y + 0.4).cos() + 0.1 * p.z * p.z * 0.1 + 0.05 * p.x * p.z
    }

    fn sampled(size: [usize; 3], spacing: DVec3) -> Image<f32> {
        Image::sampled(Geometry::axis_aligned(size, spacing), |p| smooth(p) as f32)
    }

    #[test]
    fn interpolates_the_samples() {
        for size in [[12, 9, 11], [40, 37, 33], [2, 3, 5]] {
            let image = sampled(size, DVec3::new(0.7, 1.1, 0.9));
            let spline = CubicSpline::new(&image);
            for k in 0..size[2] {
                for j in 0..size[1] {
                    for i in 0..size[0] {
                        let p = image.geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64));
                        let difference = (spline.value(p) - f64::from(image.at(i, j, k))).abs();
                        assert!(difference < 1e-7 * 40.0, "{size:?} at {i} {j} {k}: off by {difference}");
                    }
                }
            }
        }
    }

    #[test]
    fn derivatives_equal_differences_of_the_value() {
        let image = sampled([20, 18, 16], DVec3::new(0.7, 1.1, 0.9));
        let spline = CubicSpline::new(&image);
        let e = 1e-4;
        for n in 0..200u64 {
            let p = DVec3::from_array(std::array::from_fn(|a| {
                (2.0 + 11.0 * crate::random::uniform(7, a as u64, n)) * image.geometry.spacing[a]
            }));
            let jet = spline.jet(p);
            let (value, gradient) = spline.value_gradient(p);
            assert!((jet.value - value).abs() < 1e-12 && (jet.value - spline.value(p)).abs() < 1e-12);
            assert!((jet.gradient - gradient).length() < 1e-12);
            for a in 0..3 {
                let step = DVec3::AXES[a] * e;
                let (up, gu) = spline.value_gradient(p + step);
                let (down, gd) = spline.value_gradient(p - step);
                assert!(((up - down) / (2.0 * e) - gradient[a]).abs() < 1e-6);
                assert!(((gu - gd) / (2.0 * e) - jet.hessian.col(a)).length() < 1e-4);
            }
        }
    }
}
