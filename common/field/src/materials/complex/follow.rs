//! Junction curves followed step by step, from a place on one to where it ends.

use super::chains::COINCIDENT;
use crate::materials::{Indicators, MaterialId, Stratum};
use glam::DVec3;

/// Longest and shortest step along a curve, in voxels. A step is halved until the curve turns by no more than [`LEAST_COSINE`] on it.
pub(super) const LONGEST: f64 = 0.2;
const SHORTEST: f64 = 1e-3;

/// Cosine between the tangents at both ends of a step: with 37 degrees a chord lies a twelfth of a step off its arc.
const LEAST_COSINE: f64 = 0.8;

/// Farthest that Newton's method may go from where the tangent leads, over the length of the step.
const ASIDE: f64 = 0.5;

/// A place is passed where it lies nearer to a step than this share of its length.
pub(super) const PASSED: f64 = 0.25;

/// A fourth material that is so little farther (voxels) is as near.
const EQUAL: f64 = 2.0 * SHORTEST;

/// The end of a way is reached where the curve ends so near to it, in voxels: at a junction point.
const AT_AN_END: f64 = 0.01;

/// More steps than any curve has: 100,000 voxels.
const MOST_STEPS: usize = 1 << 19;

/// How closely points and curves are met, in voxels.
pub(super) const TOLERANCE: f64 = 1e-7;

/// How far another material may undercut those of a place for it to count as real, in voxels: rounding, and what Newton's method leaves.
pub(super) const UNDERCUT: f64 = 1e-6;

/// A place beyond the border of the grid goes back and forth between border and curve so often: each turn leaves the share that the cosine squared of the angle between
/// the two says.
const TURNS_AT_BORDER: usize = 12;

/// How a curve ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Stop {
    /// A fourth material gets as near: the place, and the four.
    Point(DVec3, Stratum),
    /// The grid ends.
    Border,
    /// Where it began.
    Start,
    /// Two of its sheets become tangent, so that it cannot be told where it goes on.
    Lost,
    /// It was not to be followed any farther.
    Told,
}

/// The places along a closed junction curve from one of them on, three at least; `None` where it does not return there.
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

/// The ways along a junction curve from one of its places to another, both included, in the grid that ends at `corner`: of the two directions those that lead
/// there within `longest` (mm), the shorter one first. What another material undercuts by less than [`COINCIDENT`] is passed: places a step apart do not show it.
pub fn ways_along<I: Indicators + ?Sized>(
    indicators: &I,
    curve: Stratum,
    corner: DVec3,
    [from, to]: [DVec3; 2],
    longest: f64,
) -> Vec<Vec<DVec3>> {
    let &[i, j, k] = curve.materials() else { return Vec::new() };
    let follower = Follower { indicators, corner, own: [i, j, k], undercut: COINCIDENT };
    let there = AT_AN_END * indicators.voxel();
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
    let mut ways: Vec<(f64, Vec<DVec3>)> = [way(1.0), way(-1.0)].into_iter().flatten().collect();
    ways.sort_by(|a, b| a.0.total_cmp(&b.0));
    ways.into_iter().map(|(_, places)| places).collect()
}

/// The first of [`ways_along`].
pub fn way_along<I: Indicators + ?Sized>(
    indicators: &I,
    curve: Stratum,
    corner: DVec3,
    ends: [DVec3; 2],
    longest: f64,
) -> Option<Vec<DVec3>> {
    ways_along(indicators, curve, corner, ends, longest).into_iter().next()
}

/// The way along a junction curve from one of its places, which is included, in that of its two directions that is nearer to `heading`: for `longest` (mm), or to where the curve ends or
/// cannot be followed.
pub fn way_from<I: Indicators + ?Sized>(
    indicators: &I,
    curve: Stratum,
    corner: DVec3,
    (from, heading): (DVec3, DVec3),
    longest: f64,
) -> Vec<DVec3> {
    let &[i, j, k] = curve.materials() else { return Vec::new() };
    let follower = Follower { indicators, corner, own: [i, j, k], undercut: COINCIDENT };
    let sign = if follower.tangent(from).dot(heading) < 0.0 { -1.0 } else { 1.0 };
    let mut length = 0.0;
    let (places, _) = follower.follow(from, sign, |a, b| {
        length += a.distance(b);
        length < longest
    });
    std::iter::once(from).chain(places).collect()
}

/// The curves of three materials.
pub(super) struct Follower<'a, I: ?Sized> {
    pub(super) indicators: &'a I,
    /// The last corner of the grid, mm.
    pub(super) corner: DVec3,
    pub(super) own: [MaterialId; 3],
    /// How far another material may undercut them on the way, in voxels.
    pub(super) undercut: f64,
}

