//! The refinement of one object: points are added on F = 0 until the restricted surface is a closed manifold with the components
//! and the genus of F = 0, and no facet strays from it.
//!
//! Pure criteria find violations: at simplices (`object.rs`), which are looked at again where something changed, and of the surface as a whole, which are looked
//! for when nothing else is left to do: components missing, critical points of F, cores of handles and grid nodes on the wrong side. Each is mended by a
//! point, most needed first (`queue.rs`): the centre of a facet's surface ball, where its Voronoi edge crosses F = 0 (Boissonnat and Oudot 2005), or the place
//! that the criterion names. The topology of F is known before and does not change. Where points do not help, tetrahedra change sides.

mod critical;
pub(crate) mod nodes;
mod other;
mod relabel;
mod samples;

use crate::defects::Defects;
use crate::object::{Object, Violation};
use crate::prepare::SurfacePoints;
use crate::queue::{NEAREST_FOR_SHAPE, NEAREST_FOR_TOPOLOGY, Queue, Reason, Refine, Simplex};
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use isoparticles_volume::Image;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// A place that was found by a look at the whole surface is taken unless a point added since is nearer than this part of the ball round it.
const STILL_FREE: f64 = 0.8;

/// How far the refinement may go.
#[derive(Clone, Copy, Debug)]
pub struct RefineOptions {
    /// Most looks at the whole surface that add points for its topology, and as many for grid nodes.
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
    /// Looks at the whole surface that added points.
    pub rounds: usize,
    /// Points inserted, by what asked for them.
    pub inserted: BTreeMap<Reason, usize>,
    /// Edges and vertices in which sheets touched and that tetrahedra parted by changing sides.
    pub parted_pinches: usize,
    /// Small closed pieces of the mesh that are none of F = 0, and whose tetrahedra changed sides.
    pub dropped_pieces: usize,
    /// Violations of the topology left, by what is violated.
    pub unresolved: BTreeMap<Reason, usize>,
}

impl RefineReport {
    /// Points inserted in all.
    pub fn points(&self) -> usize {
        self.inserted.values().sum()
    }
}

/// A restricted surface on its way to the topology of F.
pub struct Refinement<'a> {
    /// The surface.
    pub object: Object<'a>,
    /// What was done so far.
    pub report: RefineReport,
    options: RefineOptions,
    queue: Queue<DVec3>,
    /// Samples of F whose nodes must lie on their side, if any.
    nodes: Option<&'a Image<f32>>,
    /// The points that it began with: from the nearest of them the triangulation leads to those added since.
    first: KdTree,
    /// Points at the last look at the whole surface.
    known: usize,
    /// Looks at critical points, and at the cores of handles.
    looks: [usize; 2],
    /// Times that tetrahedra changed sides where sheets touch.
    partings: usize,
}

