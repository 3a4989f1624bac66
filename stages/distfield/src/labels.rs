//! Label maps: the smoothest surface that keeps every voxel centre on its side (Whitaker 2000, reference 19 of the paper).
//!
//! A clamped fourth-order flow (bi-Laplacian of the distance) smooths the staircase; after each step every node is held
//! on its side of zero by its clearance. Curvature flow (second order) would pull the surface onto the innermost place that the
//! clamp allows.
//!
//! Who wants it smoother than the voxels allow gives a tightening radius (the paper's program opens and closes by one): nodes nearer to
//! the staircase than that may change sides.

use crate::closest::distance_to_samples;
use crate::field::{Demands, LeastDistances, Redistanced, Source, redistance_with};
use crate::flow::{BAND, band, smooth};
use crate::junctions::{junctions, plain_choices};
use crate::keep::{Dropped, drop_parts};
use crate::mask::Mask;
use crate::runs::Runs;
use crate::sides::NodeSides;
use crate::topology::Parts;
use crate::{Border, Clearance, Keep};
use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::spline::BrickSpline;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Image;
use rayon::prelude::*;

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
pub fn from_labels(inside: &Image<bool>, options: &LabelOptions, monitor: &dyn Monitor) -> Result<Redistanced> {
    from_mask(Mask::from(inside), options, monitor)
}

/// The same of a mask. It is taken over, so that its memory is free again when the distances are made.
///
/// # Errors
/// As [`from_labels`].
pub fn from_mask(inside: Mask, options: &LabelOptions, monitor: &dyn Monitor) -> Result<Redistanced> {
    from_mask_with(inside, options, &Demands::default(), monitor)
}

/// The same with demands of its own.
///
/// # Errors
/// As [`from_labels`].
pub fn from_mask_with(
    inside: Mask,
    options: &LabelOptions,
    demands: &Demands,
    monitor: &dyn Monitor,
) -> Result<Redistanced> {
    let step = monitor.phase("binary distance");
    let mask = inside.padded(options.border, options.margin);
    drop(inside);
    if !(1..mask.geometry.voxel_count()).contains(&mask.inside.count()) {
        return Err(Error::input(
            "the chosen labels cover no voxel, or every voxel with an open border",
            "there is no surface between inside and outside",
            "choose other labels, or --border cap",
        ));
    }
    let mut binary = binary_distance(&mask, Vec::new());
    let mut sides = NodeSides::new(mask, options.clearance);
    let mut untightened = None;
    if options.tightening > 0.0 {
        let (dropped, parts);
        (binary, dropped, parts) = parts_untightened(binary, &mut sides, options, monitor)?;
        untightened = Some((dropped, parts));
    }
    sides.relax(&binary, options.tightening);
    sides.hold(&mut binary);
    drop(step);
    let step = monitor.phase("smoothing");
    let flowed = smooth(binary, &sides, &[], options.smoothing_steps, monitor)?;
    let voxel = flowed.geometry.min_spacing();
    let (near, far) = ((options.clearance.usual * voxel) as f32, (JUNCTION_DISTANCE * voxel) as f32);
    let bounds = plain_choices(&junctions(&flowed), |n| sides.least(n), near, far);
    let nodes = smooth(flowed, &sides, &bounds, options.smoothing_steps.min(JUNCTION_STEPS), monitor)?;
    check_something_is_left(&nodes, options.tightening)?;
    let smallest = SMALLEST_CLEARANCE * voxel as f32;
    let at = |n: usize| match bounds.binary_search_by_key(&n, |bound| bound.node) {
        Ok(bound) => bounds[bound].least.max(smallest),
        Err(_) => sides.least(n).max(smallest),
    };
    let source = Source { spline: BrickSpline::new(&nodes), cap: None };
    drop(step);
    let most = bounds.iter().map(|bound| bound.least).fold(sides.most().max(smallest), f32::max);
    let least = LeastDistances { most, at };
    let mut result = redistance_with(nodes, &source, least, (options.keep, options.margin), demands, monitor)?;
    if let Some((dropped, parts)) = untightened {
        result.dropped.add(dropped);
        result.parts_untightened = Some(parts);
    }
    result.changed = Some(changed_nodes(&sides.mask, &result, options.margin));
    Ok(result)
}

