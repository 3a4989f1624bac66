//! Vertices where two sheets of the surface touch in a point. Where a saddle of F lies on F = 0 to the last digit, as happens
//! at whole-numbered iso values of whole-numbered volumes, no sampling parts the sheets; the mesh must decide. It parts them:
//! each sheet gets a vertex of its own, drawn back a little into that sheet.

use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::components::DisjointSets;
use isoparticles_mesh::topology::analyse;
use std::collections::BTreeMap;

/// How far a vertex is drawn back, as a share of the way to the middle of its neighbours.
const RETREAT: f64 = 0.2;

/// Parts the sheets of a mesh at vertices that have more than one fan of triangles, each given by the triangles at it;
/// `project` brings a point back to F = 0. Returns the number of vertices added.
pub fn part_sheets(
    mesh: &mut TriangleMesh,
    pinched: &[(u32, Vec<u32>)],
    project: impl Fn(DVec3) -> Option<DVec3>,
) -> usize {
    let mut added = 0;
    for (vertex, around) in pinched {
        let apex = mesh.vertices[*vertex as usize];
        for (n, fan) in fans(mesh, *vertex, around).into_iter().enumerate() {
            let ring = fan.iter().flat_map(|&t| mesh.triangles[t as usize]).filter(|v| v != vertex);
            let middle = ring.map(|v| mesh.vertices[v as usize]).sum::<DVec3>() / (2 * fan.len()) as f64;
            let place = project(apex.lerp(middle, RETREAT)).unwrap_or(apex);
            if n == 0 {
                mesh.vertices[*vertex as usize] = place;
                continue;
            }
            let new = mesh.vertices.len() as u32;
            mesh.vertices.push(place);
            for t in fan {
                mesh.triangles[t as usize].iter_mut().filter(|v| **v == *vertex).for_each(|v| *v = new);
            }
            added += 1;
        }
    }
    added
}

/// The vertices of a closed mesh that have more than one fan of triangles, each with the triangles at it.
pub fn pinched_vertices(mesh: &TriangleMesh) -> Vec<(u32, Vec<u32>)> {
    with_triangles(mesh, analyse(mesh).non_manifold_vertices)
}

/// A few vertices, ascending, each with the triangles at it.
pub(crate) fn with_triangles(mesh: &TriangleMesh, vertices: impl IntoIterator<Item = u32>) -> Vec<(u32, Vec<u32>)> {
    let mut all: BTreeMap<u32, Vec<u32>> = vertices.into_iter().map(|v| (v, Vec::new())).collect();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for v in triangle {
            if let Some(around) = all.get_mut(v) {
                around.push(t as u32);
            }
        }
    }
    all.into_iter().collect()
}

/// The triangles at a vertex, by the fans that they form across their edges.
pub(crate) fn fans(mesh: &TriangleMesh, vertex: u32, around: &[u32]) -> Vec<Vec<u32>> {
    let ring = |t: u32| mesh.triangles[t as usize].into_iter().filter(move |&v| v != vertex);
    let mut joined = DisjointSets::new(around.len());
    for (i, &s) in around.iter().enumerate() {
        for (j, &t) in around[..i].iter().enumerate() {
            if ring(s).any(|v| ring(t).any(|w| v == w)) {
                joined.join(i as u32, j as u32);
            }
        }
    }
    let mut fans: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (i, &t) in around.iter().enumerate() {
        fans.entry(joined.find(i as u32)).or_default().push(t);
    }
    fans.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_tetrahedra_that_touch_in_a_point_are_parted() {
        let top = [DVec3::new(1.0, 0.0, 1.0), DVec3::new(-0.5, 0.8, 1.0), DVec3::new(-0.5, -0.8, 1.0)];
        let mut mesh = TriangleMesh {
            vertices: [vec![DVec3::ZERO], top.to_vec(), top.map(|p| -p).to_vec()].concat(),
            triangles: vec![[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3], [0, 4, 5], [0, 5, 6], [0, 6, 4], [4, 6, 5]],
        };
        let pinched = [(0, vec![0, 1, 2, 4, 5, 6])];
        assert_eq!(part_sheets(&mut mesh, &pinched, Some), 1);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 8));
        assert!(mesh.triangles[..4].iter().flatten().all(|&v| v < 4));
        assert!(mesh.triangles[4..].iter().flatten().all(|&v| v >= 4));
        assert!((mesh.vertices[0] - DVec3::new(0.0, 0.0, RETREAT)).length() < 1e-12);
        assert!((mesh.vertices[7] - DVec3::new(0.0, 0.0, -RETREAT)).length() < 1e-12);
    }
}
