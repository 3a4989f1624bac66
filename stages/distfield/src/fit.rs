//! Pins the zero set of F to samples of the surface.
//!
//! Where the distance has a kink within a voxel or two of the surface (thin parts, noise), the
//! spline through exact distances oscillates, which moves its zero set. This module changes the
//! spline coefficients as little as possible, in the least-squares sense, so that F vanishes at the
//! samples. It applies conjugate gradients to the normal equations (CGLS, Hestenes and Stiefel
//! 1952), starting from zero change, with damping and a diagonal preconditioner.
//!
//! Vectors use single precision, like F, because the residual stays well above the rounding error.
//! Sums over all samples use double precision.

use crate::bits::{Bits, Numbering};
use fearless_simd::{Level, Simd, dispatch, f32x4, f32x8, prelude::*};
use glam::DVec3;
use isoparticles_field::spline::SlabFilter;
use isoparticles_mesh::buckets::{parts_mut, ranges_mut};
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;

/// Number of slices of cells per parallel task. The samples of a task depend on three more slices
/// of coefficients, `2 * SLAB` in total, so every second task can run at the same time. With fewer
/// slices, these tasks would overlap; with more, a small volume would give too few tasks for all
/// threads.
const SLAB: usize = 3;

/// Number of slices of coefficients requested at a time from the prefilter, which computes at least
/// 8 Mi nodes at a time: 32 slices of 512^2 nodes, or more slices of a smaller grid.
const SLICES_AT_A_TIME: usize = 32;

/// Number of samples per partial sum. It is fixed so that sums do not depend on the number of
/// threads. A chunk takes 16 KiB, so the chunks of two vectors fit in a first-level cache.
const CHUNK: usize = 4096;

/// Weight of the squared change of the coefficients, relative to the mean diagonal entry of the
/// normal matrix of the samples.
///
/// Without damping, F shrinks towards zero where no spline vanishes at all samples, and it changes
/// sign in the corners of the volume. With a weight of 0, 0.001 and 0.002, the maximum distance
/// between the zero sets of F and of its source is 0.49, 0.041 and 0.026 voxel for an object in the
/// corners of a scan of 36^3 voxels. For `heart_ct` at iso value 250, the 99th percentile of this
/// distance is 0.049, 0.049 and 0.053 voxel.
const DAMPING: f64 = 0.001;

/// Ratio of the gradient norm to its initial value below which the fit stops, because further steps
/// hardly reduce the misfit. In the fits of `tests/labels.rs` that stop at this limit, the root
/// mean square of F at the samples is at most 2.3 times the tolerance. The values 0.0001 and 0.001
/// give the same fields for `heart_label`, `heart_ct` at iso value 250 and label 13 of
/// `frog_tissue_labels`. With 0.01, the mean shift of the zero set of `heart_ct` grows from 0.0044
/// to 0.0063 voxel (`make distfield`).
const GRADIENT_TOLERANCE: f64 = 0.001;

/// A voxel cell that contains samples.
struct Cell {
    /// Index of the first coefficient in each of the 16 rows of four coefficients that determine F
    /// in the cell.
    rows: [u32; 16],
    /// Index of the cell's first sample. The cell's samples end before the first sample of the next
    /// cell.
    first: u32,
}

/// The linear map from the coefficients near the surface to F at the samples.
struct Sampling {
    /// The weights of the four coefficients along each axis, for each sample. The samples are
    /// sorted by cell.
    weights: Vec<[[f32; 4]; 3]>,
    slabs: Vec<Slab>,
    unknowns: usize,
}

/// The cells, samples and coefficients of [`SLAB`] slices.
struct Slab {
    cells: Vec<Cell>,
    samples: Range<usize>,
    /// Range of the coefficients that the samples depend on.
    unknowns: Range<usize>,
}

