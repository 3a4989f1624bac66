//! Stores the spline only near its zero set. The coefficients are stored in bricks, so that the
//! memory for a large image is proportional to the area of the zero set, not to the volume of the
//! image.

use super::Jet;
use super::prefilter::SlabFilter;
use super::stencil::Stencil;
use glam::{DMat3, DVec3};
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;
use std::ops::Range;

/// Number of cells of a brick along each axis. Bricks overlap, so each coefficient is stored
/// (19 / 16)^3 = 1.7 times on average. With four cells, it would be stored 5.4 times.
const BRICK_CELLS: usize = 16;

/// Number of coefficients that the cells of a brick use along each axis.
const BRICK_SIDE: usize = BRICK_CELLS + 3;

/// Distance in voxels from the zero set within which all bricks are stored. The spline is evaluated
/// at vertices of marching cubes, which are within a voxel of the zero set, and along their
/// projections onto it. A value of 3 leaves two voxels for the projections.
const STORED_DISTANCE: usize = 3;

/// Sentinel indices of bricks that are not stored, because the spline is negative (or positive)
/// throughout the brick.
const NEGATIVE: u32 = u32::MAX;
const POSITIVE: u32 = u32::MAX - 1;

/// An interpolating cubic B-spline that is stored only within a few voxels of its zero set.
/// Positions are in the grid frame, derivatives per mm.
///
/// The value of a spline lies within the range of its coefficients, so a brick contains no zero if
/// all its coefficients have the same sign. In a brick that is not stored, the value is 1 or -1 and
/// the derivatives are zero.
#[derive(Clone, Debug)]
pub struct BrickSpline {
    geometry: Geometry,
    /// For each brick of the grid (x fastest), its index among the stored bricks, or one of the
    /// sentinels [`NEGATIVE`] and [`POSITIVE`].
    number: Vec<u32>,
    /// Coefficients of the bricks, one brick after the other.
    coefficients: Vec<f32>,
}

/// One layer of bricks along z.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Slices whose coefficients are needed to build the layer.
    pub slices: Range<usize>,
    /// Slices that belong to the layer. Every slice belongs to exactly one layer.
    pub own: Range<usize>,
}

/// Builds a [`BrickSpline`] layer by layer.
pub struct BrickSplineBuilder {
    spline: BrickSpline,
}

impl BrickSplineBuilder {
    /// Creates a builder for a spline on a grid.
    pub fn new(geometry: Geometry) -> Self {
        Self { spline: BrickSpline { geometry, number: Vec::new(), coefficients: Vec::new() } }
    }

    /// Returns the layers in ascending order of their slices.
    pub fn layers(geometry: &Geometry) -> impl Iterator<Item = Layer> + use<> {
        let nz = geometry.size[2];
        let count = bricks_along(nz);
        (0..count).map(move |layer| {
            let first = layer * BRICK_CELLS;
            let end = if layer + 1 == count { nz } else { first + BRICK_CELLS };
            Layer {
                slices: first.saturating_sub(1 + STORED_DISTANCE)..(first + BRICK_CELLS + 2 + STORED_DISTANCE).min(nz),
                own: first..end,
            }
        })
    }

    /// Adds the next layer. `row(j, k)` returns the coefficients along x at y index j and z index
    /// k. It is called only for the slices of the layer.
    pub fn add<'a>(&mut self, layer: &Layer, row: impl Fn(usize, usize) -> &'a [f32] + Sync) {
        let size = self.spline.geometry.size;
        let [nx, ny, _] = size;
        let (columns, rows) = (bricks_along(nx), bricks_along(ny));
        let k = layer.own.start;
        let bricks: Vec<Result<Vec<f32>, u32>> = (0..columns * rows)
            .into_par_iter()
            .map(|n| brick(size, [n % columns * BRICK_CELLS, n / columns * BRICK_CELLS, k], &row))
            .collect();
        for brick in bricks {
            let number = brick.map(|coefficients| {
                let number = self.spline.coefficients.len() / (BRICK_SIDE * BRICK_SIDE * BRICK_SIDE);
                self.spline.coefficients.extend_from_slice(&coefficients);
                number as u32
            });
            self.spline.number.push(number.unwrap_or_else(|sign| sign));
        }
    }

    /// Returns the spline. All layers must have been added.
    pub fn finish(mut self) -> BrickSpline {
        self.spline.coefficients.shrink_to_fit();
        self.spline
    }
}

fn bricks_along(nodes: usize) -> usize {
    nodes.saturating_sub(1).div_ceil(BRICK_CELLS).max(1)
}

