//! Where a restricted surface is not yet that of F: edges and vertices that are not manifold, facets that join
//! different components of the isosurface, or stray from it, and components that are missing or of the wrong genus.

use crate::isosurface::Isosurface;
use crate::restricted::Facet;
use isoparticles_common::components::{self, DisjointSets, NO_COMPONENT};
use isoparticles_common::mesh::incidence::Incidence;
use rayon::prelude::*;

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

impl Defects {
    /// Looks for defects; `component_of` gives the component of the isosurface of each vertex ([`NO_COMPONENT`] unknown).
    /// `open_edges_allowed` tells which edges may be in one facet only (open borders).
    pub fn find(
        facets: &[Facet],
        component_of: &[u32],
        isosurface: &Isosurface,
        open_edge_allowed: impl Fn(u32, u32) -> bool,
    ) -> Self {
        let vertex_count = component_of.len();
        let mut defects = Self::default();
        let triangles: Vec<[u32; 3]> = facets.iter().map(|f| f.vertices).collect();
        let incidence = Incidence::new(&triangles, vertex_count);
        let mut fans = incidence.fans(|[a, b], around| {
            if around.len() != 1 || !open_edge_allowed(a, b) {
                defects.edges.push(around);
            }
        });
        defects.find_pinched_vertices(facets, vertex_count, &mut fans);
        defects.compare(&triangles, &incidence, component_of, isosurface);
        defects
    }

    fn find_pinched_vertices(&mut self, facets: &[Facet], vertex_count: usize, fans: &mut DisjointSets) {
        let mut fan_of = vec![u32::MAX; vertex_count];
        let mut pinched = Vec::new();
        for (f, facet) in facets.iter().enumerate() {
            for (k, &v) in facet.vertices.iter().enumerate() {
                let fan = fans.find((3 * f + k) as u32);
                let known = &mut fan_of[v as usize];
                if *known == u32::MAX {
                    *known = fan;
                } else if *known != fan {
                    pinched.push(v);
                }
            }
        }
        pinched.sort_unstable();
        pinched.dedup();
        self.vertices = pinched.iter().map(|&v| (v, Vec::new())).collect();
        if pinched.is_empty() {
            return;
        }
        for (f, facet) in facets.iter().enumerate() {
            for v in facet.vertices {
                if let Ok(at) = pinched.binary_search(&v) {
                    self.vertices[at].1.push(f as u32);
                }
            }
        }
    }

    fn compare(
        &mut self,
        triangles: &[[u32; 3]],
        incidence: &Incidence,
        component_of: &[u32],
        isosurface: &Isosurface,
    ) {
        let expected = isosurface.class_bound();
        let (own, own_count) = components::of_vertices(component_of.len(), triangles);
        self.component_count = own_count;
        // a vertex of unknown component counts for nothing; where a whole facet is unknown, its piece tells
        let mut class_of_piece = vec![NO_COMPONENT; own_count];
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
        let mut pieces: Vec<Vec<u32>> = vec![Vec::new(); expected + 1];
        for (f, t) in triangles.iter().enumerate() {
            let class = class_of[f];
            if class == expected as u32 && t.iter().any(|&v| component_of[v as usize] != NO_COMPONENT) {
                self.bridges.push(f as u32);
            }
            let piece = own[t[0] as usize];
            let pieces = &mut pieces[class as usize];
            if !pieces.contains(&piece) {
                pieces.push(piece);
            }
        }
        self.piece_of_vertex = own;
        for c in isosurface.classes() {
            let pieces = pieces[c as usize].len();
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
