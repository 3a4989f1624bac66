//! A Delaunay triangulation with a label for each tetrahedron: inside or outside one object, or one
//! of many materials.
//!
//! The vertices and the circumcentre of a tetrahedron determine its label. Ghosts, beyond the
//! convex hull, have the default label, outside. The facets between different labels form the
//! surface or the interfaces, which are therefore closed and conforming.

pub use crate::around::Facet;
use crate::around::{boundary, boundary_facets_of, star};
use crate::prepare::not_triangulated;
use glam::DVec3;
use isoparticles_delaunay::predicates::orientation;
use isoparticles_delaunay::{Delaunay, INFINITE, Insertion};
use isoparticles_stage::error::Result;
use rayon::prelude::*;

/// Fewer tetrahedra than this are labelled on one thread, because waking other threads takes
/// longer.
const FEW: usize = 256;

/// Maximum number of bisections of a Voronoi edge in the search for its crossing with the surface,
/// and length in voxels at which the search ends. The crossing is projected afterwards.
const HALVINGS: usize = 60;
const CROSSING: f64 = 1e-3;

/// A labelled triangulation in the grid frame of a volume. At a facet between two labels, the
/// greater label is inside.
pub struct Labelled<L> {
    delaunay: Delaunay,
    /// Upper corner of the volume in the grid frame, mm. The lower corner is the origin.
    upper: DVec3,
    labels: Vec<L>,
    /// Tetrahedra that await a label: those created since the last call of `decide`.
    undecided: Vec<u32>,
    /// Tetrahedra that were labelled since the last call of `take_changed`.
    changed: Vec<u32>,
}

impl<L: Copy + Default + Ord + Send + Sync> Labelled<L> {
    /// Labels a triangulation. `label` returns the label of a tetrahedron from its number and its
    /// circumcentre, which is `None` outside the volume. `upper` is the upper corner of the volume
    /// (mm).
    pub fn new(delaunay: Delaunay, upper: DVec3, label: impl Fn(&Delaunay, u32, Option<DVec3>) -> L + Sync) -> Self {
        let undecided = delaunay.finite_tetrahedra().map(|(t, _)| t).collect();
        let mut new = Self { delaunay, upper, labels: Vec::new(), undecided, changed: Vec::new() };
        new.decide(label);
        new.changed = Vec::new();
        new
    }

    /// Returns the triangulation.
    pub fn delaunay(&self) -> &Delaunay {
        &self.delaunay
    }

    /// Returns the points. Inserted points are at the end.
    pub fn points(&self) -> &[DVec3] {
        self.delaunay.points()
    }

    /// Returns the label of a tetrahedron.
    pub fn of(&self, tetrahedron: u32) -> L {
        self.labels[tetrahedron as usize]
    }

    /// Sets the label of a tetrahedron.
    pub fn set(&mut self, tetrahedron: u32, label: L) {
        self.labels[tetrahedron as usize] = label;
        self.changed.push(tetrahedron);
    }

    /// Sets the labels of all tetrahedra, by their numbers. [`Self::take_changed`] does not report
    /// this change.
    pub fn set_all(&mut self, labels: Vec<L>) {
        self.labels = labels;
    }

    /// Inserts a point and returns its number, or `None` if the point exists already. `near` is a
    /// vertex close to it. [`Self::decide`] must be called before the labels of the new tetrahedra
    /// are used.
    ///
    /// # Errors
    /// If the triangulation cannot insert the point.
    pub fn insert(&mut self, point: DVec3, near: u32) -> Result<Option<u32>> {
        match self.delaunay.insert(point, Some(near)).map_err(not_triangulated)? {
            Insertion::Duplicate(_) => Ok(None),
            Insertion::New(v) => {
                self.undecided.extend_from_slice(self.delaunay.created());
                Ok(Some(v))
            }
        }
    }

    /// Labels every tetrahedron created since the last call, with `label` as in
    /// [`Self::new`].
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

