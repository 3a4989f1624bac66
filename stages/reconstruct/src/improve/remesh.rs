//! Adjusts edge lengths and vertex degrees (after Botsch and Kobbelt 2004). A round splits long
//! edges, collapses short edges, flips edges towards degree six, and relaxes vertices along the
//! surface. Every move must pass the acceptance test, and the vertices stay on F = 0.

use super::acceptance::{Goal, Limits, commit_or_rollback, total_gain};
use super::constants::{FEW_CHANGES, FLOOR, HOPELESS_AFTER_SWEEP, LONG, PASSES, ROUNDS, SHORT, TARGET};
use super::curves::{collapse_along, split_along};
use super::moves::{collapse, flip, relax, split};
use super::smooth::shift;
use super::surface::{DEAD, Surface, edges_of};
use super::{Step, Tally};
use isoparticles_stage::error::Result;

/// Splits and collapses edges between vertices that are not frozen until their lengths fit h. There
/// are at most [`ROUNDS`] rounds plus the number of times that the longest edge must be halved to
/// reach h. Each round calls `step` first.
///
/// # Errors
/// Those of `step`.
pub(super) fn adjust(surface: &mut Surface, limits: &Limits, step: Step, tally: &mut Tally) -> Result<()> {
    let changeable: Vec<u32> = (0..surface.triangles.len() as u32).filter(|&t| !surface.is_frozen(t)).collect();
    let longest = changeable.iter().map(|&t| surface.facts[t as usize].lengths[1]).fold(1.0, f64::max);
    for _ in 0..ROUNDS + longest.log2().ceil() as usize {
        step()?;
        let changes = round(surface, limits, Curves::Change, tally);
        if (changes as f64) < FEW_CHANGES * changeable.len() as f64 {
            break;
        }
    }
    Ok(())
}

/// Whether edges of junction curves are split and collapsed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Curves {
    /// They are neither split nor collapsed.
    Keep,
    /// They are split and collapsed.
    Change,
}

/// Performs one round of splits, collapses, flips and two relaxations. Returns the number of splits
/// and collapses.
pub(super) fn round(surface: &mut Surface, limits: &Limits, curves: Curves, tally: &mut Tally) -> usize {
    let splits = split_long(surface, limits, curves);
    let collapses = collapse_short(surface, limits, curves, tally);
    let all = &vec![true; surface.positions.len()];
    equalise_degrees(surface, limits, Goal::Keep { floor: FLOOR }, all, tally);
    for _ in 0..2 {
        relax_all(surface, limits, Goal::Keep { floor: TARGET }, all, tally);
    }
    splits + collapses
}

/// Returns all edges in ascending order, each with the lower vertex first.
pub(super) fn edges(surface: &Surface) -> Vec<(u32, u32)> {
    edges_of(surface.triangles.iter().filter(|t| **t != DEAD))
}

/// Splits edges longer than [`LONG`] h, and returns the number of splits.
fn split_long(surface: &mut Surface, limits: &Limits, curves: Curves) -> usize {
    let mut long: Vec<(f64, u32, u32)> = edges(surface)
        .into_iter()
        .map(|(a, b)| (surface.relative_length(a, b), a, b))
        .filter(|edge| edge.0 > LONG)
        .collect();
    long.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut count = 0;
    for (_, a, b) in long {
        let along = |surface: &mut Surface| curves == Curves::Change && split_along(surface, a, b).is_some();
        let made = split(surface, a, b).is_some() || along(surface);
        count += usize::from(made && commit_or_rollback(surface, limits, Goal::Keep { floor: FLOOR }).is_some());
        surface.rollback();
    }
    count
}

