//! The implicit surface on the device: the spline of one object, or the differences between
//! indicators with the strata of the particles.

use super::constants::HELD_CODE;
use super::differences::Differences;
use crate::constants::{LAMBDA_GROWTH, LARGEST_LAMBDA, LEAST_LAMBDA};
use isoparticles_field::materials::{Materials, Stratum};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::Geometry;
use std::borrow::Cow;

/// Maximum number of interfaces and held particles in total: 16 times the stratum index must be
/// below 2^24, because f32 represents integers up to 2^24 exactly.
const MOST_STRATA: usize = 1 << 20;

/// Coefficients for the device, and the index that locates them.
pub(super) struct DeviceSurface<'a> {
    pub geometry: &'a Geometry,
    /// Coefficients of F, or of the differences between indicators.
    pub coefficients: Cow<'a, [f32]>,
    /// Index of the differences; `None` for one object.
    pub index: Option<Vec<[u32; 4]>>,
}

impl<'a> DeviceSurface<'a> {
    /// Creates the surface of one object.
    pub(super) fn object(surface: &'a CubicSpline) -> Self {
        let coefficients = Cow::Borrowed(surface.coefficients());
        Self { geometry: surface.geometry(), coefficients, index: None }
    }

    /// Creates the surface of many materials, with particles on the strata of `carried`.
    pub(super) fn materials(materials: &'a Materials, carried: &Carried) -> Self {
        let Differences { coefficients, index } = Differences::new(materials, &carried.strata, carried.interfaces);
        Self { geometry: materials.geometry(), coefficients: Cow::Owned(coefficients), index: Some(index) }
    }
}

/// Data stored with the normal of each particle: the damping and, with many materials, the stratum.
///
/// With many materials, both are packed into one number: 16 times the index of the stratum, plus
/// log10(damping / 0.001) or, for a held particle, [`HELD_CODE`]. The interfaces have the lowest
/// indices, in ascending order. Each held particle has a separate index, above the indices of the
/// interfaces.
#[derive(Debug, Default)]
pub(super) struct Carried {
    /// Strata by index; empty for one object.
    strata: Vec<Stratum>,
    /// Number of interfaces among the strata.
    interfaces: usize,
    /// Held particles as uploaded; `None` for one object.
    held: Option<ParticleSet>,
}

impl Carried {
    /// Assigns indices to the strata of multi-material particles. Held particles must come first.
    ///
    /// # Errors
    /// If there are more than [`MOST_STRATA`] interfaces and held particles.
    pub(super) fn new(set: &ParticleSet, of: &[Stratum]) -> Result<Self> {
        let held = of.partition_point(|stratum| stratum.dimension() < 2);
        let mut strata = of[held..].to_vec();
        strata.sort_unstable();
        strata.dedup();
        let interfaces = strata.len();
        strata.extend_from_slice(&of[..held]);
        if strata.len() > MOST_STRATA {
            return Err(Error::gpu(
                format!("{} interfaces and junction particles; the GPU supports {MOST_STRATA}", strata.len()),
                "each particle stores the number of its interface as a 32-bit float",
                "raise SIZE or MIN_SIZE (sizefield --uniform, --min-size), or set BACKEND=cpu (--backend cpu)",
            ));
        }
        let first = |set: &ParticleSet| ParticleSet {
            geometry: set.geometry.clone(),
            positions: set.positions[..held].to_vec(),
            normals: set.normals[..held].to_vec(),
            sizes: set.sizes[..held].to_vec(),
            energies: vec![0.0; held],
            lambdas: set.lambdas[..held].to_vec(),
        };
        Ok(Self { strata, interfaces, held: Some(first(set)) })
    }

    /// Returns the number of held particles.
    pub(super) fn held(&self) -> usize {
        self.strata.len() - self.interfaces
    }

    /// Returns the carried value of particle i with damping `lambda`. `of` contains the strata of
    /// all particles.
    pub(super) fn of(&self, i: usize, lambda: f64, of: &[Stratum]) -> f32 {
        if self.held.is_none() {
            return lambda as f32;
        }
        if i < self.held() {
            return (16 * (self.interfaces + i) as u32 + HELD_CODE) as f32;
        }
        let number = self.strata[..self.interfaces].partition_point(|interface| interface < &of[i]) as u32;
        let power = (lambda.clamp(LEAST_LAMBDA, LARGEST_LAMBDA) / LEAST_LAMBDA).log(LAMBDA_GROWTH).round();
        (16 * number + power as u32) as f32
    }

    /// Restores the order of the particles after a readback: the held particles as uploaded, then
    /// the other particles. Returns the particles and their strata. With one object, returns the
    /// particles unchanged.
    pub(super) fn put_back(&self, mut set: ParticleSet) -> (ParticleSet, Vec<Stratum>) {
        let Some(held) = &self.held else { return (set, Vec::new()) };
        let mut all = held.clone();
        let mut strata = self.strata[self.interfaces..].to_vec();
        for i in 0..set.positions.len() {
            let carried = set.lambdas[i] as u32;
            let (number, power) = ((carried / 16) as usize, carried % 16);
            if power == HELD_CODE {
                continue;
            }
            set.lambdas[i] = LEAST_LAMBDA * LAMBDA_GROWTH.powi(power as i32);
            all.positions.push(set.positions[i]);
            all.normals.push(set.normals[i]);
            all.sizes.push(set.sizes[i]);
            all.energies.push(set.energies[i]);
            all.lambdas.push(set.lambdas[i]);
            strata.push(self.strata[number]);
        }
        (all, strata)
    }
}
