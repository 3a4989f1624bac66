//! Implicit functions whose zero sets are the interfaces of a mesh: F for one object, or one
//! function for each pair of adjacent materials.

use super::constants::{HALVINGS, LINE_STEPS, PROJECTION_TOLERANCE};
use crate::interfaces::Interface;
use glam::DVec3;
use isoparticles_field::materials::MaterialId;
use isoparticles_field::spline::{CubicSpline, Jet};

/// How a vertex may move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// Anywhere on its interface.
    Interface,
    /// Along its junction curve, where interfaces meet.
    Curve,
    /// Fixed.
    None,
    /// Fixed: the vertex is a junction point, where junction curves end.
    Point,
}

/// Implicit functions of the interfaces, at positions in the grid frame (mm). Each function is zero
/// on its interface and negative in the first of its two materials, the inside. The triangles of
/// the interface face outward.
pub trait InterfaceFunctions: Sync {
    /// Returns the value of the function of an interface.
    fn value(&self, pair: Interface, p: DVec3) -> f64;

    /// Returns the value and gradient of the function of an interface.
    fn value_gradient(&self, pair: Interface, p: DVec3) -> (f64, DVec3);

    /// Returns the value, gradient and Hessian of the function of an interface.
    fn jet(&self, pair: Interface, p: DVec3) -> Jet;

    /// Returns the projection of `start` onto an interface, and the gradient there. Returns `None`
    /// if the point is farther than `limit` (mm), is not found to within `tolerance` (mm), or lies
    /// beyond the end of the interface.
    fn project(&self, pair: Interface, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)>;

    /// Returns the projection of `start` onto the junction curve of two interfaces. Returns `None`
    /// as [`Self::project`] does, or if the interfaces do not meet in a curve.
    fn project_onto_curve(
        &self,
        _interfaces: [Interface; 2],
        _start: DVec3,
        _limit: f64,
        _tolerance: f64,
    ) -> Option<DVec3> {
        None
    }

    /// Returns the projection of `p` onto an interface, with the default tolerance and at most
    /// `limit` mm away.
    fn projected(&self, pair: Interface, p: DVec3, limit: f64) -> Option<DVec3> {
        self.project(pair, p, limit, PROJECTION_TOLERANCE * self.voxel()).map(|(q, _)| q)
    }

    /// Returns the projection of `p` onto a point of an interface where the gradient points to the
    /// side of the unit vector `normal`. This excludes the other face of a thin wall or gap. If the
    /// projection along the gradient ends there, the nearest crossing along `normal` is projected
    /// instead.
    fn projected_facing(&self, pair: Interface, p: DVec3, normal: DVec3, limit: f64) -> Option<DVec3> {
        let tolerance = PROJECTION_TOLERANCE * self.voxel();
        let facing = |start: DVec3, limit: f64| {
            self.project(pair, start, limit, tolerance).filter(|(_, g)| g.dot(normal) > 0.0).map(|(q, _)| q)
        };
        facing(p, limit).or_else(|| {
            let (mut below, mut above) = crossing_along(|x| self.value(pair, p + x * normal), limit)?;
            for _ in 0..HALVINGS {
                let middle = 0.5 * (below + above);
                if self.value(pair, p + middle * normal) < 0.0 { below = middle } else { above = middle }
            }
            facing(p + 0.5 * (below + above) * normal, limit)
        })
    }

    /// Returns the region to which a material belongs: itself, or the outside for the space beyond
    /// a plane.
    fn region(&self, id: MaterialId) -> MaterialId {
        id
    }

    /// Returns the mean voxel spacing (mm).
    fn voxel(&self) -> f64;
}

/// Returns the interval nearest to 0, between -`limit` and `limit`, in which `f` increases through
/// zero. Each interval is `limit` / [`LINE_STEPS`] long.
fn crossing_along(f: impl Fn(f64) -> f64, limit: f64) -> Option<(f64, f64)> {
    let step = limit / LINE_STEPS as f64;
    let centre = f(0.0);
    let (mut up, mut down) = (centre, centre);
    for k in 0..LINE_STEPS {
        let (near, far) = (k as f64 * step, (k + 1) as f64 * step);
        let next = f(far);
        if up < 0.0 && next >= 0.0 {
            return Some((near, far));
        }
        up = next;
        let next = f(-far);
        if next < 0.0 && down >= 0.0 {
            return Some((-far, -near));
        }
        down = next;
    }
    None
}

/// One object: F = 0 is its only interface.
impl InterfaceFunctions for CubicSpline {
    fn value(&self, _: Interface, p: DVec3) -> f64 {
        CubicSpline::value(self, p)
    }

    fn value_gradient(&self, _: Interface, p: DVec3) -> (f64, DVec3) {
        CubicSpline::value_gradient(self, p)
    }

    fn jet(&self, _: Interface, p: DVec3) -> Jet {
        CubicSpline::jet(self, p)
    }

    fn project(&self, _: Interface, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        self.project_with_gradient(start, limit, tolerance)
    }

    fn voxel(&self) -> f64 {
        CubicSpline::voxel(self)
    }
}
