//! Ends materials at planes, such as the faces of the volume.
//!
//! The space beyond each plane is an additional material; these materials have the numbers after
//! all others. The indicator is F_b = F_m - 2 s, where F_m is the smallest indicator of a material
//! other than the outside, and s is the signed distance from the plane (mm), positive beyond it.
//! The difference G_mb = (F_m - F_b) / 2 is then s, so the interface is the plane itself, and its
//! rim is a junction curve. The outside and the spaces beyond all planes form one *region*
//! ([`Indicators::region`]); there are no interfaces within a region.

use super::strata::half_difference;
use super::{Indicators, KNOWN_VOXELS, MaterialId, Near, far};
use crate::spline::Jet;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;

/// Depth, in mean voxel spacings, that replaces an infinite one deep inside a material. Only
/// F_m - F_b is used there, which does not depend on F_m: no interface of two materials is nearer
/// than [`KNOWN_VOXELS`].
const DEEP: f64 = KNOWN_VOXELS as f64;

/// A plane at which materials end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bound {
    /// Name of the triangles in the plane.
    pub name: String,
    /// A point of the plane in the grid frame, mm.
    pub point: DVec3,
    /// Unit normal in the grid frame. It points away from the materials.
    pub normal: DVec3,
}

impl Bound {
    /// Returns the signed distance (mm) of a position from the plane, positive beyond it.
    pub fn distance(&self, grid: DVec3) -> f64 {
        (grid - self.point).dot(self.normal)
    }

    /// Returns whether an axis-aligned box lies before the plane (less), crosses it (equal) or lies
    /// beyond it (greater). The box is given by its centre and half its size, mm.
    pub fn side_of_box(&self, centre: DVec3, half: DVec3) -> Ordering {
        let (distance, reach) = (self.distance(centre), self.normal.abs().dot(half));
        if distance.abs() <= reach { Ordering::Equal } else { distance.total_cmp(&0.0) }
    }
}

/// Indicators of materials that end at planes.
pub struct Bounded<'a, I> {
    /// Indicators of the materials, which continue beyond the planes.
    inner: I,
    bounds: &'a [Bound],
    /// Number of the space beyond the first plane.
    first: u16,
    /// Distance from a plane (mm) within which the indicator of the space beyond it is known.
    reach: f64,
}

impl<'a, I: Indicators> Bounded<'a, I> {
    /// Ends materials at planes. `first` is the number of the space beyond the first plane, which
    /// follows the numbers of all materials of `inner`. `diagonal` is the diagonal of a grid cell
    /// (mm). The spaces beyond planes are then known at both ends of every edge that crosses a
    /// plane when cells are cut into tetrahedra ([`super::complex`]).
    pub fn new(inner: I, bounds: &'a [Bound], first: MaterialId, diagonal: f64) -> Self {
        Self { inner, bounds, first: first.0, reach: diagonal * (1.0 + 1e-9) }
    }

    /// Returns the plane of a material that is the space beyond a plane.
    fn bound(&self, id: MaterialId) -> Option<&'a Bound> {
        self.bounds.get(usize::from(id.0.checked_sub(self.first)?))
    }

    /// Returns the spaces beyond planes whose indicators are known at a position, with the signed
    /// distances from the planes.
    fn near_bounds(&self, grid: DVec3) -> impl Iterator<Item = (MaterialId, f64)> {
        let least = -self.reach;
        let all = (self.first..).map(MaterialId).zip(self.bounds);
        all.map(move |(id, bound)| (id, bound.distance(grid))).filter(move |(_, distance)| *distance > least)
    }

    /// Returns the material other than the outside with the smallest indicator at a position.
    fn nearest(&self, grid: DVec3) -> Option<MaterialId> {
        let near = self.inner.near(grid);
        near.entries().iter().map(|(id, _)| *id).find(|id| *id != MaterialId::OUTSIDE)
    }

    /// Replaces minus infinity, the indicator deep inside a material, by a finite value.
    fn finite(&self, value: f64) -> f64 {
        value.max(-DEEP * self.inner.voxel())
    }

    /// Returns the plane between two materials, and the sign of its distance s in G_ij. Returns
    /// `None` unless exactly one of the materials is the space beyond a plane, and the other is not
    /// the outside. This other material is taken as the one with the indicator F_m.
    fn plane_between(&self, i: MaterialId, j: MaterialId) -> Option<(&'a Bound, f64)> {
        match (self.bound(i), self.bound(j)) {
            (None, Some(bound)) if i != MaterialId::OUTSIDE => Some((bound, 1.0)),
            (Some(bound), None) if j != MaterialId::OUTSIDE => Some((bound, -1.0)),
            _ => None,
        }
    }
}

