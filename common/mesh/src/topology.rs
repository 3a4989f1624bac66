//! Topology of a triangle mesh. Checks whether every edge lies in exactly two triangles that
//! traverse it in opposite directions, and whether every vertex has one fan of triangles. Finds the
//! components, Euler characteristics and genus, and lists the vertices, edges and triangles that
//! violate a condition.

use super::TriangleMesh;
use crate::components::{self, DisjointSets, NO_COMPONENT};
use rayon::prelude::*;
use serde::Serialize;

/// Topology of one connected component.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ComponentTopology {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of edges.
    pub edges: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Euler characteristic: vertices - edges + triangles.
    pub euler: i64,
    /// Number of handles; `None` unless the component is a closed, oriented manifold.
    pub genus: Option<i64>,
}

/// Topology of a mesh. An edge is a pair of vertices, with the lower index first. All lists are in
/// ascending order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Topology {
    /// Number of different edges.
    pub edges: usize,
    /// Edges that lie in only one triangle.
    pub open_edges: Vec<[u32; 2]>,
    /// Edges that lie in more than two triangles.
    pub non_manifold_edges: Vec<[u32; 2]>,
    /// Edges whose two triangles traverse them in the same direction.
    pub badly_oriented_edges: Vec<[u32; 2]>,
    /// Vertices whose triangles form more than one fan.
    pub non_manifold_vertices: Vec<u32>,
    /// Vertices that belong to no triangle.
    pub unused_vertices: Vec<u32>,
    /// Triangles with a repeated vertex.
    pub collapsed_triangles: Vec<u32>,
    /// Triangles with the same three vertices as an earlier triangle.
    pub duplicate_triangles: Vec<u32>,
    /// Component of each vertex. Components are numbered in the order of their lowest vertices.
    /// [`NO_COMPONENT`] for an unused vertex.
    pub component_of_vertex: Vec<u32>,
    /// Component of each triangle.
    pub component_of_triangle: Vec<u32>,
    /// The components.
    pub components: Vec<ComponentTopology>,
    /// Euler characteristic of the whole mesh: used vertices - edges + triangles.
    pub euler: i64,
}

impl Topology {
    /// Returns whether every edge lies in exactly two triangles that traverse it in opposite
    /// directions.
    pub fn is_watertight(&self) -> bool {
        self.open_edges.is_empty() && self.non_manifold_edges.is_empty() && self.badly_oriented_edges.is_empty()
    }

    /// Returns whether the mesh is watertight, has one fan at every vertex, and has no duplicate or
    /// collapsed triangles.
    pub fn is_closed_manifold(&self) -> bool {
        self.is_watertight()
            && self.non_manifold_vertices.is_empty()
            && self.collapsed_triangles.is_empty()
            && self.duplicate_triangles.is_empty()
    }
}

/// Analyses a mesh, which must be well-formed ([`TriangleMesh::is_well_formed`]).
pub fn analyse(mesh: &TriangleMesh) -> Topology {
    let mut topology = Topology { duplicate_triangles: duplicate_triangles(mesh), ..Topology::default() };
    for (t, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        if a == b || b == c || c == a {
            topology.collapsed_triangles.push(t as u32);
        }
    }
    find_components(mesh, &mut topology);
    let mut faulty = vec![false; topology.components.len()];
    let fans = examine_edges(mesh, &mut topology, &mut faulty);
    examine_vertices(mesh, fans, &mut topology, &mut faulty);
    for (component, faulty) in topology.components.iter_mut().zip(faulty) {
        component.euler = component.vertices as i64 - component.edges as i64 + component.triangles as i64;
        component.genus = (!faulty).then_some((2 - component.euler) / 2);
        topology.euler += component.euler;
    }
    topology
}

