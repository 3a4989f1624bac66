//! What a bad triangle is lifted by: a single move, with relocations round it where none helps alone, and two moves in a row.

use super::constants::{FIRST_MOVES, LEAST_GAIN};
use super::guard::{Limits, Rule, commit_or_rollback, gain, progress};
use super::moves::{Move, moves_near, relocate_all};
use super::surface::Surface;

/// What follows a move before it is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum After {
    /// Nothing.
    Nothing,
    /// Relocations of the vertices that gain by it.
    Relocations,
}

/// Commits the single move on a triangle that gains most, of those that the guard lets pass; with relocations round it where none does alone.
pub(super) fn lift(surface: &mut Surface, triangle: u32, limits: &Limits, bar: f64) -> bool {
    let candidates = moves_near([surface.triangles[triangle as usize]]);
    let mut by_best = |after| lift_by_best(surface, &candidates, after, limits, bar);
    by_best(After::Nothing) || by_best(After::Relocations)
}

/// Commits the move that gains most, of those that the guard lets pass.
fn lift_by_best(surface: &mut Surface, candidates: &[Move], after: After, limits: &Limits, bar: f64) -> bool {
    let mut rated: Vec<(f64, Move)> = Vec::new();
    // relocations that follow bring a vertex all the way
    for &candidate in candidates.iter().filter(|m| after == After::Nothing || !m.is_partial()) {
        if make(surface, candidate, after) {
            let gain = gain(surface, bar);
            if gain > LEAST_GAIN {
                rated.push((gain, candidate));
            }
        }
        surface.rollback();
    }
    // stable: the order of the moves among equals
    rated.sort_by(|a, b| b.0.total_cmp(&a.0));
    rated.into_iter().any(|(_, candidate)| {
        let made = make(surface, candidate, after);
        let kept = made && commit_or_rollback(surface, limits, Rule::Lift { bar }).is_some();
        surface.rollback();
        kept
    })
}

/// The same with two moves in a row: a first one on the triangle or its neighbours, which need not help by itself, and one on the worst triangle that it
/// leaves, each with relocations.
pub(super) fn lift_by_two(surface: &mut Surface, triangle: u32, limits: &Limits, bar: f64) -> bool {
    let whole = |triangles: Vec<[u32; 3]>| -> Vec<Move> {
        moves_near(triangles).into_iter().filter(|m| !m.is_partial()).collect()
    };
    let near = whole(surface.with_neighbours(triangle));
    if lift(surface, triangle, limits, bar) {
        return true;
    }
    let after = After::Relocations;
    let mut firsts: Vec<(f64, Move)> = Vec::new();
    for candidate in near {
        if make(surface, candidate, after) {
            firsts.push((progress(surface, bar), candidate));
        }
        surface.rollback();
    }
    firsts.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, first) in firsts.into_iter().take(FIRST_MOVES) {
        make(surface, first, after);
        let made = surface.mark();
        let touched = surface.touched().into_iter().filter(|&t| surface.is_alive(t));
        let worst = touched.min_by(|&a, &b| surface.quality(a).total_cmp(&surface.quality(b)));
        let corners = worst.map(|t| surface.triangles[t as usize]);
        let mut rated: Vec<(f64, Move)> = Vec::new();
        for candidate in whole(corners.into_iter().collect()) {
            if make(surface, candidate, after) {
                let gain = gain(surface, bar);
                if gain > LEAST_GAIN {
                    rated.push((gain, candidate));
                }
            }
            surface.rollback_to(made);
        }
        rated.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, second) in rated {
            surface.rollback();
            if make(surface, first, after)
                && make(surface, second, after)
                && commit_or_rollback(surface, limits, Rule::Lift { bar }).is_some()
            {
                return true;
            }
        }
        surface.rollback();
    }
    false
}

/// Makes a move, with what is to follow; false where it cannot be made.
pub(super) fn make(surface: &mut Surface, candidate: Move, after: After) -> bool {
    let Some(involved) = candidate.make(surface) else { return false };
    if after == After::Relocations {
        relocate_all(surface, involved);
    }
    true
}
