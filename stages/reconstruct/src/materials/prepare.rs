//! Turns particles into the points of a complex. Each particle is projected onto its stratum.
//! Particles that are too close to others or encroach upon segments are removed. Consecutive points
//! on junction curves are connected by segments, and closed curves with too few points get more.
//! The result is triangulated.

use super::segments::Segments;
use super::way::{LONGEST_WAY, length};
use crate::interfaces::{Segment, segment};
use crate::prepare::{LONGEST_MOVE, ON_SURFACE, Placed, PrepareReport, SurfacePoints, projected};
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::materials::complex::{SAME_JUNCTION, way_along, way_round};
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::{Error, Result};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Indicators that differ by less than this, in voxels, count as equal if the projection onto a
/// curve or junction point does not converge. This happens next to a kink of the indicators.
const EQUAL: f64 = 1e-3;

/// A particle on an interface indicates a junction curve if the indicator of a third material
/// exceeds its own by at most this, in voxels. The curve is searched for within one voxel.
const NEAR_A_CURVE: f64 = 0.5;

/// A position on a curve counts as known if a path along the curve has a point within this
/// distance, in voxels. The steps of a path are at most about a fifth of a voxel long.
const ON_A_WAY: f64 = 0.15;

/// Triangulated points on strata.
pub struct Prepared {
    /// Delaunay triangulation of the points.
    pub delaunay: Delaunay,
    /// Stratum of each point.
    pub strata: Vec<Stratum>,
    /// Target edge length h at each point, mm.
    pub sizes: Vec<f64>,
    /// Segments of junction curves.
    pub segments: Segments,
    /// Numbers of particles and segments that were used, added or not used.
    pub report: PrepareReport,
}

/// A particle that has been projected onto its stratum.
#[derive(Clone, Copy)]
pub(super) struct Point {
    pub(super) place: DVec3,
    pub(super) stratum: Stratum,
    pub(super) size: f64,
}

/// Projects a position onto a stratum, at most `limit` mm away. Returns `None` if the stratum is
/// not real there. If the projection onto a curve or junction point fails, returns `start` if the
/// indicators there are equal to within [`EQUAL`].
pub(super) fn onto(indicators: &dyn Indicators, stratum: Stratum, start: DVec3, limit: f64) -> Option<DVec3> {
    let voxel = indicators.voxel();
    let tolerance = ON_SURFACE * voxel;
    let on = indicators.project_onto(stratum, start, limit, tolerance);
    let equal_there = || {
        let values = stratum.materials().iter().map(|&id| indicators.value_gradient(id, start).0);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        (stratum.dimension() < 2 && high - low < EQUAL * voxel).then_some(start)
    };
    on.or_else(equal_there).filter(|&p| indicators.clearance(p, stratum.materials()) > -SAME_JUNCTION * voxel)
}

/// Projects particles onto their strata, selects those that can be used, and triangulates them.
///
/// # Errors
/// If there is not one stratum for each particle, and those of [`crate::prepare::prepare`] and of
/// the triangulation.
pub fn prepare(particles: &ParticleSet, strata: &Strata, indicators: &dyn Indicators) -> Result<Prepared> {
    let count = particles.positions.len();
    if strata.of.len() != count {
        return Err(Error::input(
            format!("{count} particles with {} strata", strata.of.len()),
            "each particle needs one",
            "run the stages `seed` and `particles` again",
        ));
    }
    let upper = particles.geometry.upper_corner();
    let project = |v: usize| onto(indicators, strata.of[v], particles.positions[v], LONGEST_MOVE * indicators.voxel());
    let (points, mut report) = projected(particles, upper, project)?;
    let on = |(own, &stratum): (Option<Placed>, _)| own.map(|(place, size)| Point { place, stratum, size });
    let mut points: Vec<Option<Point>> = points.into_iter().zip(&strata.of).map(on).collect();
    let pairs = small_loops(&mut points, &strata.segments, (indicators, upper), &mut report);
    let (mut points, mut pairs) = without_the_lost(&points, pairs, &mut report);
    missing_loops(&mut points, &mut pairs, (indicators, upper), &mut report);
    let (points, pairs) = without_the_crowded(points, pairs, (indicators, upper), &mut report);
    triangulated(points, pairs, (indicators, upper), report)
}