/// Returns the coefficients of the brick whose lowest cell is `first`, on a grid of `size` nodes.
/// Far from the zero set, returns the sentinel for the sign of the spline as an error.
fn brick<'a>(size: [usize; 3], first: [usize; 3], row: &impl Fn(usize, usize) -> &'a [f32]) -> Result<Vec<f32>, u32> {
    let around = [0, 1, 2].map(|a| {
        first[a].saturating_sub(1 + STORED_DISTANCE)..(first[a] + BRICK_CELLS + 2 + STORED_DISTANCE).min(size[a])
    });
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for k in around[2].clone() {
        for j in around[1].clone() {
            for &c in &row(j, k)[around[0].clone()] {
                (low, high) = (low.min(c), high.max(c));
            }
        }
    }
    if low > 0.0 {
        return Err(POSITIVE);
    }
    if high < 0.0 {
        return Err(NEGATIVE);
    }
    // entries beyond the grid are never used
    let mut brick = vec![0.0; BRICK_SIDE * BRICK_SIDE * BRICK_SIDE];
    let held = [0, 1, 2].map(|a| first[a].saturating_sub(1)..(first[a] + BRICK_CELLS + 2).min(size[a]));
    for k in held[2].clone() {
        for j in held[1].clone() {
            let [i, j_to, k_to] = [held[0].start + 1 - first[0], j + 1 - first[1], k + 1 - first[2]];
            let row = &row(j, k)[held[0].clone()];
            brick[(k_to * BRICK_SIDE + j_to) * BRICK_SIDE + i..][..row.len()].copy_from_slice(row);
        }
    }
    Ok(brick)
}

impl BrickSpline {
    /// Creates the spline through the samples of an image.
    pub fn new(image: &Image<f32>) -> Self {
        let geometry = &image.geometry;
        let plane = geometry.size[0] * geometry.size[1];
        let fill = |k: usize, slice: &mut [f32]| slice.copy_from_slice(&image.data[k * plane..(k + 1) * plane]);
        let mut filter = SlabFilter::new(geometry.size);
        let mut builder = BrickSplineBuilder::new(geometry.clone());
        for layer in BrickSplineBuilder::layers(geometry) {
            let coefficients = filter.coefficients(layer.slices.clone(), fill);
            builder.add(&layer, |j, k| coefficients.row(j, k));
        }
        builder.finish()
    }

    /// Returns the grid.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Returns F and its gradient at a grid position (clamped to the volume). Inlined, so that it
    /// is compiled for the instruction set of the caller.
    #[inline(always)]
    pub fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        match self.brick(grid) {
            Ok((stencil, brick)) => stencil.value_gradient(brick, self.geometry.spacing),
            Err(sign) => (sign, DVec3::ZERO),
        }
    }

    /// Returns F, its gradient and its Hessian at a grid position (clamped to the volume).
    #[inline]
    pub fn jet(&self, grid: DVec3) -> Jet {
        match self.brick(grid) {
            Ok((stencil, brick)) => stencil.jet(brick, self.geometry.spacing),
            Err(sign) => Jet { value: sign, gradient: DVec3::ZERO, hessian: DMat3::ZERO },
        }
    }

    /// Returns the stencil of a position and the coefficients of the brick that contains it. If the
    /// brick is not stored, returns the sign of the spline as an error.
    #[inline(always)]
    fn brick(&self, grid: DVec3) -> Result<(Stencil, &[f32]), f64> {
        let stencil = Stencil::new(&self.geometry, grid);
        let at = stencil.cell().map(|n| n / BRICK_CELLS);
        let [nx, ny, _] = self.geometry.size.map(bricks_along);
        match self.number[(at[2] * ny + at[1]) * nx + at[0]] {
            NEGATIVE => Err(-1.0),
            POSITIVE => Err(1.0),
            number => {
                let volume = BRICK_SIDE * BRICK_SIDE * BRICK_SIDE;
                let brick = &self.coefficients[number as usize * volume..][..volume];
                Ok((stencil.within_block(at.map(|n| n * BRICK_CELLS), BRICK_SIDE), brick))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::CubicSpline;
    use super::*;

    #[test]
    fn near_the_zero_set_the_bricks_are_the_spline() {
        for size in [[70, 43, 61], [18, 17, 16], [4, 5, 3]] {
            let geometry = Geometry::axis_aligned(size, DVec3::new(0.7, 1.1, 0.9));
            let centre = 0.5 * geometry.upper_corner();
            let radius = 0.3 * centre.max_element();
            let node = |n: usize| {
                DVec3::new((n % size[0]) as f64, (n / size[0] % size[1]) as f64, (n / (size[0] * size[1])) as f64)
            };
            let value = |n: usize| ((geometry.index_to_grid(node(n)) - centre).length() - radius) as f32;
            let image = Image { data: (0..geometry.voxel_count()).map(value).collect(), geometry: geometry.clone() };
            let (whole, bricks) = (CubicSpline::new(&image), BrickSpline::new(&image));
            for n in 0..4000 {
                let place = |a: u64| crate::random::uniform(5, a, n);
                let p = DVec3::new(place(0), place(1), place(2)) * geometry.upper_corner();
                let (jet, found) = (whole.jet(p), bricks.jet(p));
                if jet.value.abs() < STORED_DISTANCE as f64 * 0.7 {
                    assert!((found.value - jet.value).abs() < 1e-5, "{size:?}: {found:?} {jet:?}");
                    assert!((found.gradient - jet.gradient).length() < 1e-5);
                    assert!((found.hessian - jet.hessian).to_cols_array().iter().all(|h| h.abs() < 1e-4));
                }
                assert_eq!(found.value < 0.0, jet.value < 0.0, "{size:?} at {p}");
                assert_eq!(found.value, bricks.value_gradient(p).0);
            }
        }
    }
}
