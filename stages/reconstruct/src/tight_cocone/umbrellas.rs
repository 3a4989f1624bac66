//! Umbrellas: candidate triangles at a vertex that separate its two poles, and the side of each
//! tetrahedron at the vertex.
//!
//! The tetrahedra at a vertex are connected across facets that are not candidates. The candidates
//! around the region of a pole are the umbrella that a walk on this side would find. Candidates
//! that separate nothing, such as those at sharp edges, have no effect. The paper prunes them one
//! by one.

use super::cells::{Cells, NOBODY};
use crate::around::place_of;
use isoparticles_delaunay::INFINITE;
use isoparticles_mesh::components::DisjointSets;
use rayon::prelude::*;

/// Sides of the tetrahedra at each vertex with an umbrella.
pub(super) struct Umbrellas {
    /// For each tetrahedron of each star: 1 on the side of the normal, -1 on the other side, 0
    /// between candidates or without an umbrella.
    sides: Vec<i8>,
    /// Whether each vertex has an umbrella.
    pub(super) is_good: Vec<bool>,
}

impl Umbrellas {
    pub(super) fn new(cells: &Cells) -> Self {
        let count = cells.stars.vertex_count();
        const BLOCK: usize = 2048;
        let blocks: Vec<(Vec<i8>, Vec<bool>)> = (0..count.div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let (mut sides, mut is_good) = (Vec::new(), Vec::with_capacity(BLOCK));
                for v in block * BLOCK..count.min((block + 1) * BLOCK) {
                    is_good.push(part_star(cells, v as u32, &mut sides));
                }
                (sides, is_good)
            })
            .collect();
        let (sides, is_good): (Vec<Vec<i8>>, Vec<Vec<bool>>) = blocks.into_iter().unzip();
        Self { sides: sides.concat(), is_good: is_good.concat() }
    }

    /// Returns the side of a tetrahedron with respect to one of its vertices.
    pub(super) fn side(&self, cells: &Cells, vertex: u32, tetrahedron: u32) -> i8 {
        let at = cells.stars.of(vertex).binary_search(&tetrahedron);
        at.map_or(0, |at| self.sides[cells.stars.range(vertex).start + at])
    }

    /// Returns the tetrahedra at a vertex with their sides.
    pub(super) fn star<'a>(&'a self, cells: &'a Cells, vertex: u32) -> impl Iterator<Item = (u32, i8)> + 'a {
        cells.stars.of(vertex).iter().copied().zip(self.sides[cells.stars.range(vertex)].iter().copied())
    }
}

/// Appends the sides of the tetrahedra at a vertex. Returns whether candidates separate its poles.
fn part_star(cells: &Cells, v: u32, sides: &mut Vec<i8>) -> bool {
    let star = cells.stars.of(v);
    let poles = cells.poles[v as usize];
    let start = sides.len();
    sides.resize(start + star.len(), 0);
    if poles.contains(&NOBODY) || !cells.is_flat[v as usize] {
        return false;
    }
    let local = |t: u32| star.binary_search(&t).unwrap_or(0) as u32;
    let mut regions = DisjointSets::new(star.len());
    for (k, &t) in star.iter().enumerate() {
        let neighbours = cells.delaunay.neighbours(t);
        let at = place_of(cells.delaunay.vertices(t), v);
        for j in (0..4).filter(|&j| j != at && neighbours[j] > t && !cells.is_candidate(t, j)) {
            regions.join(k as u32, local(neighbours[j]));
        }
    }
    let [above, below] = poles.map(|t| regions.find(local(t)));
    if above == below {
        return false;
    }
    for (k, side) in sides[start..].iter_mut().enumerate() {
        let region = regions.find(k as u32);
        *side = i8::from(region == above) - i8::from(region == below);
    }
    true
}

/// Returns the vertices of a tetrahedron that have an umbrella.
pub(super) fn good_vertices(cells: &Cells, umbrellas: &Umbrellas, t: u32) -> impl Iterator<Item = u32> {
    let vertices = cells.delaunay.vertices(t);
    vertices.map(|v| (v != INFINITE && umbrellas.is_good[v as usize]).then_some(v)).into_iter().flatten()
}
