//! The refinement loop: points are added on F = 0 until the restricted surface is a closed manifold with the components
//! and the genus of the isosurface, and no facet strays from it.
//!
//! Where a facet is at fault, the point is where its Voronoi edge crosses F = 0: the centre of the facet's surface ball,
//! the place of the isosurface nearby that is farthest from all points (Boissonnat and Oudot 2005).

mod genus;
mod looks;
mod other;
mod pinches;
mod samples;

use crate::critical::CriticalPoint;
use crate::defects::Defects;
use crate::isosurface::{Isosurface, nearest_pair};
use crate::prepare::{ON_SURFACE, SurfacePoints};
use crate::restricted::{Facet, Restricted};
use glam::DVec3;
use isoparticles_common::components::NO_COMPONENT;
use isoparticles_common::error::Result;
use isoparticles_common::kd_tree::KdTree;
use isoparticles_common::spline::CubicSpline;
use looks::Looks;
use pinches::Patience;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::HashMap;
use std::sync::OnceLock;

/// A facet may lie this part of h away from F = 0 when no limit is given: three times what a facet of edge h has on a
/// ball of radius 2 h (h^2 / 6 R).
const DEFAULT_DEVIATION: f64 = 0.25;

/// Cosine between a facet's normal and grad F at its centroid below which the facet counts as astray.
const TURNED: f64 = 0.3;

/// A new point keeps this part of h from all others, unless the topology asks for it.
const NEAREST_FOR_SHAPE: f64 = 0.35;

/// The same where the topology asks.
const NEAREST_FOR_TOPOLOGY: f64 = 0.02;

/// A grid node on the wrong side whose nearest point of F = 0 is nearer than this part of h to a vertex has that vertex.
const AT_A_VERTEX: f64 = 0.15;

/// Rounds spent on critical points that stay on the wrong side of the mesh.
const GENUS_ROUNDS: usize = 6;

/// How far the refinement may go.
#[derive(Clone, Copy, Debug)]
pub struct RefineOptions {
    /// Most rounds.
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
    /// Rounds of insertion.
    pub rounds: usize,
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
    /// Components of F = 0 that lie between the samples, so that marching cubes has nothing there, and that the mesh has.
    pub unsampled_components: usize,
    /// Edges and vertices that are still not manifold.
    pub unresolved_manifold: usize,
    /// Facets that still join different components.
    pub unresolved_bridges: usize,
    /// Components still without facets.
    pub unresolved_missing: usize,
    /// Critical points of F that are still on the wrong side of the mesh.
    pub unresolved_critical: usize,
    /// Components that are still in pieces, or of another Euler characteristic than marching cubes and not known to be right.
    pub unresolved_genus: usize,
}

/// Why a point is to be inserted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Reason {
    Missing,
    Manifold,
    Bridge,
    Genus,
    Deviation,
    Node,
}

#[derive(Clone, Copy, Debug)]
struct Candidate {
    reason: Reason,
    point: DVec3,
    /// Distance from the nearest vertices known.
    radius: f64,
    size: f64,
    near: u32,
}

/// A restricted surface on its way to the topology of the isosurface.
pub struct Refinement<'a> {
    /// The triangulation.
    pub restricted: Restricted<'a>,
    /// Target edge length at each point, mm.
    pub sizes: Vec<f64>,
    /// Component of the isosurface of each point, [`NO_COMPONENT`] where there is none near.
    pub component_of: Vec<u32>,
    /// What was done so far.
    pub report: RefineReport,
    isosurface: Isosurface,
    options: RefineOptions,
    genus_rounds: usize,
    /// Rounds granted at first.
    granted: usize,
    looks: Looks,
    patience: Patience,
    /// Whether the tetrahedra inside are those that the facets enclose.
    sides_are_known: bool,
    /// Whether it is the sign of F that says which they are.
    is_by_sign: bool,
    /// Critical points of F, once they have been asked for.
    critical: OnceLock<Vec<CriticalPoint>>,
    /// Times that points were added on each class for want of facets.
    samplings: HashMap<u32, i32>,
}

impl<'a> Refinement<'a> {
    /// Triangulates points on F = 0; `points` loses those that crowd others.
    ///
    /// # Errors
    /// When the points lie in one plane.
    pub fn new(
        points: &mut SurfacePoints,
        field: &'a CubicSpline,
        isosurface: Isosurface,
        options: RefineOptions,
    ) -> Result<Self> {
        let restricted = Restricted::new(points.triangulate()?, field);
        let component_of =
            points.positions.par_iter().map(|&p| component_at(p, field, &isosurface)).collect::<Vec<u32>>();
        Ok(Self {
            restricted,
            sizes: points.sizes.clone(),
            component_of,
            report: RefineReport::default(),
            isosurface,
            options,
            genus_rounds: 0,
            granted: options.max_rounds,
            looks: Looks::default(),
            patience: Patience::default(),
            sides_are_known: true,
            is_by_sign: true,
            critical: OnceLock::new(),
            samplings: HashMap::new(),
        })
    }