impl Slab {
    /// Returns the cells with the ranges of their samples.
    fn cells(&self) -> impl Iterator<Item = (&Cell, Range<usize>)> {
        let ends = self.cells.iter().skip(1).map(|next| next.first as usize).chain([self.samples.end]);
        self.cells.iter().zip(ends).map(|(cell, end)| (cell, cell.first as usize..end))
    }
}

/// Report of the fit.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct FitReport {
    /// Root mean square of F at the samples before the fit, mm.
    pub before: f64,
    /// Root mean square after the fit, mm.
    pub after: f64,
    /// Number of conjugate-gradient steps.
    pub steps: usize,
}

/// Changes the values of `field` (signed distance, mm) near the surface so that the cubic spline
/// through them vanishes at `samples`. Stops when the root mean square of F at `samples` is at most
/// `tolerance` mm, when further steps would hardly reduce it (`GRADIENT_TOLERANCE`), or after
/// `most_steps` steps.
pub fn pin_zero_set(field: &mut Image<f32>, samples: Vec<DVec3>, tolerance: f64, most_steps: usize) -> FitReport {
    let number = touched_coefficients(&field.geometry, &samples);
    if number.count == 0 {
        return FitReport::default();
    }
    // run the filter before the samples are sorted, because it needs memory that the sorted samples
    // would occupy
    let start = gather(field, &number);
    let sampling = Sampling::new(&field.geometry, &samples, &number);
    drop(samples);
    let mut residual = vec![0.0; sampling.weights.len()];
    sampling.apply(&start, &mut residual);
    drop(start);
    residual.par_iter_mut().for_each(|r| *r = -*r);
    let root_mean_square = |r: &[f32]| (dot(r, r) / r.len() as f64).sqrt();
    let before = root_mean_square(&residual);

    // Preconditioner: the diagonal plus its mean. With the diagonal alone, coefficients that hardly
    // affect the samples could change freely.
    let mut scale = vec![0.0; sampling.unknowns];
    sampling.apply_transposed(&vec![1.0; residual.len()], &mut scale, true);
    let mean = (scale.iter().map(|&s| f64::from(s)).sum::<f64>() / scale.len() as f64) as f32;
    scale.par_iter_mut().for_each(|s| *s = 1.0 / (*s + mean));

    let damping = DAMPING * f64::from(mean);
    let mut change = vec![0.0; sampling.unknowns];
    let mut gradient = vec![0.0; sampling.unknowns];
    sampling.apply_transposed(&residual, &mut gradient, false);
    let mut direction: Vec<f32> = gradient.par_iter().zip(&scale).map(|(g, s)| g * s).collect();
    let mut image = vec![0.0; residual.len()];
    let mut norm = dot(&gradient, &direction);
    let (mut after, mut steps) = (before, 0);
    let solved = norm * GRADIENT_TOLERANCE * GRADIENT_TOLERANCE;
    while steps < most_steps && after > tolerance && norm > solved {
        sampling.apply(&direction, &mut image);
        let alpha = norm / (dot(&image, &image) + damping * dot(&direction, &direction));
        add_scaled(&mut change, alpha as f32, &direction);
        add_scaled(&mut residual, -alpha as f32, &image);
        sampling.apply_transposed(&residual, &mut gradient, false);
        add_scaled(&mut gradient, -damping as f32, &change);
        let next = weighted_norm(&gradient, &scale);
        let beta = (next / norm) as f32;
        norm = next;
        direction.par_iter_mut().zip(&gradient).zip(&scale).for_each(|((d, g), s)| *d = g * s + beta * *d);
        after = root_mean_square(&residual);
        steps += 1;
    }
    add_change(field, &number, &change);
    FitReport { before, after, steps }
}

/// Returns the lowest node of the cell that contains a sample, and the position of the sample
/// within the cell (0 to 1 along each axis). Returns `None` near the faces of the grid, where the
/// cell does not have four coefficients along each axis.
fn cell(geometry: &Geometry, sample: DVec3) -> Option<(usize, DVec3)> {
    let index = geometry.grid_to_index(sample);
    let base = index.floor();
    let inner = (0..3).all(|a| base[a] >= 1.0 && base[a] + 2.0 < geometry.size[a] as f64);
    inner.then(|| (geometry.linear(base.x as usize, base.y as usize, base.z as usize), index - base))
}

