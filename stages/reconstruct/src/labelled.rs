//! A Delaunay triangulation whose tetrahedra bear labels: inside or outside of one object, or one of many materials.
//!
//! The label of a tetrahedron is decided by its vertices and its circumcentre; beyond the hull it is the default one, outside. The facets between different
//! labels are the surface, or the interfaces: closed and conforming by construction.

pub use crate::around::Facet;
use crate::around::{boundary, boundary_facets_of, star};
use crate::prepare::not_triangulated;
use glam::DVec3;
use isoparticles_delaunay::predicates::orientation;
use isoparticles_delaunay::{Delaunay, INFINITE, Insertion};
use isoparticles_stage::error::Result;
use rayon::prelude::*;

/// Fewer tetrahedra than these are labelled on one thread: waking others takes longer.
const FEW: usize = 256;

/// Most halvings of a Voronoi edge when the surface that it crosses is sought, and how long a piece is enough, voxels: the crossing is projected after that.
const HALVINGS: usize = 60;
const CROSSING: f64 = 1e-3;

/// A triangulation in the grid frame of a volume whose tetrahedra bear labels; the greater of two is inside.
pub struct Labelled<L> {
    delaunay: Delaunay,
    /// The last corner of the volume, mm.
    upper: DVec3,
    labels: Vec<L>,
    /// Tetrahedra made since the labels were last decided.
    undecided: Vec<u32>,
    /// Tetrahedra made, or given another label, since the changes were last taken.
    changed: Vec<u32>,
}

impl<L: Copy + Default + Ord + Send + Sync> Labelled<L> {
    /// Labels a triangulation by what `label` says of a tetrahedron and of its circumcentre, where that lies in the volume, which ends at `upper`.
    pub fn new(delaunay: Delaunay, upper: DVec3, label: impl Fn(&Delaunay, u32, Option<DVec3>) -> L + Sync) -> Self {
        let undecided = delaunay.finite_tetrahedra().map(|(t, _)| t).collect();
        let mut new = Self { delaunay, upper, labels: Vec::new(), undecided, changed: Vec::new() };
        new.decide(label);
        new.changed = Vec::new();
        new
    }

    /// The triangulation.
    pub fn delaunay(&self) -> &Delaunay {
        &self.delaunay
    }

    /// The points, those inserted at the end.
    pub fn points(&self) -> &[DVec3] {
        self.delaunay.points()
    }

    /// The label of a tetrahedron.
    pub fn of(&self, tetrahedron: u32) -> L {
        self.labels[tetrahedron as usize]
    }

    /// Gives a tetrahedron another label.
    pub fn set(&mut self, tetrahedron: u32, label: L) {
        self.labels[tetrahedron as usize] = label;
        self.changed.push(tetrahedron);
    }

    /// Gives all tetrahedra other labels, by their numbers.
    pub fn set_all(&mut self, labels: Vec<L>) {
        self.labels = labels;
    }

    /// Adds a point; [`Self::decide`] must follow the last of a round. `None` when it was there already.
    ///
    /// # Errors
    /// Those of the triangulation.
    pub fn insert(&mut self, point: DVec3, near: u32) -> Result<Option<u32>> {
        match self.delaunay.insert(point, Some(near)).map_err(not_triangulated)? {
            Insertion::Duplicate(_) => Ok(None),
            Insertion::New(v) => {
                self.undecided.extend_from_slice(self.delaunay.created());
                Ok(Some(v))
            }
        }
    }

    /// Has the labels of the tetrahedra at a point decided anew.
    pub fn reconsider(&mut self, point: u32) {
        self.undecided.extend(star(&self.delaunay, point));
    }

    /// Decides the label of every tetrahedron made since the last call, as [`Self::new`] does.
    pub fn decide(&mut self, label: impl Fn(&Delaunay, u32, Option<DVec3>) -> L + Sync) {
        self.labels.resize(self.delaunay.slot_count(), L::default());
        let mut undecided = std::mem::take(&mut self.undecided);
        undecided.sort_unstable();
        undecided.dedup();
        let of = |&t: &u32| {
            if !self.delaunay.is_alive(t) || self.delaunay.is_ghost(t) {
                return L::default();
            }
            let centre = self.delaunay.circumcentre(t).filter(|&c| self.in_volume(c));
            label(&self.delaunay, t, centre)
        };
        let labels: Vec<L> = if undecided.len() < FEW {
            undecided.iter().map(of).collect()
        } else {
            undecided.par_iter().map(of).collect()
        };
        for (&t, &label) in undecided.iter().zip(&labels) {
            self.labels[t as usize] = label;
        }
        self.changed.append(&mut undecided);
    }

