//! Places the seeds of several materials at junction points, along junction curves and on
//! interfaces.
//!
//! The strata are sampled in order of increasing dimension, with the particles on lower-dimensional
//! strata held fixed (Meyer, Whitaker, Kirby, Ledergerber and Pfister 2008). Later stages do not
//! move particles at points and on curves: the particles on a curve are equally spaced in the
//! metric ds / h, which minimizes the one-dimensional energy. Interfaces are sampled like the
//! surface of one object.

mod compute;
mod curves;
mod interfaces;

pub(crate) use compute::compute;
pub use curves::{Curves, seed_curves};
pub use interfaces::{InterfaceParticles, seed_interfaces};

use glam::DVec3;
use isoparticles_field::materials::Materials;
use isoparticles_field::materials::complex::Complex;
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::sizing::SizingField;

/// Statistics of the seeding.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Summary {
    /// Numbers of particles at junction points, on junction curves and on interfaces.
    pub particles: [usize; 3],
    /// Number of junction curves.
    pub curves: usize,
    /// Number of closed junction curves.
    pub closed_curves: usize,
    /// Number of components of interfaces.
    pub components: usize,
    /// Number of components that got extra particles because the sizing field gave them too few.
    pub underpopulated_components: usize,
    /// Number of particles that the sizing field predicts ([`Complex::predicted_count`]).
    pub predicted_count: f64,
    /// Number of seeds dropped because the projection onto their stratum failed or because another
    /// material is nearer at the projected point.
    pub not_projected: usize,
    /// Number of interface components that have no particle because they are far smaller than a
    /// voxel face.
    pub specks: usize,
    /// Number of interface components that have no particle because every projection failed.
    pub bare_components: usize,
}

/// Seeds all strata of a complex. The spacing of the particles follows `spread`; their sizes come
/// from `sizing`. The result depends only on the arguments.
pub fn seed_strata(
    materials: &Materials,
    complex: &Complex,
    (spread, sizing): (&SizingField, &SizingField),
    predicted_count: f64,
    seed: u64,
) -> (ParticleSet, Strata, Summary) {
    let curves = seed_curves(materials, complex, (spread, sizing));
    let interfaces = seed_interfaces(materials, complex, (spread, sizing), &curves, seed);
    let points = complex.points.len();
    let summary = Summary {
        particles: [points, curves.positions.len() - points, interfaces.positions.len()],
        curves: complex.chains.len(),
        closed_curves: complex.chains.iter().filter(|chain| chain.is_closed()).count(),
        components: interfaces.components,
        underpopulated_components: interfaces.crowded,
        predicted_count,
        not_projected: curves.not_projected + interfaces.not_projected,
        specks: interfaces.specks,
        bare_components: interfaces.bare,
    };
    let Curves { mut positions, mut normals, mut sizes, mut strata, .. } = curves;
    positions.extend(interfaces.positions);
    normals.extend(interfaces.normals);
    sizes.extend(interfaces.sizes);
    strata.of.extend(interfaces.of);
    let count = positions.len();
    let geometry = materials.geometry().clone();
    let set =
        ParticleSet { geometry, positions, normals, sizes, energies: vec![0.0; count], lambdas: vec![0.1; count] };
    (set, strata, summary)
}

/// Returns whether a number is a valid length, that is, finite and positive.
fn is_length(h: f64) -> bool {
    h.is_finite() && h > 0.0
}

/// Returns the point a fraction `share` of the way from a to b.
fn between(a: DVec3, b: DVec3, share: f64) -> DVec3 {
    a + (b - a) * share
}
