//! Defines strata (material interfaces, junction curves and junction points) as zero sets of the
//! differences G_ij = (F_i - F_j) / 2, and computes the Newton steps onto them.

use super::{Indicators, MaterialId};
use crate::spline::{Jet, LEAST_SQUARED_GRADIENT, PROJECTION_STEPS};
use glam::{DMat3, DVec3};

/// Minimum squared sine of the angle between two interfaces, or between a curve and a third
/// interface, for them to count as crossing. At this angle, 0.6 degrees, displacing one interface
/// by a hundredth of a voxel moves the intersection by a voxel.
pub const LEAST_SQUARED_SINE: f64 = 1e-4;

/// Half the difference of two indicators, G_ij = (F_i - F_j) / 2, as a function. It is in mm,
/// negative where F_i is the smaller, and zero on the interface of the two materials. The interface
/// is real where no third indicator is smaller.
#[derive(Debug)]
pub struct InterfaceFunction<'a, I: ?Sized> {
    pub(super) indicators: &'a I,
    /// The material on the negative side.
    pub i: MaterialId,
    /// The material on the positive side.
    pub j: MaterialId,
}

impl<I: Indicators + ?Sized> InterfaceFunction<'_, I> {
    /// Returns G_ij and its gradient at a grid position.
    pub fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        self.indicators.difference_gradient(self.i, self.j, grid)
    }

    /// Returns G_ij, its gradient and its Hessian at a grid position.
    pub fn jet(&self, grid: DVec3) -> Jet {
        self.indicators.difference(self.i, self.j, grid)
    }

    /// Projects `start` onto the interface ([`Indicators::project_onto_interface`]).
    pub fn project(&self, start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        self.indicators.project_onto_interface([self.i, self.j], start, limit, tolerance)
    }

    /// Returns the clearance of the interface at a position in mm ([`Indicators::clearance`]).
    pub fn clearance(&self, grid: DVec3) -> f64 {
        self.indicators.clearance(grid, &[self.i, self.j])
    }
}

/// Returns half the difference of two values, with its gradient.
#[inline(always)]
pub(super) fn half_difference(a: (f64, DVec3), b: (f64, DVec3)) -> (f64, DVec3) {
    (0.5 * (a.0 - b.0), 0.5 * (a.1 - b.1))
}

/// Takes steps until the length of a step is at most `tolerance` (mm). Returns the position before
/// this last step, and the second value of `step` there. Returns `None` after [`PROJECTION_STEPS`]
/// steps, if `step` fails, or if the position moves `limit` (mm) or more from `start`.
#[inline(always)]
pub(super) fn project<T>(
    voxel: f64,
    start: DVec3,
    limit: f64,
    tolerance: f64,
    step: impl Fn(DVec3) -> Option<(DVec3, T)>,
) -> Option<(DVec3, T)> {
    let mut p = start;
    for _ in 0..PROJECTION_STEPS {
        let (step, told) = step(p)?;
        if step.length_squared() <= tolerance * tolerance {
            return Some((p, told));
        }
        p += step.clamp_length_max(0.5 * voxel);
        // also rejects NaN
        if p.distance_squared(start).partial_cmp(&(limit * limit)) != Some(std::cmp::Ordering::Less) {
            return None;
        }
    }
    None
}

/// Returns whether the squared length of a gradient is finite and large enough for a Newton step.
#[inline(always)]
fn is_steep(squared: f64) -> bool {
    squared > LEAST_SQUARED_GRADIENT && squared.is_finite()
}

/// Returns the Newton step onto G = 0 along the gradient of G.
#[inline(always)]
pub(super) fn interface_step(value: f64, gradient: DVec3) -> Option<DVec3> {
    let squared = gradient.length_squared();
    (is_steep(squared) && value.is_finite()).then(|| gradient * (-value / squared))
}

/// Returns the shortest step onto the line where both linearised functions are zero:
/// `-J^T (J J^T)^-1 G`. `G` contains the two values, and the rows of `J` are their gradients.
pub(super) fn curve_step([(u, a), (v, b)]: [(f64, DVec3); 2]) -> Option<DVec3> {
    let (aa, bb, ab) = (a.length_squared(), b.length_squared(), a.dot(b));
    let determinant = aa * bb - ab * ab;
    let crosses = is_steep(aa) && is_steep(bb) && determinant > LEAST_SQUARED_SINE * aa * bb;
    let both = u.is_finite() && v.is_finite();
    (crosses && both).then(|| (a * (v * ab - u * bb) + b * (u * ab - v * aa)) / determinant)
}

/// Returns the Newton step onto the common zero of three functions.
pub(super) fn point_step(rows: [(f64, DVec3); 3]) -> Option<DVec3> {
    let [a, b, c] = rows.map(|(_, gradient)| gradient);
    let squares = [a, b, c].map(DVec3::length_squared);
    let jacobian = DMat3::from_cols(a, b, c).transpose();
    let determinant = jacobian.determinant();
    // the determinant of the unit normals is the product of two sines: of the angle between two
    // interfaces, and of the angle between their curve and the third interface
    let least = LEAST_SQUARED_SINE * squares.iter().product::<f64>();
    let crosses = squares.into_iter().all(is_steep) && determinant * determinant > least;
    let values = DVec3::from_array(rows.map(|(value, _)| value));
    (crosses && values.is_finite()).then(|| -(jacobian.inverse() * values))
}