/// Assigns indices to the coefficients that the samples depend on.
fn touched_coefficients(geometry: &Geometry, samples: &[DVec3]) -> Numbering {
    let [nx, ny, _] = geometry.size;
    let corners = samples.par_chunks(CHUNK).map(|samples| {
        let mut corners: Vec<usize> =
            samples.iter().filter_map(|&p| cell(geometry, p)).map(|(at, _)| corner(at, nx, ny)).collect();
        // consecutive samples often lie in the same cell
        corners.dedup();
        corners
    });
    let mut touched = Bits::none(geometry.voxel_count());
    for corner in corners.collect::<Vec<_>>().into_iter().flatten() {
        touched.insert(corner..corner + 1);
    }
    // four coefficients along each axis; the corner is so far from the faces of the grid that no
    // step wraps into the next row or slice
    let four = |step: usize| [0, step, 2 * step, 3 * step];
    Numbering::new(touched.moved(four(1)).moved(four(nx)).moved(four(nx * ny)))
}

/// Returns the first node of the block of 4^3 coefficients that determine the spline in the cell
/// whose lowest node is `at`.
fn corner(at: usize, nx: usize, ny: usize) -> usize {
    at - 1 - nx - nx * ny
}

/// Returns the first nodes of the 16 rows of four coefficients that determine the spline in the
/// cell whose lowest node is `at`.
fn row_starts(at: usize, nx: usize, ny: usize) -> [usize; 16] {
    let corner = corner(at, nx, ny);
    std::array::from_fn(|n| corner + (n % 4) * nx + (n / 4) * nx * ny)
}

/// Returns the cubic B-spline weights of four consecutive coefficients at position t (0 to 1)
/// between the second and the third coefficient.
#[inline(always)]
fn weights_at(t: f32) -> [f32; 4] {
    let u = 1.0 - t;
    [
        u * u * u / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        t * t * t / 6.0,
    ]
}

impl Sampling {
    /// Sorts the samples by cell and computes their weights.
    fn new(geometry: &Geometry, samples: &[DVec3], number: &Numbering) -> Self {
        let [nx, ny, nz] = geometry.size;
        let mut order: Vec<(usize, u32)> = (0..samples.len())
            .into_par_iter()
            .filter_map(|n| cell(geometry, samples[n]).map(|(at, _)| (at, n as u32)))
            .collect();
        // within a cell, samples keep their order
        order.par_sort_unstable();
        let slices_before = |k: usize| number.number(k * nx * ny);
        let before = |k: usize| order.partition_point(|&(at, _)| at < k * nx * ny);
        let bounds: Vec<usize> = (0..=nz.div_ceil(SLAB)).map(|s| before((s * SLAB).min(nz))).collect();
        let mut weights = vec![[[0.0; 4]; 3]; order.len()];
        let parts = parts_mut(&mut weights, bounds.windows(2).map(|own| own[1] - own[0]));
        let slab = |(s, weights): (usize, &mut [[[f32; 4]; 3]])| {
            let own = &order[bounds[s]..bounds[s + 1]];
            for (weights, &(_, sample)) in weights.iter_mut().zip(own) {
                let offset = cell(geometry, samples[sample as usize]).map_or(DVec3::ZERO, |(_, offset)| offset);
                *weights = offset.as_vec3().to_array().map(weights_at);
            }
            let mut cells = Vec::with_capacity(own.chunk_by(|a, b| a.0 == b.0).count());
            let mut first = bounds[s];
            for same_cell in own.chunk_by(|a, b| a.0 == b.0) {
                let rows = row_starts(same_cell[0].0, nx, ny).map(|n| number.number(n) as u32);
                cells.push(Cell { rows, first: first as u32 });
                first += same_cell.len();
            }
            let unknowns = slices_before((s * SLAB).saturating_sub(1))..slices_before(((s + 1) * SLAB + 2).min(nz));
            Slab { cells, samples: bounds[s]..bounds[s + 1], unknowns }
        };
        let slabs = parts.into_par_iter().enumerate().map(slab).collect();
        Self { weights, slabs, unknowns: number.count }
    }

