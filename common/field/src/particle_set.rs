//! The particles that `seed` creates, `particles` moves into equilibrium and `reconstruct` connects
//! into a mesh.

use crate::materials::Stratum;
use glam::DVec3;
use isoparticles_volume::Geometry;
use serde::{Deserialize, Serialize};

/// Particles on the isosurface, in the grid frame of the distance field from which they were
/// created.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParticleSet {
    /// Geometry of the distance field.
    pub geometry: Geometry,
    /// Positions in the grid frame, mm.
    pub positions: Vec<DVec3>,
    /// Unit normals in the grid frame (direction of the gradient of F, outward).
    pub normals: Vec<DVec3>,
    /// Target edge length h at each particle in mm.
    pub sizes: Vec<f64>,
    /// Energy of each particle (Eq. 1). Zero if not computed yet.
    pub energies: Vec<f64>,
    /// Levenberg-Marquardt damping parameter of each particle.
    pub lambdas: Vec<f64>,
}

/// The strata of multi-material particles, in the order of the [`ParticleSet`]: first junction
/// points, then particles on junction curves, then particles on material interfaces.
///
/// On an interface, the normal points from the material with the higher number to the material with
/// the lower number. On a curve, the normal is replaced by the tangent. At a junction point, it is
/// zero.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Strata {
    /// Stratum of each particle.
    pub of: Vec<Stratum>,
    /// Pairs of consecutive particles on a junction curve. They include the ends of the curve,
    /// which are junction points or particles on the border of the volume. A closed curve of one
    /// particle has no pair; a closed curve of two particles has two pairs.
    pub segments: Vec<[u32; 2]>,
}
