//! The refinement loop: points are added on F = 0 until the restricted surface is a closed manifold with the components
//! and the genus of F = 0, and no facet strays from it.
//!
//! Where a facet is at fault, the point is where its Voronoi edge crosses F = 0: the centre of the facet's surface ball,
//! the place of F = 0 nearby that is farthest from all points (Boissonnat and Oudot 2005). A round compares the whole surface with the
//! topology of F, which is known before and does not change, adds points, and follows them up where they changed something; the last comparison is always of the whole.

mod follow_up;
mod genus;
mod insert;
mod near;
mod nodes;
mod other;
mod pieces;
mod pinches;
mod samples;

use crate::defects::Defects;
use crate::prepare::{ON_SURFACE, SurfacePoints};
use crate::restricted::{Facet, Restricted};
use glam::DVec3;
use insert::{Candidate, Reason};
use isoparticles_delaunay::Delaunay;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::{CriticalPoint, FieldTopology};
use isoparticles_mesh::components::NO_COMPONENT;
use isoparticles_stage::error::Result;
use near::Nearest;
use pinches::Patience;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::HashMap;
use std::sync::OnceLock;

/// A facet may lie this part of h away from F = 0 when no limit is given: three times what a facet of edge h has on a
/// ball of radius 2 h (h^2 / 6 R).
pub(crate) const DEFAULT_DEVIATION: f64 = 0.25;

/// Cosine between a facet's normal and grad F at its centroid below which the facet counts as turned away from F = 0.
pub(crate) const TURNED: f64 = 0.3;

/// A new point keeps this part of h from all others, unless the topology asks for it.
pub(crate) const NEAREST_FOR_SHAPE: f64 = 0.35;

/// Rounds spent on critical points that stay on the wrong side of the mesh.
const GENUS_ROUNDS: usize = 6;

/// How far the refinement may go.
#[derive(Clone, Copy, Debug)]
pub struct RefineOptions {
    /// Most rounds over the whole surface at a stretch.
    pub max_rounds: usize,
    /// Farthest that the centroid of a facet may lie from F = 0, mm; `None`: a quarter of h, at least a quarter voxel.
    pub max_deviation: Option<f64>,
    /// Whether the object is open where the volume ends.
    pub open_border: bool,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { max_rounds: 40, max_deviation: None, open_border: false }
    }
}

/// What the refinement did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RefineReport {
    /// Rounds of adding points all over the surface.
    pub rounds: usize,
    /// Times that points were added after that where those before had changed something.
    pub follow_ups: usize,
    /// Points inserted in all.
    pub inserted: usize,
    /// ... at edges and vertices that were not manifold.
    pub inserted_manifold: usize,
    /// ... at facets that joined different components.
    pub inserted_bridges: usize,
    /// ... on components that had no facets.
    pub inserted_missing: usize,
    /// ... at critical points of F on the wrong side.
    pub inserted_genus: usize,
    /// ... at facets too far from F = 0, or turned away from it.
    pub inserted_deviation: usize,
    /// ... near grid nodes on the wrong side (label volumes).
    pub inserted_nodes: usize,
    /// Edges and vertices in which sheets touched and that tetrahedra parted by changing sides.
    pub parted_pinches: usize,
    /// Small closed pieces of the mesh that are none of F = 0, and whose tetrahedra changed sides.
    pub dropped_pieces: usize,
    /// Edges and vertices that are still not manifold.
    pub unresolved_manifold: usize,
    /// Facets that still join different components.
    pub unresolved_bridges: usize,
    /// Components still without facets.
    pub unresolved_missing: usize,
    /// Critical points of F that are still on the wrong side of the mesh.
    pub unresolved_critical: usize,
    /// Components that are still in pieces, or of an Euler characteristic that F does not have there.
    pub unresolved_genus: usize,
}

/// A restricted surface on its way to the topology of F.
pub struct Refinement<'a> {
    /// The triangulation.
    pub restricted: Restricted<'a>,
    /// Target edge length at each point, mm.
    pub sizes: Vec<f64>,
    /// Component of F = 0 of each point, [`NO_COMPONENT`] where there is none near.
    pub component_of: Vec<u32>,
    /// What was done so far.
    pub report: RefineReport,
    topology: &'a FieldTopology,
    options: RefineOptions,
    genus_rounds: usize,
    /// Rounds granted at first.
    granted: usize,
    patience: Patience,
    /// Whether the tetrahedra inside are those that the facets enclose.
    sides_are_known: bool,
    /// Critical points on the wrong side of the mesh, each with the nearest vertex, once they have been asked for since the last comparison.
    wrong_sided: OnceLock<Vec<(CriticalPoint, u32)>>,
    /// The points, as of the last comparison.
    nearest: Nearest,
    /// Times that points were added on each class for want of facets.
    samplings: HashMap<u32, i32>,
    /// Whether facets that stray were sought on the whole surface.
    strays_are_known: bool,
}

