//! Finds the defects of a surface compared with F. Defects are edges and vertices that are not
//! manifold, facets that join components of F = 0, and components that are missing, in several
//! pieces, or of another genus.

use crate::restricted::Facet;
use isoparticles_field::topology::{FieldTopology, Group};
use isoparticles_mesh::components::{self, NO_COMPONENT};
use isoparticles_mesh::incidence::{FanWork, Incidence};
use rayon::prelude::*;
use serde::Serialize;

/// Number of vertices per parallel task.
const CHUNK: usize = 1 << 12;

/// Defects of a set of facets, and its topology compared with that of F.
#[derive(Clone, Debug, Default)]
pub struct Defects {
    /// For each edge that is not in exactly two facets, the indices of its facets in the given
    /// list. Open edges at an open border are excluded.
    pub edges: Vec<Vec<u32>>,
    /// For each vertex with more than one fan of facets, the vertex and the indices of its facets.
    pub vertices: Vec<(u32, Vec<u32>)>,
    /// Indices of facets whose vertices lie on different components of F = 0 that no undecided
    /// place can join.
    pub bridges: Vec<u32>,
    /// Components of F = 0 without facets, except those that undecided places allow to be missing.
    pub missing: Vec<u32>,
    /// Groups with more pieces than undecided places allow.
    pub in_pieces: Vec<Found>,
    /// Groups with fewer pieces, or another Euler characteristic, than undecided places allow.
    /// Groups with missing components are excluded.
    pub wrong_genus: Vec<Found>,
    /// Euler characteristic of all facets.
    pub euler: i64,
    /// Number of pieces that are near no component of F = 0.
    pub strangers: usize,
    /// Number of pieces: connected components of the facets.
    pub component_count: usize,
    /// Piece of each vertex, or [`NO_COMPONENT`] for vertices without facets.
    piece_of_vertex: Vec<u32>,
}

/// Topology of the facets of a group of components.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Found {
    /// Number of the group.
    pub group: u32,
    /// Number of pieces of its facets.
    pub components: usize,
    /// Euler characteristic of its facets.
    pub euler: i64,
}

impl Found {
    /// Returns whether F may have this topology in the group.
    pub fn fits(&self, group: &Group) -> bool {
        group.may_be(self.components, self.euler)
    }
}

/// Edges and vertices at which a surface is not manifold.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pinches {
    /// For each edge that is not in exactly two facets, the indices of its facets in the given
    /// list. Open edges at an open border are excluded.
    pub edges: Vec<Vec<u32>>,
    /// For each vertex with more than one fan of facets, the vertex and the indices of its facets.
    pub vertices: Vec<(u32, Vec<u32>)>,
}

impl Pinches {
    /// Finds the pinches at the first `count` vertices. An edge belongs to its lower end.
    /// `open_edge_allowed` returns whether an edge may be in a single facet (open borders).
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

/// Returns the edge that is common to facets, which are given by their indices in a list. Returns
/// `None` if there are fewer than two facets or they do not share exactly two vertices.
pub fn edge_of(facets: &[Facet], around: &[u32]) -> Option<[u32; 2]> {
    let in_all = |v: &u32| around.iter().all(|&f| facets[f as usize].vertices.contains(v));
    let mut shared = facets[*around.first()? as usize].vertices.into_iter().filter(in_all);
    let edge = [shared.next()?, shared.next()?];
    shared.next().is_none().then_some(edge)
}

impl Defects {
    /// Finds the defects. `component_of` contains the component of F = 0 of each vertex, or
    /// [`NO_COMPONENT`] if it is unknown. `open_edge_allowed` returns whether an edge may be in a
    /// single facet (open borders).
    pub fn find(
        triangles: &[[u32; 3]],
        component_of: &[u32],
        topology: &FieldTopology,
        open_edge_allowed: impl Fn(u32, u32) -> bool + Sync,
    ) -> Self {
        let incidence = Incidence::new(triangles, component_of.len());
        let mut defects = Self::of_shape(&incidence, open_edge_allowed);
        defects.compare(&incidence, component_of, topology);
        defects
    }

    /// Finds the defects that do not depend on F, and the pieces of the facets.
    pub fn of_shape(incidence: &Incidence, open_edge_allowed: impl Fn(u32, u32) -> bool + Sync) -> Self {
        let Pinches { edges, vertices } = Pinches::at_first(incidence.vertex_count(), incidence, open_edge_allowed);
        let (piece_of_vertex, component_count) =
            components::of_vertices(incidence.vertex_count(), incidence.triangles());
        Self { edges, vertices, component_count, piece_of_vertex, ..Self::default() }
    }

