//! First particles of many materials: at junction points, along junction curves, on sheets.
//!
//! After Meyer, Whitaker, Kirby, Ledergerber and Pfister 2008 the strata are sampled by their dimension, each with the lower ones held fixed. Points and curves are done
//! here for good: particles at equal distances in the metric ds / h along a curve are where the one-dimensional energy is least. Sheets are sampled as one object is.

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

/// What the seeding did.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Summary {
    /// Particles at junction points, on curves and on sheets.
    pub particles: [usize; 3],
    /// Junction curves, and those of them that are closed.
    pub curves: usize,
    /// Closed ones.
    pub closed_curves: usize,
    /// Components of sheets.
    pub components: usize,
    /// Components that got extra particles, because the sizing field asked for fewer than they need.
    pub underpopulated_components: usize,
    /// Particles that the sizing field asks for ([`Complex::predicted_count`]).
    pub predicted_count: f64,
    /// Seeds dropped because they could not be projected onto their stratum, or because another material is nearer there.
    pub not_projected: usize,
    /// Components of sheets that were left out, since they are far smaller than a voxel's face.
    pub specks: usize,
    /// Components of sheets that got no particle, since no place on them could be met.
    pub bare_components: usize,
}

/// Seeds all strata of a complex; `spread` is the field that spacings follow, `sizing` that which particles get their sizes from. The result depends on the
/// arguments alone.
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

/// Whether a number is a length that a curve can be divided by.
fn is_length(h: f64) -> bool {
    h.is_finite() && h > 0.0
}

/// A place along a line at a share of its step.
fn between(a: DVec3, b: DVec3, share: f64) -> DVec3 {
    a + (b - a) * share
}
