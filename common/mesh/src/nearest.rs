//! The nearest triangle of a mesh, and the distance to it.

use crate::TriangleMesh;
use crate::spatial::{Bounds, BoxTree};
use glam::DVec3;
use rayon::prelude::*;

/// Returns the triangle nearest to each position, and the distance to it, or `None` if the mesh has
/// no triangles.
pub fn nearest_triangles(mesh: &TriangleMesh, positions: &[DVec3]) -> Option<Vec<(u32, f64)>> {
    let boxes: Vec<Bounds> = (0..mesh.triangles.len()).into_par_iter().map(|t| Bounds::of(&mesh.corners(t))).collect();
    let tree = BoxTree::new(&boxes);
    let nearest = |&p: &DVec3| {
        let (triangle, square) = tree.nearest(p, |t| squared_distance(p, mesh.corners(t as usize)))?;
        Some((triangle, square.sqrt()))
    };
    positions.par_iter().map(nearest).collect()
}

/// Maximum number of positions in [`sampled_distances`]. The 99th percentile then has 2,000
/// positions above it.
pub const MAX_SAMPLES: usize = 200_000;

/// Returns the distances from positions on a mesh to another mesh: from its vertices and the
/// centroids of its triangles, or from every n-th of them if there are more than [`MAX_SAMPLES`].
/// Returns `None` if the other mesh has no triangles.
pub fn sampled_distances(mesh: &TriangleMesh, other: &TriangleMesh) -> Option<Vec<f64>> {
    let mut used = vec![false; mesh.vertices.len()];
    mesh.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
    let vertices = mesh.vertices.iter().zip(used).filter(|(_, used)| *used).map(|(p, _)| *p);
    let centroids = (0..mesh.triangles.len()).map(|t| mesh.corners(t).iter().sum::<DVec3>() / 3.0);
    let samples: Vec<DVec3> = vertices.chain(centroids).collect();
    let step = samples.len().div_ceil(MAX_SAMPLES).max(1);
    let samples: Vec<DVec3> = samples.into_iter().step_by(step).collect();
    Some(nearest_triangles(other, &samples)?.into_iter().map(|(_, distance)| distance).collect())
}

/// Maximum difference of equal distances in [`nearest_flags`], relative to the longest edge of the
/// triangle. Where a flat cap meets a curved wall, both may be the nearest to rounding.
const TIE: f64 = 0.01;

/// Returns the flag of each triangle of a mesh: that of the triangle of `other` nearest to its
/// centroid. Where a triangle with the flag and one without are equally near, the one with the more
/// similar normal counts.
pub fn nearest_flags(mesh: &TriangleMesh, other: &TriangleMesh, flags: &[bool]) -> Vec<bool> {
    let part = |flag: bool| {
        let own = other.triangles.iter().zip(flags).filter(|(_, own)| **own == flag).map(|(corners, _)| *corners);
        TriangleMesh { vertices: other.vertices.clone(), triangles: own.collect() }
    };
    let [with, without] = [true, false].map(part);
    let centroid = |t: usize| mesh.corners(t).iter().sum::<DVec3>() / 3.0;
    let centroids: Vec<DVec3> = (0..mesh.triangles.len()).map(centroid).collect();
    let nearest = |part| nearest_triangles(part, &centroids);
    let Some((nearest_with, nearest_without)) = nearest(&with).and_then(|first| Some((first, nearest(&without)?)))
    else {
        return vec![without.triangles.is_empty(); centroids.len()];
    };
    let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize_or_zero();
    let is_flagged = |t: usize| {
        let corners @ [a, b, c] = mesh.corners(t);
        let ((flagged, distance), (plain, other_distance)) = (nearest_with[t], nearest_without[t]);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        if (distance - other_distance).abs() > TIE * longest {
            return distance < other_distance;
        }
        let own = normal(corners);
        own.dot(normal(with.corners(flagged as usize))) > own.dot(normal(without.corners(plain as usize)))
    };
    (0..centroids.len()).map(is_flagged).collect()
}

