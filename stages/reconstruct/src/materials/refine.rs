//! Delaunay refinement of a complex: one priority queue of violations, a point for each, and only what changed is looked at again (Cheng, Dey and Levine 2008).
//!
//! Segments of junction curves come first, then facets, edges and vertices of another topology than the indicators', then facets that stray, then grid nodes in
//! another material. A point that would lie in the ball of which a segment is a diameter splits the segment in its place (Ruppert 1995). The queue ends empty,
//! or with violations that only points nearer to others than the smallest radius could mend: these are counted and shown.

use super::complex::{Complex, Mend, Violation};
use super::nodes::Nodes;
use super::prepare::onto;
use super::segments::{Segment, segment};
use super::topology::Simplices;
use super::way::{self, LONGEST_WAY, ONE_CURVE};
use crate::around::star;
use crate::labelled::Facet;
use crate::queue::{NEAREST_FOR_SHAPE, NEAREST_FOR_TOPOLOGY, Queue, Reason, Refine, Remedy, Simplex};
use glam::DVec3;
use isoparticles_field::materials::Stratum;
use isoparticles_field::materials::complex::{way_from, ways_along};
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Ends of a segment are no nearer to the point that splits it than this part of its length.
const MIDDLE: f64 = 0.2;

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
    passes: BTreeSet<(Segment, u32)>,
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
    fn at_nodes(&self) -> Vec<Violation> {
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

    /// Has a segment pass through a point that its curve passes; where there is none, inserts a point of its curve between its ends, unless that is nearer than `least` to one of them; true
    /// when it did either. A point is inserted next to the one that lies deepest in the ball of
    /// which the segment is a diameter, if there is one: where two curves run side by side, nearer to each other than their points are, these come to lie in pairs,
    /// and both curves' segments are edges (the ball on a side of a rectangle holds no corner). Else in the middle.
    fn split(&mut self, pair: Segment, least: f64) -> Result<bool> {
        let Some(curve) = self.complex.segments.curve(pair) else { return Ok(false) };
        let [a, b] = pair.map(|v| self.complex.points()[v as usize]);
        let length = a.distance(b);
        let is_between = |p: &DVec3| p.distance(a).min(p.distance(b)) > (MIDDLE * length).max(least);
        let way = self.way(pair, curve);
        let (near, distance) = self.complex.labelled.nearest(a.midpoint(b), pair[0]);
        let is_within = !pair.contains(&near) && distance < 0.5 * length;
        let on_way = way.iter().flat_map(|way| self.on_way(way, pair[0]));
        let passed = on_way.into_iter().find(|&v| self.can_pass(pair, v));
        if let Some(point) = passed {
            return Ok(self.pass(pair, point));
        }
        let beside = way.as_ref().filter(|_| is_within).and_then(|way| {
            let (foot, _) = way::foot(way, self.complex.points()[near as usize]);
            self.place_on(curve, way, foot)
        });
        let middle = || match &way {
            Some(way) => self.place_on(curve, way, 0.5 * way::length(way)),
            None => self.farthest(pair, curve),
        };
        let place = beside.filter(is_between).or_else(|| middle().filter(is_between));
        let onto = || self.onto_curve(curve, a.midpoint(b), 0.5 * length).filter(is_between);
        let place = match place {
            None => match self.linked(pair, curve).into_iter().find(|&v| self.can_pass(pair, v)) {
                Some(point) => return Ok(self.pass(pair, point)),
                None if way.is_none() => onto(),
                None => None,
            },
            place => place,
        };
        let Some(place) = place else { return Ok(false) };
        let (known, distance) = self.complex.labelled.nearest(place, near);
        let is_known = !pair.contains(&known)
            && self.complex.strata[known as usize].is_on(&curve)
            && distance < ONE_CURVE * self.complex.indicators.voxel();
        if is_known {
            return Ok(self.can_pass(pair, known) && self.pass(pair, known));
        }
        let size = 0.5 * (self.complex.sizes[pair[0] as usize] + self.complex.sizes[pair[1] as usize]);
        let inserted = self.complex.labelled.insert(place, pair[0])?;
        let outcome = self.settle(inserted, curve, size);
        if let Some(v) = inserted {
            self.complex.segments.split(pair, v, self.complex.labelled.points());
            self.report.on_curves += 1;
        }
        Ok(outcome)
    }

    /// Has a segment pass through a point; true.
    fn pass(&mut self, pair: Segment, point: u32) -> bool {
        self.passes.insert((pair, point));
        self.report.passes += 1;
        self.complex.pass(pair, point);
        true
    }

    /// Points of curves that a way passes within `ONE_CURVE`, without those at its ends; `near` is one not far from its first place.
    fn on_way(&self, way: &[DVec3], near: u32) -> Vec<u32> {
        let reach = ONE_CURVE * self.complex.indicators.voxel();
        let whole = way::length(way);
        let is_passed = |&v: &u32| {
            let (foot, distance) = way::foot(way, self.complex.points()[v as usize]);
            distance < reach && foot > 0.0 && foot < whole && self.complex.strata[v as usize].dimension() < 2
        };
        let middles = way.windows(2).map(|step| step[0].midpoint(step[1]));
        let mut near = near;
        let mut nearest = |place: DVec3| {
            near = self.complex.labelled.nearest(place, near).0;
            near
        };
        let mut found: Vec<u32> = way.iter().copied().chain(middles).map(&mut nearest).filter(is_passed).collect();
        let mut known = BTreeSet::new();
        found.retain(|&v| known.insert(v));
        found
    }

    /// Junction points in the ball of which a segment is a diameter, or nearer to it than `ONE_CURVE`, that have segments with one of its ends or lie nearest to it, and at which all materials of its curve meet: where the curve is one with another
    /// it may be undercut, and these lead on.
    fn linked(&self, pair: Segment, curve: Stratum) -> Vec<u32> {
        let points = self.complex.points();
        let [a, b] = pair.map(|v| points[v as usize]);
        let reach = ONE_CURVE * self.complex.indicators.voxel();
        let is_beside = |v: &u32| {
            let place = points[*v as usize];
            (place - a).dot(place - b) < 0.0 || way::foot(&[a, b], place).1 < reach
        };
        let ends = pair.into_iter().flat_map(|v| self.complex.segments.at(v)).flatten();
        let ends = ends.chain(self.on_way(&[a, b], pair[0]));
        let leads = |v: &u32| {
            let own = self.complex.strata[*v as usize];
            own.dimension() == 0 && own.is_on(&curve)
        };
        ends.filter(|v| !pair.contains(v) && is_beside(v) && leads(v)).collect()
    }

    /// Whether a segment can give way to two by way of a point that its curve passes, and no curve is left open by that: what lies nearer together than `ONE_CURVE` is one.
    /// Without it two curves that coincide over some length would be refined without end, as neither's segments can be edges beside the other's points.
    fn can_pass(&self, pair: Segment, point: u32) -> bool {
        let segments = &self.complex.segments;
        let is_new = || !self.passes.contains(&(pair, point)) || segments.is_covered(pair, point);
        let strata = &self.complex.strata;
        let is_left_open = |&end: &u32| {
            let is_linked = segments.curve(segment(end, point)).is_some();
            strata[end as usize].dimension() == 1 && is_linked && segments.at(end).count() < 3
        };
        strata[point as usize].dimension() < 2
            && is_new()
            && !pair.iter().any(is_left_open)
            && segments.can_pass(pair, point, self.complex.points())
    }

    /// The way along the curve of a segment from one end to the other, the shortest of those of four materials. One that leaves an end by a segment of the same curve is that
    /// of other segments, round a loop: a curve goes on where it comes from only at its ends.
    fn way(&self, pair: Segment, curve: Stratum) -> Option<Vec<DVec3>> {
        let indicators = self.complex.indicators;
        let ends = pair.map(|v| self.complex.points()[v as usize]);
        let longest = LONGEST_WAY * ends[0].distance(ends[1]).max(indicators.voxel());
        // a point of curves that are one lies on one of them
        let own =
            |curve: Stratum| ends.map(|p| onto(indicators, curve, p, ONE_CURVE * indicators.voxel()).unwrap_or(p));
        let is_its_own = |curve: Stratum, way: &[DVec3]| {
            let along = |v: u32| way::foot(way, self.complex.points()[v as usize]).0;
            let mut same = self.on_way(way, pair[0]);
            same.retain(|&v| self.complex.strata[v as usize] == curve);
            same.sort_by(|&a, &b| along(a).total_cmp(&along(b)));
            let [Some(&first), Some(&last)] = [same.first(), same.last()] else { return true };
            let is_taken = |end: u32, next: u32| {
                let known: Vec<u32> = self.others(end, curve).collect();
                self.complex.strata[end as usize] == curve && known.contains(&next) && known.len() < 3
            };
            !is_taken(pair[0], first) && !is_taken(pair[1], last)
        };
        let ways = curve.curves().flat_map(|curve| {
            let mut ways = ways_along(indicators, curve, self.complex.labelled.upper(), own(curve), longest);
            ways.retain(|way| is_its_own(curve, way));
            ways
        });
        ways.min_by(|a, b| way::length(a).total_cmp(&way::length(b)))
    }

    /// The other ends of the segments of a curve at a point.
    fn others(&self, point: u32, curve: Stratum) -> impl Iterator<Item = u32> + '_ {
        let segments = self.complex.segments.at(point);
        let own = segments.filter(move |&pair| self.complex.segments.curve(pair) == Some(curve));
        own.flatten().filter(move |&end| end != point)
    }

    /// Where the curve of a segment leads from one of its ends, away from the segment before, half of the segment's length along: of both ends the one from which it leads farther.
    fn farthest(&self, pair: Segment, curve: Stratum) -> Option<DVec3> {
        let [a, b] = pair;
        let place = |v: u32| self.complex.points()[v as usize];
        let longest = 0.5 * place(a).distance(place(b));
        let way = |end: u32, other: u32| {
            let before = self.others(end, curve).find(|&v| v != other);
            let heading = before.map_or_else(|| place(other) - place(end), |v| place(end) - place(v));
            way_from(self.complex.indicators, curve, self.complex.labelled.upper(), (place(end), heading), longest)
        };
        let ways = [way(a, b), way(b, a)];
        let farthest = ways.into_iter().max_by(|a, b| way::length(a).total_cmp(&way::length(b)));
        farthest.and_then(|way| way.last().copied())
    }

    /// The place of a curve so far along a way on it, mm.
    fn place_on(&self, curve: Stratum, way: &[DVec3], along: f64) -> Option<DVec3> {
        let mut sum = 0.0;
        let step = way.windows(2).find(|step| {
            sum += step[0].distance(step[1]);
            sum >= along
        })?;
        let own = step[0].distance(step[1]);
        let share = (sum - along) / own.max(f64::MIN_POSITIVE);
        self.onto_curve(curve, step[1].lerp(step[0], share), 0.5 * own)
    }

    /// The place of a segment's curve near another.
    fn onto_curve(&self, curve: Stratum, place: DVec3, limit: f64) -> Option<DVec3> {
        curve.curves().find_map(|curve| onto(self.complex.indicators, curve, place, limit))
    }

    /// Takes note of a point, if it is new; true when it is.
    fn settle(&mut self, inserted: Option<u32>, stratum: Stratum, size: f64) -> bool {
        if inserted.is_none() {
            return false;
        }
        self.complex.strata.push(stratum);
        self.complex.sizes.push(size);
        self.complex.decide();
        true
    }
}
