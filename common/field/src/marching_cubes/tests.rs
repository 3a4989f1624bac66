//! Tests of marching cubes on shapes of known topology, area and volume.

use super::*;
use crate::random::uniform;
use isoparticles_volume::Geometry;
use proptest::prelude::*;
use std::collections::HashMap;
use std::f64::consts::PI;

fn sampled(size: [usize; 3], spacing: DVec3, f: impl Fn(DVec3) -> f64) -> Image<f32> {
    Image::sampled(Geometry::axis_aligned(size, spacing), |p| f(p) as f32)
}

fn corners(mesh: &TriangleMesh, t: [u32; 3]) -> [DVec3; 3] {
    t.map(|v| mesh.vertices[v as usize])
}

/// Returns the area and the enclosed volume.
fn measure(mesh: &TriangleMesh) -> (f64, f64) {
    mesh.triangles.iter().map(|&t| corners(mesh, t)).fold((0.0, 0.0), |(area, volume), [a, b, c]| {
        (area + 0.5 * (b - a).cross(c - a).length(), volume + a.dot(b.cross(c)) / 6.0)
    })
}

/// Checks that the mesh is closed and manifold, without degenerate triangles. Returns the Euler
/// characteristic.
fn check_closed(mesh: &TriangleMesh) -> isize {
    let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
    let mut fans: Vec<HashMap<u32, u32>> = vec![HashMap::new(); mesh.vertices.len()];
    for t in &mesh.triangles {
        for n in 0..3 {
            let (a, b, c) = (t[n], t[(n + 1) % 3], t[(n + 2) % 3]);
            *edges.entry((a, b)).or_default() += 1;
            assert!(fans[a as usize].insert(b, c).is_none());
        }
        let [a, b, c] = corners(mesh, *t);
        assert!((b - a).cross(c - a).length() > 1e-9, "zero-area triangle");
    }
    for (&(a, b), &count) in &edges {
        assert_eq!(count, 1, "edge {a} {b} used {count} times in one direction");
        assert!(edges.contains_key(&(b, a)), "edge {a} {b} has no partner");
    }
    for (vertex, fan) in fans.iter().enumerate() {
        assert!(!fan.is_empty(), "vertex {vertex} is in no triangle");
        let start = *fan.keys().next().expect("not empty");
        let (mut at, mut steps) = (start, 0);
        while steps == 0 || at != start {
            at = fan[&at];
            steps += 1;
        }
        assert_eq!(steps, fan.len(), "the triangles round vertex {vertex} form more than one fan");
    }
    mesh.vertices.len() as isize - edges.len() as isize / 2 + mesh.triangles.len() as isize
}

#[test]
fn sphere_torus_and_balls_have_their_topology_and_measures() {
    let spacing = DVec3::new(0.5, 0.6, 0.4);
    let centre = DVec3::new(12.1, 12.3, 10.2);
    let size = [50, 42, 52];

    let sphere = marching_cubes(&sampled(size, spacing, |p| p.distance(centre) - 8.0), 0.0);
    assert_eq!(check_closed(&sphere), 2);
    let (area, volume) = measure(&sphere);
    // the inscribed mesh underestimates area and volume by a fraction of a few times `1 / (8 R^2)`,
    // where the radius R is 13 to 20 voxels
    assert!((area / (4.0 * PI * 64.0) - 1.0).abs() < 4e-3, "area {area}");
    assert!((volume / (4.0 / 3.0 * PI * 512.0) - 1.0).abs() < 4e-3, "volume {volume}");

    let torus = |p: DVec3| {
        let q = p - centre;
        (q.x.hypot(q.y) - 7.0).hypot(q.z) - 3.0
    };
    let torus = marching_cubes(&sampled(size, spacing, torus), 0.0);
    assert_eq!(check_closed(&torus), 0);
    let (area, volume) = measure(&torus);
    assert!((area / (4.0 * PI * PI * 21.0) - 1.0).abs() < 1.5e-2, "area {area}");
    assert!((volume / (2.0 * PI * PI * 63.0) - 1.0).abs() < 1.5e-2, "volume {volume}");

    let balls = |p: DVec3| {
        let shift = DVec3::X * 4.2;
        (p - centre - shift).length().min((p - centre + shift).length()) - 4.0
    };
    assert_eq!(check_closed(&marching_cubes(&sampled(size, spacing, balls), 0.0)), 4);
}

#[test]
fn triangles_face_the_larger_values() {
    let centre = DVec3::splat(6.0);
    let mesh = marching_cubes(&sampled([13, 13, 13], DVec3::ONE, |p| p.distance(centre) - 4.3), 0.0);
    for &t in &mesh.triangles {
        let [a, b, c] = corners(&mesh, t);
        assert!((b - a).cross(c - a).dot(a - centre) > 0.0);
    }
}

