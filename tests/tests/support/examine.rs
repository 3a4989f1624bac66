//! Examines a triangle mesh independently of the project's own code. Tests also use it to verify
//! the project's own checks.

use glam::DVec3;
use std::collections::HashMap;

/// Properties of a mesh.
#[derive(Clone, Debug)]
pub struct Examination {
    /// Number of directed edges without exactly one opposite edge; 0 for a closed, oriented mesh.
    pub bad_edges: usize,
    /// Connected components.
    pub components: usize,
    /// Sum of the genera of all components, from Euler's formula. It is meaningful only for closed
    /// meshes.
    pub genus: i64,
    /// Sum of the triangles' areas.
    pub area: f64,
    /// Enclosed volume from the divergence theorem; positive if the triangles face outward.
    pub volume: f64,
    /// Centre of mass of the enclosed solid.
    pub centroid: DVec3,
    /// Mean radius ratio: twice the inradius divided by the circumradius.
    pub mean_radius_ratio: f64,
    /// Minimum radius ratio.
    pub smallest_radius_ratio: f64,
}

/// Examines a mesh.
pub fn examine(vertices: &[DVec3], triangles: &[[u32; 3]]) -> Examination {
    let mut directed: HashMap<(u32, u32), usize> = HashMap::new();
    let mut parent: Vec<usize> = (0..vertices.len()).collect();
    let mut used = vec![false; vertices.len()];
    for triangle in triangles {
        for side in 0..3 {
            let (from, to) = (triangle[side], triangle[(side + 1) % 3]);
            *directed.entry((from, to)).or_default() += 1;
            used[from as usize] = true;
            join(&mut parent, from as usize, to as usize);
        }
    }
    let bad_edges =
        directed.iter().filter(|((from, to), count)| **count != 1 || directed.get(&(*to, *from)) != Some(&1)).count();
    let components = (0..vertices.len()).filter(|v| used[*v] && find(&mut parent, *v) == *v).count();
    let euler = used.iter().filter(|u| **u).count() as i64 - (directed.len() / 2) as i64 + triangles.len() as i64;

    let (mut area, mut volume, mut moment) = (0.0, 0.0, DVec3::ZERO);
    let mut ratios = Vec::with_capacity(triangles.len());
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| vertices[v as usize]);
        let normal = (b - a).cross(c - a);
        let tetrahedron = a.dot(b.cross(c)) / 6.0;
        area += 0.5 * normal.length();
        volume += tetrahedron;
        moment += tetrahedron * (a + b + c) / 4.0;
        let sides = [a.distance(b), b.distance(c), c.distance(a)];
        // With the inradius r, the circumradius R and the area A: 2 r / R = 16 A^2 / (perimeter x
        // product of the sides).
        ratios.push(4.0 * normal.length_squared() / (sides.iter().sum::<f64>() * sides.iter().product::<f64>()));
    }
    Examination {
        bad_edges,
        components,
        genus: components as i64 - euler / 2,
        area,
        volume,
        centroid: moment / volume,
        mean_radius_ratio: ratios.iter().sum::<f64>() / ratios.len().max(1) as f64,
        smallest_radius_ratio: ratios.iter().copied().fold(f64::INFINITY, f64::min),
    }
}

fn find(parent: &mut [usize], mut vertex: usize) -> usize {
    while parent[vertex] != vertex {
        parent[vertex] = parent[parent[vertex]];
        vertex = parent[vertex];
    }
    vertex
}

fn join(parent: &mut [usize], a: usize, b: usize) {
    let (a, b) = (find(parent, a), find(parent, b));
    parent[a] = b;
}
