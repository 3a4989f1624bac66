//! A mesh with the materials on both sides of each triangle, and the segments of its junction
//! curves. One object is the case of two materials: the object and the outside.

use glam::DVec3;
use isoparticles_field::materials::{MaterialId, Stratum};
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::components::DisjointSets;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The two vertices of a segment, the lower number first.
pub type Segment = [u32; 2];

/// Returns the segment between two vertices.
pub fn segment(a: u32, b: u32) -> Segment {
    [a.min(b), a.max(b)]
}

/// An interface: the materials inside and outside of it.
pub type Interface = [MaterialId; 2];

/// A conforming mesh of all interfaces. Interfaces share the vertices and edges at which they meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Interfaces {
    /// Vertices in the grid frame, mm, and triangles, counter-clockwise as seen from outside.
    pub mesh: TriangleMesh,
    /// The materials inside and outside of each triangle. Inside has the higher number, unless
    /// outside is the space beyond a plane ([`Self::first_beyond`]).
    pub between: Vec<[MaterialId; 2]>,
    /// Segments of junction curves, ascending, each with its curve. A vertex that is in no triangle
    /// has the number `u32::MAX`.
    pub segments: Vec<(Segment, Stratum)>,
    /// Vertices at which strata are merged.
    pub joined: Vec<Joined>,
    /// Number of the space beyond the first plane, if the materials end at planes
    /// ([`isoparticles_field::materials::Indicators::first_beyond`]).
    pub first_beyond: Option<MaterialId>,
}

/// A vertex at which strata that are close together are merged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joined {
    /// The vertex; `u32::MAX` if it was removed.
    pub vertex: u32,
    /// Limit of the first-order distance of the vertex from its interfaces, mm.
    pub distance: f64,
}

/// The materials inside and outside of the surface of one object.
pub const OBJECT: [MaterialId; 2] = [MaterialId(1), MaterialId::OUTSIDE];

/// Distance by which a vertex moves away from another part of the surface that touches it, as a
/// share of the distance to the centroid of its own neighbours.
const RETREAT: f64 = 0.2;

impl Interfaces {
    /// Returns the surface of one object, whose triangles face outward.
    pub fn of_object(mesh: TriangleMesh) -> Self {
        let between = vec![OBJECT; mesh.triangles.len()];
        Self { mesh, between, ..Self::default() }
    }

    /// Returns the surface of one object that consists of some triangles between points, and the
    /// index of the point of each vertex.
    pub fn compact_object(points: &[DVec3], triangles: impl Iterator<Item = [u32; 3]>) -> (Self, Vec<u32>) {
        Self::compact(points, triangles.map(|corners| (corners, OBJECT)).collect())
    }

    /// Returns whether the mesh has a single interface, so no junction curves.
    pub fn has_single_interface(&self) -> bool {
        self.between.windows(2).all(|two| two[0] == two[1])
    }

    /// Returns the interfaces that consist of some triangles between points, and the index of the
    /// point of each vertex, ascending. Triangles start with their lowest vertex and are sorted.
    /// The result therefore does not depend on the order of `triangles`, and nearby triangles are
    /// mostly close in memory.
    pub fn compact(points: &[DVec3], mut triangles: Vec<([u32; 3], [MaterialId; 2])>) -> (Self, Vec<u32>) {
        let mut number = vec![u32::MAX; points.len()];
        triangles.iter().flat_map(|(corners, _)| corners).for_each(|&v| number[v as usize] = 0);
        let used: Vec<u32> = (0..points.len() as u32).filter(|&v| number[v as usize] == 0).collect();
        (0..).zip(&used).for_each(|(n, &v)| number[v as usize] = n);
        triangles.par_iter_mut().for_each(|(corners, _)| {
            *corners = corners.map(|v| number[v as usize]);
            let lowest = (0..3).min_by_key(|&k| corners[k]).unwrap_or(0);
            corners.rotate_left(lowest);
        });
        triangles.par_sort_unstable();
        let vertices = used.iter().map(|&v| points[v as usize]).collect();
        let (triangles, between) = triangles.into_iter().unzip();
        (Self { mesh: TriangleMesh { vertices, triangles }, between, ..Self::default() }, used)
    }

    /// Returns each edge together with each of its triangles, ascending.
    pub fn edges(&self) -> Vec<(Segment, u32)> {
        let sides = |(t, v): (usize, &[u32; 3])| {
            let v = *v;
            (0..3).map(move |k| (segment(v[k], v[(k + 1) % 3]), t as u32))
        };
        let mut all: Vec<_> = self.mesh.triangles.par_iter().enumerate().flat_map_iter(sides).collect();
        all.par_sort_unstable();
        all
    }

