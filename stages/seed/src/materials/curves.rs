//! Places particles at junction points and along junction curves.

use super::{between, is_length};
use crate::sampling::DISK_RADIUS;
use glam::DVec3;
use isoparticles_field::materials::complex::{Chain, Complex, End, SAME_JUNCTION};
use isoparticles_field::materials::{Indicators, MaterialId};
use isoparticles_field::particle_set::Strata;
use isoparticles_field::sizing::SizingField;
use std::collections::BTreeSet;

/// Maximum step along a curve in units of h. The number of steps is the length of the curve in
/// units of h, rounded. With two or more steps, a step is at most 1.25 h long. A single step could
/// be 1.5 h long; if it is longer than this limit, it is divided into two steps of at least 0.65 h.
/// Every point of a step must be closer than [`DISK_RADIUS`] times h to one end of the step, so
/// that the particles at both ends keep particles on interfaces away from the whole step.
const LONGEST_STEP: f64 = 1.3;
const _: () = assert!(LONGEST_STEP > 1.25 && LONGEST_STEP < 2.0 * DISK_RADIUS, "a step has a wrong length");

/// Length in voxels below which a closed curve gets one particle instead of a ring of three, if it
/// is also shorter than h. Such a curve is at most one voxel across (half its length), so the data
/// does not resolve its shape.
const TINY_VOXELS: f64 = 2.0;

/// Minimum number of steps of a closed curve that is not tiny ([`TINY_VOXELS`]), and of a curve
/// that starts and ends at the same junction point: a polygon has at least three sides.
const RING: usize = 3;

/// Distance in voxels below which two particles are considered coincident: half the distance below
/// which the complex merges junction points. Coincident particles occur on chains of the complex
/// that have no counterpart in the true strata.
const DUPLICATE_DISTANCE: f64 = 0.5 * SAME_JUNCTION;

/// Maximum distance, in voxels, between a point of a chain and its projection onto the curve. It
/// equals the limit that the complex applies to the vertices of chains (`LONGEST_PROJECTION` in
/// `complex/chains.rs`).
const MAX_PROJECTION: f64 = 1.0;

/// Tolerance of the projection, in voxels, the same as in the complex. The spline coefficients are
/// f32 numbers with a magnitude of about one voxel near the zero set, where an ulp is 2^-23 =
/// 1.2e-7 voxel.
const TOLERANCE: f64 = 1e-7;

/// Particles at junction points, in the order of the complex, followed by particles on curves.
#[derive(Clone, Debug, Default)]
pub struct Curves {
    /// Positions in mm in the grid frame.
    pub positions: Vec<DVec3>,
    /// Unit tangents for particles on curves, zero for particles at points.
    pub normals: Vec<DVec3>,
    /// Edge lengths in mm: h or the longest adjacent step, whichever is smaller.
    pub sizes: Vec<f64>,
    /// Strata of the particles, and the segments of the curves.
    pub strata: Strata,
    /// Number of particles that were skipped because the projection onto their curve failed or
    /// another material is nearer.
    pub not_projected: usize,
}

/// Places particles at the points and along the chains of a complex. The spacing of the particles
/// follows `spread`; their sizes come from `sizing`.
pub fn seed_curves<I: Indicators>(
    indicators: &I,
    complex: &Complex,
    (spread, sizing): (&SizingField, &SizingField),
) -> Curves {
    let mut found = Curves::default();
    for point in &complex.points {
        found.positions.push(point.position);
        found.normals.push(DVec3::ZERO);
        found.strata.of.push(point.stratum);
    }
    // pairs of points connected by a curve with a single step; a second such curve is divided into
    // two steps, because otherwise the segments of the two curves would coincide
    let mut joined = BTreeSet::new();
    for chain in &complex.chains {
        let line = complex.line(chain);
        let along = Along::new(line, chain.is_closed(), spread);
        let mut steps = (along.total().round() as usize).max((along.total() / LONGEST_STEP).ceil() as usize).max(1);
        match chain.ends {
            [End::Point(a), End::Point(b)] if a == b => steps = steps.max(RING),
            [End::Point(a), End::Point(b)] if steps == 1 && !joined.insert((a.min(b), a.max(b))) => steps = 2,
            [End::Closed, _] => {
                let length = complex.length(chain);
                let is_tiny = along.total() < 1.0 && length < TINY_VOXELS * indicators.voxel();
                steps = if is_tiny { 1 } else { steps.max(RING) };
            }
            _ => {}
        }
        found.add(indicators, chain, &along, steps);
    }
    found.set_sizes(sizing);
    found
}

