//! Computes F of label maps: a smooth surface that keeps every voxel centre on its side and
//! preserves the local volume.
//!
//! The occupancy of the voxels, 0 or 1, is smoothed by a Gaussian with standard deviation `SIGMA`,
//! and a level set of the result preserves the volume (`level.rs`). Local corrections keep every
//! voxel centre on its side, at a minimum distance from the surface. This method replaces the
//! constrained flow of Whitaker (2000), reference 19 of the paper.
//!
//! Parts that touch along an edge are connected; parts that touch only at a corner are not.

use crate::bits::Bits;
use crate::field::{Demands, Redistanced};
use crate::level::{Clearance, Smoothing, contacts, level_set};
use crate::mask::Mask;
use crate::occupancy::Occupancy;
use crate::scalar::{ScalarOptions, from_level};
use crate::{Border, Inside, Keep};
use glam::DVec3;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::{CutFaces, Image};
use rayon::prelude::*;

/// Standard deviation, in voxels along each axis, of the Gaussian that smooths the steps between
/// voxels. For a ball with a radius of 20 voxels, the root-mean-square error of the radius is 0.06
/// voxel with a standard deviation of 1.5, and 0.065 voxel with 1.3.
pub(crate) const SIGMA: DVec3 = DVec3::splat(1.5);

/// Number of layers of nodes that affect the surface, counted outwards from the labels. With five
/// layers, F agrees with the F of the whole volume to within 0.01 voxel (test
/// `field_of_the_object_box_equals_field_of_the_whole_volume`); with four layers, the differences
/// are larger.
pub(crate) const LABEL_ROOM: usize = 5;

/// Returns the number of voxels to keep around the labels in addition to the margin.
pub(crate) fn room_of_labels(margin: usize) -> [usize; 3] {
    [LABEL_ROOM.saturating_sub(margin); 3]
}

/// Ratio of the clearance required of the level set to the clearance required of F. The level set
/// satisfies its clearance only to first order. With a ratio of 1, |F| would have to be raised at
/// thousands of voxel centres of `heart_label`, which would move the zero set.
const CLEARANCE_FACTOR: f64 = 2.0;

/// Options for computing a surface from labels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelOptions {
    /// Treatment of the object at the border of the volume.
    pub border: Border,
    /// Number of voxels added on each face.
    pub margin: usize,
    /// Faces of the grid that are cuts rather than borders of the volume. An open border is closed
    /// at these faces.
    pub cut: CutFaces,
    /// Minimum distance of the surface from voxel centres, in units of the minimum voxel spacing.
    pub clearance: f64,
    /// Parts of the object to keep.
    pub keep: Keep,
}

/// Computes F of the union of several labels; `inside` is true at the voxels of the labels.
///
/// # Errors
/// If no voxel is inside, if all voxels are inside and the border is open, if no part is kept, or
/// if the run is interrupted.
pub fn from_labels(inside: &Image<bool>, options: &LabelOptions, monitor: &dyn Monitor) -> Result<Redistanced> {
    from_mask(Mask::from(inside), options, monitor)
}

/// Computes F of a mask.
///
/// # Errors
/// See [`from_labels`].
pub fn from_mask(inside: Mask, options: &LabelOptions, monitor: &dyn Monitor) -> Result<Redistanced> {
    from_mask_with(inside, |_| false, options, &Demands::default(), monitor)
}

/// Computes F of a mask with a given accuracy. Where two parts touch along an edge, `gives_way` is
/// called with the two outside voxels at the edge. If it returns true, the outside voxels are
/// connected instead of the parts.
///
/// # Errors
/// See [`from_labels`].
pub(crate) fn from_mask_with(
    mask: Mask,
    gives_way: impl Fn([usize; 2]) -> bool + Sync,
    options: &LabelOptions,
    demands: &Demands,
    monitor: &dyn Monitor,
) -> Result<Redistanced> {
    let padded = mask.padded(options.margin, options.cut);
    let count = padded.inside.count();
    if count == 0 || (count == padded.geometry.voxel_count() && options.border == Border::Open) {
        return Err(Error::input(
            "the chosen labels cover no voxel, or they cover every voxel and the border is open",
            "there is no surface between inside and outside",
            "choose other LABELS (--labels), or set BORDER=cap (--border cap)",
        ));
    }
    let step = monitor.phase("smoothing");
    let size = mask.geometry.size;
    let voxel = |node: usize| {
        let [px, py, _] = padded.geometry.size;
        let at = [node % px, node / px % py, node / (px * py)];
        let [i, j, k] = std::array::from_fn(|a| at[a].saturating_sub(options.margin).min(size[a] - 1));
        mask.geometry.linear(i, j, k)
    };
    let contacts = contacts(&padded, |outside| gives_way(outside.map(voxel)));
    let clearance = Clearance { distance: CLEARANCE_FACTOR * options.clearance, contacts };
    let smoothing = Smoothing { sigma: SIGMA, least_level: 0.0, clearance: Some(clearance) };
    let above = level_set(&Occupancy::of_mask(&padded), &smoothing).above;
    drop(step);
    monitor.check()?;
    let &LabelOptions { border, margin, cut, keep, .. } = options;
    let scalar = ScalarOptions { inside: Inside::Above, border, margin, cut, keep };
    let level = Image { geometry: padded.geometry, data: above };
    let mut result = from_level(level, margin, options.clearance, &scalar, demands, monitor)?;
    result.changed = Some(changed_voxels(&mask.inside, &result, margin));
    Ok(result)
}

/// Returns the number of voxel centres on the wrong side of F = 0, excluding the voxels of dropped
/// parts.
fn changed_voxels(inside: &Bits, result: &Redistanced, margin: usize) -> usize {
    let Redistanced { field, dropped, .. } = result;
    let [px, py, pz] = field.geometry.size;
    let [nx, ny, nz] = [px, py, pz].map(|n| n - 2 * margin);
    let rows = (0..ny * nz).into_par_iter().map(|row| {
        let first = ((row / ny + margin) * py + row % ny + margin) * px + margin;
        let has_changed = |i: &usize| {
            let node = first + i;
            let was_dropped = || dropped.nodes.as_ref().is_some_and(|nodes| nodes.holds(node));
            (field.data[node] < 0.0) != inside.holds(row * nx + i) && !was_dropped()
        };
        (0..nx).filter(has_changed).count()
    });
    rows.sum()
}
