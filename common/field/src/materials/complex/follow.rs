//! Follows junction curves step by step from a position on the curve to the ends of the curve. Each
//! step is a predictor step along the tangent, followed by a projection back onto the curve with
//! Newton's method. Positions are in the grid frame, mm.

use crate::materials::{Indicators, MaterialId, Stratum};
use glam::DVec3;

// Sensitivity of the constants below, measured on two label crops with `distfield --material all`
// and `Complex::new`: `brain_parcellation` (nodes x 60 to 111, y and z 100 to 151; 4,195 chains)
// and `frog_tissue_labels` (x 220 to 283, y 200 to 263, z 50 to 109; 403 chains). The numbers of
// chains, closed chains, junction points and lost curves are the same with each of these values:
//
// - on both crops, `LEAST_COSINE` of 0.6 and 0.9, `LARGEST_CORRECTION` of 0.25 and 0.7, and
//   `PASSING_DISTANCE` of 0.1 and 0.5;
// - on the frog crop, `LONGEST_STEP` of 0.1 and 0.4, `SHORTEST_STEP` of 0.0005 and 0.002,
//   `EQUAL_CLEARANCE` of 0.0002 and 0.01, and `END_TOLERANCE` of 0.003 and 0.03.

/// Distance, in voxels, below which two junction points count as one. Labels determine the position
/// of a junction only to within a fraction of a voxel, far more than this distance. Where more than
/// four materials meet, the clearance at this distance decides which curves leave the point.
pub const SAME_JUNCTION: f64 = 0.02;

/// Maximum length of a step along a curve, in voxels. On a curve with a radius of one voxel, a
/// chord of this length is within 0.2^2 / 8 = 0.005 voxel of the arc. With 0.1, 0.2 and 0.4, the
/// curves of the frog crop have a total length of 3,327, 3,321 and 3,309 mm. A step is halved until
/// the cosine of the angle between the tangents at its ends is at least [`LEAST_COSINE`].
pub(super) const LONGEST_STEP: f64 = 0.2;

/// Minimum length of a step along a curve, in voxels: a twentieth of [`SAME_JUNCTION`]. Where a
/// shorter step would be needed, the curve ends.
const SHORTEST_STEP: f64 = 1e-3;

/// Minimum cosine of the angle between the tangents at the two ends of a step. At this angle, 37
/// degrees, a chord of [`LONGEST_STEP`] deviates from the arc by at most 0.0811 of its own length:
/// 0.016 voxel, less than [`SAME_JUNCTION`].
const LEAST_COSINE: f64 = 0.8;

const _: () = assert!(0.0811 * LONGEST_STEP < SAME_JUNCTION, "a step could deviate from its curve");

/// Maximum Newton correction after a step, as a fraction of the step length. The step must also
/// advance by more than this fraction of its length. On a circular arc that turns by the angle of
/// [`LEAST_COSINE`], the correction is 1/3 of the step length and the advance is 0.8 of it. The
/// constant lies between these values, so that steps along curves of varying curvature are
/// accepted.
const LARGEST_CORRECTION: f64 = 0.5;

/// Maximum distance of a position from a step that passes it, as a fraction of the step length. The
/// arc deviates from the step by at most a twelfth of the step length ([`LEAST_COSINE`]). The
/// fraction is three times as large, because the position may be the result of a separate
/// projection onto the curve. For the longest step, this limit is 0.05 voxel.
pub(super) const PASSING_DISTANCE: f64 = 0.25;

/// Clearance, in voxels, below which a fourth material counts as equally near where a curve cannot
/// be followed further. Indicators have slope 1, so the clearance changes by at most 2 d over a
/// distance d. The curve ends within [`SHORTEST_STEP`] of the junction point.
const EQUAL_CLEARANCE: f64 = 2.0 * SHORTEST_STEP;

/// Maximum distance, in voxels, of the end of a path from a position that it reaches. Two paths
/// that reach the same position then end within [`SAME_JUNCTION`] of each other.
const END_TOLERANCE: f64 = 0.5 * SAME_JUNCTION;

/// Maximum number of steps in one direction. This many steps of maximum length cover 100,000
/// voxels, and their positions take 12 MiB. A longer curve counts as lost. The longest curve of the
/// two crops takes 812 steps.
const MOST_STEPS: usize = 1 << 19;

/// Tolerance, in voxels, of projections onto points and curves: about one ulp of a coefficient,
/// which is an f32 with a magnitude of about one voxel near the zero set (2^-23 = 1.2e-7).
pub(super) const TOLERANCE: f64 = 1e-7;

