//! Fans of facets: the corners of facets at a vertex, joined across the edges that lie in two facets. A vertex of a manifold has one fan.

use crate::restricted::Facet;
use isoparticles_common::components::DisjointSets;
use rayon::prelude::*;

/// Joins the corners (3 f + i is corner i of facet f) of all facets into fans. Edges that do not lie in exactly two facets join
/// nothing and go to `other_edge`, with the numbers of their facets.
pub fn fans(facets: &[Facet], mut other_edge: impl FnMut([u32; 2], &mut dyn Iterator<Item = u32>)) -> DisjointSets {
    let mut sides: Vec<(u32, u32, u32)> = facets
        .par_iter()
        .enumerate()
        .flat_map_iter(|(f, facet)| {
            let [a, b, c] = facet.vertices;
            [(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q), f as u32))
        })
        .collect();
    sides.par_sort_unstable();
    let mut fans = DisjointSets::new(3 * facets.len());
    let corner = |f: u32, v: u32| {
        let place = facets[f as usize].vertices.iter().position(|&u| u == v);
        3 * f + place.unwrap_or_default() as u32
    };
    for edge in sides.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
        let (a, b, first) = edge[0];
        match edge {
            [_, (_, _, second)] => [a, b].iter().for_each(|&v| fans.join(corner(first, v), corner(*second, v))),
            _ => other_edge([a, b], &mut edge.iter().map(|side| side.2)),
        }
    }
    fans
}
