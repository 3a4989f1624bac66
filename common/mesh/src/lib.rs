//! Triangle meshes: the data structure, quality measures, validity checks and file formats.
//!
//! [`quality`] and [`measure`] compute the values of the paper's Table 1 (radius ratio 2r/R,
//! angles, areas). [`topology`], [`intersect`] and [`inside`] check whether a mesh is valid for
//! simulation; geometric tests use exact predicates. [`complex`] does so for many materials.
//! [`spatial`], [`kd_tree`] and [`nearest`] search, [`components`] finds connected components, and
//! [`nesting`] finds which of them lies in which. [`surface`] and [`point_cloud`] read and write
//! files.
//!
//! ```
//! use isoparticles_mesh::{
//!     measure::measure, quality::radius_ratios, shapes::icosphere, topology::analyse,
//! };
//!
//! let ball = icosphere(10.0, 3);
//! assert_eq!(analyse(&ball).components.len(), 1);
//! assert!((measure(&ball).area / (4.0 * std::f64::consts::PI * 100.0) - 1.0).abs() < 0.02);
//! assert!(radius_ratios(&ball).into_iter().all(|ratio| ratio > 0.9));
//! ```

use glam::DVec3;

pub mod buckets;
pub mod complex;
pub mod components;
pub mod difference;
mod error;
pub mod incidence;
pub mod inside;
pub mod intersect;
pub mod kd_tree;
pub mod measure;
pub mod nearest;
pub mod nesting;
pub mod point_cloud;
pub mod points;
pub mod quality;
pub mod shapes;
pub mod spatial;
pub mod surface;
pub mod tetrahedra;
pub mod topology;
mod vtk_legacy;

pub use error::{Error, Result};

/// An indexed triangle mesh. Triangles are counter-clockwise as seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions.
    pub vertices: Vec<DVec3>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Returns the positions of the three corners of a triangle.
    #[inline]
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|v| self.vertices[v as usize])
    }

    /// Returns whether all coordinates are finite and all indices refer to existing vertices. The
    /// other checks assume both conditions.
    pub fn is_well_formed(&self) -> bool {
        let count = self.vertices.len();
        self.vertices.iter().all(|p| p.is_finite()) && self.triangles.iter().flatten().all(|&v| (v as usize) < count)
    }
}