    /// Components that the isosurface is known to have by now.
    pub fn component_count(&self) -> usize {
        self.isosurface.component_count() + self.report.unsampled_components
    }

    /// What is known of the isosurface by now.
    pub fn isosurface(&self) -> &Isosurface {
        &self.isosurface
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
        let points = self.restricted.points();
        let geometry = self.restricted.field().geometry();
        let upper = geometry.upper_corner();
        let open = self.options.open_border;
        let near_border = |v: u32| {
            let p = points[v as usize];
            p.min(upper - p).min_element() < self.sizes[v as usize] + geometry.mean_spacing()
        };
        Defects::find(facets, &self.component_of, &self.isosurface, |a, b| open && near_border(a) && near_border(b))
    }

    /// Adds points until there is no defect left, or `max_rounds` are over at a stretch. `step` hears the round and the number of
    /// points and may stop the loop with an error. Returns the facets.
    ///
    /// # Errors
    /// Those of `step`.
    pub fn run(&mut self, mut step: impl FnMut(usize, usize) -> Result<()>) -> Result<Vec<Facet>> {
        loop {
            step(self.report.rounds, self.restricted.points().len())?;
            let facets = self.facets();
            let defects = self.compare(&facets);
            if self.patience.is_over(&defects) && self.part_pinches(&facets, &defects) > 0 {
                continue;
            }
            let may_go_on = self.report.rounds < self.options.max_rounds;
            let candidates = if may_go_on { self.candidates(&facets, &defects) } else { Vec::new() };
            let is_stuck = self.insert_all(candidates)? == 0 && self.insert_at_critical_points()? == 0;
            if is_stuck && self.part_pinches(&facets, &defects) == 0 {
                self.report.unsampled_components = self.unsampled_components(&facets, &defects);
                return Ok(facets);
            }
        }
    }

    /// Defects of a set of facets, after looking again wherever the isosurface may be at fault; they go into the report.
    fn compare(&mut self, facets: &[Facet]) -> Defects {
        loop {
            let defects = self.defects(facets);
            if self.look_again(facets, &defects) {
                continue;
            }
            self.report.unresolved_manifold = defects.edges.len() + defects.vertices.len();
            self.report.unresolved_bridges = defects.bridges.len();
            self.report.unresolved_missing = defects.missing.len();
            self.report.unresolved_genus = defects.wrong_genus.len() + defects.in_pieces.len();
            return defects;
        }
    }

    /// Brings grid nodes that lie on the wrong side of the mesh to the right one: inserts the point of F = 0 nearest to
    /// each or, where a vertex is there already, refines the facet at it that passes the node by. Returns how many.
    ///
    /// # Errors
    /// None as a rule; those of the triangulation.
    pub fn insert_near_nodes(&mut self, nodes: &[[usize; 3]], facets: &[Facet]) -> Result<usize> {
        let geometry = self.restricted.field().geometry();
        let tree = KdTree::new(self.restricted.points());
        let mut at_vertex: Vec<(u32, DVec3)> = Vec::new();
        let mut candidates = Vec::new();
        for node in nodes {
            let node = geometry.index_to_grid(DVec3::from_array(node.map(|n| n as f64)));
            let Some(point) = self.on_surface(node, 2.0) else { continue };
            let Some((near, radius)) = tree.nearest(point) else { continue };
            let size = self.sizes[near];
            if radius < AT_A_VERTEX * size {
                at_vertex.push((near as u32, node));
            } else {
                candidates.push(Candidate { reason: Reason::Node, point, radius, size, near: near as u32 });
            }
        }
        at_vertex.sort_by_key(|(v, _)| *v);
        let points = self.restricted.points();
        for facet in facets {
            let [a, b, c] = facet.vertices.map(|v| points[v as usize]);
            let normal = (b - a).cross(c - a);
            for v in facet.vertices {
                let start = at_vertex.partition_point(|(u, _)| *u < v);
                let nodes = at_vertex[start..].iter().take_while(|(u, _)| *u == v);
                for (_, node) in nodes {
                    let outside = self.restricted.field().value(*node) > 0.0;
                    if ((*node - a).dot(normal) > 0.0) != outside {
                        candidates.extend(self.split(facet));
                    }
                }
            }
        }
        self.insert_all(candidates)
    }

    /// The point of F = 0 at the middle of the longest edge of a facet.
    fn split(&self, facet: &Facet) -> Option<Candidate> {
        let ends = |k: usize| [k, (k + 1) % 3].map(|k| self.restricted.points()[facet.vertices[k] as usize]);
        let length = |k: &usize| ends(*k)[0].distance(ends(*k)[1]);
        let [a, b] = ends((0..3).max_by(|i, j| length(i).total_cmp(&length(j)))?);
        let point = self.on_surface(a.midpoint(b), 2.0)?;
        let size = self.sizes[facet.vertices[0] as usize];
        let radius = point.distance(a).min(point.distance(b));
        Some(Candidate { reason: Reason::Node, point, radius, size, near: facet.vertices[0] })
    }

