//! Improves a bad triangle by a single move, followed by relocations around it if needed, or by two
//! moves in a row.

use super::acceptance::{Goal, Limits, commit_or_rollback, gain, progress};
use super::constants::{FIRST_MOVES, LEAST_GAIN};
use super::moves::{Move, moves_near, relocate_all};
use super::surface::Surface;
use rayon::prelude::*;

/// Maximum number of triangles of a surface whose moves with relocations (0.1 ms each) are rated in
/// parallel on copies. Above this size, copying costs more than parallelism saves.
const MOST_COPIED: usize = 1000;

/// What follows a move before the acceptance test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum After {
    /// Nothing.
    Nothing,
    /// Relocations of the vertices around the move.
    Relocations,
}

/// Tries the moves on a triangle, maximum gain first, and commits the first that passes the
/// acceptance test. If none passes, tries moves followed by relocations. Returns whether a move
/// passed.
pub(super) fn lift(surface: &mut Surface, triangle: u32, limits: &Limits, bar: f64) -> bool {
    let candidates = moves_near([surface.triangles[triangle as usize]]);
    let mut by_best = |after| lift_by_best(surface, &candidates, after, limits, bar);
    by_best(After::Nothing) || by_best(After::Relocations)
}

/// Tries moves, maximum gain first, and commits the first that passes the acceptance test. Returns
/// whether a move passed.
fn lift_by_best(surface: &mut Surface, candidates: &[Move], after: After, limits: &Limits, bar: f64) -> bool {
    // the relocations that follow move each vertex to its best position, so partial relocations are
    // redundant
    let candidates: Vec<Move> =
        candidates.iter().filter(|m| after == After::Nothing || !m.is_partial()).copied().collect();
    let rated = rated(surface, &candidates, after, gain_above(bar));
    rated.into_iter().any(|(_, candidate)| {
        let made = make(surface, candidate, after);
        let kept = made && commit_or_rollback(surface, limits, Goal::Lift { bar }).is_some();
        surface.rollback();
        kept
    })
}

/// Commits a single move if one passes ([`lift`]), and otherwise two moves in a row, each with
/// relocations. The first move is on the triangle or its neighbours and may lower the minimum
/// quality. The second move is on the worst triangle that the first has touched. Returns whether
/// anything was committed.
pub(super) fn lift_by_two(surface: &mut Surface, triangle: u32, limits: &Limits, bar: f64) -> bool {
    let whole = |triangles: Vec<[u32; 3]>| -> Vec<Move> {
        moves_near(triangles).into_iter().filter(|m| !m.is_partial()).collect()
    };
    let near = whole(surface.with_neighbours(triangle));
    if lift(surface, triangle, limits, bar) {
        return true;
    }
    let after = After::Relocations;
    let firsts = rated(surface, &near, after, |made| Some(progress(made, bar)));
    for (_, first) in firsts.into_iter().take(FIRST_MOVES) {
        make(surface, first, after);
        let touched = surface.touched().into_iter().filter(|&t| surface.is_alive(t));
        let worst = touched.min_by(|&a, &b| surface.quality(a).total_cmp(&surface.quality(b)));
        let corners = worst.map(|t| surface.triangles[t as usize]);
        let seconds = whole(corners.into_iter().collect());
        for (_, second) in rated(surface, &seconds, after, gain_above(bar)) {
            surface.rollback();
            if make(surface, first, after)
                && make(surface, second, after)
                && commit_or_rollback(surface, limits, Goal::Lift { bar }).is_some()
            {
                return true;
            }
        }
        surface.rollback();
    }
    false
}

/// Returns the gain of the edits since the last commit if it exceeds [`LEAST_GAIN`].
fn gain_above(bar: f64) -> impl Fn(&Surface) -> Option<f64> + Sync {
    move |made| Some(gain(made, bar)).filter(|&gain| gain > LEAST_GAIN)
}

/// Makes each move, rates it by a measure of the surface, and rolls it back. Returns the rates and
/// moves in descending order, without moves that are not possible or have no rate.
fn rated(
    surface: &mut Surface,
    candidates: &[Move],
    after: After,
    measure: impl Fn(&Surface) -> Option<f64> + Sync,
) -> Vec<(f64, Move)> {
    let rate = |surface: &mut Surface, candidate: Move| {
        let before = surface.mark();
        let rate = make(surface, candidate, after).then(|| measure(surface)).flatten();
        surface.rollback_to(before);
        rate.map(|rate| (rate, candidate))
    };
    let copies = rayon::current_num_threads().min(candidates.len());
    let is_small = after == After::Relocations && surface.triangles.len() <= MOST_COPIED;
    let mut rated: Vec<(f64, Move)> = if is_small && copies > 1 {
        let chunks = candidates.par_chunks(candidates.len().div_ceil(copies));
        let rate_all = |chunk: &[Move]| {
            let mut copy = surface.clone();
            let rated: Vec<_> = chunk.iter().filter_map(|&candidate| rate(&mut copy, candidate)).collect();
            (rated, copy.tried - surface.tried)
        };
        let (rated, tried): (Vec<_>, Vec<usize>) = chunks.map(rate_all).unzip();
        surface.tried += tried.into_iter().sum::<usize>();
        rated.concat()
    } else {
        candidates.iter().filter_map(|&candidate| rate(surface, candidate)).collect()
    };
    // the sort is stable: moves with equal rates keep their order
    rated.sort_by(|a, b| b.0.total_cmp(&a.0));
    rated
}

/// Makes a move and what follows it. Returns whether the move is possible.
pub(super) fn make(surface: &mut Surface, candidate: Move, after: After) -> bool {
    let Some(involved) = candidate.make(surface) else { return false };
    if after == After::Relocations {
        relocate_all(surface, involved);
    }
    true
}
