//! Tight Cocone on analytic scenes and on clouds with faults.

use super::*;
use crate::scenes::{self, Scene};
use isoparticles_common::mesh::TriangleMesh;
use isoparticles_common::mesh::topology::{Topology, analyse};

fn mesh_of(points: &[DVec3], normals: Option<&[DVec3]>) -> (TriangleMesh, CoconeReport) {
    let delaunay = Delaunay::new(points).unwrap();
    let (facets, report) = tight_cocone(&delaunay, normals).unwrap();
    (TriangleMesh { vertices: points.to_vec(), triangles: facets.iter().map(|f| f.vertices).collect() }, report)
}

#[test]
fn probe() {
    for (name, scene, spacing) in [
        ("sphere", scenes::sphere(), 1.0),
        ("sphere", scenes::sphere(), 2.5),
        ("torus", scenes::torus(), 0.8),
        ("torus", scenes::torus(), 1.6),
        ("two", scenes::two_balls(), 0.6),
        ("two", scenes::two_balls(), 1.2),
        ("shell", scenes::shell(), 0.8),
        ("shell", scenes::shell(), 1.2),
        ("gyroid", scenes::gyroid(), 0.6),
        ("gyroid", scenes::gyroid(), 1.2),
    ] {
        let points = scene.points(spacing);
        let normals: Vec<DVec3> = points.iter().map(|&p| scene.gradient(p)).collect();
        for given in [None, Some(&normals[..])] {
            let (mesh, report) = mesh_of(&points, given);
            let t = analyse(&mesh);
            let f = |t: &Topology| {
                format!(
                    "comps {} euler {} open {} nme {} nmv {}",
                    t.components.len(),
                    t.euler,
                    t.open_edges.len(),
                    t.non_manifold_edges.len(),
                    t.non_manifold_vertices.len()
                )
            };
            println!("{name} {spacing} {} {report:?}", f(&t));
        }
    }
}
