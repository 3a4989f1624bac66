//! Traces junction curves as chains of vertices between junction points. The lattice vertices on
//! curves and points are first projected onto the true strata. [`Follower`] then follows each curve
//! from a projected vertex. Each curve becomes one chain, regardless of how the lattice connects
//! its vertices.

use super::follow::{self, Follower, LONGEST_STEP, PASSING_DISTANCE, SAME_JUNCTION, Stop, TOLERANCE, UNDERCUT};
use super::{Complex, Vertex};
use crate::materials::{Indicators, MaterialId, Stratum};
use glam::DVec3;
use isoparticles_mesh::components::DisjointSets;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_mesh::spatial::Bins;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum distance in voxels between a lattice vertex and its projection onto a curve or point:
/// the edge length of a grid cell. With limits of 0.5, 1 and 2, 1,279, 260 and 226 vertices of the
/// brain crop (see `follow.rs`) cannot be projected. The chains are the same in all three cases.
const LONGEST_PROJECTION: f64 = 1.0;

/// Length of a chain, in voxels, below which the junction points at its ends are merged if they
/// have the same four materials. Such points are one junction point that was found twice. A chain
/// of this length is too short for particles: a third of the minimum h (0.75 voxel).
const MERGED_WITHIN: f64 = 0.25;

/// Minimum length of a closed curve, in voxels. Shorter closed curves are dropped. A circle of this
/// circumference encloses 0.5^2 / (4 pi) = 0.02 of the area of a voxel face.
const SPECK: f64 = 0.5;

/// An end of a chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The chain ends at the junction point with this index.
    Point(u32),
    /// The chain ends with a vertex on the border of the grid, or where the curve could not be
    /// followed further.
    Border,
    /// The chain has no end: it is closed and returns to its first vertex.
    Closed,
}

/// A connected piece of a junction curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// The three materials that meet on the curve.
    pub curve: Stratum,
    /// Vertex indices in order, without junction points.
    pub vertices: Vec<u32>,
    /// The ends of the chain, before its first vertex and after its last vertex.
    pub ends: [End; 2],
}

impl Chain {
    /// Returns whether the chain is closed.
    pub fn is_closed(&self) -> bool {
        self.ends[0] == End::Closed
    }

    fn reversed(mut self) -> Self {
        self.vertices.reverse();
        self.ends.reverse();
        self
    }
}

/// A junction point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JunctionPoint {
    /// The four materials that meet at the point.
    pub stratum: Stratum,
    /// Position in the grid frame, mm.
    pub position: DVec3,
}

/// Result of projecting a vertex onto its stratum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Met {
    /// Projected, and no other indicator is smaller at the new position.
    Yes,
    /// Projected, but another indicator is smaller at the new position.
    NotClear,
    /// Not projected.
    No,
}

/// Finds the chains and junction points of `indicators`, starting from the lattice vertices in
/// `complex`. `corner` is the upper corner of the grid in mm.
pub(super) fn trace<I: Indicators + ?Sized>(complex: &mut Complex, indicators: &I, corner: DVec3) {
    let met = project(complex, indicators, corner);
    let mut starts: BTreeMap<Stratum, Vec<DVec3>> = BTreeMap::new();
    let mut met_points = Vec::new();
    for (vertex, met) in complex.vertices.iter().zip(met) {
        let tally = &mut complex.tally;
        let [all, no, not_clear] = match vertex.stratum.dimension() {
            0 => {
                met_points.extend((met == Met::Yes).then_some(vertex.position));
                [&mut tally.points, &mut tally.points_not_projected, &mut tally.points_not_clear]
            }
            1 => {
                if met == Met::Yes {
                    starts.entry(vertex.stratum).or_default().push(vertex.position);
                }
                let [no, not_clear] = [&mut tally.curve_vertices_not_projected, &mut tally.curve_vertices_not_clear];
                [&mut tally.curve_vertices, no, not_clear]
            }
            _ => continue,
        };
        *all += 1;
        *no += usize::from(met == Met::No);
        *not_clear += usize::from(met == Met::NotClear);
    }
    let starts: Vec<(Stratum, Vec<DVec3>)> = starts.into_iter().collect();
    let lines = starts.par_iter().flat_map_iter(|(curve, starts)| lines_from(indicators, corner, *curve, starts));
    let lines: Vec<Line> = lines.collect();
    let reach = SAME_JUNCTION * indicators.voxel();
    let points = Points {
        reach,
        met: KdTree::new(&met_points),
        met_places: met_points,
        all: Vec::new(),
        bins: Bins::new(reach),
    };
    let voxel = indicators.voxel();
    let (known, same) = (StepIndex { voxel, ..StepIndex::default() }, Vec::new());
    let mut assembly = Assembly { complex, points, leaving: BTreeSet::new(), known, same };
    lines.into_iter().for_each(|line| assembly.add(line, None));
    assembly.complete(indicators, corner);
    let Assembly { points, same, .. } = assembly;
    complex.points = points.all;
    merge_points(complex, indicators, &same);
    let before = complex.chains.len();
    let is_kept: Vec<bool> = complex
        .chains
        .iter()
        .map(|chain| !chain.is_closed() || complex.length(chain) >= SPECK * indicators.voxel())
        .collect();
    let mut kept = is_kept.into_iter();
    complex.chains.retain(|_| kept.next().unwrap_or(true));
    complex.tally.specks = before - complex.chains.len();
}

