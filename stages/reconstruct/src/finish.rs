//! The finished mesh with its data, in the world, and the places where a check failed.

use crate::check::CheckReport;
use glam::DVec3;
use isoparticles_field::curvature::mean_curvature;
use isoparticles_field::energy::{SUPPORT, pair_energy, scaled_distance};
use isoparticles_field::neighbours::NeighbourLists;
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::quality::radius_ratios;
use isoparticles_mesh::surface::{DataArray, Simplices, Surface};
use isoparticles_mesh::topology::analyse;
use isoparticles_stage::meta::CapPlane;
use isoparticles_volume::Geometry;
use rayon::prelude::*;

/// Triangles whose corners are this near (voxels) to a capping plane lie on it.
const ON_CAP: f64 = 0.1;

/// Takes a mesh from the grid frame to the world, with what is known at its vertices (h, given as `sizes`, energy, normal, curvature,
/// component) and triangles (radius ratio, deviation, cap).
pub fn attributes(mesh: &TriangleMesh, field: &CubicSpline, sizes: &[f64], caps: &[CapPlane]) -> Surface {
    let geometry = field.geometry();
    let jets: Vec<(DVec3, f64)> = mesh
        .vertices
        .par_iter()
        .map(|&p| {
            let jet = field.jet(p);
            (jet.gradient, mean_curvature(&jet))
        })
        .collect();
    let normals: Vec<DVec3> = jets.iter().map(|(g, _)| geometry.normal_to_world(*g)).collect();
    let near = NeighbourLists::new(&mesh.vertices, sizes, SUPPORT, |i, j| jets[i].0.dot(jets[j].0) > 0.0);
    let energies: Vec<f64> = (0..mesh.vertices.len())
        .into_par_iter()
        .map(|i| {
            let pair = |&j: &u32| {
                let j = j as usize;
                let distance = mesh.vertices[i].distance(mesh.vertices[j]);
                pair_energy(scaled_distance(distance, sizes[i], sizes[j]))
            };
            near.of(i).iter().map(pair).sum()
        })
        .collect();
    let component_of_triangle = analyse(mesh).component_of_triangle;
    let mut component = vec![-1i64; mesh.vertices.len()];
    for (t, &c) in mesh.triangles.iter().zip(&component_of_triangle) {
        t.iter().for_each(|&v| component[v as usize] = i64::from(c));
    }
    let deviation = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            field.distance_estimate((a + b + c) / 3.0)
        })
        .collect();
    let cap = (0..mesh.triangles.len()).map(|t| i64::from(on_cap(mesh.corners(t), caps, geometry))).collect();
    let mut surface = Surface::from_grid(mesh, geometry);
    surface.point_data = vec![
        DataArray::scalars("h", sizes.to_vec()),
        DataArray::scalars("energy", energies),
        DataArray::vectors("normal", &normals),
        DataArray::scalars("curvature", jets.iter().map(|(_, k)| *k).collect()),
        DataArray::integers("component", component),
    ];
    surface.cell_data = vec![
        DataArray::scalars("radius_ratio", radius_ratios(mesh)),
        DataArray::scalars("deviation", deviation),
        DataArray::integers("cap", cap),
    ];
    surface
}

fn on_cap(corners: [DVec3; 3], caps: &[CapPlane], geometry: &Geometry) -> bool {
    caps.iter().any(|cap| {
        let tolerance = ON_CAP * geometry.spacing[cap.axis];
        corners.iter().all(|p| (p[cap.axis] - cap.position).abs() < tolerance)
    })
}

