//! Refines the restricted Delaunay triangulation of one object by points on F = 0. The result is a
//! closed manifold with the components and the genus of F = 0 and a small deviation.
//!
//! Local criteria (`object.rs`) apply to one simplex and are tested again where the triangulation
//! changes. Global criteria compare the whole surface with F when the queue is empty: missing
//! components, critical points of F, cores of handles, and grid nodes on the wrong side.
//!
//! One point is inserted per violation (`queue.rs`): the centre of a facet's surface Delaunay ball
//! (Boissonnat and Oudot 2005), or a position that the criterion gives. Where parts of the surface
//! still touch, tetrahedra change sides. The topology of F is computed beforehand.

mod critical;
pub(crate) mod nodes;
mod other;
mod samples;

use crate::defects::{Defects, edge_of};
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

/// A position from a global criterion is dropped if the nearest vertex was added since then and is
/// closer than this fraction of the position's radius.
const STILL_FREE: f64 = 0.8;

/// Maximum number of rounds in which tetrahedra change sides where parts of the surface touch. In
/// the second half of the rounds, they only change from outside to inside, to prevent oscillation.
const PARTINGS: usize = 16;

/// Limits of the refinement.
#[derive(Clone, Copy, Debug)]
pub struct RefineOptions {
    /// Maximum number of global rounds that add points for the topology. The same limit applies to
    /// rounds that add points for grid nodes.
    pub max_rounds: usize,
    /// Maximum distance of the centroid of a facet from F = 0, mm. `None`: a quarter of h, but at
    /// least a quarter of a voxel.
    pub max_deviation: Option<f64>,
    /// Whether the object is open at the border of the volume.
    pub open_border: bool,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { max_rounds: 40, max_deviation: None, open_border: false }
    }
}

/// Report on the refinement.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RefineReport {
    /// Number of global rounds that added points.
    pub rounds: usize,
    /// Violations of many materials at the start, by reason, without grid nodes.
    pub violations: BTreeMap<Reason, usize>,
    /// Violations repaired by an inserted point, by reason.
    pub inserted: BTreeMap<Reason, usize>,
    /// Points inserted on junction curves.
    pub on_curves: usize,
    /// Edges without a segment that became one, because their curve passes both ends within the
    /// tolerance.
    pub adopted: usize,
    /// Changes of the label of tetrahedra: parts of stars, runs around edges, and single
    /// tetrahedra.
    pub relabelled: usize,
    /// Dropped segments that are not edges between their materials and whose ends are connected by
    /// other segments of their curve.
    pub superfluous: usize,
    /// Number of vertices at which touching parts of an interface were separated.
    pub parted: usize,
    /// Number of short segments that were contracted at a scale.
    pub contracted: usize,
    /// Remaining violations of the topology, and of many materials also the grid nodes in another
    /// material, by reason.
    pub unresolved: BTreeMap<Reason, usize>,
}

impl RefineReport {
    /// Returns the total number of inserted points.
    pub fn points(&self) -> usize {
        self.inserted.values().sum()
    }
}