    /// Returns the existing tetrahedra, ascending, that [`Self::decide`] or [`Self::set`] labelled
    /// since the last call.
    pub fn take_changed(&mut self) -> Vec<u32> {
        let mut changed = std::mem::take(&mut self.changed);
        changed.retain(|&t| self.delaunay.is_alive(t));
        changed.sort_unstable();
        changed.dedup();
        changed
    }

    /// Returns the upper corner of the volume, mm.
    pub fn upper(&self) -> DVec3 {
        self.upper
    }

    /// Returns whether a position is in the volume.
    pub fn in_volume(&self, p: DVec3) -> bool {
        p.cmpge(DVec3::ZERO).all() && p.cmple(self.upper).all()
    }

    /// Returns the tetrahedron that contains a point, or `None` beyond the convex hull. The walk
    /// through the triangulation starts at `near`, a vertex close to the point.
    pub fn locate(&self, point: DVec3, near: u32) -> Option<u32> {
        let mut t = self.delaunay.incident(near)?;
        let mut entered_from = None;
        loop {
            let (vertices, neighbours) = (self.delaunay.vertices(t), self.delaunay.neighbours(t));
            let infinite = vertices.iter().position(|&v| v == INFINITE);
            let way = match infinite {
                // beyond the hull, except at the start of the walk
                Some(_) if entered_from.is_some() => return None,
                Some(i) => Some(i),
                None => (0..4).filter(|&i| Some(neighbours[i]) != entered_from).find(|&i| {
                    let mut corners = vertices.map(|v| self.points()[v as usize]);
                    corners[i] = point;
                    orientation(corners[0], corners[1], corners[2], corners[3]) < 0.0
                }),
            };
            let Some(i) = way else { return Some(t) };
            // a walk that starts at a ghost may return to it at once
            entered_from = infinite.is_none().then_some(t);
            t = neighbours[i];
        }
    }

    /// Returns the vertex nearest to a position, and the distance in mm. The search starts at
    /// `near` and moves to the nearest neighbour until none is nearer. In a Delaunay triangulation,
    /// it ends at the nearest vertex. Among neighbours at equal distance, the lowest number wins.
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

    /// Returns the facets between different labels, in the order of the tetrahedra.
    pub fn facets(&self) -> Vec<Facet> {
        boundary(&self.delaunay, |t| self.of(t))
    }

    /// Returns the facets between different labels at a vertex.
    pub fn facets_at(&self, vertex: u32) -> Vec<Facet> {
        let star = star(&self.delaunay, vertex);
        let own = |t: u32| {
            boundary_facets_of(&self.delaunay, t, |t| self.of(t)).into_iter().filter(move |f| f.tetrahedron == t)
        };
        star.into_iter().flat_map(own).filter(|f| f.vertices.contains(&vertex)).collect()
    }

    /// Returns the tetrahedron on the other side of a facet.
    pub fn across(&self, facet: &Facet) -> u32 {
        self.delaunay.neighbours(facet.tetrahedron)[usize::from(facet.opposite)]
    }

    /// Returns the two ends of the dual Voronoi edge of a facet, the inner end first. The outer end
    /// is cut at the border of the volume. Returns `None` if an end is not finite.
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

    /// Returns an interval of the dual Voronoi edge of a facet in which it leaves the inside, at
    /// the crossing next to the facet. The interval is shorter than a thousandth of a voxel;
    /// `voxel` is in mm. Returns `None` if there is no such crossing.
    pub fn dual_crossing(
        &self,
        facet: &Facet,
        is_inside: impl Fn(DVec3) -> bool,
        voxel: f64,
    ) -> Option<(DVec3, DVec3)> {
        let tolerance = CROSSING * voxel;
        let (mut low, mut high) = self.dual_edge(facet)?;
        let [a, b, c] = facet.vertices.map(|v| self.points()[v as usize]);
        // the intersection with the plane of the facet divides the edge, to select the crossing
        // next to the facet
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

    /// Returns the point at which a ray leaves the volume.
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
