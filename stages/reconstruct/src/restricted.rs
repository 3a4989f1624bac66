//! The Delaunay triangulation of the particles restricted to the isosurface: a tetrahedron is inside when F is negative
//! at its circumcentre, and the surface is where inside meets outside.
//!
//! Being the boundary of a set of tetrahedra the surface is closed whatever the sampling; where the sampling is dense
//! enough (an epsilon-sample, Amenta and Bern 1999) each of its facets is the one that the paper's Tight Cocone finds
//! too. The Voronoi edge dual to a facet joins the two circumcentres and crosses F = 0: that crossing is the
//! point which refines the facet (Boissonnat and Oudot 2005).

use crate::around::{boundary, boundary_facets_of, parts_round, runs_round, star};
use crate::prepare::not_triangulated;
use glam::DVec3;
use isoparticles_delaunay::predicates::orientation;
use isoparticles_delaunay::{Delaunay, INFINITE, Insertion};
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::error::Result;
use rayon::prelude::*;

/// Halvings of a Voronoi edge when its crossing with F = 0 is sought.
const HALVINGS: usize = 60;

/// A triangulation whose tetrahedra know their side of F = 0.
pub struct Restricted<'a> {
    delaunay: Delaunay,
    field: &'a CubicSpline,
    upper: DVec3,
    inside: Vec<bool>,
    /// Tetrahedra made since the sides were last decided.
    undecided: Vec<u32>,
    /// Tetrahedra made since the changes were last taken.
    changed: Vec<u32>,
}

/// A facet between inside and outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facet {
    /// Its vertices, counter-clockwise seen from outside.
    pub vertices: [u32; 3],
    /// The tetrahedron inside.
    pub tetrahedron: u32,
    /// Which facet of it this is: the one opposite to the vertex at this place.
    pub opposite: u8,
}

impl<'a> Restricted<'a> {
    /// Decides the side of each tetrahedron of a triangulation in the grid frame of F.
    pub fn new(delaunay: Delaunay, field: &'a CubicSpline) -> Self {
        let undecided = delaunay.finite_tetrahedra().map(|(t, _)| t).collect();
        let upper = field.geometry().upper_corner();
        let mut new = Self { delaunay, field, upper, inside: Vec::new(), undecided, changed: Vec::new() };
        new.decide_sides();
        new.changed = Vec::new();
        new
    }

    /// The triangulation.
    pub fn delaunay(&self) -> &Delaunay {
        &self.delaunay
    }