/// State of the refinement of one object.
pub struct Refinement<'a> {
    /// The triangulation with its labels and criteria.
    pub object: Object<'a>,
    /// Report so far.
    pub report: RefineReport,
    options: RefineOptions,
    queue: Queue<DVec3>,
    /// Samples of F whose grid nodes must stay on their side. `None` if grid nodes are not tested.
    nodes: Option<&'a Image<f32>>,
    /// The initial points. The search for the nearest vertex starts at the nearest of them and
    /// continues in the triangulation.
    first: KdTree,
    /// Number of points at the start of the last global round.
    known: usize,
    /// Number of attempts at critical points, and at the cores of handles.
    looks: [usize; 2],
    /// Number of rounds in which tetrahedra changed sides where parts of the surface touch.
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
        // A projected centroid can be closer to other vertices than to those of its facet.
        // Positions from global criteria need no such test, because each is tried once per round.
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
    /// Triangulates points on F = 0. Points too close to others are removed from `points`.
    ///
    /// # Errors
    /// If the points cannot be triangulated, for example because they lie in one plane.
    pub fn new(
        points: &mut SurfacePoints,
        field: &'a CubicSpline,
        topology: &'a FieldTopology,
        options: RefineOptions,
    ) -> Result<Self> {
        let delaunay = points.triangulate()?;
        Ok(Self::of(delaunay, points, field, topology, options))
    }

    /// Starts from an existing triangulation of points on F = 0.
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
        // the first global round finds violations at edges and vertices
        let found: Vec<Violation> = object.facets().par_iter().filter_map(|f| object.at_facet(f)).collect();
        let mut queue = Queue::default();
        queue.add(found);
        let (known, looks, partings) = (0, [0; 2], 0);
        Self { object, report: RefineReport::default(), options, queue, nodes: None, first, known, looks, partings }
    }

    /// Enables the criterion for grid nodes. `samples` are the samples of F at the nodes.
    pub fn keep_nodes(&mut self, samples: &'a Image<f32>) {
        self.nodes = Some(samples);
    }

    /// Adds points until there are no violations, no point can be inserted, or `max_rounds` is
    /// reached. `step` is called with the number of points and may stop the loop with an error.
    /// Returns the facets and their remaining defects.
    ///
    /// # Errors
    /// If `step` returns an error, or if the triangulation cannot insert a point.
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

    /// Repairs violations and those that result from the repairs. Returns the number of inserted
    /// points.
    fn mend_all(&mut self, found: Vec<Violation>, step: &mut dyn FnMut(usize) -> Result<()>) -> Result<usize> {
        self.known = self.object.points().len();
        let mended = self.drain(found, step)?;
        self.report.rounds += usize::from(mended > 0);
        Ok(mended)
    }

    /// Separates parts of the surface that touch at edges or, if no edge can be separated, at
    /// vertices. Returns the number of edges or vertices.
    fn part_pinches(&mut self, facets: &[Facet], defects: &Defects) -> usize {
        if defects.is_manifold() || self.partings >= PARTINGS {
            return 0;
        }
        let may_leave = 2 * self.partings < PARTINGS;
        let restricted = &mut self.object.restricted;
        let mut parted = 0;
        for around in &defects.edges {
            if let Some(edge) = edge_of(facets, around) {
                let start = facets[around[0] as usize].tetrahedron;
                parted += usize::from(restricted.part_edge(edge, start, may_leave));
            }
        }
        if parted == 0 {
            let vertices = defects.vertices.iter().map(|(v, _)| *v);
            parted = vertices.filter(|&v| restricted.part_vertex(v, may_leave)).count();
        }
        self.partings += usize::from(parted > 0);
        self.report.relabelled += parted;
        parted
    }

    /// Records the remaining violations in the report.
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

    /// Returns the local violations at defects of the topology and at tetrahedra that changed
    /// sides, and positions on missing components.
    fn at_defects(&mut self, facets: &[Facet], defects: &Defects) -> Vec<Violation> {
        let around = defects.edges.iter().flatten().chain(defects.vertices.iter().flat_map(|(_, around)| around));
        let mut found = self.object.at_vertices(around.flat_map(|&f| facets[f as usize].vertices).collect());
        found.extend(defects.bridges.iter().filter_map(|&f| self.object.at_facet(&facets[f as usize])));
        found.extend(self.at_changed());
        found.extend(self.on_missing(&defects.missing));
        found
    }

    /// Returns one violation for each position from a global criterion.
    fn places(&self, reason: Reason, found: &[Place]) -> Vec<Violation> {
        let violation = |(k, &Place { point, radius, size }): (usize, &Place)| {
            let (simplex, near) = (Simplex::Place(reason, k), self.near(point));
            Violation { reason, simplex, remedy: point, radius, size, near }
        };
        found.par_iter().enumerate().map(violation).collect()
    }

    /// Returns the initial point nearest to a position, as the start of a search.
    fn near(&self, place: DVec3) -> u32 {
        self.first.nearest(place).map_or(0, |(v, _)| v as u32)
    }

    /// Returns the vertex nearest to a position, and the distance in mm.
    fn nearest(&self, place: DVec3) -> (u32, f64) {
        self.object.restricted.nearest(place, self.near(place))
    }
}

/// Position of a new point.
struct Place {
    /// Position on F = 0 in the grid frame, mm.
    point: DVec3,
    /// Distance to the nearest vertices that the criterion considers, mm.
    radius: f64,
    /// Target edge length h, mm.
    size: f64,
}
