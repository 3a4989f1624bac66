//! The particles that `seed` creates, `particles` settles and `reconstruct` joins into a mesh.

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
    /// Energy of each particle (Eq. 1); zero if not computed yet.
    pub energies: Vec<f64>,
    /// Levenberg-Marquardt damping of each particle.
    pub lambdas: Vec<f64>,
}

/// Strata of the particles of many materials, in the order of their [`ParticleSet`]: first junction
/// points, then particles on junction curves, then particles on material interfaces.
///
/// On an interface, the normal points from the material of the higher number to that of the lower.
/// On a curve it is the tangent, at a junction point it is zero.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Strata {
    /// The stratum of each particle.
    pub of: Vec<Stratum>,
    /// Pairs of consecutive particles on a junction curve, its ends included (junction points, or
    /// particles on the border of the volume). A closed curve of one particle has no pair, one of
    /// two particles has two.
    pub segments: Vec<[u32; 2]>,
}
