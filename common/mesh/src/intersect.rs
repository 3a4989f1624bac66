//! Finds self-intersections of a mesh with exact predicates (Shewchuk's adaptive `orient2d` and
//! `orient3d`).
//!
//! Triangles are closed sets, so touching triangles intersect. Two triangles without a common
//! vertex must be disjoint. Two triangles with one common vertex may meet only there. Two coplanar
//! triangles with a common edge must not overlap. No triangle may occur twice.

use super::TriangleMesh;
use crate::spatial::{Bounds, BoxTree};
use glam::DVec3;
use rayon::prelude::*;
use robust::{Coord, Coord3D};

/// Returns all pairs of triangles that intersect outside their shared vertices and edges. The pairs
/// are in ascending order, with the lower index first.
pub fn self_intersections(mesh: &TriangleMesh) -> Vec<[u32; 2]> {
    let boxes: Vec<Bounds> = (0..mesh.triangles.len()).into_par_iter().map(|t| Bounds::of(&mesh.corners(t))).collect();
    BoxTree::new(&boxes).pairs(|a, b| triangles_cross(mesh, a as usize, b as usize))
}

/// Returns whether two different triangles of a mesh intersect outside their shared vertices and
/// edges.
pub fn triangles_cross(mesh: &TriangleMesh, first: usize, second: usize) -> bool {
    corners_cross(mesh.triangles[first], mesh.corners(first), mesh.triangles[second], mesh.corners(second))
}

/// Works like [`triangles_cross`], for triangles given by vertex indices and positions.
pub fn corners_cross(first: [u32; 3], p: [DVec3; 3], second: [u32; 3], q: [DVec3; 3]) -> bool {
    let mut shared = [(0, 0); 3];
    let mut count = 0;
    for (i, a) in first.iter().enumerate() {
        if let Some(j) = second.iter().position(|b| a == b) {
            shared[count] = (i, j);
            count += 1;
        }
    }
    match count {
        0 => !clearly_apart(p, q, &q) && !clearly_apart(q, p, &p) && triangles_meet(p, q),
        1 => {
            let (i, j) = shared[0];
            let rest = |t: [DVec3; 3], at: usize| [t[(at + 1) % 3], t[(at + 2) % 3]];
            if clearly_apart(turned(p, i), q, &rest(q, j)) || clearly_apart(turned(q, j), p, &rest(p, i)) {
                return false;
            }
            segment_meets_triangle(p[(i + 1) % 3], p[(i + 2) % 3], q)
                || segment_meets_triangle(q[(j + 1) % 3], q[(j + 2) % 3], p)
        }
        2 => {
            let (u, v) = (shared[0].0, shared[1].0);
            let apex = q[3 - shared[0].1 - shared[1].1];
            folded(p[u], p[v], p[3 - u - v], apex)
        }
        _ => true,
    }
}

/// Returns the triangle with its corners cyclically permuted so that corner `first` comes first.
fn turned(t: [DVec3; 3], first: usize) -> [DVec3; 3] {
    [t[first], t[(first + 1) % 3], t[(first + 2) % 3]]
}

/// Returns whether a fast floating-point test proves that two triangles do not intersect. The test
/// uses the plane of `t`, and the planes perpendicular to `t` through the two edges at its first
/// corner. The test succeeds if all `points` (corners of `other`) lie on one side of the plane of
/// `t`, or are separated from `t` by one of the other two planes, by more than the rounding error.
/// If `points` omits a corner of `other`, that corner must be the first corner of `t`.
fn clearly_apart(t: [DVec3; 3], other: [DVec3; 3], points: &[DVec3]) -> bool {
    let (u, v) = (t[1] - t[0], t[2] - t[0]);
    let normal = u.cross(v);
    let length = u.length() + v.length();
    let far = other.iter().map(|p| p.distance(t[0])).fold(0.0, f64::max);
    let plane = |direction: DVec3, size: f64| {
        // Rounding errors are below `1e-14 * size * far`. The exact test decides all other cases.
        let margin = 1e-10 * size * far;
        let side = |p: &DVec3| (*p - t[0]).dot(direction);
        (points.iter().all(|p| side(p) < -margin), points.iter().all(|p| side(p) > margin))
    };
    let (square, cube) = (length * length, length * length * length);
    let (below, above) = plane(normal, square);
    below || above || plane(normal.cross(u), cube).0 || plane(v.cross(normal), cube).0
}

