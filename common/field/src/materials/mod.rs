//! Many materials in one space: one smooth indicator F_m for each, the outside included, and the
//! strata where materials meet.
//!
//! After Meyer, Whitaker, Kirby, Ledergerber and Pfister (Particle-based Sampling and Meshing of
//! Surfaces in Multimaterial Volumes, IEEE TVCG 14(6), 2008), with signed distances (mm, negative
//! inside) as indicators. The material at a position is the one with the smallest indicator, so
//! there are neither gaps nor overlaps. The two smallest indicators are equal on a material
//! interface (*sheet* in the code), the three smallest on a *junction curve*, the four smallest at
//! a *junction point*. All three are *strata*.
//!
//! [`Indicators`] is the interface for algorithms. [`Materials`] implements it for samples on a
//! grid, [`Analytic`] for functions.

mod analytic;
pub mod complex;
mod error;
mod index;
mod indicator;
mod strata;
mod stratum;
#[cfg(test)]
mod tests;

pub use analytic::{Analytic, ball, half_space, maximum, minimum, negative};
pub use error::Error;
pub use index::{Materials, ON_SHEET};
pub use indicator::{BLOCK, CELLS, Indicator, IndicatorParts, KNOWN_VOXELS, bricks_along};
pub use strata::{LEAST_SQUARED_SINE, Sheet};
pub use stratum::Stratum;

use crate::spline::Jet;
use glam::{DMat3, DVec3};
use isoparticles_volume::LayerLabel;
use serde::{Deserialize, Serialize};

/// Number of a material in its table; 0 is the outside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct MaterialId(pub u16);

impl MaterialId {
    /// The outside: everything that no other material covers.
    pub const OUTSIDE: Self = Self(0);

    /// The number as an index of the table.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// Maximum number of materials, the outside included. The number 65535 itself means none.
pub const MOST_MATERIALS: usize = u16::MAX as usize;

/// Name and labels of a material.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Material {
    /// Its name.
    pub name: String,
    /// Labels of the volume that belong to it.
    pub labels: Vec<LayerLabel>,
}

/// Maximum number of indicators returned for one position. More materials meet only in noise; the
/// largest indicators are dropped there.
pub const MOST_NEAR: usize = 8;

/// The indicators known at a position, smallest first; equal ones by material number. Minus
/// infinity stands for a material that fills the surroundings, farther from its border than its
/// indicator is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    entries: [(MaterialId, f64); MOST_NEAR],
    count: usize,
}

impl Default for Near {
    fn default() -> Self {
        Self { entries: [(MaterialId::OUTSIDE, f64::INFINITY); MOST_NEAR], count: 0 }
    }
}

impl Near {
    /// Adds an indicator; if there is no room, the largest is dropped.
    #[inline]
    pub fn insert(&mut self, id: MaterialId, value: f64) {
        let is_before = |other: &(MaterialId, f64)| (value, id) < (other.1, other.0);
        let at = self.entries[..self.count].iter().position(is_before).unwrap_or(self.count);
        if at < MOST_NEAR {
            let end = (self.count + 1).min(MOST_NEAR);
            self.entries.copy_within(at..end - 1, at + 1);
            self.entries[at] = (id, value);
            self.count = end;
        }
    }

    /// The materials with their indicators, mm, smallest first.
    pub fn entries(&self) -> &[(MaterialId, f64)] {
        &self.entries[..self.count]
    }

    /// The material with the smallest indicator, if any is known.
    pub fn first(&self) -> Option<MaterialId> {
        self.entries().first().map(|(id, _)| *id)
    }

    /// Half the difference of the two smallest indicators, mm: the distance to the nearest
    /// interface, to first order. Infinite if fewer than two are known.
    pub fn interface_distance(&self) -> f64 {
        match self.entries() {
            [(_, first), (_, second), ..] => 0.5 * (second - first),
            _ => f64::INFINITY,
        }
    }
}

/// The jet of an indicator far from its border: infinite, with zero derivatives.
pub(crate) fn far(inside: bool) -> Jet {
    let value = if inside { f64::NEG_INFINITY } else { f64::INFINITY };
    Jet { value, gradient: DVec3::ZERO, hessian: DMat3::ZERO }
}

/// The indicators F_m of some materials: signed distances, mm, negative inside, with derivatives
/// per mm; positions in the grid frame, mm. An indicator that is not known at a position is
/// infinite there, with its sign and zero derivatives.
///
/// The provided methods are the geometry of strata, the same for all indicators.
pub trait Indicators: Sync {
    /// The indicators that are known at a position, smallest first.
    fn near(&self, grid: DVec3) -> Near;

