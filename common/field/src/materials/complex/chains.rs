//! Junction curves as chains of vertices between junction points, brought onto the true ones, and freed of what the lattice alone has.

use super::Complex;
use super::cells::Segment;
use crate::materials::{Indicators, MaterialId, Stratum};
use glam::DVec3;
use isoparticles_mesh::components::DisjointSets;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// How far a vertex of a curve or a point may be from where the lattice has it, in voxels.
const FARTHEST: f64 = 1.0;

/// How closely points and curves are met, in voxels.
const TOLERANCE: f64 = 1e-7;

/// A place beyond the border of the grid goes back and forth between border and curve so often: each turn leaves the share that the cosine squared of the angle between
/// the two says.
const TURNS_AT_BORDER: usize = 12;

/// Junction points of the same four materials are one, if a chain shorter than this (voxels) joins them. Of the 26,530 chains that join such points in
/// `brain_parcellation`, 2,326 are shorter than a tenth, and from there on there are 500 to 600 to each tenth: what crowds near zero is one point that the lattice meets twice.
/// No particles fit between those a quarter apart, a third of the smallest h.
const MERGED_WITHIN: f64 = 0.25;

/// Points nearer than this (voxels) are the same, which Newton's method met from both.
const COINCIDENT: f64 = 0.01;

/// The same where they coincide, or Newton's method has not met one of the two: the lattice alone has it, in a pair that cancels. Of 2,787 such points in that volume 662 were left
/// when points within half a voxel were merged, 411 with three quarters.
const UNMET_MERGED_WITHIN: f64 = 1.0;

/// Closed curves shorter than this (voxels) are left out: two materials that touch on less than a fiftieth of the face of a voxel.
const SPECK: f64 = 0.5;

/// How far another material may undercut those of a vertex (voxels) for the vertex to count as real: rounding, and what Newton's method leaves.
const LEAST_CLEARANCE: f64 = -1e-6;

/// Where a chain ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// At the junction point of that number.
    Point(u32),
    /// At the border of the grid, with its last vertex.
    Border,
    /// Nowhere: it returns to its first vertex.
    Closed,
}

/// A junction curve between its ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// The three materials.
    pub curve: Stratum,
    /// Its vertices in order, junction points not included.
    pub vertices: Vec<u32>,
    /// What comes before the first vertex and after the last.
    pub ends: [End; 2],
}

impl Chain {
    /// Whether it has no ends.
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
pub struct Junction {
    /// The four materials.
    pub stratum: Stratum,
    /// Where it lies, grid frame, mm.
    pub position: DVec3,
    /// Whether the four are equal there, and no fifth is nearer; else it stays where the lattice has it.
    pub is_met: bool,
}

/// What became of a vertex on its way to its stratum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Met {
    Yes,
    /// Met, where another material is nearer.
    NotClear,
    No,
}

/// Makes chains and points of segments, and brings their vertices onto the strata; the grid ends at `corner`.
pub(super) fn trace<I: Indicators + ?Sized>(
    complex: &mut Complex,
    segments: &[Segment],
    indicators: &I,
    corner: DVec3,
) {
    let met = project(complex, indicators, corner);
    let tally = &mut complex.tally;
    let mut point_of = BTreeMap::new();
    for (v, vertex) in complex.vertices.iter().enumerate() {
        let is = |what: Met| usize::from(met[v] == what);
        match vertex.stratum.dimension() {
            0 => {
                point_of.insert(v as u32, complex.points.len() as u32);
                let (stratum, position) = (vertex.stratum, vertex.position);
                complex.points.push(Junction { stratum, position, is_met: met[v] == Met::Yes });
                tally.points += 1;
                tally.points_not_projected += is(Met::No);
                tally.points_not_clear += is(Met::NotClear);
            }
            1 => {
                tally.curve_vertices += 1;
                tally.curve_vertices_not_projected += is(Met::No);
                tally.curve_vertices_not_clear += is(Met::NotClear);
            }
            _ => {}
        }
    }
    let chains = walk(segments, &point_of);
    let voxel = indicators.voxel();
    complex.chains = chains.into_iter().map(|chain| without_strays(chain, &met)).collect();
    merge_points(complex, indicators);
    let before = complex.chains.len();
    let is_kept: Vec<bool> =
        complex.chains.iter().map(|chain| !chain.is_closed() || complex.length(chain) >= SPECK * voxel).collect();
    let mut kept = is_kept.into_iter();
    complex.chains.retain(|_| kept.next().unwrap_or(true));
    complex.tally.specks = before - complex.chains.len();
    let mut chains = std::mem::take(&mut complex.chains);
    let turned: usize = chains.iter_mut().map(|chain| drop_turns(chain, complex)).sum();
    complex.tally.curve_vertices_turned_back = turned;
    complex.chains = chains;
}