    fn on_surface(&self, p: DVec3, voxels: f64) -> Option<DVec3> {
        let voxel = self.restricted.field().geometry().mean_spacing();
        self.restricted.field().project(p, voxels * voxel, ON_SURFACE * voxel)
    }

    fn candidates(&mut self, facets: &[Facet], defects: &Defects) -> Vec<Candidate> {
        let mut candidates = Vec::new();
        let mut members: HashMap<u32, Vec<u32>> = defects.missing.iter().map(|&class| (class, Vec::new())).collect();
        if !members.is_empty() {
            for (v, class) in (0..).zip(&self.component_of) {
                members.entry(*class).and_modify(|members| members.push(v));
            }
        }
        for &class in &defects.missing {
            let attempt = *self.samplings.entry(class).and_modify(|n| *n += 1).or_insert(0);
            candidates.extend(self.sample_class(class, &members[&class], attempt));
        }
        let spots = defects.edges.iter().chain(defects.vertices.iter().map(|(_, around)| around));
        for around in spots {
            let balls = around.iter().filter_map(|&f| self.ball(&facets[f as usize], Reason::Manifold));
            candidates.extend(balls.max_by(|a, b| a.radius.total_cmp(&b.radius)));
        }
        candidates.extend(defects.in_pieces.iter().flat_map(|&(class, _)| self.gaps(class, defects)));
        candidates.extend(defects.bridges.iter().filter_map(|&f| self.ball(&facets[f as usize], Reason::Bridge)));
        candidates.par_extend(facets.par_iter().filter(|f| self.badness(f) > 1.0).filter_map(|f| {
            let ball = self.ball(f, Reason::Deviation)?;
            (ball.radius > NEAREST_FOR_SHAPE * ball.size).then_some(ball)
        }));
        candidates
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

    /// Points in the gaps of a class that fell apart: between each smaller piece and the nearest vertex of the others.
    fn gaps(&self, class: u32, defects: &Defects) -> Vec<Candidate> {
        let pieces = self.pieces(class, defects);
        let between = (1..pieces.len()).filter_map(|k| {
            let (p, q) = nearest_pair(&pieces[k], &pieces[..k].concat())?;
            let point = self.on_surface(p.midpoint(q), 2.0)?;
            let radius = point.distance(p).min(point.distance(q));
            Some(Candidate { reason: Reason::Genus, point, radius, size: p.distance(q), near: 0 })
        });
        between.collect()
    }

    /// Inserts candidates, the most needed and the roomiest first, none too near to one inserted in the same round.
    fn insert_all(&mut self, mut candidates: Vec<Candidate>) -> Result<usize> {
        candidates.sort_by(|a, b| {
            a.reason.cmp(&b.reason).then(b.radius.total_cmp(&a.radius)).then_with(|| {
                let (p, q) = (a.point.to_array(), b.point.to_array());
                p.partial_cmp(&q).unwrap_or(std::cmp::Ordering::Equal)
            })
        });
        let cell_size = candidates.iter().map(|c| c.radius).fold(0.0, f64::max).max(1e-12);
        let mut taken: HashMap<[i64; 3], Vec<DVec3>> = HashMap::new();
        let mut inserted = 0;
        for candidate in candidates {
            if candidate.radius < NEAREST_FOR_TOPOLOGY * candidate.size {
                continue;
            }
            let cell = |p: DVec3| (p / cell_size).floor().to_array().map(|x| x as i64);
            let at = cell(candidate.point);
            let around = (0..27i64).map(|n| [at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1]);
            let clearance = if candidate.reason == Reason::Missing { 0.99 } else { 0.8 } * candidate.radius;
            let blocked =
                around.filter_map(|key| taken.get(&key)).flatten().any(|p| p.distance(candidate.point) < clearance);
            if blocked {
                continue;
            }
            if self.restricted.insert(candidate.point, candidate.near)?.is_none() {
                continue;
            }
            taken.entry(at).or_default().push(candidate.point);
            self.sizes.push(candidate.size);
            self.component_of.push(component_at(candidate.point, self.restricted.field(), &self.isosurface));
            inserted += 1;
            let report = &mut self.report;
            *match candidate.reason {
                Reason::Missing => &mut report.inserted_missing,
                Reason::Manifold => &mut report.inserted_manifold,
                Reason::Bridge => &mut report.inserted_bridges,
                Reason::Genus => &mut report.inserted_genus,
                Reason::Deviation => &mut report.inserted_deviation,
                Reason::Node => &mut report.inserted_nodes,
            } += 1;
        }
        if inserted > 0 {
            self.restricted.decide_sides();
            self.report.rounds += 1;
            self.report.inserted += inserted;
        }
        Ok(inserted)
    }
}

fn component_at(p: DVec3, field: &CubicSpline, isosurface: &Isosurface) -> u32 {
    isosurface.component_at(p, field.value_gradient(p).1).unwrap_or(NO_COMPONENT)
}
