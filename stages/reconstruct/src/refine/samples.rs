//! Samples components of F = 0 that have no facets.

use super::{Place, Refinement};
use crate::object::Violation;
use crate::queue::Reason;
use glam::DVec3;
use isoparticles_mesh::spatial::{Bins, Bounds};
use rayon::prelude::*;
use std::collections::HashMap;

/// Minimum distance between the points on a component, in voxels or in units of the maximum extent
/// of the component, whichever is smaller.
const CLOSEST: f64 = 0.02;

/// Factor by which the distance between points decreases if the previous points gave the component
/// no facet.
const NEARER: f64 = 0.7;

/// Target edge length h at these points, as a multiple of the distance between them.
const SIZE_OF_SPACING: f64 = 1.2;

impl Refinement<'_> {
    /// Returns points on components that have no facets.
    pub(super) fn on_missing(&self, missing: &[u32]) -> Vec<Violation> {
        let mut members: HashMap<u32, Vec<u32>> = missing.iter().map(|&component| (component, Vec::new())).collect();
        if members.is_empty() {
            return Vec::new();
        }
        for (v, component) in (0..).zip(&self.object.component_of) {
            members.entry(*component).and_modify(|members| members.push(v));
        }
        let samples = |component: &u32| self.sample_component(*component, &members[component]);
        let found: Vec<Place> = missing.par_iter().flat_map_iter(samples).collect();
        self.places(Reason::Missing, &found)
    }

    /// Returns new points on a component that has no facet. Their spacing is at most a voxel and
    /// the extent of the component, and smaller than that of the points `members` already on it. It
    /// is reduced, down to a limit, until the component has a dozen points and one of them is new.
    fn sample_component(&self, component: u32, members: &[u32]) -> Vec<Place> {
        let voxel = self.object.restricted.field().geometry().mean_spacing();
        let samples = self.object.topology.samples(component);
        let samples: Vec<DVec3> = samples.into_iter().filter_map(|p| self.object.on_surface(p, 1.0)).collect();
        if samples.is_empty() {
            return Vec::new();
        }
        let present: Vec<DVec3> = members.iter().map(|&v| self.object.points()[v as usize]).collect();
        let bounds = Bounds::of(&samples);
        let extent = (bounds.high - bounds.low).max_element();
        let smallest = members.iter().map(|&v| self.object.sizes[v as usize]).fold(f64::INFINITY, f64::min);
        let wanted = if members.is_empty() { voxel } else { NEARER / SIZE_OF_SPACING * smallest };
        let mut spacing = wanted.min(extent).max(CLOSEST * voxel.min(extent));
        let mut kept = thinned(&present, &samples, spacing);
        // If all points exist already, smaller distances are tried at once: the next round would do
        // no more.
        while (kept.len() < 12 || kept.iter().all(|k| k.is_present)) && spacing > 0.1 * voxel.min(extent) {
            spacing *= NEARER;
            kept = thinned(&present, &samples, spacing);
        }
        let new = kept.into_iter().filter(|k| !k.is_present);
        new.map(|k| Place { point: k.point, radius: spacing, size: SIZE_OF_SPACING * spacing }).collect()
    }
}

/// A point kept by [`thinned`].
#[derive(Clone, Copy)]
struct Kept {
    point: DVec3,
    is_present: bool,
}

/// Returns points of `present` and `samples` that are at least `spacing` apart. Earlier points take
/// precedence, those of `present` first.
fn thinned(present: &[DVec3], samples: &[DVec3], spacing: f64) -> Vec<Kept> {
    let mut kept: Vec<Kept> = Vec::new();
    let mut bins = Bins::new(spacing);
    let present = present.iter().map(|&point| Kept { point, is_present: true });
    for new in present.chain(samples.iter().map(|&point| Kept { point, is_present: false })) {
        if !bins.near(new.point).any(|q: &DVec3| q.distance(new.point) < spacing) {
            bins.add(new.point, new.point);
            kept.push(new);
        }
    }
    kept
}
