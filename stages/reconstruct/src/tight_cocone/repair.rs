//! Edges and vertices in which parts of the surface touch: a part of space there changes sides.

use super::cells::Cells;
use super::umbrellas::{Umbrellas, good_vertices};
use crate::around::{boundary, parts_round, runs_round};
use crate::defects::{Pinches, edge_of};
use crate::restricted::Facet;
use isoparticles_mesh::incidence::Incidence;

/// Rounds in which parts may go either way; after them they may only join the object, so that there is an end.
const FREE_ROUNDS: usize = 8;

/// At a vertex no more tetrahedra than these change sides; where more would have to, the vertex is doubled later.
const SMALL_PART: usize = 12;

/// Lets tetrahedra at edges in more than two facets change sides until there is none, and few at vertices with more than one fan;
/// returns the facets and how many tetrahedra changed.
pub(super) fn part_pinches(cells: &Cells, umbrellas: &Umbrellas, is_out: &mut [bool]) -> (Vec<Facet>, usize) {
    let mut changed = 0;
    for round in 0.. {
        let is_free = round < FREE_ROUNDS;
        let facets = boundary(cells.delaunay, |t| !is_out[t as usize]);
        let triangles: Vec<[u32; 3]> = facets.iter().map(|f| f.vertices).collect();
        let incidence = Incidence::new(&triangles, cells.delaunay.points().len());
        let Pinches { edges, vertices } = Pinches::at_first(incidence.vertex_count(), &incidence, |_, _| false);
        if edges.is_empty() && (vertices.is_empty() || !is_free) {
            return (facets, changed);
        }
        let before = changed;
        for around in edges {
            let Some(edge) = edge_of(&facets, &around) else { continue };
            let runs = runs_round(cells.delaunay, edge, facets[around[0] as usize].tetrahedron, |t| is_out[t as usize]);
            if runs.len() < 4 {
                // an edge nearby took care of it
                continue;
            }
            let may_change = |run: &&Vec<u32>| {
                let joins = is_out[run[0] as usize];
                run.iter().all(|&t| !cells.delaunay.is_ghost(t)) && (joins || is_free)
            };
            let Some(run) = runs.iter().filter(may_change).min_by_key(|run| doubt(cells, umbrellas, run)) else {
                continue;
            };
            run.iter().for_each(|&t| is_out[t as usize] ^= true);
            changed += run.len();
        }
        for (v, _) in vertices.into_iter().filter(|_| is_free) {
            let parts = parts_round(cells.delaunay, v, cells.stars.of(v), |t| is_out[t as usize]);
            let of_side = |side: bool| parts.iter().filter(|part| is_out[part[0] as usize] == side).count();
            let spare = |part: &&Vec<u32>| {
                let is_small = part.len() <= SMALL_PART && part.iter().all(|&t| !cells.delaunay.is_ghost(t));
                is_small && of_side(is_out[part[0] as usize]) > 1
            };
            let Some(part) = parts.iter().filter(spare).min_by_key(|part| doubt(cells, umbrellas, part)) else {
                continue;
            };
            part.iter().for_each(|&t| is_out[t as usize] ^= true);
            changed += part.len();
        }
        if changed == before {
            return (facets, changed);
        }
    }
    unreachable!("the rounds end when no edge is left, and each round after the free ones adds to the object")
}

/// How much speaks against a change of sides: tetrahedra, and umbrellas at them.
fn doubt(cells: &Cells, umbrellas: &Umbrellas, part: &[u32]) -> usize {
    part.iter().map(|&t| 1 + good_vertices(cells, umbrellas, t).count()).sum()
}
