//! Separates parts of the surface that touch at an edge or a vertex: some tetrahedra there change
//! sides.

use super::cells::Cells;
use super::umbrellas::{Umbrellas, good_vertices};
use crate::around::{boundary, parts_round, runs_round};
use crate::defects::{Pinches, edge_of};
use crate::restricted::Facet;
use isoparticles_mesh::incidence::Incidence;

/// Number of rounds in which tetrahedra may change to either side. Afterwards, they may only change
/// to the inside, so that the loop ends.
const FREE_ROUNDS: usize = 8;

/// Maximum number of tetrahedra that change sides at a vertex. If more are needed, the vertex is
/// duplicated later.
const SMALL_PART: usize = 12;

/// Lets tetrahedra change sides at edges of more than two facets, and small groups of tetrahedra at
/// vertices with more than one fan. Ends when there are no such edges or nothing more can change.
/// Returns the facets and the number of changes.
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
                // a change at a nearby edge has already separated the parts
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

/// Returns the cost of a change of sides: the number of tetrahedra and of umbrellas at their
/// vertices.
fn doubt(cells: &Cells, umbrellas: &Umbrellas, part: &[u32]) -> usize {
    part.iter().map(|&t| 1 + good_vertices(cells, umbrellas, t).count()).sum()
}