#[test]
fn samples_equal_to_the_iso_value_make_no_degenerate_triangle() {
    // all samples are integers, so many of them equal the iso value
    let distance = |p: DVec3| (p - DVec3::splat(7.0)).abs().element_sum();
    let mesh = marching_cubes(&sampled([15, 15, 15], DVec3::ONE, distance), 5.0);
    assert_eq!(check_closed(&mesh), 2);
}

#[test]
fn the_table_covers_every_crossed_edge_once() {
    for case in 0..=255u8 {
        let crossed =
            EDGES.iter().filter(|e| (case >> e.corner & 1) != (case >> (e.corner | AXIS_BIT[e.axis]) & 1)).count();
        for variant in 0..1usize << ambiguous_faces(case).len() {
            let in_loops: usize = loops(case, variant).iter().map(Vec::len).sum();
            assert_eq!(crossed, in_loops, "case {case:#010b}, variant {variant:#b}");
        }
    }
}

#[test]
fn the_saddle_decides_whether_diagonal_neighbours_are_joined() {
    // for an outside value v, the saddle value is 0.3 v - 0.35, so the diagonal samples are joined
    // for v = 1.1 but not for v = 1.2; the bilinear interpolant would separate them for v > 1/2
    for (outside, components) in [(1.1, 1), (1.2, 2)] {
        let diagonal = |p: DVec3| {
            let touches = p == DVec3::new(2.0, 2.0, 2.0) || p == DVec3::new(3.0, 3.0, 2.0);
            if touches { -0.5 } else { outside }
        };
        let mesh = marching_cubes(&sampled([6, 6, 5], DVec3::ONE, diagonal), 0.0);
        assert_eq!(check_closed(&mesh), 2 * components, "outside value {outside}");
    }
}

#[test]
fn empty_full_and_flat_images_have_no_surface() {
    for (size, value) in [([4, 4, 4], 1.0), ([4, 4, 4], -1.0), ([1, 4, 4], -1.0)] {
        let mesh = marching_cubes(&sampled(size, DVec3::ONE, |_| value), 0.0);
        assert!(mesh.triangles.is_empty() && mesh.vertices.is_empty());
    }
}

#[test]
fn rows_of_any_length_have_a_vertex_on_every_crossed_edge() {
    for nx in [3, 15, 16, 17, 63, 64, 65, 128, 131] {
        let size = [nx, 6, 5];
        let mut field = sampled(size, DVec3::ONE, |_| 1.0);
        let inner = |n: usize, axis: usize| n > 0 && n + 1 < size[axis];
        let all = || (0..nx * 30).map(|n| [n % nx, n / nx % 6, n / nx / 6]);
        for (n, [i, j, k]) in all().enumerate().filter(|(_, [i, j, k])| inner(*i, 0) && inner(*j, 1) && inner(*k, 2)) {
            let random = uniform(7, nx as u64, n as u64) as f32;
            let at = field.geometry.linear(i, j, k);
            // NaN counts as outside
            field.data[at] = if random > 0.95 { f32::NAN } else { random - 0.5 };
        }
        let is_inside = |[i, j, k]: [usize; 3]| field.data[field.geometry.linear(i, j, k)] < 0.0;
        let crossed = |from: [usize; 3]| {
            (0..3)
                .filter(|&axis| {
                    let mut to = from;
                    to[axis] += 1;
                    to[axis] < size[axis] && is_inside(from) != is_inside(to)
                })
                .count()
        };
        let mesh = marching_cubes(&field, 0.0);
        check_closed(&mesh);
        // only vertices on grid edges have exactly one fractional coordinate; centres of fans lie
        // within cells
        let off_grid = |x: f64| x != x.round();
        let on_edges = mesh.vertices.iter().filter(|v| v.to_array().into_iter().filter(|&x| off_grid(x)).count() == 1);
        assert_eq!(on_edges.count(), all().map(crossed).sum::<usize>(), "rows of {nx}");
    }
}

proptest! {
    #[test]
    fn any_field_gives_a_closed_manifold(values in proptest::collection::vec(-2i8..=2, 6 * 5 * 7), exact: bool) {
        let mut field = sampled([8, 7, 9], DVec3::new(1.0, 0.5, 2.0), |_| 1.0);
        let mut value = values.iter();
        for k in 1..8 {
            for j in 1..6 {
                for i in 1..7 {
                    let at = field.geometry.linear(i, j, k);
                    let v = f32::from(*value.next().expect("one value an inner node"));
                    field.data[at] = if exact { v } else { v + 0.3 };
                }
            }
        }
        let mesh = marching_cubes(&field, 0.0);
        check_closed(&mesh);
        let (_, volume) = measure(&mesh);
        prop_assert!(mesh.triangles.is_empty() || volume > 0.0);
    }
}