/// Counts the edges, and lists the edges that violate a condition. Marks the components of these
/// edges in `faulty`. Returns disjoint sets of triangle corners: two corners at a vertex are in the
/// same set if a chain of triangles that share edges at the vertex connects them.
fn examine_edges(mesh: &TriangleMesh, topology: &mut Topology, faulty: &mut [bool]) -> DisjointSets {
    let mut fans = DisjointSets::new(3 * mesh.triangles.len());
    for group in sorted_sides(mesh).chunk_by(|a, b| a.key == b.key) {
        let key = group[0].key;
        let edge = [(key >> 32) as u32, key as u32];
        let component = topology.component_of_vertex[edge[0] as usize] as usize;
        topology.edges += 1;
        topology.components[component].edges += 1;
        let forward = group.iter().filter(|s| s.forward).count();
        let fault = match group.len() {
            1 => Some(&mut topology.open_edges),
            2 if forward != 1 => Some(&mut topology.badly_oriented_edges),
            2 => None,
            _ => Some(&mut topology.non_manifold_edges),
        };
        if let Some(list) = fault {
            list.push(edge);
            faulty[component] = true;
        }
        for pair in group.windows(2) {
            for vertex in edge {
                fans.join(corner_of(mesh, pair[0].triangle, vertex), corner_of(mesh, pair[1].triangle, vertex));
            }
        }
    }
    fans
}

/// Lists the vertices without triangles and the vertices with more than one fan. Marks the
/// components with more than one fan at a vertex in `faulty`. Each set of corners at a vertex is
/// one fan.
fn examine_vertices(mesh: &TriangleMesh, mut fans: DisjointSets, topology: &mut Topology, faulty: &mut [bool]) {
    let mut fan_count = vec![0u32; mesh.vertices.len()];
    for corner in 0..3 * mesh.triangles.len() as u32 {
        let vertex = mesh.triangles[corner as usize / 3][corner as usize % 3];
        // if a triangle contains a vertex twice, only the first of the two corners is counted
        if fans.find(corner) == corner && corner_of(mesh, corner / 3, vertex) == corner {
            fan_count[vertex as usize] += 1;
        }
    }
    for (v, &count) in fan_count.iter().enumerate() {
        match count {
            0 => topology.unused_vertices.push(v as u32),
            1 => {}
            _ => {
                topology.non_manifold_vertices.push(v as u32);
                faulty[topology.component_of_vertex[v] as usize] = true;
            }
        }
    }
}

/// A side of a triangle, with a sort key that identifies the edge.
struct Side {
    key: u64,
    triangle: u32,
    forward: bool,
}

fn sorted_sides(mesh: &TriangleMesh) -> Vec<Side> {
    let mut sides: Vec<Side> = mesh
        .triangles
        .par_iter()
        .enumerate()
        .flat_map_iter(|(t, &[a, b, c])| {
            [(a, b), (b, c), (c, a)].map(|(from, to)| Side {
                key: u64::from(from.min(to)) << 32 | u64::from(from.max(to)),
                triangle: t as u32,
                forward: from < to,
            })
        })
        .collect();
    sides.par_sort_unstable_by_key(|s| (s.key, s.triangle, s.forward));
    sides
}

/// Returns the corner number (3 * triangle + corner index) of the first occurrence of a vertex in a
/// triangle.
fn corner_of(mesh: &TriangleMesh, triangle: u32, vertex: u32) -> u32 {
    let corners = mesh.triangles[triangle as usize];
    3 * triangle + u32::from(corners[0] != vertex) * (1 + u32::from(corners[1] != vertex))
}

/// Returns the triangles with the same three vertices as an earlier triangle, ascending.
pub fn duplicate_triangles(mesh: &TriangleMesh) -> Vec<u32> {
    let mut keys: Vec<([u32; 3], u32)> = mesh
        .triangles
        .par_iter()
        .enumerate()
        .map(|(t, corners)| {
            let mut key = *corners;
            key.sort_unstable();
            (key, t as u32)
        })
        .collect();
    keys.par_sort_unstable();
    let mut found: Vec<u32> = keys.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1).collect();
    found.sort_unstable();
    found
}

