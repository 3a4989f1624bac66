//! Finds the triangles nearest to the grid nodes on the wrong side.

use super::Surface;
use crate::improve::nodes::NodeSides;
use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;

impl Surface<'_> {
    /// Returns whether grid nodes are guarded and some of them are on the wrong side.
    pub(in crate::improve) fn has_wrong_nodes(&self) -> bool {
        self.sides.as_ref().is_some_and(|sides| sides.wrong_count() > 0)
    }

    /// Returns the triangles nearest to the grid nodes on the wrong side, ascending.
    pub(in crate::improve) fn triangles_at_wrong_nodes(&self) -> Vec<u32> {
        let places = self.sides.as_ref().map_or_else(Vec::new, NodeSides::wrong_places);
        let mut nearest: Vec<u32> = places.into_par_iter().filter_map(|p| self.nearest_triangle(p)).collect();
        nearest.sort_unstable();
        nearest.dedup();
        nearest
    }

    /// Returns the triangle nearest to a point, the first of equals. Returns `None`
    /// without a grid or triangles.
    fn nearest_triangle(&self, p: DVec3) -> Option<u32> {
        let furthest = self.positions.iter().map(|q| q.distance(p)).fold(0.0, f64::max);
        let mut reach = self.field.voxel();
        loop {
            let mut best: Option<(f64, u32)> = None;
            self.grid.as_ref()?.any(&Bounds { low: p - reach, high: p + reach }, |t, _| {
                let rated = (distance_to_triangle(p, self.corners(t)), t);
                if rated.0 <= reach && best.is_none_or(|best| rated < best) {
                    best = Some(rated);
                }
                false
            });
            if best.is_some() || reach > furthest {
                return best.map(|(_, t)| t);
            }
            reach *= 2.0;
        }
    }
}

/// Returns the distance from `p` to a triangle.
fn distance_to_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let sides = [(a, b), (b, c), (c, a)];
    if normal != DVec3::ZERO && sides.iter().all(|&(from, to)| (to - from).cross(p - from).dot(normal) >= 0.0) {
        return (p - a).dot(normal).abs();
    }
    let to_side = |(from, to): (DVec3, DVec3)| {
        let share = (p - from).dot(to - from) / (to - from).length_squared().max(f64::MIN_POSITIVE);
        p.distance(from.lerp(to, share.clamp(0.0, 1.0)))
    };
    sides.map(to_side).into_iter().fold(f64::INFINITY, f64::min)
}