/// Returns the pairs of consecutive points on curves, each once. Closed curves of one or two
/// particles get at least three points, because the two pairs of two particles would be one
/// segment.
fn small_loops(
    points: &mut Vec<Option<Point>>,
    pairs: &[[u32; 2]],
    (indicators, upper): (&dyn Indicators, DVec3),
    report: &mut PrepareReport,
) -> Vec<Segment> {
    let mut times: BTreeMap<Segment, usize> = BTreeMap::new();
    pairs.iter().for_each(|&[a, b]| *times.entry(segment(a, b)).or_default() += 1);
    let joined: BTreeSet<u32> = pairs.iter().flatten().copied().collect();
    let alone = (0..points.len() as u32).filter(|v| !joined.contains(v)).map(|v| (v, v));
    let twice = times.iter().filter(|(_, n)| **n > 1).map(|(&[a, b], _)| (a, b));
    let loops: Vec<(u32, u32)> = alone.chain(twice).collect();
    let mut all: Vec<Segment> = times.into_iter().filter(|&(_, n)| n == 1).map(|(pair, _)| pair).collect();
    for (first, second) in loops {
        let Some(point) = points[first as usize].filter(|p| p.stratum.dimension() == 1) else { continue };
        let Some(way) = way_round(indicators, point.stratum, upper, point.place) else { continue };
        let others = points.iter().flatten().filter(|other| other.stratum == point.stratum);
        let is_on_way =
            |other: &Point| way[1..].iter().any(|p| p.distance(other.place) < ON_A_WAY * indicators.voxel());
        if first == second && others.filter(|other| other.place != point.place).any(is_on_way) {
            points[first as usize] = None;
            continue;
        }
        // The points of the ring are about h apart and replace the second particle.
        let ring = ring(&point, &way);
        let chain: Vec<u32> = std::iter::once(first).chain(points.len() as u32..).take(ring.len()).collect();
        points[first as usize] = Some(ring[0]);
        points.extend(ring[1..].iter().copied().map(Some));
        if second != first {
            points[second as usize] = None;
        }
        report.on_small_loops += ring.len() - 1;
        all.extend(closed(&chain));
    }
    all
}

/// Returns points like `point` along a closed path that starts at its position: one for each h of
/// its length, but at least three.
fn ring(point: &Point, way: &[DVec3]) -> Vec<Point> {
    let count = ((length(way) / point.size).round() as usize).max(3).min(way.len());
    let size = point.size.min(length(way) / count as f64);
    (0..count).map(|n| Point { place: way[n * way.len() / count], size, ..*point }).collect()
}

/// Returns the segments of a closed chain.
fn closed(chain: &[u32]) -> impl Iterator<Item = Segment> + '_ {
    (0..chain.len()).map(|k| segment(chain[k], chain[(k + 1) % chain.len()]))
}

/// Adds closed curves that particles on interfaces indicate and no pair follows. An example is the
/// rim of a hole in a layer that is smaller than the lattice of `seed` resolves.
fn missing_loops(
    points: &mut Vec<Point>,
    pairs: &mut Vec<Segment>,
    (indicators, upper): (&dyn Indicators, DVec3),
    report: &mut PrepareReport,
) {
    let voxel = indicators.voxel();
    let mut known: BTreeMap<Stratum, Vec<DVec3>> = BTreeMap::new();
    let ways: Vec<(Stratum, Vec<DVec3>)> = with_curves(pairs, points, (indicators, upper))
        .into_par_iter()
        .map(|(pair, curve)| {
            let ends = pair.map(|v| points[v as usize].place);
            let longest = LONGEST_WAY * ends[0].distance(ends[1]).max(voxel);
            (curve, way_along(indicators, curve, upper, ends, longest).unwrap_or_else(|| ends.to_vec()))
        })
        .collect();
    ways.into_iter().for_each(|(curve, way)| known.entry(curve).or_default().extend(way));
    let trees: BTreeMap<Stratum, KdTree> = known.iter().map(|(curve, way)| (*curve, KdTree::new(way))).collect();
    let is_near = |p: DVec3, q: DVec3| p.distance(q) < ON_A_WAY * voxel;
    let unknown = |point: &Point| {
        let &[i, j] = point.stratum.materials() else { return None };
        let near = indicators.near(point.place);
        let (third, _) = *near.entries().iter().find(|(id, _)| !point.stratum.has(*id))?;
        if indicators.clearance(point.place, &[i, j]) > NEAR_A_CURVE * voxel {
            return None;
        }
        let curve = Stratum::new(&[i, j, third])?;
        let place = onto(indicators, curve, point.place, voxel)?;
        let is_known = trees.get(&curve).is_some_and(|tree| tree.nearest_within(place, ON_A_WAY * voxel).is_some());
        (!is_known).then_some(Point { place, stratum: curve, size: point.size })
    };
    let found: Vec<Point> = points.par_iter().filter_map(unknown).collect();
    let mut new: Vec<(Stratum, DVec3)> = Vec::new();
    for point in found {
        if new.iter().any(|(curve, place)| *curve == point.stratum && is_near(*place, point.place)) {
            continue;
        }
        let Some(way) = way_round(indicators, point.stratum, upper, point.place) else { continue };
        let ring = ring(&point, &way);
        let chain: Vec<u32> = (points.len() as u32..).take(ring.len()).collect();
        points.extend(ring);
        pairs.extend(closed(&chain));
        new.extend(way.into_iter().map(|place| (point.stratum, place)));
        report.loops_added += 1;
    }
}

