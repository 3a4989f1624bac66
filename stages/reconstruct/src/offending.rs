//! The simplices behind failed checks, for a file that shows where they are: in the world, with the number of the reason on each.

use crate::check::CheckReport;
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::surface::{DataArray, Simplices};
use isoparticles_volume::Geometry;

/// Simplices gathered by reason.
pub(crate) struct Offending<'a> {
    geometry: &'a Geometry,
    mesh: &'a TriangleMesh,
    simplices: Simplices,
    /// Those of vertices, edges and triangles.
    reasons: [Vec<i64>; 3],
}

impl<'a> Offending<'a> {
    /// None yet, of a mesh in the grid frame.
    pub(crate) fn new(mesh: &'a TriangleMesh, geometry: &'a Geometry) -> Self {
        let points = mesh.vertices.iter().map(|&p| geometry.grid_to_world(p)).collect();
        let simplices = Simplices { points, ..Simplices::default() };
        Self { geometry, mesh, simplices, reasons: Default::default() }
    }

    /// Vertices of the mesh.
    pub(crate) fn vertices(&mut self, list: &[u32], reason: i64) {
        self.simplices.vertices.extend(list);
        self.reasons[0].resize(self.simplices.vertices.len(), reason);
    }

    /// A node of the grid, by its indices.
    pub(crate) fn node(&mut self, index: [usize; 3], reason: i64) {
        let index = DVec3::from_array(index.map(|n| n as f64));
        self.simplices.vertices.push(self.simplices.points.len() as u32);
        self.simplices.points.push(self.geometry.grid_to_world(self.geometry.index_to_grid(index)));
        self.reasons[0].push(reason);
    }

    /// Edges between vertices of the mesh; others are left out.
    pub(crate) fn edges(&mut self, list: &[[u32; 2]], reason: i64) {
        let is_known = |edge: &&[u32; 2]| edge.iter().all(|&v| (v as usize) < self.mesh.vertices.len());
        self.simplices.edges.extend(list.iter().filter(is_known));
        self.reasons[1].resize(self.simplices.edges.len(), reason);
    }

    /// Triangles of the mesh, by their numbers.
    pub(crate) fn triangles(&mut self, list: &[u32], reason: i64) {
        self.simplices.triangles.extend(list.iter().map(|&t| self.mesh.triangles[t as usize]));
        self.reasons[2].resize(self.simplices.triangles.len(), reason);
    }

    /// Triangles of the mesh, by pairs that cross.
    pub(crate) fn crossing(&mut self, pairs: &[[u32; 2]], reason: i64) {
        let mut list: Vec<u32> = pairs.iter().flatten().copied().collect();
        list.sort_unstable();
        list.dedup();
        self.triangles(&list, reason);
    }

    /// All of them, with the points that they use (`reason` on each); `None` when there are none.
    pub(crate) fn simplices(self) -> Option<Simplices> {
        let (mut simplices, reasons) = (self.simplices, self.reasons.concat());
        if reasons.is_empty() {
            return None;
        }
        simplices.cell_data = vec![DataArray::integers("reason", reasons)];
        Some(keep_used_points(simplices))
    }
}

/// What is behind the failed checks of a surface of one object: 1 open edge, 2 edge in more than two triangles, 3 badly oriented edge, 4 pinched vertex, 5
/// distant vertex, 6 grid node on the wrong side, 7 repeated triangle, 8 no area, 9 crossing, 10 poor shape, 11 turned against grad F.
pub(crate) fn offending(mesh: &TriangleMesh, checked: &CheckReport, geometry: &Geometry) -> Option<Simplices> {
    let found = &checked.offenders;
    let mut offending = Offending::new(mesh, geometry);
    offending.vertices(&found.non_manifold_vertices, 4);
    offending.vertices(&found.distant_vertices, 5);
    found.nodes_on_wrong_side.iter().for_each(|&node| offending.node(node, 6));
    offending.edges(&found.open_edges, 1);
    offending.edges(&found.non_manifold_edges, 2);
    offending.edges(&found.badly_oriented_edges, 3);
    offending.triangles(&found.repeated_triangles, 7);
    offending.triangles(&found.zero_area_triangles, 8);
    offending.crossing(&found.self_intersections, 9);
    offending.triangles(&found.poor_triangles, 10);
    offending.triangles(&found.turned_triangles, 11);
    offending.simplices()
}

/// Leaves out the points that no simplex uses.
fn keep_used_points(mut simplices: Simplices) -> Simplices {
    let mut number = vec![u32::MAX; simplices.points.len()];
    let mut points = Vec::new();
    let mut renumber = |v: &mut u32| {
        let n = &mut number[*v as usize];
        if *n == u32::MAX {
            *n = points.len() as u32;
            points.push(simplices.points[*v as usize]);
        }
        *v = *n;
    };
    simplices.vertices.iter_mut().for_each(&mut renumber);
    simplices.edges.iter_mut().flatten().for_each(&mut renumber);
    simplices.triangles.iter_mut().flatten().for_each(&mut renumber);
    simplices.points = points;
    simplices
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::{CheckOptions, check};
    use crate::scenes;

    #[test]
    fn a_hole_and_a_stray_vertex_are_shown_where_they_are() {
        let scene = scenes::sphere();
        let mut mesh = scenes::ball();
        let [a, b, c] = mesh.corners(0);
        mesh.triangles.remove(0);
        let options = CheckOptions { field: Some(&scene.field), ..CheckOptions::default() };
        let simplices = offending(&mesh, &check(&mesh, &options), scene.field.geometry()).unwrap();
        assert_eq!((simplices.edges.len(), simplices.points.len()), (3, 3));
        assert!(simplices.points.iter().all(|p| [a, b, c].contains(p)));
        assert_eq!(offending(&scenes::ball(), &check(&scenes::ball(), &options), scene.field.geometry()), None);
    }

    #[test]
    fn nodes_and_edges_of_other_points_have_their_places() {
        let geometry = Geometry::axis_aligned([9; 3], DVec3::splat(2.0));
        let mesh = scenes::ball();
        let mut offending = Offending::new(&mesh, &geometry);
        offending.node([1, 2, 3], 6);
        offending.edges(&[[0, 1], [0, u32::MAX]], 12);
        let simplices = offending.simplices().unwrap();
        assert_eq!((simplices.vertices.len(), simplices.edges.len(), simplices.points.len()), (1, 1, 3));
        assert!(simplices.points.contains(&DVec3::new(2.0, 4.0, 6.0)));
    }
}
