//! One queue of bad triangles, worst first; a triangle nearest to a grid node on the wrong side comes before all. For each, a transaction on a
//! patch round it: a single move with relocations, two moves in a row, or the patch remeshed at a smaller target length. Patches that do not
//! meet are worked on side by side; what a patch commits is one commit of the whole.

use super::constants::{AIM, ATTEMPTS, BATCH, EASY, FIT, POOR, REACHES, RINGS, WASTED_WORK_LIMIT};
use super::guard::Limits;
use super::lift::{lift, lift_by_two};
use super::patch::Patch;
use super::surface::Surface;
use super::target_length::{How, remesh};
use super::{Step, Tally};
use isoparticles_mesh::spatial::Bounds;
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

/// What is tried on bad triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Means {
    /// A flip, collapse, split or relocation.
    Move,
    /// Two of them in a row.
    TwoMoves,
    /// Remeshing of a patch of so many lengths' radius with a smaller target length.
    Remesh { reach: f64 },
}

impl Means {
    /// Whether little is touched: at a junction curve, whose vertices stay, more is seldom worth its time. With all means on all triangles the four tissues of
    /// the torso phantom at h = 4 mm take 38 s in place of 15, and reach a smallest radius ratio of 0.493 in place of 0.475 (`make CASE=torso-tissues surface`).
    fn is_local(self) -> bool {
        match self {
            Self::Move => true,
            Self::TwoMoves => false,
            Self::Remesh { reach } => reach <= REACHES[1],
        }
    }
}

/// One way through the queue.
struct Pass {
    means: Means,
    limits: Limits,
    /// Quality below which a triangle is in the queue.
    bar: f64,
}

impl Pass {
    /// Whether it is worth trying on a triangle of some quality (0 at a grid node on the wrong side): where all corners lie on junction curves single moves are all that may help.
    fn may_help(&self, surface: &Surface, triangle: u32, quality: f64) -> bool {
        match self.means {
            Means::Move => true,
            _ if quality > 0.0 && surface.is_between_curves(triangle) => false,
            means => means.is_local() || quality < POOR || !surface.is_held(triangle),
        }
    }
}

/// The work of a pass in all rounds, in transactions, and what it gains. A pass ends when its
/// wasted work exceeds its useful work by [`WASTED_WORK_LIMIT`]. Useful work raises the number of
/// lifted triangles to a new maximum, so the number of bad triangles bounds the sum of both.
#[derive(Default)]
struct Ledger {
    useful: usize,
    wasted: usize,
    /// Triangles worked on.
    triangles: usize,
    /// Triangles brought above the bar and grid nodes brought to their right side, less triangles
    /// that fell below it.
    lifted: isize,
    most_lifted: isize,
    /// The number of commits at each failure, by triangle. It is tried again only after a change
    /// next to it.
    failures: HashMap<u32, u32>,
}

impl Ledger {
    /// The number of triangles to work on at once: as many as the budget allows at the mean cost so
    /// far, and at least one while any budget is left.
    fn batch_size(&self) -> usize {
        let left = (WASTED_WORK_LIMIT + self.useful).saturating_sub(self.wasted);
        let mean_cost = (self.useful + self.wasted).div_ceil(self.triangles.max(1));
        match (left, mean_cost) {
            (0, _) => 0,
            (_, 0) => 1,
            _ => (left / mean_cost).clamp(1, BATCH),
        }
    }

    /// Enters the work on one triangle.
    fn enter(&mut self, work: usize, lifted: isize) {
        self.triangles += 1;
        self.lifted += lifted;
        if self.lifted > self.most_lifted {
            self.most_lifted = self.lifted;
            self.useful += work;
        } else {
            self.wasted += work;
        }
    }
}