impl Curves {
    /// Divides a chain into `steps` steps and adds its particles. Skips particles that coincide
    /// with the previous particle or with an end of the chain.
    fn add<I: Indicators>(&mut self, indicators: &I, chain: &Chain, along: &Along, steps: usize) {
        let point = |end: End| match end {
            End::Point(point) => Some(point),
            End::Border | End::Closed => None,
        };
        let is_free = |n: usize| match chain.ends {
            [End::Closed, _] => n < steps,
            [first, last] => (n > 0 || point(first).is_none()) && (n < steps || point(last).is_none()),
        };
        let own: [MaterialId; 3] = match *chain.curve.materials() {
            [a, b, c] => [a, b, c],
            _ => return,
        };
        let voxel = indicators.voxel();
        let first = self.positions.len() as u32;
        let mut previous = point(chain.ends[0]);
        for n in (0..=steps).filter(|&n| is_free(n)) {
            let (place, way) = along.at(n as f64 / steps as f64);
            let met = indicators.project_onto_curve(own, place, MAX_PROJECTION * voxel, TOLERANCE * voxel);
            let Some(position) = met.filter(|&p| indicators.clearance(p, &own) >= -TOLERANCE * voxel) else {
                self.not_projected += 1;
                continue;
            };
            let is_near = |other: u32| self.positions[other as usize].distance(position) < DUPLICATE_DISTANCE * voxel;
            let is_closing = chain.is_closed() && self.positions.len() as u32 > first && is_near(first);
            if is_closing || previous.is_some_and(is_near) || point(chain.ends[1]).is_some_and(is_near) {
                continue;
            }
            let gradient = |other: MaterialId| indicators.difference_gradient(own[0], other, position).1;
            let tangent = gradient(own[1]).cross(gradient(own[2])).normalize_or_zero();
            let number = self.positions.len() as u32;
            self.positions.push(position);
            self.normals.push(if tangent.dot(way) < 0.0 { -tangent } else { tangent });
            self.strata.of.push(chain.curve);
            self.strata.segments.extend(previous.map(|previous| [previous, number]));
            previous = Some(number);
        }
        let last = if chain.is_closed() {
            (self.positions.len() as u32 > first + 1).then_some(first)
        } else {
            point(chain.ends[1])
        };
        if let (Some(previous), Some(last)) = (previous, last)
            && previous != last
        {
            self.strata.segments.push([previous, last]);
        }
    }

    /// Sets the size of each particle to h or to the longest adjacent step, whichever is smaller.
    fn set_sizes(&mut self, sizing: &SizingField) {
        let mut longest = vec![0.0f64; self.positions.len()];
        for segment in &self.strata.segments {
            let [a, b] = segment.map(|n| n as usize);
            let length = self.positions[a].distance(self.positions[b]);
            longest[a] = longest[a].max(length);
            longest[b] = longest[b].max(length);
        }
        let size = |(&p, &longest): (&DVec3, &f64)| {
            let h = sizing.at(p);
            if longest > 0.0 { h.min(longest) } else { h }
        };
        self.sizes = self.positions.iter().zip(&longest).map(size).collect();
    }
}

/// A polyline parametrized by its length in the metric ds / h.
struct Along {
    line: Vec<DVec3>,
    /// Integral of ds / h from the start of the line to each vertex.
    sums: Vec<f64>,
}

impl Along {
    fn new(mut line: Vec<DVec3>, is_closed: bool, sizing: &SizingField) -> Self {
        if is_closed && let Some(&first) = line.first() {
            line.push(first);
        }
        let mut sums = vec![0.0; line.len()];
        for n in 1..line.len() {
            let h = sizing.at(between(line[n - 1], line[n], 0.5));
            let step = line[n - 1].distance(line[n]);
            sums[n] = sums[n - 1] + if is_length(h) { step / h } else { 0.0 };
        }
        Self { line, sums }
    }

    fn total(&self) -> f64 {
        self.sums.last().copied().unwrap_or(0.0)
    }

    /// Returns the point at which the integral reaches the fraction `share` of its total, and the
    /// direction of the line there.
    fn at(&self, share: f64) -> (DVec3, DVec3) {
        let wanted = share * self.total();
        let after = self.sums.partition_point(|&sum| sum < wanted).clamp(1, self.line.len().max(2) - 1);
        let (Some(&a), Some(&b)) = (self.line.get(after - 1), self.line.get(after)) else {
            return (self.line.first().copied().unwrap_or_default(), DVec3::ZERO);
        };
        let (low, high) = (self.sums[after - 1], self.sums[after]);
        let within = if high > low { ((wanted - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 };
        (between(a, b, within), b - a)
    }
}