/// Returns the projected points, and the pairs between them. Lost points are bridged.
fn without_the_lost(
    points: &[Option<Point>],
    pairs: Vec<Segment>,
    report: &mut PrepareReport,
) -> (Vec<Point>, Vec<Segment>) {
    let is_kept: Vec<bool> = points.iter().map(Option::is_some).collect();
    let (pairs, bridged) = bridged(&is_kept, pairs);
    report.bridged += bridged;
    let kept = points.iter().copied().flatten().collect();
    (kept, renumbered(&is_kept, pairs))
}

/// Returns the pairs between the points that are kept, and the number of bridges. A point that is
/// not kept and has two neighbours is replaced by a pair of these neighbours.
fn bridged(is_kept: &[bool], pairs: Vec<Segment>) -> (Vec<Segment>, usize) {
    let mut ends: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    let join = |ends: &mut BTreeMap<u32, BTreeSet<u32>>, a: u32, b: u32| {
        ends.entry(a).or_default().insert(b);
        ends.entry(b).or_default().insert(a);
    };
    pairs.into_iter().for_each(|[a, b]| join(&mut ends, a, b));
    let mut count = 0;
    let lost: Vec<u32> = ends.keys().copied().filter(|&v| !is_kept[v as usize]).collect();
    for v in lost {
        let around: Vec<u32> = ends.remove(&v).unwrap_or_default().into_iter().collect();
        for u in &around {
            ends.entry(*u).or_default().remove(&v);
        }
        if let [a, b] = around[..] {
            join(&mut ends, a, b);
            count += 1;
        }
    }
    let pairs = ends.iter().flat_map(|(&a, others)| others.iter().filter(move |&&b| a < b).map(move |&b| [a, b]));
    (pairs.collect(), count)
}

/// Returns pairs with the indices of their points among those kept.
fn renumbered(is_kept: &[bool], pairs: Vec<Segment>) -> Vec<Segment> {
    let numbers: Vec<u32> = is_kept
        .iter()
        .scan(0, |next, &kept| {
            let number = *next;
            *next += u32::from(kept);
            Some(number)
        })
        .collect();
    pairs.into_iter().map(|pair| pair.map(|v| numbers[v as usize])).collect()
}

/// Sorts points by the dimension of their strata, and removes points on interfaces that encroach
/// upon segments. The triangulation keeps the first of two points that are too close, which is then
/// the one on the lower stratum.
fn without_the_crowded(
    points: Vec<Point>,
    pairs: Vec<Segment>,
    (indicators, upper): (&dyn Indicators, DVec3),
    report: &mut PrepareReport,
) -> (Vec<Point>, Vec<Segment>) {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|&v| points[v].stratum.dimension());
    let mut number = vec![0u32; points.len()];
    order.iter().enumerate().for_each(|(n, &v)| number[v] = n as u32);
    let points: Vec<Point> = order.into_iter().map(|v| points[v]).collect();
    let pairs: Vec<Segment> = pairs.into_iter().map(|[a, b]| segment(number[a as usize], number[b as usize])).collect();
    let places: Vec<DVec3> = points.iter().map(|p| p.place).collect();
    let segments = Segments::new(with_curves(&pairs, &points, (indicators, upper)), &places);
    let is_free = |p: &&Point| p.stratum.dimension() < 2 || segments.encroached(p.place, &places).is_none();
    let is_kept: Vec<bool> = points.iter().map(|p| is_free(&p)).collect();
    report.encroaching += is_kept.iter().filter(|&&kept| !kept).count();
    let kept = points.into_iter().zip(&is_kept).filter(|(_, kept)| **kept).map(|(p, _)| p).collect();
    (kept, renumbered(&is_kept, pairs))
}

