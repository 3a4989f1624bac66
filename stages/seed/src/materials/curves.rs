//! Places particles at junction points and along junction curves.

use super::{between, is_length};
use glam::DVec3;
use isoparticles_field::materials::complex::{Chain, Complex, End};
use isoparticles_field::materials::{Indicators, MaterialId};
use isoparticles_field::particle_set::Strata;
use isoparticles_field::sizing::SizingField;
use std::collections::BTreeSet;

/// Longest step along a curve, in h. Rounding the number of steps gives steps of up to 1.5 h; if a
/// step would exceed this limit, the curve gets one more.
const LONGEST_STEP: f64 = 1.3;

/// A closed curve shorter than h and than this many voxels gets one particle instead of a ring of
/// three: it is below the resolution of the data.
const TINY_VOXELS: f64 = 2.0;

/// Minimum number of particles on other closed curves: fewer make no ring.
const RING: usize = 3;

/// A particle nearer than this share of a step to the previous one is skipped. The curve is then
/// shorter than its chain.
const NEAREST: f64 = 0.3;

/// Particles nearer than this, in voxels, count as coincident. They occur on chains that exist only
/// in the grid complex.
const COINCIDENT: f64 = 0.01;

/// Maximum distance from the chain to the curve, and tolerance of the projection, in voxels.
const FARTHEST: f64 = 1.0;
const TOLERANCE: f64 = 1e-7;

/// The particles at junction points, in the order of the complex, followed by those on curves.
#[derive(Clone, Debug, Default)]
pub struct Curves {
    /// Positions, grid frame, mm.
    pub positions: Vec<DVec3>,
    /// Zero at points, unit tangent on curves.
    pub normals: Vec<DVec3>,
    /// Edge lengths, mm: h, limited to the longest step to a neighbour.
    pub sizes: Vec<f64>,
    /// Strata of the particles, and the segments of the curves.
    pub strata: Strata,
    /// Places that were skipped because the projection onto their curve failed.
    pub not_projected: usize,
}

/// Places particles at the points and along the chains of a complex. Spacings follow `spread`,
/// sizes `sizing`.
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
    // pairs of points with a one-step curve; a second such curve needs a particle in between
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
        let nearest = |p: DVec3| NEAREST * spread.at(p) * along.total() / steps as f64;
        found.add(indicators, chain, &along, steps, nearest);
    }
    found.set_sizes(sizing);
    found
}

impl Curves {
    /// Adds the particles of a chain, `steps` steps along it. A particle is skipped if it is nearer
    /// than `nearest` at its place (mm) to the previous one or to an end.
    fn add<I: Indicators>(
        &mut self,
        indicators: &I,
        chain: &Chain,
        along: &Along,
        steps: usize,
        nearest: impl Fn(DVec3) -> f64,
    ) {
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
            let met = indicators.project_onto_curve(own, place, FARTHEST * voxel, TOLERANCE * voxel);
            let Some(position) = met.filter(|&p| indicators.clearance(p, &own) >= -TOLERANCE * voxel) else {
                self.not_projected += 1;
                continue;
            };
            let nearest = nearest(position).max(COINCIDENT * voxel);
            let is_near = |other: u32| self.positions[other as usize].distance(position) < nearest;
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

    /// Sets the sizes: h, limited to the longest step to a neighbour.
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

/// A polyline with the metric ds / h.
struct Along {
    line: Vec<DVec3>,
    /// The integral of ds / h up to each vertex.
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

    /// The place at a share of the integral, and the direction of the line there.
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