/// Collapses edges shorter than [`SHORT`] h, and returns the number of collapses.
fn collapse_short(surface: &mut Surface, limits: &Limits, curves: Curves, tally: &mut Tally) -> usize {
    let before = tally.collapses;
    let mut short: Vec<(f64, u32, u32)> = edges(surface)
        .into_iter()
        .map(|(a, b)| (surface.relative_length(a, b), a, b))
        .filter(|edge| edge.0 < SHORT)
        .collect();
    short.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, a, b) in short {
        if surface.relative_length(a, b) >= SHORT {
            continue;
        }
        let Some([(left, _), _]) = surface.edge_triangles(a, b) else {
            let collapses = |&(keep, gone): &(u32, u32)| {
                let made = curves == Curves::Change && collapse_along(surface, keep, gone);
                let kept = made && commit_or_rollback(surface, limits, Goal::Keep { floor: FLOOR }).is_some();
                surface.rollback();
                kept
            };
            tally.collapses += usize::from([(a, b), (b, a)].iter().any(collapses));
            continue;
        };
        let (p, q) = (surface.positions[a as usize], surface.positions[b as usize]);
        let middle = surface.field.projected(surface.pair[left as usize], 0.5 * (p + q), p.distance(q));
        for (keep, gone, at) in [(a, b, middle), (a, b, Some(p)), (b, a, Some(q))] {
            let Some(at) = at else { continue };
            let too_long = |s: &Surface| s.link(keep).any(|(v, _)| s.relative_length(keep, v) > LONG);
            if collapse(surface, keep, gone, at)
                && !too_long(surface)
                && commit_or_rollback(surface, limits, Goal::Keep { floor: FLOOR }).is_some()
            {
                tally.collapses += 1;
                break;
            }
            surface.rollback();
        }
    }
    tally.collapses - before
}

/// Flips an edge if this lowers the sum of the squared surpluses ([`Surface::surplus`]) of its four
/// vertices. Only edges of triangles with a vertex in `in_question` are tested.
///
/// If the goal requires a gain, the four vertices of a flip are smoothed before the acceptance
/// test, because a flip alone rarely improves the triangles. Flips that do not change the sum are
/// then tried as well; they move a 5-7 pair by one edge. With them, the mean radius ratio of
/// `heart_label` 1 at 5,000 vertices is 0.9919 instead of 0.9915, and that of the lungs at 1,000 is
/// 0.9885 instead of 0.9877.
pub(super) fn equalise_degrees(
    surface: &mut Surface,
    limits: &Limits,
    goal: Goal,
    in_question: &[bool],
    tally: &mut Tally,
) {
    let must_gain = !matches!(goal, Goal::Keep { .. });
    let next_to = |corners: &&[u32; 3]| **corners != DEAD && corners.iter().any(|&v| in_question[v as usize]);
    for (a, b) in edges_of(surface.triangles.iter().filter(next_to)) {
        let Some([(left, c), (_, d)]) = surface.edge_triangles(a, b) else { continue };
        let [a_over, b_over, c_over, d_over] = [a, b, c, d].map(|v| surface.surplus(v, left));
        let cost = |x: i64| x * x;
        let before = cost(a_over) + cost(b_over) + cost(c_over) + cost(d_over);
        let after = cost(a_over - 1) + cost(b_over - 1) + cost(c_over + 1) + cost(d_over + 1);
        if (after < before || after == before && must_gain) && flip(surface, a, b) {
            let mut sweeps = if must_gain { 0..PASSES } else { 0..0 };
            let is_hopeful = sweeps.all(|_| {
                [a, b, c, d].into_iter().for_each(|v| shift(surface, v));
                total_gain(surface) >= HOPELESS_AFTER_SWEEP
            });
            tally.flips += usize::from(is_hopeful && commit_or_rollback(surface, limits, goal).is_some());
        }
        surface.rollback();
    }
}

/// Relaxes each vertex in `in_question` once, in order: all the way or, if this fails, by 0.4 of
/// it.
pub(super) fn relax_all(surface: &mut Surface, limits: &Limits, goal: Goal, in_question: &[bool], tally: &mut Tally) {
    for v in (0..surface.positions.len() as u32).filter(|&v| in_question[v as usize]) {
        for share in [1.0, 0.4] {
            if relax(surface, v, share) && commit_or_rollback(surface, limits, goal).is_some() {
                tally.relocations += 1;
                break;
            }
            surface.rollback();
        }
    }
}
