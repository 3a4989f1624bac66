//! Moves vertices to maximise the mean radius ratio of their triangles, by Newton's method in the
//! tangent plane. The surface is approximated by a paraboloid; the result is projected onto F = 0.

use super::acceptance::{Goal, Limits, commit_or_rollback};
use super::constants::{FIRST_STEP, LEAST_MEAN_GAIN, SHARES};
use super::site::Site;
use super::surface::Surface;
use glam::{DVec2, DVec3};
use isoparticles_mesh::quality::radius_ratio;

/// Moves a vertex by a Newton step in its tangent plane towards the maximum mean radius ratio of
/// its triangles, or by a share of this step. Commits the move if the mean increases by more than
/// [`LEAST_MEAN_GAIN`] and the acceptance test passes. Returns whether a move was committed.
pub(super) fn smooth(surface: &mut Surface, vertex: u32, limits: &Limits, goal: Goal) -> bool {
    let Some(step) = Step::of(surface, vertex) else { return false };
    let least = LEAST_MEAN_GAIN * step.site.ring.len() as f64;
    SHARES.into_iter().any(|share| {
        let kept = step.make(surface, share, least) && commit_or_rollback(surface, limits, goal).is_some();
        surface.rollback();
        kept
    })
}

/// Moves a vertex like [`smooth`], but without a commit, an acceptance test or a minimum gain.
pub(super) fn shift(surface: &mut Surface, vertex: u32) {
    if let Some(step) = Step::of(surface, vertex) {
        // if the full step overshoots, a share of it may not
        let _ = SHARES.into_iter().any(|share| step.make(surface, share, 0.0));
    }
}

/// A Newton step of a vertex on the paraboloid of its site.
struct Step {
    vertex: u32,
    site: Site,
    before: f64,
    way: DVec2,
}

impl Step {
    fn of(surface: &Surface, vertex: u32) -> Option<Self> {
        let site = Site::of(surface, vertex)?;
        let mut step = Self { vertex, site, before: 0.0, way: DVec2::ZERO };
        let (before, gradient, hessian) = step.derivatives();
        step.before = before;
        step.way = step.newton(gradient, hessian)?;
        Some(step)
    }

    /// Returns the sum of the radius ratios with the vertex on the paraboloid above coordinates
    /// (mm) in the tangent plane.
    fn sum(&self, at: DVec2) -> f64 {
        let p = self.site.place(at);
        self.site.ring.iter().map(|&(a, b)| radius_ratio(p, a, b)).sum()
    }

    /// Returns the sum of the radius ratios with the vertex at its present position, and the
    /// gradient and Hessian (xx, xy, yy) of the sum. The ratio of a triangle with sides x, y and c
    /// is (y + c - x) (c + x - y) (x + y - c) / (x y c); c is constant.
    fn derivatives(&self) -> (f64, DVec2, [f64; 3]) {
        let (mut sum, mut gradient, mut hessian) = (0.0, DVec2::ZERO, [0.0; 3]);
        for &(a, b) in &self.site.ring {
            let (x, gx, hx) = self.side(a);
            let (y, gy, hy) = self.side(b);
            let c = a.distance(b);
            let factors = [y + c - x, c + x - y, x + y - c];
            let ratio = factors[0] * factors[1] * factors[2] / (x * y * c);
            let [i, j, k] = factors.map(f64::recip);
            // derivatives of the logarithm with respect to x and y
            let (lx, ly) = (j + k - i - 1.0 / x, i + k - j - 1.0 / y);
            let squares = i * i + j * j + k * k;
            let (lxx, lxy, lyy) = (1.0 / (x * x) - squares, i * i + j * j - k * k, 1.0 / (y * y) - squares);
            let (rxx, rxy, ryy) = (lxx + lx * lx, lxy + lx * ly, lyy + ly * ly);
            sum += ratio;
            gradient += ratio * (lx * gx + ly * gy);
            let second = |p: usize, q: usize, n: usize| {
                rxx * gx[p] * gx[q]
                    + rxy * (gx[p] * gy[q] + gy[p] * gx[q])
                    + ryy * gy[p] * gy[q]
                    + lx * hx[n]
                    + ly * hy[n]
            };
            hessian[0] += ratio * second(0, 0, 0);
            hessian[1] += ratio * second(0, 1, 1);
            hessian[2] += ratio * second(1, 1, 2);
        }
        (sum, gradient, hessian)
    }

    /// Returns the distance of the vertex from a point, and its gradient and Hessian (xx, xy, yy)
    /// with respect to the coordinates of the vertex in the tangent plane.
    fn side(&self, other: DVec3) -> (f64, DVec2, [f64; 3]) {
        let way = self.site.start - other;
        let length = way.length();
        let gradient = DVec2::new(self.site.axes[0].dot(way), self.site.axes[1].dot(way)) / length;
        let [xx, xy, yy] = self.site.bend.map(|bend| bend * self.site.normal.dot(way));
        let (gx, gy) = (gradient.x, gradient.y);
        (length, gradient, [(1.0 - gx * gx - xx) / length, (-gx * gy - xy) / length, (1.0 - gy * gy - yy) / length])
    }

    /// Returns the Newton step towards a maximum, at most [`FIRST_STEP`] times the mean distance to
    /// the neighbours. Absolute values replace the eigenvalues of the Hessian, so that the step
    /// leads uphill even where the sum is not concave.
    fn newton(&self, gradient: DVec2, [xx, xy, yy]: [f64; 3]) -> Option<DVec2> {
        // the eigenvalues are mean + spread and mean - spread; `first` is the eigenvector of the
        // former
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

    /// Moves the vertex by a share of the step, if this raises the sum by more than `least` on the
    /// paraboloid. Most steps do not, and need no projection (`heart_label` 1, h = 2.1 mm: 185,000
    /// of 238,000, of which one would have passed). Returns whether the vertex moved.
    fn make(&self, surface: &mut Surface, share: f64, least: f64) -> bool {
        let at = share * self.way;
        if self.sum(at) - self.before <= least {
            return false;
        }
        match surface.field.projected_facing(self.site.pair, self.site.place(at), self.site.normal, self.site.reach) {
            Some(p) => {
                surface.move_vertex(self.vertex, p);
                true
            }
            None => false,
        }
    }
}
