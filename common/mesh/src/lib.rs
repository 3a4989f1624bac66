//! The triangle mesh that the pipeline hands on, and everything it is judged by.
//!
//! [`quality`] and [`measure`] give the figures of the paper's Table 1 (radius ratio 2r/R, angles, areas);
//! [`topology`], [`intersect`] and [`inside`] say exactly, by exact predicates, whether a mesh is what a simulation
//! may be run on. [`surface`] and [`point_cloud`] read and write the files.

use glam::DVec3;

pub mod components;
pub mod incidence;
pub mod inside;
pub mod intersect;
pub mod kd_tree;
pub mod measure;
pub mod point_cloud;
pub mod points;
pub mod quality;
pub mod shapes;
pub mod spatial;
pub mod surface;
pub mod topology;

/// Indexed triangles, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions.
    pub vertices: Vec<DVec3>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// The three corners of a triangle.
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|v| self.vertices[v as usize])
    }

    /// Whether every coordinate is a number and every index names a vertex: what the other checks take for granted.
    pub fn is_well_formed(&self) -> bool {
        let count = self.vertices.len();
        self.vertices.iter().all(|p| p.is_finite()) && self.triangles.iter().flatten().all(|&v| (v as usize) < count)
    }
}
