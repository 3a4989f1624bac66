//! Moves vertices to where the mean radius ratio round them is largest.

use super::constants::{DIFFERENCE, FIRST_STEP, SHARES};
use super::guard::{Limits, Rule, commit_or_rollback};
use super::moves::{Site, projected_facing};
use super::surface::Surface;
use glam::{DVec2, DVec3};
use isoparticles_mesh::quality::radius_ratio;

/// Brings a vertex nearer to where the mean radius ratio of its triangles is largest, by a step of Newton's method over its tangent plane, and
/// commits that when the rule lets it pass.
pub(super) fn smooth(surface: &mut Surface, vertex: u32, limits: &Limits, rule: Rule) -> bool {
    let Some(step) = Step::of(surface, vertex) else { return false };
    SHARES.into_iter().any(|share| {
        let kept = step.make(surface, share) && commit_or_rollback(surface, limits, rule).is_some();
        surface.rollback();
        kept
    })
}

/// The same without asking whether it is kept.
pub(super) fn shift(surface: &mut Surface, vertex: u32) {
    if let Some(step) = Step::of(surface, vertex) {
        // where the whole way overshoots, a part of it may not
        let _ = SHARES.into_iter().any(|share| step.make(surface, share));
    }
}

/// The way of a vertex over the surface, which is a paraboloid over its tangent plane to second order.
struct Step {
    vertex: u32,
    site: Site,
    /// Of the paraboloid: xx, xy, yy, per mm.
    bend: [f64; 3],
    before: f64,
    way: DVec2,
}

impl Step {
    fn of(surface: &Surface, vertex: u32) -> Option<Self> {
        let site = Site::of(surface, vertex)?;
        let [e1, e2] = site.axes;
        let (h1, h2) = (site.jet.hessian * e1 / site.slope, site.jet.hessian * e2 / site.slope);
        let bend = [e1.dot(h1), e1.dot(h2), e2.dot(h2)];
        let mut step = Self { vertex, site, bend, before: 0.0, way: DVec2::ZERO };
        step.before = step.sum(DVec2::ZERO);
        step.way = step.newton()?;
        Some(step)
    }

    fn place(&self, at: DVec2) -> DVec3 {
        let [xx, xy, yy] = self.bend;
        let height = 0.5 * (xx * at.x * at.x + yy * at.y * at.y) + xy * at.x * at.y;
        self.site.start + self.site.axes[0] * at.x + self.site.axes[1] * at.y - self.site.normal * height
    }

    /// Sum of the radius ratios with the vertex at a place of the tangent plane.
    fn sum(&self, at: DVec2) -> f64 {
        let p = self.place(at);
        self.site.ring.iter().map(|&(a, b)| radius_ratio(p, a, b)).sum()
    }

    /// Newton's step, uphill also where the sum is not concave.
    fn newton(&self) -> Option<DVec2> {
        let d = DIFFERENCE * self.site.reach;
        let f = |x: f64, y: f64| self.sum(DVec2::new(x, y) * d);
        let [left, right, down, up] = [f(-1.0, 0.0), f(1.0, 0.0), f(0.0, -1.0), f(0.0, 1.0)];
        let mixed = f(1.0, 1.0) - f(1.0, -1.0) - f(-1.0, 1.0) + f(-1.0, -1.0);
        let gradient = DVec2::new(right - left, up - down) / (2.0 * d);
        let square = d * d;
        let (xx, yy) = ((right + left - 2.0 * self.before) / square, (up + down - 2.0 * self.before) / square);
        let xy = mixed / (4.0 * square);
        // eigenvalues and the direction of the first
        let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let spread = half.hypot(xy);
        let angle = 0.5 * xy.atan2(half);
        let first = DVec2::from_angle(angle);
        let second = first.perp();
        let along = |axis: DVec2, value: f64| axis * (axis.dot(gradient) / value.abs());
        let way = along(first, mean + spread) + along(second, mean - spread);
        let way = way.clamp_length_max(FIRST_STEP * self.site.reach);
        (way.is_finite() && way != DVec2::ZERO).then_some(way)
    }

    /// Goes a share of the way; false where that does not raise the mean.
    fn make(&self, surface: &mut Surface, share: f64) -> bool {
        let at = share * self.way;
        if self.sum(at) <= self.before {
            return false;
        }
        match projected_facing(surface, self.site.sheet, self.place(at), self.site.normal, self.site.reach) {
            Some(p) => {
                surface.move_vertex(self.vertex, p);
                true
            }
            None => false,
        }
    }
}