impl<'a> Refinement<'a> {
    /// Triangulates points on F = 0; `points` loses those that crowd others.
    ///
    /// # Errors
    /// When the points lie in one plane.
    pub fn new(
        points: &mut SurfacePoints,
        field: &'a CubicSpline,
        topology: &'a FieldTopology,
        options: RefineOptions,
    ) -> Result<Self> {
        let delaunay = points.triangulate()?;
        Ok(Self::of(delaunay, points, field, topology, options))
    }

    /// Begins with the triangulation of points on F = 0.
    pub fn of(
        delaunay: Delaunay,
        points: &SurfacePoints,
        field: &'a CubicSpline,
        topology: &'a FieldTopology,
        options: RefineOptions,
    ) -> Self {
        let restricted = Restricted::new(delaunay, field);
        let component_of = points.positions.par_iter().map(|&p| component_at(p, field, topology)).collect::<Vec<u32>>();
        Self {
            restricted,
            sizes: points.sizes.clone(),
            component_of,
            report: RefineReport::default(),
            topology,
            options,
            genus_rounds: 0,
            granted: options.max_rounds,
            patience: Patience::default(),
            sides_are_known: true,
            wrong_sided: OnceLock::new(),
            nearest: Nearest::default(),
            samplings: HashMap::new(),
            strays_are_known: false,
        }
    }

    /// Lets the refinement go on for so many rounds from now.
    pub fn allow_rounds(&mut self, rounds: usize) {
        self.options.max_rounds = self.report.rounds + rounds;
    }

    /// The facets of the surface; with an open border, without those that would close it there.
    pub fn facets(&self) -> Vec<Facet> {
        self.without_border_closure(self.restricted.facets())
    }

    /// Facets without those that would close the surface at an open border.
    pub fn without_border_closure(&self, mut facets: Vec<Facet>) -> Vec<Facet> {
        if self.options.open_border {
            let closure: Vec<bool> = facets.par_iter().map(|f| self.restricted.is_border_closure(f)).collect();
            let mut closure = closure.into_iter();
            facets.retain(|_| !closure.next().unwrap_or(false));
        }
        facets
    }

    /// Defects of a set of facets.
    pub fn defects(&self, facets: &[Facet]) -> Defects {
        let triangles: Vec<[u32; 3]> = facets.iter().map(|f| f.vertices).collect();
        Defects::find(&triangles, &self.component_of, self.topology, |a, b| self.may_be_open(a, b))
    }

    /// Whether an edge may be in one facet only: at an open border.
    fn may_be_open(&self, a: u32, b: u32) -> bool {
        let geometry = self.restricted.field().geometry();
        let upper = geometry.upper_corner();
        let near_border = |v: u32| {
            let p = self.restricted.points()[v as usize];
            p.min(upper - p).min_element() < self.sizes[v as usize] + geometry.mean_spacing()
        };
        self.options.open_border && near_border(a) && near_border(b)
    }

    /// Adds points until there is no defect left, or `max_rounds` are over at a stretch. `step` hears the round and the number of
    /// points and may stop the loop with an error. Returns the facets.
    ///
    /// # Errors
    /// Those of `step`.
    pub fn run(&mut self, mut step: impl FnMut(usize, usize) -> Result<()>) -> Result<Vec<Facet>> {
        loop {
            let follow_ups = self.follow_up(&mut step)?;
            step(self.report.rounds, self.restricted.points().len())?;
            let facets = self.facets();
            let defects = self.compare(&facets);
            if self.patience.is_over(&defects, follow_ups) && self.part_pinches(&facets, &defects) > 0 {
                continue;
            }
            let is_stuck = self.add_points(&facets, &defects)? == 0;
            if is_stuck && self.part_pinches(&facets, &defects) == 0 && self.drop_pieces(&facets, &defects) == 0 {
                return Ok(facets);
            }
        }
    }

    /// Defects of a set of facets; they go into the report.
    fn compare(&mut self, facets: &[Facet]) -> Defects {
        self.nearest.update(self.restricted.points());
        self.wrong_sided = OnceLock::new();
        let defects = self.defects(facets);
        self.report.unresolved_manifold = defects.edges.len() + defects.vertices.len();
        self.report.unresolved_bridges = defects.bridges.len();
        self.report.unresolved_missing = defects.missing.len();
        self.report.unresolved_genus = defects.wrong_genus.len() + defects.in_pieces.len();
        defects
    }

    fn on_surface(&self, p: DVec3, voxels: f64) -> Option<DVec3> {
        let voxel = self.restricted.field().geometry().mean_spacing();
        self.restricted.field().project(p, voxels * voxel, ON_SURFACE * voxel)
    }

