//! Resamples a volume from a sheared grid to an orthonormal grid. A gantry tilt or a NIfTI sform
//! can cause the shear.
//!
//! The new axes result from Gram-Schmidt orthogonalization: x is unchanged, y lies in the slice
//! plane, and z is the slice normal. Every old slice becomes one new slice, so at most two
//! one-dimensional passes are needed. The first pass shifts each slice along y, and the second
//! shifts each row along x. The volume of a voxel does not change.
//!
//! [`Shear::interpolate`] resamples measured values with the cubic kernel of Keys (1981), and
//! [`Shear::move_labels`] resamples labels.

mod labels;

use crate::geometry::Geometry;
use crate::voxels::Voxels;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Upper limit, in voxels, of the shifts at the far end of the volume that are ignored. Such shifts
/// can result from rounded directions in the header: an error of 1e-4 shifts the 500th voxel by
/// 0.05 voxels.
const IGNORED_SHIFT: f64 = 0.1;

/// A transformation from a sheared grid to an orthonormal grid that covers it.
#[derive(Clone, Debug)]
pub struct Shear {
    /// The orthonormal grid.
    pub geometry: Geometry,
    /// Maximum deviation of the angle between two old axes from 90 degrees, in degrees.
    pub degrees: f64,
    passes: Vec<Pass>,
}

/// A pass that shifts rows along one axis.
#[derive(Clone, Copy, Debug)]
struct Pass {
    /// The axis along which the rows are shifted: 0 or 1.
    axis: usize,
    /// Grid size before the pass.
    from: [usize; 3],
    /// Grid size after the pass.
    to: [usize; 3],
    /// The shift of a row in voxels is `start + per_row * row + per_slice * slice`.
    start: f64,
    per_row: f64,
    per_slice: f64,
}

impl Shear {
    /// Computes the transformation of a grid to an orthonormal one. Returns `None` if all shifts
    /// are smaller than `IGNORED_SHIFT`.
    pub fn of(geometry: &Geometry) -> Option<Self> {
        let [d0, d1, d2] = [0, 1, 2].map(|axis| geometry.directions.col(axis));
        let x = d0.normalize();
        let y = d1.reject_from_normalized(x).normalize();
        let normal = x.cross(y);
        let z = if normal.dot(d2) < 0.0 { -normal } else { normal };
        let spacing = geometry.spacing * DVec3::new(1.0, d1.dot(y), d2.dot(z));
        let [nx, ny, nz] = geometry.size;
        let kept =
            |shift: f64, count: usize| if shift.abs() * (count as f64 - 1.0) < IGNORED_SHIFT { 0.0 } else { shift };
        // shifts in voxels: along x per row, along x per slice, along y per slice
        let xy = kept(geometry.spacing.y * d1.dot(x) / spacing.x, ny);
        let xz = kept(geometry.spacing.z * d2.dot(x) / spacing.x, nz);
        let yz = kept(geometry.spacing.z * d2.dot(y) / spacing.y, nz);
        if [xy, xz, yz] == [0.0; 3] {
            return None;
        }
        let (far_y, far_z) = (ny as f64 - 1.0, nz as f64 - 1.0);
        let low_y = snapped((yz * far_z).min(0.0)).floor();
        let low_x = snapped((xy * far_y).min(0.0) + (xz * far_z).min(0.0)).floor();
        let high_y = snapped((yz * far_z).max(0.0)).ceil();
        let high_x = snapped((xy * far_y).max(0.0) + (xz * far_z).max(0.0)).ceil();
        let between = [nx, ny + (high_y - low_y) as usize, nz];
        let size = [nx + (high_x - low_x) as usize, between[1], nz];
        let along_y = Pass { axis: 1, from: geometry.size, to: between, start: -low_y, per_row: 0.0, per_slice: yz };
        // the position of `row` before the first pass is row + low_y - yz * slice
        let along_x =
            Pass { axis: 0, from: between, to: size, start: xy * low_y - low_x, per_row: xy, per_slice: xz - xy * yz };
        let passes = [(along_y, yz != 0.0), (along_x, xy != 0.0 || xz != 0.0)];
        let first = x * (low_x * spacing.x) + y * (low_y * spacing.y);
        let sines = [d0.dot(d1), d1.dot(d2), d2.dot(d0)].map(f64::abs);
        Some(Self {
            geometry: Geometry {
                size,
                spacing,
                directions: DMat3::from_cols(x, y, z),
                origin: geometry.origin + first,
                space: geometry.space,
            },
            degrees: sines.into_iter().fold(0.0, f64::max).min(1.0).asin().to_degrees(),
            passes: passes.into_iter().filter(|(_, moves)| *moves).map(|(pass, _)| pass).collect(),
        })
    }