impl<I: Indicators + ?Sized> Follower<'_, I> {
    /// The unit tangent at a place on a curve: of one direction all along it, by the order of the materials.
    pub(super) fn tangent(&self, place: DVec3) -> DVec3 {
        let gradient = |other: MaterialId| self.indicators.difference_gradient(self.own[0], other, place).1;
        gradient(self.own[1]).cross(gradient(self.own[2])).normalize_or_zero()
    }

    /// The place of a curve near another, in the grid.
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

    /// Whether two ways from `starts`, both lost, are so on the same spot: at a turn too sharp to be followed.
    fn meet(&self, starts: &[DVec3], forth: &[DVec3], back: &[DVec3]) -> bool {
        let last = |way: &[DVec3], start: usize| *way.last().unwrap_or(&starts[start]);
        last(forth, 0).distance(last(back, starts.len() - 1)) < AT_AN_END * self.indicators.voxel()
    }

    /// Whether no other material is nearer at a place on a curve.
    pub(super) fn is_real(&self, place: DVec3) -> bool {
        self.indicators.clearance(place, &self.own) >= -self.undercut * self.indicators.voxel()
    }

    /// The place a step further, if the curve turns little on the way.
    fn ahead(&self, place: DVec3, tangent: DVec3, sign: f64, step: f64) -> Option<DVec3> {
        let limit = ASIDE * step;
        let tolerance = TOLERANCE * self.indicators.voxel();
        let found = self.indicators.project_onto_curve(self.own, place + step * tangent, limit, tolerance)?;
        let is_smooth = sign * self.tangent(found).dot(tangent) >= LEAST_COSINE;
        (is_smooth && (found - place).dot(tangent) > ASIDE * step).then_some(found)
    }

    /// Whether the curve is real a little from a junction point, along its tangent or against it.
    pub(super) fn leaves(&self, point: DVec3, is_along: bool) -> bool {
        let (step, sign) = (COINCIDENT * self.indicators.voxel(), if is_along { 1.0 } else { -1.0 });
        let next = self.ahead(point, sign * self.tangent(point), sign, step);
        next.is_some_and(|p| self.indicators.clearance(p, &self.own) > 0.0)
    }

    /// Follows a curve from a place on it, along its tangent (`sign` 1) or against it (-1): the places behind the first, and how it ends; a junction point and the border are
    /// no such places, and the first is none. `hear` is told both ends of every step, and whether to go on is what it answers.
    pub(super) fn follow(
        &self,
        start: DVec3,
        sign: f64,
        mut hear: impl FnMut(DVec3, DVec3) -> bool,
    ) -> (Vec<DVec3>, Stop) {
        let voxel = self.indicators.voxel();
        let (mut places, mut place, mut step) = (Vec::new(), start, LONGEST * voxel);
        while places.len() < MOST_STEPS {
            let tangent = sign * self.tangent(place);
            let found = loop {
                match self.ahead(place, tangent, sign, step) {
                    Some(found) => break Some(found),
                    None if step < SHORTEST * voxel => break None,
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
                    None if step < SHORTEST * voxel => return (places, self.stop_at(place)),
                    None => step *= 0.25,
                }
                continue;
            }
            if !hear(place, next) {
                return (places, Stop::Told);
            }
            if !self.is_in_grid(next) {
                places.extend(self.onto(next, LONGEST * voxel));
                return (places, Stop::Border);
            }
            if places.len() > 2 && is_passed(start, place, next) {
                return (places, Stop::Start);
            }
            places.push(next);
            place = next;
            step = (2.0 * step).min(LONGEST * voxel);
        }
        (places, Stop::Lost)
    }

    /// How a curve ends at a place from which it cannot be followed: where a fourth material is as near, indicators have kinks, and this is the junction point.
    fn stop_at(&self, place: DVec3) -> Stop {
        let near = self.indicators.near(place);
        let fourth = near.entries().iter().find(|(id, _)| !self.own.contains(id));
        let [i, j, k] = self.own;
        let is_equal = self.indicators.clearance(place, &self.own) < EQUAL * self.indicators.voxel();
        let point = fourth.filter(|_| is_equal).and_then(|(fourth, _)| Stratum::new(&[i, j, k, *fourth]));
        point.map_or(Stop::Lost, |stratum| Stop::Point(place, stratum))
    }

    /// Follows a curve from a place on it both ways: the places along its tangent, which of them the first one is, and how it ends before the first and behind the last. A curve
    /// that is lost both ways on the same spot is closed, with a turn too sharp to be followed.
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

    /// The junction point between two places of a curve, of which the second is no longer real.
    fn point_between(&self, place: DVec3, beyond: DVec3, step: f64) -> Option<(DVec3, Stratum)> {
        let near = self.indicators.near(beyond);
        let (fourth, _) = near.entries().iter().find(|(id, _)| !self.own.contains(id))?;
        let [i, j, k] = self.own;
        let stratum = Stratum::new(&[i, j, k, *fourth])?;
        let &[a, b, c, d] = stratum.materials() else { return None };
        let voxel = self.indicators.voxel();
        let (limit, tolerance) = (2.0 * step, TOLERANCE * voxel);
        let point = self.indicators.project_onto_point([a, b, c, d], beyond, limit, tolerance)?;
        let is_between = point.distance(place) <= (1.0 + ASIDE) * step && self.is_in_grid(point);
        let is_met = self.indicators.clearance(point, stratum.materials()) >= -UNDERCUT * voxel;
        (is_between && is_met).then_some((point, stratum))
    }
}

/// Whether a place lies beside a step.
pub(super) fn is_passed(place: DVec3, a: DVec3, b: DVec3) -> bool {
    distance_from_step(place, a, b) <= PASSED * a.distance(b)
}

/// Distance of a place from a step, mm.
pub(super) fn distance_from_step(place: DVec3, a: DVec3, b: DVec3) -> f64 {
    let (way, squared) = (b - a, a.distance_squared(b));
    let share = if squared > 0.0 { ((place - a).dot(way) / squared).clamp(0.0, 1.0) } else { 0.0 };
    place.distance(a + share * way)
}
