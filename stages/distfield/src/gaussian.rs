//! Smooths an image by a Gaussian, with mirrored values beyond the faces of the grid. The computing
//! time does not depend on the width of the Gaussian.
//!
//! Along each axis, a box filter of fractional width is applied `BOXES` times (Gwosdek, Grewenig,
//! Bruhn and Weickert, "Theoretical foundations of Gaussian convolution by extended box filtering",
//! 2011). Together, these filters have exactly the variance of the Gaussian. The mirror planes lie
//! half a voxel beyond the outermost voxel centres. Mirroring preserves constants and does not tilt
//! surfaces that are perpendicular to a face.

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

/// Number of box filters per Gaussian. With four, a step from 0 to 1 that is smoothed by the boxes
/// deviates by at most 0.007 from the same step smoothed by a Gaussian
/// (`four_boxes_are_nearly_a_gaussian`).
const BOXES: usize = 4;
const _: () = assert!(BOXES.is_multiple_of(2), "each box swaps a line and its room: the result would be in the room");

/// Number of columns smoothed together, one per SIMD lane. Sixteen single-precision values of a row
/// fill a cache line of 64 bytes.
const LANES: usize = 16;

/// Number of rows along the second axis per parallel task when smoothing along the third axis.
/// Fewer rows give more tasks on small grids. The result does not depend on this number.
const ROWS: usize = 4;

/// A box filter with weight `middle` for the sample itself and for `reach` samples on each side,
/// and weight `end` for the next sample on each side.
#[derive(Clone, Copy, Debug)]
struct ExtendedBox {
    reach: usize,
    middle: f64,
    end: f64,
}

impl ExtendedBox {
    /// Returns the box filter whose [`BOXES`]-fold application has the variance of a Gaussian with
    /// standard deviation `sigma`, in voxels.
    fn new(sigma: f64) -> Self {
        let variance = sigma * sigma / BOXES as f64;
        let reach = (0.5 * ((12.0 * variance + 1.0).sqrt() - 1.0)).floor().max(0.0);
        let whole = 2.0 * reach + 1.0;
        let share = whole * (reach * (reach + 1.0) - 3.0 * variance) / (6.0 * (variance - (reach + 1.0).powi(2)));
        let length = whole + 2.0 * share;
        Self { reach: reach as usize, middle: 1.0 / length, end: share / length }
    }
}

/// [`LANES`] columns side by side.
type Line = Vec<[f64; LANES]>;

/// Smooths the columns in `line` with the widest SIMD instructions available; `room` is workspace.
/// Multiplications and additions are not fused, so the result is the same on every instruction set.
///
/// The result is zero wherever all values within reach of the filters are zero, so only the other
/// parts of a line are processed. These parts are short if the nonzero values form a band around a
/// surface.
fn smooth_lines(line: &mut Line, room: &mut Line, kernel: ExtendedBox) {
    let reach = BOXES * (kernel.reach + 1);
    let is_zero = |at: &[f64; LANES]| at.iter().all(|&value| value == 0.0);
    let mut from = 0;
    while let Some(first) = line[from..].iter().position(|at| !is_zero(at)) {
        let first = from + first;
        let mut end = first + 1;
        // extend up to the first gap that is so wide that the smoothed values on its two sides do
        // not overlap
        while let Some(next) = line[end..].iter().take(2 * reach).position(|at| !is_zero(at)) {
            end += next + 1;
        }
        let stretch = first.saturating_sub(reach)..(end + reach).min(line.len());
        let (own, room) = (&mut line[stretch.clone()], &mut room[stretch.clone()]);
        dispatch!(Level::new(), _simd => smooth_side_by_side(own, room, kernel));
        from = stretch.end;
    }
}

