//! What the device knows of the implicit function: the spline of one object, or the indicators of many materials with the strata of the particles.

use super::constants::HELD_CODE;
use crate::constants::{LAMBDA_GROWTH, LARGEST_LAMBDA, LEAST_LAMBDA};
use isoparticles_field::materials::{Materials, Stratum};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::Geometry;
use std::borrow::Cow;

/// The words in front of the index of materials: where its parts begin.
pub(crate) const INDEX_STARTS: usize = 0;
/// Where the entries begin: material and number of the brick in it.
pub(crate) const INDEX_ENTRIES: usize = 1;
/// Where the materials begin that fill the bricks.
pub(crate) const INDEX_FILL: usize = 2;
/// Where the boxes begin: first node, node behind the last, whether what lies beyond is inside, and a word of no use.
pub(crate) const INDEX_BOXES: usize = 3;
/// Where the blocks begin that each brick reads.
pub(crate) const INDEX_BLOCKS: usize = 4;
/// Where the strata begin: four materials of 16 bits.
pub(crate) const INDEX_STRATA: usize = 5;

/// Strata and particles that are held are numbered below this: 16 times the number is a whole number that f32 holds exactly.
const MOST_STRATA: usize = 1 << 20;

/// The coefficients on the device, and what finds them.
pub(super) struct Ground<'a> {
    pub geometry: &'a Geometry,
    /// Of F, or of all materials one behind the other.
    pub coefficients: Cow<'a, [f32]>,
    /// Of many materials.
    pub index: Option<Vec<u32>>,
}

impl<'a> Ground<'a> {
    /// Of one object.
    pub(super) fn object(surface: &'a CubicSpline) -> Self {
        let coefficients = Cow::Borrowed(surface.coefficients());
        Self { geometry: surface.geometry(), coefficients, index: None }
    }

    /// Of many materials, for particles on these strata.
    pub(super) fn materials(materials: &'a Materials, carried: &Carried) -> Self {
        let bricks = materials.fill().len();
        let mut coefficients = Vec::new();
        let (mut first_brick, mut boxes, mut blocks) = (Vec::new(), Vec::new(), Vec::new());
        let mut known: Vec<Vec<[u32; 2]>> = vec![Vec::new(); bricks];
        for (material, indicator) in (0u32..).zip(materials.indicators()) {
            let first_block = (coefficients.len() / 64) as u32;
            first_brick.push((blocks.len() / 8) as u32);
            let (first, size) = indicator.extent();
            boxes.extend(first.map(|n| n as u32));
            boxes.extend([0, 1, 2].map(|a| (first[a] + size[a]) as u32));
            boxes.extend([u32::from(indicator.surrounds()), 0]);
            for (number, &brick) in (0u32..).zip(indicator.bricks()) {
                known[brick as usize].push([material, first_brick[material as usize] + number]);
            }
            blocks.extend(indicator.blocks().as_flattened().iter().map(|block| first_block + block));
            coefficients.extend_from_slice(indicator.coefficients());
        }
        let mut starts = vec![0u32];
        for entries in &known {
            starts.push(starts[starts.len() - 1] + entries.len() as u32);
        }
        let entries: Vec<u32> = known.iter().flatten().flatten().copied().collect();
        let fill: Vec<u32> = materials.fill().iter().map(|&id| u32::from(id)).collect();
        let strata: Vec<u32> = carried.strata.iter().flat_map(words_of).collect();
        // in the order of the constants above
        let parts = [starts, entries, fill, boxes, blocks, strata];
        let mut index = vec![0u32; 8];
        for (n, part) in parts.iter().enumerate() {
            index[n] = index.len() as u32;
            index.extend_from_slice(part);
        }
        Self { geometry: materials.geometry(), coefficients: Cow::Owned(coefficients), index: Some(index) }
    }
}

/// The materials of a stratum, 16 bits each; 65535 behind the last.
fn words_of(stratum: &Stratum) -> [u32; 2] {
    let mut ids = [u32::from(u16::MAX); 4];
    ids.iter_mut().zip(stratum.materials()).for_each(|(to, id)| *to = u32::from(id.0));
    [ids[0] | ids[1] << 16, ids[2] | ids[3] << 16]
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