/// Tightening may leave no surface.
fn check_something_is_left(nodes: &Image<f32>, tightening: f64) -> Result<()> {
    if nodes.data.par_iter().all(|f| *f >= 0.0) {
        return Err(Error::input(
            format!("tightening by {tightening} voxels leaves nothing of the object"),
            "parts thinner than twice that radius may vanish, and all are",
            "choose a smaller --tightening; 0 keeps every voxel",
        ));
    }
    if nodes.data.par_iter().all(|f| *f < 0.0) {
        return Err(Error::input(
            format!("tightening by {tightening} voxels closes every gap in the object"),
            "gaps thinner than twice that radius may vanish, and all do: no surface is left",
            "choose a smaller --tightening; 0 keeps every voxel",
        ));
    }
    Ok(())
}

/// Tightening may lose, part and join parts. So they are counted, and those that are not to stay taken out of the mask, as without it: which
/// parts that touch along an edge are joined is for the flow to say. Gives the binary distance of the mask back.
fn parts_untightened(
    mut binary: Image<f32>,
    sides: &mut NodeSides,
    options: &LabelOptions,
    monitor: &dyn Monitor,
) -> Result<(Image<f32>, Dropped, Parts)> {
    // the nodes that are about to move
    let band = band(&binary);
    let near = Runs::of(binary.geometry.size, |n| binary.data[n].abs() < band);
    let values = near.values(|n| binary.data[n]);
    sides.hold(&mut binary);
    let mut nodes = smooth(binary, sides, &[], options.smoothing_steps, monitor)?;
    let choices = junctions(&nodes);
    let dropped = drop_parts(&mut nodes, options.margin, &choices, options.keep)?;
    let parts = Parts::of(&marching_cubes(&nodes, 0.0));
    if let Some(gone) = &dropped.nodes {
        sides.mask.inside.subtract(gone);
        nodes = binary_distance(&sides.mask, nodes.data);
    } else {
        near.scatter(&values, &mut nodes.data);
    }
    Ok((nodes, dropped, parts))
}

/// Signed distance of the binary surface (mm), which runs midway between voxel centres of different sides; `room` is where it is written to.
fn binary_distance(mask: &Mask, mut room: Vec<f32>) -> Image<f32> {
    let geometry = mask.geometry.clone();
    room.resize(geometry.voxel_count(), 0.0);
    let mut field = Image { geometry, data: room };
    field.data.par_iter_mut().enumerate().for_each(|(n, f)| *f = if mask.inside.holds(n) { -1.0 } else { 1.0 });
    let mesh = marching_cubes(&field, 0.0);
    let mut samples = mesh.vertices.clone();
    samples.extend(mesh.triangles.iter().map(|t| t.iter().map(|&v| mesh.vertices[v as usize]).sum::<DVec3>() / 3.0));
    drop(mesh);
    // room for the differences at the rim of the band; beyond, any large number will do
    let limit = BAND * field.geometry.mean_spacing() + 3.0 * field.geometry.spacing.max_element();
    distance_to_samples(&mut field, &mask.inside, &samples, limit);
    field
}

/// Voxel centres that F puts on the other side; those of parts that were dropped changed side on purpose.
fn changed_nodes(mask: &Mask, result: &Redistanced, margin: usize) -> usize {
    let Redistanced { field, dropped, .. } = result;
    let [nx, ny, nz] = field.geometry.size;
    let has_changed = |n: usize| {
        let was_dropped = || dropped.nodes.as_ref().is_some_and(|nodes| nodes.holds(n));
        (field.data[n] < 0.0) != mask.inside.holds(n) && !was_dropped()
    };
    let rows = (margin..nz - margin).into_par_iter().flat_map_iter(|k| (margin..ny - margin).map(move |j| k * ny + j));
    rows.map(|row| (row * nx + margin..(row + 1) * nx - margin).filter(|&n| has_changed(n)).count()).sum()
}
