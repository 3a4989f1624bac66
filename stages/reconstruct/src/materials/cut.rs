//! Splits segments of junction curves. The split is at an existing point that the curve of the
//! segment passes within `ONE_CURVE`, or at a new point on the curve between the ends of the
//! segment. Paths along the curve come from `ways_along` and `way_from`.

use super::prepare::onto;
use super::refine::Refinement;
use super::way::{self, LONGEST_WAY, ONE_CURVE};
use crate::interfaces::Segment;
use glam::DVec3;
use isoparticles_field::materials::Stratum;
use isoparticles_field::materials::complex::{way_from, ways_along};
use isoparticles_stage::error::Result;
use std::collections::BTreeSet;

/// Minimum distance between a new point and the ends of the segment that it splits, as a share of
/// the length of the segment.
const MIDDLE: f64 = 0.2;

/// Position at which a segment is split.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cut {
    /// An existing point.
    At(u32),
    /// A new point in the grid frame, mm.
    New(DVec3),
}

impl Refinement<'_> {
    /// Splits a segment at the position that [`cut`](Self::cut) returns. Returns false if there is
    /// none. A new point is at least `least` (mm) from both ends.
    pub(super) fn split(&mut self, pair: Segment, least: f64) -> Result<bool> {
        let Some((curve, cut)) = self.cut(pair, least) else { return Ok(false) };
        let place = match cut {
            Cut::At(point) => {
                self.passes.insert((pair, point));
                self.report.passes += 1;
                self.complex.pass(pair, point);
                return Ok(true);
            }
            Cut::New(place) => place,
        };
        let size = 0.5 * (self.complex.sizes[pair[0] as usize] + self.complex.sizes[pair[1] as usize]);
        let inserted = self.complex.labelled.insert(place, pair[0])?;
        let outcome = self.settle(inserted, curve, size);
        if let Some(v) = inserted {
            // A new point on a segment of four materials lies on one of their curves. The others
            // pass it within `ONE_CURVE`.
            if curve.dimension() < 1 {
                self.complex.joined.insert(v, ONE_CURVE * self.complex.indicators.voxel());
            }
            self.complex.segments.split(pair, v, self.complex.labelled.points());
            self.report.on_curves += 1;
        }
        Ok(outcome)
    }

    /// Returns the curve of a segment and the position at which the segment is split. In order of
    /// preference, this is:
    /// - an existing point that the curve passes,
    /// - a new point on the curve between the ends ([`Self::new_place`]),
    /// - a junction point returned by [`Self::linked`],
    /// - if the curve cannot be followed, the projection of the midpoint of the segment onto the
    ///   curve.
    ///
    /// New points are at least `least` (mm) from both ends. Returns `None` if there is no such
    /// position.
    fn cut(&self, pair: Segment, least: f64) -> Option<(Stratum, Cut)> {
        let curve = self.complex.segments.curve(pair)?;
        let [a, b] = pair.map(|v| self.complex.points()[v as usize]);
        let length = a.distance(b);
        let is_between = |p: &DVec3| p.distance(a).min(p.distance(b)) > (MIDDLE * length).max(least);
        let way = self.way(pair, curve);
        let first = |points: Vec<u32>| points.into_iter().find(|&v| self.can_pass(pair, v));
        if let Some(point) = way.as_ref().and_then(|way| first(self.on_way(way, pair[0]))) {
            return Some((curve, Cut::At(point)));
        }
        if let Some(place) = self.new_place(pair, curve, way.as_deref()).filter(is_between) {
            return self.cut_near(pair, curve, place);
        }
        if let Some(point) = first(self.linked(pair, curve)) {
            return Some((curve, Cut::At(point)));
        }
        let on_curve = way.is_none().then(|| self.onto_curve(curve, a.midpoint(b), 0.5 * length)).flatten();
        self.cut_near(pair, curve, on_curve.filter(is_between)?)
    }

    /// Returns a new position on the curve of a segment: the middle of the path between its ends
    /// or, if the curve cannot be followed to the other end, the farthest position that can be
    /// reached ([`Self::farthest`]).
    fn new_place(&self, pair: Segment, curve: Stratum, way: Option<&[DVec3]>) -> Option<DVec3> {
        match way {
            Some(way) => self.place_on(curve, way, 0.5 * way::length(way)),
            None => self.farthest(pair, curve),
        }
    }

    /// Returns a cut at a new position, or at an existing point of the curve within `ONE_CURVE` of
    /// it. Returns `None` if the segment cannot be split at the existing point.
    fn cut_near(&self, pair: Segment, curve: Stratum, place: DVec3) -> Option<(Stratum, Cut)> {
        let (known, distance) = self.complex.labelled.nearest(place, pair[0]);
        let is_known = !pair.contains(&known)
            && self.complex.strata[known as usize].is_on(&curve)
            && distance < ONE_CURVE * self.complex.indicators.voxel();
        match is_known {
            true => self.can_pass(pair, known).then_some((curve, Cut::At(known))),
            false => Some((curve, Cut::New(place))),
        }
    }

    /// Returns the points on junction curves, and the junction points, that a path passes within
    /// `ONE_CURVE` between its ends. `near` is a vertex near the start of the path.
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

    /// Returns the junction points that have all materials of the curve of a segment, and that
    /// share a segment with one of its ends or that the segment passes within `ONE_CURVE`. They lie
    /// in the diametral ball of the segment, or within `ONE_CURVE` of the segment.
    ///
    /// A merged curve cannot be followed where a fourth material has a smaller indicator. These
    /// points then continue it.
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

    /// Returns whether a segment can be split at an existing point that its curve passes. A segment
    /// is split at the same point at most once, unless other segments of its curve already connect
    /// the point to both ends.
    ///
    /// Without such splits, two curves that coincide over some length would be refined
    /// indefinitely. The points of each curve prevent segments of the other from being edges.
    fn can_pass(&self, pair: Segment, point: u32) -> bool {
        let segments = &self.complex.segments;
        let is_new = || !self.passes.contains(&(pair, point)) || segments.is_covered(pair, point);
        self.complex.strata[point as usize].dimension() < 2
            && is_new()
            && segments.can_pass(pair, point, self.complex.points())
    }

    /// Returns the path along the curve of a segment from one end to the other. For a segment of
    /// four materials, it is the shortest path on one of their curves. Paths that leave an end
    /// along another segment of the same curve are excluded: they follow the other segments of a
    /// closed curve. This does not apply to ends at junction points.
    fn way(&self, pair: Segment, curve: Stratum) -> Option<Vec<DVec3>> {
        let indicators = self.complex.indicators;
        let ends = pair.map(|v| self.complex.points()[v as usize]);
        let longest = LONGEST_WAY * ends[0].distance(ends[1]).max(indicators.voxel());
        // A point on merged curves lies exactly on only one of them.
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

    /// Returns the other ends of the segments of a curve at a point.
    fn others(&self, point: u32, curve: Stratum) -> impl Iterator<Item = u32> + '_ {
        let segments = self.complex.segments.at(point);
        let own = segments.filter(move |&pair| self.complex.segments.curve(pair) == Some(curve));
        own.flatten().filter(move |&end| end != point)
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

    /// Returns the position on a curve at the arc length `along` (mm) of a path on it.
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

    /// Projects a position onto the curve of a segment, at most `limit` mm away. For a segment of
    /// four materials, this is the first of their curves for which the projection succeeds.
    fn onto_curve(&self, curve: Stratum, place: DVec3, limit: f64) -> Option<DVec3> {
        curve.curves().find_map(|curve| onto(self.complex.indicators, curve, place, limit))
    }
}
