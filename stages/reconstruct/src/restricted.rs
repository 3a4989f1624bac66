//! The restricted Delaunay triangulation of points on F = 0. A tetrahedron is inside if F < 0 at
//! its circumcentre, and the surface consists of the facets between inside and outside.

use crate::around::{parts_round, runs_round, star};
pub use crate::labelled::Facet;
use crate::labelled::Labelled;
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::spline::CubicSpline;
use std::ops::{Deref, DerefMut};

/// A triangulation in which each tetrahedron has a side of F = 0. Those with the label `true` are
/// inside.
pub struct Restricted<'a> {
    sides: Labelled<bool>,
    field: &'a CubicSpline,
}

impl Deref for Restricted<'_> {
    type Target = Labelled<bool>;

    fn deref(&self) -> &Labelled<bool> {
        &self.sides
    }
}

impl DerefMut for Restricted<'_> {
    fn deref_mut(&mut self) -> &mut Labelled<bool> {
        &mut self.sides
    }
}

impl<'a> Restricted<'a> {
    /// Labels the tetrahedra of a triangulation in the grid frame of F by the sign of F at their
    /// circumcentres. Tetrahedra with circumcentres outside the volume are outside.
    pub fn new(delaunay: Delaunay, field: &'a CubicSpline) -> Self {
        let sides = Labelled::new(delaunay, field.geometry().upper_corner(), |_, _, centre| {
            centre.is_some_and(|p| field.value(p) < 0.0)
        });
        Self { sides, field }
    }

    /// Returns F.
    pub fn field(&self) -> &'a CubicSpline {
        self.field
    }

    /// Labels the tetrahedra that were created since the last call.
    pub fn decide_sides(&mut self) {
        self.sides.decide(|_, _, centre| centre.is_some_and(|p| self.field.value(p) < 0.0));
    }

    /// Returns whether a tetrahedron is inside.
    pub fn is_inside(&self, tetrahedron: u32) -> bool {
        self.sides.of(tetrahedron)
    }

    /// Separates parts of the surface that touch at an edge: one run of the tetrahedra around it
    /// changes sides. `start` is one of these tetrahedra. Returns whether any changed. See
    /// [`Restricted::part_vertex`].
    pub fn part_edge(&mut self, edge: [u32; 2], start: u32, may_leave: bool) -> bool {
        let runs = runs_round(self.delaunay(), edge, start, |t| self.is_inside(t));
        self.change_side_of_one(runs, may_leave)
    }

    /// Separates parts of the surface that touch at a vertex: one part of the tetrahedra at it
    /// changes sides. It is the part whose circumcentres are nearest to F = 0. This is needed where
    /// parts of F = 0 are closer together than points can resolve. Without `may_leave`, tetrahedra
    /// only change from outside to inside. Returns whether any changed.
    pub fn part_vertex(&mut self, vertex: u32, may_leave: bool) -> bool {
        let star = star(self.delaunay(), vertex);
        let parts = parts_round(self.delaunay(), vertex, &star, |t| self.is_inside(t));
        self.change_side_of_one(parts, may_leave)
    }

    fn change_side_of_one(&mut self, parts: Vec<Vec<u32>>, may_leave: bool) -> bool {
        let is_inside = |part: &Vec<u32>| self.is_inside(part[0]);
        let inside = parts.iter().filter(|part| is_inside(part)).count();
        // one part of each side must remain
        let is_spare = |part: &&Vec<u32>| match is_inside(part) {
            true => may_leave && inside > 1,
            false => parts.len() - inside > 1,
        };
        let errs = |part: &Vec<u32>| part.iter().map(|&t| self.distance_of_centre(t)).fold(0.0, f64::max);
        let spare = parts.iter().filter(is_spare).map(|part| (errs(part), part)).filter(|(err, _)| err.is_finite());
        let Some((_, part)) = spare.min_by(|a, b| a.0.total_cmp(&b.0)) else { return false };
        part.iter().for_each(|&t| self.sides.set(t, !self.sides.of(t)));
        true
    }

    /// Returns the first-order distance of the circumcentre of a tetrahedron from F = 0 in mm. The
    /// distance of ghosts, and of circumcentres outside the volume, is infinite.
    fn distance_of_centre(&self, t: u32) -> f64 {
        let centre =
            self.delaunay().circumcentre(t).filter(|&c| !self.delaunay().is_ghost(t) && self.sides.in_volume(c));
        centre.map_or(f64::INFINITY, |c| self.field.distance_estimate(c).abs())
    }

    /// Returns whether each tetrahedron, by its number, is inside a closed surface of facets.
    pub fn sides_of(&self, facets: &[Facet]) -> Vec<bool> {
        let mut inside = vec![false; self.delaunay().slot_count()];
        // bit i is set if the facet opposite vertex i of a tetrahedron is on the surface
        let mut on_surface = vec![0u8; self.delaunay().slot_count()];
        facets.iter().for_each(|f| on_surface[f.tetrahedron as usize] |= 1 << f.opposite);
        let mut open: Vec<u32> = facets.iter().map(|f| f.tetrahedron).collect();
        while let Some(t) = open.pop() {
            if !std::mem::replace(&mut inside[t as usize], true) {
                let neighbours = self.delaunay().neighbours(t).into_iter().enumerate();
                open.extend(neighbours.filter(|(i, _)| on_surface[t as usize] >> i & 1 == 0).map(|(_, n)| n));
            }
        }
        inside
    }

    /// Replaces the labels of all tetrahedra, by their numbers. `true` is inside.
    pub fn set_sides(&mut self, sides: Vec<bool>) {
        self.sides.set_all(sides);
    }

    /// Returns whether a point lies in a tetrahedron that is inside. `near` is a vertex close to
    /// it.
    pub fn holds(&self, point: DVec3, near: u32) -> bool {
        self.locate(point, near).is_some_and(|t| self.is_inside(t))
    }

    /// Returns whether a facet closes an object that is open at the border of the volume. The outer
    /// end of its dual Voronoi edge is then outside only because the volume ends there.
    pub fn is_border_closure(&self, facet: &Facet) -> bool {
        self.dual_edge(facet).is_none_or(|(_, to)| self.field.value(to) < 0.0)
    }

    /// Returns the point at which the dual Voronoi edge of a facet crosses F = 0 next to the facet,
    /// or `None` if there is no such crossing.
    pub fn dual_crossing(&self, facet: &Facet) -> Option<DVec3> {
        let voxel = self.field.geometry().mean_spacing();
        let (low, high) = self.sides.dual_crossing(facet, |p| self.field.value(p) < 0.0, voxel)?;
        Some(low.midpoint(high))
    }
}