/// Lifts the triangles below a quality, `rounds` times at most: by moves within the limits; those not fit for finite elements by moves within the
/// loosened limits, by remeshing and by two moves in a row; then those below [`AIM`] by two moves, and all of them by one, by two and by
/// remeshing; and what is still below [`AIM`] by remeshing farther round. Each pass has a budget of
/// work ([`Ledger`]).
/// `step` is called before each batch and may stop it.
///
/// # Errors
/// Those of `step`.
pub(super) fn optimise(
    surface: &mut Surface,
    limits: &Limits,
    target: f64,
    rounds: usize,
    step: Step,
    tally: &mut Tally,
) -> Result<()> {
    let (loosened, unfit) = (limits.loosened(), target.min(FIT));
    let pass = |means, limits, bar| Pass { means, limits, bar };
    let remesh = |reach| pass(Means::Remesh { reach }, *limits, unfit);
    let [smallest, small, large, largest] = REACHES;
    let two_moves = |limits, bar: f64| pass(Means::TwoMoves, limits, target.min(bar));
    // as loose as that, but no farther from F = 0
    let within = Limits { deviation: limits.deviation, ..loosened };
    // few are left so far below the rest, and the smallest ratio is one of theirs: `thorax_labels` 1 at h = 1 mm comes to 0.74 by it in place of 0.62. Of several sheets there
    // are hundreds at their junctions: on all of `thorax_labels` at 3 mm it lifts 13, none of the worst, and the improvement takes 13.8 s in place of 8.9
    let is_one_sheet = surface.sheet.windows(2).all(|pair| pair[0] == pair[1]);
    let farther_below = if is_one_sheet { AIM } else { 0.0 };
    let passes = [
        pass(Means::Move, *limits, target.min(EASY)),
        pass(Means::Move, loosened, unfit),
        remesh(smallest),
        remesh(small),
        pass(Means::TwoMoves, loosened, unfit),
        remesh(large),
        remesh(largest),
        two_moves(within, AIM),
        two_moves(loosened, AIM),
        pass(Means::Move, *limits, target),
        two_moves(within, target),
        two_moves(loosened, EASY),
        pass(Means::Remesh { reach: smallest }, *limits, target),
        pass(Means::Remesh { reach: small }, *limits, target.min(farther_below)),
    ];
    let mut ledgers: Vec<Ledger> = passes.iter().map(|_| Ledger::default()).collect();
    for _ in 0..rounds {
        let commits = surface.commits();
        for (pass, ledger) in passes.iter().zip(&mut ledgers) {
            drain(surface, pass, ledger, step, tally)?;
        }
        if surface.commits() == commits {
            break;
        }
    }
    tally.tried += ledgers.iter().map(|ledger| ledger.useful + ledger.wasted).sum::<usize>();
    Ok(())
}

/// Tries every triangle below the bar, worst first, and again whatever falls short next to a
/// success, within the budget.
fn drain(surface: &mut Surface, pass: &Pass, ledger: &mut Ledger, step: Step, tally: &mut Tally) -> Result<()> {
    let mut at_nodes = if pass.bar > 0.0 { surface.triangles_at_wrong_nodes() } else { Vec::new() };
    // no triangle has less than 0
    let rank = |surface: &Surface, at_nodes: &[u32], t: u32| {
        let is_at_node = surface.is_alive(t) && at_nodes.binary_search(&t).is_ok();
        if is_at_node { 0 } else { surface.facts[t as usize].quality.to_bits() }
    };
    let entry = |surface: &Surface, at_nodes: &[u32], t: u32| {
        let rank = rank(surface, at_nodes, t);
        let is_tried = rank < pass.bar.to_bits() && pass.may_help(surface, t, f64::from_bits(rank));
        is_tried.then_some(Reverse((rank, t)))
    };
    let all = (0..surface.triangles.len() as u32).into_par_iter();
    let mut queue = BinaryHeap::from(all.filter_map(|t| entry(surface, &at_nodes, t)).collect::<Vec<_>>());
    loop {
        let (mut batch, most) = (Vec::new(), ledger.batch_size());
        while batch.len() < most
            && let Some(Reverse((bits, t))) = queue.pop()
        {
            let is_current = surface.is_alive(t) && rank(surface, &at_nodes, t) == bits;
            let is_as_it_was = |&commits: &u32| surface.is_unchanged_since(t, commits);
            let is_hopeless = || ledger.failures.get(&t).is_some_and(is_as_it_was);
            if is_current && !batch.contains(&t) && !is_hopeless() {
                batch.push(t);
            }
        }
        if batch.is_empty() {
            break;
        }
        step()?;
        let (chosen, others) = apart(surface, &batch, pass.means);
        let try_on = |&(t, region): &(u32, Bounds)| {
            let mut patch = Patch::within(surface, &region);
            let local = patch.local(t);
            let is_better = match pass.means {
                Means::Move => lift(&mut patch.surface, local, &pass.limits, pass.bar),
                Means::TwoMoves => lift_by_two(&mut patch.surface, local, &pass.limits, pass.bar),
                Means::Remesh { reach } => {
                    let side_by_side = chosen.len() == 1 && rayon::current_num_threads() > 1;
                    let how = How { reach, attempts: ATTEMPTS, side_by_side };
                    remesh(&mut patch.surface, local, how, &pass.limits, pass.bar)
                }
            };
            (patch.surface.tried, is_better.then(|| (patch.turned_nodes(surface), patch.edits(surface))))
        };
        let done: Vec<_> = chosen.par_iter().map(try_on).collect();
        queue.extend(others.into_iter().filter_map(|t| entry(surface, &at_nodes, t)));
        for ((t, _), (work, outcome)) in chosen.into_iter().zip(done) {
            match outcome {
                Some((nodes, edits)) => {
                    let before = count_below(surface, &edits.touched(), pass.bar) + nodes.len();
                    let touched = edits.commit(surface, &nodes);
                    ledger.enter(work, before as isize - count_below(surface, &touched, pass.bar) as isize);
                    if touched.iter().any(|t| at_nodes.binary_search(t).is_ok()) {
                        at_nodes = surface.triangles_at_wrong_nodes();
                        queue.extend(at_nodes.iter().filter_map(|&t| entry(surface, &at_nodes, t)));
                    }
                    queue.extend(touched.into_iter().filter_map(|t| entry(surface, &at_nodes, t)));
                    match pass.means {
                        Means::Move => tally.single_moves += 1,
                        Means::TwoMoves => tally.double_moves += 1,
                        Means::Remesh { .. } => tally.remeshed_patches += 1,
                    }
                }
                None => {
                    ledger.enter(work, 0);
                    ledger.failures.insert(t, surface.commits());
                }
            }
        }
    }
    Ok(())
}

