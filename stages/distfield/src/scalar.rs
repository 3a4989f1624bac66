//! Scalar volumes: the surface is the zero set of the input's own interpolating cubic B-spline minus the iso value.

use crate::cap::BorderBox;
use crate::field::{Redistanced, Source, redistance};
use crate::{Border, Inside, Keep};
use glam::DVec3;
use isoparticles_common::cli::Context;
use isoparticles_common::error::{Error, Result};
use isoparticles_common::image::Image;
use isoparticles_common::spline::CubicSpline;
use rayon::prelude::*;

/// Least |F| at a node, in voxels: what a sample equal to the iso value is pushed outwards by.
const CLEARANCE: f64 = 1e-3;

/// How an isosurface becomes F.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarOptions {
    /// Side of the iso value that the object is on.
    pub inside: Inside,
    /// What happens at the border of the volume.
    pub border: Border,
    /// Voxels added on each face.
    pub margin: usize,
    /// Parts of the object to keep.
    pub keep: Keep,
}

/// F of a scalar volume: zero where the spline through `image` equals `iso`, on the padded grid. The image is taken over, so that its memory
/// is free again when the distances are made.
///
/// # Errors
/// When the volume holds NaN or infinite voxels, is constant, or the iso value is outside its range; when no part is to stay.
pub fn from_scalar(image: Image<f32>, iso: f64, options: &ScalarOptions, context: &Context) -> Result<Redistanced> {
    check_values(&image)?;
    check_iso(&image, iso)?;
    let step = context.step("input spline");
    let source = source(image, iso, options.inside, options.border, options.margin);
    let least = (CLEARANCE * source.nodes.geometry.min_spacing()) as f32;
    drop(step);
    redistance(&source, |_| least, options.keep, context)
}

/// Refuses volumes with voxels that are not numbers.
pub fn check_values(image: &Image<f32>) -> Result<()> {
    let bad = image.data.par_iter().filter(|v| !v.is_finite()).count();
    if bad == 0 {
        return Ok(());
    }
    let first = image.data.iter().position(|v| !v.is_finite()).unwrap_or(0);
    let [nx, ny, _] = image.geometry.size;
    Err(Error::input(
        format!(
            "{bad} voxels are NaN or infinite, the first at index ({}, {}, {})",
            first % nx,
            first / nx % ny,
            first / (nx * ny)
        ),
        "a surface cannot be interpolated through them",
        "replace them in the input, for instance by the value of the background",
    ))
}

fn check_iso(image: &Image<f32>, iso: f64) -> Result<()> {
    let (low, high) = image
        .data
        .par_iter()
        .map(|&v| (v, v))
        .reduce(|| (f32::INFINITY, f32::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    if low == high {
        return Err(Error::input(
            format!("every voxel has the value {low}"),
            "a constant volume has no isosurface",
            "check that this is the volume you meant",
        ));
    }
    if iso.is_finite() && f64::from(low) < iso && iso < f64::from(high) {
        return Ok(());
    }
    Err(Error::input(
        format!("no voxel crosses iso value {iso}: the volume ranges from {low} to {high}"),
        "the isosurface would be empty",
        format!("choose --iso between {low} and {high}"),
    ))
}

/// The implicit function of a scalar volume on the padded grid.
fn source(mut image: Image<f32>, iso: f64, inside: Inside, border: Border, margin: usize) -> Source {
    let sign = match inside {
        Inside::Above => -1.0,
        Inside::Below => 1.0,
    };
    image.data.par_iter_mut().for_each(|v| *v = (sign * (f64::from(*v) - iso)) as f32);
    let signed = image;
    let spline = CubicSpline::new(&signed);
    let padded = signed.geometry.padded(margin);
    // The spline's own mirror boundary gives the first coefficient beyond the border, and constant ones after it continue the
    // surface straight: between voxel centres the padded spline is the input's to the bit.
    let coefficients = pad(spline.coefficients(), signed.geometry.size, margin, |i, n| {
        let last = n as isize - 1;
        let nearest = if i < 0 {
            1
        } else if i > last {
            last - 1
        } else {
            i
        };
        nearest.clamp(0, last) as usize
    });
    let spline = CubicSpline::from_coefficients(padded.clone(), coefficients);
    let mut nodes = Image { geometry: padded.clone(), data: vec![0.0f32; padded.voxel_count()] };
    let [nx, ny, nz] = signed.geometry.size;
    let [px, py, _] = padded.size;
    nodes.data.par_chunks_mut(px).enumerate().for_each(|(row, values)| {
        let (j, k) = (row % py, row / py);
        let within = (margin..margin + ny).contains(&j) && (margin..margin + nz).contains(&k);
        if within {
            let from = signed.geometry.linear(0, j - margin, k - margin);
            values[margin..margin + nx].copy_from_slice(&signed.data[from..from + nx]);
        }
        for (i, value) in values.iter_mut().enumerate() {
            if !within || !(margin..margin + nx).contains(&i) {
                *value = spline.value(padded.index_to_grid(DVec3::new(i as f64, j as f64, k as f64))) as f32;
            }
        }
    });
    let cap = (border == Border::Cap).then(|| BorderBox::new(&padded, margin));
    Source { nodes, spline, cap }
}

/// Values on the padded grid, each axis continued by `from` (padded index minus margin, size -> index).
pub(crate) fn pad<T: Copy + Send + Sync>(
    data: &[T],
    size: [usize; 3],
    margin: usize,
    from: impl Fn(isize, usize) -> usize + Sync,
) -> Vec<T> {
    let [nx, ny, nz] = size;
    let take =
        |n: usize| -> Vec<usize> { (0..n + 2 * margin).map(|i| from(i as isize - margin as isize, n)).collect() };
    let (xs, ys, zs) = (take(nx), take(ny), take(nz));
    let rows: Vec<(usize, usize)> = zs.iter().flat_map(|&k| ys.iter().map(move |&j| (j, k))).collect();
    rows.par_iter().flat_map_iter(|&(j, k)| xs.iter().map(move |&i| data[(k * ny + j) * nx + i])).collect()
}