/// Brings the vertices of curves and points onto these, and tells what became of all.
fn project<I: Indicators + ?Sized>(complex: &mut Complex, indicators: &I, corner: DVec3) -> Vec<Met> {
    let voxel = indicators.voxel();
    let (limit, tolerance) = (FARTHEST * voxel, TOLERANCE * voxel);
    let each = complex.vertices.par_iter_mut().map(|vertex| {
        let found = match *vertex.stratum.materials() {
            [a, b, c, d] => indicators.project_onto_point([a, b, c, d], vertex.position, limit, tolerance),
            [a, b, c] => {
                let onto = |p: DVec3| indicators.project_onto_curve([a, b, c], p, limit, tolerance);
                let mut found = onto(vertex.position);
                for _ in 0..TURNS_AT_BORDER {
                    let beyond = found.filter(|&p| p != p.clamp(DVec3::ZERO, corner));
                    let Some(beyond) = beyond else { break };
                    found = onto(beyond.clamp(DVec3::ZERO, corner));
                }
                found.map(|p| p.clamp(DVec3::ZERO, corner))
            }
            _ => return Met::Yes,
        };
        let Some(found) = found else { return Met::No };
        if indicators.clearance(found, vertex.stratum.materials()) < LEAST_CLEARANCE * voxel {
            return Met::NotClear;
        }
        vertex.position = found;
        Met::Yes
    });
    each.collect()
}

/// Strings segments together.
fn walk(segments: &[Segment], point_of: &BTreeMap<u32, u32>) -> Vec<Chain> {
    let mut at: Vec<(u32, u32)> = (0..).zip(segments).flat_map(|(n, segment)| segment.ends.map(|v| (v, n))).collect();
    at.sort_unstable();
    let around = |v: u32| {
        let start = at.partition_point(|&(other, _)| other < v);
        at[start..].iter().take_while(move |&&(other, _)| other == v).map(|&(_, segment)| segment)
    };
    let mut is_taken = vec![false; segments.len()];
    let mut chains = Vec::new();
    let mut follow = |start: u32, first: u32, is_taken: &mut Vec<bool>| {
        let mut chain = Chain { curve: segments[first as usize].curve, vertices: Vec::new(), ends: [End::Closed; 2] };
        chain.ends[0] = match point_of.get(&start) {
            Some(&point) => End::Point(point),
            None => {
                chain.vertices.push(start);
                End::Border
            }
        };
        let (mut from, mut segment) = (start, first);
        loop {
            is_taken[segment as usize] = true;
            let [a, b] = segments[segment as usize].ends;
            let to = if a == from { b } else { a };
            if let Some(&point) = point_of.get(&to) {
                chain.ends[1] = End::Point(point);
                break;
            }
            if to == start {
                // once round: what was taken for an end is none
                chain.ends = [End::Closed; 2];
                break;
            }
            chain.vertices.push(to);
            match around(to).find(|&next| !is_taken[next as usize]) {
                Some(next) => (from, segment) = (to, next),
                None => {
                    chain.ends[1] = End::Border;
                    break;
                }
            }
        }
        chains.push(chain);
    };
    // from the ends first, then what has none
    for &point in point_of.keys() {
        for segment in around(point).collect::<Vec<_>>() {
            if !is_taken[segment as usize] {
                follow(point, segment, &mut is_taken);
            }
        }
    }
    for ends_alone in [true, false] {
        for own in at.chunk_by(|a, b| a.0 == b.0) {
            let (v, segment) = own[0];
            if !is_taken[segment as usize] && (!ends_alone || own.len() == 1) {
                follow(v, segment, &mut is_taken);
            }
        }
    }
    chains
}

