//! Delaunay refinement of a complex: one priority queue of violations, a point for each, and only what changed is looked at again (Cheng, Dey and Levine 2008).
//!
//! Segments of junction curves come first, then facets, edges and vertices of another topology than the indicators', then facets that stray, then grid nodes in
//! another material. A point that would lie in the ball of which a segment is a diameter splits the segment in its place (Ruppert 1995). The queue ends empty,
//! or with violations that only points nearer to others than the smallest radius could mend: these are counted and shown.

use super::complex::Complex;
use super::criteria::{Mend, Violation};
use super::nodes::Nodes;
use super::topology::Simplices;
use crate::around::star;
use crate::interfaces::Segment;
use crate::labelled::Facet;
use crate::queue::{NEAREST_FOR_SHAPE, NEAREST_FOR_TOPOLOGY, Queue, Reason, Refine, Remedy, Simplex};
use isoparticles_field::materials::Stratum;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Times that grid nodes are looked for in other materials, each time with an empty queue.
const NODE_ROUNDS: usize = 12;

/// What the refinement did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RefineReport {
    /// Violations at the start, by what was violated; grid nodes come later.
    pub violations: BTreeMap<Reason, usize>,
    /// Points inserted, by what asked for them.
    pub inserted: BTreeMap<Reason, usize>,
    /// Of these, on junction curves.
    pub on_curves: usize,
    /// Times that a segment was made to pass through a point of another, nearer than `ONE_CURVE`.
    pub passes: usize,
    /// Edges that no known segment lay on, and became one: their ends lie nearer to their curve than `ONE_CURVE`.
    pub adopted: usize,
    /// Parts of stars and runs round edges that were given to another material.
    pub relabelled: usize,
    /// Segments that were no edges between their materials, and join two places that their curve passes by others.
    pub superfluous: usize,
    /// Vertices in which sheets of the same two materials still touched: each sheet gets its own.
    pub parted: usize,
    /// Violations left, by what is violated: only points nearer to others than the smallest radius could mend them.
    pub unresolved: BTreeMap<Reason, usize>,
}

impl Remedy for Mend {
    fn place(&self) -> [f64; 3] {
        match *self {
            Self::Point { place, .. } => place.to_array(),
            Self::Split(pair) => [f64::from(pair[0]), f64::from(pair[1]), 0.0],
            Self::None => [0.0; 3],
        }
    }
}

/// A complex on the way to that of the indicators.
pub struct Refinement<'a> {
    /// The complex.
    pub complex: Complex<'a>,
    /// What was done.
    pub report: RefineReport,
    queue: Queue<Mend>,
    /// Segments that were made to pass through a point: each once, so that this ends.
    pub(super) passes: BTreeSet<(Segment, u32)>,
    /// Those of the grid, where they shall keep their materials.
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
    /// Begins with all violations of a complex; `nodes` are those of the grid, where they shall keep their materials.
    pub fn new(complex: Complex<'a>, nodes: Option<&'a Nodes>) -> Self {
        let found = complex.violations(&Simplices::all(&complex, complex.labelled.facets()));
        let mut report = RefineReport::default();
        found.iter().for_each(|v| *report.violations.entry(v.reason).or_default() += 1);
        let mut new = Self { complex, report, queue: Queue::default(), passes: BTreeSet::new(), nodes };
        new.queue.add(found);
        new
    }

    /// Adds points until nothing is violated, or there is no room. `step` hears the number of points and may stop the loop with an error. Returns the facets.
    ///
    /// # Errors
    /// Those of `step` and of the triangulation.
    pub fn run(&mut self, mut step: impl FnMut(usize) -> Result<()>) -> Result<Vec<Facet>> {
        self.drain([], &mut step)?;
        for _ in 0..NODE_ROUNDS {
            let found = self.at_nodes();
            if self.drain(found, &mut step)? == 0 {
                break;
            }
        }
        self.report.relabelled += self.relabel(&mut step)?;
        // what is left of edges without a known segment may lie on a curve all the same
        let found = self.adopt();
        if !found.is_empty() {
            self.drain(found, &mut step)?;
            self.complex.give_up_adopted();
            self.report.relabelled += self.relabel(&mut step)?;
            self.complex.give_up_adopted();
        }
        self.unite();
        self.report.adopted = self.complex.segments.adopted().len();
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

    /// Takes edges on which three or four materials meet, and which are no segments, as such where their curve passes both of their ends; returns the violations round them.
    fn adopt(&mut self) -> Vec<Violation> {
        let wrong = self.complex.wrong(&Simplices::all(&self.complex, self.complex.labelled.facets()));
        let mut changed = Vec::new();
        for (_, simplex) in wrong {
            if let Simplex::Edge(edge) = simplex
                && self.complex.adopt(edge)
            {
                edge.iter().for_each(|&v| changed.extend(star(self.complex.labelled.delaunay(), v)));
            }
        }
        changed.sort_unstable();
        changed.dedup();
        self.complex.violations(&Simplices::of(&self.complex, &changed))
    }

    /// The grid nodes in other materials.
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

    /// Inserts the point that mends a violation, or splits the segment on which it encroaches; false where there is no room for one.
    fn insert(&mut self, violation: &Violation) -> Result<bool> {
        let least = violation.size
            * if violation.reason == Reason::Deviation { NEAREST_FOR_SHAPE } else { NEAREST_FOR_TOPOLOGY };
        if violation.radius < least {
            // a segment that passes through a point which is there wants no room
            return match violation.simplex {
                Simplex::Edge(pair) => self.split(pair, least),
                _ => Ok(false),
            };
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

    /// Takes note of a point, if it is new; true when it is.
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