/// Projects the vertices of curves and points onto their strata. Returns the result for each
/// vertex.
fn project<I: Indicators + ?Sized>(complex: &mut Complex, indicators: &I, corner: DVec3) -> Vec<Met> {
    let voxel = indicators.voxel();
    let (limit, tolerance) = (LONGEST_PROJECTION * voxel, TOLERANCE * voxel);
    let each = complex.vertices.par_iter_mut().map(|vertex| {
        let found = match *vertex.stratum.materials() {
            [a, b, c, d] => indicators.project_onto_point([a, b, c, d], vertex.position, limit, tolerance),
            [a, b, c] => {
                Follower { indicators, corner, own: [a, b, c], undercut: UNDERCUT }.onto(vertex.position, limit)
            }
            _ => return Met::Yes,
        };
        let Some(found) = found else { return Met::No };
        if indicators.clearance(found, vertex.stratum.materials()) < -UNDERCUT * voxel {
            return Met::NotClear;
        }
        vertex.position = found;
        Met::Yes
    });
    each.collect()
}

/// A junction curve that has been followed.
struct Line {
    curve: Stratum,
    /// Positions along the curve, without junction points.
    places: Vec<DVec3>,
    /// Whether the positions are ordered along the tangent.
    is_along: bool,
    /// Reasons why the curve ends before the first position and after the last position.
    ends: [Stop; 2],
}

/// Returns the curves of three materials that pass through the given positions, each curve once.
fn lines_from<I: Indicators + ?Sized>(indicators: &I, corner: DVec3, curve: Stratum, starts: &[DVec3]) -> Vec<Line> {
    let &[i, j, k] = curve.materials() else { return Vec::new() };
    let follower = Follower { indicators, corner, own: [i, j, k], undercut: UNDERCUT };
    let tree = KdTree::new(starts);
    let mut is_passed = vec![false; starts.len()];
    let mut lines = Vec::new();
    for (n, &start) in starts.iter().enumerate() {
        if std::mem::replace(&mut is_passed[n], true) {
            continue;
        }
        let mut hear = |a: DVec3, b: DVec3| {
            let reach = (0.5 + PASSING_DISTANCE) * a.distance(b);
            tree.each_within((a.midpoint(b), reach), usize::MAX, &mut |n, place| {
                is_passed[n as usize] |= follow::is_passed(place, a, b);
                None
            });
            true
        };
        let (places, _, ends) = follower.follow_both_ways(start, &mut hear);
        lines.push(Line { curve, places, is_along: true, ends });
    }
    lines
}

/// Returns all triples of the given materials, each triple in ascending order.
fn triples(ids: &[MaterialId]) -> Vec<[MaterialId; 3]> {
    let mut ids = ids.to_vec();
    ids.sort_unstable();
    let count = ids.len();
    let pairs = (0..count).flat_map(|c| (0..c).map(move |b| (b, c)));
    pairs.flat_map(|(b, c)| (0..b).map(move |a| [a, b, c])).map(|own| own.map(|n| ids[n])).collect()
}

/// Junction points at which curves end, without duplicates.
struct Points {
    /// Positions closer than this distance, in mm, count as one point.
    reach: f64,
    /// Lattice vertices that Newton's method projected onto junction points. They are more accurate
    /// than the last position on a curve that could not be followed to its end.
    met: KdTree,
    met_places: Vec<DVec3>,
    all: Vec<JunctionPoint>,
    /// Indices of the points, binned by position.
    bins: Bins<u32>,
}

