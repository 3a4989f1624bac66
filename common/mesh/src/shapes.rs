//! Creates meshes of known shape and topology (icosphere, torus, box), for tests and as simple
//! initial meshes.

use super::TriangleMesh;
use glam::DVec3;
use std::collections::HashMap;
use std::f64::consts::TAU;

/// Creates a sphere around the origin from an icosahedron by splitting each triangle into four,
/// `levels` times. The sphere has 20 * 4^levels triangles, which face outward. All vertices are at
/// distance `radius` from the origin.
pub fn icosphere(radius: f64, levels: usize) -> TriangleMesh {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let mut vertices = Vec::new();
    for (a, b) in [(1.0, golden), (1.0, -golden), (-1.0, golden), (-1.0, -golden)] {
        vertices.push(DVec3::new(0.0, a, b));
        vertices.push(DVec3::new(a, b, 0.0));
        vertices.push(DVec3::new(b, 0.0, a));
    }
    let side = 2.0;
    let mut triangles = Vec::new();
    // the faces are the triples of vertices that are a distance `side` apart
    for a in 0..12u32 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let [p, q, r] = [a, b, c].map(|v| vertices[v as usize]);
                if [p.distance(q), q.distance(r), r.distance(p)].iter().all(|d| (d - side).abs() < 1e-9) {
                    let outward = (q - p).cross(r - p).dot(p) > 0.0;
                    triangles.push(if outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..levels {
        let mut middle = HashMap::new();
        let mut cut = |vertices: &mut Vec<DVec3>, a: u32, b: u32| {
            *middle.entry((a.min(b), a.max(b))).or_insert_with(|| {
                vertices.push(0.5 * (vertices[a as usize] + vertices[b as usize]));
                vertices.len() as u32 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (cut(&mut vertices, a, b), cut(&mut vertices, b, c), cut(&mut vertices, c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    let vertices = vertices.into_iter().map(|p| p.normalize() * radius).collect();
    TriangleMesh { vertices, triangles }
}

/// Creates a torus around the z axis with `around` vertices along the ring and `across` vertices
/// around the tube (at least 3 each). The triangles face outward.
pub fn torus(ring_radius: f64, tube_radius: f64, around: usize, across: usize) -> TriangleMesh {
    let (around, across) = (around.max(3), across.max(3));
    let mut mesh = TriangleMesh::default();
    for i in 0..around {
        let u = TAU * i as f64 / around as f64;
        for j in 0..across {
            let v = TAU * j as f64 / across as f64;
            let distance = ring_radius + tube_radius * v.cos();
            mesh.vertices.push(DVec3::new(distance * u.cos(), distance * u.sin(), tube_radius * v.sin()));
        }
    }
    let at = |i: usize, j: usize| ((i % around) * across + j % across) as u32;
    for i in 0..around {
        for j in 0..across {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// Creates a box with one corner at the origin and the opposite corner at `size`. The box has
/// twelve triangles, which face outward.
pub fn cuboid(size: DVec3) -> TriangleMesh {
    let vertices =
        (0..8u32).map(|c| DVec3::new(f64::from(c & 1), f64::from(c >> 1 & 1), f64::from(c >> 2 & 1)) * size).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    TriangleMesh { vertices, triangles }
}

/// Concatenates meshes without merging vertices.
pub fn union(parts: &[TriangleMesh]) -> TriangleMesh {
    let mut whole = TriangleMesh::default();
    for part in parts {
        let offset = whole.vertices.len() as u32;
        whole.vertices.extend(&part.vertices);
        whole.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + offset)));
    }
    whole
}
