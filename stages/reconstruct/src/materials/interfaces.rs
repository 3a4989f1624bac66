//! The triangles between materials as one mesh, and the closed surface of each material in it.

use super::complex::Complex;
use super::prepare::onto;
use super::segments::{Segment, segment};
use crate::labelled::Facet;
use crate::pinched::{fans, part_sheets};
use glam::DVec3;
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
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

    /// Parts the sheets of two materials that touch in a vertex, as those of one object are; returns how many such vertices there were. Those that are added lie on
    /// sheets, and come last.
    pub fn part_sheets(&mut self, indicators: &dyn Indicators) -> usize {
        let meets = self.materials_at_vertices();
        let mut around = vec![Vec::new(); meets.len()];
        for (t, corners) in (0..).zip(&self.mesh.triangles) {
            corners.iter().filter(|&&v| meets[v as usize].len() == 2).for_each(|&v| around[v as usize].push(t));
        }
        let mut parted = 0;
        for (v, around) in (0..).zip(around).filter(|(_, around): &(u32, Vec<u32>)| !around.is_empty()) {
            if fans(&self.mesh, v, &around).len() > 1 {
                let [inside, outside] = self.between[around[0] as usize];
                let project = |p: DVec3| onto(indicators, Stratum::interface(inside, outside), p, indicators.voxel());
                part_sheets(&mut self.mesh, &[(v, around)], project);
                parted += 1;
            }
        }
        parted
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

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::materials::{Analytic, ball, minimum, negative};

    #[test]
    fn two_sheets_of_the_same_materials_that_touch_in_a_vertex_are_parted_and_stay_on_their_sheet() {
        // two balls that touch in the origin, each a tetrahedron whose other corners lie more to one side
        let both = || minimum(ball(DVec3::Z, 1.0), ball(-DVec3::Z, 1.0));
        let indicators = Analytic::new(vec![negative(both()), both()], 1.0);
        let ring = [0.0f64, 2.1, 4.2].map(|turn| DVec3::new(0.8 * turn.cos() + 0.4, 0.8 * turn.sin(), 1.6));
        let mut interfaces = Interfaces {
            mesh: TriangleMesh {
                vertices: [vec![DVec3::ZERO], ring.to_vec(), ring.map(|p| -p).to_vec()].concat(),
                triangles: vec![[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3], [0, 4, 5], [0, 5, 6], [0, 6, 4], [4, 6, 5]],
            },
            between: vec![[MaterialId(1), MaterialId(0)]; 8],
            ..Interfaces::default()
        };
        assert_eq!((interfaces.part_sheets(&indicators), interfaces.part_sheets(&indicators)), (1, 0));
        let [upper, lower] = [0, 7].map(|v: usize| interfaces.mesh.vertices[v]);
        for (place, centre) in [(upper, DVec3::Z), (lower, -DVec3::Z)] {
            assert!((place.distance(centre) - 1.0).abs() < 1e-4 && place.length() > 0.1, "{place}");
        }
        assert!(upper.x > 0.1 && lower.x < -0.1, "{upper} {lower}");
    }
}
