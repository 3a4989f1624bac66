//! The guard: whether a transaction, the edits since the last commit, is kept. It must raise the quality by the rule at hand, and must not
//! turn or fold a triangle, leave F = 0, spoil edge lengths, make triangles cross, or carry a grid node to the other side.

use super::constants::{
    AGREEMENT, AIM, AIM_ANGLES, BELOW, FARTHER, FIT, FIT_ANGLES, FOLD, FOLLOWS, LEAST_GAIN, LEAST_GAIN_OF_SWEEP,
    LOOSE_AGREEMENT, LOOSE_DEVIATION, LOOSE_FOLD, LOOSE_FOLD_OF_F, LOOSE_LENGTHS, NODE, PRICE_OF_DEVIATION,
    PROJECTION_AGREEMENT, SURELY_WIDE,
};
use super::surface::{Facts, Surface};
use glam::DVec3;
use isoparticles_mesh::intersect::corners_cross;
use isoparticles_mesh::quality::radius_ratio;
use isoparticles_mesh::spatial::{Bounds, BoxTree};

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
    /// Range of edge lengths, over h.
    pub(super) lengths: [f64; 2],
    /// Whether a larger deviation has its price ([`PRICE_OF_DEVIATION`]).
    pub(super) is_priced: bool,
}

impl Limits {
    /// For bringing a vertex onto F = 0, which comes before all else but crossing triangles.
    pub(super) const FOR_PROJECTION: Self = Self {
        agreement: PROJECTION_AGREEMENT,
        fold: LOOSE_FOLD_OF_F,
        fold_of_f: LOOSE_FOLD_OF_F,
        deviation: f64::INFINITY,
        lengths: [0.0, f64::INFINITY],
        is_priced: false,
    };

    /// The ordinary limits with a largest deviation and a range of edge lengths.
    pub(super) const fn new(deviation: f64, lengths: [f64; 2]) -> Self {
        Self { agreement: AGREEMENT, fold: FOLD, fold_of_f: FOLD, deviation, lengths, is_priced: false }
    }

    /// For sweeps, which raise the mean: rims may fold and centroids lie farther from F = 0, as they must where F bends within h, but at a price.
    pub(super) const fn of_sweeps(&self) -> Self {
        Self { fold_of_f: LOOSE_FOLD, deviation: FARTHER * self.deviation, is_priced: true, ..*self }
    }

    /// For taking vertices away, the same and folds as of the loosened ones.
    pub(super) fn of_thinning(&self) -> Self {
        Self { lengths: self.lengths, deviation: FARTHER * self.deviation, ..self.loosened() }
    }

    /// For the few triangles that are not fit for finite elements, which nothing within the limits can help.
    pub(super) fn loosened(&self) -> Self {
        Self {
            agreement: self.agreement.min(LOOSE_AGREEMENT),
            fold: self.fold.min(LOOSE_FOLD),
            fold_of_f: self.fold_of_f.min(LOOSE_FOLD_OF_F),
            deviation: (2.0 * self.deviation).max(LOOSE_DEVIATION),
            lengths: [self.lengths[0].min(LOOSE_LENGTHS[0]), self.lengths[1].max(LOOSE_LENGTHS[1])],
            is_priced: false,
        }
    }
}

/// What counts as better.
#[derive(Clone, Copy, Debug)]
pub(super) enum Rule {
    /// The smallest quality of the patch does not fall, and the shortfall of its triangles below `bar` shrinks; or fewer grid nodes are on the
    /// wrong side, and the smallest quality does not fall below [`FIT`].
    Lift {
        /// Quality below which a triangle falls short.
        bar: f64,
    },
    /// Neither the smallest nor the mean quality falls, and one of them rises.
    Even,
    /// The mean quality rises, and the smallest does not fall below `floor`, or not at all where it was lower.
    Mean {
        /// The floor.
        floor: f64,
    },
    /// The smallest quality does not fall below `floor`, or not at all where it was lower.
    Keep {
        /// The floor.
        floor: f64,
    },
    /// Nothing is asked of the quality but that no triangle loses its area.
    Any,
}