/// The simplices behind failed checks, in the world, with the number of the reason (`reason`: 1 open edge, 2 edge in more
/// than two triangles, 3 badly oriented edge, 4 pinched vertex, 5 distant vertex, 6 grid node on the wrong side, 7 repeated
/// triangle, 8 no area, 9 crossing, 10 poor shape, 11 turned against grad F); `None` when there are none.
pub fn offending(mesh: &TriangleMesh, checked: &CheckReport, geometry: &Geometry) -> Option<Simplices> {
    let found = &checked.offenders;
    let mut simplices =
        Simplices { points: mesh.vertices.iter().map(|&p| geometry.grid_to_world(p)).collect(), ..Default::default() };
    let (mut vertex_reasons, mut edge_reasons, mut triangle_reasons) = (Vec::new(), Vec::new(), Vec::new());
    for (list, reason) in [(&found.non_manifold_vertices, 4), (&found.distant_vertices, 5)] {
        simplices.vertices.extend(list);
        vertex_reasons.resize(simplices.vertices.len(), reason);
    }
    for node in &found.nodes_on_wrong_side {
        let index = DVec3::from_array(node.map(|n| n as f64));
        simplices.vertices.push(simplices.points.len() as u32);
        simplices.points.push(geometry.grid_to_world(geometry.index_to_grid(index)));
        vertex_reasons.push(6);
    }
    for (list, reason) in [(&found.open_edges, 1), (&found.non_manifold_edges, 2), (&found.badly_oriented_edges, 3)] {
        simplices.edges.extend(list);
        edge_reasons.resize(simplices.edges.len(), reason);
    }
    let mut crossing: Vec<u32> = found.self_intersections.iter().flatten().copied().collect();
    crossing.sort_unstable();
    crossing.dedup();
    for (list, reason) in [
        (&found.repeated_triangles, 7),
        (&found.zero_area_triangles, 8),
        (&crossing, 9),
        (&found.poor_triangles, 10),
        (&found.turned_triangles, 11),
    ] {
        simplices.triangles.extend(list.iter().map(|&t| mesh.triangles[t as usize]));
        triangle_reasons.resize(simplices.triangles.len(), reason);
    }
    let reasons: Vec<i64> = [vertex_reasons, edge_reasons, triangle_reasons].concat();
    if reasons.is_empty() {
        return None;
    }
    simplices.cell_data = vec![DataArray::integers("reason", reasons)];
    Some(keep_used_points(simplices))
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
    use isoparticles_mesh::shapes::icosphere;
    use isoparticles_stage::meta::Side;

    fn ball() -> TriangleMesh {
        let mut mesh = icosphere(10.0, 3);
        mesh.vertices.iter_mut().for_each(|p| *p += scenes::CENTRE);
        mesh
    }

    fn values<'a>(arrays: &'a [DataArray], name: &str) -> &'a [f64] {
        match arrays.iter().find(|a| a.name == name).map(|a| &a.values) {
            Some(isoparticles_volume::Voxels::F64(values)) => values,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn data_of_a_ball_is_that_of_a_ball() {
        let scene = scenes::sphere();
        let surface = attributes(&ball(), &scene.field, &vec![1.5; ball().vertices.len()], &[]);
        for &k in values(&surface.point_data, "curvature") {
            assert!((k - 0.1).abs() < 2e-3, "curvature {k}");
        }
        for (n, p) in values(&surface.point_data, "normal").chunks(3).zip(&surface.mesh.vertices) {
            let outward = (*p - scenes::CENTRE).normalize();
            assert!(DVec3::from_slice(n).dot(outward) > 0.9999);
        }
        // the chord of an edge e lies e^2 / 6R inside at the centroid
        for &d in values(&surface.cell_data, "deviation") {
            assert!((-0.05..0.0).contains(&d), "deviation {d}");
        }
    }

    #[test]
    fn cap_triangles_are_those_on_the_plane() {
        let caps = [CapPlane { axis: 2, side: Side::Low, position: 4.5 }];
        let geometry = Geometry::axis_aligned([9; 3], DVec3::ONE);
        let triangle = |z: f64| [DVec3::new(1.0, 1.0, 4.5), DVec3::new(2.0, 1.0, 4.52), DVec3::new(1.0, 2.0, z)];
        assert!(on_cap(triangle(4.55), &caps, &geometry) && !on_cap(triangle(4.9), &caps, &geometry));
    }

    #[test]
    fn a_hole_and_a_stray_vertex_are_shown_where_they_are() {
        let scene = scenes::sphere();
        let mut mesh = ball();
        let [a, b, c] = mesh.corners(0);
        mesh.triangles.remove(0);
        let options = CheckOptions { field: Some(&scene.field), ..CheckOptions::default() };
        let simplices = offending(&mesh, &check(&mesh, &options), scene.field.geometry()).unwrap();
        assert_eq!((simplices.edges.len(), simplices.points.len()), (3, 3));
        assert!(simplices.points.iter().all(|p| [a, b, c].contains(p)));
        assert_eq!(offending(&ball(), &check(&ball(), &options), scene.field.geometry()), None);
    }
}