impl Points {
    /// Returns the index of the point at a position, and adds the point if it is new.
    fn number(&mut self, position: DVec3, stratum: Stratum) -> u32 {
        let is_here = |n: &&u32| self.all[**n as usize].position.distance(position) < self.reach;
        if let Some(&number) = self.bins.near(position).find(is_here) {
            return number;
        }
        let number = self.all.len() as u32;
        self.bins.add(position, number);
        let position = self.met.nearest_within(position, self.reach).map_or(position, |(n, _)| self.met_places[n]);
        self.all.push(JunctionPoint { stratum, position });
        number
    }
}

/// Adds followed curves to a complex.
struct Assembly<'a> {
    complex: &'a mut Complex,
    points: Points,
    /// Curves that leave each point, along the tangent (true) or against it (false).
    leaving: BTreeSet<(u32, Stratum, bool)>,
    /// Curves that have been added.
    known: StepIndex,
    /// Pairs of points to be merged.
    same: Vec<[u32; 2]>,
}

impl Assembly<'_> {
    /// Adds a curve. If `from` is given, this point is the first end of the curve. A curve that the
    /// complex already contains is not added. If the existing chain ends at another point of the
    /// same materials close to `from`, the two points are marked for merging. Such points occur
    /// where four indicators are almost equal along a curve, so that Newton's method finds the
    /// junction point at several positions.
    fn add(&mut self, line: Line, from: Option<u32>) {
        let position = |point: u32| self.points.all[point as usize].position;
        let end = |stop: Stop| if let Stop::Point(place, _) = stop { Some(place) } else { None };
        let first = from.map(position).or(end(line.ends[0]));
        let path: Vec<DVec3> = first.into_iter().chain(line.places.iter().copied()).chain(end(line.ends[1])).collect();
        let chain_of = |n: u32| self.complex.chains[n as usize].ends;
        if let Some(n) = self.known.chain_along(line.curve, &path, line.is_along) {
            let Some(from) = from else { return };
            let is_here = |other: &u32| {
                let [own, other] = [from, *other].map(|point| self.points.all[point as usize]);
                let distance = own.position.distance(other.position);
                own.stratum == other.stratum && distance < MERGED_WITHIN * self.known.voxel
            };
            let ends = chain_of(n).into_iter().filter_map(|end| if let End::Point(p) = end { Some(p) } else { None });
            self.same.extend(ends.filter(is_here).map(|other| [from, other]));
            return;
        }
        self.known.add(self.complex.chains.len() as u32, line.curve, &path, line.is_along);
        let mut end = |stop: Stop, is_first: bool| {
            let point = match stop {
                _ if is_first && from.is_some() => from,
                Stop::Point(place, stratum) => Some(self.points.number(place, stratum)),
                Stop::Start => return End::Closed,
                Stop::Border => return End::Border,
                Stop::Lost | Stop::Told => {
                    self.complex.tally.curves_lost += 1;
                    return End::Border;
                }
            };
            point.map_or(End::Border, |point| {
                self.leaving.insert((point, line.curve, is_first == line.is_along));
                End::Point(point)
            })
        };
        let ends = [end(line.ends[0], true), end(line.ends[1], false)];
        let first = self.complex.vertices.len() as u32;
        let stratum = line.curve;
        self.complex.vertices.extend(line.places.into_iter().map(|position| Vertex { position, stratum }));
        let vertices = (first..self.complex.vertices.len() as u32).collect();
        self.complex.chains.push(Chain { curve: line.curve, vertices, ends });
    }

    /// Follows the curves that leave known points but pass through no lattice vertex.
    fn complete<I: Indicators + ?Sized>(&mut self, indicators: &I, corner: DVec3) {
        let voxel = indicators.voxel();
        let mut next = 0;
        while let Some(&JunctionPoint { position, .. }) = self.points.all.get(next) {
            let point = next as u32;
            next += 1;
            let near = indicators.near(position);
            let smallest = near.entries().first().map_or(f64::INFINITY, |(_, value)| *value);
            let equal = near.entries().iter().filter(|(_, value)| value - smallest < SAME_JUNCTION * voxel);
            let ids: Vec<MaterialId> = equal.map(|(id, _)| *id).collect();
            for own in triples(&ids).into_iter().filter(|own| indicators.are_separate(own)) {
                let Some(curve) = Stratum::new(&own) else { continue };
                let follower = Follower { indicators, corner, own, undercut: UNDERCUT };
                for is_along in [true, false] {
                    if self.leaving.contains(&(point, curve, is_along)) || !follower.leaves(position, is_along) {
                        continue;
                    }
                    let (places, last) = follower.follow(position, if is_along { 1.0 } else { -1.0 }, |_, _| true);
                    self.add(Line { curve, places, is_along, ends: [Stop::Lost, last] }, Some(point));
                }
            }
        }
    }
}

