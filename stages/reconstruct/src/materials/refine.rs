//! Delaunay refinement of a complex: one priority queue of violations, a point for each, and only what changed is looked at again (Cheng, Dey and Levine 2008).
//!
//! Segments of junction curves come first, then facets, edges and vertices of another topology than the indicators', then facets that stray, then grid nodes in
//! another material. A point that would lie in the ball of which a segment is a diameter splits the segment in its place (Ruppert 1995). The queue ends empty,
//! or with violations that only points nearer to others than the smallest radius could mend: these are counted and shown.

use super::complex::{Complex, Reason, Remedy, Simplex, Violation};
use super::nodes::Nodes;
use super::prepare::onto;
use super::segments::Segment;
use crate::labelled::Facet;
use crate::refine::NEAREST_FOR_SHAPE;
use glam::DVec3;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use serde::Serialize;
use std::cmp::{Ordering, Reverse};
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

/// A new point keeps this part of h from all others where the topology or a grid node asks for it.
const NEAREST_FOR_TOPOLOGY: f64 = 0.05;

/// Ends of a segment are no nearer to the point that splits it than this part of its length.
const MIDDLE: f64 = 0.2;

/// Times that grid nodes are looked for in other materials, each time with an empty queue.
const NODE_ROUNDS: usize = 12;

/// Violations between two looks at whether to stop.
const BETWEEN_STEPS: usize = 1 << 10;

/// What the refinement did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RefineReport {
    /// Violations at the start, by what was violated; grid nodes come later.
    pub violations: BTreeMap<Reason, usize>,
    /// Points inserted, by what asked for them.
    pub inserted: BTreeMap<Reason, usize>,
    /// Of these, on junction curves.
    pub on_curves: usize,
    /// Parts of stars and runs round edges that were given to another material.
    pub relabelled: usize,
    /// Violations left, by what is violated: only points nearer to others than the smallest radius could mend them.
    pub unresolved: BTreeMap<Reason, usize>,
}

/// A violation in the queue: most needed first, then the roomiest, then by place.
#[derive(Clone, Copy, PartialEq)]
struct Entry(Violation);

impl Entry {
    fn place(&self) -> [f64; 3] {
        match self.0.remedy {
            Remedy::Point { place, .. } => place.to_array(),
            Remedy::Split(pair) => [f64::from(pair[0]), f64::from(pair[1]), 0.0],
            Remedy::None => [0.0; 3],
        }
    }
}

impl Eq for Entry {}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Ordering {
        let ([a, b, c], [d, e, f]) = (self.place(), other.place());
        let places = a.total_cmp(&d).then(b.total_cmp(&e)).then(c.total_cmp(&f));
        let by_room = self.0.radius.total_cmp(&other.0.radius);
        // the heap gives the greatest first
        other
            .0
            .reason
            .cmp(&self.0.reason)
            .then(by_room)
            .then(places)
            .then(Reverse(self.0.simplex).cmp(&Reverse(other.0.simplex)))
    }
}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// What came of a violation.
enum Outcome {
    /// A point was inserted; the violation may be there still.
    Inserted,
    /// There is no room for one.
    NoRoom,
}

/// A complex on the way to that of the indicators.
pub struct Refinement<'a> {
    /// The complex.
    pub complex: Complex<'a>,
    /// What was done.
    pub report: RefineReport,
    queue: BinaryHeap<Entry>,
    /// What there was no room for.
    without_room: BTreeSet<Simplex>,
}

impl<'a> Refinement<'a> {
    /// Begins with all violations of a complex.
    pub fn new(complex: Complex<'a>) -> Self {
        let facets = complex.labelled.facets();
        let found = all_violations(&complex, &facets);
        let mut report = RefineReport::default();
        found.iter().for_each(|v| *report.violations.entry(v.reason).or_default() += 1);
        Self { complex, report, queue: found.into_iter().map(Entry).collect(), without_room: BTreeSet::new() }
    }

    /// Adds points until nothing is violated, or there is no room. `nodes` are those of the grid, where they shall keep their materials; `step` hears the
    /// number of points and may stop the loop with an error. Returns the facets.
    ///
    /// # Errors
    /// Those of `step` and of the triangulation.
    pub fn run(&mut self, nodes: Option<&Nodes>, mut step: impl FnMut(usize) -> Result<()>) -> Result<Vec<Facet>> {
        for round in 0..=NODE_ROUNDS {
            self.drain(nodes, &mut step)?;
            let facets = self.complex.labelled.facets();
            let wrong = match nodes {
                Some(nodes) if round < NODE_ROUNDS => nodes.wrong(&self.complex, &facets),
                _ => Vec::new(),
            };
            let before = self.complex.points().len();
            let tree = KdTree::new(self.complex.points());
            for node in wrong {
                if let Some(nodes) = nodes
                    && let Some((near, _)) = tree.nearest(nodes.place(node))
                {
                    self.queue.extend(nodes.violation(&self.complex, node, near as u32).map(Entry));
                }
            }
            self.drain(nodes, &mut step)?;
            if self.complex.points().len() == before {
                break;
            }
        }
        self.report.relabelled += self.relabel(nodes);
        let facets = self.complex.labelled.facets();
        self.report.unresolved = BTreeMap::new();
        for violation in self.unresolved(&facets) {
            *self.report.unresolved.entry(violation.reason).or_default() += 1;
        }
        Ok(facets)
    }

