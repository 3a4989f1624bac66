//! The acceptance test: decides whether a transaction, that is, the edits since the last commit, is
//! kept.
//!
//! A transaction must reach its [`Goal`] and stay within its [`Limits`]. It must not produce
//! intersecting triangles (exact predicates). A guarded grid node may move to the wrong side only
//! if the number of nodes on the wrong side decreases.

use super::constants::{BELOW, FIT, FOLLOWS, LEAST_GAIN, LEAST_MEAN_GAIN, NODE};
use super::surface::{Facts, Surface};
use isoparticles_mesh::intersect::corners_cross;
use isoparticles_mesh::spatial::{Bounds, BoxTree};

/// Limits for the touched triangles. If some of them violated a limit before, their worst value
/// before is the limit instead.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Minimum cosine between the normal of a triangle and grad F at its centroid.
    pub(super) agreement: f64,
    /// Minimum cosine between the normals of adjacent triangles.
    pub(super) fold: f64,
    /// Minimum cosine between the normals of adjacent triangles that both follow grad F
    /// ([`FOLLOWS`]), so that F itself is folded there.
    pub(super) fold_of_f: f64,
    /// Maximum distance of a centroid from F = 0, in units of h.
    pub(super) deviation: f64,
    /// Range of edge lengths, in units of h.
    pub(super) lengths: [f64; 2],
}

impl Limits {
    /// The limits for sweeps and single moves. With deviations of 0.15, 0.25, 0.30 and 0.33,
    /// trabecular bone (1,000 vertices requested) has 1,182, 1,095, 1,075 and 1,043 vertices. With
    /// 0.15, 0.30 and 0.33, a gyroid thinner than h loses 0.8, 4.9 and 5.1 % of its volume.
    pub(super) const STRICT: Self =
        Self { agreement: 0.3, fold: 0.0, fold_of_f: -0.3, deviation: 0.3, lengths: [0.5, 1.6] };

    /// The limits for patches, and for moves on triangles that no single move within the strict
    /// limits improves. They allow a normal deviation of 90 degrees, folds of 107 degrees, and
    /// folds of F of 143 degrees. A fold of 107 degrees, also the strict limit for folds of F,
    /// leaves a dihedral angle of 73 degrees, close to the 70.5 of a regular tetrahedron. Two edges
    /// of the minimum length allow detail of 0.1 h. The maximum is about twice the strict one.
    pub(super) const LOOSE: Self =
        Self { agreement: 0.0, fold: -0.3, fold_of_f: -0.8, lengths: [0.05, 3.0], ..Self::STRICT };
}

/// What a transaction must achieve. Quality refers to the touched triangles.
#[derive(Clone, Copy, Debug)]
pub(super) enum Goal {
    /// The shortfall of triangles below `bar` decreases, and the minimum quality does not decrease.
    /// Alternatively, the number of grid nodes on the wrong side decreases. The minimum quality
    /// then does not fall below [`FIT`], or does not decrease if it was lower.
    Lift {
        /// Quality below which a triangle falls short.
        bar: f64,
    },
    /// The mean quality increases by more than [`LEAST_MEAN_GAIN`], and by more than `price` times
    /// the increase of the mean deviation. The minimum quality does not fall below `floor`, or does
    /// not decrease if it was lower.
    Mean {
        /// The minimum quality to keep.
        floor: f64,
        /// Required increase of the mean quality per increase of the mean deviation by h; 0 for
        /// none.
        price: f64,
    },
    /// The minimum quality does not fall below `floor`, or does not decrease if it was lower. No
    /// triangle has zero area.
    Keep {
        /// The minimum quality to keep.
        floor: f64,
    },
}

/// Minimum and mean quality of some triangles, and their shortfall below a bar: the sum of the
/// squared differences, plus [`BELOW`] for each triangle.
#[derive(Clone, Copy, Debug)]
struct Score {
    smallest: f64,
    mean: f64,
    shortfall: f64,
}

impl Score {
    fn of(qualities: impl Iterator<Item = f64>, bar: f64) -> Self {
        let (mut smallest, mut sum, mut count, mut shortfall) = (f64::INFINITY, 0.0, 0usize, 0.0);
        for quality in qualities.filter(|q| q.is_finite()) {
            smallest = smallest.min(quality);
            sum += quality;
            count += 1;
            if quality < bar {
                shortfall += BELOW + (bar - quality).powi(2);
            }
        }
        Self { smallest, mean: sum / count.max(1) as f64, shortfall }
    }
}

/// Returns the scores of the touched triangles at the last commit and now.
fn scores(surface: &Surface, touched: &[u32], bar: f64) -> (Score, Score) {
    let before = Score::of(touched.iter().map(|&t| surface.facts[t as usize].quality), bar);
    let now = touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| surface.quality(t));
    (before, Score::of(now, bar))
}

/// Returns the gain of the edits since the last commit, as measured by [`Goal::Lift`]. Returns
/// negative infinity if the minimum quality or the grid nodes rule the edits out.
pub(super) fn gain(surface: &Surface, bar: f64) -> f64 {
    let touched = surface.touched();
    let mended =
        if surface.has_wrong_nodes() { changed_nodes(surface, &touched).map(|(_, mended)| mended) } else { Some(0) };
    mended.map_or(f64::NEG_INFINITY, |mended| gain_of(scores(surface, &touched, bar), mended))
}

