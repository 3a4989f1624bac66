//! Delaunay refinement of a complex (Cheng, Dey and Levine 2008). One priority queue orders the
//! violations, each is repaired by inserting a point, and only changed tetrahedra are checked
//! again.
//!
//! The order is: segments of junction curves; facets, edges and vertices whose topology differs
//! from that of the indicators; facets with too large a deviation; grid nodes in another material.
//! A point that would encroach upon a segment splits the segment instead (Ruppert 1995). Violations
//! remain where a new point would be too close to existing ones. They are counted in the report.

use super::complex::Complex;
use super::criteria::{Mend, Violation};
use super::nodes::Nodes;
use super::topology::Simplices;
use crate::labelled::Facet;
use crate::queue::{NEAREST_FOR_SHAPE, NEAREST_FOR_TOPOLOGY, Queue, Reason, Refine, Remedy, Simplex};
use crate::refine::RefineReport;
use isoparticles_field::materials::Stratum;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use std::collections::BTreeMap;

/// Maximum number of searches for grid nodes in other materials, each with an empty queue.
const NODE_ROUNDS: usize = 12;

impl Remedy for Mend {
    fn place(&self) -> [f64; 3] {
        match *self {
            Self::Point { place, .. } => place.to_array(),
            Self::Split(pair) => [f64::from(pair[0]), f64::from(pair[1]), 0.0],
            Self::None => [0.0; 3],
        }
    }
}

/// The refinement of a complex towards the strata of the indicators.
pub struct Refinement<'a> {
    /// The complex.
    pub complex: Complex<'a>,
    /// The report so far.
    pub report: RefineReport,
    queue: Queue<Mend>,
    /// Grid nodes that must keep their materials; `None` if no node must.
    pub(super) nodes: Option<&'a Nodes>,
}

impl Refine for Refinement<'_> {
    type Remedy = Mend;

    fn queue(&mut self) -> &mut Queue<Mend> {
        &mut self.queue
    }

    fn now(&self, old: &Violation) -> Option<Violation> {
        match old.simplex {
            Simplex::Node(node) => self.nodes.and_then(|nodes| nodes.violation(&self.complex, node, old.near)),
            simplex => self.complex.at_simplex(simplex),
        }
    }

    fn mend(&mut self, violation: &Violation) -> Result<bool> {
        let is_mended = self.insert(violation)?;
        if is_mended {
            *self.report.inserted.entry(violation.reason).or_default() += 1;
        }
        Ok(is_mended)
    }

    fn at_changed(&mut self) -> Vec<Violation> {
        let changed = self.complex.labelled.take_changed();
        self.complex.violations(&Simplices::of(&self.complex, &changed))
    }

    fn point_count(&self) -> usize {
        self.complex.points().len()
    }
}

impl<'a> Refinement<'a> {
    /// Creates the refinement with all violations of a complex in its queue. `nodes` are the grid
    /// nodes that must keep their materials.
    pub fn new(complex: Complex<'a>, nodes: Option<&'a Nodes>) -> Self {
        let found = complex.violations(&Simplices::all(&complex, complex.labelled.facets()));
        let mut report = RefineReport::default();
        found.iter().for_each(|v| *report.violations.entry(v.reason).or_default() += 1);
        let mut new = Self { complex, report, queue: Queue::default(), nodes };
        new.queue.add(found);
        new
    }

    /// Inserts points until no criterion is violated or no further point can be inserted, then
    /// changes materials and strata where points do not help. Calls `step` with the number of
    /// points; its error ends the refinement. Returns the facets.
    ///
    /// # Errors
    /// Those of `step` and of the triangulation.
    pub fn run(&mut self, mut step: impl FnMut(usize) -> Result<()>) -> Result<Vec<Facet>> {
        self.report.rounds += usize::from(self.drain([], &mut step)? > 0);
        for _ in 0..NODE_ROUNDS {
            let found = self.at_nodes();
            if self.drain(found, &mut step)? == 0 {
                break;
            }
            self.report.rounds += 1;
        }
        self.report.relabelled += self.relabel(&mut step)?;
        self.unite();
        let facets = self.complex.labelled.facets();
        self.report.unresolved = BTreeMap::new();
        for (reason, _) in self.complex.wrong(&Simplices::all(&self.complex, facets.clone())) {
            *self.report.unresolved.entry(reason).or_default() += 1;
        }
        let wrong = self.nodes.map_or_else(Vec::new, |nodes| nodes.wrong(&self.complex, &facets));
        if !wrong.is_empty() {
            self.report.unresolved.insert(Reason::Node, wrong.len());
        }
        Ok(facets)
    }

    /// Returns the violations at grid nodes in other materials.
    pub(super) fn at_nodes(&self) -> Vec<Violation> {
        let Some(nodes) = self.nodes else { return Vec::new() };
        let wrong = nodes.wrong(&self.complex, &self.complex.labelled.facets());
        if wrong.is_empty() {
            return Vec::new();
        }
        let tree = KdTree::new(self.complex.points());
        let violation = |node: usize| {
            let (near, _) = tree.nearest(nodes.place(node))?;
            nodes.violation(&self.complex, node, near as u32)
        };
        wrong.into_iter().filter_map(violation).collect()
    }

    /// Inserts the point that repairs a violation, or splits the segment upon which the point
    /// encroaches. Returns false if there is no room.
    fn insert(&mut self, violation: &Violation) -> Result<bool> {
        let least = violation.size
            * if violation.reason == Reason::Deviation { NEAREST_FOR_SHAPE } else { NEAREST_FOR_TOPOLOGY };
        if violation.radius < least {
            return Ok(false);
        }
        match violation.remedy {
            Mend::None => Ok(false),
            Mend::Split(pair) => self.split(pair, least),
            Mend::Point { place, stratum } => match self.complex.segments.encroached(place, self.complex.points()) {
                Some(pair) => self.split(pair, least),
                None => {
                    let inserted = self.complex.labelled.insert(place, violation.near)?;
                    Ok(self.settle(inserted, stratum, violation.size))
                }
            },
        }
    }

    /// Records the stratum and the target edge length (mm) of an inserted point, and assigns
    /// materials to the new tetrahedra. Returns false if the point existed already.
    pub(super) fn settle(&mut self, inserted: Option<u32>, stratum: Stratum, size: f64) -> bool {
        if inserted.is_none() {
            return false;
        }
        self.complex.strata.push(stratum);
        self.complex.sizes.push(size);
        self.complex.decide();
        true
    }
}
