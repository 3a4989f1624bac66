//! Removes vertices where the mesh is denser than h. Refinement inserts points closer than h to
//! obtain the topology of F and a small deviation. Once the surrounding vertices are smoothed,
//! fewer of them suffice.

use super::acceptance::{Goal, Limits, change_of_mean, commit_or_rollback};
use super::constants::{HOPELESS_BEFORE_SETTLINGS, SHORT, TARGET};
use super::moves::Move;
use super::smooth::shift;
use super::surface::{DEAD, Surface, edges_of};
use super::{Step, Tally};
use isoparticles_stage::error::Result;

/// Collapses edges at the vertices in `in_question` that are shorter than [`SHORT`] times h,
/// shortest first, and smooths the vertices around them. A collapse is kept if the mean quality
/// increases and the minimum quality stays at least [`TARGET`], or does not decrease if it was
/// lower. Further passes examine the vertices of changed triangles until nothing changes.
///
/// Normals and folds have the loose limits, because a rim or rod thinner than h folds by more than
/// the strict limits allow. Deviation and edge lengths have the strict limits.
///
/// # Errors
/// Those of `step`.
pub(super) fn thin_out(surface: &mut Surface, in_question: &[bool], step: Step, tally: &mut Tally) -> Result<()> {
    let limits = &Limits { deviation: Limits::STRICT.deviation, lengths: Limits::STRICT.lengths, ..Limits::LOOSE };
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
            // earlier collapses may have lengthened or removed the edge
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

/// Collapses an edge into its midpoint or one of its ends, and smooths the vertices around it.
/// Commits the first collapse that passes the acceptance test, and returns the touched triangles.
/// Further relocations would lower the mean quality: with them, ribs at 5,000 vertices reach 0.971
/// instead of 0.974, in three times the time.
fn collapse_smoothly(surface: &mut Surface, a: u32, b: u32, limits: &Limits) -> Option<Vec<u32>> {
    [Move::Collapse(a, b, 0.5), Move::Collapse(a, b, 0.0), Move::Collapse(b, a, 0.0)].into_iter().find_map(
        |candidate| {
            let made = candidate.make(surface).is_some_and(|involved| settle(surface, &involved));
            let touched =
                if made { commit_or_rollback(surface, limits, Goal::Mean { floor: TARGET, price: 0.0 }) } else { None };
            surface.rollback();
            touched
        },
    )
}

/// Smooths vertices and their neighbours in turn, once for each limit in
/// [`HOPELESS_BEFORE_SETTLINGS`]. Returns `false` if the collapse is abandoned, that is, if the
/// change of the mean quality is below a limit.
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