/// Returns whether two triangles without a common vertex intersect.
pub fn triangles_meet(p: [DVec3; 3], q: [DVec3; 3]) -> bool {
    let side = |t: [DVec3; 3], of: [DVec3; 3]| of.map(|x| orientation(t[0], t[1], t[2], x));
    let of_q = side(p, q);
    if one_sided(of_q) {
        return false;
    }
    let of_p = side(q, p);
    if one_sided(of_p) {
        return false;
    }
    if of_p == [0; 3] && of_q == [0; 3] {
        return flat_triangles_meet(p, q);
    }
    (0..3).any(|e| segment_meets_triangle(p[e], p[(e + 1) % 3], q) || segment_meets_triangle(q[e], q[(e + 1) % 3], p))
}

fn one_sided(s: [i8; 3]) -> bool {
    s == [1; 3] || s == [-1; 3]
}

/// Returns whether a closed segment and a closed triangle intersect.
pub fn segment_meets_triangle(a: DVec3, b: DVec3, t: [DVec3; 3]) -> bool {
    let at_a = orientation(t[0], t[1], t[2], a);
    let at_b = orientation(t[0], t[1], t[2], b);
    if at_a * at_b > 0 {
        return false;
    }
    if at_a == 0 && at_b == 0 {
        return flat_segment_meets_triangle(a, b, t);
    }
    let turns: [i8; 3] = std::array::from_fn(|e| orientation(a, b, t[e], t[(e + 1) % 3]));
    !(turns.contains(&1) && turns.contains(&-1))
}

/// Returns whether the triangles (u, v, p) and (u, v, q) are coplanar and lie on the same side of
/// their common edge.
fn folded(u: DVec3, v: DVec3, p: DVec3, q: DVec3) -> bool {
    if orientation(u, v, p, q) != 0 {
        return false;
    }
    (0..3).any(|axis| {
        let [u, v, p, q] = [u, v, p, q].map(|x| flat(x, axis));
        turn(u, v, p) * turn(u, v, q) > 0
    })
}

// Coplanar sets intersect if and only if their projections along all three axes intersect. A common
// point remains common in every projection. Conversely, at least one projection is injective on the
// plane.

fn flat_triangles_meet(p: [DVec3; 3], q: [DVec3; 3]) -> bool {
    (0..3).all(|axis| {
        let (p, q) = (p.map(|x| flat(x, axis)), q.map(|x| flat(x, axis)));
        let sides_meet = (0..3).any(|i| (0..3).any(|j| segments_meet_2d(p[i], p[(i + 1) % 3], q[j], q[(j + 1) % 3])));
        sides_meet || holds(q, p[0]) || holds(p, q[0])
    })
}

fn flat_segment_meets_triangle(a: DVec3, b: DVec3, t: [DVec3; 3]) -> bool {
    (0..3).all(|axis| {
        let (a, b, t) = (flat(a, axis), flat(b, axis), t.map(|x| flat(x, axis)));
        holds(t, a) || (0..3).any(|e| segments_meet_2d(a, b, t[e], t[(e + 1) % 3]))
    })
}

fn flat(p: DVec3, axis: usize) -> Coord<f64> {
    Coord { x: p[(axis + 1) % 3], y: p[(axis + 2) % 3] }
}

/// Returns whether a point lies in a triangle or on its border. Returns false for a degenerate
/// triangle, because callers test its sides separately.
fn holds(t: [Coord<f64>; 3], p: Coord<f64>) -> bool {
    let turns: [i8; 3] = std::array::from_fn(|e| turn(t[e], t[(e + 1) % 3], p));
    turn(t[0], t[1], t[2]) != 0 && !(turns.contains(&1) && turns.contains(&-1))
}

