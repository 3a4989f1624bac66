//! Tests that meshes have the correct world coordinates for oblique, anisotropic and left-handed
//! volumes, and for each space that a file may specify.

mod support;

use glam::{DMat3, DVec3};
use isoparticles_mesh::surface::read_surface;
use isoparticles_tests::nrrd::FileSpace;
use isoparticles_tests::scene::{self, Options, Shape};
use isoparticles_volume::{Geometry, Space};
use support::chain::{self, Wishes};
use support::examine::examine;
use support::{Kind, write_phantom_with};

/// Meshes an ellipsoid. Every vertex must lie on the true surface, which the file header places in
/// the world. The three axes of the ellipsoid have different lengths, so swapped axes are detected.
fn lands_where_the_header_says(left_handed: bool, space: FileSpace) {
    let mut directions = DMat3::from_rotation_z(0.5) * DMat3::from_rotation_y(-0.3) * DMat3::from_rotation_x(0.8);
    if left_handed {
        directions.x_axis = -directions.x_axis;
    }
    let geometry = Geometry {
        size: [60, 40, 32],
        spacing: DVec3::new(0.7, 1.1, 1.5),
        directions,
        origin: DVec3::new(-31.0, 12.5, 104.0),
        space: if space == FileSpace::Unnamed { Space::Unnamed } else { Space::Lps },
    };
    let folder = tempfile::tempdir().expect("folder");
    let volume = folder.path().join("phantom.nrrd");
    let options = Options::for_grid(&geometry);
    let truth = write_phantom_with(&volume, Shape::Ellipsoid, &geometry, Kind::Scalar, space, &options);
    let files = chain::surface(&volume, folder.path(), &Wishes::scalar(Some(1.6)));
    let surface = read_surface(&files.surface).expect("surface").surface.mesh;

    let scene = scene::build(Shape::Ellipsoid, &geometry, &options);
    let to_grid = directions.transpose();
    let farthest = surface.vertices.iter().map(|world| scene.value(to_grid * (*world - geometry.origin)).abs());
    let farthest = farthest.fold(0.0, f64::max);
    // The measured distance is at most 0.02 mm at voxel spacings of 0.7 to 1.5 mm. It is the error
    // of the spline through the samples of the blurred edge.
    assert!(farthest < 0.06, "a vertex is {farthest} mm from where it should be");

    let examined = examine(&surface.vertices, &surface.triangles);
    assert_eq!(examined.bad_edges, 0);
    assert!(examined.volume > 0.0, "the triangles must face outward: {examined:?}");
    let centre = geometry.origin + directions * DVec3::from_array(truth.centre_grid);
    assert!(examined.centroid.distance(centre) < 0.05, "{} instead of {centre}", examined.centroid);
}

#[test]
fn oblique_anisotropic_volume() {
    lands_where_the_header_says(false, FileSpace::Lps);
}

#[test]
fn oblique_anisotropic_left_handed_volume() {
    lands_where_the_header_says(true, FileSpace::Lps);
}

#[test]
fn ras_volume_lands_in_lps() {
    lands_where_the_header_says(false, FileSpace::Ras);
}

#[test]
fn volume_of_no_named_space_keeps_its_own() {
    lands_where_the_header_says(true, FileSpace::Unnamed);
}
