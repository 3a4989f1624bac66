//! Points on components of the isosurface that have no facets.

use super::{Candidate, Reason, Refinement};
use crate::isosurface::bounds;
use glam::DVec3;
use std::collections::HashMap;

impl Refinement<'_> {
    /// Points on a class that has no facets: as far apart as its particles want to be, if it has any, and nearer each
    /// time; at least a dozen, where it is large enough.
    pub(super) fn sample_class(&self, class: u32, members: &[u32], attempt: i32) -> Vec<Candidate> {
        let voxel = self.restricted.field().geometry().mean_spacing();
        let samples: Vec<DVec3> =
            self.isosurface.samples(class).into_iter().filter_map(|p| self.on_surface(p, 1.0)).collect();
        let present: Vec<DVec3> = members.iter().map(|&v| self.restricted.points()[v as usize]).collect();
        let largest = members.iter().map(|&v| self.sizes[v as usize]).fold(voxel, f64::max);
        let Some((low, high)) = bounds(&samples) else { return Vec::new() };
        let extent = (high - low).max_element();
        let mut spacing = largest.min(extent) * 0.7f64.powi(attempt);
        let fresh = |spacing: f64| thinned(&[&present[..], &samples[..]].concat(), spacing);
        let mut kept = fresh(spacing);
        while kept.len() < 12 && spacing > 0.1 * voxel.min(extent) {
            spacing *= 0.7;
            kept = fresh(spacing);
        }
        // those of the present points that were kept are in the triangulation already, and will be found there
        kept.into_iter()
            .map(|point| Candidate { reason: Reason::Missing, point, radius: spacing, size: spacing * 1.2, near: 0 })
            .collect()
    }
}

/// Points no two of which are nearer than `spacing`, first come first kept.
fn thinned(points: &[DVec3], spacing: f64) -> Vec<DVec3> {
    let mut kept: Vec<DVec3> = Vec::new();
    let mut bins: HashMap<[i64; 3], Vec<DVec3>> = HashMap::new();
    for &p in points {
        let at = (p / spacing).floor().to_array().map(|x| x as i64);
        let near = (0..27i64)
            .filter_map(|n| bins.get(&[at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1]))
            .flatten()
            .any(|q| q.distance(p) < spacing);
        if !near {
            bins.entry(at).or_default().push(p);
            kept.push(p);
        }
    }
    kept
}
