//! The recursive prefilter that computes spline coefficients from samples, for a whole image or
//! slab by slab.

use super::stencil::mirror;
use rayon::prelude::*;
use std::collections::VecDeque;
use std::ops::Range;

/// Pole of the cubic B-spline prefilter: sqrt(3) - 2.
const POLE: f64 = -0.267_949_192_431_122_7;

/// Number of slices beyond a slab that contribute to its coefficients. Slices farther away have
/// weights below (2 - sqrt(3))^16 = 7e-10, less than single precision resolves.
const HALO: usize = 16;

/// Minimum number of nodes whose coefficients are computed together. Their coefficients take 32
/// MiB. Smaller images are filtered as a whole.
const NODES_AT_A_TIME: usize = 8 << 20;

/// Number of rows along x that are filtered together. Within a row, each sample depends on the
/// previous one, but the eight recursions are independent and run in parallel. Eight samples, one
/// from each row, fill a cache line of 64 bytes.
const ROWS_AT_A_TIME: usize = 8;

/// Prefilters an image slice by slice and returns the coefficients of a few slices at a time, so
/// that the coefficients of a large image are never all in memory. They equal the coefficients of
/// [`super::CubicSpline`] up to single-precision rounding, for any number of threads.
pub struct SlabFilter {
    size: [usize; 3],
    /// Slices that are already filtered along x and y, starting at slice `first`.
    slices: VecDeque<Vec<f32>>,
    first: usize,
    held: Coefficients,
}

/// The coefficients of consecutive slices.
pub struct Coefficients {
    /// The range of slices.
    slices: Range<usize>,
    /// One plane per y index, with x fastest, then z.
    planes: Vec<Vec<f32>>,
    nx: usize,
}

impl Coefficients {
    /// Returns the coefficients along x at y index `j` and z index `k`.
    pub fn row(&self, j: usize, k: usize) -> &[f32] {
        &self.planes[j][(k - self.slices.start) * self.nx..][..self.nx]
    }
}

impl SlabFilter {
    /// Creates a filter for an image of `size` nodes.
    pub fn new(size: [usize; 3]) -> Self {
        let held = Coefficients { slices: 0..0, planes: Vec::new(), nx: size[0] };
        Self { size, slices: VecDeque::new(), first: 0, held }
    }

    /// Returns the coefficients of at least the slices in `range`. Successive ranges must be in
    /// ascending order of their starts. `fill` writes the samples of one slice (x fastest). It is
    /// called at most once per slice. Each call of this function fills only slices after those that
    /// were filled before.
    pub fn coefficients(&mut self, range: Range<usize>, fill: impl Fn(usize, &mut [f32]) + Sync) -> &Coefficients {
        if self.held.slices.start > range.start || self.held.slices.end < range.end {
            let [nx, ny, nz] = self.size;
            let end = range.end.max(range.start + NODES_AT_A_TIME / (nx * ny)).min(nz);
            self.make(range.start..end, fill);
        }
        &self.held
    }

    fn make(&mut self, range: Range<usize>, fill: impl Fn(usize, &mut [f32]) + Sync) {
        let [nx, ny, nz] = self.size;
        self.held.planes = Vec::new();
        let (low, high) = (range.start.saturating_sub(HALO), (range.end + HALO).min(nz));
        assert!(low >= self.first, "slabs in ascending order");
        let passed = (low - self.first).min(self.slices.len());
        self.slices.drain(..passed);
        self.first = low;
        let next: Vec<Vec<f32>> = (low + self.slices.len()..high)
            .into_par_iter()
            .map_init(
                || vec![0.0f64; nx * ny],
                |scratch, k| {
                    let mut slice = vec![0.0f32; nx * ny];
                    fill(k, &mut slice);
                    filter_slice(&mut slice, nx, ny, scratch);
                    slice
                },
            )
            .collect();
        self.slices.extend(next);
        let slices: Vec<&[f32]> = self.slices.iter().map(Vec::as_slice).collect();
        self.held.planes = filter_across(&slices, nx, range.start - low..range.end - low);
        self.held.slices = range;
    }
}

/// Prefilters a slice along x and then along y.
pub(super) fn filter_slice(slice: &mut [f32], nx: usize, ny: usize, scratch: &mut [f64]) {
    for rows in slice.chunks_mut(nx * ROWS_AT_A_TIME) {
        let width = rows.len() / nx;
        let lines = &mut scratch[..rows.len()];
        for (x, row) in rows.chunks(nx).enumerate() {
            row.iter().zip(lines[x..].iter_mut().step_by(width)).for_each(|(from, to)| *to = 6.0 * f64::from(*from));
        }
        filter_lines(lines, width, nx);
        for (x, row) in rows.chunks_mut(nx).enumerate() {
            row.iter_mut().zip(lines[x..].iter().step_by(width)).for_each(|(to, from)| *to = *from as f32);
        }
    }
    filter_block(slice, nx, ny, scratch);
}

/// Prefilters across slices. Returns the slices in `range` as one plane per y index (x fastest,
/// then z).
pub(super) fn filter_across(slices: &[&[f32]], nx: usize, range: Range<usize>) -> Vec<Vec<f32>> {
    let (nz, ny) = (slices.len(), slices[0].len() / nx);
    let filter = |(plane, scratch): &mut (Vec<f32>, Vec<f64>), j: usize| {
        plane.clear();
        for slice in slices {
            plane.extend_from_slice(&slice[j * nx..(j + 1) * nx]);
        }
        filter_block(plane, nx, nz, scratch);
        plane[range.start * nx..range.end * nx].to_vec()
    };
    let room = || (Vec::with_capacity(nx * nz), vec![0.0f64; nx * nz]);
    (0..ny).into_par_iter().map_init(room, filter).collect()
}

/// Copies planes of constant y into slices of constant z.
pub(super) fn scatter(planes: &[Vec<f32>], nx: usize, to: &mut [f32]) {
    to.par_chunks_mut(nx * planes.len()).enumerate().for_each(|(k, slice)| {
        for (row, plane) in slice.chunks_mut(nx).zip(planes) {
            row.copy_from_slice(&plane[k * nx..(k + 1) * nx]);
        }
    });
}

/// Prefilters `width` lines of `length` samples that are stored side by side: consecutive samples
/// of a line are `width` apart.
fn filter_block(block: &mut [f32], width: usize, length: usize, scratch: &mut [f64]) {
    for (to, from) in scratch.iter_mut().zip(block.iter()) {
        *to = 6.0 * f64::from(*from);
    }
    filter_lines(scratch, width, length);
    for (to, from) in block.iter_mut().zip(scratch.iter()) {
        *to = *from as f32;
    }
}

/// Prefilters lines like [`filter_block`], but in place, for samples that are already multiplied by
/// six.
fn filter_lines(scratch: &mut [f64], width: usize, length: usize) {
    if length < 2 {
        scratch.iter_mut().for_each(|sample| *sample /= 6.0);
        return;
    }
    // the first value of the causal filter is a geometric sum over the mirrored samples, truncated
    // at the weight POLE^30 = 7e-18, which is below 2^-53
    let horizon = 30.min(length);
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
