//! Label maps: the smoothest surface that keeps every voxel centre on its side (Whitaker 2000, reference 19 of the paper).
//!
//! A clamped fourth-order flow (bi-Laplacian of the distance) smooths the staircase; after each step every node is held
//! on its side of zero by its clearance. Curvature flow (second order) would pull the surface onto the innermost place that the
//! clamp allows.
//!
//! Who wants it smoother than the voxels allow gives a tightening radius (the paper's program opens and closes by one): nodes nearer to
//! the staircase than that may change sides.

use crate::closest::distance_to_samples;
use crate::field::{Redistanced, Source, redistance};
use crate::junctions::{Bound, junctions, plain_choices};
use crate::keep::{Dropped, drop_parts};
use crate::scalar::pad;
use crate::topology::Parts;
use crate::{Border, Clearance, Keep};
use glam::DVec3;
use isoparticles_common::cli::Context;
use isoparticles_common::error::{Error, Result};
use isoparticles_common::image::Image;
use isoparticles_common::marching_cubes::marching_cubes;
use isoparticles_common::spline::BrickSpline;
use rayon::prelude::*;

/// Half-width of the band that the flow acts in, in voxels. Beyond it the distance of the binary image stays: a band
/// that ends in clipped, constant values instead makes balls shrink.
const BAND: f64 = 5.0;

/// Step of the flow; above 2/144 (the largest eigenvalue of the squared seven-point Laplacian is 144) it is unstable.
const STEP: f32 = 1.8 / 144.0;

/// Distance of the surface from the voxel centres that are joined where two parts touch along an edge, in voxels.
const JUNCTION_DISTANCE: f64 = 0.45;

/// Least |F| at a node that may leave its side, in voxels.
const SMALLEST_CLEARANCE: f32 = 1e-3;

/// Steps of the flow after those distances have been imposed.
const JUNCTION_STEPS: usize = 20;

/// How labels become a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelOptions {
    /// What happens at the border of the volume.
    pub border: Border,
    /// Voxels added on each face.
    pub margin: usize,
    /// Least distance of the surface from voxel centres.
    pub clearance: Clearance,
    /// Steps of the flow; 0 leaves the staircase.
    pub smoothing_steps: usize,
    /// How far the surface may leave the staircase of the voxels (voxels, smallest spacing), centres of voxels or not; 0 keeps every
    /// voxel centre on its side.
    pub tightening: f64,
    /// Parts of the object to keep.
    pub keep: Keep,
}

/// F of the union of some labels: `inside` is true at their voxels.
///
/// # Errors
/// When no voxel is inside, or with an open border all are, also after tightening, or when the run is interrupted.
pub fn from_labels(inside: &Image<bool>, options: &LabelOptions, context: &Context) -> Result<Redistanced> {
    let step = context.step("binary distance");
    let mut mask = padded_mask(inside, options.border, options.margin);
    if !mask.data.contains(&true) || !mask.data.contains(&false) {
        return Err(Error::input(
            "the chosen labels cover no voxel, or every voxel with an open border",
            "there is no surface between inside and outside",
            "choose other labels, or --border cap",
        ));
    }
    let mut least = least_distances(&mask, options.clearance);
    let mut binary = binary_distance(&mask);
    let mut untightened = None;
    if options.tightening > 0.0 {
        let (dropped, parts) = parts_untightened(&mut mask, binary.clone(), &least, options, context)?;
        if !dropped.nodes.is_empty() {
            least = least_distances(&mask, options.clearance);
            binary = binary_distance(&mask);
        }
        untightened = Some((dropped, parts));
    }
    relax(&mut least, &binary, options.tightening);
    hold(&mut binary, &mask, &least);
    drop(step);
    let step = context.step("smoothing");
    let flowed = smooth(binary, &mask, &least, &[], options.smoothing_steps, context)?;
    let voxel = mask.geometry.min_spacing();
    let (near, far) = ((options.clearance.usual * voxel) as f32, (JUNCTION_DISTANCE * voxel) as f32);
    let bounds = plain_choices(&junctions(&flowed), &least, near, far);
    let nodes = smooth(flowed, &mask, &least, &bounds, options.smoothing_steps.min(JUNCTION_STEPS), context)?;
    for bound in &bounds {
        least[bound.node] = bound.least;
    }
    if nodes.data.par_iter().all(|f| *f >= 0.0) {
        return Err(Error::input(
            format!("tightening by {} voxels leaves nothing of the object", options.tightening),
            "parts thinner than twice that radius may vanish, and all are",
            "choose a smaller --tightening; 0 keeps every voxel",
        ));
    }
    if nodes.data.par_iter().all(|f| *f < 0.0) {
        return Err(Error::input(
            format!("tightening by {} voxels closes every gap in the object", options.tightening),
            "gaps thinner than twice that radius may vanish, and all do: no surface is left",
            "choose a smaller --tightening; 0 keeps every voxel",
        ));
    }
    let source = Source { spline: BrickSpline::new(&nodes), cap: None };
    drop(step);
    let smallest = SMALLEST_CLEARANCE * voxel as f32;
    let mut result = redistance(nodes, &source, |n| least[n].max(smallest), options.keep, context)?;
    if let Some((dropped, parts)) = untightened {
        result.dropped.add(dropped);
        result.parts_untightened = Some(parts);
    }
    Ok(result)
}

