//! Computes the curvature of the level sets of F from the gradient and Hessian of F (Goldman,
//! *Curvature formulas for implicit curves and surfaces*, 2005).

use crate::spline::{Jet, LEAST_GRADIENT};
use glam::{DMat3, DVec3};

/// Returns the curvature tensor of the level set through a point, per mm. It is the Hessian divided
/// by the length of the gradient, restricted to the tangent plane. Its eigenvalues are 0 (along the
/// normal) and the two principal curvatures, which are positive on a ball. The tensor is zero if
/// the gradient is shorter than [`LEAST_GRADIENT`].
pub fn curvature_tensor(jet: &Jet) -> DMat3 {
    let slope = jet.gradient.length();
    if slope < LEAST_GRADIENT {
        return DMat3::ZERO;
    }
    let n = jet.gradient / slope;
    let across = DMat3::IDENTITY - DMat3::from_cols(n * n.x, n * n.y, n * n.z);
    across * jet.hessian * across * (1.0 / slope)
}

/// Returns the maximum magnitude of the two principal curvatures, per mm. `tensor` is the curvature
/// tensor of a surface with unit normal n.
pub fn largest_curvature(tensor: &DMat3, n: DVec3) -> f64 {
    let u = n.any_orthonormal_vector();
    let v = n.cross(u);
    let (tu, tv) = (*tensor * u, *tensor * v);
    let (a, b, c) = (u.dot(tu), u.dot(tv), v.dot(tv));
    (0.5 * (a + c)).abs() + (0.5 * (a - c)).hypot(b)
}

/// Returns the mean curvature (half the divergence of the unit normal), per mm. It is 1/R for a
/// ball of radius R.
pub fn mean_curvature(jet: &Jet) -> f64 {
    let slope = jet.gradient.length().max(LEAST_GRADIENT);
    let trace = jet.hessian.x_axis.x + jet.hessian.y_axis.y + jet.hessian.z_axis.z;
    (trace - jet.gradient.dot(jet.hessian * jet.gradient) / (slope * slope)) / (2.0 * slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn on_a_ball_and_on_a_cylinder_curvature_is_what_it_is() {
        let p = DVec3::new(3.0, -2.0, 6.0);
        // F = |p|^2: the level set through p is a sphere of radius 7
        let ball = Jet { value: 0.0, gradient: 2.0 * p, hessian: DMat3::from_diagonal(DVec3::splat(2.0)) };
        assert!((mean_curvature(&ball) - 1.0 / 7.0).abs() < 1e-12);
        assert!((largest_curvature(&curvature_tensor(&ball), p / 7.0) - 1.0 / 7.0).abs() < 1e-12);
        // F = x^2 + y^2: a cylinder along z
        let flat = p.with_z(0.0);
        let hessian = DMat3::from_diagonal(DVec3::new(2.0, 2.0, 0.0));
        let cylinder = Jet { value: 0.0, gradient: 2.0 * flat, hessian };
        let radius = flat.length();
        assert!((mean_curvature(&cylinder) - 0.5 / radius).abs() < 1e-12);
        assert!((largest_curvature(&curvature_tensor(&cylinder), flat / radius) - 1.0 / radius).abs() < 1e-12);
        let none = Jet { value: 0.0, gradient: DVec3::ZERO, hessian };
        assert_eq!(curvature_tensor(&none), DMat3::ZERO);
    }
}
