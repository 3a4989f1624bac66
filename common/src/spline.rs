//! The implicit function F: the interpolating cubic B-spline through samples on a grid, with analytic gradient and
//! Hessian.
//!
//! The coefficients come from the exact recursive prefilter (Unser, Aldroubi and Eden 1993; pole sqrt(3) - 2,
//! mirror boundary), so that F takes the sample values at the samples; without it a ball shrinks by 1/(3R) voxel.

use crate::geometry::Geometry;
use crate::image::Image;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

const POLE: f64 = -0.267_949_192_431_122_7; // sqrt(3) - 2

/// Interpolating cubic B-spline over a grid; positions in the grid frame, derivatives per mm.
#[derive(Clone, Debug)]
pub struct CubicSpline {
    geometry: Geometry,
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
    /// Prefilters the samples of an image.
    pub fn new(image: &Image<f32>) -> Self {
        let mut coefficients = image.data.clone();
        let [nx, ny, nz] = image.geometry.size;
        // x: every line is contiguous
        coefficients.par_chunks_mut(nx).for_each_init(|| vec![0.0f64; nx], |line, row| filter_block(row, 1, nx, line));
        // y: within each slice
        coefficients
            .par_chunks_mut(nx * ny)
            .for_each_init(|| vec![0.0f64; ny * nx], |block, slice| filter_block(slice, nx, ny, block));
        // z: gather a plane of fixed y, filter along z, scatter back
        if nz > 1 {
            let planes: Vec<Vec<f32>> = (0..ny)
                .into_par_iter()
                .map(|j| {
                    let mut plane = Vec::with_capacity(nx * nz);
                    for k in 0..nz {
                        plane.extend_from_slice(&coefficients[(k * ny + j) * nx..][..nx]);
                    }
                    let mut block = vec![0.0f64; nx * nz];
                    filter_block(&mut plane, nx, nz, &mut block);
                    plane
                })
                .collect();
            coefficients.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slice)| {
                for (j, plane) in planes.iter().enumerate() {
                    slice[j * nx..(j + 1) * nx].copy_from_slice(&plane[k * nx..(k + 1) * nx]);
                }
            });
        }
        Self { geometry: image.geometry.clone(), coefficients }
    }

    /// Takes coefficients as they are (already prefiltered).
    pub fn from_coefficients(geometry: Geometry, coefficients: Vec<f32>) -> Self {
        assert_eq!(geometry.voxel_count(), coefficients.len(), "one coefficient a voxel");
        Self { geometry, coefficients }
    }

    /// The grid.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// The spline coefficients, x fastest.
    pub fn coefficients(&self) -> &[f32] {
        &self.coefficients
    }

    /// F at a grid position (clamped to the volume).
    pub fn value(&self, grid: DVec3) -> f64 {
        let stencil = self.stencil(grid);
        let mut sum = 0.0;
        stencil.each_row(|wy, wz, base| {
            let row = &self.coefficients[base..];
            sum += wy.0 * wz.0 * dot(&stencil.x.0, row, &stencil.ix);
        });
        sum
    }

    /// F and its gradient at a grid position (clamped to the volume).
    pub fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        let stencil = self.stencil(grid);
        let (mut value, mut gradient) = (0.0, DVec3::ZERO);
        stencil.each_row(|wy, wz, base| {
            let row = &self.coefficients[base..];
            let c0 = dot(&stencil.x.0, row, &stencil.ix);
            let c1 = dot(&stencil.x.1, row, &stencil.ix);
            value += wy.0 * wz.0 * c0;
            gradient += DVec3::new(wy.0 * wz.0 * c1, wy.1 * wz.0 * c0, wy.0 * wz.1 * c0);
        });
        (value, gradient / self.geometry.spacing)
    }

    /// F, gradient and Hessian at a grid position (clamped to the volume).
    pub fn jet(&self, grid: DVec3) -> Jet {
        let stencil = self.stencil(grid);
        let (mut value, mut gradient) = (0.0, DVec3::ZERO);
        let (mut diagonal, mut mixed) = (DVec3::ZERO, DVec3::ZERO);
        stencil.each_row(|wy, wz, base| {
            let row = &self.coefficients[base..];
            let c0 = dot(&stencil.x.0, row, &stencil.ix);
            let c1 = dot(&stencil.x.1, row, &stencil.ix);
            let c2 = dot(&stencil.x.2, row, &stencil.ix);
            value += wy.0 * wz.0 * c0;
            gradient += DVec3::new(wy.0 * wz.0 * c1, wy.1 * wz.0 * c0, wy.0 * wz.1 * c0);
            diagonal += DVec3::new(wy.0 * wz.0 * c2, wy.2 * wz.0 * c0, wy.0 * wz.2 * c0);
            // mixed: yz, xz, xy
            mixed += DVec3::new(wy.1 * wz.1 * c0, wy.0 * wz.1 * c1, wy.1 * wz.0 * c1);
        });
        let s = self.geometry.spacing;
        let (yz, xz, xy) = (mixed.x / (s.y * s.z), mixed.y / (s.x * s.z), mixed.z / (s.x * s.y));
        let d = diagonal / (s * s);
        Jet {
            value,
            gradient: gradient / s,
            hessian: DMat3::from_cols(DVec3::new(d.x, xy, xz), DVec3::new(xy, d.y, yz), DVec3::new(xz, yz, d.z)),
        }
    }

    /// Moves a point onto F = 0 by Newton steps along the gradient (Eq. 5 with its sign mended). `limit` is the
    /// longest total move (mm); `None` when the point runs away, or the gradient vanishes, or 25 steps are not enough
    /// to reach |F| <= `tolerance` (mm).
    pub fn project(&self, start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        self.project_with_gradient(start, limit, tolerance).map(|(p, _)| p)
    }

    /// As [`Self::project`], with the gradient of F at the point reached.
    pub fn project_with_gradient(&self, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        let longest = 0.5 * self.geometry.mean_spacing();
        let mut p = start;
        for _ in 0..25 {
            let (f, g) = self.value_gradient(p);
            let g2 = g.length_squared();
            // also refuses a gradient that is not a number
            if g2.partial_cmp(&1e-8) != Some(std::cmp::Ordering::Greater) {
                return None;
            }
            if f.abs() <= tolerance * g2.sqrt().min(1.0) {
                return Some((p, g));
            }
            p += (-g * (f / g2)).clamp_length_max(longest);
            if p.distance_squared(start) > limit * limit {
                return None;
            }
        }
        None
    }

    fn stencil(&self, grid: DVec3) -> Stencil {
        let g = &self.geometry;
        let index = g.grid_to_index(grid);
        let axis = |a: usize| {
            let n = g.size[a];
            let x = index[a].clamp(0.0, (n - 1) as f64);
            let base = (x.floor() as usize).min(n.saturating_sub(2));
            let t = x - base as f64;
            let at: [usize; 4] = std::array::from_fn(|k| mirror(base as isize + k as isize - 1, n));
            (weights(t), at)
        };
        let (x, ix) = axis(0);
        let (y, iy) = axis(1);
        let (z, iz) = axis(2);
        Stencil { x, y, z, ix, iy, iz, nx: g.size[0], ny: g.size[1] }
    }
}

