//! The triangles between materials as one mesh, and the closed surface of each material in it.

use super::complex::Complex;
use super::segments::{Segment, segment};
use crate::labelled::Facet;
use isoparticles_field::materials::{MaterialId, Stratum};
use isoparticles_mesh::TriangleMesh;
use rayon::prelude::*;

/// One conforming mesh of all interfaces; vertices are shared wherever sheets meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Interfaces {
    /// Vertices, grid frame, and triangles, counter-clockwise seen from outside: from the material of the lower number.
    pub mesh: TriangleMesh,
    /// The materials inside (the higher number) and outside of each triangle.
    pub between: Vec<[MaterialId; 2]>,
    /// Segments of junction curves by the vertices of the mesh, `u32::MAX` for one that is in no triangle; each with its curve.
    pub segments: Vec<(Segment, Stratum)>,
    /// Vertices that lie on one of several curves that are one: on the others' sheets but for a twentieth of a voxel.
    pub joined: Vec<u32>,
}

/// An edge with its triangles.
pub type Edge = ([u32; 2], Vec<u32>);

impl Interfaces {
    /// The facets of a complex, and the dimension of the stratum of each vertex.
    pub fn of(complex: &Complex, facets: &[Facet]) -> (Self, Vec<usize>) {
        let mut number = vec![u32::MAX; complex.points().len()];
        facets.iter().flat_map(|f| f.vertices).for_each(|v| number[v as usize] = 0);
        let (mut vertices, mut dimensions) = (Vec::new(), Vec::new());
        for (v, number) in number.iter_mut().enumerate().filter(|(_, number)| **number == 0) {
            *number = vertices.len() as u32;
            vertices.push(complex.points()[v]);
            dimensions.push(complex.strata[v].dimension());
        }
        let triangles = facets.iter().map(|f| f.vertices.map(|v| number[v as usize])).collect();
        let between = facets.iter().map(|f| complex.sheet(f)).collect();
        let segments = complex.segments.all().map(|(pair, curve)| (pair.map(|v| number[v as usize]), curve)).collect();
        let joined = complex.joined.iter().map(|&v| number[v as usize]).filter(|&v| v != u32::MAX).collect();
        (Self { mesh: TriangleMesh { vertices, triangles }, between, segments, joined }, dimensions)
    }

    /// All edges in order, lower vertex first, with their triangles, ascending.
    pub fn edges(&self) -> Vec<Edge> {
        let sides = |(t, v): (u32, &[u32; 3])| [0, 1, 2].map(|k| (segment(v[k], v[(k + 1) % 3]), t));
        let mut all: Vec<([u32; 2], u32)> = (0..).zip(&self.mesh.triangles).flat_map(sides).collect();
        all.par_sort_unstable();
        all.chunk_by(|a, b| a.0 == b.0).map(|edge| (edge[0].0, edge.iter().map(|(_, t)| *t).collect())).collect()
    }

    /// The materials at each vertex, ascending.
    pub fn materials_at_vertices(&self) -> Vec<Vec<MaterialId>> {
        let mut at = vec![Vec::new(); self.mesh.vertices.len()];
        for (triangle, between) in self.mesh.triangles.iter().zip(&self.between) {
            for &v in triangle {
                for &id in between {
                    if !at[v as usize].contains(&id) {
                        at[v as usize].push(id);
                    }
                }
            }
        }
        at.iter_mut().for_each(|ids| ids.sort_unstable());
        at
    }

    /// The materials that have triangles, ascending.
    pub fn materials(&self) -> Vec<MaterialId> {
        let mut ids: Vec<MaterialId> = self.between.iter().flatten().copied().collect();
        ids.par_sort_unstable();
        ids.dedup();
        ids
    }

    /// The pairs of materials that have triangles between them, ascending.
    pub fn pairs(&self) -> Vec<[MaterialId; 2]> {
        let mut pairs = self.between.clone();
        pairs.par_sort_unstable();
        pairs.dedup();
        pairs
    }

    /// The closed surface of a material, outward, and the number of each of its vertices and triangles in the whole.
    pub fn surface_of(&self, id: MaterialId) -> (TriangleMesh, Vec<u32>, Vec<u32>) {
        let own: Vec<u32> =
            (0..self.between.len() as u32).filter(|&t| self.between[t as usize].contains(&id)).collect();
        let mut vertices: Vec<u32> = own.iter().flat_map(|&t| self.mesh.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let local = |v: u32| vertices.partition_point(|&u| u < v) as u32;
        let triangle = |&t: &u32| {
            let [a, b, c] = self.mesh.triangles[t as usize].map(local);
            if self.between[t as usize][0] == id { [a, b, c] } else { [a, c, b] }
        };
        let mesh = TriangleMesh {
            vertices: vertices.iter().map(|&v| self.mesh.vertices[v as usize]).collect(),
            triangles: own.iter().map(triangle).collect(),
        };
        (mesh, vertices, own)
    }

    /// Some triangles by themselves.
    pub fn part(&self, is_in: impl Fn([MaterialId; 2]) -> bool) -> TriangleMesh {
        let own = self.mesh.triangles.iter().zip(&self.between).filter(|(_, between)| is_in(**between));
        TriangleMesh { vertices: self.mesh.vertices.clone(), triangles: own.map(|(t, _)| *t).collect() }
    }
}
