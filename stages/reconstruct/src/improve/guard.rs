//! Says whether the edits since the last commit are welcome: they must raise the quality by the rule at hand, and must not
//! turn or fold a triangle, leave F = 0, spoil edge lengths, make triangles cross, or carry a grid node to the other side.

use super::surface::{Facts, Surface};
use glam::DVec3;
use isoparticles_mesh::intersect::corners_cross;
use isoparticles_mesh::quality::radius_ratio;
use isoparticles_mesh::spatial::Bounds;

/// What a move must respect; where the surface was worse before, it must not get any worse.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Smallest cosine between a triangle's normal and grad F at its centroid.
    pub(super) agreement: f64,
    /// Smallest cosine between the normals of neighbouring triangles.
    pub(super) fold: f64,
    /// The same where both triangles follow grad F ([`FOLLOWS`]): the fold is in F itself.
    pub(super) fold_of_f: f64,
    /// Largest distance of a centroid from F = 0, over h.
    pub(super) deviation: f64,
    /// Largest excess of an edge length over its range ([`Facts::excess`]).
    pub(super) excess: f64,
}

impl Limits {
    /// For bringing a vertex onto F = 0, which comes before all else but crossing triangles.
    pub(super) const FOR_PROJECTION: Self =
        Self { agreement: -0.2, fold: -0.8, fold_of_f: -0.8, deviation: f64::INFINITY, excess: f64::INFINITY };

    /// For the few triangles that nothing within the limits can help: a third of h off F = 0 in the middle of a triangle,
    /// where F has detail below h, does less harm than a needle.
    pub(super) fn loosened(&self) -> Self {
        Self {
            agreement: self.agreement.min(0.0),
            fold: self.fold.min(-0.3),
            fold_of_f: self.fold_of_f.min(-0.8),
            deviation: (2.0 * self.deviation).max(0.35),
            excess: self.excess + 0.35,
        }
    }
}

/// Cosine to grad F from which on a triangle follows it.
const FOLLOWS: f64 = 0.5;

/// What counts as better.
#[derive(Clone, Copy, Debug)]
pub(super) enum Rule {
    /// The smallest radius ratio of the patch does not fall, and the shortfall of its triangles below `bar` shrinks.
    Lift {
        /// Radius ratio below which a triangle falls short.
        bar: f64,
    },
    /// Neither the smallest nor the mean radius ratio falls, and one of them rises.
    Even,
    /// The smallest radius ratio does not fall below `floor`, or not at all where it was lower.
    Keep {
        /// The floor.
        floor: f64,
    },
    /// The smallest [`fitness`] of the patch does not fall, and the shortfall of its triangles below 1 shrinks.
    Fit,
    /// Nothing is asked of the quality but that no triangle loses its area.
    Any,
}

/// Gain that counts; what is smaller may be rounding, and would never end.
const LEAST_GAIN: f64 = 1e-5;

/// Smallest radius ratio, smallest and largest angle (degrees) that finite elements are asked for.
const FIT_RATIO: f64 = 0.5;
const FIT_ANGLES: [f64; 2] = [25.0, 120.0];

/// A triangle of a higher radius ratio keeps both: 8 sin(A/2) sin(B/2) sin(C/2) of one with A at either limit is at most 0.679.
const SURELY_FIT: f64 = 0.68;

/// How far a triangle is within those limits: 1 and more where it keeps them all, down to 0 where it has no area.
pub(super) fn fitness(corners: [DVec3; 3]) -> f64 {
    let [a, b, c] = corners;
    let ratio = radius_ratio(a, b, c);
    if ratio > SURELY_FIT {
        return ratio / FIT_RATIO;
    }
    let angles =
        [(b - a).angle_between(c - a), (c - b).angle_between(a - b), (a - c).angle_between(b - c)].map(f64::to_degrees);
    let smallest = angles.into_iter().fold(f64::INFINITY, f64::min);
    let largest = angles.into_iter().fold(0.0, f64::max);
    let by_angle = (smallest / FIT_ANGLES[0]).min((180.0 - largest) / (180.0 - FIT_ANGLES[1]));
    by_angle.min(ratio / FIT_RATIO)
}

/// What a triangle outside the limits counts for at least, beside how far outside it is.
const UNFIT: f64 = 0.02;

/// By how much the edits since the last commit bring the patch nearer to the limits of [`fitness`]; negative infinity when they lower the
/// smallest.
pub(super) fn gain_in_fitness(surface: &Surface) -> f64 {
    let touched = surface.touched();
    let score = |corners: &[[DVec3; 3]]| {
        let fitnesses = corners.iter().map(|&c| fitness(c)).filter(|&f| f < 1.0);
        fitnesses.fold((1.0f64, 0.0), |(smallest, shortfall), f| (smallest.min(f), shortfall + UNFIT + 1.0 - f))
    };
    let (smallest_before, before) = score(&surface.former_corners(&touched));
    let now: Vec<_> = touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| surface.corners(t)).collect();
    let (smallest, after) = score(&now);
    if smallest < smallest_before { f64::NEG_INFINITY } else { before - after }
}

/// Smallest quality, sum, count and shortfall of some triangles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Score {
    pub(super) smallest: f64,
    pub(super) mean: f64,
    pub(super) shortfall: f64,
}

impl Score {
    fn of(qualities: impl Iterator<Item = f64>, bar: f64) -> Self {
        let (mut smallest, mut sum, mut count, mut shortfall) = (f64::INFINITY, 0.0, 0usize, 0.0);
        for quality in qualities.filter(|q| q.is_finite()) {
            smallest = smallest.min(quality);
            sum += quality;
            count += 1;
            shortfall += (bar - quality).max(0.0).powi(2);
        }
        Self { smallest, mean: sum / count.max(1) as f64, shortfall }
    }
}

