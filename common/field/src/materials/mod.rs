//! Represents many materials in one space: a smooth indicator F_m for each material, including the
//! outside, and the strata where materials meet.
//!
//! The method follows Meyer, Whitaker, Kirby, Ledergerber and Pfister (Particle-based Sampling and
//! Meshing of Surfaces in Multimaterial Volumes, IEEE TVCG 14(6), 2008), with signed distances (mm,
//! negative inside) as indicators. The material at a position is the material with the smallest
//! indicator, so there are neither gaps nor overlaps. The two smallest indicators are equal on a
//! *material interface*, the three smallest on a *junction curve*, and the four smallest at a
//! *junction point*. Interfaces, curves and points are called *strata*.
//!
//! Algorithms access indicators through the trait [`Indicators`]. [`Materials`] implements it for
//! samples on a grid, [`Object`] for the spline of one object, and [`Analytic`] for functions.

mod analytic;
mod bounded;
pub mod complex;
mod error;
mod euler;
mod index;
mod indicator;
mod object;
mod strata;
mod stratum;
#[cfg(test)]
mod tests;

pub use analytic::{Analytic, ball, half_space, maximum, minimum, negative};
pub use bounded::{Bound, Bounded};
pub use error::Error;
pub use euler::{EulerPair, euler_pairs};
pub use index::{Materials, ON_INTERFACE};
pub use indicator::{BLOCK, CELLS, Indicator, IndicatorParts, KNOWN_VOXELS, bricks_along};
pub use object::Object;
pub use strata::{InterfaceFunction, LEAST_SQUARED_SINE};
pub use stratum::Stratum;

use crate::spline::{Jet, distance_estimate};
use glam::{DMat3, DVec3};
use isoparticles_volume::LayerLabel;
use serde::{Deserialize, Serialize};

/// Index of a material in the table of materials; 0 is the outside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct MaterialId(pub u16);

impl MaterialId {
    /// The outside: the space that no other material covers.
    pub const OUTSIDE: Self = Self(0);

    /// Returns the region of the material: the outside for the space beyond a plane, otherwise the
    /// material itself. `first_beyond` is the number of the space beyond the first plane.
    pub fn region(self, first_beyond: Option<Self>) -> Self {
        if first_beyond.is_some_and(|first| self >= first) { Self::OUTSIDE } else { self }
    }

    /// Returns the number as an index into the table.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// Maximum number of materials, including the outside. The number 65535 is reserved for "no
/// material".
pub const MOST_MATERIALS: usize = u16::MAX as usize;

/// Name and labels of a material.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Material {
    /// Name of the material.
    pub name: String,
    /// Labels whose voxels make up the material.
    pub labels: Vec<LayerLabel>,
}

/// Maximum number of indicators returned for one position. A position lies between eight voxel
/// centres, which have at most eight different labels. If more indicators are known, the largest
/// are dropped.
pub const MOST_NEAR: usize = 8;

/// The indicators known at a position, smallest first. Equal indicators are ordered by material
/// number. If a material fills the surroundings of the position but its indicator is not known
/// there, its value is minus infinity.
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
    /// Adds an indicator. If there is no room, the largest indicator is dropped.
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

    /// Returns the materials with their indicators in mm, smallest first.
    pub fn entries(&self) -> &[(MaterialId, f64)] {
        &self.entries[..self.count]
    }

    /// Returns the indicator of a material in mm, or infinity if it is not known.
    pub fn value(&self, id: MaterialId) -> f64 {
        self.entries().iter().find(|(known, _)| *known == id).map_or(f64::INFINITY, |(_, value)| *value)
    }

    /// Returns the material with the smallest indicator, if any indicator is known.
    pub fn first(&self) -> Option<MaterialId> {
        self.entries().first().map(|(id, _)| *id)
    }

    /// Returns a first-order estimate of the distance (mm) to the nearest interface: half the
    /// difference of the two smallest indicators. It is infinite if fewer than two indicators are
    /// known.
    pub fn interface_distance(&self) -> f64 {
        match self.entries() {
            [(_, first), (_, second), ..] => 0.5 * (second - first),
            _ => f64::INFINITY,
        }
    }
}

/// Returns the jet of an indicator at a position where it is not known: an infinite value, negative
/// if `inside` is true, and zero derivatives.
pub(crate) fn far(inside: bool) -> Jet {
    let value = if inside { f64::NEG_INFINITY } else { f64::INFINITY };
    Jet { value, gradient: DVec3::ZERO, hessian: DMat3::ZERO }
}

