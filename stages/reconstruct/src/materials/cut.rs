//! Splits segments of junction curves at new points on their curves.

use super::prepare::onto;
use super::refine::Refinement;
use super::way::{self, LONGEST_WAY};
use crate::interfaces::Segment;
use glam::DVec3;
use isoparticles_field::materials::Stratum;
use isoparticles_field::materials::complex::{way_along, way_from};
use isoparticles_stage::error::Result;

/// Minimum distance between a new point and the ends of the segment that it splits, as a share of
/// the length of the segment.
const MIDDLE: f64 = 0.2;

impl Refinement<'_> {
    /// Splits a segment at a new point on its curve. The point is farther from both ends than
    /// `least` (mm) and than [`MIDDLE`] of the length. Returns false if there is no such point.
    pub(super) fn split(&mut self, pair: Segment, least: f64) -> Result<bool> {
        let Some(curve) = self.complex.segments.curve(pair) else { return Ok(false) };
        let Some(place) = self.cut(pair, curve, least) else { return Ok(false) };
        let size = 0.5 * (self.complex.sizes[pair[0] as usize] + self.complex.sizes[pair[1] as usize]);
        let inserted = self.complex.labelled.insert(place, pair[0])?;
        let outcome = self.settle(inserted, curve, size);
        if let Some(v) = inserted {
            self.complex.segments.split(pair, v, self.complex.labelled.points());
            self.report.on_curves += 1;
        }
        Ok(outcome)
    }

    /// Returns the position at which a segment is split: the middle of the path along its curve
    /// between its ends. If the curve cannot be followed to the other end, this is the farthest
    /// position that can be reached ([`Self::farthest`]) or, failing this, the projection of the
    /// midpoint of the segment onto the curve.
    fn cut(&self, pair: Segment, curve: Stratum, least: f64) -> Option<DVec3> {
        let indicators = self.complex.indicators;
        let ends @ [a, b] = pair.map(|v| self.complex.points()[v as usize]);
        let length = a.distance(b);
        let is_between = |p: &DVec3| p.distance(a).min(p.distance(b)) > (MIDDLE * length).max(least);
        let longest = LONGEST_WAY * length.max(indicators.voxel());
        if let Some(way) = way_along(indicators, curve, self.complex.labelled.upper(), ends, longest) {
            return self.middle(curve, &way).filter(is_between);
        }
        let projected = || onto(indicators, curve, a.midpoint(b), 0.5 * length);
        self.farthest(pair, curve).filter(is_between).or_else(|| projected().filter(is_between))
    }

    /// Returns the position that is reached from an end of a segment along its curve, away from the
    /// previous segment, over at most half the length of the segment. Of the two ends, the one with
    /// the longer path is used.
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

    /// Returns the other ends of the segments of a curve at a point.
    fn others(&self, point: u32, curve: Stratum) -> impl Iterator<Item = u32> + '_ {
        let segments = self.complex.segments.at(point);
        let own = segments.filter(move |&pair| self.complex.segments.curve(pair) == Some(curve));
        own.flatten().filter(move |&end| end != point)
    }

    /// Returns the position on a curve in the middle of a path on it.
    fn middle(&self, curve: Stratum, way: &[DVec3]) -> Option<DVec3> {
        let half = 0.5 * way::length(way);
        let mut passed = 0.0;
        let step = way.windows(2).find(|step| {
            passed += step[0].distance(step[1]);
            passed >= half
        })?;
        let own = step[0].distance(step[1]);
        let share = (passed - half) / own.max(f64::MIN_POSITIVE);
        onto(self.complex.indicators, curve, step[1].lerp(step[0], share), 0.5 * own)
    }
}
