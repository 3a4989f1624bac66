//! Counts the parts and cavities of a surface and measures the enclosed volume.

use isoparticles_mesh::{TriangleMesh, components};
use serde::Serialize;

/// Counts of the parts of a closed surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Parts {
    /// Number of connected surfaces that bound a part of the object from the outside.
    pub components: usize,
    /// Number of connected surfaces that bound a cavity.
    pub cavities: usize,
    /// Enclosed volume, without the cavities, mm^3.
    pub volume: f64,
}

impl Parts {
    /// Counts the connected surfaces of an outward-oriented mesh. Surfaces with negative volume are
    /// cavities.
    pub fn of(mesh: &TriangleMesh) -> Self {
        let (component, count) = components::of_vertices(mesh.vertices.len(), &mesh.triangles);
        let mut volume = vec![0.0; count];
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
            volume[component[t[0] as usize] as usize] += a.dot(b.cross(c)) / 6.0;
        }
        let cavities = volume.iter().filter(|v| **v < 0.0).count();
        Self { components: volume.len() - cavities, cavities, volume: volume.iter().sum() }
    }
}
