//! Takes vertices away where the mesh is denser than h asks: refinement adds points where F bends within h, for a topology and a distance from F = 0 that
//! the mesh keeps with fewer once vertices may move.

use super::constants::{HOPELESS_BEFORE_SETTLINGS, SHORT, TARGET};
use super::guard::{Limits, Rule, change_of_mean, commit_or_rollback};
use super::moves::Move;
use super::smooth::shift;
use super::surface::{DEAD, Surface, edges_of};
use super::{Step, Tally};
use isoparticles_stage::error::Result;

/// Collapses the edges next to the vertices in question that are shorter than [`SHORT`] times h, shortest first, and smooths what is round them, wherever the mean quality there
/// rises and none falls below [`TARGET`]; and again next to what has changed, until none is left. A rim or a rod thinner than h folds more than the ordinary limits allow: those
/// that F folds by are the loosened ones, and centroids may lie farther from F = 0 ([`Limits::of_thinning`]). No edge gets longer than the ordinary limits, and none ends in two vertices that stay.
///
/// # Errors
/// Those of `step`.
pub(super) fn thin_out(
    surface: &mut Surface,
    limits: &Limits,
    in_question: &[bool],
    step: Step,
    tally: &mut Tally,
) -> Result<()> {
    let limits = &limits.of_thinning();
    let mut open = in_question.to_vec();
    while open.contains(&true) {
        step()?;
        let next_to = |corners: &&[u32; 3]| **corners != DEAD && corners.iter().any(|&v| open[v as usize]);
        let edges = edges_of(surface.triangles.iter().filter(next_to));
        let is_open = |&(a, b): &(u32, u32)| open[a as usize] || open[b as usize];
        let rated = edges.into_iter().filter(is_open).map(|(a, b)| (surface.relative_length(a, b), a, b));
        let mut short: Vec<(f64, u32, u32)> = rated.filter(|edge| edge.0 < SHORT).collect();
        short.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut next = vec![false; open.len()];
        for (_, a, b) in short {
            // its ends may have moved apart, or be gone
            let is_short = surface.edge_triangles(a, b).is_some() && surface.relative_length(a, b) < SHORT;
            if is_short && let Some(touched) = collapse_smoothly(surface, a, b, limits) {
                tally.collapses += 1;
                let corners = touched.into_iter().filter(|&t| surface.is_alive(t));
                corners.flat_map(|t| surface.triangles[t as usize]).for_each(|v| next[v as usize] = true);
            }
        }
        open = next;
    }
    Ok(())
}

/// Collapses an edge into its middle or one of its ends, the first of these that the guard lets pass once what is round it is smooth; the triangles touched. Relocations after that would
/// lower the mean that is asked for: with them ribs at 5,000 vertices came to 0.971 in place of 0.974, in three times the time.
fn collapse_smoothly(surface: &mut Surface, a: u32, b: u32, limits: &Limits) -> Option<Vec<u32>> {
    [Move::Collapse(a, b, 0.5), Move::Collapse(a, b, 0.0), Move::Collapse(b, a, 0.0)].into_iter().find_map(
        |candidate| {
            let made = candidate.make(surface).is_some_and(|involved| settle(surface, &involved));
            let touched = if made { commit_or_rollback(surface, limits, Rule::Mean { floor: TARGET }) } else { None };
            surface.rollback();
            touched
        },
    )
}

/// Smooths some vertices and their neighbours in turn, as often as [`HOPELESS_BEFORE_SETTLINGS`] says; false where that is given up.
fn settle(surface: &mut Surface, vertices: &[u32]) -> bool {
    let neighbours = vertices.iter().flat_map(|&v| surface.link(v).map(|(u, _)| u));
    let mut round: Vec<u32> = neighbours.chain(vertices.iter().copied()).collect();
    round.sort_unstable();
    round.dedup();
    HOPELESS_BEFORE_SETTLINGS.into_iter().all(|bar| {
        let is_worth_it = change_of_mean(surface) >= bar;
        if is_worth_it {
            round.iter().for_each(|&v| shift(surface, v));
        }
        is_worth_it
    })
}
