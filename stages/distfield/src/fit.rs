//! Pins the zero set of the spline through F on samples of the surface.
//!
//! The spline through exact distances rings where the distance has a kink within a voxel or two of the surface (thin parts,
//! noise), and its zero set moves. Here the spline coefficients are changed as little as possible (in the least-squares
//! sense) such that F vanishes at the samples: conjugate gradients on the normal equations (CGLS, Hestenes and
//! Stiefel 1952) from zero change, preconditioned by their diagonal and stopped early, which regularises.

use glam::DVec3;
use isoparticles_common::geometry::Geometry;
use isoparticles_common::image::Image;
use isoparticles_common::spline::CubicSpline;
use rayon::prelude::*;
use serde::Serialize;

/// Slices of spline coefficients whose samples one task gathers; the reach of a sample is three slices more, so that
/// every second task can run at the same time.
const SLAB: usize = 6;

/// Samples of one partial sum; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

/// One sample: 16 rows of four neighbouring coefficients and the weights along each axis.
struct Row {
    start: [u32; 16],
    weight: [[f32; 4]; 3],
}

/// The linear map from the coefficients near the surface to F at the samples.
struct Sampling {
    rows: Vec<Row>,
    /// Rows of each slab of slices, and where the coefficients start that the slab's samples touch.
    slabs: Vec<Slab>,
    unknowns: usize,
}

struct Slab {
    rows: std::ops::Range<usize>,
    unknowns: std::ops::Range<usize>,
}

/// What the fit did.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct FitReport {
    /// Root-mean-square of F at the samples before, in mm.
    pub before: f64,
    /// The same after.
    pub after: f64,
    /// Conjugate-gradient steps.
    pub steps: usize,
}

/// Changes the samples of `field` (mm, signed distance) near the surface so that the cubic spline through them vanishes at
/// `samples`, to a root-mean-square of `tolerance` mm, in at most `most_steps` steps.
pub fn pin_zero_set(field: &mut Image<f32>, samples: &[DVec3], tolerance: f64, most_steps: usize) -> FitReport {
    let geometry = field.geometry.clone();
    let (number, sampling) = build(&geometry, samples);
    if sampling.rows.is_empty() {
        return FitReport::default();
    }
    let spline = CubicSpline::new(field);
    let start = gather(&number, spline.coefficients(), sampling.unknowns);
    drop(spline);
    let mut residual = vec![0.0; sampling.rows.len()];
    sampling.apply(&start, &mut residual);
    drop(start);
    residual.par_iter_mut().for_each(|r| *r = -*r);
    let root_mean_square = |r: &[f64]| (dot(r, r) / r.len() as f64).sqrt();
    let before = root_mean_square(&residual);

    // Half diagonal, half identity: the diagonal alone would give coefficients that hardly touch the surface free rein.
    let mut scale = vec![0.0; sampling.unknowns];
    sampling.apply_transposed(&vec![1.0; residual.len()], &mut scale, true);
    let mean = scale.iter().sum::<f64>() / scale.len() as f64;
    scale.par_iter_mut().for_each(|s| *s = 1.0 / (*s + mean));

    let mut change = vec![0.0; sampling.unknowns];
    let mut gradient = vec![0.0; sampling.unknowns];
    sampling.apply_transposed(&residual, &mut gradient, false);
    let mut direction: Vec<f64> = gradient.par_iter().zip(&scale).map(|(g, s)| g * s).collect();
    let mut image = vec![0.0; residual.len()];
    let mut norm = dot(&gradient, &direction);
    let (mut after, mut steps) = (before, 0);
    while steps < most_steps && after > tolerance && norm > 0.0 {
        sampling.apply(&direction, &mut image);
        let alpha = norm / dot(&image, &image);
        add_scaled(&mut change, alpha, &direction);
        add_scaled(&mut residual, -alpha, &image);
        sampling.apply_transposed(&residual, &mut gradient, false);
        let next = weighted_norm(&gradient, &scale);
        let beta = next / norm;
        norm = next;
        direction.par_iter_mut().zip(&gradient).zip(&scale).for_each(|((d, g), s)| *d = g * s + beta * *d);
        after = root_mean_square(&residual);
        steps += 1;
    }
    add_change(field, &number, &change);
    FitReport { before, after, steps }
}