/// Quality of a triangle: its radius ratio, or less where its smallest or largest angle is worse than that: [`FIT`] and [`AIM`] at the limits of
/// each of the three, linear between and beyond, 0 without area.
pub(super) fn quality_of(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let ratio = radius_ratio(a, b, c);
    if ratio > SURELY_WIDE {
        return ratio;
    }
    // opposite the shortest and the longest side; the law of cosines loses digits only where an angle is far from any limit
    let mut squares = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    squares.sort_unstable_by(f64::total_cmp);
    let [short, middle, long] = squares;
    let angle = |opposite: f64, p: f64, q: f64| {
        ((p + q - opposite) / (2.0 * (p * q).sqrt())).clamp(-1.0, 1.0).acos().to_degrees()
    };
    let (smallest, largest) = (angle(short, middle, long), angle(long, short, middle));
    let by_angle = |angle: f64, fit: f64, aim: f64| {
        if angle < fit { FIT * angle / fit } else { FIT + (AIM - FIT) * (angle - fit) / (aim - fit) }
    };
    ratio.min(by_angle(smallest, FIT_ANGLES[0], AIM_ANGLES[0])).min(by_angle(
        180.0 - largest,
        180.0 - FIT_ANGLES[1],
        180.0 - AIM_ANGLES[1],
    ))
}

/// Quality of a triangle that is to face along a normal: less one where it is turned against it.
pub(super) fn quality_facing([p, a, b]: [DVec3; 3], normal: DVec3) -> f64 {
    let quality = quality_of(p, a, b);
    if (a - p).cross(b - p).dot(normal) > 0.0 { quality } else { quality - 1.0 }
}

/// Smallest and mean quality of some triangles, and what they lack to a bar: the sum of the squares, and [`BELOW`] for each.
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

/// Scores of the touched triangles as last committed and as they are now.
fn scores(surface: &Surface, touched: &[u32], bar: f64) -> (Score, Score) {
    let before = Score::of(touched.iter().map(|&t| surface.facts[t as usize].quality), bar);
    let now = touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| surface.quality(t));
    (before, Score::of(now, bar))
}

/// By how much the edits since the last commit bring the patch nearer to a bar and grid nodes to their right sides; negative infinity when
/// they lower the smallest quality, or for the sake of a node lower it below [`FIT`].
pub(super) fn gain(surface: &Surface, bar: f64) -> f64 {
    let touched = surface.touched();
    let mended =
        if surface.has_wrong_nodes() { changed_nodes(surface, &touched).map(|(_, mended)| mended) } else { Some(0) };
    mended.map_or(f64::NEG_INFINITY, |mended| gain_of(scores(surface, &touched, bar), mended))
}

/// By how much the shortfall below a bar shrinks, whatever becomes of the smallest quality: for the first of two moves.
pub(super) fn progress(surface: &Surface, bar: f64) -> f64 {
    let (before, after) = scores(surface, &surface.touched(), bar);
    before.shortfall - after.shortfall
}

fn gain_of((before, after): (Score, Score), mended: usize) -> f64 {
    let floor = if mended > 0 { before.smallest.min(FIT) } else { before.smallest };
    let gain = before.shortfall - after.shortfall + NODE * mended as f64;
    if after.smallest < floor { f64::NEG_INFINITY } else { gain }
}

/// By how much the edits since the last commit raise the sum of the qualities of the triangles touched, as many before as now.
pub(super) fn total_gain(surface: &Surface) -> f64 {
    let change = |t: u32| surface.quality(t) - surface.facts[t as usize].quality;
    surface.touched().into_iter().map(change).sum()
}

/// By how much the smallest quality of the triangles touched has risen since the last commit.
pub(super) fn change_of_smallest(surface: &Surface) -> f64 {
    let (before, after) = scores(surface, &surface.touched(), 0.0);
    after.smallest - before.smallest
}

/// By how much the mean quality of the triangles touched has risen since the last commit.
pub(super) fn change_of_mean(surface: &Surface) -> f64 {
    let (before, after) = scores(surface, &surface.touched(), 0.0);
    after.mean - before.mean
}

