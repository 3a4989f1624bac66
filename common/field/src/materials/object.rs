//! One object as two materials: itself (1) and the outside (0), with the indicators F and -F. Their
//! half difference G_10 is F.

use super::{Indicators, MaterialId, Near};
use crate::spline::{CubicSpline, Jet};
use glam::DVec3;

/// The indicators of one object and of the outside.
#[derive(Clone, Debug)]
pub struct Object(pub CubicSpline);

impl Object {
    /// Number of the object.
    pub const INSIDE: MaterialId = MaterialId(1);
}

/// Returns the factor of F in the indicator of a material.
fn sign(id: MaterialId) -> f64 {
    if id == Object::INSIDE { 1.0 } else { -1.0 }
}

impl Indicators for Object {
    fn near(&self, grid: DVec3) -> Near {
        let mut near = Near::default();
        let value = self.0.value(grid);
        [MaterialId::OUTSIDE, Self::INSIDE].into_iter().for_each(|id| near.insert(id, sign(id) * value));
        near
    }

    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3) {
        let (value, gradient) = self.0.value_gradient(grid);
        (sign(id) * value, sign(id) * gradient)
    }

    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet {
        let Jet { value, gradient, hessian } = self.0.jet(grid);
        Jet { value: sign(id) * value, gradient: sign(id) * gradient, hessian: hessian * sign(id) }
    }

    fn voxel(&self) -> f64 {
        self.0.voxel()
    }
}