    /// F_m and its gradient.
    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3);

    /// F_m, gradient and Hessian.
    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet;

    /// Length over which indicators are smooth, mm: the mean voxel spacing. Projection steps are
    /// limited to half of it.
    fn voxel(&self) -> f64;

    /// The material at a position: the one with the smallest indicator, or the outside if none is
    /// known.
    fn material_at(&self, grid: DVec3) -> MaterialId {
        self.near(grid).first().unwrap_or(MaterialId::OUTSIDE)
    }

    /// The difference of two indicators as a function.
    fn sheet(&self, i: MaterialId, j: MaterialId) -> Sheet<'_, Self>
    where
        Self: Sized,
    {
        Sheet { indicators: self, i, j }
    }

    /// G_ij = (F_i - F_j) / 2, mm, negative where i is nearer, with gradient and Hessian. Its slope
    /// is near 1 on an interface, since F_j is about -F_i there.
    fn difference(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> Jet {
        let (a, b) = (self.jet(i, grid), self.jet(j, grid));
        Jet {
            value: 0.5 * (a.value - b.value),
            gradient: 0.5 * (a.gradient - b.gradient),
            hessian: (a.hessian - b.hessian) * 0.5,
        }
    }

    /// G_ij and its gradient.
    #[inline(always)]
    fn difference_gradient(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> (f64, DVec3) {
        strata::half_difference(self.value_gradient(i, grid), self.value_gradient(j, grid))
    }

    /// Whether the interface of two materials is real at a position on it: its [`Self::clearance`]
    /// is positive.
    #[inline(always)]
    fn is_real_sheet(&self, own: [MaterialId; 2], grid: DVec3) -> bool {
        self.clearance(grid, &own) > 0.0
    }

    /// Clearance of the stratum of the materials `own` at a position, mm: the smallest indicator of
    /// all others minus the largest of their own. The stratum is real where this is positive.
    /// Infinite where no other is known, minus infinity where one of their own is not.
    fn clearance(&self, grid: DVec3, own: &[MaterialId]) -> f64 {
        let near = self.near(grid);
        let others = near.entries().iter().filter(|(id, _)| !own.contains(id));
        let smallest = others.map(|(_, value)| *value).fold(f64::INFINITY, f64::min);
        let value = |id: &MaterialId| near.entries().iter().find(|(known, _)| known == id).map(|(_, value)| *value);
        let largest = own.iter().map(|id| value(id).unwrap_or(f64::INFINITY)).fold(f64::NEG_INFINITY, f64::max);
        if largest == f64::INFINITY { f64::NEG_INFINITY } else { smallest - largest }
    }

    /// Projects `start` onto the interface of two materials by Newton steps along the gradient of
    /// G_ij. `limit` is the longest total move (mm). `None` if the position moves farther, the
    /// gradient vanishes, an indicator is not known, or [`crate::spline::PROJECTION_STEPS`] do not
    /// bring it within `tolerance` (mm) of the interface, to first order. Whether the two materials
    /// are the smallest there is not checked ([`Self::clearance`]).
    fn project_onto_sheet(&self, own: [MaterialId; 2], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let (value, gradient) = self.difference_gradient(own[0], own[1], p);
            strata::sheet_step(value, gradient).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }

    /// As [`Self::project_onto_sheet`], with the gradient of G_ij at the position reached. `None`
    /// also if the interface is not real there ([`Self::is_real_sheet`]).
    #[inline(always)]
    fn place_on_sheet(&self, own: [MaterialId; 2], start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        let place = strata::project(self.voxel(), start, limit, tolerance, |p| {
            let (value, gradient) = self.difference_gradient(own[0], own[1], p);
            strata::sheet_step(value, gradient).map(|step| (step, gradient))
        });
        place.filter(|&(p, _)| self.is_real_sheet(own, p))
    }

    /// Projects `start` onto the junction curve of three materials: Gauss-Newton on G_ij = G_ik = 0
    /// with steps of minimum length. Limit and tolerance as in [`Self::project_onto_sheet`]. `None`
    /// also if the interfaces are tangent ([`LEAST_SQUARED_SINE`]).
    fn project_onto_curve(&self, own: [MaterialId; 3], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let [first, second, third] = own.map(|id| self.value_gradient(id, p));
            let differences = [strata::half_difference(first, second), strata::half_difference(first, third)];
            strata::curve_step(differences).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }

    /// Projects `start` onto the junction point of four materials: Newton's method on
    /// G_ij = G_ik = G_il = 0. Limit and tolerance as in [`Self::project_onto_sheet`]. `None` also
    /// if the curves are tangent ([`LEAST_SQUARED_SINE`]).
    fn project_onto_point(&self, own: [MaterialId; 4], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let [first, others @ ..] = own.map(|id| self.value_gradient(id, p));
            strata::point_step(others.map(|other| strata::half_difference(first, other))).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }
}