/// Scores of the touched triangles as last committed and as they are now.
pub(super) fn scores(surface: &Surface, touched: &[u32], bar: f64) -> (Score, Score) {
    let before = Score::of(touched.iter().map(|&t| surface.facts[t as usize].quality), bar);
    let now = touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| surface.quality(t));
    (before, Score::of(now, bar))
}

/// Whether the quality has improved by a rule.
fn is_better(surface: &Surface, touched: &[u32], rule: Rule) -> bool {
    let bar = if let Rule::Lift { bar } = rule { bar } else { 0.0 };
    let (before, after) = scores(surface, touched, bar);
    match rule {
        Rule::Lift { .. } => after.smallest >= before.smallest && after.shortfall < before.shortfall - LEAST_GAIN,
        Rule::Fit => gain_in_fitness(surface) > LEAST_GAIN,
        Rule::Even => {
            let (smallest, mean) = (after.smallest - before.smallest, after.mean - before.mean);
            smallest >= 0.0 && mean >= 0.0 && smallest + mean > 1e-4
        }
        Rule::Keep { floor } => after.smallest >= before.smallest.min(floor) && after.smallest > 0.0,
        Rule::Any => after.smallest > 0.0,
    }
}

/// Commits the edits since the last commit when they pass, takes them back otherwise. The triangles touched, when they did.
pub(super) fn commit_if_welcome(surface: &mut Surface, limits: &Limits, rule: Rule) -> Option<Vec<u32>> {
    let touched = surface.touched();
    if touched.is_empty() || !surface.is_within_region(&touched) || !is_better(surface, &touched, rule) {
        surface.undo();
        return None;
    }
    let facts: Vec<Facts> = touched.iter().map(|&t| surface.measure(t)).collect();
    let changed = match changed_nodes(surface, &touched) {
        Some(changed) if is_sound(surface, limits, &touched, &facts) && !crosses(surface, &touched) => changed,
        _ => {
            surface.undo();
            return None;
        }
    };
    if let Some(sides) = &mut surface.sides {
        sides.turn(&changed);
    }
    surface.commit(&touched, &facts);
    Some(touched)
}

/// Whether the edits since the last commit keep the limits, crossing triangles and grid nodes aside.
pub(super) fn keeps_limits(surface: &Surface, limits: &Limits) -> bool {
    let touched = surface.touched();
    let facts: Vec<Facts> = touched.iter().map(|&t| surface.measure(t)).collect();
    is_sound(surface, limits, &touched, &facts)
}

fn is_sound(surface: &Surface, limits: &Limits, touched: &[u32], facts: &[Facts]) -> bool {
    let mut worst = Facts::NONE;
    let mut before_fold: f64 = 1.0;
    for &t in touched {
        let before = &surface.facts[t as usize];
        worst.agreement = worst.agreement.min(before.agreement);
        worst.deviation = worst.deviation.max(before.deviation);
        worst.excess = worst.excess.max(before.excess);
        before_fold = before_fold.min(before.agreement);
    }
    let sound = facts.iter().all(|now| {
        now.agreement >= worst.agreement.min(limits.agreement)
            && now.deviation <= worst.deviation.max(limits.deviation)
            && now.excess <= worst.excess.max(limits.excess)
    });
    // a patch that was turned against F somewhere may have been folded there as well
    let limit = |a: &Facts, b: &Facts| {
        let is_of_f = a.agreement.min(b.agreement) >= FOLLOWS;
        if is_of_f { limits.fold_of_f } else { limits.fold }.min(before_fold)
    };
    sound
        && touched.iter().zip(facts).all(|(&t, now)| {
            let [a, b, c] = surface.triangles[t as usize];
            now.quality.is_infinite()
                || [(a, b), (b, c), (c, a)].iter().all(|&(from, to)| {
                    surface.wings(from, to).is_none_or(|[_, (neighbour, _)]| {
                        let other = match touched.binary_search(&neighbour) {
                            Ok(at) => &facts[at],
                            Err(_) => &surface.facts[neighbour as usize],
                        };
                        now.normal.dot(other.normal) >= limit(now, other)
                    })
                })
        })
}

/// Whether a touched triangle crosses any other.
fn crosses(surface: &Surface, touched: &[u32]) -> bool {
    let own: Vec<(u32, Bounds)> =
        touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| (t, surface.bounds(t))).collect();
    let whole = own.iter().fold(Bounds::EMPTY, |all, (_, bounds)| all.merged(*bounds));
    let cross = |first: u32, second: u32| {
        corners_cross(
            surface.triangles[first as usize],
            surface.corners(first),
            surface.triangles[second as usize],
            surface.corners(second),
        )
    };
    let crosses_own = |t: u32, bounds: &Bounds, own: &[(u32, Bounds)]| {
        own.iter().any(|(other, box_of_other)| box_of_other.meets(bounds) && cross(t, *other))
    };
    own.iter().enumerate().any(|(i, (t, bounds))| crosses_own(*t, bounds, &own[i + 1..]))
        || surface
            .grid
            .any(&whole, |other, bounds| touched.binary_search(&other).is_err() && crosses_own(other, bounds, &own))
}

/// Grid nodes that changed sides; `None` when one left its right side.
fn changed_nodes(surface: &Surface, touched: &[u32]) -> Option<Vec<usize>> {
    let Some(sides) = &surface.sides else { return Some(Vec::new()) };
    let now: Vec<_> = touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| surface.corners(t)).collect();
    let changed = sides.changed(&surface.former_corners(touched), &now);
    sides.are_wrong(&changed).then_some(changed)
}