/// The indicators F_m of a set of materials: signed distances in mm, negative inside. Positions are
/// in the grid frame, mm. Derivatives are per mm. An indicator that is not known at a position is
/// infinite there, with the correct sign and zero derivatives.
///
/// The default methods compute the geometry of strata for any implementation.
pub trait Indicators: Sync {
    /// Returns the indicators that are known at a position, smallest first.
    fn near(&self, grid: DVec3) -> Near;

    /// Returns F_m and its gradient.
    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3);

    /// Returns F_m, its gradient and its Hessian.
    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet;

    /// Returns the length scale of the indicators in mm: the mean voxel spacing. Projection steps
    /// are limited to half of this length.
    fn voxel(&self) -> f64;

    /// Returns the material at a position: the material with the smallest indicator, or the outside
    /// if no indicator is known.
    fn material_at(&self, grid: DVec3) -> MaterialId {
        self.near(grid).first().unwrap_or(MaterialId::OUTSIDE)
    }

    /// Returns the number of the space beyond the first plane, if the materials end at planes
    /// ([`Bounded`]). The spaces beyond planes have this number and all higher ones.
    fn first_beyond(&self) -> Option<MaterialId> {
        None
    }

    /// Returns the region of a material ([`MaterialId::region`]). A mesh has no triangles within a
    /// region.
    fn region(&self, id: MaterialId) -> MaterialId {
        id.region(self.first_beyond())
    }

    /// Returns whether a material is the space beyond a plane.
    fn is_beyond(&self, id: MaterialId) -> bool {
        self.region(id) != id
    }

    /// Returns whether materials belong to at least two regions.
    fn are_separate(&self, ids: &[MaterialId]) -> bool {
        ids.iter().any(|&id| self.region(id) != self.region(ids[0]))
    }

    /// Returns F_i - F_j (mm), given the indicators known at a position. The value is not finite if
    /// one of them is not known.
    #[inline(always)]
    fn difference_of(&self, near: &Near, _grid: DVec3, i: MaterialId, j: MaterialId) -> f64 {
        near.value(i) - near.value(j)
    }

    /// Returns half the difference of two indicators, G_ij = (F_i - F_j) / 2, as a function.
    fn interface(&self, i: MaterialId, j: MaterialId) -> InterfaceFunction<'_, Self>
    where
        Self: Sized,
    {
        InterfaceFunction { indicators: self, i, j }
    }

    /// Returns G_ij = (F_i - F_j) / 2 in mm, negative where F_i is the smaller, with its gradient
    /// and Hessian. The slope of G_ij is close to 1 on an interface, because F_j is about -F_i
    /// there.
    fn difference(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> Jet {
        let (a, b) = (self.jet(i, grid), self.jet(j, grid));
        Jet {
            value: 0.5 * (a.value - b.value),
            gradient: 0.5 * (a.gradient - b.gradient),
            hessian: (a.hessian - b.hessian) * 0.5,
        }
    }

    /// Returns G_ij and its gradient.
    #[inline(always)]
    fn difference_gradient(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> (f64, DVec3) {
        strata::half_difference(self.value_gradient(i, grid), self.value_gradient(j, grid))
    }

    /// Returns whether the interface of two materials is real at a position on it, that is, whether
    /// its [`Self::clearance`] is positive.
    #[inline(always)]
    fn is_real_interface(&self, own: [MaterialId; 2], grid: DVec3) -> bool {
        self.clearance(grid, &own) > 0.0
    }

    /// Returns the clearance of the stratum of the materials `own` at a position in mm: the
    /// smallest indicator of all other materials minus the largest indicator of `own`. The stratum
    /// is real where the clearance is positive. The clearance is infinite if no other material is
    /// known, and minus infinity if a material of `own` is not known.
    fn clearance(&self, grid: DVec3, own: &[MaterialId]) -> f64 {
        let near = self.near(grid);
        let others = near.entries().iter().filter(|(id, _)| !own.contains(id));
        let smallest = others.map(|(_, value)| *value).fold(f64::INFINITY, f64::min);
        let largest = own.iter().map(|&id| near.value(id)).fold(f64::NEG_INFINITY, f64::max);
        if largest == f64::INFINITY { f64::NEG_INFINITY } else { smallest - largest }
    }

    /// Projects `start` onto the interface of two materials by Newton steps along the gradient of
    /// G_ij. Returns `None` if the position moves `limit` (mm) or more from `start`, the gradient
    /// vanishes, or an indicator is not known. Also returns `None` if
    /// [`crate::spline::PROJECTION_STEPS`] steps do not bring the position within `tolerance` (mm)
    /// of the interface, to first order. Does not check whether the two materials have the smallest
    /// indicators at the result ([`Self::clearance`]).
    fn project_onto_interface(&self, own: [MaterialId; 2], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let (value, gradient) = self.difference_gradient(own[0], own[1], p);
            strata::interface_step(value, gradient).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }

    /// Projects `start` like [`Self::project_onto_interface`]. Returns the projected position and
    /// the gradient of G_ij there. Also returns `None` if the interface is not real at this
    /// position ([`Self::is_real_interface`]).
    #[inline(always)]
    fn place_on_interface(
        &self,
        own: [MaterialId; 2],
        start: DVec3,
        limit: f64,
        tolerance: f64,
    ) -> Option<(DVec3, DVec3)> {
        let place = strata::project(self.voxel(), start, limit, tolerance, |p| {
            let (value, gradient) = self.difference_gradient(own[0], own[1], p);
            strata::interface_step(value, gradient).map(|step| (step, gradient))
        });
        place.filter(|&(p, _)| self.is_real_interface(own, p))
    }

    /// Projects `start` onto the junction curve of three materials by the Gauss-Newton method on
    /// G_ij = G_ik = 0, with minimum-norm steps. `limit` and `tolerance` are as in
    /// [`Self::project_onto_interface`]. Also returns `None` if the interfaces are nearly tangent
    /// ([`LEAST_SQUARED_SINE`]).
    fn project_onto_curve(&self, own: [MaterialId; 3], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let [first, second, third] = own.map(|id| self.value_gradient(id, p));
            let differences = [strata::half_difference(first, second), strata::half_difference(first, third)];
            strata::curve_step(differences).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }

    /// Projects `start` onto the junction point of four materials by Newton's method on
    /// G_ij = G_ik = G_il = 0. `limit` and `tolerance` are as in [`Self::project_onto_interface`].
    /// Also returns `None` if two interfaces, or a curve and an interface, are nearly tangent
    /// ([`LEAST_SQUARED_SINE`]).
    fn project_onto_point(&self, own: [MaterialId; 4], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        strata::project(self.voxel(), start, limit, tolerance, |p| {
            let [first, others @ ..] = own.map(|id| self.value_gradient(id, p));
            strata::point_step(others.map(|other| strata::half_difference(first, other))).map(|step| (step, ()))
        })
        .map(|(p, ())| p)
    }

    /// Projects `start` onto a stratum: an interface ([`Self::project_onto_interface`]), a curve
    /// ([`Self::project_onto_curve`]) or a point ([`Self::project_onto_point`]).
    fn project_onto(&self, stratum: Stratum, start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        match *stratum.materials() {
            [i, j] => self.project_onto_interface([i, j], start, limit, tolerance),
            [i, j, k] => self.project_onto_curve([i, j, k], start, limit, tolerance),
            [i, j, k, l] => self.project_onto_point([i, j, k, l], start, limit, tolerance),
            _ => None,
        }
    }

    /// Projects `start` onto the interface of two materials, or onto the nearest junction curve of
    /// more materials, which are ascending. `limit` and `tolerance` are as in
    /// [`Self::project_onto`]. Also returns `None` unless the interface or curve is real at the
    /// result, to within [`complex::SAME_JUNCTION`].
    fn project_onto_meeting(&self, own: &[MaterialId], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        let least = -complex::SAME_JUNCTION * self.voxel();
        let place = |own: &[MaterialId]| {
            let place = self.project_onto(Stratum::new(own)?, start, limit, tolerance)?;
            (self.clearance(place, own) > least).then_some(place)
        };
        if own.len() < 3 {
            return place(own);
        }
        let later = |i: usize| (i + 1..own.len()).map(move |j| [i, j]);
        let three = (0..own.len()).flat_map(later).flat_map(|[i, j]| (j + 1..own.len()).map(move |k| [i, j, k]));
        let places = three.filter_map(|three| place(&three.map(|n| own[n])));
        places.min_by(|a, b| a.distance_squared(start).total_cmp(&b.distance_squared(start)))
    }

    /// Returns the largest first-order distance (mm) of a position from an interface of two of the
    /// materials `own`. It is not finite if an indicator is not known there.
    fn distance_from_meeting(&self, own: &[MaterialId], grid: DVec3) -> f64 {
        let all: Vec<(f64, DVec3)> = own.iter().map(|&id| self.value_gradient(id, grid)).collect();
        let pairs = all.iter().enumerate().flat_map(|(n, a)| all[..n].iter().map(move |b| (*a, *b)));
        let distance = |(a, b)| {
            let (value, gradient) = strata::half_difference(a, b);
            distance_estimate(value, gradient).abs()
        };
        pairs.map(distance).fold(0.0, |largest, own| if own.is_nan() { f64::INFINITY } else { largest.max(own) })
    }
}
