//! The geometry around a free vertex: the tangent plane, the paraboloid that approximates the
//! surface, and the triangles at the vertex. The searches for a better position use it.

use super::surface::Surface;
use super::surface::measure::quality_facing;
use crate::interfaces::Interface;
use glam::{DVec2, DVec3};
use isoparticles_field::spline::LEAST_GRADIENT;

/// The geometry around a vertex that may move on its interface.
pub(super) struct Site {
    pub(super) start: DVec3,
    pub(super) pair: Interface,
    pub(super) normal: DVec3,
    /// Orthonormal axes of the tangent plane.
    pub(super) axes: [DVec3; 2],
    /// Second derivatives (xx, xy, yy; per mm) of the height of the tangent plane over the
    /// paraboloid that approximates the surface to second order.
    pub(super) bend: [f64; 3],
    /// For each triangle at the vertex, the positions of the other two corners ([`Surface::side`]).
    pub(super) ring: Vec<(DVec3, DVec3)>,
    /// Mean distance to the neighbours, mm.
    pub(super) reach: f64,
}

impl Site {
    /// Returns the site of a vertex, or `None` if the vertex may not move on an interface or grad F
    /// vanishes.
    pub(super) fn of(surface: &Surface, vertex: u32) -> Option<Self> {
        let v = vertex as usize;
        if surface.frozen[v] || !surface.is_free(vertex) || surface.around[v].is_empty() {
            return None;
        }
        let (start, pair) = (surface.positions[v], surface.pair_at(vertex));
        let jet = surface.field.jet(pair, start);
        let slope = jet.gradient.length();
        if slope < LEAST_GRADIENT {
            return None;
        }
        let normal = jet.gradient / slope;
        let axes = <[DVec3; 2]>::from(normal.any_orthonormal_pair());
        let ring: Vec<(DVec3, DVec3)> = surface.link(vertex).map(|(a, b)| surface.side(a, b)).collect();
        let reach = ring.iter().map(|(a, _)| a.distance(start)).sum::<f64>() / ring.len() as f64;
        let [h1, h2] = axes.map(|axis| jet.hessian * axis / slope);
        let bend = [axes[0].dot(h1), axes[0].dot(h2), axes[1].dot(h2)];
        Some(Self { start, pair, normal, axes, bend, ring, reach })
    }

    /// Returns the point of the paraboloid above the coordinates `at` (mm) in the tangent plane.
    pub(super) fn place(&self, at: DVec2) -> DVec3 {
        let [xx, xy, yy] = self.bend;
        let height = 0.5 * (xx * at.x * at.x + yy * at.y * at.y) + xy * at.x * at.y;
        self.start + self.axes[0] * at.x + self.axes[1] * at.y - self.normal * height
    }

    /// Returns the minimum quality of the triangles with the vertex at `p`, or `None` if it is at
    /// most `bar`. The quality of a triangle turned against the normal is reduced by 1, and
    /// therefore at most 0.
    pub(super) fn worth_above(&self, p: DVec3, bar: f64) -> Option<f64> {
        let mut smallest = f64::INFINITY;
        for &(a, b) in &self.ring {
            smallest = smallest.min(quality_facing([p, a, b], self.normal));
            if smallest <= bar {
                return None;
            }
        }
        Some(smallest)
    }
}
