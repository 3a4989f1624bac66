//! One queue of bad triangles, worst first; a triangle nearest to a grid node on the wrong side comes before all. For each, a transaction on a
//! patch round it: a single move with relocations, two moves in a row, or the patch remeshed at a smaller target length. Patches that do not
//! meet are worked on side by side; what a patch commits is one commit of the whole.

use super::constants::{
    AIM, BATCH, EASY, FIT, MOST_FIT_REMESHED_IN_VAIN, MOST_IN_VAIN, MOST_IN_VAIN_ABOVE_EASY, MOST_IN_VAIN_AT_JUNCTIONS,
    MOST_PAIRS_IN_VAIN, REACHES, RINGS,
};
use super::guard::Limits;
use super::lift::{lift, lift_by_two};
use super::patch::Patch;
use super::sheets::Freedom;
use super::surface::Surface;
use super::target_length::remesh;
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
    /// Triangles tried in vain after which the rest is left as it is.
    most_in_vain: usize,
}

impl Pass {
    /// The same where sheets meet in junction curves.
    fn most_in_vain_at_junctions(&self) -> usize {
        if self.means == Means::Move { self.most_in_vain } else { self.most_in_vain.min(MOST_IN_VAIN_AT_JUNCTIONS) }
    }
}

/// What was tried in vain, by triangle: the number of commits at the time, lest it be tried again before anything has changed there.
type Failures = HashMap<u32, u32>;

/// Lifts the triangles below a quality, `rounds` times at most: by moves within the limits; those not fit for finite elements by moves within the
/// loosened limits, by remeshing and by two moves in a row; then those below [`AIM`] by two moves, and all of them by one, by two and by
/// remeshing, in so far as a few failures allow.
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
    let pass = |means, limits, bar, most_in_vain| Pass { means, limits, bar, most_in_vain };
    let remesh = |reach| pass(Means::Remesh { reach }, *limits, unfit, MOST_IN_VAIN);
    let [smallest, small, large, largest] = REACHES;
    let two_moves = |limits, bar: f64| pass(Means::TwoMoves, limits, target.min(bar), MOST_PAIRS_IN_VAIN);
    // as loose as that, but no farther from F = 0
    let within = Limits { deviation: limits.deviation, ..loosened };
    let passes = [
        pass(Means::Move, *limits, target.min(EASY), usize::MAX),
        pass(Means::Move, loosened, unfit, usize::MAX),
        remesh(smallest),
        remesh(small),
        pass(Means::TwoMoves, loosened, unfit, MOST_IN_VAIN),
        remesh(large),
        remesh(largest),
        two_moves(within, AIM),
        two_moves(loosened, AIM),
        pass(Means::Move, *limits, target, MOST_IN_VAIN_ABOVE_EASY),
        two_moves(within, target),
        two_moves(loosened, EASY),
        pass(Means::Remesh { reach: smallest }, *limits, target, MOST_FIT_REMESHED_IN_VAIN),
    ];
    let mut failures: Vec<Failures> = passes.iter().map(|_| Failures::new()).collect();
    for _ in 0..rounds {
        let commits = surface.commits();
        for (pass, failures) in passes.iter().zip(&mut failures) {
            drain(surface, pass, failures, step, tally)?;
        }
        if surface.commits() == commits {
            break;
        }
    }
    Ok(())
}

/// Tries every triangle below the bar, worst first, and again whatever falls short next to a success.
fn drain(surface: &mut Surface, pass: &Pass, failures: &mut Failures, step: Step, tally: &mut Tally) -> Result<()> {
    let mut at_nodes = if pass.bar > 0.0 { surface.triangles_at_wrong_nodes() } else { Vec::new() };
    // no triangle has less than 0
    let rank = |surface: &Surface, at_nodes: &[u32], t: u32| {
        let is_at_node = surface.is_alive(t) && at_nodes.binary_search(&t).is_ok();
        if is_at_node { 0 } else { surface.facts[t as usize].quality.to_bits() }
    };
    let entry = |surface: &Surface, at_nodes: &[u32], t: u32| {
        let rank = rank(surface, at_nodes, t);
        let is_tried = rank < pass.bar.to_bits() && (pass.means.is_local() || rank == 0 || !surface.is_held(t));
        is_tried.then_some(Reverse((rank, t)))
    };
    let has_junctions = surface.freedom.iter().any(|&freedom| freedom != Freedom::Sheet);
    let most_in_vain = if has_junctions { pass.most_in_vain_at_junctions() } else { pass.most_in_vain };
    let all = 0..surface.triangles.len() as u32;
    let mut queue: BinaryHeap<_> = all.filter_map(|t| entry(surface, &at_nodes, t)).collect();
    // as many as may well be apart
    let mut width = BATCH;
    while failures.len() < most_in_vain {
        let mut batch = Vec::new();
        // no more than may fail
        let left = most_in_vain - failures.len();
        while batch.len() < width.min(left)
            && let Some(Reverse((bits, t))) = queue.pop()
        {
            let is_current = surface.is_alive(t) && rank(surface, &at_nodes, t) == bits;
            let is_hopeless = || failures.get(&t).is_some_and(|&commits| surface.is_unchanged_since(t, commits));
            if is_current && !batch.contains(&t) && !is_hopeless() {
                batch.push(t);
            }
        }
        if batch.is_empty() {
            break;
        }
        step()?;
        let (chosen, others) = apart(surface, &batch, pass.means);
        width = (2 * chosen.len()).clamp(2, BATCH);
        let work = |&(t, region): &(u32, Bounds)| {
            let mut patch = Patch::within(surface, &region);
            let local = patch.local(t);
            let is_better = match pass.means {
                Means::Move => lift(&mut patch.surface, local, &pass.limits, pass.bar),
                Means::TwoMoves => lift_by_two(&mut patch.surface, local, &pass.limits, pass.bar),
                Means::Remesh { reach } => remesh(&mut patch.surface, local, reach, &pass.limits, pass.bar),
            };
            is_better.then(|| (patch.turned_nodes(surface), patch.edits(surface)))
        };
        let done: Vec<_> = chosen.par_iter().map(work).collect();
        queue.extend(others.into_iter().filter_map(|t| entry(surface, &at_nodes, t)));
        for ((t, _), outcome) in chosen.into_iter().zip(done) {
            match outcome {
                Some((nodes, edits)) => {
                    let touched = edits.commit(surface, &nodes);
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
                    failures.insert(t, surface.commits());
                }
            }
        }
    }
    Ok(())
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
