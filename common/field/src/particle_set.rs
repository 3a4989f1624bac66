//! The particles: what `seed` makes, `particles` settles and `reconstruct` joins into a mesh.

use crate::materials::Stratum;
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

/// Where the particles of many materials live, beside their [`ParticleSet`], in the same order: junction points first, then those on junction
/// curves, then those on sheets.
///
/// On a sheet the normal is that of the sheet, from the material of the higher number to that of the lower; on a curve it is the tangent; at a point it is zero.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Strata {
    /// The stratum of each particle.
    pub of: Vec<Stratum>,
    /// Pairs of particles that follow each other on a junction curve, its ends (junction points, or where it meets the border of the volume) included. A
    /// closed curve of one particle has none, one of two has two.
    pub segments: Vec<[u32; 2]>,
}