/// Returns the decrease of the shortfall below a bar, ignoring the minimum quality. It rates the
/// first of two moves.
pub(super) fn progress(surface: &Surface, bar: f64) -> f64 {
    let (before, after) = scores(surface, &surface.touched(), bar);
    before.shortfall - after.shortfall
}

fn gain_of((before, after): (Score, Score), mended: usize) -> f64 {
    let floor = if mended > 0 { before.smallest.min(FIT) } else { before.smallest };
    let gain = before.shortfall - after.shortfall + NODE * mended as f64;
    if after.smallest < floor { f64::NEG_INFINITY } else { gain }
}

/// Returns the increase of the summed quality of the touched triangles since the last commit. The
/// edits must not add or remove triangles.
pub(super) fn total_gain(surface: &Surface) -> f64 {
    let change = |t: u32| surface.quality(t) - surface.facts[t as usize].quality;
    surface.touched().into_iter().map(change).sum()
}

/// Returns the increase of the minimum quality of the touched triangles since the last commit.
pub(super) fn change_of_smallest(surface: &Surface) -> f64 {
    let (before, after) = scores(surface, &surface.touched(), 0.0);
    after.smallest - before.smallest
}

/// Returns the increase of the mean quality of the touched triangles since the last commit.
pub(super) fn change_of_mean(surface: &Surface) -> f64 {
    let (before, after) = scores(surface, &surface.touched(), 0.0);
    after.mean - before.mean
}

/// Returns whether the edits reach a goal, ignoring the price of [`Goal::Mean`]. `mended` is the
/// decrease of the number of grid nodes on the wrong side.
fn is_reached(surface: &Surface, touched: &[u32], goal: Goal, mended: usize) -> bool {
    let bar = if let Goal::Lift { bar } = goal { bar } else { 0.0 };
    let (before, after) = scores(surface, touched, bar);
    match goal {
        Goal::Lift { .. } => gain_of((before, after), mended) > LEAST_GAIN,
        Goal::Mean { floor, .. } => {
            after.smallest >= before.smallest.min(floor) && after.mean - before.mean > LEAST_MEAN_GAIN
        }
        Goal::Keep { floor } => after.smallest >= before.smallest.min(floor) && after.smallest > 0.0,
    }
}

/// Commits the edits since the last commit if they pass the acceptance test, and rolls them back
/// otherwise. Returns the touched triangles, or `None` if the edits fail.
pub(super) fn commit_or_rollback(surface: &mut Surface, limits: &Limits, goal: Goal) -> Option<Vec<u32>> {
    let touched = surface.touched();
    let Some((facts, changed)) = judged(surface, limits, goal, &touched) else {
        surface.rollback();
        return None;
    };
    if let Some(sides) = &mut surface.sides {
        sides.turn(&changed);
    }
    surface.commit(&touched, &facts);
    Some(touched)
}

/// Returns the facts of the touched triangles and the grid nodes that change sides, or `None` if
/// the edits since the last commit fail the acceptance test.
fn judged(surface: &Surface, limits: &Limits, goal: Goal, touched: &[u32]) -> Option<(Vec<Facts>, Vec<usize>)> {
    if touched.is_empty() || !surface.is_within_region(touched) {
        return None;
    }
    // cheap tests come first; while nodes are on the wrong side, the goal depends on the nodes, so
    // these are tested before it
    let mends = surface.has_wrong_nodes();
    let early = if mends { changed_nodes(surface, touched)? } else { (Vec::new(), 0) };
    if !is_reached(surface, touched, goal, early.1) {
        return None;
    }
    let facts: Vec<Facts> = touched.iter().map(|&t| surface.measure(t)).collect();
    let (changed, _) = if mends { early } else { changed_nodes(surface, touched)? };
    if let Goal::Mean { price, .. } = goal
        && price > 0.0
        && !is_worth_its_price(surface, touched, &facts, price)
    {
        return None;
    }
    (is_sound(surface, limits, touched, &facts) && !crosses(surface, touched)).then_some((facts, changed))
}

/// Returns whether the edits since the last commit keep the limits, ignoring intersections and grid
/// nodes.
#[cfg(test)]
pub(super) fn keeps_limits(surface: &Surface, limits: &Limits) -> bool {
    let touched = surface.touched();
    let facts: Vec<Facts> = touched.iter().map(|&t| surface.measure(t)).collect();
    is_sound(surface, limits, &touched, &facts)
}

/// Returns whether the mean quality of the touched triangles increases by more than `price` times
/// the increase of their mean deviation.
fn is_worth_its_price(surface: &Surface, touched: &[u32], facts: &[Facts], price: f64) -> bool {
    let mean = |facts: &mut dyn Iterator<Item = &Facts>| {
        let (mut quality, mut deviation, mut count) = (0.0, 0.0, 0usize);
        for facts in facts.filter(|facts| facts.quality.is_finite()) {
            quality += facts.quality;
            deviation += facts.deviation;
            count += 1;
        }
        (quality / count.max(1) as f64, deviation / count.max(1) as f64)
    };
    let before = mean(&mut touched.iter().map(|&t| &surface.facts[t as usize]));
    let after = mean(&mut facts.iter());
    after.0 - before.0 > price * (after.1 - before.1)
}

