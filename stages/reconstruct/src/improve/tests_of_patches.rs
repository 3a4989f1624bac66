//! The optimiser on a lattice and on a small component whose triangles are not fit for finite
//! elements.

use super::surface::measure::quality_of;
use super::*;
use crate::check::{CheckOptions, Fault, check_object};
use crate::subject::Object;
use constants::FIT;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_volume::{Geometry, Image};

/// Number of vertices along a side of the lattice, and number of edges between displaced vertices.
pub(super) const SIDE: usize = 64;
const APART: usize = 6;

/// Returns a plane lattice of equilateral triangles with sides of length 1. Some vertices are
/// displaced in the plane by `shift`.
pub(super) fn lattice(shift: f64) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for j in 0..SIDE {
        for i in 0..SIDE {
            let is_moved = i % APART == APART / 2 && j % APART == APART / 2;
            let x = i as f64 + 0.5 * (j % 2) as f64 + if is_moved { shift } else { 0.0 };
            mesh.vertices.push(DVec3::new(2.0 + x, 2.0 + 0.75f64.sqrt() * j as f64, 3.5));
        }
    }
    let vertex = |i: usize, j: usize| (j * SIDE + i) as u32;
    for j in 0..SIDE - 1 {
        for i in 0..SIDE - 1 {
            let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i, j + 1), vertex(i + 1, j + 1)];
            mesh.triangles.extend(if j % 2 == 0 { [[a, b, c], [b, d, c]] } else { [[a, b, d], [a, d, c]] });
        }
    }
    mesh
}

/// Returns an F that is zero on the plane of the lattice.
pub(super) fn plane() -> CubicSpline {
    let mut image = Image::filled(Geometry::axis_aligned([70, 62, 8], DVec3::ONE), 0.0f32);
    for (n, value) in image.data.iter_mut().enumerate() {
        *value = (n / (70 * 62)) as f32 - 3.5;
    }
    CubicSpline::new(&image)
}

#[test]
fn many_triangles_just_outside_the_limits_are_all_lifted() {
    let field = plane();
    let qualities = |mesh: &TriangleMesh| -> Vec<f64> {
        let corners = (0..mesh.triangles.len()).map(|t| mesh.corners(t));
        corners.map(|[a, b, c]| quality_of(a, b, c)).collect()
    };
    let smallest = |mesh: &TriangleMesh| qualities(mesh).into_iter().fold(f64::INFINITY, f64::min);
    // a displacement for which the worst triangles are just below the limits
    let shift = (1..400).map(|n| 0.002 * f64::from(n)).find(|&shift| smallest(&lattice(shift)) < FIT).unwrap();
    let mesh = lattice(shift);
    assert!(smallest(&mesh) > FIT - 0.01, "{}", smallest(&mesh));
    let size = |_: DVec3| 1.0;
    let lifted = |threads: usize| {
        let mut surface = Surface::new(&mesh, &field, &size);
        let unfit = qualities(&mesh).into_iter().filter(|&quality| quality < FIT).count();
        assert!(unfit > 2 * constants::BATCH, "{unfit}");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut tally = Tally::default();
        pool.install(|| optimise::optimise(&mut surface, FIT, &|| Ok(()), &mut tally)).unwrap();
        let made = surface.into_mesh();
        assert!(smallest(&made) >= FIT, "{} {tally:?}", smallest(&made));
        made
    };
    assert_eq!(lifted(1), lifted(3));
}

const MIDDLE: DVec3 = DVec3::new(6.2, 5.9, 6.1);
const HALF_AXES: DVec3 = DVec3::new(2.4, 1.5, 1.2);

/// Returns an F whose zero set is an ellipsoid: a quadratic function, which the spline reproduces.
/// `sign` is 1 for an object and -1 for a hole.
fn ellipsoid(sign: f64) -> CubicSpline {
    let mut image = Image::filled(Geometry::axis_aligned([13; 3], DVec3::ONE), 0.0f32);
    for (n, value) in image.data.iter_mut().enumerate() {
        let node = DVec3::new((n % 13) as f64, (n / 13 % 13) as f64, (n / 169) as f64);
        *value = (sign * (((node - MIDDLE) / HALF_AXES).length_squared() - 1.0)) as f32;
    }
    CubicSpline::new(&image)
}

/// Returns a closed mesh with vertices on F = 0: two poles, and points near the equator at given
/// angles.
fn bipyramid(field: &CubicSpline, angles: &[f64], is_hole: bool) -> TriangleMesh {
    let ring = angles.iter().map(|a| DVec3::new(a.cos(), a.sin(), 0.1 * a.sin()));
    let ways = ring.chain([DVec3::new(0.1, 0.2, 1.0), DVec3::new(0.2, -0.1, -1.0)]);
    let on_surface =
        |way: DVec3| field.project(MIDDLE + way.normalize() * HALF_AXES, 1.0, 1e-7).expect("F = 0 is near");
    let count = angles.len() as u32;
    let sides = (0..count).flat_map(|a| {
        let b = (a + 1) % count;
        [[a, b, count], [b, a, count + 1]]
    });
    let turned = |[a, b, c]: [u32; 3]| if is_hole { [a, c, b] } else { [a, b, c] };
    TriangleMesh { vertices: ways.map(on_surface).collect(), triangles: sides.map(turned).collect() }
}

#[test]
fn a_small_component_of_needles_becomes_a_fit_ellipsoid() {
    let size = |_: DVec3| 3.0;
    for sign in [1.0, -1.0] {
        let field = ellipsoid(sign);
        let mesh = bipyramid(&field, &[0.2, 1.4, 2.9], sign < 0.0);
        assert!(summarise(&mesh).angle_min < 25.0, "{:?}", summarise(&mesh));
        let mut surface = Surface::new(&mesh, &field, &size);
        let mut tally = Tally::default();
        optimise::optimise(&mut surface, FIT, &|| Ok(()), &mut tally).expect("nothing stops it");
        assert_eq!(tally.remeshed_patches, 1, "{tally:?}");
        let options = CheckOptions {
            subject: Some(&Object { field: &field, topology: &FieldTopology::new(&field), samples: None }),
            max_vertex_distance: Some(1e-4),
            ..Default::default()
        };
        let after = check_object(&surface.into_mesh(), &options);
        assert_eq!(after.failed, Vec::<String>::new());
        assert_eq!((after.object().euler, after.count(Fault::TurnedTriangles)), (2, 0));
        let quality = &after.quality;
        assert!(quality.radius_ratio_min >= 0.5 && quality.angle_min >= 25.0 && quality.angle_max <= 120.0);
        // an icosahedron has 0.6 of the volume of its circumscribed ball
        let share = after.object().volume / (sign * 4.0 / 3.0 * std::f64::consts::PI * HALF_AXES.element_product());
        assert!((0.5..1.0).contains(&share), "{share}");
    }
}
