//! Compares two triangle meshes by the positions of their corners.

use crate::TriangleMesh;
use rayon::prelude::*;

/// Returns the number of triangles of the first mesh that the second mesh lacks, and the reverse.
/// Two triangles are equal if their corners have exactly the same coordinates, in the same cyclic
/// order. Vertices of one mesh must have different positions.
pub fn differing_triangles(first: &TriangleMesh, second: &TriangleMesh) -> [usize; 2] {
    let meshes = [first, second];
    let mut places: Vec<([f64; 3], usize, usize)> = Vec::new();
    for (n, mesh) in meshes.iter().enumerate() {
        // adding 0 turns -0 into 0
        places.extend(mesh.vertices.iter().enumerate().map(|(v, &p)| ((p + 0.0).to_array(), n, v)));
    }
    places.par_sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    let mut number = meshes.map(|mesh| vec![0u32; mesh.vertices.len()]);
    for (place, same) in (0..).zip(places.chunk_by(|a, b| a.0 == b.0)) {
        same.iter().for_each(|&(_, n, v)| number[n][v] = place);
    }
    let [one, other] = [0, 1].map(|n| {
        let triangle = |corners: &[u32; 3]| {
            let mut corners = corners.map(|v| number[n][v as usize]);
            let lowest = (0..3).min_by_key(|&k| corners[k]).unwrap_or(0);
            corners.rotate_left(lowest);
            corners
        };
        let mut triangles: Vec<[u32; 3]> = meshes[n].triangles.par_iter().map(triangle).collect();
        triangles.par_sort_unstable();
        triangles.dedup();
        triangles
    });
    let missing = |from: &[[u32; 3]], to: &[[u32; 3]]| from.iter().filter(|t| to.binary_search(t).is_err()).count();
    [missing(&one, &other), missing(&other, &one)]
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use super::*;

    #[test]
    fn renumbered_vertices_do_not_matter_and_flipped_triangles_do() {
        let sphere = shapes::icosphere(1.0, 2);
        let count = sphere.vertices.len() as u32;
        let mut other = sphere.clone();
        other.vertices.reverse();
        other.triangles.iter_mut().for_each(|t| *t = [t[1], t[2], t[0]].map(|v| count - 1 - v));
        assert_eq!(differing_triangles(&sphere, &other), [0, 0]);
        other.triangles[5].swap(0, 1);
        other.triangles.truncate(300);
        assert_eq!(differing_triangles(&sphere, &other), [21, 1]);
        let around = sphere.triangles.iter().filter(|t| t.contains(&7)).count();
        let mut moved = sphere.clone();
        moved.vertices[7] *= 1.0 + 1e-15;
        assert_eq!(differing_triangles(&sphere, &moved), [around, around]);
    }
}