fn find_components(mesh: &TriangleMesh, topology: &mut Topology) {
    let (component_of_vertex, count) = components::of_vertices(mesh.vertices.len(), &mesh.triangles);
    topology.components = vec![ComponentTopology::default(); count];
    for &component in component_of_vertex.iter().filter(|&&c| c != NO_COMPONENT) {
        topology.components[component as usize].vertices += 1;
    }
    topology.component_of_vertex = component_of_vertex;
    topology.component_of_triangle =
        mesh.triangles.iter().map(|t| topology.component_of_vertex[t[0] as usize]).collect();
    for &component in &topology.component_of_triangle {
        topology.components[component as usize].triangles += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use super::*;
    use glam::DVec3;

    #[test]
    fn sphere_torus_and_box_have_their_genus() {
        for (mesh, genus) in [
            (shapes::icosphere(1.0, 3), 0),
            (shapes::torus(3.0, 1.0, 24, 12), 1),
            (shapes::cuboid(DVec3::new(1.0, 2.0, 3.0)), 0),
        ] {
            let topology = analyse(&mesh);
            assert!(topology.is_closed_manifold());
            assert_eq!(topology.components.len(), 1);
            assert_eq!(topology.components[0].genus, Some(genus));
            assert_eq!(topology.euler, 2 - 2 * genus);
            assert_eq!(2 * topology.edges, 3 * mesh.triangles.len());
            assert!(topology.unused_vertices.is_empty());
        }
    }

    #[test]
    fn components_are_counted_one_by_one() {
        let mut mesh = shapes::union(&[shapes::torus(3.0, 1.0, 12, 8), shapes::icosphere(1.0, 1)]);
        mesh.vertices.push(DVec3::ZERO);
        let topology = analyse(&mesh);
        assert_eq!(topology.components.len(), 2);
        assert_eq!(topology.components.iter().map(|c| c.genus).collect::<Vec<_>>(), [Some(1), Some(0)]);
        assert_eq!(topology.components[1].vertices, 42);
        assert_eq!(topology.unused_vertices, [96 + 42]);
        assert_eq!(topology.component_of_vertex[138], NO_COMPONENT);
        assert!(topology.component_of_triangle.iter().take(192).all(|&c| c == 0));
    }

    #[test]
    fn an_open_edge_is_named() {
        let mut mesh = shapes::cuboid(DVec3::ONE);
        let gone = mesh.triangles.pop().unwrap_or_default();
        let topology = analyse(&mesh);
        let mut expected: Vec<[u32; 2]> =
            (0..3).map(|e| [gone[e], gone[(e + 1) % 3]]).map(|[a, b]| [a.min(b), a.max(b)]).collect();
        expected.sort_unstable();
        assert_eq!(topology.open_edges, expected);
        assert!(!topology.is_watertight());
        assert_eq!(topology.components[0].genus, None);
    }

    #[test]
    fn a_turned_triangle_has_three_badly_oriented_edges() {
        let mut mesh = shapes::icosphere(1.0, 1);
        mesh.triangles[7].swap(0, 1);
        let topology = analyse(&mesh);
        assert_eq!(topology.badly_oriented_edges.len(), 3);
        assert!(topology.badly_oriented_edges.iter().flatten().all(|v| mesh.triangles[7].contains(v)));
        assert!(topology.open_edges.is_empty() && topology.non_manifold_edges.is_empty());
    }

    #[test]
    fn a_bow_tie_vertex_is_found() {
        let mut mesh = shapes::union(&[shapes::icosphere(1.0, 0), shapes::icosphere(1.0, 0)]);
        for p in &mut mesh.vertices[12..] {
            p.x += 5.0;
        }
        for t in &mut mesh.triangles[20..] {
            for v in t {
                if *v == 12 {
                    *v = 3;
                }
            }
        }
        let topology = analyse(&mesh);
        assert_eq!(topology.non_manifold_vertices, [3]);
        assert_eq!(topology.unused_vertices, [12]);
        assert!(topology.is_watertight() && !topology.is_closed_manifold());
        assert_eq!(topology.components.len(), 1);
        assert_eq!(topology.components[0].genus, None);
    }

    #[test]
    fn three_triangles_on_an_edge_and_duplicates_are_found() {
        let mut mesh = shapes::cuboid(DVec3::ONE);
        let again = mesh.triangles[4];
        mesh.triangles.push([again[1], again[2], again[0]]);
        let topology = analyse(&mesh);
        assert_eq!(topology.non_manifold_edges.len(), 3);
        assert_eq!(topology.duplicate_triangles, [12]);
        mesh.triangles[12] = [1, 1, 2];
        assert_eq!(analyse(&mesh).collapsed_triangles, [12]);
    }
}