/// Maximum amount, in voxels, by which another indicator may be smaller than the indicators of a
/// stratum where the stratum exists. It is ten times [`TOLERANCE`], to cover the differences that a
/// projection leaves between the indicators of the stratum.
pub(super) const UNDERCUT: f64 = 1e-6;

/// Maximum number of pairs of projections, onto the border of the grid and onto the curve, for a
/// position beyond the border. Each pair multiplies the error by the squared cosine of the angle
/// between border and curve. At 45 degrees, twelve pairs reduce an error of 0.2 voxel (the longest
/// step) to 5e-5 voxel. The result is then clamped to the grid.
const TURNS_AT_BORDER: usize = 12;

/// The reason why a curve ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Stop {
    /// The curve reaches a junction point, where a fourth material is equally near. The values are
    /// the position of the point and the four materials.
    Point(DVec3, Stratum),
    /// The curve reaches the border of the grid.
    Border,
    /// The curve returns to its start.
    Start,
    /// The curve cannot be followed further, for example because two of its interfaces become
    /// tangent.
    Lost,
    /// The callback ended the path.
    Told,
}

/// Returns at least three positions along a closed junction curve, starting with `from`. Returns
/// `None` if the curve does not return to `from`. `corner` is the upper corner of the grid in mm.
pub fn way_round<I: Indicators + ?Sized>(
    indicators: &I,
    curve: Stratum,
    corner: DVec3,
    from: DVec3,
) -> Option<Vec<DVec3>> {
    let &[i, j, k] = curve.materials() else { return None };
    let follower = Follower { indicators, corner, own: [i, j, k], undercut: UNDERCUT };
    let (mut way, at, ends) = follower.follow_both_ways(from, |_, _| true);
    way.rotate_left(at);
    (ends == [Stop::Start; 2] && way.len() >= 3).then_some(way)
}

/// Returns the shortest path along a junction curve from one position on it to another, including
/// both positions. `corner` is the upper corner of the grid in mm. The search in each direction
/// stops when its path reaches the length `longest` (mm). A path may cross parts of the curve where
/// another indicator is smaller by less than [`SAME_JUNCTION`], because positions a step apart do
/// not resolve such parts.
pub fn way_along<I: Indicators + ?Sized>(
    indicators: &I,
    curve: Stratum,
    corner: DVec3,
    [from, to]: [DVec3; 2],
    longest: f64,
) -> Option<Vec<DVec3>> {
    let &[i, j, k] = curve.materials() else { return None };
    let follower = Follower { indicators, corner, own: [i, j, k], undercut: SAME_JUNCTION };
    let there = END_TOLERANCE * indicators.voxel();
    let way = |sign: f64| {
        let (mut length, mut is_there) = (0.0, false);
        let (mut places, stop) = follower.follow(from, sign, |a, b| {
            is_there = is_passed(to, a, b) || to.distance(b) < there;
            length += a.distance(if is_there { to } else { b });
            !is_there && length < longest
        });
        if stop == Stop::Lost {
            let (back, stop) = follower.follow(to, -sign, |a, b| {
                length += a.distance(b);
                length < longest
            });
            is_there = stop == Stop::Lost && follower.meet(&[from, to], &places, &back);
            places.extend(back.into_iter().rev());
        }
        is_there.then(|| (length, std::iter::once(from).chain(places).chain([to]).collect::<Vec<_>>()))
    };
    let ways = [way(1.0), way(-1.0)].into_iter().flatten();
    ways.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, places)| places)
}

/// Returns a path along a junction curve. It starts at a position on the curve and runs in the
/// direction closer to `heading`. The path ends after `longest` (mm), or where the curve ends or
/// cannot be followed.
pub fn way_from<I: Indicators + ?Sized>(
    indicators: &I,
    curve: Stratum,
    corner: DVec3,
    (from, heading): (DVec3, DVec3),
    longest: f64,
) -> Vec<DVec3> {
    let &[i, j, k] = curve.materials() else { return Vec::new() };
    let follower = Follower { indicators, corner, own: [i, j, k], undercut: SAME_JUNCTION };
    let sign = if follower.tangent(from).dot(heading) < 0.0 { -1.0 } else { 1.0 };
    let mut length = 0.0;
    let (places, _) = follower.follow(from, sign, |a, b| {
        length += a.distance(b);
        length < longest
    });
    std::iter::once(from).chain(places).collect()
}

