//! Edges in which parts of the surface touch: one of the parts of space round the edge changes sides.

use super::cells::{Cells, place_of};
use super::umbrellas::{Umbrellas, good_vertices};
use crate::restricted::Facet;
use isoparticles_common::delaunay::Delaunay;
use rayon::prelude::*;

/// Rounds in which parts may go either way; after them they may only join the object, so that there is an end.
const FREE_ROUNDS: usize = 8;

/// The facets between inside and outside, in the order of the tetrahedra.
pub(super) fn boundary(delaunay: &Delaunay, is_out: &[bool]) -> Vec<Facet> {
    (0..is_out.len() as u32)
        .into_par_iter()
        .flat_map_iter(|t| {
            let is_inside = !is_out[t as usize] && delaunay.is_alive(t);
            let neighbours = delaunay.neighbours(t);
            (0..4usize).filter(move |&i| is_inside && is_out[neighbours[i] as usize]).map(move |i| Facet {
                vertices: delaunay.facet(t, i),
                tetrahedron: t,
                opposite: i as u8,
            })
        })
        .collect()
}

/// Lets tetrahedra at edges in more than two facets change sides until there is none; returns the facets and how many tetrahedra
/// changed.
pub(super) fn part_edges(cells: &Cells, umbrellas: &Umbrellas, is_out: &mut [bool]) -> (Vec<Facet>, usize) {
    let mut changed = 0;
    for round in 0.. {
        let facets = boundary(cells.delaunay, is_out);
        let edges = pinched_edges(&facets);
        if edges.is_empty() {
            return (facets, changed);
        }
        for (edge, facet) in edges {
            let runs = runs_round(cells.delaunay, edge, facets[facet as usize].tetrahedron, is_out);
            if runs.len() < 4 {
                // an edge nearby took care of it
                continue;
            }
            let free = |run: &&Vec<u32>| {
                let joins = is_out[run[0] as usize];
                run.iter().all(|&t| !cells.delaunay.is_ghost(t)) && (joins || round < FREE_ROUNDS)
            };
            let doubt =
                |run: &Vec<u32>| run.iter().map(|&t| 1 + good_vertices(cells, umbrellas, t).count()).sum::<usize>();
            let Some(run) = runs.iter().filter(free).min_by_key(|run| doubt(run)) else { continue };
            for &t in run {
                is_out[t as usize] ^= true;
            }
            changed += run.len();
        }
    }
    unreachable!("the rounds end when no edge is left, and each round after the free ones adds to the object")
}

/// Edges in more than two facets, each with one of its facets.
fn pinched_edges(facets: &[Facet]) -> Vec<([u32; 2], u32)> {
    let mut sides: Vec<(u32, u32, u32)> = facets
        .par_iter()
        .enumerate()
        .flat_map_iter(|(f, facet)| {
            let [a, b, c] = facet.vertices;
            [(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q), f as u32))
        })
        .collect();
    sides.par_sort_unstable();
    let edges = sides.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)).filter(|edge| edge.len() > 2);
    edges.map(|edge| ([edge[0].0, edge[0].1], edge[0].2)).collect()
}

/// The tetrahedra round an edge, by runs of one side.
fn runs_round(delaunay: &Delaunay, [a, b]: [u32; 2], start: u32, is_out: &[bool]) -> Vec<Vec<u32>> {
    let others = |t: u32| {
        let v = delaunay.vertices(t);
        v.into_iter().filter(move |&u| u != a && u != b)
    };
    let mut ring = vec![start];
    let mut behind = others(start).next().unwrap_or(a);
    loop {
        let t = ring[ring.len() - 1];
        let ahead = others(t).find(|&u| u != behind).unwrap_or(a);
        let next = delaunay.neighbours(t)[place_of(delaunay.vertices(t), behind)];
        if next == start {
            break;
        }
        ring.push(next);
        // across the facet opposite to what was behind lies a tetrahedron with what was ahead
        behind = ahead;
    }
    let side = |t: &u32| is_out[*t as usize];
    let first =
        (0..ring.len()).find(|&k| side(&ring[k]) != side(&ring[(k + ring.len() - 1) % ring.len()])).unwrap_or(0);
    ring.rotate_left(first);
    ring.chunk_by(|s, t| side(s) == side(t)).map(<[u32]>::to_vec).collect()
}