    /// Violations of the topology that are left.
    pub fn unresolved(&self, facets: &[Facet]) -> Vec<Violation> {
        all_violations(&self.complex, facets).into_iter().filter(|v| v.reason.is_topology()).collect()
    }

    /// Works the queue off.
    fn drain(&mut self, nodes: Option<&Nodes>, step: &mut impl FnMut(usize) -> Result<()>) -> Result<()> {
        let mut count = 0;
        while let Some(Entry(old)) = self.queue.pop() {
            if count % BETWEEN_STEPS == 0 {
                step(self.complex.points().len())?;
            }
            count += 1;
            let now = match old.simplex {
                Simplex::Node(node) => nodes.and_then(|nodes| nodes.violation(&self.complex, node, old.near)),
                simplex => self.complex.at_simplex(simplex),
            };
            let Some(violation) = now else { continue };
            if violation.reason > old.reason {
                self.queue.push(Entry(violation));
                continue;
            }
            match self.mend(&violation)? {
                Outcome::Inserted => {
                    *self.report.inserted.entry(violation.reason).or_default() += 1;
                    let changed = self.complex.labelled.take_changed();
                    self.queue.extend(self.complex.at_tetrahedra(&changed).into_iter().map(Entry));
                    self.queue.push(Entry(violation));
                }
                Outcome::NoRoom => {
                    self.without_room.insert(violation.simplex);
                }
            }
        }
        Ok(())
    }

    /// Inserts the point that mends a violation, or splits the segment on which it encroaches.
    fn mend(&mut self, violation: &Violation) -> Result<Outcome> {
        let least = violation.size
            * if violation.reason == Reason::Deviation { NEAREST_FOR_SHAPE } else { NEAREST_FOR_TOPOLOGY };
        if violation.radius < least {
            return Ok(Outcome::NoRoom);
        }
        match violation.remedy {
            Remedy::None => Ok(Outcome::NoRoom),
            Remedy::Split(pair) => self.split(pair, least),
            Remedy::Point { place, stratum } => match self.complex.segments.encroached(place, self.complex.points()) {
                Some(pair) => self.split(pair, least),
                None => {
                    let inserted = self.complex.labelled.insert(place, violation.near)?;
                    Ok(self.settle(inserted, stratum, violation.size))
                }
            },
        }
    }

    /// Inserts the middle of a segment, on its curve, unless that is nearer than `least` to an end.
    fn split(&mut self, pair: Segment, least: f64) -> Result<Outcome> {
        let Some(curve) = self.complex.segments.curve(pair) else { return Ok(Outcome::NoRoom) };
        let [a, b] = pair.map(|v| self.complex.points()[v as usize]);
        let length = a.distance(b);
        let middle = onto(self.complex.indicators, curve, a.midpoint(b), 0.5 * length);
        let is_between = |p: &DVec3| p.distance(a).min(p.distance(b)) > (MIDDLE * length).max(least);
        let Some(middle) = middle.filter(is_between) else { return Ok(Outcome::NoRoom) };
        let size = 0.5 * (self.complex.sizes[pair[0] as usize] + self.complex.sizes[pair[1] as usize]);
        let inserted = self.complex.labelled.insert(middle, pair[0])?;
        let outcome = self.settle(inserted, curve, size);
        if let Some(v) = inserted {
            self.complex.segments.split(pair, v, self.complex.labelled.points());
            self.report.on_curves += 1;
        }
        Ok(outcome)
    }

    /// Takes note of a new point.
    fn settle(&mut self, inserted: Option<u32>, stratum: isoparticles_field::materials::Stratum, size: f64) -> Outcome {
        if inserted.is_none() {
            return Outcome::NoRoom;
        }
        self.complex.strata.push(stratum);
        self.complex.sizes.push(size);
        let indicators = self.complex.indicators;
        self.complex.labelled.decide(|centre| indicators.material_at(centre));
        Outcome::Inserted
    }
}

/// All violations of a complex but those of grid nodes, whose facets are given.
pub(super) fn all_violations(complex: &Complex, facets: &[Facet]) -> Vec<Violation> {
    let mut found: Vec<Violation> = facets.par_iter().filter_map(|f| complex.at_facet(f)).collect();
    let mut edges: Vec<[u32; 2]> = facets
        .iter()
        .flat_map(|f| (0..3).map(|k| super::segments::segment(f.vertices[k], f.vertices[(k + 1) % 3])))
        .chain(complex.segments.all().map(|(pair, _)| pair))
        .collect();
    edges.par_sort_unstable();
    edges.dedup();
    found.par_extend(edges.into_par_iter().filter_map(|edge| complex.at_any_edge(edge)));
    let mut vertices: Vec<u32> = facets.iter().flat_map(|f| f.vertices).collect();
    vertices.par_sort_unstable();
    vertices.dedup();
    found.par_extend(vertices.into_par_iter().filter_map(|v| complex.at_vertex(v)));
    found
}