    /// Computes F at the samples from the coefficients.
    fn apply(&self, coefficients: &[f32], values: &mut [f32]) {
        let parts = parts_mut(values, self.slabs.iter().map(|slab| slab.samples.len()));
        let instructions = Level::new();
        self.slabs.par_iter().zip(parts).for_each(|(slab, mine)| {
            dispatch!(instructions, simd => self.apply_to_slab(simd, slab, coefficients, mine));
        });
    }

    /// Applies the map to one slab. Processes two samples at a time, each in half a register.
    #[inline(always)]
    fn apply_to_slab<S: Simd>(&self, simd: S, slab: &Slab, coefficients: &[f32], values: &mut [f32]) {
        for (cell, samples) in slab.cells() {
            let mut read = [f32x8::splat(simd, 0.0); 16];
            for (twofold, &row) in read.iter_mut().zip(&cell.rows) {
                *twofold = twice(simd, four(simd, &coefficients[row as usize..]));
            }
            let last = samples.end - 1;
            for sample in samples.step_by(2) {
                let other = (sample + 1).min(last);
                let ([wx, wy, wz], [other_wx, other_wy, other_wz]) = (&self.weights[sample], &self.weights[other]);
                let mut sum = f32x8::splat(simd, 0.0);
                for k in 0..4 {
                    let wz = splats(simd, wz[k], other_wz[k]);
                    for j in 0..4 {
                        sum += splats(simd, wy[j], other_wy[j]) * wz * read[4 * k + j];
                    }
                }
                let sums: [f32; 8] = *(sum * joined(simd, four(simd, wx), four(simd, other_wx)));
                values[sample - slab.samples.start] = (sums[0] + sums[1]) + (sums[2] + sums[3]);
                values[other - slab.samples.start] = (sums[4] + sums[5]) + (sums[6] + sums[7]);
            }
        }
    }

    /// Applies the transpose of the map. If `squared` is true, all entries of its matrix are
    /// squared. Processes the even slabs before the odd slabs, so that parallel tasks never write
    /// the same coefficient.
    fn apply_transposed(&self, values: &[f32], coefficients: &mut [f32], squared: bool) {
        coefficients.par_chunks_mut(CHUNK).for_each(|part| part.fill(0.0));
        for parity in 0..2 {
            let slabs: Vec<&Slab> = self.slabs.iter().skip(parity).step_by(2).collect();
            let ranges: Vec<Range<usize>> = slabs.iter().map(|slab| slab.unknowns.clone()).collect();
            let instructions = Level::new();
            slabs.into_par_iter().zip(ranges_mut(coefficients, &ranges)).for_each(|(slab, mine)| {
                dispatch!(instructions, simd => self.apply_transposed_to_slab(simd, slab, values, mine, squared));
            });
        }
    }