/// How many of some triangles are below a bar.
fn count_below(surface: &Surface, triangles: &[u32], bar: f64) -> usize {
    triangles.iter().filter(|&&t| surface.facts[t as usize].quality < bar).count()
}

/// The triangles, in order, whose regions do not meet those before, with their regions; and the others.
fn apart(surface: &Surface, triangles: &[u32], means: Means) -> (Vec<(u32, Bounds)>, Vec<u32>) {
    let region = |&t: &u32| match means {
        Means::Move | Means::TwoMoves => surface.rings(t, RINGS).bounds(surface),
        Means::Remesh { reach } => super::target_length::region(surface, t, reach),
    };
    let regions: Vec<Bounds> = triangles.par_iter().map(region).collect();
    let (mut chosen, mut others) = (Vec::<(u32, Bounds)>::new(), Vec::new());
    for (&t, region) in triangles.iter().zip(regions) {
        if chosen.iter().any(|(_, other)| other.meets(&region)) {
            others.push(t);
        } else {
            chosen.push((t, region));
        }
    }
    (chosen, others)
}

#[cfg(test)]
mod tests {
    use super::super::sheets::Freedom;
    use super::super::tests::{ball, sampled};
    use super::*;
    use glam::DVec3;
    use isoparticles_field::spline::CubicSpline;
    use isoparticles_mesh::TriangleMesh;

    #[test]
    fn between_curves_single_moves_alone_are_tried_and_beside_them_all_that_there_is_on_what_fails_the_check() {
        let vertices = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].to_vec();
        let mesh = TriangleMesh { vertices, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] };
        let field = CubicSpline::new(&sampled([5; 3], DVec3::ONE, ball(DVec3::ZERO, 1.0)));
        // of the first triangle no corner is free, and all lie on the other sheet, too; of the others one is
        let freedom = vec![Freedom::Point, Freedom::Curve, Freedom::None, Freedom::Sheet];
        let surface = Surface::of_sheets(&mesh, vec![0, 1, 1, 1], freedom, &field, &|_| 1.0);
        let tried = |means: Means, triangle: u32, quality: f64| {
            let pass = Pass { means, limits: Limits::new(0.15, [0.5, 1.6]), bar: FIT };
            pass.may_help(&surface, triangle, quality)
        };
        let [near, far] = [REACHES[0], REACHES[3]].map(|reach| Means::Remesh { reach });
        let all = [Means::Move, near, far, Means::TwoMoves];
        assert_eq!(all.map(|means| tried(means, 0, 0.1)), [true, false, false, false]);
        assert_eq!(all.map(|means| tried(means, 1, 0.9 * POOR)), [true; 4]);
        assert_eq!(all.map(|means| tried(means, 1, 1.1 * POOR)), [true, true, false, false]);
        assert_eq!(all.map(|means| tried(means, 0, 0.0)), [true; 4], "a grid node on the wrong side");
    }
}