/// B-spline weights and their first and second derivatives (per index) for the four samples around a cell.
type Weights = ([f64; 4], [f64; 4], [f64; 4]);

struct Stencil {
    x: Weights,
    y: Weights,
    z: Weights,
    ix: [usize; 4],
    iy: [usize; 4],
    iz: [usize; 4],
    nx: usize,
    ny: usize,
}

impl Stencil {
    #[inline(always)]
    fn each_row(&self, mut row: impl FnMut((f64, f64, f64), (f64, f64, f64), usize)) {
        for c in 0..4 {
            let wz = (self.z.0[c], self.z.1[c], self.z.2[c]);
            for b in 0..4 {
                let wy = (self.y.0[b], self.y.1[b], self.y.2[b]);
                row(wy, wz, (self.iz[c] * self.ny + self.iy[b]) * self.nx);
            }
        }
    }
}

#[inline(always)]
fn dot(w: &[f64; 4], row: &[f32], at: &[usize; 4]) -> f64 {
    w[0] * f64::from(row[at[0]])
        + w[1] * f64::from(row[at[1]])
        + w[2] * f64::from(row[at[2]])
        + w[3] * f64::from(row[at[3]])
}

fn weights(t: f64) -> Weights {
    let u = 1.0 - t;
    (
        [
            u * u * u / 6.0,
            (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
            (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
            t * t * t / 6.0,
        ],
        [-0.5 * u * u, t * (1.5 * t - 2.0), -u * (1.5 * u - 2.0), 0.5 * t * t],
        [u, 3.0 * t - 2.0, 3.0 * u - 2.0, t],
    )
}

pub(crate) fn mirror(i: isize, n: usize) -> usize {
    if n == 1 {
        return 0;
    }
    let last = n as isize - 1;
    let mut i = i;
    while i < 0 || i > last {
        if i < 0 {
            i = -i;
        }
        if i > last {
            i = 2 * last - i;
        }
    }
    i as usize
}

/// Prefilters `count` lines of `length` samples that lie `width` apart in a block (`width` lines side by side).
fn filter_block(block: &mut [f32], width: usize, length: usize, scratch: &mut [f64]) {
    if length < 2 {
        return;
    }
    for (to, from) in scratch.iter_mut().zip(block.iter()) {
        *to = 6.0 * f64::from(*from);
    }
    let horizon = 30.min(length);
    // first causal value: mirrored geometric sum
    for x in 0..width {
        scratch[x] = causal_start(|k| scratch[k * width + x], length, horizon);
    }
    for k in 1..length {
        let (before, now) = scratch.split_at_mut(k * width);
        let before = &before[(k - 1) * width..];
        for x in 0..width {
            now[x] += POLE * before[x];
        }
    }
    let last = (length - 1) * width;
    for x in 0..width {
        scratch[last + x] = POLE / (POLE * POLE - 1.0) * (scratch[last + x] + POLE * scratch[last - width + x]);
    }
    for k in (0..length - 1).rev() {
        let (now, after) = scratch.split_at_mut((k + 1) * width);
        let now = &mut now[k * width..];
        for x in 0..width {
            now[x] = POLE * (after[x] - now[x]);
        }
    }
    for (to, from) in block.iter_mut().zip(scratch.iter()) {
        *to = *from as f32;
    }
}

fn causal_start(sample: impl Fn(usize) -> f64, length: usize, horizon: usize) -> f64 {
    if horizon < length {
        let (mut sum, mut z) = (0.0, 1.0);
        for k in 0..horizon {
            sum += z * sample(k);
            z *= POLE;
        }
        return sum;
    }
    // short line: the exact mirrored sum
    let period = 2 * (length - 1);
    let (mut sum, mut z) = (0.0, 1.0);
    for k in 0..period {
        sum += z * sample(mirror(k as isize, length));
        z *= POLE;
    }
    sum / (1.0 - POLE.powi(period as i32))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn smooth(p: DVec3) -> f64 {
        (0.3 * p.x).sin() * (0.2 * p.y + 0.4).cos() + 0.1 * p.z * p.z * 0.1 + 0.05 * p.x * p.z
    }

    fn sampled(size: [usize; 3], spacing: DVec3) -> Image<f32> {
        let geometry = Geometry::axis_aligned(size, spacing);
        let mut data = Vec::new();
        for k in 0..size[2] {
            for j in 0..size[1] {
                for i in 0..size[0] {
                    data.push(smooth(geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64))) as f32);
                }
            }
        }
        Image { geometry, data }
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
