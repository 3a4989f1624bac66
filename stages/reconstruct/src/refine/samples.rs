//! Points on components of F = 0 that have no facets.

use super::{Place, Refinement};
use crate::object::Violation;
use crate::queue::Reason;
use glam::DVec3;
use isoparticles_mesh::spatial::{Bins, Bounds};
use rayon::prelude::*;
use std::collections::HashMap;

/// Points on a component are no closer than this part of a voxel, or of the extent of the component where that is less.
const CLOSEST: f64 = 0.02;

/// Each time that the points of a component give it no facet, the next are this much nearer to each other.
const NEARER: f64 = 0.7;

/// Target edge length at such points over the distance that they keep from each other.
const SIZE_OF_SPACING: f64 = 1.2;

impl Refinement<'_> {
    /// Points on components that have no facets.
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

    /// Points on a component that has no facets: about a voxel apart or as its extent is, nearer to each other than those that it has; at least a
    /// dozen, where it is large enough.
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
        // where none is new, the next look would be all there is to do
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

/// Points no two of which are nearer than `spacing`, first come first kept.
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