/// Returns the pairs with their curves. A pair with an end on a curve has this curve. Two junction
/// points with three common materials have the curve of these; with fewer, the pair is dropped.
///
/// Two junction points with four common materials have the shortest curve of three of them that
/// leads from one to the other. A curve with particles on this path is excluded, because the
/// segments on it are those of the particles. If no curve can be followed, the pair has the curve
/// with the maximum clearance at the midpoint.
fn with_curves(
    pairs: &[Segment],
    points: &[Point],
    (indicators, upper): (&dyn Indicators, DVec3),
) -> Vec<(Segment, Stratum)> {
    let mut on: BTreeMap<Stratum, Vec<DVec3>> = BTreeMap::new();
    let on_curves = points.iter().filter(|p| p.stratum.dimension() == 1);
    on_curves.for_each(|p| on.entry(p.stratum).or_default().push(p.place));
    let curve = |&[a, b]: &Segment| {
        let [a, b] = [a, b].map(|v| points[v as usize]);
        if let Some(own) = [a, b].into_iter().find(|p| p.stratum.dimension() == 1) {
            return Some(own.stratum);
        }
        let common: Vec<MaterialId> = a.stratum.materials().iter().copied().filter(|&id| b.stratum.has(id)).collect();
        if common.len() < 4 {
            return Stratum::new(&common).filter(|curve| curve.dimension() == 1);
        }
        let three = |skipped: &MaterialId| common.iter().copied().filter(|id| id != skipped).collect::<Vec<_>>();
        let curves: Vec<Stratum> = common.iter().filter_map(|skipped| Stratum::new(&three(skipped))).collect();
        let longest = LONGEST_WAY * a.place.distance(b.place).max(indicators.voxel());
        let is_taken = |curve: &Stratum, way: &[DVec3]| {
            let reach = ON_A_WAY * indicators.voxel();
            on.get(curve).into_iter().flatten().any(|p| way.iter().any(|q| q.distance(*p) < reach))
        };
        let free = |&curve: &Stratum| {
            let way = way_along(indicators, curve, upper, [a.place, b.place], longest)?;
            (!is_taken(&curve, &way)).then(|| (curve, length(&way)))
        };
        let shortest = curves.iter().filter_map(free).min_by(|a, b| a.1.total_cmp(&b.1));
        let middle = a.place.midpoint(b.place);
        let real = |curve: &Stratum| indicators.clearance(middle, curve.materials());
        let in_the_middle = || curves.iter().copied().max_by(|a, b| real(a).total_cmp(&real(b)));
        shortest.map(|(curve, _)| curve).or_else(in_the_middle)
    };
    pairs.par_iter().filter_map(|pair| Some((*pair, curve(pair)?))).collect()
}

fn triangulated(
    points: Vec<Point>,
    pairs: Vec<Segment>,
    (indicators, upper): (&dyn Indicators, DVec3),
    report: PrepareReport,
) -> Result<Prepared> {
    let mut surface = SurfacePoints {
        positions: points.iter().map(|p| p.place).collect(),
        sizes: points.iter().map(|p| p.size).collect(),
        normals: Vec::new(),
        lower: points.iter().map(|p| p.stratum).take_while(|stratum| stratum.dimension() < 2).collect(),
        report,
    };
    let delaunay = surface.triangulate()?;
    let mut report = surface.report;
    // the remaining points keep their order
    let mut left = surface.positions.iter().peekable();
    let is_kept: Vec<bool> = points.iter().map(|p| left.next_if(|&&place| place == p.place).is_some()).collect();
    let (pairs, count) = bridged(&is_kept, pairs);
    report.bridged += count;
    let pairs = renumbered(&is_kept, pairs);
    let points: Vec<Point> = points.into_iter().zip(&is_kept).filter(|(_, kept)| **kept).map(|(p, _)| p).collect();
    let segments = Segments::new(with_curves(&pairs, &points, (indicators, upper)), delaunay.points());
    report.segments = segments.count();
    let strata = points.iter().map(|p| p.stratum).collect();
    Ok(Prepared { strata, sizes: points.iter().map(|p| p.size).collect(), delaunay, segments, report })
}