/// The steps of the curves that have been added to a complex, indexed by position.
#[derive(Default)]
struct StepIndex {
    voxel: f64,
    /// For each curve: its steps in the direction of the tangent, binned by midpoint. Each step is
    /// stored with the index of its chain.
    steps: BTreeMap<Stratum, Bins<(u32, [DVec3; 2])>>,
}

impl StepIndex {
    /// Returns the steps of a path in the direction of the tangent.
    fn along(path: &[DVec3], is_along: bool) -> impl Iterator<Item = [DVec3; 2]> + '_ {
        path.windows(2).map(move |step| if is_along { [step[0], step[1]] } else { [step[1], step[0]] })
    }

    /// Adds the steps of a chain.
    fn add(&mut self, chain: u32, curve: Stratum, path: &[DVec3], is_along: bool) {
        let bins = self.steps.entry(curve).or_insert_with(|| Bins::new(2.0 * LONGEST_STEP * self.voxel));
        Self::along(path, is_along).for_each(|[a, b]| bins.add(a.midpoint(b), (chain, [a, b])));
    }

    /// Returns the existing chain that a path follows in the same direction. At each end, a part of
    /// the path is ignored: [`MERGED_WITHIN`] or a third of the path, whichever is shorter.
    fn chain_along(&self, curve: Stratum, path: &[DVec3], is_along: bool) -> Option<u32> {
        let bins = self.steps.get(&curve)?;
        let length: f64 = path.windows(2).map(|step| step[0].distance(step[1])).sum();
        let margin = (MERGED_WITHIN * self.voxel).min(length / 3.0);
        let mut passed = 0.0;
        let mut inner = Vec::new();
        for (step, [a, b]) in path.windows(2).zip(Self::along(path, is_along)) {
            let half = 0.5 * step[0].distance(step[1]);
            let middle = passed + half;
            passed += 2.0 * half;
            if middle >= margin && length - middle >= margin {
                inner.push((a.midpoint(b), b - a));
            }
        }
        let reach = PASSING_DISTANCE * LONGEST_STEP * self.voxel;
        let chains_at = |&(place, way): &(DVec3, DVec3)| {
            let is_on =
                |[a, b]: &[DVec3; 2]| (*b - *a).dot(way) > 0.0 && follow::distance_from_step(place, *a, *b) < reach;
            bins.near(place).filter(|(_, step)| is_on(step)).map(|(chain, _)| *chain).collect::<BTreeSet<u32>>()
        };
        let mut chains = chains_at(inner.first()?);
        for at in &inner[1..] {
            if chains.is_empty() {
                return None;
            }
            let here = chains_at(at);
            chains.retain(|chain| here.contains(chain));
        }
        chains.first().copied()
    }
}

/// Returns the sets of points to be merged, and whether each chain is too short to keep. Points are
/// merged if they are a pair in `same`, or if they have the same materials and a chain shorter than
/// [`MERGED_WITHIN`] joins them.
fn merged_sets(complex: &Complex, same: &[[u32; 2]], voxel: f64) -> (DisjointSets, Vec<bool>) {
    let mut sets = DisjointSets::new(complex.points.len());
    same.iter().for_each(|&[a, b]| sets.join(a, b));
    let mut is_short = vec![false; complex.chains.len()];
    for (n, chain) in complex.chains.iter().enumerate() {
        if let [End::Point(a), End::Point(b)] = chain.ends {
            let [a_point, b_point] = [a, b].map(|point| complex.points[point as usize]);
            if a_point.stratum == b_point.stratum && complex.length(chain) < MERGED_WITHIN * voxel {
                is_short[n] = true;
                sets.join(a, b);
            }
        }
    }
    (sets, is_short)
}