/// Tightening may lose, part and join parts. So they are counted, and those that are not to stay taken out of the mask, as without it: which
/// parts that touch along an edge are joined is for the flow to say.
fn parts_untightened(
    mask: &mut Image<bool>,
    mut binary: Image<f32>,
    least: &[f32],
    options: &LabelOptions,
    context: &Context,
) -> Result<(Dropped, Parts)> {
    hold(&mut binary, mask, least);
    let mut nodes = smooth(binary, mask, least, &[], options.smoothing_steps, context)?;
    let choices = junctions(&nodes);
    let dropped = drop_parts(&mut nodes, &choices, options.keep)?;
    dropped.nodes.iter().for_each(|&n| mask.data[n as usize] = false);
    Ok((dropped, Parts::of(&marching_cubes(&nodes, 0.0))))
}

/// Lets nodes within the radius of the staircase (voxels) come nearer to the surface than their least distance, and leave their side: the
/// surface then stays within that radius of the staircase.
fn relax(least: &mut [f32], binary: &Image<f32>, radius: f64) {
    if radius > 0.0 {
        let radius = (radius * binary.geometry.min_spacing()) as f32;
        least
            .par_iter_mut()
            .zip(&binary.data)
            .for_each(|(least, distance)| *least = least.min(distance.abs() - radius));
    }
}

/// Puts every node on its side of zero, by its least distance.
fn hold(field: &mut Image<f32>, mask: &Image<bool>, least: &[f32]) {
    field.data.par_iter_mut().enumerate().for_each(|(n, f)| {
        *f = if mask.data[n] { f.min(-least[n]) } else { f.max(least[n]) };
    });
}

fn padded_mask(inside: &Image<bool>, border: Border, margin: usize) -> Image<bool> {
    let size = inside.geometry.size;
    let geometry = inside.geometry.padded(margin);
    let nearest = |i: isize, n: usize| i.clamp(0, n as isize - 1) as usize;
    let mut data = pad(&inside.data, size, margin, nearest);
    if border == Border::Cap {
        let [nx, ny, _] = geometry.size;
        data.par_chunks_mut(nx).enumerate().for_each(|(row, values)| {
            let beyond = |i: usize, n: usize| i < margin || i >= margin + n;
            if beyond(row % ny, size[1]) || beyond(row / ny, size[2]) {
                values.fill(false);
            }
            values[..margin].fill(false);
            values[margin + size[0]..].fill(false);
        });
    }
    Image { geometry, data }
}

/// Least |F| at every node, in mm: the clearance, and more where the object or the gap is one voxel thin.
fn least_distances(mask: &Image<bool>, clearance: Clearance) -> Vec<f32> {
    let voxel = mask.geometry.min_spacing();
    let (usual, thin) = ((clearance.usual * voxel) as f32, (clearance.thin * voxel) as f32);
    thin_nodes(mask).into_par_iter().map(|is_thin| if is_thin { thin } else { usual }).collect()
}

/// Nodes that lie in no block of 2 x 2 x 2 nodes of their own side: what an opening by such a block would remove.
fn thin_nodes(mask: &Image<bool>) -> Vec<bool> {
    let [nx, ny, nz] = mask.geometry.size;
    let plane = nx * ny;
    let data = &mask.data;
    // bit 0: the block that starts here is all inside; bit 1: all outside
    let blocks: Vec<u8> = (0..data.len())
        .into_par_iter()
        .map(|n| {
            if n % nx + 1 >= nx || n / nx % ny + 1 >= ny || n / plane + 1 >= nz {
                return 0;
            }
            let corners = [0, 1, nx, nx + 1, plane, plane + 1, plane + nx, plane + nx + 1];
            let count = corners.iter().filter(|&&c| data[n + c]).count();
            u8::from(count == 8) | u8::from(count == 0) << 1
        })
        .collect();
    (0..data.len())
        .into_par_iter()
        .map(|n| {
            let (i, j, k) = (n % nx, n / nx % ny, n / plane);
            let on_rim = i == 0 || j == 0 || k == 0 || i + 1 == nx || j + 1 == ny || k + 1 == nz;
            if on_rim {
                return false;
            }
            let own = if data[n] { 1 } else { 2 };
            let corners = [0, 1, nx, nx + 1, plane, plane + 1, plane + nx, plane + nx + 1];
            !corners.iter().any(|&c| blocks[n - c] & own != 0)
        })
        .collect()
}

