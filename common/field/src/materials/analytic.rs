//! Indicators given as functions: balls, half spaces, and their unions, intersections and
//! complements. They are used in tests of shapes with known strata.

use super::{Indicators, MaterialId, Near};
use crate::spline::Jet;
use glam::{DMat3, DVec3};

/// A function of the grid position (mm) that also returns its derivatives.
type Function = Box<dyn Fn(DVec3) -> Jet + Send + Sync>;

/// Indicators given as one function per material.
pub struct Analytic {
    functions: Vec<Function>,
    voxel: f64,
}

impl Analytic {
    /// Creates the indicators. `voxel` (mm) is the length scale of the functions
    /// ([`Indicators::voxel`]).
    pub fn new(functions: Vec<Function>, voxel: f64) -> Self {
        Self { functions, voxel }
    }

    /// Returns the numbers of the materials.
    pub fn ids(&self) -> impl Iterator<Item = MaterialId> + use<> {
        (0..self.functions.len() as u16).map(MaterialId)
    }
}

impl Indicators for Analytic {
    fn near(&self, grid: DVec3) -> Near {
        let mut near = Near::default();
        self.ids().for_each(|id| near.insert(id, self.jet(id, grid).value));
        near
    }

    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3) {
        let jet = self.jet(id, grid);
        (jet.value, jet.gradient)
    }

    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet {
        self.functions[id.index()](grid)
    }

    fn voxel(&self) -> f64 {
        self.voxel
    }
}

/// Returns the signed distance (mm) from a ball, negative inside.
pub fn ball(centre: DVec3, radius: f64) -> Function {
    Box::new(move |p| {
        let (away, length) = (p - centre, p.distance(centre));
        let normal = away.normalize_or_zero();
        let outer = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        let hessian = if length > 0.0 { (DMat3::IDENTITY - outer) * (1.0 / length) } else { DMat3::ZERO };
        Jet { value: length - radius, gradient: normal, hessian }
    })
}

/// Returns the signed distance (mm) from the plane through `point`. It is negative on the side
/// opposite to the unit normal.
pub fn half_space(point: DVec3, normal: DVec3) -> Function {
    Box::new(move |p| Jet { value: (p - point).dot(normal), gradient: normal, hessian: DMat3::ZERO })
}

/// Returns the maximum of two functions: the intersection of the regions where they are negative.
pub fn maximum(a: Function, b: Function) -> Function {
    Box::new(move |p| {
        let (a, b) = (a(p), b(p));
        if a.value >= b.value { a } else { b }
    })
}

/// Returns the minimum of two functions: the union of the regions where they are negative.
pub fn minimum(a: Function, b: Function) -> Function {
    negative(maximum(negative(a), negative(b)))
}

/// Returns the negative of a function: the complement of the region where it is negative.
pub fn negative(a: Function) -> Function {
    Box::new(move |p| {
        let Jet { value, gradient, hessian } = a(p);
        Jet { value: -value, gradient: -gradient, hessian: hessian * -1.0 }
    })
}