impl Refine for Refinement<'_> {
    type Remedy = DVec3;

    fn queue(&mut self) -> &mut Queue<DVec3> {
        &mut self.queue
    }

    fn now(&self, old: &Violation) -> Option<Violation> {
        match old.simplex {
            Simplex::Place(..) => {
                let (near, room) = self.object.restricted.nearest(old.remedy, old.near);
                let is_free = (near as usize) < self.known || room >= STILL_FREE * old.radius;
                is_free.then_some(Violation { near, ..*old })
            }
            simplex => self.object.at_simplex(simplex),
        }
    }

    fn mend(&mut self, violation: &Violation) -> Result<bool> {
        let Violation { reason, remedy, radius, size, near, .. } = *violation;
        let least = if reason == Reason::Deviation { NEAREST_FOR_SHAPE } else { NEAREST_FOR_TOPOLOGY };
        // a projected centroid may lie nearer to others than to the facet's vertices; a place is tried once a look
        let is_free = || {
            matches!(violation.simplex, Simplex::Place(..))
                || self.object.restricted.nearest(remedy, near).1 >= NEAREST_FOR_TOPOLOGY * size
        };
        let is_mended = radius >= least * size && is_free() && self.object.insert(remedy, size, near)?;
        if is_mended {
            *self.report.inserted.entry(reason).or_default() += 1;
        }
        Ok(is_mended)
    }

    fn at_changed(&mut self) -> Vec<Violation> {
        let changed = self.object.restricted.take_changed();
        self.object.at_tetrahedra(&changed)
    }

    fn point_count(&self) -> usize {
        self.object.points().len()
    }
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
        let RefineOptions { max_deviation, open_border, .. } = options;
        let first = KdTree::new(delaunay.points());
        let object = Object::new(delaunay, points, field, topology, max_deviation, open_border);
        // what is amiss at edges and vertices comes with the first look at the whole surface
        let found: Vec<Violation> = object.facets().par_iter().filter_map(|f| object.at_facet(f)).collect();
        let mut queue = Queue::default();
        queue.add(found);
        let (known, looks, partings) = (0, [0; 2], 0);
        Self { object, report: RefineReport::default(), options, queue, nodes: None, first, known, looks, partings }
    }

    /// Lets grid nodes count, the samples of F, from now on.
    pub fn keep_nodes(&mut self, samples: &'a Image<f32>) {
        self.nodes = Some(samples);
    }

    /// Adds points until nothing is violated, there is no room for more, or `max_rounds` are over. `step` hears the number of points and may stop
    /// the loop with an error. Returns the facets, and what is left amiss in them.
    ///
    /// # Errors
    /// Those of `step` and of the triangulation.
    pub fn run(&mut self, mut step: impl FnMut(usize) -> Result<()>) -> Result<(Vec<Facet>, Defects)> {
        let step: &mut dyn FnMut(usize) -> Result<()> = &mut step;
        let mut rounds_left = self.options.max_rounds;
        let mut node_rounds_left = self.options.max_rounds;
        loop {
            step(self.object.points().len())?;
            let facets = self.object.facets();
            let defects = self.object.defects(&facets);
            let mut mended = 0;
            if rounds_left > 0 {
                let found = self.at_defects(&facets, &defects);
                mended = self.mend_all(found, step)?;
                rounds_left -= usize::from(mended > 0);
            }
            let wrong_sided = if mended == 0 { self.wrong_sided() } else { Vec::new() };
            let [mut at_points, mut along_cores] = self.looks;
            if mended == 0 {
                mended = self.mend_critical_points(&wrong_sided, &mut at_points, step)?;
            }
            if mended == 0 && self.may_look(along_cores) {
                let left = self.cores_left(&defects);
                mended = self.mend_critical_points(&left, &mut along_cores, step)?;
            }
            self.looks = [at_points, along_cores];
            if mended == 0 {
                mended = self.part_pinches(&facets, &defects);
            }
            if mended == 0 {
                mended = self.drop_pieces(&facets, &defects);
            }
            if mended == 0 && node_rounds_left > 0 {
                let found = self.at_nodes(&facets);
                mended = self.mend_all(found, step)?;
                node_rounds_left -= usize::from(mended > 0);
            }
            if mended == 0 {
                self.tell(&defects, wrong_sided.len());
                return Ok((facets, defects));
            }
        }
    }

    /// Mends violations and those that come of it; returns how many points that took.
    fn mend_all(&mut self, found: Vec<Violation>, step: &mut dyn FnMut(usize) -> Result<()>) -> Result<usize> {
        self.known = self.object.points().len();
        let mended = self.drain(found, step)?;
        self.report.rounds += usize::from(mended > 0);
        Ok(mended)
    }

    /// Puts into the report what is left.
    fn tell(&mut self, defects: &Defects, critical: usize) {
        let left = [
            (Reason::Edge, defects.edges.len()),
            (Reason::Vertex, defects.vertices.len()),
            (Reason::Bridge, defects.bridges.len()),
            (Reason::Missing, defects.missing.len()),
            (Reason::Component, defects.wrong_genus.len() + defects.in_pieces.len()),
            (Reason::CriticalPoint, critical),
        ];
        self.report.unresolved = left.into_iter().filter(|(_, count)| *count > 0).collect();
    }

    /// What is violated in the topology of the surface, and where tetrahedra changed sides.
    fn at_defects(&mut self, facets: &[Facet], defects: &Defects) -> Vec<Violation> {
        let around = defects.edges.iter().flatten().chain(defects.vertices.iter().flat_map(|(_, around)| around));
        let mut found = self.object.at_vertices(around.flat_map(|&f| facets[f as usize].vertices).collect());
        found.extend(defects.bridges.iter().filter_map(|&f| self.object.at_facet(&facets[f as usize])));
        found.extend(self.at_changed());
        found.extend(self.on_missing(&defects.missing));
        found
    }

    /// Places found together, as violations.
    fn places(&self, reason: Reason, found: &[Place]) -> Vec<Violation> {
        let violation = |(k, &Place { point, radius, size }): (usize, &Place)| {
            let (simplex, near) = (Simplex::Place(reason, k), self.near(point));
            Violation { reason, simplex, remedy: point, radius, size, near }
        };
        found.par_iter().enumerate().map(violation).collect()
    }

    /// A point not far from a place.
    fn near(&self, place: DVec3) -> u32 {
        self.first.nearest(place).map_or(0, |(v, _)| v as u32)
    }

    /// The point nearest to a place and its distance, mm.
    fn nearest(&self, place: DVec3) -> (u32, f64) {
        self.object.restricted.nearest(place, self.near(place))
    }
}

/// A place for a new point.
struct Place {
    /// On F = 0, grid frame, mm.
    point: DVec3,
    /// Distance from the points that matter, mm.
    radius: f64,
    /// Target edge length h, mm.
    size: f64,
}