    /// Describes the resampling for the user.
    pub fn remark(&self) -> String {
        let ([nx, ny, nz], [sx, sy, sz]) = (self.geometry.size, self.geometry.spacing.to_array());
        format!(
            "the axes are {:.1} degrees off right angles; the volume is resampled on an orthogonal grid of {nx} x \
             {ny} x {nz} voxels of {sx:.4} x {sy:.4} x {sz:.4} mm",
            self.degrees
        )
    }

    /// Resamples values to the orthonormal grid by cubic interpolation within the slices. Outside
    /// the volume, the value is `beyond(v)`, where v is the value of the nearest voxel in the row.
    pub fn interpolate(&self, voxels: &Voxels, beyond: impl Fn(f32) -> f32 + Sync) -> Vec<f32> {
        self.passes.iter().fold(voxels.to_f32(), |values, pass| pass.interpolate(&values, &beyond))
    }
}

impl Pass {
    /// Returns the source position of the voxels in a row as `(first, part)`: new voxel n lies at
    /// the old position `n - first + part`, where `0 <= part < 1`.
    fn shift(&self, row: isize, slice: isize) -> (isize, f64) {
        let shift = snapped(self.start + self.per_row * row as f64 + self.per_slice * slice as f64);
        let first = shift.ceil();
        (first as isize, first - shift)
    }

    /// Returns the number of rows per slice.
    fn rows(&self) -> usize {
        self.from[1 - self.axis]
    }

    /// Returns the linear index of voxel `n` of row `row` in slice `k`, in a grid of `size` voxels.
    #[inline]
    fn linear(&self, size: [usize; 3], n: usize, row: usize, k: usize) -> usize {
        let (i, j) = if self.axis == 0 { (n, row) } else { (row, n) };
        (k * size[1] + j) * size[0] + i
    }

    fn interpolate(&self, values: &[f32], beyond: &(impl Fn(f32) -> f32 + Sync)) -> Vec<f32> {
        let last = self.from[self.axis] as isize - 1;
        let mut moved = vec![0.0; self.to.iter().product()];
        moved.par_chunks_mut(self.to[0] * self.to[1]).enumerate().for_each(|(k, slice)| {
            for row in 0..self.rows() {
                let (first, part) = self.shift(row as isize, k as isize);
                let weights = keys(part);
                let old = |n: isize| {
                    let value = values[self.linear(self.from, n.clamp(0, last) as usize, row, k)];
                    if (0..=last).contains(&n) { value } else { beyond(value) }
                };
                for n in 0..self.to[self.axis] {
                    let at = n as isize - first;
                    slice[self.linear(self.to, n, row, 0)] = if part == 0.0 {
                        old(at)
                    } else {
                        (-1..=2).zip(weights).map(|(step, weight)| weight * old(at + step)).sum()
                    };
                }
            }
        });
        moved
    }
}

/// Rounds a shift in voxels to the nearest integer if the difference is less than 1e-6. An integer
/// shift then moves values without interpolation, despite rounding errors.
fn snapped(shift: f64) -> f64 {
    if (shift - shift.round()).abs() < 1e-6 { shift.round() } else { shift }
}

/// Returns the weights of voxels -1, 0, 1 and 2 for interpolation at a position t between voxels 0
/// and 1. The kernel is the cubic convolution of Keys (1981) with a = -1/2, which is exact for
/// polynomials of second degree. For a synthetic scan of a ball of radius 14 mm, with a point
/// spread of 0.8 mm and 1 mm voxels sheared by 30 degrees, F = 0 encloses 11,454 mm^3. With linear
/// interpolation, it encloses 11,446 mm^3; on an unsheared grid, 11,456 mm^3.
fn keys(t: f64) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, 0.5 * (t3 - t2)]
        .map(|weight| weight as f32)
}

#[cfg(test)]
mod tests;
