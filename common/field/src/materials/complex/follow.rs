//! Follows junction curves step by step from a position on them to their ends: a predictor step
//! along the tangent, then Newton's method back onto the curve. Positions are in the grid frame,
//! mm.

use super::chains::COINCIDENT;
use crate::materials::{Indicators, MaterialId, Stratum};
use glam::DVec3;

/// Longest step along a curve, in voxels. A step is halved until the curve turns by no more than
/// [`LEAST_COSINE`] over it.
pub(super) const LONGEST: f64 = 0.2;
/// Shortest step along a curve, in voxels.
const SHORTEST: f64 = 1e-3;

/// Minimum cosine between the tangents at both ends of a step. At this angle, 37 degrees, a chord
/// lies a twelfth of its length off the arc.
const LEAST_COSINE: f64 = 0.8;

/// Longest Newton correction after a step, as a fraction of the step's length. The step must also
/// advance by more than this fraction.
const ASIDE: f64 = 0.5;

/// A position is passed by a step if its distance from the step is at most this fraction of the
/// step's length.
pub(super) const PASSED: f64 = 0.25;

/// Maximum clearance (voxels) of a fourth material that counts as equally near where a curve cannot
/// be followed further.
const EQUAL: f64 = 2.0 * SHORTEST;

/// A path has reached its target position if a step ends within this distance of it, in voxels. A
/// curve that ends at a junction point does so.
const AT_AN_END: f64 = 0.01;

/// Maximum number of steps: 100,000 voxels at the longest step, more than any curve has.
const MOST_STEPS: usize = 1 << 19;

/// Tolerance of projections onto points and curves, in voxels.
pub(super) const TOLERANCE: f64 = 1e-7;

/// A stratum is real at a position unless another material undercuts its own by more than this
/// (voxels). It covers rounding and the residual of Newton's method.
pub(super) const UNDERCUT: f64 = 1e-6;

/// Alternating projections between the border of the grid and the curve, for a position beyond the
/// border. Each multiplies the error by the squared cosine of the angle between the two.
const TURNS_AT_BORDER: usize = 12;

/// How a curve ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Stop {
    /// At a junction point, where a fourth material is equally near: its position and the four
    /// materials.
    Point(DVec3, Stratum),
    /// At the border of the grid.
    Border,
    /// Where it began.
    Start,
    /// Where it cannot be followed further, because two of its interfaces become tangent.
    Lost,
    /// Where the callback stopped it.
    Told,
}

/// Positions along a closed junction curve, starting with `from`; at least three. `None` if the
/// curve does not return there.
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

/// Paths along a junction curve from one of its positions to another, both included, in the grid
/// that ends at `corner`. There is at most one for each direction, shorter than `longest` (mm) and
/// sorted by length. Parts that another material undercuts by less than [`COINCIDENT`] are passed,
/// since positions a step apart do not resolve them.
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

/// The shortest path of [`ways_along`].
pub fn way_along<I: Indicators + ?Sized>(
    indicators: &I,
    curve: Stratum,
    corner: DVec3,
    ends: [DVec3; 2],
    longest: f64,
) -> Option<Vec<DVec3>> {
    ways_along(indicators, curve, corner, ends, longest).into_iter().next()
}

/// Path along a junction curve from one of its positions, which is included, in the direction
/// closer to `heading`. It ends after `longest` (mm), or where the curve ends or cannot be
/// followed.
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

/// Follows the curves of three materials.
pub(super) struct Follower<'a, I: ?Sized> {
    pub(super) indicators: &'a I,
    /// The last corner of the grid, mm.
    pub(super) corner: DVec3,
    pub(super) own: [MaterialId; 3],
    /// How far another material may undercut the three on the way, in voxels.
    pub(super) undercut: f64,
}