/// Merges junction points: the pairs in `same`, and points of the same materials that a short chain
/// joins. Drops the short chains. Removes each point through which all of its curves continue, and
/// joins the chains of these curves.
fn merge_points<I: Indicators + ?Sized>(complex: &mut Complex, indicators: &I, same: &[[u32; 2]]) {
    let (mut sets, is_short) = merged_sets(complex, same, indicators.voxel());
    let mut members: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for point in 0..complex.points.len() as u32 {
        members.entry(sets.find(point)).or_default().push(point);
    }
    let mut left: Vec<Option<Chain>> = Vec::new();
    for (chain, is_short) in std::mem::take(&mut complex.chains).into_iter().zip(is_short) {
        let moved = chain.ends.map(|end| match end {
            End::Point(point) => End::Point(sets.find(point)),
            other => other,
        });
        left.push((!is_short || moved[0] != moved[1]).then_some(Chain { ends: moved, ..chain }));
    }
    // the chains that end at each point
    let mut at: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (n, chain) in (0..).zip(&left) {
        for end in chain.iter().flat_map(|chain| chain.ends) {
            if let End::Point(point) = end {
                at.entry(point).or_default().push(n);
            }
        }
    }
    let (mut kept, mut number) = (Vec::new(), BTreeMap::new());
    let mut same = DisjointSets::new(left.len());
    for (&own, members) in &members {
        let first = complex.points[own as usize];
        let ends = at.get(&own).map_or(&[][..], Vec::as_slice);
        let curves: Vec<Stratum> =
            ends.iter().filter_map(|&n| left[same.find(n) as usize].as_ref().map(|chain| chain.curve)).collect();
        // the outside and spaces beyond planes, which are one region, meet on no curve
        let ids = first.stratum.materials();
        let others = |without: MaterialId| -> Vec<_> { ids.iter().copied().filter(|&id| id != without).collect() };
        let has_curve = |without: &&MaterialId| indicators.are_separate(&others(**without));
        let of = |without: &MaterialId| curves.iter().filter(|curve| !curve.has(*without)).count();
        let counts: Vec<usize> = ids.iter().filter(has_curve).map(of).collect();
        if counts.iter().all(|count| count.is_multiple_of(2)) {
            complex.tally.points_passed += 1;
            pass(own, ends, &mut left, &mut same);
            continue;
        }
        complex.tally.points_irregular += usize::from(counts.iter().any(|&count| count != 1));
        complex.tally.points_merged += members.len() - 1;
        number.insert(own, kept.len() as u32);
        kept.push(first);
    }
    complex.points = kept;
    let renumbered = |chain: Chain| {
        let ends = chain.ends.map(|end| match end {
            End::Point(point) => End::Point(number.get(&point).copied().unwrap_or(0)),
            other => other,
        });
        Chain { ends, ..chain }
    };
    complex.chains = left.into_iter().flatten().map(renumbered).collect();
}

/// Joins chains of the same curve pairwise where they end at the point `own`. `same` maps each
/// joined chain to the chain that remains.
fn pass(own: u32, ends: &[u32], left: &mut [Option<Chain>], same: &mut DisjointSets) {
    loop {
        let mut numbers: Vec<u32> = ends.iter().map(|&n| same.find(n)).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let mut open: Vec<(Stratum, u32, usize)> = Vec::new();
        for &n in &numbers {
            if let Some(chain) = &left[n as usize] {
                let here = (0..2).filter(|&end| chain.ends[end] == End::Point(own));
                open.extend(here.map(|end| (chain.curve, n, end)));
            }
        }
        open.sort_unstable();
        let Some(&[first, second]) = open.windows(2).find(|pair| pair[0].0 == pair[1].0) else { return };
        if first.1 == second.1 {
            let place = &mut left[first.1 as usize];
            *place = place.take().filter(|chain| !chain.vertices.is_empty());
            if let Some(chain) = place {
                chain.ends = [End::Closed; 2];
            }
            continue;
        }
        let (Some(a), Some(b)) = (left[first.1 as usize].take(), left[second.1 as usize].take()) else { return };
        let (mut a, b) = (if first.2 == 0 { a.reversed() } else { a }, if second.2 == 1 { b.reversed() } else { b });
        a.vertices.extend(b.vertices);
        a.ends[1] = b.ends[1];
        same.join(first.1, second.1);
        left[same.find(first.1) as usize] = Some(a);
    }
}
