//! Seeds many materials: at junction points, along junction curves and on interfaces.
//!
//! The strata are sampled in the order of their dimension, each with the lower ones held fixed
//! (Meyer, Whitaker, Kirby, Ledergerber and Pfister 2008). Particles at points and on curves are
//! final: equal distances in the metric ds / h minimize the one-dimensional energy. Interfaces are
//! sampled like the surface of one object.

mod curves;
mod program;
mod sheets;

pub use curves::{Curves, seed_curves};
pub(crate) use program::run;
pub use sheets::{Sheets, seed_sheets};

use glam::DVec3;
use isoparticles_field::materials::Materials;
use isoparticles_field::materials::complex::Complex;
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::sizing::SizingField;

/// Statistics of the seeding.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Summary {
    /// Particles at junction points, on junction curves and on interfaces.
    pub particles: [usize; 3],
    /// Junction curves.
    pub curves: usize,
    /// Closed junction curves.
    pub closed_curves: usize,
    /// Components of interfaces.
    pub components: usize,
    /// Components that got extra particles because the sizing field gave them fewer than they need.
    pub underpopulated_components: usize,
    /// Number of particles by the sizing field ([`Complex::predicted_count`]).
    pub predicted_count: f64,
    /// Seeds dropped because the projection onto their stratum failed or another material is nearer
    /// there.
    pub not_projected: usize,
    /// Components of interfaces that were skipped because they are far smaller than a voxel's face.
    pub specks: usize,
    /// Components of interfaces without a particle, because every projection failed.
    pub bare_components: usize,
}

/// Seeds all strata of a complex. Spacings follow `spread`; particles get their sizes from
/// `sizing`. The result depends only on the arguments.
pub fn seed_strata(
    materials: &Materials,
    complex: &Complex,
    (spread, sizing): (&SizingField, &SizingField),
    predicted_count: f64,
    seed: u64,
) -> (ParticleSet, Strata, Summary) {
    let curves = seed_curves(materials, complex, (spread, sizing));
    let sheets = seed_sheets(materials, complex, (spread, sizing), &curves, seed);
    let points = complex.points.len();
    let summary = Summary {
        particles: [points, curves.positions.len() - points, sheets.positions.len()],
        curves: complex.chains.len(),
        closed_curves: complex.chains.iter().filter(|chain| chain.is_closed()).count(),
        components: sheets.components,
        underpopulated_components: sheets.crowded,
        predicted_count,
        not_projected: curves.not_projected + sheets.not_projected,
        specks: sheets.specks,
        bare_components: sheets.bare,
    };
    let Curves { mut positions, mut normals, mut sizes, mut strata, .. } = curves;
    positions.extend(sheets.positions);
    normals.extend(sheets.normals);
    sizes.extend(sheets.sizes);
    strata.of.extend(sheets.of);
    let count = positions.len();
    let geometry = materials.geometry().clone();
    let set =
        ParticleSet { geometry, positions, normals, sizes, energies: vec![0.0; count], lambdas: vec![0.1; count] };
    (set, strata, summary)
}

/// Whether a number is a valid length: finite and positive.
fn is_length(h: f64) -> bool {
    h.is_finite() && h > 0.0
}

/// The point at a share of the way from a to b.
fn between(a: DVec3, b: DVec3, share: f64) -> DVec3 {
    a + (b - a) * share
}
