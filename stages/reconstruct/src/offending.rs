//! Collects the simplices behind the failed checks, for a file that shows their positions.

use crate::check::{CheckReport, Fault, Simplices as Faulty};
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::surface::{DataArray, Simplices};
use isoparticles_volume::Geometry;
use std::collections::BTreeSet;

/// Returns the offending simplices in world coordinates, with the number of the fault as cell data
/// `reason`; faults without a number are omitted. The mesh is in the grid frame. Returns `None` if
/// nothing remains. Edges with a vertex that is not in the mesh are omitted, and so are grid nodes,
/// unless they must keep their material.
pub(crate) fn offending(
    mesh: &TriangleMesh,
    checked: &CheckReport,
    geometry: &Geometry,
    keeps_nodes: bool,
) -> Option<Simplices> {
    let points = mesh.vertices.iter().map(|&p| geometry.grid_to_world(p)).collect();
    let mut found = Simplices { points, ..Simplices::default() };
    // for vertices, edges and triangles
    let mut reasons: [Vec<i64>; 3] = Default::default();
    let corners = |t: &u32| mesh.triangles[*t as usize];
    let is_shown = |fault: Fault| fault.described().0 > 0 && (keeps_nodes || fault != Fault::NodesOnWrongSide);
    for (fault, simplices) in checked.offenders.iter().filter(|(fault, _)| is_shown(**fault)) {
        match simplices {
            Faulty::Vertices(list) => found.vertices.extend(list),
            Faulty::Nodes(list) => {
                for &node in list {
                    found.vertices.push(found.points.len() as u32);
                    found.points.push(geometry.grid_to_world(geometry.node_to_grid(node)));
                }
            }
            Faulty::Edges(list) => found.edges.extend(list.iter().filter(|edge| !edge.contains(&u32::MAX))),
            Faulty::Triangles(list) => found.triangles.extend(list.iter().map(corners)),
            Faulty::TrianglePairs(list) => {
                let crossing: BTreeSet<u32> = list.iter().flatten().copied().collect();
                found.triangles.extend(crossing.iter().map(corners));
            }
            Faulty::Components(_) => {}
        }
        let reason = fault.described().0;
        let counts = [found.vertices.len(), found.edges.len(), found.triangles.len()];
        reasons.iter_mut().zip(counts).for_each(|(list, count)| list.resize(count, reason));
    }
    let reasons = reasons.concat();
    if reasons.is_empty() {
        return None;
    }
    found.cell_data = vec![DataArray::integers("reason", reasons)];
    Some(keep_used_points(found))
}

/// Returns the simplices without unused points.
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
    use crate::check::{CheckOptions, check_object};
    use crate::scenes;
    use glam::DVec3;

    #[test]
    fn the_open_edges_of_a_hole_are_offending() {
        let geometry = Geometry::axis_aligned([9; 3], DVec3::splat(2.0));
        let mut mesh = scenes::ball();
        let checked = |mesh: &TriangleMesh| check_object(mesh, &CheckOptions::default());
        assert_eq!(offending(&mesh, &checked(&mesh), &geometry, true), None);
        let corners = mesh.corners(0);
        mesh.triangles.remove(0);
        let simplices = offending(&mesh, &checked(&mesh), &geometry, true).expect("a hole");
        assert_eq!((simplices.edges.len(), simplices.points.len()), (3, 3));
        assert!(simplices.points.iter().all(|p| corners.contains(p)));
    }

    #[test]
    fn nodes_get_positions_and_edges_without_vertex_are_omitted() {
        let geometry = Geometry::axis_aligned([9; 3], DVec3::splat(2.0));
        let mesh = scenes::ball();
        let mut checked = CheckReport::default();
        checked.offenders.insert(Fault::NodesOnWrongSide, Faulty::Nodes(vec![geometry.linear(1, 2, 3)]));
        checked.offenders.insert(Fault::MissingSegments, Faulty::Edges(vec![[0, 1], [0, u32::MAX]]));
        let simplices = offending(&mesh, &checked, &geometry, true).expect("three");
        assert_eq!((simplices.vertices.len(), simplices.edges.len(), simplices.points.len()), (1, 1, 3));
        assert!(simplices.points.contains(&DVec3::new(2.0, 4.0, 6.0)));
        let edges = offending(&mesh, &checked, &geometry, false).expect("an edge");
        assert_eq!((edges.vertices.len(), edges.edges.len()), (0, 1));
    }
}