    /// Returns the edges between different interfaces, ascending, each with the materials of its
    /// triangles (the first four if there are more).
    pub fn edges_of_curves(&self) -> Vec<(Segment, Stratum)> {
        if self.has_single_interface() {
            return Vec::new();
        }
        let curve = |own: &[(Segment, u32)]| {
            let mut ids: Vec<MaterialId> = own.iter().flat_map(|(_, t)| self.between[*t as usize]).collect();
            ids.sort_unstable();
            ids.dedup();
            Some((own[0].0, Stratum::new(&ids[..ids.len().min(4)])?))
        };
        let edges = self.edges();
        edges.chunk_by(|a, b| a.0 == b.0).filter(|own| self.is_of_curve(own)).filter_map(curve).collect()
    }

    /// Returns whether an edge, given with each of its triangles, belongs to more than two
    /// triangles or to triangles of different interfaces.
    pub fn is_of_curve(&self, edge: &[(Segment, u32)]) -> bool {
        let first = self.between[edge[0].1 as usize];
        edge.len() > 2 || edge.iter().any(|(_, t)| self.between[*t as usize] != first)
    }

    /// Returns each vertex together with each of its interfaces, ascending.
    pub fn pairs_at_vertices(&self) -> Vec<(u32, [MaterialId; 2])> {
        let mut first = vec![None; self.mesh.vertices.len()];
        let mut more = Vec::new();
        for (triangle, &pair) in self.mesh.triangles.iter().zip(&self.between) {
            for &v in triangle {
                if *first[v as usize].get_or_insert(pair) != pair {
                    more.push((v, pair));
                }
            }
        }
        let mut all: Vec<_> = (0..).zip(first).filter_map(|(v, pair)| Some((v, pair?))).collect();
        if !more.is_empty() {
            all.extend(more);
            all.par_sort_unstable();
            all.dedup();
        }
        all
    }

    /// Returns the materials at each vertex, ascending.
    pub fn materials_at_vertices(&self) -> Vec<Vec<MaterialId>> {
        let mut at: Vec<Vec<MaterialId>> = vec![Vec::new(); self.mesh.vertices.len()];
        self.pairs_at_vertices().into_iter().for_each(|(v, pair)| at[v as usize].extend(pair));
        at.par_iter_mut().for_each(|ids| {
            ids.sort_unstable();
            ids.dedup();
        });
        at
    }

    /// Returns the dimension of the stratum at each vertex: 2 on interfaces, 1 on curves of three
    /// materials, and 0 at points of more.
    pub fn dimensions(&self) -> Vec<usize> {
        if self.has_single_interface() {
            return vec![2; self.mesh.vertices.len()];
        }
        self.materials_at_vertices().iter().map(|ids| 4usize.saturating_sub(ids.len())).collect()
    }

    /// Returns the regions inside and outside of a triangle.
    pub fn regions_of(&self, triangle: u32) -> [MaterialId; 2] {
        self.between[triangle as usize].map(|id| id.region(self.first_beyond))
    }