#[inline(always)]
fn smooth_side_by_side<'a>(mut line: &'a mut [[f64; LANES]], mut room: &'a mut [[f64; LANES]], kernel: ExtendedBox) {
    let n = line.len() as isize;
    let mirrored = |at: isize| {
        if (0..n).contains(&at) {
            return at as usize;
        }
        let around = at.rem_euclid(2 * n);
        (if around < n { around } else { 2 * n - 1 - around }) as usize
    };
    let reach = kernel.reach as isize;
    for _ in 0..BOXES {
        let mut sum = [0.0; LANES];
        for at in -reach..=reach {
            let from = line[mirrored(at)];
            sum.iter_mut().zip(from).for_each(|(sum, value)| *sum += value);
        }
        for at in 0..n {
            let (before, after) = (line[mirrored(at - reach - 1)], line[mirrored(at + reach + 1)]);
            let leaves = line[mirrored(at - reach)];
            let to = &mut room[at as usize];
            for lane in 0..LANES {
                to[lane] = kernel.middle * sum[lane] + kernel.end * (before[lane] + after[lane]);
                sum[lane] += after[lane] - leaves[lane];
            }
        }
        std::mem::swap(&mut line, &mut room);
    }
}

/// Smooths across rows: line i consists of entry i of each row.
fn smooth_across(rows: &mut [&mut [f32]], kernel: ExtendedBox) {
    let width = rows.first().map_or(0, |row| row.len());
    let (mut line, mut room) = (vec![[0.0; LANES]; rows.len()], vec![[0.0; LANES]; rows.len()]);
    for first in (0..width).step_by(LANES) {
        let columns = first..(first + LANES).min(width);
        for (to, row) in line.iter_mut().zip(rows.iter()) {
            to.iter_mut().zip(&row[columns.clone()]).for_each(|(to, &value)| *to = f64::from(value));
        }
        smooth_lines(&mut line, &mut room, kernel);
        for (from, row) in line.iter().zip(rows.iter_mut()) {
            row[columns.clone()].iter_mut().zip(from).for_each(|(to, &value)| *to = value as f32);
        }
    }
}

/// Smooths up to [`LANES`] rows, each along its length.
fn smooth_along(rows: &mut [f32], length: usize, kernel: ExtendedBox) {
    let (mut line, mut room) = (vec![[0.0; LANES]; length], vec![[0.0; LANES]; length]);
    for (lane, row) in rows.chunks(length).enumerate() {
        line.iter_mut().zip(row).for_each(|(to, &value)| to[lane] = f64::from(value));
    }
    smooth_lines(&mut line, &mut room, kernel);
    for (lane, row) in rows.chunks_mut(length).enumerate() {
        row.iter_mut().zip(&line).for_each(|(to, from)| *to = from[lane] as f32);
    }
}

