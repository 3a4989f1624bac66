//! Tests meshes with a given number of vertices: `distfield --scale-for-vertices` and `sizefield
//! --vertices`, through all stages.

mod support;

use glam::DVec3;
use isoparticles_mesh::surface::read_surface;
use isoparticles_tests::scene::Shape;
use isoparticles_volume::Geometry;
use support::chain::{self, Wishes};
use support::examine::{Examination, examine};
use support::{Kind, write_phantom};

/// Meshes a phantom with a target number of vertices and additional options of `sizefield`. Returns
/// the properties of the mesh, and its volume divided by the exact volume.
fn mesh(shape: Shape, spacing: DVec3, kind: Kind, vertices: u32, graded: &[&str]) -> (Examination, f64) {
    let folder = tempfile::tempdir().expect("folder");
    let volume = folder.path().join("phantom.nrrd");
    let truth = write_phantom(&volume, shape, &Geometry::axis_aligned([56; 3], spacing), kind);
    let mut wishes = if kind == Kind::Scalar { Wishes::scalar(None) } else { Wishes::label(None) };
    wishes.distfield.extend(arguments!["--scale-for-vertices", vertices.to_string()]);
    wishes.sizefield.extend(arguments!["--vertices", vertices.to_string()]);
    wishes.sizefield.extend(graded.iter().map(Into::into));
    wishes.particles.extend(arguments!["--backend", "cpu"]);
    let files = chain::surface(&volume, folder.path(), &wishes);
    let surface = read_surface(&files.surface).expect("surface").surface.mesh;
    let examined = examine(&surface.vertices, &surface.triangles);
    let kept = examined.volume / truth.volume.expect("a closed phantom");
    let off = surface.vertices.len() as f64 / f64::from(vertices) - 1.0;
    println!("{shape:?} {kind:?} {vertices} {graded:?}: {:+.1} %, {kept} of the volume, {examined:?}", 100.0 * off);
    assert!(off.abs() < 0.05, "{shape:?}: {} vertices in place of {vertices}", surface.vertices.len());
    assert_eq!(examined.bad_edges, 0, "{shape:?}: {examined:?}");
    assert_eq!(Some(examined.components), truth.components, "{shape:?}: {examined:?}");
    assert_eq!(Some(examined.genus), truth.genus.map(|g| g as i64), "{shape:?}: {examined:?}");
    (examined, kept)
}

#[test]
fn one_edge_length_gives_the_number_asked_for() {
    let thick = DVec3::new(1.0, 1.0, 1.5);
    for (shape, spacing, kind, vertices) in [
        (Shape::Ball, thick, Kind::Label, 400),
        (Shape::Torus, DVec3::ONE, Kind::Label, 1500),
        (Shape::Ellipsoid, DVec3::ONE, Kind::Scalar, 3000),
    ] {
        let (examined, kept) = mesh(shape, spacing, kind, vertices, &[]);
        assert!(examined.mean_radius_ratio > 0.97 && examined.smallest_radius_ratio > 0.6, "{shape:?}: {examined:?}");
        assert!((kept - 1.0).abs() < 0.03, "{shape:?}: {kept} of the volume");
    }
}

#[test]
fn a_graded_field_is_scaled_to_the_number_asked_for() {
    let (examined, _) = mesh(Shape::Ellipsoid, DVec3::ONE, Kind::Label, 1000, &["--epsilon", "0.6"]);
    assert!(examined.mean_radius_ratio > 0.95, "{examined:?}");
}