    /// Returns the regions that have triangles, ascending.
    pub fn regions(&self) -> Vec<MaterialId> {
        let mut ids: Vec<MaterialId> =
            self.pairs().into_iter().flatten().map(|id| id.region(self.first_beyond)).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Returns the pairs of materials that have triangles between them, ascending.
    pub fn pairs(&self) -> Vec<[MaterialId; 2]> {
        let mut pairs = self.between.clone();
        pairs.dedup();
        pairs.par_sort_unstable();
        pairs.dedup();
        pairs
    }

    /// Returns the closed surface of a region, facing outward, and the indices of its vertices
    /// and of its triangles in the whole mesh.
    pub fn surface_of(&self, id: MaterialId) -> (TriangleMesh, Vec<u32>, Vec<u32>) {
        let own: Vec<u32> = (0..self.between.len() as u32).filter(|&t| self.regions_of(t).contains(&id)).collect();
        let mut vertices: Vec<u32> = own.iter().flat_map(|&t| self.mesh.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let local = |v: u32| vertices.partition_point(|&u| u < v) as u32;
        let triangle = |&t: &u32| {
            let [a, b, c] = self.mesh.triangles[t as usize].map(local);
            if self.regions_of(t)[0] == id { [a, b, c] } else { [a, c, b] }
        };
        let mesh = TriangleMesh {
            vertices: vertices.iter().map(|&v| self.mesh.vertices[v as usize]).collect(),
            triangles: own.iter().map(triangle).collect(),
        };
        (mesh, vertices, own)
    }

    /// Returns the triangles of one interface as a mesh that keeps all vertices.
    pub fn part(&self, pair: [MaterialId; 2]) -> TriangleMesh {
        let own = self.mesh.triangles.iter().zip(&self.between).filter(|(_, between)| **between == pair);
        TriangleMesh { vertices: self.mesh.vertices.clone(), triangles: own.map(|(t, _)| *t).collect() }
    }

    /// Separates parts of an interface that touch at a vertex away from junction curves, and
    /// returns the number of such vertices. Each part gets its own vertex, which moves away from
    /// the others. `project` returns the nearest point of an interface. New vertices come last.
    ///
    /// If a saddle of F has exactly the iso value, as in volumes of integers at an integer iso
    /// value, no sampling separates the parts.
    pub fn separate_touching(&mut self, project: impl Fn([MaterialId; 2], DVec3) -> Option<DVec3>) -> usize {
        let mut around: BTreeMap<u32, Vec<u32>> =
            self.touching_vertices().into_iter().map(|v| (v, Vec::new())).collect();
        if around.is_empty() {
            return 0;
        }
        for (t, triangle) in (0..).zip(&self.mesh.triangles) {
            for v in triangle {
                if let Some(own) = around.get_mut(v) {
                    own.push(t);
                }
            }
        }
        let count = around.len();
        for (vertex, around) in around {
            let pair = self.between[around[0] as usize];
            let apex = self.mesh.vertices[vertex as usize];
            for (n, fan) in fans(&self.mesh, vertex, &around).into_iter().enumerate() {
                let ring = fan.iter().flat_map(|&t| self.mesh.triangles[t as usize]).filter(|v| *v != vertex);
                let centroid = ring.map(|v| self.mesh.vertices[v as usize]).sum::<DVec3>() / (2 * fan.len()) as f64;
                let place = project(pair, apex.lerp(centroid, RETREAT)).unwrap_or(apex);
                if n == 0 {
                    self.mesh.vertices[vertex as usize] = place;
                    continue;
                }
                let new = self.mesh.vertices.len() as u32;
                self.mesh.vertices.push(place);
                for t in fan {
                    let corners = &mut self.mesh.triangles[t as usize];
                    *corners = corners.map(|v| if v == vertex { new } else { v });
                }
            }
        }
        count
    }

    /// Returns the vertices of a single interface whose triangles form several fans, ascending.
    fn touching_vertices(&self) -> Vec<u32> {
        let pairs = self.pairs_at_vertices();
        let on_one = |v: u32| {
            let start = pairs.partition_point(|(u, _)| *u < v);
            pairs[start..].iter().take_while(|(u, _)| *u == v).count() == 1
        };
        let several = isoparticles_mesh::topology::analyse(&self.mesh).non_manifold_vertices;
        several.into_iter().filter(|&v| on_one(v)).collect()
    }
}

/// Returns the triangles at a vertex by fans, whose triangles are connected by edges at the vertex.
fn fans(mesh: &TriangleMesh, vertex: u32, around: &[u32]) -> Vec<Vec<u32>> {
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
    fn parts_that_touch_at_a_vertex_are_separated_once() {
        let top = [DVec3::new(1.0, 0.0, 1.0), DVec3::new(-0.5, 0.8, 1.0), DVec3::new(-0.5, -0.8, 1.0)];
        let mut touching = Interfaces::of_object(TriangleMesh {
            vertices: [vec![DVec3::ZERO], top.to_vec(), top.map(|p| -p).to_vec()].concat(),
            triangles: vec![[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3], [0, 4, 5], [0, 5, 6], [0, 6, 4], [4, 6, 5]],
        });
        let mut part = || touching.separate_touching(|_, p| Some(p));
        assert_eq!([part(), part()], [1, 0]);
        let mesh = touching.mesh;
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 8));
        assert!(mesh.triangles[..4].iter().flatten().all(|&v| v < 4));
        assert!(mesh.triangles[4..].iter().flatten().all(|&v| v >= 4));
        assert!((mesh.vertices[0] - DVec3::new(0.0, 0.0, RETREAT)).length() < 1e-12);
        assert!((mesh.vertices[7] - DVec3::new(0.0, 0.0, -RETREAT)).length() < 1e-12);
    }

    #[test]
    fn vertices_of_junction_curves_are_not_separated() {
        // two fans that touch at vertex 0: one between materials 1 and 0, one between 2 and 0
        let mesh = TriangleMesh {
            vertices: vec![DVec3::ZERO; 7],
            triangles: vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 4, 5], [0, 5, 6], [0, 6, 4]],
        };
        let between = [1, 1, 1, 2, 2, 2].map(|id| [MaterialId(id), MaterialId::OUTSIDE]).to_vec();
        let mut touching = Interfaces { mesh, between, ..Interfaces::default() };
        assert_eq!(touching.separate_touching(|_, p| Some(p)), 0);
        assert_eq!(touching.materials_at_vertices()[0], [0, 1, 2].map(MaterialId));
        assert_eq!(touching.edges().len(), 18);
    }
}
