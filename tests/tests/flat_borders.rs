//! Materials that end at planes: at the border of the volume (`--border flat`) and at planes of
//! `--cut`. The shape is a tube of two materials along x, through the whole volume.

mod support;

use glam::DVec3;
use isoparticles_mesh::surface::{Surface, read_surface};
use isoparticles_tests::nrrd::{self, FileSpace, Voxels};
use isoparticles_volume::Geometry;
use std::f64::consts::PI;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use support::chain::{self, Wishes};
use support::stage;

/// Voxels along y and z.
const SIZE: usize = 40;
/// Voxel spacing along y and z, mm.
const SPACING: f64 = 0.5;
/// Length of the tube, mm.
const LENGTH: f64 = 20.0;
/// Inner and outer radius of the wall of the tube, mm.
const RADII: [f64; 2] = [4.0, 6.5];
/// A point of the axis of the tube, mm.
const AXIS: DVec3 = DVec3::new(0.0, 9.8, 10.1);

/// Writes the tube: label 1 within the inner radius, label 2 between both. `spacing` is the voxel
/// spacing along x, mm.
fn tube(folder: &Path, spacing: f64) -> PathBuf {
    let path = folder.join("tube.nrrd");
    let count = (LENGTH / spacing) as usize;
    let label = |n: usize| {
        let place = DVec3::new(0.0, (n / count % SIZE) as f64, (n / (count * SIZE)) as f64) * SPACING;
        let radius = place.distance(AXIS);
        if radius < RADII[0] { 1 } else { 2 * u8::from(radius < RADII[1]) }
    };
    let labels = Voxels::U8((0..count * SIZE * SIZE).map(label).collect());
    let geometry = Geometry::axis_aligned([count, SIZE, SIZE], DVec3::new(spacing, SPACING, SPACING));
    nrrd::write(&path, &geometry, FileSpace::Lps, &labels, true).expect("a volume");
    path
}

/// Meshes the tube with options of `distfield`. `spacing` is the voxel spacing along x, mm.
fn mesh(distfield: Vec<OsString>, spacing: f64) -> Surface {
    let folder = tempfile::tempdir().expect("folder");
    let particles = arguments!["--backend", "cpu"];
    let wishes = Wishes { distfield, particles, ..Wishes::default() };
    let files = chain::surface(&tube(folder.path(), spacing), folder.path(), &wishes);
    read_surface(&files.surface).expect("surface").surface
}

/// Returns the area (mm^2) of the triangles of a material in the plane with a number (from 1), and
/// the maximum distance (mm) of their corners from the plane.
fn cap(surface: &Surface, material: usize, number: usize, distance: impl Fn(DVec3) -> f64) -> [f64; 2] {
    let array = |name: &str| {
        let array = surface.cell_data.iter().find(|array| array.name == name).expect("a triangle array");
        array.values.to_f64()
    };
    let (caps, inside, outside) = (array("cap"), array("material_inside"), array("material_outside"));
    let mut found = [0.0, 0.0f64];
    for t in (0..caps.len()).filter(|&t| caps[t] == number as f64 && inside[t] == material as f64) {
        assert_eq!(outside[t], 0.0, "the outside is beyond each plane");
        let [a, b, c] = surface.mesh.corners(t);
        found[0] += 0.5 * (b - a).cross(c - a).length();
        found[1] = [a, b, c].into_iter().map(|p| distance(p).abs()).fold(found[1], f64::max);
    }
    found
}

#[test]
fn a_tube_ends_in_flat_caps_at_the_border_and_at_a_cut() {
    let normal = DVec3::new(2.0, 1.0, 0.0).normalize();
    let point = DVec3::new(12.0, AXIS.y, AXIS.z);
    let materials = arguments!["--material", "lumen=1", "--material", "wall=2", "--border", "flat"];
    let cut = format!("plane:{},{},{},2,1,0=outlet", point.x, point.y, point.z);
    let surface = mesh([materials, arguments!["--cut", cut]].concat(), SPACING);
    let areas = [PI * RADII[0].powi(2), PI * (RADII[1].powi(2) - RADII[0].powi(2))];
    // plane 1 is the cut, and plane 2 the first face of the volume along x
    for (material, area) in [(1, areas[0]), (2, areas[1])] {
        let [cut, off] = cap(&surface, material, 1, |p| (p - point).dot(normal));
        assert!((cut * normal.x / area - 1.0).abs() < 0.04 && off < 1e-6, "{material}: {cut} {area} {off}");
        let [face, off] = cap(&surface, material, 2, |p| p.x + 0.5 * SPACING);
        assert!((face / area - 1.0).abs() < 0.04 && off < 1e-6, "{material}: {face} {area} {off}");
    }
    assert_eq!(cap(&surface, 2, 3, |_| 0.0), [0.0, 0.0], "the other end is cut off");
}

/// Checks the caps of the tube as one object. `spacing` is the voxel spacing along x, mm.
fn ends_in_flat_caps(options: Vec<OsString>, spacing: f64) {
    let surface = mesh([options, arguments!["--border", "flat"]].concat(), spacing);
    for (number, face) in [(1, -0.5 * spacing), (2, LENGTH - 0.5 * spacing)] {
        let [area, off] = cap(&surface, 1, number, |p| p.x - face);
        assert!((area / (PI * RADII[1].powi(2)) - 1.0).abs() < 0.04 && off < 1e-6, "{area} {off}");
    }
}

#[test]
fn labels_of_one_object_end_in_flat_caps() {
    ends_in_flat_caps(arguments!["--labels", "1,2"], SPACING);
    ends_in_flat_caps(arguments!["--labels", "1,2", "--scale-for-size", "2"], SPACING);
}

#[test]
fn long_voxels_end_in_flat_caps() {
    ends_in_flat_caps(arguments!["--labels", "1,2"], 5.0);
}

#[test]
fn an_isosurface_ends_in_flat_caps() {
    ends_in_flat_caps(arguments!["--iso", "0.7", "--kind", "scan"], SPACING);
}

#[test]
fn planes_that_cannot_cut_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let (volume, output) = (tube(folder.path(), SPACING), folder.path().join("out.vti"));
    let cut = |plane: &'static str| arguments!["--labels", "1,2", "--cut", plane];
    for (options, what) in [
        (cut("plane:-90,0,0,-1,0,0"), "meets no material"),
        ([cut("plane:9,0,0,1,0,0"), arguments!["--border", "open"]].concat(), "cannot be combined with --border open"),
        (cut("plane:9,0,0,0,0,0"), "NX,NY,NZ must not be zero"),
        (cut("plane:9,0,0,1,0,0=object"), "the name 'object' is taken"),
    ] {
        let finished = stage("distfield", [arguments![&volume, "-o", &output, "--kind", "auto"], options].concat());
        assert_eq!(finished.code, Some(2), "{what}: {}", finished.stderr);
        assert!(finished.stderr.contains(what), "{what}: {}", finished.stderr);
        assert!(!output.exists());
    }
}
