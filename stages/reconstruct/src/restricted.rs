//! The Delaunay triangulation of the particles restricted to the isosurface: a tetrahedron is inside when F is negative
//! at its circumcentre, and the surface is where inside meets outside.
//!
//! Being the boundary of a set of tetrahedra the surface is closed whatever the sampling; where the sampling is dense
//! enough (an epsilon-sample, Amenta and Bern 1999) each of its facets is the one that the paper's Tight Cocone finds
//! too. The Voronoi edge dual to a facet joins the two circumcentres and crosses F = 0: that crossing is the
//! point which refines the facet (Boissonnat and Oudot 2005).

use crate::around::{parts_round, runs_round, star};
pub use crate::labelled::Facet;
use crate::labelled::Labelled;
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::spline::CubicSpline;
use std::ops::{Deref, DerefMut};

/// A triangulation whose tetrahedra know their side of F = 0: those that bear `true` are inside.
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
    /// Decides the side of each tetrahedron of a triangulation in the grid frame of F.
    pub fn new(delaunay: Delaunay, field: &'a CubicSpline) -> Self {
        let sides = Labelled::new(delaunay, field.geometry().upper_corner(), |_, _, centre| {
            centre.is_some_and(|p| field.value(p) < 0.0)
        });
        Self { sides, field }
    }

    /// The implicit function.
    pub fn field(&self) -> &'a CubicSpline {
        self.field
    }

    /// Decides the side of every tetrahedron made since the last call.
    pub fn decide_sides(&mut self) {
        self.sides.decide(|_, _, centre| centre.is_some_and(|p| self.field.value(p) < 0.0));
    }

    /// Whether a tetrahedron is inside.
    pub fn is_inside(&self, tetrahedron: u32) -> bool {
        self.sides.of(tetrahedron)
    }

    /// Parts the sheets that touch in an edge: of the tetrahedra round it (`start` is one of them) those of one run change sides. True
    /// when some did. See [`Restricted::part_vertex`].
    pub fn part_edge(&mut self, edge: [u32; 2], start: u32, may_leave: bool) -> bool {
        let runs = runs_round(self.delaunay(), edge, start, |t| self.is_inside(t));
        self.change_side_of_one(runs, may_leave)
    }

    /// Parts the sheets that touch in a vertex: of the tetrahedra at it those of one part change sides, the part whose circumcentres
    /// lie nearest to F = 0. Where the sheets of F are nearer to each other than points can tell, the mesh must decide. Unless
    /// `may_leave`, tetrahedra only join the object. True when some changed.
    pub fn part_vertex(&mut self, vertex: u32, may_leave: bool) -> bool {
        let star = star(self.delaunay(), vertex);
        let parts = parts_round(self.delaunay(), vertex, &star, |t| self.is_inside(t));
        self.change_side_of_one(parts, may_leave)
    }

    fn change_side_of_one(&mut self, parts: Vec<Vec<u32>>, may_leave: bool) -> bool {
        let is_inside = |part: &Vec<u32>| self.is_inside(part[0]);
        let inside = parts.iter().filter(|part| is_inside(part)).count();
        // the last part of a side is what the others are parted from
        let is_spare = |part: &&Vec<u32>| match is_inside(part) {
            true => may_leave && inside > 1,
            false => parts.len() - inside > 1,
        };
        let errs = |part: &Vec<u32>| part.iter().map(|&t| self.distance_of_centre(t)).fold(0.0, f64::max);
        let spare = parts.iter().filter(is_spare).map(|part| (errs(part), part)).filter(|(err, _)| err.is_finite());
        let Some((_, part)) = spare.min_by(|a, b| a.0.total_cmp(&b.0)) else { return false };
        self.change_sides(part);
        true
    }

    /// Lets some tetrahedra change sides.
    pub fn change_sides(&mut self, tetrahedra: &[u32]) {
        tetrahedra.iter().for_each(|&t| self.sides.set(t, !self.sides.of(t)));
    }

    /// The tetrahedra within a closed surface of facets, which it is all around: those inside of a part of the object, or those outside in a
    /// cavity of it. `None` where there are more than `most`, or where it is not all around them.
    pub fn enclosed(&self, facets: &[Facet], most: usize) -> Option<Vec<u32>> {
        let starts = [facets.first()?.tetrahedron, self.sides.across(facets.first()?)];
        starts.into_iter().find_map(|start| {
            let side = self.is_inside(start);
            let (mut region, mut next, mut met) = (vec![start], 0, 0);
            while next < region.len() && region.len() <= most {
                for n in self.delaunay().neighbours(region[next]) {
                    if self.is_inside(n) != side {
                        met += 1;
                    } else if !region.contains(&n) {
                        region.push(n);
                    }
                }
                next += 1;
            }
            let is_all = next == region.len() && met == facets.len();
            (is_all && !region.iter().any(|&t| self.delaunay().is_ghost(t))).then_some(region)
        })
    }

    /// Distance of a circumcentre from F = 0 to first order, mm; infinite beyond the hull and the volume.
    fn distance_of_centre(&self, t: u32) -> f64 {
        let centre =
            self.delaunay().circumcentre(t).filter(|&c| !self.delaunay().is_ghost(t) && self.sides.in_volume(c));
        centre.map_or(f64::INFINITY, |c| self.field.distance_estimate(c).abs())
    }

    /// The sides that a closed surface of facets gives the tetrahedra, by their numbers.
    pub fn sides_of(&self, facets: &[Facet]) -> Vec<bool> {
        let mut inside = vec![false; self.delaunay().slot_count()];
        // a bit for each facet of each tetrahedron: whether it is on the surface
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

    /// Gives the tetrahedra sides in place of those by the sign of F.
    pub fn set_sides(&mut self, sides: Vec<bool>) {
        self.sides.set_all(sides);
    }

    /// Whether a point lies in a tetrahedron that is inside; `near` is a vertex not far from it.
    pub fn holds(&self, point: DVec3, near: u32) -> bool {
        self.locate(point, near).is_some_and(|t| self.is_inside(t))
    }

    /// Whether the outer end of the facet's Voronoi edge is outside only because the volume ends there, so that the
    /// facet closes an object which an open border left open.
    pub fn is_border_closure(&self, facet: &Facet) -> bool {
        self.dual_edge(facet).is_none_or(|(_, to)| self.field.value(to) < 0.0)
    }

    /// Where the Voronoi edge dual to a facet crosses F = 0, near the facet; `None` when it cannot be found.
    pub fn dual_crossing(&self, facet: &Facet) -> Option<DVec3> {
        let voxel = self.field.geometry().mean_spacing();
        let (low, high) = self.sides.dual_crossing(facet, |p| self.field.value(p) < 0.0, voxel)?;
        Some(low.midpoint(high))
    }
}