/// Smooths values on a grid (x fastest) by a Gaussian with standard deviations `sigma` along the
/// axes, in voxels. The result does not depend on the number of threads.
pub fn smooth(data: &mut [f32], size: [usize; 3], sigma: [f64; 3]) {
    let [nx, ny, _] = size;
    let kernels = sigma.map(ExtendedBox::new);
    data.par_chunks_mut(nx * LANES).for_each(|rows| smooth_along(rows, nx, kernels[0]));
    data.par_chunks_mut(nx * ny).for_each(|slice| {
        let mut rows: Vec<&mut [f32]> = slice.chunks_mut(nx).collect();
        smooth_across(&mut rows, kernels[1]);
    });
    let mut tasks: Vec<Vec<&mut [f32]>> = (0..ny.div_ceil(ROWS)).map(|_| Vec::new()).collect();
    for slice in data.chunks_mut(nx * ny) {
        tasks.iter_mut().zip(slice.chunks_mut(nx * ROWS)).for_each(|(task, rows)| task.push(rows));
    }
    tasks.into_par_iter().for_each(|mut rows| smooth_across(&mut rows, kernels[2]));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Smooths a single voxel of value 1. Returns the standard deviations of the result along the
    /// axes, and the sum of the result.
    fn spread(size: [usize; 3], sigma: [f64; 3]) -> ([f64; 3], f64) {
        let mut data = vec![0.0; size.iter().product()];
        let centre = size.map(|n| n / 2);
        data[(centre[2] * size[1] + centre[1]) * size[0] + centre[0]] = 1.0;
        smooth(&mut data, size, sigma);
        let mut squares = [0.0; 3];
        for (n, &value) in data.iter().enumerate() {
            let at = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
            for axis in 0..3 {
                squares[axis] += f64::from(value) * (at[axis] as f64 - centre[axis] as f64).powi(2);
            }
        }
        (squares.map(f64::sqrt), data.iter().map(|&value| f64::from(value)).sum())
    }

    #[test]
    fn the_variance_is_sigma_squared() {
        for sigma in [[0.3, 0.7, 1.0], [1.5, 2.9, 4.2]] {
            let (found, sum) = spread([41, 43, 47], sigma);
            for axis in 0..3 {
                assert!((found[axis] - sigma[axis]).abs() < 1e-4, "{found:?}, not {sigma:?}");
            }
            assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        }
    }

    #[test]
    fn four_boxes_are_nearly_a_gaussian() {
        let (size, sigma) = ([121, 1, 1], 6.0);
        let mut data: Vec<f32> = (0..121).map(|n| if n >= 60 { 1.0 } else { 0.0 }).collect();
        smooth(&mut data, size, [sigma; 3]);
        // integral of the Gaussian, by the midpoint rule
        let density = |x: f64| (-0.5 * (x / sigma).powi(2)).exp() / (sigma * std::f64::consts::TAU.sqrt());
        let mut integral = 0.0;
        let mut worst = 0.0f64;
        let steps = 100;
        for (n, &value) in data.iter().enumerate() {
            worst = worst.max((f64::from(value) - integral).abs());
            for step in 0..steps {
                integral += density(n as f64 - 59.5 + (f64::from(step) + 0.5) / f64::from(steps)) / f64::from(steps);
            }
        }
        assert!(worst < 0.0075, "{worst}");
    }

    #[test]
    fn stretches_of_zeros_change_nothing() {
        for (sigma, gaps) in [(0.4, 3), (2.0, 7), (2.0, 40), (6.0, 90)] {
            let kernel = ExtendedBox::new(sigma);
            let mut line: Line = vec![[0.0; LANES]; 211];
            // each nonzero value is in a single lane; some are at the border, some are adjacent,
            // and some are within or beyond reach of each other
            for (n, at) in [0, 1, gaps, 2 * gaps + 1, 209 - gaps, 205].into_iter().enumerate() {
                line[at][n % LANES] = 1.0 + n as f64;
            }
            let mut whole = line.clone();
            let (mut room, mut other_room) = (line.clone(), line.clone());
            smooth_lines(&mut line, &mut room, kernel);
            smooth_side_by_side(&mut whole, &mut other_room, kernel);
            let pairs = line.as_flattened().iter().zip(whole.as_flattened());
            assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 1e-13), "{sigma} {gaps}");
            assert!(pairs.filter(|(a, _)| **a > 1e-6).count() > 20);
        }
    }

    #[test]
    fn smoothing_keeps_constants_on_lines_of_any_length() {
        for size in [[7, 1, 3], [40, 5, 33]] {
            let mut data = vec![2.5; size.iter().product()];
            smooth(&mut data, size, [3.0, 9.0, 0.4]);
            assert!(data.iter().all(|value| (value - 2.5).abs() < 1e-5));
        }
        // after smoothing, a step along x is still independent of y and z
        let size = [24, 6, 5];
        let mut data: Vec<f32> = (0..720).map(|n| if n % 24 < 11 { 1.0 } else { 0.0 }).collect();
        smooth(&mut data, size, [2.0; 3]);
        assert!(data.chunks(24).all(|row| row.iter().zip(&data[..24]).all(|(a, b)| (a - b).abs() < 1e-6)));
    }
}
