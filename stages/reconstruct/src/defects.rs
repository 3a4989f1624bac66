//! Where a restricted surface is not yet that of F: edges and vertices that are not manifold, facets that join
//! different components of the isosurface, or stray from it, and components that are missing or of the wrong genus.

use crate::isosurface::Isosurface;
use crate::restricted::Facet;
use isoparticles_mesh::components::{self, NO_COMPONENT};
use isoparticles_mesh::incidence::{FanWork, Incidence};
use rayon::prelude::*;

/// Vertices looked at by one thread at a time.
const CHUNK: usize = 1 << 12;

/// Topology of a set of facets against the isosurface.
#[derive(Clone, Debug, Default)]
pub struct Defects {
    /// For each edge that is not in exactly two facets, its facets (numbers in the list given).
    pub edges: Vec<Vec<u32>>,
    /// For each vertex with more than one fan of facets, the vertex and its facets.
    pub vertices: Vec<(u32, Vec<u32>)>,
    /// Facets whose vertices lie on different components of the isosurface.
    pub bridges: Vec<u32>,
    /// Components of the isosurface that have no facet.
    pub missing: Vec<u32>,
    /// Components of the isosurface whose facets fall apart, and into how many pieces.
    pub in_pieces: Vec<(u32, usize)>,
    /// Components of the isosurface that were thought to be several, and the fewer pieces that their facets form by now.
    pub rejoined: Vec<(u32, usize)>,
    /// Components of the isosurface whose facets have another Euler characteristic, and that of the facets.
    pub wrong_genus: Vec<(u32, i64)>,
    /// Components of the facets.
    pub component_count: usize,
    /// Component of each vertex among the facets; [`NO_COMPONENT`] for vertices of no facet.
    pub piece_of_vertex: Vec<u32>,
}

/// Where a surface is not manifold.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pinches {
    /// For each edge that is not in exactly two facets, its facets (numbers in the list given).
    pub edges: Vec<Vec<u32>>,
    /// For each vertex with more than one fan of facets, the vertex and its facets.
    pub vertices: Vec<(u32, Vec<u32>)>,
}

impl Pinches {
    /// Those at the first `count` vertices; an edge counts with the first of its ends. `open_edge_allowed` tells which edges may be in one
    /// facet only (open borders).
    pub fn at_first(count: usize, incidence: &Incidence, open_edge_allowed: impl Fn(u32, u32) -> bool + Sync) -> Self {
        let chunks: Vec<Self> = (0..count)
            .into_par_iter()
            .step_by(CHUNK)
            .map(|first| {
                let mut found = Self::default();
                let mut work = FanWork::default();
                for v in first as u32..(first + CHUNK).min(count) as u32 {
                    let fans = incidence.fans_at(v, &mut work, |other, around| {
                        let around: Vec<u32> = around.collect();
                        if other > v && (around.len() != 1 || !open_edge_allowed(v, other)) {
                            found.edges.push(around);
                        }
                    });
                    if fans > 1 {
                        found.vertices.push((v, incidence.of(v).to_vec()));
                    }
                }
                found
            })
            .collect();
        let mut all = Self::default();
        for chunk in chunks {
            all.edges.extend(chunk.edges);
            all.vertices.extend(chunk.vertices);
        }
        all
    }
}

/// The edge that facets, given by their numbers in a list, have in common; `None` for fewer than two.
pub fn edge_of(facets: &[Facet], around: &[u32]) -> Option<[u32; 2]> {
    let in_all = |v: &u32| around.iter().all(|&f| facets[f as usize].vertices.contains(v));
    let mut shared = facets[*around.first()? as usize].vertices.into_iter().filter(in_all);
    let edge = [shared.next()?, shared.next()?];
    shared.next().is_none().then_some(edge)
}

impl Defects {
    /// Looks for defects; `component_of` gives the component of the isosurface of each vertex ([`NO_COMPONENT`] unknown).
    /// `open_edge_allowed` tells which edges may be in one facet only (open borders).
    pub fn find(
        facets: &[Facet],
        component_of: &[u32],
        isosurface: &Isosurface,
        open_edge_allowed: impl Fn(u32, u32) -> bool + Sync,
    ) -> Self {
        let triangles: Vec<[u32; 3]> = facets.iter().map(|f| f.vertices).collect();
        let incidence = Incidence::new(&triangles, component_of.len());
        let mut defects = Self::of_shape(&incidence, open_edge_allowed);
        defects.compare(&incidence, component_of, isosurface);
        defects
    }

    /// The defects that do not depend on the isosurface, and the components of the facets.
    pub fn of_shape(incidence: &Incidence, open_edge_allowed: impl Fn(u32, u32) -> bool + Sync) -> Self {
        let Pinches { edges, vertices } = Pinches::at_first(incidence.vertex_count(), incidence, open_edge_allowed);
        let (piece_of_vertex, component_count) =
            components::of_vertices(incidence.vertex_count(), incidence.triangles());
        Self { edges, vertices, component_count, piece_of_vertex, ..Self::default() }
    }

