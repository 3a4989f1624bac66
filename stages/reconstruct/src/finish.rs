//! Computes the data on the vertices and triangles of the finished mesh, and maps it to world
//! coordinates.

use crate::interfaces::Interfaces;
use crate::materials::each::SIDES;
use glam::DVec3;
use isoparticles_field::curvature::mean_curvature;
use isoparticles_field::energy::{SUPPORT, pair_energy, scaled_distance};
use isoparticles_field::materials::MaterialId;
use isoparticles_field::neighbours::NeighbourLists;
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::components::{self, NO_COMPONENT};
use isoparticles_mesh::quality::radius_ratios;
use isoparticles_mesh::surface::{DataArray, Surface};
use isoparticles_stage::meta::CapPlane;
use isoparticles_volume::Geometry;
use rayon::prelude::*;

/// Maximum distance from a capping plane, in voxels along its axis, of the corners of a triangle
/// that belongs to the cap.
const ON_CAP: f64 = 0.1;

/// Returns a mesh in the grid frame as a surface in world coordinates. Data on vertices: h
/// (`sizes`), energy, normal, curvature and component. Data on triangles: radius ratio, deviation
/// and cap.
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
    let (component, _) = components::of_vertices(mesh.vertices.len(), &mesh.triangles);
    let component = component.into_iter().map(|c| if c == NO_COMPONENT { -1 } else { i64::from(c) }).collect();
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

/// Returns the interfaces in the world frame, with attributes of vertices (h, number of materials
/// that meet) and triangles (the two regions, radius ratio, and the number of the plane in which
/// the triangle lies, from 1).
pub(crate) fn attributes_of_materials(interfaces: &Interfaces, sizes: &[f64], geometry: &Geometry) -> Surface {
    let Interfaces { mesh, between, first_beyond, .. } = interfaces;
    let mut surface = Surface::from_grid(mesh, geometry);
    let meeting = interfaces.materials_at_vertices().iter().map(|ids| ids.len() as i64).collect();
    surface.point_data = vec![DataArray::scalars("h", sizes.to_vec()), DataArray::integers("materials", meeting)];
    let side = |n: usize| {
        let of = |t: u32| i64::from(interfaces.regions_of(t)[n].0);
        (0..between.len() as u32).map(of).collect()
    };
    surface.cell_data = vec![
        DataArray::integers(SIDES[0], side(0)),
        DataArray::integers(SIDES[1], side(1)),
        DataArray::scalars("radius_ratio", radius_ratios(mesh)),
    ];
    if let Some(first) = first_beyond {
        let cap = |pair: &[MaterialId; 2]| i64::from((pair[1].0 + 1).saturating_sub(first.0));
        surface.cell_data.push(DataArray::integers("cap", between.iter().map(cap).collect()));
    }
    surface
}

fn on_cap(corners: [DVec3; 3], caps: &[CapPlane], geometry: &Geometry) -> bool {
    caps.iter().any(|cap| {
        let tolerance = ON_CAP * geometry.spacing[cap.axis];
        corners.iter().all(|p| (p[cap.axis] - cap.position).abs() < tolerance)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;
    use isoparticles_stage::meta::Side;

    fn values<'a>(arrays: &'a [DataArray], name: &str) -> &'a [f64] {
        match arrays.iter().find(|a| a.name == name).map(|a| &a.values) {
            Some(isoparticles_volume::Voxels::F64(values)) => values,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn curvature_normals_and_deviation_of_a_ball_are_correct() {
        let scene = scenes::sphere();
        let surface = attributes(&scenes::ball(), &scene.field, &vec![1.5; scenes::ball().vertices.len()], &[]);
        for &k in values(&surface.point_data, "curvature") {
            assert!((k - 0.1).abs() < 2e-3, "curvature {k}");
        }
        for (n, p) in values(&surface.point_data, "normal").chunks(3).zip(&surface.mesh.vertices) {
            let outward = (*p - scenes::CENTRE).normalize();
            assert!(DVec3::from_slice(n).dot(outward) > 0.9999);
        }
        // the centroid of an equilateral triangle with edge e is e^2 / 6R inside the sphere
        for &d in values(&surface.cell_data, "deviation") {
            assert!((-0.05..0.0).contains(&d), "deviation {d}");
        }
    }

    #[test]
    fn cap_triangles_are_on_the_capping_plane() {
        let caps = [CapPlane { axis: 2, side: Side::Low, position: 4.5 }];
        let geometry = Geometry::axis_aligned([9; 3], DVec3::ONE);
        let triangle = |z: f64| [DVec3::new(1.0, 1.0, 4.5), DVec3::new(2.0, 1.0, 4.52), DVec3::new(1.0, 2.0, z)];
        assert!(on_cap(triangle(4.55), &caps, &geometry) && !on_cap(triangle(4.9), &caps, &geometry));
    }
}