    #[inline(always)]
    fn apply_transposed_to_slab<S: Simd>(
        &self,
        simd: S,
        slab: &Slab,
        values: &[f32],
        coefficients: &mut [f32],
        squared: bool,
    ) {
        for (cell, samples) in slab.cells() {
            // two rows of coefficients per register
            let mut sums = [f32x8::splat(simd, 0.0); 8];
            for sample in samples {
                let [wx, wy, wz] = &self.weights[sample];
                let wy = [splats(simd, wy[0], wy[1]), splats(simd, wy[2], wy[3])];
                let mut along_x = four(simd, wx);
                if squared {
                    along_x *= along_x;
                }
                let row = twice(simd, along_x * values[sample]);
                for k in 0..4 {
                    for j in 0..2 {
                        let mut weight = wy[j] * wz[k];
                        if squared {
                            weight *= weight;
                        }
                        sums[2 * k + j] += weight * row;
                    }
                }
            }
            for (pair, sum) in cell.rows.as_chunks::<2>().0.iter().zip(sums) {
                let (low, high) = simd.split_f32x8(sum);
                for (&start, sum) in pair.iter().zip([low, high]) {
                    let at = start as usize - slab.unknowns.start;
                    let to = &mut coefficients[at..at + 4];
                    to.copy_from_slice(&*(four(simd, to) + sum));
                }
            }
        }
    }
}

/// Loads four numbers into a register. In this module, multiplications and additions are not fused
/// and every sum has a fixed order, so results have the same bits on any instruction set.
#[inline(always)]
fn four<S: Simd>(simd: S, from: &[f32]) -> f32x4<S> {
    f32x4::from_slice(simd, &from[..4])
}

#[inline(always)]
fn joined<S: Simd>(simd: S, low: f32x4<S>, high: f32x4<S>) -> f32x8<S> {
    simd.combine_f32x4(low, high)
}

#[inline(always)]
fn twice<S: Simd>(simd: S, own: f32x4<S>) -> f32x8<S> {
    joined(simd, own, own)
}

/// Fills the four low lanes of a register with one number and the four high lanes with another.
#[inline(always)]
fn splats<S: Simd>(simd: S, low: f32, high: f32) -> f32x8<S> {
    joined(simd, f32x4::splat(simd, low), f32x4::splat(simd, high))
}

/// Computes the spline coefficients of a field at the nodes in `number`.
fn gather(field: &Image<f32>, number: &Numbering) -> Vec<f32> {
    let [nx, ny, nz] = field.geometry.size;
    let plane = nx * ny;
    let fill = |k: usize, slice: &mut [f32]| slice.copy_from_slice(&field.data[k * plane..(k + 1) * plane]);
    let mut filter = SlabFilter::new(field.geometry.size);
    let mut compact = Vec::with_capacity(number.count);
    for first in (0..nz).step_by(SLICES_AT_A_TIME) {
        let coefficients = filter.coefficients(first..(first + SLICES_AT_A_TIME).min(nz), fill);
        for row in first * ny..(first + SLICES_AT_A_TIME).min(nz) * ny {
            let (values, start) = (coefficients.row(row % ny, row / ny), row * nx);
            number.each(start..start + nx, |node, _| compact.push(values[node - start]));
        }
    }
    compact
}

/// Adds to the field the node values of the spline whose coefficients are `change`.
fn add_change(field: &mut Image<f32>, number: &Numbering, change: &[f32]) {
    let [nx, ny, nz] = field.geometry.size;
    let node_weight = |offset: isize| if offset == 0 { 4.0 / 6.0 } else { 1.0 / 6.0 };
    field.data.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slice)| {
        for near_k in k.saturating_sub(1)..(k + 2).min(nz) {
            let wz = node_weight(near_k as isize - k as isize);
            let start = near_k * nx * ny;
            number.each(start..start + nx * ny, |node, n| {
                let (near_i, near_j) = ((node - start) % nx, (node - start) / nx);
                let value = wz * f64::from(change[n]);
                for j in near_j.saturating_sub(1)..(near_j + 2).min(ny) {
                    let wy = node_weight(j as isize - near_j as isize);
                    for i in near_i.saturating_sub(1)..(near_i + 2).min(nx) {
                        let wx = node_weight(i as isize - near_i as isize);
                        slice[j * nx + i] += (value * wy * wx) as f32;
                    }
                }
            });
        }
    });
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    chunked_sum(a, b, |a, b| a * b)
}

/// Returns the weighted sum of the squares of `a`.
fn weighted_norm(a: &[f32], weight: &[f32]) -> f64 {
    chunked_sum(a, weight, |a, w| a * a * w)
}