/// Signed distance of the binary surface (mm), which runs midway between voxel centres of different sides.
fn binary_distance(mask: &Image<bool>) -> Image<f32> {
    let data = mask.data.iter().map(|&m| if m { -1.0 } else { 1.0 }).collect();
    let mut field = Image { geometry: mask.geometry.clone(), data };
    let mesh = marching_cubes(&field, 0.0);
    let mut samples = mesh.vertices.clone();
    samples.extend(mesh.triangles.iter().map(|t| t.iter().map(|&v| mesh.vertices[v as usize]).sum::<DVec3>() / 3.0));
    drop(mesh);
    // room for the differences at the rim of the band; beyond, any large number will do
    let limit = BAND * mask.geometry.mean_spacing() + 3.0 * mask.geometry.spacing.max_element();
    distance_to_samples(&mut field, &samples, limit);
    field
}

/// Nodes in rows along x: `start[row]..start[row + 1]` are the x indices of a row's nodes.
struct Rows {
    start: Vec<usize>,
    columns: Vec<u32>,
}

impl Rows {
    /// The nodes off the rim of the grid for which `keep` holds.
    fn of(size: [usize; 3], keep: impl Fn(usize) -> bool + Sync) -> Self {
        let [nx, ny, nz] = size;
        let rows: Vec<Vec<u32>> = (0..ny * nz)
            .into_par_iter()
            .map(|row| {
                let (j, k) = (row % ny, row / ny);
                if j == 0 || k == 0 || j + 1 == ny || k + 1 == nz {
                    return Vec::new();
                }
                (1..nx as u32 - 1).filter(|&i| keep(row * nx + i as usize)).collect()
            })
            .collect();
        let mut start = vec![0];
        for row in &rows {
            start.push(start[start.len() - 1] + row.len());
        }
        Self { start, columns: rows.concat() }
    }

    /// Gives every node of the rows a new value; `new` gets its old one and its number.
    fn update(&self, nx: usize, data: &mut [f32], new: impl Fn(f32, usize) -> f32 + Sync) {
        data.par_chunks_mut(nx).enumerate().for_each(|(row, values)| {
            for &i in &self.columns[self.start[row]..self.start[row + 1]] {
                let value = &mut values[i as usize];
                *value = new(*value, row * nx + i as usize);
            }
        });
    }
}

/// The clamped bi-Laplacian flow, in a band round the binary surface; beyond the band its distance stays as it is. `bounds`
/// hold single nodes closer than `least` does.
///
/// The differences are those of the grid, not of the millimetres: the staircase lives on the grid, and thick slices need the
/// longer reach that this gives across them.
fn smooth(
    mut field: Image<f32>,
    mask: &Image<bool>,
    least: &[f32],
    bounds: &[Bound],
    steps: usize,
    context: &Context,
) -> Result<Image<f32>> {
    let size = field.geometry.size;
    let [nx, ny, _] = size;
    let plane = nx * ny;
    let band = (BAND * field.geometry.mean_spacing()) as f32;
    let in_band = |n: usize| field.data[n].abs() < band;
    let active = Rows::of(size, in_band);
    let neighbours = |n: usize| [n - 1, n + 1, n - nx, n + nx, n - plane, n + plane];
    let ring = Rows::of(size, |n| in_band(n) || neighbours(n).into_iter().any(in_band));
    let differences = |data: &[f32], n: usize| neighbours(n).into_iter().map(|m| data[m]).sum::<f32>() - 6.0 * data[n];
    let mut laplacian = vec![0.0f32; field.data.len()];
    let impose = |data: &mut [f32]| {
        for bound in bounds {
            let value = &mut data[bound.node];
            *value = value.abs().clamp(bound.least, bound.most).copysign(*value);
        }
    };
    impose(&mut field.data);
    let progress = context.progress(Some(steps as u64), "smoothing");
    for _ in 0..steps {
        context.check_interrupt()?;
        ring.update(nx, &mut laplacian, |_, n| differences(&field.data, n));
        active.update(nx, &mut field.data, |value, n| {
            let value = value - STEP * differences(&laplacian, n);
            if mask.data[n] { value.min(-least[n]) } else { value.max(least[n]) }
        });
        impose(&mut field.data);
        progress.add(1);
    }
    Ok(field)
}