/// Returns the squared distance from `p` to a triangle.
fn squared_distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a);
    let sides = [(a, b), (b, c), (c, a)];
    let is_above = |&(from, to): &(DVec3, DVec3)| (to - from).cross(p - from).dot(normal) >= 0.0;
    if normal != DVec3::ZERO && sides.iter().all(is_above) {
        return (p - a).dot(normal).powi(2) / normal.length_squared();
    }
    let to_side = |(from, to): (DVec3, DVec3)| {
        let share = (p - from).dot(to - from) / (to - from).length_squared().max(f64::MIN_POSITIVE);
        p.distance_squared(from.lerp(to, share.clamp(0.0, 1.0)))
    };
    sides.map(to_side).into_iter().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use super::*;
    use isoparticles_field::random::uniform;

    #[test]
    fn distances_to_face_edge_and_corner() {
        let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
        for (p, distance) in [
            (DVec3::new(0.2, 0.3, -2.0), 2.0),
            (DVec3::new(0.5, -3.0, 4.0), 5.0),
            (DVec3::new(-1.0, -2.0, 2.0), 3.0),
            (DVec3::new(1.0, 1.0, 0.0), 0.5f64.sqrt()),
        ] {
            assert!((squared_distance(p, triangle) - distance * distance).abs() < 1e-14);
        }
        assert_eq!(squared_distance(DVec3::Z, [DVec3::ZERO, DVec3::X, DVec3::X * 2.0]), 1.0);
    }

    #[test]
    fn nearest_triangles_are_those_of_a_full_scan() {
        let mesh = shapes::torus(3.0, 1.0, 24, 12);
        let at = |n: u64| 9.0 * DVec3::from_array([0, 1, 2].map(|axis| uniform(5, axis, n) - 0.5));
        let positions: Vec<DVec3> = (0..300).map(at).chain(mesh.vertices.iter().copied()).collect();
        let found = nearest_triangles(&mesh, &positions).expect("the mesh has triangles");
        for (&p, found) in positions.iter().zip(found) {
            let distance = |t: u32| squared_distance(p, mesh.corners(t as usize)).sqrt();
            let least = (0..mesh.triangles.len() as u32).map(distance).fold(f64::INFINITY, f64::min);
            assert!(found.1 == distance(found.0) && found.1 - least < 1e-15, "{found:?} instead of {least}");
        }
        assert_eq!(nearest_triangles(&TriangleMesh::default(), &[DVec3::ZERO]), None);
    }

    #[test]
    fn flags_come_from_the_nearest_triangle_with_the_same_normal() {
        let triangle = |corners: [[f64; 3]; 3]| TriangleMesh {
            vertices: corners.map(DVec3::from_array).to_vec(),
            triangles: vec![[0, 1, 2]],
        };
        let [low, high] = [0.0, 4.0].map(|z| triangle([[0.0, 0.0, z], [1.0, 0.0, z], [0.0, 1.0, z]]));
        let both = shapes::union(&[low.clone(), high.clone()]);
        for flags in [[true, false], [false, true], [true, true], [false, false]] {
            assert_eq!(nearest_flags(&both, &both, &flags), flags);
        }
        let mut back = low.clone();
        back.triangles[0].swap(1, 2);
        let both = shapes::union(&[low, back]);
        assert_eq!(nearest_flags(&both, &both, &[false, true]), [false, true]);
    }

    #[test]
    fn vertices_of_a_larger_sphere_lie_outside_by_its_thickness() {
        let (inner, outer) = (shapes::icosphere(1.0, 4), shapes::icosphere(1.25, 4));
        let distances = sampled_distances(&outer, &inner).expect("the mesh has triangles");
        assert_eq!(distances.len(), outer.vertices.len() + outer.triangles.len());
        let vertices = &distances[..outer.vertices.len()];
        assert!(vertices.iter().all(|distance| (distance - 0.25).abs() < 1e-12));
    }
}