/// Numbers the coefficients that the samples touch (x fastest, `u32::MAX` elsewhere) and sorts the samples by cell.
fn build(geometry: &Geometry, samples: &[DVec3]) -> (Vec<u32>, Sampling) {
    let [nx, ny, nz] = geometry.size;
    let cell = |p: DVec3| -> Option<([usize; 3], DVec3)> {
        let index = geometry.grid_to_index(p);
        let base = index.floor();
        let inner = (0..3).all(|a| base[a] >= 1.0 && base[a] + 2.0 < geometry.size[a] as f64);
        inner.then(|| ([0, 1, 2].map(|a| base[a] as usize), index - base))
    };
    let mut cells: Vec<(usize, [usize; 3], DVec3)> =
        samples.par_iter().filter_map(|&p| cell(p).map(|(b, t)| (geometry.linear(b[0], b[1], b[2]), b, t))).collect();
    // stable, so that the order within a cell is that of the samples
    cells.par_sort_by_key(|&(at, ..)| at);

    let mut number = vec![u32::MAX; geometry.voxel_count()];
    let mut last = usize::MAX;
    for &(at, ..) in &cells {
        if at == last {
            continue;
        }
        last = at;
        for row in row_starts(at, nx, ny) {
            number[row..row + 4].fill(0);
        }
    }
    let mut unknowns = 0u32;
    let mut slice_start = Vec::with_capacity(nz + 1);
    for slice in number.chunks_mut(nx * ny) {
        slice_start.push(unknowns as usize);
        for n in slice.iter_mut().filter(|n| **n == 0) {
            *n = unknowns;
            unknowns += 1;
        }
    }
    slice_start.push(unknowns as usize);

    let slabs = (0..nz.div_ceil(SLAB))
        .map(|s| {
            let (first, end) = (s * SLAB, ((s + 1) * SLAB).min(nz));
            let from = cells.partition_point(|&(_, b, _)| b[2] < first);
            let to = cells.partition_point(|&(_, b, _)| b[2] < end);
            Slab { rows: from..to, unknowns: slice_start[first.saturating_sub(1)]..slice_start[(end + 2).min(nz)] }
        })
        .collect();
    let rows = cells
        .par_iter()
        .map(|&(at, _, t)| Row {
            start: row_starts(at, nx, ny).map(|n| number[n]),
            weight: [0, 1, 2].map(|a| weights(t[a])),
        })
        .collect();
    (number, Sampling { rows, slabs, unknowns: unknowns as usize })
}

/// First nodes of the 16 rows of four that the spline reads in the cell whose lowest node is `at`.
fn row_starts(at: usize, nx: usize, ny: usize) -> [usize; 16] {
    let corner = at - 1 - nx - nx * ny;
    std::array::from_fn(|n| corner + (n % 4) * nx + (n / 4) * nx * ny)
}

/// Cubic B-spline weights of the four coefficients round a cell.
fn weights(t: f64) -> [f32; 4] {
    let u = 1.0 - t;
    [
        u * u * u / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        t * t * t / 6.0,
    ]
    .map(|w| w as f32)
}

impl Sampling {
    /// F at the samples.
    fn apply(&self, coefficients: &[f64], values: &mut [f64]) {
        values.par_iter_mut().zip(&self.rows).for_each(|(value, row)| {
            let [wx, wy, wz] = row.weight.map(|w| w.map(f64::from));
            let mut sum = 0.0;
            for (n, &start) in row.start.iter().enumerate() {
                let c = &coefficients[start as usize..start as usize + 4];
                sum += wy[n % 4] * wz[n / 4] * (wx[0] * c[0] + wx[1] * c[1] + wx[2] * c[2] + wx[3] * c[3]);
            }
            *value = sum;
        });
    }

