//! One queue of bad triangles, worst first. For each, a transaction on a patch round it: a single move with relocations, or the patch remeshed
//! at a smaller target length. Patches that do not meet are worked on side by side; what a patch commits is one commit of the whole.

use super::constants::{BATCH, FIT, LEAST_GAIN, MOST_IN_VAIN, REACHES, RINGS};
use super::guard::{Limits, Rule, commit_or_rollback, gain};
use super::moves::{Move, moves_near, relocate_all};
use super::patch::Patch;
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
    /// Remeshing of a patch of so many lengths' radius with a smaller target length.
    Remesh { reach: f64 },
}

/// One way through the queue.
struct Pass {
    means: Means,
    limits: Limits,
    /// Quality below which a triangle is in the queue.
    bar: f64,
}

/// What was tried in vain, by triangle: the number of commits at the time, lest it be tried again before anything has changed there.
type Failures = HashMap<u32, u32>;

/// Lifts the triangles below a quality, `rounds` times at most: by moves within the limits; those not fit for finite elements by moves within
/// the loosened limits, and by remeshing. `step` is called before each batch and may stop it.
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
    let passes = [
        Pass { means: Means::Move, limits: *limits, bar: target },
        Pass { means: Means::Move, limits: loosened, bar: unfit },
    ];
    let remeshing = REACHES.map(|reach| Pass { means: Means::Remesh { reach }, limits: loosened, bar: unfit });
    let passes: Vec<Pass> = passes.into_iter().chain(remeshing).collect();
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
    let entry = |surface: &Surface, t: u32| {
        let quality = surface.facts[t as usize].quality;
        (quality < pass.bar).then(|| Reverse((quality.to_bits(), t)))
    };
    let all = 0..surface.triangles.len() as u32;
    let mut queue: BinaryHeap<_> = all.filter_map(|t| entry(surface, t)).collect();
    let mut in_vain = 0;
    // as many as may well be apart
    let mut width = BATCH;
    while pass.means == Means::Move || in_vain < MOST_IN_VAIN {
        let mut batch = Vec::new();
        while batch.len() < width
            && let Some(Reverse((bits, t))) = queue.pop()
        {
            let is_current = surface.facts[t as usize].quality.to_bits() == bits && surface.is_alive(t);
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
                Means::Remesh { reach } => remesh(&mut patch.surface, local, reach, &pass.limits, pass.bar),
            };
            is_better.then(|| (patch.turned_nodes(surface), patch.edits(surface)))
        };
        let done: Vec<_> = chosen.par_iter().map(work).collect();
        queue.extend(others.into_iter().filter_map(|t| entry(surface, t)));
        for ((t, _), outcome) in chosen.into_iter().zip(done) {
            match outcome {
                Some((nodes, edits)) => {
                    let touched = edits.commit(surface, &nodes);
                    queue.extend(touched.into_iter().filter_map(|t| entry(surface, t)));
                    match pass.means {
                        Means::Move => tally.single_moves += 1,
                        Means::Remesh { .. } => tally.remeshed_patches += 1,
                    }
                }
                None => {
                    failures.insert(t, surface.commits());
                    in_vain += 1;
                }
            }
        }
    }
    Ok(())
}

/// The triangles, in order, whose regions do not meet those before, with their regions; and the others.
fn apart(surface: &Surface, triangles: &[u32], means: Means) -> (Vec<(u32, Bounds)>, Vec<u32>) {
    let region = |&t: &u32| match means {
        Means::Move => surface.rings(t, RINGS).bounds(surface),
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

/// Commits the single move on a triangle that gains most, of those that the guard lets pass; with relocations round it where none does alone.
pub(super) fn lift(surface: &mut Surface, triangle: u32, limits: &Limits, bar: f64) -> bool {
    let corners = surface.triangles[triangle as usize];
    let candidates = moves_near(corners);
    for relocates in [false, true] {
        let mut rated: Vec<(f64, Move)> = Vec::new();
        for &candidate in &candidates {
            if make(surface, candidate, relocates) {
                let gain = gain(surface, bar);
                if gain > LEAST_GAIN {
                    rated.push((gain, candidate));
                }
            }
            surface.rollback();
        }
        // stable: the order of the moves among equals
        rated.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, candidate) in rated {
            if make(surface, candidate, relocates) && commit_or_rollback(surface, limits, Rule::Lift { bar }).is_some()
            {
                return true;
            }
            surface.rollback();
        }
    }
    false
}

fn make(surface: &mut Surface, candidate: Move, relocates: bool) -> bool {
    let Some(involved) = candidate.make(surface) else { return false };
    if relocates {
        relocate_all(surface, involved);
    }
    true
}
