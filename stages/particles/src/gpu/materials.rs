//! What the device knows of the implicit function: the spline of one object, or the differences of many materials with the strata of the particles.

use super::constants::HELD_CODE;
use super::differences::Differences;
use crate::constants::{LAMBDA_GROWTH, LARGEST_LAMBDA, LEAST_LAMBDA};
use isoparticles_field::materials::{Materials, Stratum};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::Geometry;
use std::borrow::Cow;

/// Strata and particles that are held are numbered below this: 16 times the number is a whole number that f32 holds exactly.
const MOST_STRATA: usize = 1 << 20;

/// The coefficients on the device, and what finds them.
pub(super) struct Ground<'a> {
    pub geometry: &'a Geometry,
    /// Of F, or of the differences between materials.
    pub coefficients: Cow<'a, [f32]>,
    /// Of many materials: what finds the differences.
    pub index: Option<Vec<[u32; 4]>>,
}

impl<'a> Ground<'a> {
    /// Of one object.
    pub(super) fn object(surface: &'a CubicSpline) -> Self {
        let coefficients = Cow::Borrowed(surface.coefficients());
        Self { geometry: surface.geometry(), coefficients, index: None }
    }

    /// Of many materials, for particles on these strata.
    pub(super) fn materials(materials: &'a Materials, carried: &Carried) -> Self {
        let Differences { coefficients, index } = Differences::new(materials, &carried.strata, carried.sheets);
        Self { geometry: materials.geometry(), coefficients: Cow::Owned(coefficients), index: Some(index) }
    }
}

/// What goes with each particle beside its normal: its damping, and of many materials its stratum.
///
/// Of many materials it is 16 times the number of the stratum, and the power of ten of the damping, or [`HELD_CODE`]. Sheets are numbered first, ascending, then
/// each particle that is held has a number of its own, by which it is put back in its place.
#[derive(Debug, Default)]
pub(super) struct Carried {
    /// The strata by their numbers; none of one object.
    strata: Vec<Stratum>,
    /// How many of them are sheets.
    sheets: usize,
    /// The particles that are held, as they are.
    held: Option<ParticleSet>,
}

impl Carried {
    /// Numbers the strata of many materials' particles, those that are held first.
    ///
    /// # Errors
    /// When there are too many to number.
    pub(super) fn new(set: &ParticleSet, of: &[Stratum]) -> Result<Self> {
        let held = of.partition_point(|stratum| stratum.dimension() < 2);
        let mut strata = of[held..].to_vec();
        strata.sort_unstable();
        strata.dedup();
        let sheets = strata.len();
        strata.extend_from_slice(&of[..held]);
        if strata.len() > MOST_STRATA {
            return Err(Error::gpu(
                format!("{} sheets and particles of junctions; the GPU numbers {MOST_STRATA}", strata.len()),
                "the number of each travels with the particles",
                "use a larger target edge length, or --backend cpu",
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
        Ok(Self { strata, sheets, held: Some(first(set)) })
    }

    /// How many particles are held.
    pub(super) fn held(&self) -> usize {
        self.strata.len() - self.sheets
    }

    /// What goes with particle i of a damping; `of` are the strata of all.
    pub(super) fn of(&self, i: usize, lambda: f64, of: &[Stratum]) -> f32 {
        if self.held.is_none() {
            return lambda as f32;
        }
        if i < self.held() {
            return (16 * (self.sheets + i) as u32 + HELD_CODE) as f32;
        }
        let number = self.strata[..self.sheets].partition_point(|sheet| sheet < &of[i]) as u32;
        let power = (lambda.clamp(LEAST_LAMBDA, LARGEST_LAMBDA) / LEAST_LAMBDA).log(LAMBDA_GROWTH).round();
        (16 * number + power as u32) as f32
    }

    /// The particles that came back, those that are held first and as they were, with their strata; of one object as they are.
    pub(super) fn put_back(&self, mut set: ParticleSet) -> (ParticleSet, Vec<Stratum>) {
        let Some(held) = &self.held else { return (set, Vec::new()) };
        let mut all = held.clone();
        let mut strata = self.strata[self.sheets..].to_vec();
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
