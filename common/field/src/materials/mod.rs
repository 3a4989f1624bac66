//! Many materials in one space: one smooth indicator F_m for each, the outside included, and the strata where materials meet.
//!
//! After Meyer, Whitaker, Kirby, Ledergerber and Pfister (Particle-based Sampling and Meshing of Surfaces in Multimaterial Volumes, IEEE TVCG 14(6),
//! 2008), with signed distances (mm, negative inside) for indicators: the material at a place is the one with the smallest, so that there are neither
//! gaps nor overlaps. Where the two smallest are equal is a *sheet*, where three are a *junction curve*, where four are a *junction point*.
//!
//! [`Indicators`] is what the algorithms ask, [`Materials`] answers from samples on a grid, [`Analytic`] from functions.

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
    /// What lies outside all that was named.
    pub const OUTSIDE: Self = Self(0);

    /// As an index of the table.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// Most materials, the outside included; the last number means none.
pub const MOST_MATERIALS: usize = u16::MAX as usize;

/// What a material is called and made of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Material {
    /// Its name.
    pub name: String,
    /// Labels of the volume that it is made of.
    pub labels: Vec<LayerLabel>,
}

/// Most indicators that are told of a place: more meet nowhere but in noise, where the largest are left out.
pub const MOST_NEAR: usize = 8;

/// The indicators that are known at a place, smallest first; of equal ones that of the lower number. Minus infinity stands for a material that fills the place,
/// farther from its border than is known.
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
    /// Adds an indicator; the largest is dropped where there is no room.
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

    /// Half the difference of the two smallest indicators, mm: the distance from the nearest sheet, to first order. Infinite where only one is known.
    pub fn interface_distance(&self) -> f64 {
        match self.entries() {
            [(_, first), (_, second), ..] => 0.5 * (second - first),
            _ => f64::INFINITY,
        }
    }
}

/// A jet of a function that is far from zero: infinite, without slope.
pub(crate) fn far(inside: bool) -> Jet {
    let value = if inside { f64::NEG_INFINITY } else { f64::INFINITY };
    Jet { value, gradient: DVec3::ZERO, hessian: DMat3::ZERO }
}

/// The indicators F_m of some materials: signed distances, mm, negative inside, derivatives per mm; positions in the grid frame, mm. An indicator that is not known
/// at a place counts as infinite by its sign there, without slope.
///
/// The methods that have a body are the geometry of strata, the same for all indicators.
pub trait Indicators: Sync {
    /// The indicators that are known at a place, smallest first.
    fn near(&self, grid: DVec3) -> Near;

    /// F_m and its gradient.
    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3);

    /// F_m, gradient and Hessian.
    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet;

    /// Length over which indicators can be trusted to be smooth, mm: the mean spacing of voxels. No step of a projection is longer than half of it.
    fn voxel(&self) -> f64;

    /// The material at a place: that with the smallest indicator.
    fn material_at(&self, grid: DVec3) -> MaterialId {
        self.near(grid).first().unwrap_or(MaterialId::OUTSIDE)
    }

    /// The difference of two indicators as a function of its own.
    fn sheet(&self, i: MaterialId, j: MaterialId) -> Sheet<'_, Self>
    where
        Self: Sized,
    {
        Sheet { indicators: self, i, j }
    }

    /// G_ij = (F_i - F_j) / 2, mm, negative where i is nearer, with gradient and Hessian: slope near 1 on a sheet, since F_j is about -F_i there.
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

    /// Whether the sheet of two materials is real at a place on it: its [`Self::clearance`] is positive.
    #[inline(always)]
    fn is_real_sheet(&self, own: [MaterialId; 2], grid: DVec3) -> bool {
        self.clearance(grid, &own) > 0.0
    }

    /// How real a stratum of the materials `own` is at a place, mm: the smallest indicator of all others less the largest of their own. Positive where these are the
    /// smallest; infinite where no other is known, minus infinity where one of their own is not.
    fn clearance(&self, grid: DVec3, own: &[MaterialId]) -> f64 {
        let near = self.near(grid);
        let others = near.entries().iter().filter(|(id, _)| !own.contains(id));
        let smallest = others.map(|(_, value)| *value).fold(f64::INFINITY, f64::min);
        let value = |id: &MaterialId| near.entries().iter().find(|(known, _)| known == id).map(|(_, value)| *value);
        let largest = own.iter().map(|id| value(id).unwrap_or(f64::INFINITY)).fold(f64::NEG_INFINITY, f64::max);
        if largest == f64::INFINITY { f64::NEG_INFINITY } else { smallest - largest }
    }

    /// The point of the sheet of two materials near `start`, by Newton steps along the gradient of G_ij. `limit` is the longest total move (mm); `None` when the
    /// point runs away, the gradient vanishes or an indicator is not known, or when [`crate::spline::PROJECTION_STEPS`] do not bring the sheet, to first
    /// order, nearer than `tolerance` (mm). Whether the two are the smallest there, [`Self::clearance`] tells.
    fn project_onto_sheet(&self, own: [MaterialId; 2], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let (value, gradient) = self.difference_gradient(own[0], own[1], p);
            strata::sheet_step(value, gradient).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }

    /// As [`Self::project_onto_sheet`], with the gradient of G_ij at the place reached; `None` too where the sheet is not real, because another material is as
    /// near there as the two ([`Self::is_real_sheet`]).
    #[inline(always)]
    fn place_on_sheet(&self, own: [MaterialId; 2], start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        let place = strata::project(self.voxel(), start, limit, tolerance, |p| {
            let (value, gradient) = self.difference_gradient(own[0], own[1], p);
            strata::sheet_step(value, gradient).map(|step| (step, gradient))
        });
        place.filter(|&(p, _)| self.is_real_sheet(own, p))
    }

    /// The point of the junction curve of three materials near `start`: Gauss-Newton on G_ij = G_ik = 0, by steps of the least length. Limit and tolerance as for
    /// [`Self::project_onto_sheet`]; `None` too where the sheets are tangent ([`LEAST_SQUARED_SINE`]).
    fn project_onto_curve(&self, own: [MaterialId; 3], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let [first, second, third] = own.map(|id| self.value_gradient(id, p));
            let differences = [strata::half_difference(first, second), strata::half_difference(first, third)];
            strata::curve_step(differences).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }

    /// The junction point of four materials near `start`: Newton's method on G_ij = G_ik = G_il = 0. Limit and tolerance as for
    /// [`Self::project_onto_sheet`]; `None` too where the curves are tangent ([`LEAST_SQUARED_SINE`]).
    fn project_onto_point(&self, own: [MaterialId; 4], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let [first, others @ ..] = own.map(|id| self.value_gradient(id, p));
            strata::point_step(others.map(|other| strata::half_difference(first, other))).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }
}