/// Whether the quality has improved by a rule.
fn is_better(surface: &Surface, touched: &[u32], rule: Rule, mended: usize) -> bool {
    let bar = if let Rule::Lift { bar } = rule { bar } else { 0.0 };
    let (before, after) = scores(surface, touched, bar);
    match rule {
        Rule::Lift { .. } => gain_of((before, after), mended) > LEAST_GAIN,
        Rule::Even => {
            let (smallest, mean) = (after.smallest - before.smallest, after.mean - before.mean);
            smallest >= 0.0 && mean >= 0.0 && smallest + mean > LEAST_GAIN_OF_SWEEP
        }
        Rule::Mean { floor } => {
            after.smallest >= before.smallest.min(floor) && after.mean - before.mean > LEAST_GAIN_OF_SWEEP
        }
        Rule::Keep { floor } => after.smallest >= before.smallest.min(floor) && after.smallest > 0.0,
        Rule::Any => after.smallest > 0.0,
    }
}

/// Commits the edits since the last commit when they pass, takes them back otherwise. The triangles touched, when they did.
pub(super) fn commit_or_rollback(surface: &mut Surface, limits: &Limits, rule: Rule) -> Option<Vec<u32>> {
    let touched = surface.touched();
    let Some((facts, changed)) = judged(surface, limits, rule, &touched) else {
        surface.rollback();
        return None;
    };
    if let Some(sides) = &mut surface.sides {
        sides.turn(&changed);
    }
    surface.commit(&touched, &facts);
    Some(touched)
}

/// Facts of the touched triangles and the grid nodes that change sides, when the edits since the last commit pass.
fn judged(surface: &Surface, limits: &Limits, rule: Rule, touched: &[u32]) -> Option<(Vec<Facts>, Vec<usize>)> {
    if touched.is_empty() || !surface.is_within_region(touched) {
        return None;
    }
    // what is quick to find comes first: where all nodes are on their right sides, none can be mended
    let mends = surface.has_wrong_nodes();
    let early = if mends { changed_nodes(surface, touched)? } else { (Vec::new(), 0) };
    if !is_better(surface, touched, rule, early.1) {
        return None;
    }
    let facts: Vec<Facts> = touched.iter().map(|&t| surface.measure(t)).collect();
    let (changed, _) = if mends { early } else { changed_nodes(surface, touched)? };
    if limits.is_priced && !is_worth_its_price(surface, touched, &facts) {
        return None;
    }
    (is_sound(surface, limits, touched, &facts) && !crosses(surface, touched)).then_some((facts, changed))
}

/// Whether the edits since the last commit keep the limits, crossing triangles and grid nodes aside.
#[cfg(test)]
pub(super) fn keeps_limits(surface: &Surface, limits: &Limits) -> bool {
    let touched = surface.touched();
    let facts: Vec<Facts> = touched.iter().map(|&t| surface.measure(t)).collect();
    is_sound(surface, limits, &touched, &facts)
}

/// Whether the mean quality of the triangles touched rises by the price of what their mean deviation rises by.
fn is_worth_its_price(surface: &Surface, touched: &[u32], facts: &[Facts]) -> bool {
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
    after.0 - before.0 > PRICE_OF_DEVIATION * (after.1 - before.1)
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

/// Whether a touched triangle crosses any other; false while that is left for the end.
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

/// Whether two triangles cross.
fn cross(surface: &Surface, first: u32, second: u32) -> bool {
    corners_cross(
        surface.triangles[first as usize],
        surface.corners(first),
        surface.triangles[second as usize],
        surface.corners(second),
    )
}

impl Surface<'_> {
    /// Whether any triangle that has changed crosses another.
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

/// Grid nodes that change sides, and by how many fewer are on the wrong one; `None` when one leaves its right side and the count does not fall.
fn changed_nodes(surface: &Surface, touched: &[u32]) -> Option<(Vec<usize>, usize)> {
    let Some(sides) = &surface.sides else { return Some((Vec::new(), 0)) };
    let sides_of = |t: u32| surface.field.sides(surface.sheet[t as usize]);
    let now = touched.iter().filter(|&&t| surface.is_alive(t)).map(|&t| (surface.corners(t), sides_of(t)));
    let former = surface.former_corners(touched).into_iter().map(|(t, corners)| (corners, sides_of(t)));
    let changed = sides.changed(former.chain(now));
    // at a curve a node may change from one wrong material to another
    if !changed.is_empty() && surface.changes_a_curve() {
        return None;
    }
    let mended = sides.mended_by(&changed)?;
    Some((changed, mended))
}