    /// Adds points at the defects, if there are rounds left, else round critical points; returns how many. Facets that stray are sought all
    /// over the surface at first and where nothing else is left to do; in between, rounds find those that they make themselves.
    fn add_points(&mut self, facets: &[Facet], defects: &Defects) -> Result<usize> {
        let mut inserted = 0;
        if self.report.rounds < self.options.max_rounds {
            let mut candidates = self.candidates(facets, defects);
            let strays_are_known = std::mem::replace(&mut self.strays_are_known, true);
            if !strays_are_known {
                candidates.extend(self.at_strays(facets));
            }
            inserted = self.insert_all(candidates)?;
            if inserted == 0 && strays_are_known {
                inserted = self.insert_all(self.at_strays(facets))?;
            }
        }
        if inserted == 0 { self.insert_at_critical_points() } else { Ok(inserted) }
    }

    /// Points at the defects of the topology.
    fn candidates(&mut self, facets: &[Facet], defects: &Defects) -> Vec<Candidate> {
        let mut candidates = self.on_missing(&defects.missing);
        candidates.extend(self.at_pinches(facets, &defects.edges, &defects.vertices));
        candidates.extend(self.in_gaps(defects));
        candidates.extend(defects.bridges.iter().filter_map(|&f| self.ball(&facets[f as usize], Reason::Bridge)));
        candidates
    }

    /// At each edge and vertex that is not manifold, the largest surface ball of the facets there.
    fn at_pinches(&self, facets: &[Facet], edges: &[Vec<u32>], vertices: &[(u32, Vec<u32>)]) -> Vec<Candidate> {
        let spots: Vec<&Vec<u32>> = edges.iter().chain(vertices.iter().map(|(_, around)| around)).collect();
        let largest = |around: &&Vec<u32>| {
            let balls = around.iter().filter_map(|&f| self.ball(&facets[f as usize], Reason::Manifold));
            balls.max_by(|a, b| a.radius.total_cmp(&b.radius))
        };
        spots.par_iter().filter_map(largest).collect()
    }

    fn at_strays(&self, facets: &[Facet]) -> Vec<Candidate> {
        facets.par_iter().filter_map(|f| self.at_stray(f)).collect()
    }

    /// The surface ball of a facet that strays from F = 0, if it is not too small.
    fn at_stray(&self, facet: &Facet) -> Option<Candidate> {
        if self.badness(facet) <= 1.0 {
            return None;
        }
        self.ball(facet, Reason::Deviation).filter(|ball| ball.radius > NEAREST_FOR_SHAPE * ball.size)
    }

    /// How far a facet strays, in units of what is allowed.
    fn badness(&self, facet: &Facet) -> f64 {
        let limit = self.options.max_deviation.unwrap_or_else(|| {
            let size = facet.vertices.map(|v| self.sizes[v as usize]).iter().sum::<f64>() / 3.0;
            DEFAULT_DEVIATION * size.max(self.restricted.field().geometry().mean_spacing())
        });
        let (distance, agreement) = self.at_centroid(facet);
        let turned = if agreement < TURNED { 1.0 + TURNED - agreement } else { 0.0 };
        (distance / limit).max(turned)
    }

    /// Distance of the centroid of a facet from F = 0 to first order, mm, and the cosine between the facet's normal and grad F there.
    fn at_centroid(&self, facet: &Facet) -> (f64, f64) {
        let [a, b, c] = facet.vertices.map(|v| self.restricted.points()[v as usize]);
        let (value, gradient) = self.restricted.field().value_gradient((a + b + c) / 3.0);
        let slope = gradient.length().max(1e-6);
        (value.abs() / slope, (b - a).cross(c - a).normalize_or_zero().dot(gradient / slope))
    }

    /// The surface ball of a facet: where its Voronoi edge crosses F = 0, else the projected centroid.
    fn ball(&self, facet: &Facet, reason: Reason) -> Option<Candidate> {
        let points = self.restricted.points();
        let [a, b, c] = facet.vertices.map(|v| points[v as usize]);
        let crossing = self.restricted.dual_crossing(facet).and_then(|p| self.on_surface(p, 0.5));
        let point = crossing.or_else(|| self.on_surface((a + b + c) / 3.0, 2.0))?;
        let radius = a.distance(point).min(b.distance(point)).min(c.distance(point));
        let size = facet.vertices.map(|v| self.sizes[v as usize]).iter().sum::<f64>() / 3.0;
        Some(Candidate { reason, point, radius, size, near: facet.vertices[0] })
    }
}

fn component_at(p: DVec3, field: &CubicSpline, topology: &FieldTopology) -> u32 {
    topology.component_at(field, p, field.value_gradient(p).1).unwrap_or(NO_COMPONENT)
}