fn segments_meet_2d(a: Coord<f64>, b: Coord<f64>, c: Coord<f64>, d: Coord<f64>) -> bool {
    let (of_c, of_d) = (turn(a, b, c), turn(a, b, d));
    let (of_a, of_b) = (turn(c, d, a), turn(c, d, b));
    if of_c * of_d > 0 || of_a * of_b > 0 {
        return false;
    }
    if of_c == 0 && of_d == 0 && of_a == 0 && of_b == 0 {
        // all points are collinear or coincident, so compare the extents
        let apart = |a: f64, b: f64, c: f64, d: f64| a.max(b) < c.min(d) || c.max(d) < a.min(b);
        return !apart(a.x, b.x, c.x, d.x) && !apart(a.y, b.y, c.y, d.y);
    }
    true
}

/// Returns the exact orientation of the points a, b, c in the plane: 1 for a left turn, -1 for a
/// right turn, 0 if the points are collinear.
pub fn turn(a: Coord<f64>, b: Coord<f64>, c: Coord<f64>) -> i8 {
    sign(robust::orient2d(a, b, c))
}

/// Returns the exact side of d relative to the plane through a, b and c. The result is 1 on the
/// side of the normal (b - a) x (c - a), -1 on the other side, and 0 in the plane.
pub fn orientation(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> i8 {
    let coordinate = |p: DVec3| Coord3D { x: p.x, y: p.y, z: p.z };
    -sign(robust::orient3d(coordinate(a), coordinate(b), coordinate(c), coordinate(d)))
}

fn sign(x: f64) -> i8 {
    i8::from(x > 0.0) - i8::from(x < 0.0)
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use super::*;
    use proptest::prelude::*;

    fn v(x: f64, y: f64, z: f64) -> DVec3 {
        DVec3::new(x, y, z)
    }

    fn pair(p: [DVec3; 3], q: [DVec3; 3]) -> bool {
        let mesh = TriangleMesh { vertices: [p, q].concat(), triangles: vec![[0, 1, 2], [3, 4, 5]] };
        let found = self_intersections(&mesh);
        assert_eq!(triangles_meet(p, q), triangles_meet(q, p));
        !found.is_empty()
    }

    const BASE: [DVec3; 3] = [DVec3::ZERO, DVec3::X, DVec3::Y];

    #[test]
    fn orientation_is_positive_above() {
        assert_eq!(orientation(BASE[0], BASE[1], BASE[2], DVec3::Z), 1);
        assert_eq!(orientation(BASE[0], BASE[1], BASE[2], -DVec3::Z), -1);
        assert_eq!(orientation(BASE[0], BASE[1], BASE[2], v(0.3, 0.9, 0.0)), 0);
    }

    #[test]
    fn crossing_touching_and_parted_triangles() {
        assert!(pair(BASE, [v(0.2, 0.2, -1.0), v(0.2, 0.2, 1.0), v(3.0, 3.0, 0.0)]));
        // a corner on the face, and a corner slightly off the face
        assert!(pair(BASE, [v(0.25, 0.25, 0.0), v(0.0, 0.0, 1.0), v(1.0, 0.0, 1.0)]));
        assert!(!pair(BASE, [v(0.25, 0.25, 1e-300), v(0.0, 0.0, 1.0), v(1.0, 0.0, 1.0)]));
        // two edges that cross
        assert!(pair(BASE, [v(0.5, 0.0, -1.0), v(0.5, 0.0, 1.0), v(0.5, -1.0, 0.0)]));
        // parallel
        assert!(!pair(BASE, BASE.map(|p| p + DVec3::Z * 1e-12)));
        // coplanar triangles: overlapping, one inside the other, disjoint, touching at a point
        assert!(pair(BASE, BASE.map(|p| p + v(0.3, 0.3, 0.0))));
        assert!(pair(BASE, BASE.map(|p| p * 0.25 + v(0.25, 0.25, 0.0))));
        assert!(!pair(BASE, BASE.map(|p| p + v(0.6, 0.6, 0.0))));
        assert!(pair(BASE, BASE.map(|p| p + v(0.5, 0.5, 0.0))));
    }

    #[test]
    fn degenerate_triangles_meet_what_their_points_touch() {
        let needle = [v(0.25, 0.25, -1.0), v(0.25, 0.25, 0.5), v(0.25, 0.25, 1.0)];
        assert!(pair(BASE, needle));
        assert!(!pair(BASE, needle.map(|p| p + DVec3::Z * 2.0)));
        assert!(!pair(BASE, needle.map(|p| p + DVec3::X * 2.0)));
        let other = [v(-1.0, 0.25, 0.75), v(1.0, 0.25, 0.75), v(2.0, 0.25, 0.75)];
        assert!(pair(needle, other));
        assert!(!pair(needle, other.map(|p| p + DVec3::Y)));
        let point = [v(0.25, 0.5, 0.0); 3];
        assert!(pair(BASE, point));
        assert!(!pair(BASE, point.map(|p| p + DVec3::X)));
    }

    #[test]
    fn triangles_with_a_common_vertex_may_meet_only_there() {
        let mesh = |a: DVec3, b: DVec3| TriangleMesh {
            vertices: [&BASE[..], &[a, b]].concat(),
            triangles: vec![[0, 1, 2], [4, 0, 3]],
        };
        assert!(self_intersections(&mesh(v(-1.0, 0.0, 0.0), v(0.0, -1.0, 0.5))).is_empty());
        // The edge opposite the common vertex first passes through the other triangle and then
        // beyond it. The triangles intersect in both cases.
        assert_eq!(self_intersections(&mesh(v(0.2, 0.2, -1.0), v(0.2, 0.2, 1.0))), [[0, 1]]);
        assert_eq!(self_intersections(&mesh(v(2.0, 2.0, -1.0), v(2.0, 2.0, 1.0))), [[0, 1]]);
        // coplanar triangles: side by side, and overlapping
        assert!(self_intersections(&mesh(v(-1.0, 0.0, 0.0), v(0.0, -1.0, 0.0))).is_empty());
        assert_eq!(self_intersections(&mesh(v(1.0, 3.0, 0.0), v(3.0, 1.0, 0.0))), [[0, 1]]);
    }

    #[test]
    fn a_folded_pair_and_a_duplicate_are_found() {
        let mesh = |apex: DVec3| TriangleMesh {
            vertices: [&BASE[..], &[apex]].concat(),
            triangles: vec![[0, 1, 2], [1, 0, 3]],
        };
        assert_eq!(self_intersections(&mesh(v(0.7, 0.1, 0.0))), [[0, 1]]);
        assert!(self_intersections(&mesh(v(0.7, 0.1, 1e-300))).is_empty());
        assert!(self_intersections(&mesh(v(0.7, -0.1, 0.0))).is_empty());
        let twice = TriangleMesh { vertices: BASE.to_vec(), triangles: vec![[0, 1, 2], [1, 0, 2]] };
        assert_eq!(self_intersections(&twice), [[0, 1]]);
    }

    #[test]
    fn sound_meshes_have_none_and_two_crossing_spheres_do() {
        let sphere = shapes::icosphere(1.0, 4);
        assert!(self_intersections(&sphere).is_empty());
        assert!(self_intersections(&shapes::torus(3.0, 1.0, 60, 30)).is_empty());
        assert!(self_intersections(&shapes::cuboid(DVec3::ONE)).is_empty());
        let mut moved = sphere.clone();
        for p in &mut moved.vertices {
            p.x += 0.5;
        }
        let both = shapes::union(&[sphere, moved]);
        let found = self_intersections(&both);
        let half = (both.triangles.len() / 2) as u32;
        assert!(found.len() > 50);
        assert!(found.iter().all(|&[a, b]| a < half && b >= half));
        assert!(found.windows(2).all(|w| w[0] < w[1]));
    }

    /// Applies the separating-axis test, which is exact for integers, to two triangles. Returns
    /// whether they intersect. Two triangles are disjoint if and only if their projections onto
    /// some axis are disjoint. It is enough to test the face normals, the cross products of two
    /// edges, and the in-plane edge normals.
    fn reference_meet(p: [[i64; 3]; 3], q: [[i64; 3]; 3]) -> bool {
        let sub = |a: [i64; 3], b: [i64; 3]| std::array::from_fn::<i128, 3, _>(|i| i128::from(a[i]) - i128::from(b[i]));
        let cross = |a: [i128; 3], b: [i128; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let edges = |t: [[i64; 3]; 3]| [sub(t[1], t[0]), sub(t[2], t[1]), sub(t[0], t[2])];
        let (e, f) = (edges(p), edges(q));
        let (n, m) = (cross(e[0], e[1]), cross(f[0], f[1]));
        let mut axes = vec![n, m];
        for a in e {
            axes.push(cross(n, a));
            axes.extend(f.iter().map(|&b| cross(a, b)));
        }
        axes.extend(f.iter().map(|&b| cross(m, b)));
        !axes.iter().any(|&axis| {
            let extent = |t: [[i64; 3]; 3]| {
                let d = t.map(|x| (0..3).map(|i| axis[i] * i128::from(x[i])).sum::<i128>());
                (d[0].min(d[1]).min(d[2]), d[0].max(d[1]).max(d[2]))
            };
            let ((a, b), (c, d)) = (extent(p), extent(q));
            axis != [0; 3] && (b < c || d < a)
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        /// Compares the predicates with the separating-axis test on small integer coordinates, for
        /// which touching and coplanar triangles are frequent.
        #[test]
        fn agrees_with_the_separating_axis_test(
            p in prop::array::uniform3(prop::array::uniform3(-3i64..4)),
            q in prop::array::uniform3(prop::array::uniform3(-3i64..4)),
        ) {
            let real = |t: [[i64; 3]; 3]| t.map(|x| v(x[0] as f64, x[1] as f64, x[2] as f64));
            let has_area = |t: [DVec3; 3]| (t[1] - t[0]).cross(t[2] - t[0]) != DVec3::ZERO;
            prop_assume!(has_area(real(p)) && has_area(real(q)));
            let expected = reference_meet(p, q);
            prop_assert_eq!(triangles_meet(real(p), real(q)), expected);
            prop_assert_eq!(corners_cross([0, 1, 2], real(p), [3, 4, 5], real(q)), expected);
        }

        /// The fast test must never declare two triangles disjoint if the exact test finds an
        /// intersection.
        #[test]
        fn pairs_with_a_common_vertex_agree_with_the_exact_test(
            points in prop::array::uniform5(prop::array::uniform3(-3i8..4)),
            turn_first in 0usize..3,
            turn_second in 0usize..3,
        ) {
            let [s, a, b, c, d] = points.map(|x| v(f64::from(x[0]), f64::from(x[1]), f64::from(x[2])));
            prop_assume!((a - s).cross(b - s) != DVec3::ZERO && (c - s).cross(d - s) != DVec3::ZERO);
            let exact = segment_meets_triangle(a, b, [s, c, d]) || segment_meets_triangle(c, d, [s, a, b]);
            let (p, q) = (turned([s, a, b], turn_first), turned([s, c, d], turn_second));
            let index = |t: [u32; 3], k: usize| [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
            let (i, j) = (index([0, 1, 2], turn_first), index([0, 3, 4], turn_second));
            prop_assert_eq!(corners_cross(i, p, j, q), exact);
        }

        #[test]
        fn does_not_depend_on_order_or_winding(
            p in prop::array::uniform3(prop::array::uniform3(-2i8..3)),
            q in prop::array::uniform3(prop::array::uniform3(-2i8..3)),
        ) {
            let real = |t: [[i8; 3]; 3]| t.map(|x| v(f64::from(x[0]), f64::from(x[1]), f64::from(x[2])));
            let (p, q) = (real(p), real(q));
            let expected = triangles_meet(p, q);
            prop_assert_eq!(triangles_meet(q, p), expected);
            prop_assert_eq!(triangles_meet([p[1], p[0], p[2]], [q[2], q[0], q[1]]), expected);
        }
    }
}