impl<I: Indicators> Indicators for Bounded<'_, I> {
    #[inline]
    fn near(&self, grid: DVec3) -> Near {
        let near = self.inner.near(grid);
        let mut bounds = self.near_bounds(grid).peekable();
        let nearest = near.entries().iter().find(|(id, _)| *id != MaterialId::OUTSIDE);
        let Some(&(_, value)) = nearest.filter(|_| bounds.peek().is_some()) else { return near };
        let mut all = Near::default();
        near.entries().iter().for_each(|&(id, value)| all.insert(id, self.finite(value)));
        bounds.for_each(|(id, distance)| all.insert(id, self.finite(value) - 2.0 * distance));
        all
    }

    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3) {
        let of = |id: MaterialId| {
            let (value, gradient) = self.inner.value_gradient(id, grid);
            let is_near = value == f64::NEG_INFINITY && self.near_bounds(grid).next().is_some();
            (if is_near { self.finite(value) } else { value }, gradient)
        };
        let Some(bound) = self.bound(id) else { return of(id) };
        let Some(nearest) = self.nearest(grid) else { return (far(false).value, DVec3::ZERO) };
        let (value, gradient) = of(nearest);
        (value - 2.0 * bound.distance(grid), gradient - 2.0 * bound.normal)
    }

    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet {
        let (value, gradient) = self.value_gradient(id, grid);
        let nearest = if self.bound(id).is_some() { self.nearest(grid) } else { Some(id) };
        let hessian = nearest.map_or(DMat3::ZERO, |nearest| self.inner.jet(nearest, grid).hessian);
        Jet { value, gradient, hessian }
    }

    fn voxel(&self) -> f64 {
        self.inner.voxel()
    }

    fn first_beyond(&self) -> Option<MaterialId> {
        (!self.bounds.is_empty()).then_some(MaterialId(self.first))
    }

    #[inline(always)]
    fn difference_of(&self, near: &Near, grid: DVec3, i: MaterialId, j: MaterialId) -> f64 {
        let plane = self.plane_between(i, j).map(|(bound, sign)| 2.0 * sign * bound.distance(grid));
        plane.unwrap_or_else(|| near.value(i) - near.value(j))
    }

    fn difference(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> Jet {
        if let Some((bound, sign)) = self.plane_between(i, j) {
            return Jet { value: sign * bound.distance(grid), gradient: sign * bound.normal, hessian: DMat3::ZERO };
        }
        if self.bound(i).is_none() && self.bound(j).is_none() {
            return self.inner.difference(i, j, grid);
        }
        let (a, b) = (self.jet(i, grid), self.jet(j, grid));
        let (value, gradient) = half_difference((a.value, a.gradient), (b.value, b.gradient));
        Jet { value, gradient, hessian: (a.hessian - b.hessian) * 0.5 }
    }

    #[inline(always)]
    fn difference_gradient(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> (f64, DVec3) {
        if let Some((bound, sign)) = self.plane_between(i, j) {
            return (sign * bound.distance(grid), sign * bound.normal);
        }
        if self.bound(i).is_none() && self.bound(j).is_none() {
            return self.inner.difference_gradient(i, j, grid);
        }
        half_difference(self.value_gradient(i, grid), self.value_gradient(j, grid))
    }

    #[inline(always)]
    fn is_real_interface(&self, own: [MaterialId; 2], grid: DVec3) -> bool {
        if own.into_iter().any(|id| self.bound(id).is_some()) {
            return self.clearance(grid, &own) > 0.0;
        }
        self.bounds.iter().all(|bound| bound.distance(grid) < 0.0) && self.inner.is_real_interface(own, grid)
    }
}