/// Follows the junction curves of three materials.
pub(super) struct Follower<'a, I: ?Sized> {
    pub(super) indicators: &'a I,
    /// Upper corner of the grid in mm.
    pub(super) corner: DVec3,
    pub(super) own: [MaterialId; 3],
    /// Maximum amount, in voxels, by which the indicator of another material may be smaller than
    /// the indicators of the three materials.
    pub(super) undercut: f64,
}

impl<I: Indicators + ?Sized> Follower<'_, I> {
    /// Returns the unit tangent at a position on a curve. The order of the materials determines its
    /// direction along the whole curve.
    pub(super) fn tangent(&self, place: DVec3) -> DVec3 {
        let gradient = |other: MaterialId| self.indicators.difference_gradient(self.own[0], other, place).1;
        gradient(self.own[1]).cross(gradient(self.own[2])).normalize_or_zero()
    }

    /// Projects a position onto the curve within the grid. `limit` (mm) is the maximum displacement
    /// of a single projection.
    pub(super) fn onto(&self, place: DVec3, limit: f64) -> Option<DVec3> {
        let tolerance = TOLERANCE * self.indicators.voxel();
        let onto = |p: DVec3| self.indicators.project_onto_curve(self.own, p, limit, tolerance);
        let mut found = onto(place);
        for _ in 0..TURNS_AT_BORDER {
            let beyond = found.filter(|&p| !self.is_in_grid(p));
            let Some(beyond) = beyond else { break };
            found = onto(beyond.clamp(DVec3::ZERO, self.corner));
        }
        found.map(|p| p.clamp(DVec3::ZERO, self.corner))
    }

    fn is_in_grid(&self, p: DVec3) -> bool {
        p == p.clamp(DVec3::ZERO, self.corner)
    }

    /// Returns whether two lost paths end at the same position, at a turn too sharp to follow.
    /// `starts` contains the start of each path, or the start that both paths share.
    fn meet(&self, starts: &[DVec3], forth: &[DVec3], back: &[DVec3]) -> bool {
        let last = |way: &[DVec3], start: usize| *way.last().unwrap_or(&starts[start]);
        last(forth, 0).distance(last(back, starts.len() - 1)) < END_TOLERANCE * self.indicators.voxel()
    }

    /// Returns whether no other indicator is smaller by more than `undercut` at a position on a
    /// curve.
    pub(super) fn is_real(&self, place: DVec3) -> bool {
        self.indicators.clearance(place, &self.own) >= -self.undercut * self.indicators.voxel()
    }

    /// Returns the position one step further along the curve. Returns `None` if the projection
    /// fails, the curve turns too much, or the step advances too little.
    fn ahead(&self, place: DVec3, tangent: DVec3, sign: f64, step: f64) -> Option<DVec3> {
        let limit = LARGEST_CORRECTION * step;
        let tolerance = TOLERANCE * self.indicators.voxel();
        let found = self.indicators.project_onto_curve(self.own, place + step * tangent, limit, tolerance)?;
        let is_smooth = sign * self.tangent(found).dot(tangent) >= LEAST_COSINE;
        (is_smooth && (found - place).dot(tangent) > LARGEST_CORRECTION * step).then_some(found)
    }

    /// Returns whether the curve is real at a distance of [`SAME_JUNCTION`] from a junction point,
    /// in the direction of its tangent (`is_along`) or against it.
    pub(super) fn leaves(&self, point: DVec3, is_along: bool) -> bool {
        let (step, sign) = (SAME_JUNCTION * self.indicators.voxel(), if is_along { 1.0 } else { -1.0 });
        let next = self.ahead(point, sign * self.tangent(point), sign, step);
        next.is_some_and(|p| self.indicators.clearance(p, &self.own) > 0.0)
    }

    /// Follows a curve from a position on it, along its tangent (`sign` 1) or against it (-1).
    /// Returns the positions after `start`, and the reason why the curve ends. A final position on
    /// the border is included; a junction point is not. `hear` receives both ends of every step and
    /// returns whether to continue.
    pub(super) fn follow(
        &self,
        start: DVec3,
        sign: f64,
        mut hear: impl FnMut(DVec3, DVec3) -> bool,
    ) -> (Vec<DVec3>, Stop) {
        let voxel = self.indicators.voxel();
        let (mut places, mut place, mut step) = (Vec::new(), start, LONGEST_STEP * voxel);
        while places.len() < MOST_STEPS {
            let tangent = sign * self.tangent(place);
            let found = loop {
                match self.ahead(place, tangent, sign, step) {
                    Some(found) => break Some(found),
                    None if step < SHORTEST_STEP * voxel => break None,
                    None => step *= 0.5,
                }
            };
            let Some(next) = found else { return (places, self.stop_at(place)) };
            if !self.is_real(next) {
                match self.point_between(place, next, step) {
                    Some((point, stratum)) => {
                        hear(place, point);
                        return (places, Stop::Point(point, stratum));
                    }
                    None if step < SHORTEST_STEP * voxel => return (places, self.stop_at(place)),
                    None => step *= 0.25,
                }
                continue;
            }
            if !hear(place, next) {
                return (places, Stop::Told);
            }
            if !self.is_in_grid(next) {
                places.extend(self.onto(next, LONGEST_STEP * voxel));
                return (places, Stop::Border);
            }
            if places.len() > 2 && is_passed(start, place, next) {
                return (places, Stop::Start);
            }
            places.push(next);
            place = next;
            step = (2.0 * step).min(LONGEST_STEP * voxel);
        }
        (places, Stop::Lost)
    }

    /// Returns the reason why a curve ends at a position from which it cannot be followed. If a
    /// fourth material is equally near, the position is a junction point at a kink of the
    /// indicators.
    fn stop_at(&self, place: DVec3) -> Stop {
        let near = self.indicators.near(place);
        let fourth = near.entries().iter().find(|(id, _)| !self.own.contains(id));
        let [i, j, k] = self.own;
        let is_equal = self.indicators.clearance(place, &self.own) < EQUAL_CLEARANCE * self.indicators.voxel();
        let point = fourth.filter(|_| is_equal).and_then(|(fourth, _)| Stratum::new(&[i, j, k, *fourth]));
        point.map_or(Stop::Lost, |stratum| Stop::Point(place, stratum))
    }

    /// Follows a curve in both directions from `start`. Returns the positions in the order of the
    /// tangent, the index of `start` among them, and the reasons why the curve ends before the
    /// first position and after the last position. A curve that is lost in both directions at the
    /// same position has a turn too sharp to follow there; it counts as closed.
    pub(super) fn follow_both_ways(
        &self,
        start: DVec3,
        mut hear: impl FnMut(DVec3, DVec3) -> bool,
    ) -> (Vec<DVec3>, usize, [Stop; 2]) {
        let (forth, last) = self.follow(start, 1.0, &mut hear);
        let (mut places, first) = match last {
            Stop::Start => (Vec::new(), Stop::Start),
            _ => self.follow(start, -1.0, &mut hear),
        };
        let before = places.len();
        let is_lost = [first, last] == [Stop::Lost; 2] && before + forth.len() > 1;
        let ends = if is_lost && self.meet(&[start], &forth, &places) { [Stop::Start; 2] } else { [first, last] };
        places.reverse();
        places.push(start);
        places.extend(forth);
        (places, before, ends)
    }

    /// Returns the junction point between a position on a curve and a position `beyond` at which
    /// the curve is not real.
    fn point_between(&self, place: DVec3, beyond: DVec3, step: f64) -> Option<(DVec3, Stratum)> {
        let near = self.indicators.near(beyond);
        let (fourth, _) = near.entries().iter().find(|(id, _)| !self.own.contains(id))?;
        let [i, j, k] = self.own;
        let stratum = Stratum::new(&[i, j, k, *fourth])?;
        let &[a, b, c, d] = stratum.materials() else { return None };
        let voxel = self.indicators.voxel();
        let (limit, tolerance) = (2.0 * step, TOLERANCE * voxel);
        let point = self.indicators.project_onto_point([a, b, c, d], beyond, limit, tolerance)?;
        let is_between = point.distance(place) <= (1.0 + LARGEST_CORRECTION) * step && self.is_in_grid(point);
        let is_met = self.indicators.clearance(point, stratum.materials()) >= -UNDERCUT * voxel;
        (is_between && is_met).then_some((point, stratum))
    }
}

/// Returns whether the step from `a` to `b` passes a position.
pub(super) fn is_passed(place: DVec3, a: DVec3, b: DVec3) -> bool {
    distance_from_step(place, a, b) <= PASSING_DISTANCE * a.distance(b)
}

/// Returns the distance in mm from a position to the step from `a` to `b`.
pub(super) fn distance_from_step(place: DVec3, a: DVec3, b: DVec3) -> f64 {
    let (way, squared) = (b - a, a.distance_squared(b));
    let share = if squared > 0.0 { ((place - a).dot(way) / squared).clamp(0.0, 1.0) } else { 0.0 };
    place.distance(a + share * way)
}