/// A chain without the vertices that are not on its curve, but where it needs them: at the border. Of a closed one that is not met anywhere nothing is left.
fn without_strays(mut chain: Chain, met: &[Met]) -> Chain {
    let last = chain.vertices.len().saturating_sub(1);
    let ends = chain.ends;
    let kept = |n: usize, v: u32| {
        let is_border = (n == 0 && ends[0] == End::Border) || (n == last && ends[1] == End::Border);
        is_border || met[v as usize] == Met::Yes
    };
    let own: Vec<u32> = chain.vertices.iter().enumerate().filter(|&(n, &v)| kept(n, v)).map(|(_, &v)| v).collect();
    chain.vertices = own;
    chain
}

/// Merges the points of the same materials that short chains join, leaves out these chains, and lets those pass that need no end any more.
fn merge_points<I: Indicators + ?Sized>(complex: &mut Complex, indicators: &I) {
    let mut sets = DisjointSets::new(complex.points.len());
    let mut is_short = vec![false; complex.chains.len()];
    for (n, chain) in complex.chains.iter().enumerate() {
        if let [End::Point(a), End::Point(b)] = chain.ends {
            let [a_point, b_point] = [a, b].map(|point| complex.points[point as usize]);
            let apart = a_point.position.distance(b_point.position) > COINCIDENT * indicators.voxel();
            let share = if a_point.is_met && b_point.is_met && apart { MERGED_WITHIN } else { UNMET_MERGED_WITHIN };
            if a_point.stratum == b_point.stratum && complex.length(chain) < share * indicators.voxel() {
                is_short[n] = true;
                sets.join(a, b);
            }
        }
    }
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
        let of = |without: &MaterialId| curves.iter().filter(|curve| !curve.has(*without)).count();
        let counts: Vec<usize> = first.stratum.materials().iter().map(of).collect();
        if counts.iter().all(|count| count.is_multiple_of(2)) {
            complex.tally.points_passed += 1;
            pass(own, ends, &mut left, &mut same);
            continue;
        }
        complex.tally.points_irregular += usize::from(counts.iter().any(|&count| count != 1));
        complex.tally.points_merged += members.len() - 1;
        number.insert(own, kept.len() as u32);
        kept.push(merged(members, complex, indicators));
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

/// Joins the chains that end at a point, two and two of the same curve, so that they pass through it. `same` tells what has become one chain.
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

/// One point of several: where Newton's method leads from the first that is met or, where none is, from their middle; else that itself.
fn merged<I: Indicators + ?Sized>(members: &[u32], complex: &Complex, indicators: &I) -> Junction {
    let all: Vec<Junction> = members.iter().map(|&point| complex.points[point as usize]).collect();
    if let Some(met) = all.iter().find(|point| point.is_met) {
        return *met;
    }
    let middle = all.iter().map(|point| point.position).sum::<DVec3>() / all.len().max(1) as f64;
    let stratum = all[0].stratum;
    let voxel = indicators.voxel();
    let found = match *stratum.materials() {
        [a, b, c, d] if all.len() > 1 => {
            indicators.project_onto_point([a, b, c, d], middle, FARTHEST * voxel, TOLERANCE * voxel)
        }
        _ => None,
    };
    let met = found.filter(|&p| indicators.clearance(p, stratum.materials()) >= LEAST_CLEARANCE * voxel);
    Junction { stratum, position: met.unwrap_or(middle), is_met: met.is_some() }
}

/// Leaves out vertices at which a chain turns back, since neighbours on the lattice may be met in another order. Returns how many.
fn drop_turns(chain: &mut Chain, complex: &Complex) -> usize {
    let position = |v: u32| complex.vertices[v as usize].position;
    let end = |end: End| match end {
        End::Point(point) => Some(complex.points[point as usize].position),
        End::Border | End::Closed => None,
    };
    let before = chain.vertices.len();
    let mut kept: Vec<u32> = Vec::with_capacity(before);
    let first = end(chain.ends[0]);
    for (n, &v) in chain.vertices.iter().enumerate() {
        let next = chain.vertices.get(n + 1).map(|&next| position(next)).or_else(|| end(chain.ends[1]));
        let last = kept.last().map(|&last| position(last)).or(first);
        let turns = match (last, next) {
            (Some(last), Some(next)) => (position(v) - last).dot(next - position(v)) <= 0.0,
            _ => false,
        };
        if !turns {
            kept.push(v);
        }
    }
    if kept.len() >= 3 || !chain.is_closed() {
        chain.vertices = kept;
    }
    before - chain.vertices.len()
}