fn is_sound(surface: &Surface, limits: &Limits, touched: &[u32], facts: &[Facts]) -> bool {
    let mut worst = Facts::NONE;
    let mut before_fold: f64 = 1.0;
    for &t in touched {
        let before = &surface.facts[t as usize];
        worst.agreement = worst.agreement.min(before.agreement);
        worst.deviation = worst.deviation.max(before.deviation);
        worst.lengths = [worst.lengths[0].min(before.lengths[0]), worst.lengths[1].max(before.lengths[1])];
        before_fold = before_fold.min(before.agreement);
    }
    let sound = facts.iter().all(|now| {
        now.agreement >= worst.agreement.min(limits.agreement)
            && now.deviation <= worst.deviation.max(limits.deviation)
            && now.lengths[0] >= worst.lengths[0].min(limits.lengths[0])
            && now.lengths[1] <= worst.lengths[1].max(limits.lengths[1])
    });
    // where triangles were turned against grad F before, the surface may have been folded as well
    let limit = |a: &Facts, b: &Facts| {
        let is_of_f = a.agreement.min(b.agreement) >= FOLLOWS;
        if is_of_f { limits.fold_of_f } else { limits.fold }.min(before_fold)
    };
    sound
        && touched.iter().zip(facts).all(|(&t, now)| {
            let [a, b, c] = surface.triangles[t as usize];
            now.quality.is_infinite()
                || [(a, b), (b, c), (c, a)].iter().all(|&(from, to)| {
                    surface.edge_triangles(from, to).is_none_or(|[_, (neighbour, _)]| {
                        let other = match touched.binary_search(&neighbour) {
                            Ok(at) => &facts[at],
                            Err(_) => &surface.facts[neighbour as usize],
                        };
                        now.normal.dot(other.normal) >= limit(now, other)
                    })
                })
        })
}

/// Returns whether a touched triangle intersects any other triangle. Returns `false` while the
/// surface has no grid; intersections are then tested at the end ([`Surface::crosses_in_all`]).
fn crosses(surface: &Surface, touched: &[u32]) -> bool {
    let Some(grid) = &surface.grid else { return false };
    let own: Vec<(u32, Bounds)> =
        touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| (t, surface.bounds(t))).collect();
    let whole = own.iter().fold(Bounds::EMPTY, |all, (_, bounds)| all.merged(*bounds));
    let crosses_own = |t: u32, bounds: &Bounds, own: &[(u32, Bounds)]| {
        own.iter().any(|(other, box_of_other)| box_of_other.meets(bounds) && cross(surface, t, *other))
    };
    own.iter().enumerate().any(|(i, (t, bounds))| crosses_own(*t, bounds, &own[i + 1..]))
        || grid.any(&whole, |other, bounds| touched.binary_search(&other).is_err() && crosses_own(other, bounds, &own))
}

/// Returns whether two triangles intersect.
fn cross(surface: &Surface, first: u32, second: u32) -> bool {
    corners_cross(
        surface.triangles[first as usize],
        surface.corners(first),
        surface.triangles[second as usize],
        surface.corners(second),
    )
}

impl Surface<'_> {
    /// Returns whether any triangle that has changed since the surface was created intersects
    /// another triangle.
    pub(super) fn crosses_in_all(&self) -> bool {
        let alive: Vec<u32> = (0..self.triangles.len() as u32).filter(|&t| self.is_alive(t)).collect();
        if !alive.iter().any(|&t| self.has_changed(t)) {
            return false;
        }
        let boxes: Vec<Bounds> = alive.iter().map(|&t| self.bounds(t)).collect();
        BoxTree::new(&boxes).any_pair(|a, b| {
            let (a, b) = (alive[a as usize], alive[b as usize]);
            (self.has_changed(a) || self.has_changed(b)) && cross(self, a, b)
        })
    }
}

/// Returns the grid nodes that change sides, and the decrease of the number of nodes on the wrong
/// side. Returns `None` if a node leaves its correct side and this number does not decrease, or if
/// a node changes sides while a junction curve changes.
fn changed_nodes(surface: &Surface, touched: &[u32]) -> Option<(Vec<usize>, usize)> {
    let Some(sides) = &surface.sides else { return Some((Vec::new(), 0)) };
    let sides_of = |t: u32| surface.pair[t as usize].map(|id| surface.field.region(id));
    let now = touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| (surface.corners(t), sides_of(t)));
    let former = surface.former_corners(touched).into_iter().map(|(t, corners)| (corners, sides_of(t)));
    let changed = sides.changed(former.chain(now));
    // near a curve, a node may change from one wrong material to another, which is not a change of
    // sides
    if !changed.is_empty() && surface.changes_a_curve() {
        return None;
    }
    let mended = sides.mended_by(&changed)?;
    Some((changed, mended))
}