    /// The transpose of [`Sampling::apply`], or of the map with all entries squared; even slabs first, then odd ones, so that
    /// tasks never meet.
    fn apply_transposed(&self, values: &[f64], coefficients: &mut [f64], squared: bool) {
        coefficients.fill(0.0);
        for parity in 0..2 {
            let mut tasks = Vec::new();
            let (mut rest, mut done) = (&mut *coefficients, 0);
            for slab in self.slabs.iter().skip(parity).step_by(2) {
                let (_, after) = rest.split_at_mut(slab.unknowns.start - done);
                let (mine, after) = after.split_at_mut(slab.unknowns.len());
                tasks.push((slab, mine));
                rest = after;
                done = slab.unknowns.end;
            }
            tasks.into_par_iter().for_each(|(slab, mine)| {
                for (row, value) in self.rows[slab.rows.clone()].iter().zip(&values[slab.rows.clone()]) {
                    let entry = |w: f32| if squared { f64::from(w * w) } else { f64::from(w) };
                    let [wx, wy, wz] = row.weight.map(|w| w.map(entry));
                    for (n, &start) in row.start.iter().enumerate() {
                        let w = value * wy[n % 4] * wz[n / 4];
                        let at = start as usize - slab.unknowns.start;
                        for (c, wx) in mine[at..at + 4].iter_mut().zip(wx) {
                            *c += w * wx;
                        }
                    }
                }
            });
        }
    }
}

fn gather(number: &[u32], coefficients: &[f32], unknowns: usize) -> Vec<f64> {
    let mut compact = Vec::with_capacity(unknowns);
    compact.extend(
        number
            .iter()
            .zip(coefficients)
            .filter(|(n, _)| **n != u32::MAX)
            .map(|(_, &coefficient)| f64::from(coefficient)),
    );
    compact
}

/// Adds the values at the nodes of a change of spline coefficients.
fn add_change(field: &mut Image<f32>, number: &[u32], change: &[f64]) {
    let [nx, ny, nz] = field.geometry.size;
    let node_weight = |offset: isize| if offset == 0 { 4.0 / 6.0 } else { 1.0 / 6.0 };
    field.data.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slice)| {
        for near_k in k.saturating_sub(1)..(k + 2).min(nz) {
            let wz = node_weight(near_k as isize - k as isize);
            for near_j in 0..ny {
                let row = &number[(near_k * ny + near_j) * nx..][..nx];
                for (near_i, &n) in row.iter().enumerate() {
                    if n == u32::MAX {
                        continue;
                    }
                    let value = wz * change[n as usize];
                    for j in near_j.saturating_sub(1)..(near_j + 2).min(ny) {
                        let wy = node_weight(j as isize - near_j as isize);
                        for i in near_i.saturating_sub(1)..(near_i + 2).min(nx) {
                            let wx = node_weight(i as isize - near_i as isize);
                            slice[j * nx + i] += (value * wy * wx) as f32;
                        }
                    }
                }
            }
        }
    });
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    chunked_sum(a, b, |a, b| a * b)
}

/// Sum of squares, each times its weight.
fn weighted_norm(a: &[f64], weight: &[f64]) -> f64 {
    chunked_sum(a, weight, |a, w| a * a * w)
}

fn chunked_sum(a: &[f64], b: &[f64], term: impl Fn(f64, f64) -> f64 + Sync) -> f64 {
    let chunks = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK));
    let parts: Vec<f64> = chunks.map(|(a, b)| a.iter().zip(b).map(|(a, b)| term(*a, *b)).sum()).collect();
    parts.iter().sum()
}

fn add_scaled(to: &mut [f64], factor: f64, what: &[f64]) {
    to.par_iter_mut().zip(what).for_each(|(t, w)| *t += factor * w);
}