    /// Compares the facets with the topology of F. Expects the result of [`Self::of_shape`].
    fn compare(&mut self, incidence: &Incidence, component_of: &[u32], topology: &FieldTopology) {
        let all = topology.groups();
        let triangles = incidence.triangles();
        let groups = all.all().len() as u32;
        let own = &self.piece_of_vertex;
        let group_of: Vec<u32> = component_of.par_iter().map(|&c| all.of(c).unwrap_or(NO_COMPONENT)).collect();
        // vertices of unknown component are ignored; the piece gives the group of a facet without
        // known vertices
        let mut group_of_piece = vec![NO_COMPONENT; self.component_count];
        let mut is_present = vec![false; topology.components().len()];
        for t in triangles {
            let piece = &mut group_of_piece[own[t[0] as usize] as usize];
            *piece = t.iter().map(|&v| group_of[v as usize]).fold(*piece, u32::min);
            for &v in t {
                is_present.get_mut(component_of[v as usize] as usize).into_iter().for_each(|present| *present = true);
            }
        }
        // the group of a facet, or `groups` for facets that join groups and for pieces near no
        // component
        let group = |t: &[u32; 3]| {
            let mut known = t.iter().map(|&v| group_of[v as usize]).filter(|&g| g != NO_COMPONENT);
            let first = known.next().unwrap_or(group_of_piece[own[t[0] as usize] as usize]);
            if known.any(|g| g != first) { groups } else { first.min(groups) }
        };
        let group_of_facet: Vec<u32> = triangles.par_iter().map(group).collect();
        let euler = incidence.euler_characteristics(&group_of_facet, groups as usize + 1);
        let is_bridge = |(f, t): (usize, &[u32; 3])| {
            let is_known = |v: &u32| group_of[*v as usize] != NO_COMPONENT;
            (group_of_facet[f] == groups && t.iter().any(is_known)).then_some(f as u32)
        };
        self.euler = incidence.euler_characteristics(&vec![0; triangles.len()], 1)[0];
        self.bridges = triangles.par_iter().enumerate().filter_map(is_bridge).collect();
        self.strangers = group_of_piece.iter().filter(|&&group| group == NO_COMPONENT).count();
        let pieces = pieces_by_group(&group_of_facet, triangles, own, groups as usize);
        for (g, group) in (0..).zip(all.all()) {
            let missing: Vec<u32> = group.components.iter().copied().filter(|&c| !is_present[c as usize]).collect();
            let found = Found { group: g, components: pieces[g as usize], euler: euler[g as usize] };
            let certain: Vec<u32> = missing.into_iter().filter(|&c| !all.may_vanish(c)).collect();
            if found.components > *group.component_count.end() {
                self.in_pieces.push(found);
            } else if certain.is_empty() && !found.fits(group) {
                self.wrong_genus.push(found);
            }
            self.missing.extend(certain);
        }
    }

    /// Returns whether the surface is manifold, and closed except at an open border.
    pub fn is_manifold(&self) -> bool {
        self.edges.is_empty() && self.vertices.is_empty()
    }

    /// Returns whether the surface is manifold ([`Self::is_manifold`]) and has the topology of F.
    /// Pieces near no component of F = 0 (`strangers`) are not considered.
    pub fn is_empty(&self) -> bool {
        let same_components = self.bridges.is_empty() && self.missing.is_empty() && self.in_pieces.is_empty();
        self.is_manifold() && same_components && self.wrong_genus.is_empty()
    }
}

/// Returns the number of pieces of each group. A piece counts in each group of its triangles.
fn pieces_by_group(group_of: &[u32], triangles: &[[u32; 3]], piece_of_vertex: &[u32], groups: usize) -> Vec<usize> {
    let piece = |t: &[u32; 3]| piece_of_vertex[t[0] as usize];
    let mut met: Vec<(u32, u32)> = group_of.par_iter().zip(triangles).map(|(&group, t)| (group, piece(t))).collect();
    // adjacent entries mostly have the same group and piece
    met.dedup();
    met.par_sort_unstable();
    met.dedup();
    let mut pieces = vec![0; groups + 1];
    met.into_iter().for_each(|(group, _)| pieces[group as usize] += 1);
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;

    const TETRAHEDRON: [[u32; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

    #[test]
    fn pinched_vertices_and_edges_are_found() {
        let one = FieldTopology::new(&scenes::sphere().field);
        let find = |triangles: &[[u32; 3]], n: usize| Defects::find(triangles, &vec![0; n], &one, |_, _| false);
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
        let two = FieldTopology::new(&scenes::two_balls().field);
        let lost = Defects::find(&TETRAHEDRON, &[0; 4], &two, |_, _| false);
        assert_eq!(lost.missing, [1]);
        let merged = Defects::find(&TETRAHEDRON, &[0, 0, 0, 1], &two, |_, _| false);
        assert_eq!(merged.bridges.len(), 3);
    }
}
