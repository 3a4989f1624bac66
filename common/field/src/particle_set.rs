//! The particles: what `seed` makes, `particles` settles and `reconstruct` joins into a mesh.

use glam::DVec3;
use isoparticles_volume::Geometry;
use serde::{Deserialize, Serialize};

/// Particles on the isosurface, in the grid frame of the distance field they were made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParticleSet {
    /// Geometry of that distance field.
    pub geometry: Geometry,
    /// Positions, grid frame, mm.
    pub positions: Vec<DVec3>,
    /// Unit normals (gradient of F, outward), grid frame.
    pub normals: Vec<DVec3>,
    /// Target edge length h at each particle, mm.
    pub sizes: Vec<f64>,
    /// Energy of each particle (Eq. 1); zero where not computed yet.
    pub energies: Vec<f64>,
    /// Levenberg-Marquardt damping of each particle.
    pub lambdas: Vec<f64>,
}
