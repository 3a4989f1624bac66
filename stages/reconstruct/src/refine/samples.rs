//! Points on components of F = 0 that have no facets.

use super::Refinement;
use super::insert::{Candidate, Reason};
use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;
use std::collections::HashMap;

/// Points on a component are no closer than this part of a voxel, or of the extent of the component where that is less.
const CLOSEST: f64 = 0.02;

impl Refinement<'_> {
    /// Points on components that have no facets.
    pub(super) fn on_missing(&mut self, missing: &[u32]) -> Vec<Candidate> {
        let mut members: HashMap<u32, Vec<u32>> = missing.iter().map(|&component| (component, Vec::new())).collect();
        if members.is_empty() {
            return Vec::new();
        }
        for (v, component) in (0..).zip(&self.component_of) {
            members.entry(*component).and_modify(|members| members.push(v));
        }
        let attempts: Vec<(u32, i32)> = missing
            .iter()
            .map(|&component| (component, *self.samplings.entry(component).and_modify(|n| *n += 1).or_insert(0)))
            .collect();
        let samples =
            |&(component, attempt): &(u32, i32)| self.sample_component(component, &members[&component], attempt);
        attempts.par_iter().flat_map_iter(samples).collect()
    }

    /// Points on a component that has no facets: as far apart as its particles want to be, if it has any, and nearer each
    /// time; at least a dozen, where it is large enough.
    fn sample_component(&self, component: u32, members: &[u32], attempt: i32) -> Vec<Candidate> {
        let voxel = self.restricted.field().geometry().mean_spacing();
        let samples = self.topology.samples(component);
        let samples: Vec<DVec3> = samples.into_iter().filter_map(|p| self.on_surface(p, 1.0)).collect();
        if samples.is_empty() {
            return Vec::new();
        }
        let present: Vec<DVec3> = members.iter().map(|&v| self.restricted.points()[v as usize]).collect();
        let largest = members.iter().map(|&v| self.sizes[v as usize]).fold(voxel, f64::max);
        let bounds = Bounds::of(&samples);
        let extent = (bounds.high - bounds.low).max_element();
        let mut spacing = (largest.min(extent) * 0.7f64.powi(attempt)).max(CLOSEST * voxel.min(extent));
        let mut kept = thinned(&present, &samples, spacing);
        // where none is new, the next attempt would be all there is to do
        while (kept.len() < 12 || kept.iter().all(|k| k.is_present)) && spacing > 0.1 * voxel.min(extent) {
            spacing *= 0.7;
            kept = thinned(&present, &samples, spacing);
        }
        let near = |point: DVec3| self.nearest.to(point).map_or(0, |(v, _)| v);
        kept.into_iter()
            .filter(|k| !k.is_present)
            .map(|Kept { point, .. }| Candidate {
                reason: Reason::Missing,
                point,
                radius: spacing,
                size: spacing * 1.2,
                near: near(point),
            })
            .collect()
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
    let mut bins: HashMap<[i64; 3], Vec<DVec3>> = HashMap::new();
    let present = present.iter().map(|&point| Kept { point, is_present: true });
    for new in present.chain(samples.iter().map(|&point| Kept { point, is_present: false })) {
        let at = (new.point / spacing).floor().to_array().map(|x| x as i64);
        let near = (0..27i64)
            .filter_map(|n| bins.get(&[at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1]))
            .flatten()
            .any(|q| q.distance(new.point) < spacing);
        if !near {
            bins.entry(at).or_default().push(new.point);
            kept.push(new);
        }
    }
    kept
}