impl<I: Indicators + ?Sized> Follower<'_, I> {
    /// The unit tangent at a position on a curve. The order of the materials fixes its direction
    /// along the whole curve.
    pub(super) fn tangent(&self, place: DVec3) -> DVec3 {
        let gradient = |other: MaterialId| self.indicators.difference_gradient(self.own[0], other, place).1;
        gradient(self.own[1]).cross(gradient(self.own[2])).normalize_or_zero()
    }

    /// Projects a position onto the curve, within the grid. `limit` (mm) is the longest total move.
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

    /// Whether two paths that were both lost end at the same spot, at a turn too sharp to be
    /// followed. `starts` are their starting positions, or one that both share.
    fn meet(&self, starts: &[DVec3], forth: &[DVec3], back: &[DVec3]) -> bool {
        let last = |way: &[DVec3], start: usize| *way.last().unwrap_or(&starts[start]);
        last(forth, 0).distance(last(back, starts.len() - 1)) < AT_AN_END * self.indicators.voxel()
    }

    /// Whether no other material is nearer at a position on a curve.
    pub(super) fn is_real(&self, place: DVec3) -> bool {
        self.indicators.clearance(place, &self.own) >= -self.undercut * self.indicators.voxel()
    }

    /// The position one step further; `None` if the curve turns too much on the way.
    fn ahead(&self, place: DVec3, tangent: DVec3, sign: f64, step: f64) -> Option<DVec3> {
        let limit = ASIDE * step;
        let tolerance = TOLERANCE * self.indicators.voxel();
        let found = self.indicators.project_onto_curve(self.own, place + step * tangent, limit, tolerance)?;
        let is_smooth = sign * self.tangent(found).dot(tangent) >= LEAST_COSINE;
        (is_smooth && (found - place).dot(tangent) > ASIDE * step).then_some(found)
    }

    /// Whether the curve is real at a small distance from a junction point, along its tangent or
    /// against it.
    pub(super) fn leaves(&self, point: DVec3, is_along: bool) -> bool {
        let (step, sign) = (COINCIDENT * self.indicators.voxel(), if is_along { 1.0 } else { -1.0 });
        let next = self.ahead(point, sign * self.tangent(point), sign, step);
        next.is_some_and(|p| self.indicators.clearance(p, &self.own) > 0.0)
    }

    /// Follows a curve from a position on it, along its tangent (`sign` 1) or against it (-1).
    /// Returns the positions after `start`, and how the curve ends; a final position on the border
    /// is included, a junction point is not. `hear` receives both ends of every step and returns
    /// whether to go on.
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

    /// How a curve ends at a position from which it cannot be followed. If a fourth material is
    /// equally near, the indicators have a kink there, and the position is the junction point.
    fn stop_at(&self, place: DVec3) -> Stop {
        let near = self.indicators.near(place);
        let fourth = near.entries().iter().find(|(id, _)| !self.own.contains(id));
        let [i, j, k] = self.own;
        let is_equal = self.indicators.clearance(place, &self.own) < EQUAL * self.indicators.voxel();
        let point = fourth.filter(|_| is_equal).and_then(|(fourth, _)| Stratum::new(&[i, j, k, *fourth]));
        point.map_or(Stop::Lost, |stratum| Stop::Point(place, stratum))
    }

    /// Follows a curve both ways from `start`. Returns the positions in the order of the tangent,
    /// the index of `start` among them, and how the curve ends before the first and after the last.
    /// A curve that is lost both ways at the same spot counts as closed, with a turn too sharp to
    /// be followed.
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

    /// The junction point between two positions of a curve, the second of which is no longer real.
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

/// Whether a position lies beside a step.
pub(super) fn is_passed(place: DVec3, a: DVec3, b: DVec3) -> bool {
    distance_from_step(place, a, b) <= PASSED * a.distance(b)
}

/// Distance of a position from a step, mm.
pub(super) fn distance_from_step(place: DVec3, a: DVec3, b: DVec3) -> f64 {
    let (way, squared) = (b - a, a.distance_squared(b));
    let share = if squared > 0.0 { ((place - a).dot(way) / squared).clamp(0.0, 1.0) } else { 0.0 };
    place.distance(a + share * way)
}
