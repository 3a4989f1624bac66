//! Counts and measures the junctions, materials and interfaces of a complex.

use super::Complex;
use crate::TriangleMesh;
use crate::components::DisjointSets;
use crate::topology::{Topology, analyse};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Counts and measures of a complex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Description {
    /// Number of edges that do not lie in exactly two triangles.
    pub junction_edges: usize,
    /// Number of vertices at which one junction edge or more than two of them end.
    pub junction_vertices: usize,
    /// Number of edges by their number of triangles.
    pub edges_by_triangles: BTreeMap<usize, usize>,
    /// Number of vertices by their number of materials.
    pub vertices_by_materials: BTreeMap<usize, usize>,
    /// Root mean square of the angles (degrees) between the normals of two triangles that share an
    /// edge and belong to the same interface.
    pub rms_turn: Option<f64>,
    /// The materials that have triangles, ascending.
    pub materials: Vec<MaterialSummary>,
    /// The interfaces, ascending.
    pub interfaces: Vec<InterfaceSummary>,
}

/// The closed surface of a material.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialSummary {
    /// Number of the material.
    pub number: u32,
    /// Number of vertices that it uses.
    pub vertices: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Topology of its surface.
    pub topology: Topology,
}

/// The triangles between two materials.
#[derive(Clone, Debug, PartialEq)]
pub struct InterfaceSummary {
    /// The two materials.
    pub between: [u32; 2],
    /// Number of pieces that are connected through edges with two triangles.
    pub pieces: usize,
    /// As [`Description::rms_turn`], for this interface.
    pub rms_turn: Option<f64>,
}

/// Sum and number of squared angles.
#[derive(Clone, Copy, Default)]
struct Squares(f64, usize);

impl Squares {
    fn root_mean(self) -> Option<f64> {
        (self.1 > 0).then(|| (self.0 / self.1 as f64).sqrt())
    }
}

impl Complex<'_> {
    /// Counts and measures the complex.
    pub fn describe(&self) -> Description {
        let mut pairs = self.between.to_vec();
        pairs.par_sort_unstable();
        pairs.dedup();
        let of_triangle: Vec<usize> =
            self.between.iter().map(|pair| pairs.partition_point(|other| other < pair)).collect();
        let (pieces, turns) = self.pieces_and_turns(&of_triangle, pairs.len());
        let all = turns.iter().fold(Squares::default(), |sum, own| Squares(sum.0 + own.0, sum.1 + own.1));
        let summary = |((&between, turn), pieces): ((&[u32; 2], Squares), usize)| InterfaceSummary {
            between,
            pieces,
            rms_turn: turn.root_mean(),
        };
        let interfaces = pairs.iter().zip(turns).zip(pieces).map(summary).collect();
        let mut description = Description { rms_turn: all.root_mean(), interfaces, ..self.junctions() };
        let materials = (0..self.materials as u32).into_par_iter().filter_map(|number| self.material(number));
        description.materials = materials.collect();
        description
    }

    /// Returns the number of pieces and the squared angles of each interface.
    fn pieces_and_turns(&self, of_triangle: &[usize], interfaces: usize) -> (Vec<usize>, Vec<Squares>) {
        let mut sets = DisjointSets::new(self.mesh.triangles.len());
        let mut turns = vec![Squares::default(); interfaces];
        let normal = |t: u32| {
            let [a, b, c] = self.mesh.corners(t as usize);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let normals: Vec<DVec3> = (0..self.mesh.triangles.len() as u32).into_par_iter().map(normal).collect();
        for edge in self.edges() {
            let [one, other] = edge else { continue };
            let [one, other] = [one, other].map(|side| side.triangle);
            let interface = of_triangle[one as usize];
            if interface == of_triangle[other as usize] {
                sets.join(one, other);
                let (a, b) = (normals[one as usize], normals[other as usize]);
                let turn = a.cross(b).length().atan2(a.dot(b)).to_degrees();
                turns[interface].0 += turn * turn;
                turns[interface].1 += 1;
            }
        }
        let mut pieces = vec![0; interfaces];
        for t in 0..self.mesh.triangles.len() as u32 {
            pieces[of_triangle[t as usize]] += usize::from(sets.find(t) == t);
        }
        (pieces, turns)
    }

    /// Counts the edges and vertices at which more than one interface meets.
    fn junctions(&self) -> Description {
        let mut description = Description::default();
        let mut ends = vec![0u32; self.mesh.vertices.len()];
        for edge in self.edges() {
            *description.edges_by_triangles.entry(edge.len()).or_insert(0) += 1;
            if edge.len() != 2 {
                description.junction_edges += 1;
                edge[0].edge.iter().for_each(|&v| ends[v as usize] += 1);
            }
        }
        description.junction_vertices = ends.iter().filter(|&&count| count != 0 && count != 2).count();
        let at_corners = |(corners, pair): (&[u32; 3], &[u32; 2])| {
            let pair = *pair;
            corners.map(|v| pair.map(|material| (v, material))).into_iter().flatten()
        };
        let triangles = self.mesh.triangles.par_iter().zip(self.between);
        let mut met: Vec<(u32, u32)> = triangles.flat_map_iter(at_corners).collect();
        met.par_sort_unstable();
        met.dedup();
        for own in met.chunk_by(|a, b| a.0 == b.0) {
            *description.vertices_by_materials.entry(own.len()).or_insert(0) += 1;
        }
        description
    }

    /// Analyses the closed surface of a material, or returns `None` if it has no triangles.
    fn material(&self, number: u32) -> Option<MaterialSummary> {
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        for (&[a, b, c], between) in self.mesh.triangles.iter().zip(self.between) {
            if between[0] == number {
                triangles.push([a, b, c]);
            } else if between[1] == number {
                triangles.push([a, c, b]);
            }
        }
        let mut used: Vec<u32> = triangles.as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        let mut local = vec![0; self.mesh.vertices.len()];
        (0..).zip(&used).for_each(|(n, &v)| local[v as usize] = n);
        triangles.iter_mut().flatten().for_each(|v| *v = local[*v as usize]);
        let vertices: Vec<DVec3> = used.iter().map(|&v| self.mesh.vertices[v as usize]).collect();
        let mesh = TriangleMesh { vertices, triangles };
        let summary = |mesh: TriangleMesh| MaterialSummary {
            number,
            vertices: mesh.vertices.len(),
            triangles: mesh.triangles.len(),
            topology: analyse(&mesh),
        };
        (!mesh.triangles.is_empty()).then(|| summary(mesh))
    }
}