    /// Compares the facets, of which the rest is known already, with the isosurface; what an earlier comparison found goes.
    pub fn compare(&mut self, incidence: &Incidence, component_of: &[u32], isosurface: &Isosurface) {
        let triangles = incidence.triangles();
        let expected = isosurface.class_bound();
        let own = &self.piece_of_vertex;
        // a vertex of unknown component counts for nothing; where a whole facet is unknown, its piece tells
        let mut class_of_piece = vec![NO_COMPONENT; self.component_count];
        for t in triangles {
            let piece = &mut class_of_piece[own[t[0] as usize] as usize];
            *piece = t.iter().map(|&v| component_of[v as usize]).fold(*piece, u32::min);
        }
        // the class of a facet, or one past the last for bridges and strangers
        let class = |t: &[u32; 3]| {
            let mut known = t.iter().map(|&v| component_of[v as usize]).filter(|&c| c != NO_COMPONENT);
            let first = known.next().unwrap_or(class_of_piece[own[t[0] as usize] as usize]);
            if known.any(|c| c != first) { expected as u32 } else { first.min(expected as u32) }
        };
        let class_of: Vec<u32> = triangles.par_iter().map(class).collect();
        let euler = incidence.euler_characteristics(&class_of, expected + 1);
        let is_bridge = |(f, t): (usize, &[u32; 3])| {
            let is_known = |v: &u32| component_of[*v as usize] != NO_COMPONENT;
            (class_of[f] == expected as u32 && t.iter().any(is_known)).then_some(f as u32)
        };
        self.bridges = triangles.par_iter().enumerate().filter_map(is_bridge).collect();
        let pieces = pieces_by_class(&class_of, triangles, own, expected);
        self.missing.clear();
        self.in_pieces.clear();
        self.rejoined.clear();
        self.wrong_genus.clear();
        for c in isosurface.classes() {
            let pieces = pieces[c as usize];
            if pieces == 0 {
                self.missing.push(c);
            } else if pieces > isosurface.pieces(c) {
                self.in_pieces.push((c, pieces));
            } else if pieces < isosurface.pieces(c) {
                self.rejoined.push((c, pieces));
            } else if euler[c as usize] != isosurface.euler(c) {
                self.wrong_genus.push((c, euler[c as usize]));
            }
        }
    }

    /// Whether the surface is a closed manifold.
    pub fn is_manifold(&self) -> bool {
        self.edges.is_empty() && self.vertices.is_empty()
    }

    /// Whether the surface is a closed manifold with the topology of the isosurface.
    pub fn is_empty(&self) -> bool {
        let same_components = self.bridges.is_empty() && self.missing.is_empty() && self.in_pieces.is_empty();
        self.is_manifold() && same_components && self.wrong_genus.is_empty()
    }
}

/// Into how many pieces the triangles of each class fall apart.
fn pieces_by_class(class_of: &[u32], triangles: &[[u32; 3]], piece_of_vertex: &[u32], classes: usize) -> Vec<usize> {
    let piece = |t: &[u32; 3]| piece_of_vertex[t[0] as usize];
    let mut met: Vec<(u32, u32)> = class_of.par_iter().zip(triangles).map(|(&class, t)| (class, piece(t))).collect();
    // most neighbours in the list are of one class and piece
    met.dedup();
    met.par_sort_unstable();
    met.dedup();
    let mut pieces = vec![0; classes + 1];
    met.into_iter().for_each(|(class, _)| pieces[class as usize] += 1);
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;

    fn facets(triangles: &[[u32; 3]]) -> Vec<Facet> {
        triangles.iter().map(|&vertices| Facet { vertices, tetrahedron: 0, opposite: 0 }).collect()
    }

    const TETRAHEDRON: [[u32; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

    #[test]
    fn a_pinch_at_a_vertex_and_at_an_edge_are_found() {
        let one = Isosurface::new(&scenes::sphere().image);
        let find =
            |triangles: &[[u32; 3]], n: usize| Defects::find(&facets(triangles), &vec![0; n], &one, |_, _| false);
        assert!(find(&TETRAHEDRON, 4).is_empty());
        // a second tetrahedron that shares vertex 3
        let touching = TETRAHEDRON.map(|t| t.map(|v| v + 3));
        let pinched = find(&[TETRAHEDRON, touching].concat(), 7);
        assert_eq!(pinched.vertices.len(), 1);
        assert_eq!((pinched.vertices[0].0, pinched.vertices[0].1.len()), (3, 6));
        assert!(pinched.edges.is_empty());
        // a second tetrahedron that shares the edge 2-3
        let hinged = TETRAHEDRON.map(|t| t.map(|v| v + 2));
        let hinged = find(&[TETRAHEDRON, hinged].concat(), 6);
        assert_eq!(hinged.edges.len(), 1);
        assert_eq!(hinged.edges[0].len(), 4);
        let open = find(&TETRAHEDRON[1..], 4);
        assert_eq!(open.edges.len(), 3);
    }

    #[test]
    fn bridges_and_missing_components_are_found() {
        let two = Isosurface::new(&scenes::two_balls().image);
        let lost = Defects::find(&facets(&TETRAHEDRON), &[0; 4], &two, |_, _| false);
        assert_eq!(lost.missing, [1]);
        let merged = Defects::find(&facets(&TETRAHEDRON), &[0, 0, 0, 1], &two, |_, _| false);
        assert_eq!(merged.bridges.len(), 3);
    }
}
