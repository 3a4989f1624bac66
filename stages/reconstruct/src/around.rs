//! The tetrahedra around an edge or a vertex, grouped by label, and the facets between labels. A
//! label (`side` in this module) is inside or outside, or one of many materials. At a facet between
//! two labels, the greater label is inside.

use isoparticles_delaunay::Delaunay;
use isoparticles_mesh::components::DisjointSets;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashSet};

/// A facet between two labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facet {
    /// Vertices, counter-clockwise as seen from outside, the side of the smaller label.
    pub vertices: [u32; 3],
    /// The tetrahedron inside, with the greater label.
    pub tetrahedron: u32,
    /// Index of the facet in this tetrahedron: that of the opposite vertex.
    pub opposite: u8,
}

impl Facet {
    /// Returns the vertices in ascending order.
    pub fn sorted(&self) -> [u32; 3] {
        let mut vertices = self.vertices;
        vertices.sort_unstable();
        vertices
    }
}

/// Returns the index of a vertex or neighbour in a list of four. The list must contain it.
pub(crate) fn place_of(list: [u32; 4], what: u32) -> usize {
    list.iter().position(|&other| other == what).unwrap_or(0)
}

/// Returns the facets of a tetrahedron at which its label differs from that of the neighbour. Each
/// belongs to the tetrahedron with the greater label, which may be the neighbour.
pub(crate) fn boundary_facets_of<S: Ord>(delaunay: &Delaunay, t: u32, side: impl Fn(u32) -> S) -> Vec<Facet> {
    let neighbours = delaunay.neighbours(t);
    let facet = |i: usize| {
        let n = neighbours[i];
        let (t, i) = if side(t) > side(n) { (t, i) } else { (n, place_of(delaunay.neighbours(n), t)) };
        Facet { vertices: delaunay.facet(t, i), tetrahedron: t, opposite: i as u8 }
    };
    (0..4).filter(|&i| side(t) != side(neighbours[i])).map(facet).collect()
}

/// Returns the facets between labels, in the order of the tetrahedra with the greater label.
pub(crate) fn boundary<S: Ord + Default>(delaunay: &Delaunay, side: impl Fn(u32) -> S + Sync) -> Vec<Facet> {
    let side = &side;
    (0..delaunay.slot_count() as u32)
        .into_par_iter()
        .filter(|&t| delaunay.is_alive(t) && side(t) > S::default())
        .flat_map_iter(|t| boundary_facets_of(delaunay, t, side).into_iter().filter(move |f| f.tetrahedron == t))
        .collect()
}

/// Returns the runs of tetrahedra with the same label around an edge. `start` is one of the
/// tetrahedra. An edge of a manifold surface has two runs.
pub(crate) fn runs_round<S: PartialEq>(
    delaunay: &Delaunay,
    [a, b]: [u32; 2],
    start: u32,
    side: impl Fn(u32) -> S,
) -> Vec<Vec<u32>> {
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
        // the next tetrahedron, across the facet opposite vertex `behind`, contains vertex `ahead`
        behind = ahead;
    }
    let turns = |k: &usize| side(ring[*k]) != side(ring[(k + ring.len() - 1) % ring.len()]);
    let first = (0..ring.len()).find(turns).unwrap_or(0);
    ring.rotate_left(first);
    ring.chunk_by(|&s, &t| side(s) == side(t)).map(<[u32]>::to_vec).collect()
}

/// Returns the tetrahedra at a vertex, ascending.
pub(crate) fn star(delaunay: &Delaunay, vertex: u32) -> Vec<u32> {
    let mut star: Vec<u32> = delaunay.incident(vertex).into_iter().collect();
    let mut seen: HashSet<u32> = star.iter().copied().collect();
    let mut next = 0;
    while next < star.len() {
        let (vertices, neighbours) = (delaunay.vertices(star[next]), delaunay.neighbours(star[next]));
        for (opposite, n) in vertices.into_iter().zip(neighbours) {
            if opposite != vertex && seen.insert(n) {
                star.push(n);
            }
        }
        next += 1;
    }
    star.sort_unstable();
    star
}

/// Returns the parts of the star of a vertex: tetrahedra with the same label that are connected
/// through facets at the vertex. `star` is ascending. A vertex of a manifold surface has two parts.
pub(crate) fn parts_round<S: PartialEq>(
    delaunay: &Delaunay,
    vertex: u32,
    star: &[u32],
    side: impl Fn(u32) -> S,
) -> Vec<Vec<u32>> {
    let mut sets = DisjointSets::new(star.len());
    for (k, &t) in star.iter().enumerate() {
        let at = place_of(delaunay.vertices(t), vertex);
        for (j, n) in delaunay.neighbours(t).into_iter().enumerate() {
            if j != at && n < t && side(n) == side(t) {
                sets.join(k as u32, star.binary_search(&n).unwrap_or(k) as u32);
            }
        }
    }
    let mut parts: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (k, &t) in star.iter().enumerate() {
        parts.entry(sets.find(k as u32)).or_default().push(t);
    }
    parts.into_values().collect()
}