    /// The implicit function.
    pub fn field(&self) -> &'a CubicSpline {
        self.field
    }

    /// The points, those inserted at the end.
    pub fn points(&self) -> &[DVec3] {
        self.delaunay.points()
    }

    /// Adds a point; [`Restricted::decide_sides`] must follow the last of a round. `None` when it was there already.
    pub fn insert(&mut self, point: DVec3, near: u32) -> Result<Option<u32>> {
        match self.delaunay.insert(point, Some(near)).map_err(not_triangulated)? {
            Insertion::Duplicate(_) => Ok(None),
            Insertion::New(v) => {
                self.undecided.extend_from_slice(self.delaunay.created());
                Ok(Some(v))
            }
        }
    }

    /// Decides the side of every tetrahedron made since the last call.
    pub fn decide_sides(&mut self) {
        self.inside.resize(self.delaunay.slot_count(), false);
        let mut undecided = std::mem::take(&mut self.undecided);
        undecided.sort_unstable();
        undecided.dedup();
        let sides: Vec<bool> = undecided.par_iter().map(|&t| self.is_centre_inside(t)).collect();
        for (&t, &side) in undecided.iter().zip(&sides) {
            self.inside[t as usize] = side;
        }
        self.changed.append(&mut undecided);
    }

    /// The tetrahedra made by insertions since the last call, ascending.
    pub fn take_changed(&mut self) -> Vec<u32> {
        let mut changed = std::mem::take(&mut self.changed);
        changed.retain(|&t| self.delaunay.is_alive(t));
        changed.sort_unstable();
        changed.dedup();
        changed
    }

    fn is_centre_inside(&self, t: u32) -> bool {
        if !self.delaunay.is_alive(t) {
            return false;
        }
        self.delaunay.circumcentre(t).is_some_and(|c| self.in_volume(c) && self.field.value(c) < 0.0)
    }

    fn in_volume(&self, p: DVec3) -> bool {
        p.cmpge(DVec3::ZERO).all() && p.cmple(self.upper).all()
    }

    /// Whether a tetrahedron is inside.
    pub fn is_inside(&self, tetrahedron: u32) -> bool {
        self.inside[tetrahedron as usize]
    }

    /// Parts the sheets that touch in an edge: of the tetrahedra round it (`start` is one of them) those of one run change sides. True
    /// when some did. See [`Restricted::part_vertex`].
    pub fn part_edge(&mut self, edge: [u32; 2], start: u32, may_leave: bool) -> bool {
        let runs = runs_round(&self.delaunay, edge, start, |t| self.inside[t as usize]);
        self.change_side_of_one(runs, may_leave)
    }

    /// Parts the sheets that touch in a vertex: of the tetrahedra at it those of one part change sides, the part whose circumcentres
    /// lie nearest to F = 0. Where the sheets of F are nearer to each other than points can tell, the mesh must decide. Unless
    /// `may_leave`, tetrahedra only join the object. True when some changed.
    pub fn part_vertex(&mut self, vertex: u32, may_leave: bool) -> bool {
        let star = star(&self.delaunay, vertex);
        let parts = parts_round(&self.delaunay, vertex, &star, |t| self.inside[t as usize]);
        self.change_side_of_one(parts, may_leave)
    }

    fn change_side_of_one(&mut self, parts: Vec<Vec<u32>>, may_leave: bool) -> bool {
        let is_inside = |part: &Vec<u32>| self.inside[part[0] as usize];
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
        tetrahedra.iter().for_each(|&t| self.inside[t as usize] ^= true);
    }

    /// The tetrahedra within a closed surface of facets, which it is all around: those inside of a part of the object, or those outside in a
    /// cavity of it. `None` where there are more than `most`, or where it is not all around them.
    pub fn enclosed(&self, facets: &[Facet], most: usize) -> Option<Vec<u32>> {
        let across = |f: &Facet| self.delaunay.neighbours(f.tetrahedron)[usize::from(f.opposite)];
        let starts = [facets.first()?.tetrahedron, across(facets.first()?)];
        starts.into_iter().find_map(|start| {
            let side = self.inside[start as usize];
            let (mut region, mut next, mut met) = (vec![start], 0, 0);
            while next < region.len() && region.len() <= most {
                for n in self.delaunay.neighbours(region[next]) {
                    if self.inside[n as usize] != side {
                        met += 1;
                    } else if !region.contains(&n) {
                        region.push(n);
                    }
                }
                next += 1;
            }
            let is_all = next == region.len() && met == facets.len();
            (is_all && !region.iter().any(|&t| self.delaunay.is_ghost(t))).then_some(region)
        })
    }

    /// Distance of a circumcentre from F = 0 to first order, mm; infinite beyond the hull and the volume.
    fn distance_of_centre(&self, t: u32) -> f64 {
        let centre = self.delaunay.circumcentre(t).filter(|&c| !self.delaunay.is_ghost(t) && self.in_volume(c));
        centre.map_or(f64::INFINITY, |c| {
            let (value, gradient) = self.field.value_gradient(c);
            value.abs() / gradient.length().max(1e-6)
        })
    }

    /// The sides that a closed surface of facets gives the tetrahedra, by their numbers.
    pub fn sides_of(&self, facets: &[Facet]) -> Vec<bool> {
        let mut inside = vec![false; self.delaunay.slot_count()];
        // a bit for each facet of each tetrahedron: whether it is on the surface
        let mut on_surface = vec![0u8; self.delaunay.slot_count()];
        facets.iter().for_each(|f| on_surface[f.tetrahedron as usize] |= 1 << f.opposite);
        let mut open: Vec<u32> = facets.iter().map(|f| f.tetrahedron).collect();
        while let Some(t) = open.pop() {
            if !std::mem::replace(&mut inside[t as usize], true) {
                let neighbours = self.delaunay.neighbours(t).into_iter().enumerate();
                open.extend(neighbours.filter(|(i, _)| on_surface[t as usize] >> i & 1 == 0).map(|(_, n)| n));
            }
        }
        inside
    }

    /// Gives the tetrahedra sides in place of those by the sign of F.
    pub fn set_sides(&mut self, sides: Vec<bool>) {
        self.inside = sides;
    }

    /// Whether a point lies in a tetrahedron that is inside; `near` is a vertex not far from it.
    pub fn holds(&self, point: DVec3, near: u32) -> bool {
        self.locate(point, near).is_some_and(|t| self.inside[t as usize])
    }

    /// The tetrahedron that a point lies in, `None` beyond the hull; `near` is a vertex not far from it.
    pub fn locate(&self, point: DVec3, near: u32) -> Option<u32> {
        let mut t = self.delaunay.incident(near)?;
        let mut entered_from = None;
        loop {
            let (vertices, neighbours) = (self.delaunay.vertices(t), self.delaunay.neighbours(t));
            let infinite = vertices.iter().position(|&v| v == INFINITE);
            let way = match infinite {
                // beyond the hull, unless the walk has only started
                Some(_) if entered_from.is_some() => return None,
                Some(i) => Some(i),
                None => (0..4).filter(|&i| Some(neighbours[i]) != entered_from).find(|&i| {
                    let mut corners = vertices.map(|v| self.points()[v as usize]);
                    corners[i] = point;
                    orientation(corners[0], corners[1], corners[2], corners[3]) < 0.0
                }),
            };
            let Some(i) = way else { return Some(t) };
            // from beyond the hull the walk may turn back at once
            entered_from = infinite.is_none().then_some(t);
            t = neighbours[i];
        }
    }

    /// The facets between inside and outside, in the order of the tetrahedra.
    pub fn facets(&self) -> Vec<Facet> {
        boundary(&self.delaunay, |t| self.inside[t as usize])
    }

    /// The facets between inside and outside at a vertex.
    pub fn facets_at(&self, vertex: u32) -> Vec<Facet> {
        let inside = star(&self.delaunay, vertex).into_iter().filter(|&t| self.inside[t as usize]);
        let facets = inside.flat_map(|t| boundary_facets_of(&self.delaunay, t, |t| self.inside[t as usize]));
        facets.filter(|f| f.vertices.contains(&vertex)).collect()
    }

    /// The two ends of the Voronoi edge dual to a facet, inside first, the outer one cut at the border of the volume.
    pub fn dual_edge(&self, facet: &Facet) -> Option<(DVec3, DVec3)> {
        let from = self.delaunay.circumcentre(facet.tetrahedron)?;
        let across = self.delaunay.neighbours(facet.tetrahedron)[usize::from(facet.opposite)];
        let to = self.delaunay.circumcentre(across).filter(|_| !self.delaunay.vertices(across).contains(&INFINITE));
        let to = match to {
            Some(to) if self.in_volume(to) => to,
            Some(to) => self.cut_at_border(from, to - from),
            None => {
                let [a, b, c] = facet.vertices.map(|v| self.points()[v as usize]);
                self.cut_at_border(from, (b - a).cross(c - a))
            }
        };
        to.is_finite().then_some((from, to))
    }

    /// Where a ray leaves the volume.
    fn cut_at_border(&self, from: DVec3, direction: DVec3) -> DVec3 {
        let mut reach = f64::INFINITY;
        for axis in 0..3 {
            let wall = if direction[axis] > 0.0 { self.upper[axis] } else { 0.0 };
            if direction[axis] != 0.0 {
                reach = reach.min((wall - from[axis]) / direction[axis]);
            }
        }
        (from + direction * reach.max(0.0)).clamp(DVec3::ZERO, self.upper)
    }

    /// Whether the outer end of the facet's Voronoi edge is outside only because the volume ends there, so that the
    /// facet closes an object which an open border left open.
    pub fn is_border_closure(&self, facet: &Facet) -> bool {
        self.dual_edge(facet).is_none_or(|(_, to)| self.field.value(to) < 0.0)
    }

    /// Where the Voronoi edge dual to a facet crosses F = 0, near the facet; `None` when it cannot be found.
    pub fn dual_crossing(&self, facet: &Facet) -> Option<DVec3> {
        let (mut low, mut high) = self.dual_edge(facet)?;
        let [a, b, c] = facet.vertices.map(|v| self.points()[v as usize]);
        // the point of the edge in the facet's plane parts it, so that the crossing next to the facet is taken
        let normal = (b - a).cross(c - a);
        let along = (high - low).dot(normal);
        if along > 0.0 {
            let fraction = ((a - low).dot(normal) / along).clamp(0.0, 1.0);
            let middle = low.lerp(high, fraction);
            if self.field.value(middle) < 0.0 { low = middle } else { high = middle }
        }
        if self.field.value(low) >= 0.0 || self.field.value(high) < 0.0 {
            return None;
        }
        let tolerance = 1e-9 * self.field.geometry().mean_spacing();
        for _ in 0..HALVINGS {
            if low.distance_squared(high) < tolerance * tolerance {
                break;
            }
            let middle = low.midpoint(high);
            if self.field.value(middle) < 0.0 { low = middle } else { high = middle }
        }
        Some(low.midpoint(high))
    }
}