fn chunked_sum(a: &[f32], b: &[f32], term: impl Fn(f64, f64) -> f64 + Sync) -> f64 {
    let chunks = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK));
    let sum = |(a, b): (&[f32], &[f32])| -> f64 { a.iter().zip(b).map(|(a, b)| term((*a).into(), (*b).into())).sum() };
    let parts: Vec<f64> = chunks.map(sum).collect();
    parts.iter().sum()
}

fn add_scaled(to: &mut [f32], factor: f32, what: &[f32]) {
    to.par_iter_mut().zip(what).for_each(|(t, w)| *t += factor * w);
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;

    /// Returns the map for 500 samples in a grid of three slabs, with random coefficients and
    /// sample values.
    fn scene() -> (Sampling, Vec<f32>, Vec<f32>) {
        let geometry = Geometry::axis_aligned([9, 8, 9], DVec3::new(1.0, 0.5, 2.0));
        let random = |n: usize, k: u64| uniform(3, k, n as u64);
        let position = |n: usize| {
            DVec3::from_array(std::array::from_fn(|a| 1.0 + random(n, a as u64) * (geometry.size[a] as f64 - 3.0)))
        };
        let samples: Vec<DVec3> = (0..500).map(|n| geometry.index_to_grid(position(n))).collect();
        let sampling = Sampling::new(&geometry, &samples, &touched_coefficients(&geometry, &samples));
        assert_eq!((sampling.slabs.len(), sampling.weights.len()), (3, samples.len()));
        let numbers = |count: usize, k: u64| (0..count).map(|n| random(n, k) as f32 - 0.5).collect();
        let (coefficients, values) = (numbers(sampling.unknowns, 5), numbers(samples.len(), 6));
        (sampling, coefficients, values)
    }

    #[test]
    fn the_transpose_is_the_transpose() {
        let (sampling, coefficients, values) = scene();
        let (mut at_samples, mut back) = (vec![0.0; values.len()], vec![0.0; coefficients.len()]);
        sampling.apply(&coefficients, &mut at_samples);
        sampling.apply_transposed(&values, &mut back, false);
        let (one, other) = (dot(&at_samples, &values), dot(&coefficients, &back));
        assert!((one - other).abs() < 1e-4 * dot(&at_samples, &at_samples).sqrt(), "{one} {other}");
        // The weights of a sample sum to one. The sum of all squared weights agrees with a direct
        // sum.
        sampling.apply(&vec![1.0; coefficients.len()], &mut at_samples);
        assert!(at_samples.iter().all(|v| (v - 1.0).abs() < 1e-5));
        sampling.apply_transposed(&vec![1.0; values.len()], &mut back, true);
        let of = |w: &[f32; 4]| w.iter().map(|w| f64::from(w * w)).sum::<f64>();
        let squares: f64 = sampling.weights.iter().map(|[x, y, z]| of(x) * of(y) * of(z)).sum();
        let found: f64 = back.iter().map(|&w| f64::from(w)).sum();
        assert!((found / squares - 1.0).abs() < 1e-5, "{found} {squares}");
    }

    #[test]
    fn simd_lanes_give_the_same_bits_at_every_level() {
        let (sampling, coefficients, values) = scene();
        let by = |level: Level| {
            let (mut at_samples, mut back) = (vec![0.0; values.len()], vec![0.0; coefficients.len()]);
            for slab in &sampling.slabs {
                let (at_own, own) = (&mut at_samples[slab.samples.clone()], &mut back[slab.unknowns.clone()]);
                dispatch!(level, simd => sampling.apply_to_slab(simd, slab, &coefficients, at_own));
                dispatch!(level, simd => sampling.apply_transposed_to_slab(simd, slab, &values, own, false));
            }
            (at_samples, back)
        };
        assert_eq!(by(Level::new()), by(Level::baseline()));
    }
}