    /// The tetrahedra made, or given another label one by one, since the last call, ascending.
    pub fn take_changed(&mut self) -> Vec<u32> {
        let mut changed = std::mem::take(&mut self.changed);
        changed.retain(|&t| self.delaunay.is_alive(t));
        changed.sort_unstable();
        changed.dedup();
        changed
    }

    /// The last corner of the volume, mm.
    pub fn upper(&self) -> DVec3 {
        self.upper
    }

    /// Whether a place lies in the volume.
    pub fn in_volume(&self, p: DVec3) -> bool {
        p.cmpge(DVec3::ZERO).all() && p.cmple(self.upper).all()
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

    /// The point nearest to a place and its distance, mm: from `near` on to whatever neighbour is nearer, which ends at the nearest (Delaunay). The lowest
    /// number wins a tie among neighbours.
    pub fn nearest(&self, place: DVec3, near: u32) -> (u32, f64) {
        let distance = |v: u32| self.points()[v as usize].distance(place);
        let mut best = (near, distance(near));
        loop {
            let star = star(&self.delaunay, best.0);
            let around = star.into_iter().flat_map(|t| self.delaunay.vertices(t)).filter(|&v| v != INFINITE);
            let found = around.map(|v| (v, distance(v))).min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
            match found.filter(|found| found.1 < best.1) {
                Some(nearer) => best = nearer,
                None => return best,
            }
        }
    }

    /// The facets between different labels, in the order of the tetrahedra.
    pub fn facets(&self) -> Vec<Facet> {
        boundary(&self.delaunay, |t| self.of(t))
    }

    /// The facets between different labels at a vertex.
    pub fn facets_at(&self, vertex: u32) -> Vec<Facet> {
        let star = star(&self.delaunay, vertex);
        let own = |t: u32| {
            boundary_facets_of(&self.delaunay, t, |t| self.of(t)).into_iter().filter(move |f| f.tetrahedron == t)
        };
        star.into_iter().flat_map(own).filter(|f| f.vertices.contains(&vertex)).collect()
    }

    /// The tetrahedron on the other side of a facet.
    pub fn across(&self, facet: &Facet) -> u32 {
        self.delaunay.neighbours(facet.tetrahedron)[usize::from(facet.opposite)]
    }

    /// The two ends of the Voronoi edge dual to a facet, inside first, the outer one cut at the border of the volume.
    pub fn dual_edge(&self, facet: &Facet) -> Option<(DVec3, DVec3)> {
        let from = self.delaunay.circumcentre(facet.tetrahedron)?;
        let across = self.across(facet);
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

    /// The two places, nearer to each other than a thousandth of a voxel, between which the Voronoi edge dual to a facet leaves what is inside, next to the facet; `None`
    /// when it does not.
    pub fn dual_crossing(
        &self,
        facet: &Facet,
        is_inside: impl Fn(DVec3) -> bool,
        voxel: f64,
    ) -> Option<(DVec3, DVec3)> {
        let tolerance = CROSSING * voxel;
        let (mut low, mut high) = self.dual_edge(facet)?;
        let [a, b, c] = facet.vertices.map(|v| self.points()[v as usize]);
        // the point of the edge in the facet's plane parts it, so that the crossing next to the facet is taken
        let normal = (b - a).cross(c - a);
        let along = (high - low).dot(normal);
        if along > 0.0 {
            let middle = low.lerp(high, ((a - low).dot(normal) / along).clamp(0.0, 1.0));
            if is_inside(middle) { low = middle } else { high = middle }
        }
        if !is_inside(low) || is_inside(high) {
            return None;
        }
        for _ in 0..HALVINGS {
            if low.distance_squared(high) < tolerance * tolerance {
                break;
            }
            let middle = low.midpoint(high);
            if is_inside(middle) { low = middle } else { high = middle }
        }
        Some((low, high))
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
}
