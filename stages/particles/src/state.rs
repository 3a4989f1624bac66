//! The particles while they move: positions with what depends on them, and who interacts with whom.

use crate::constants::{FIRST_RING, LATTICE_NEIGHBOURS, REBUILD_MOVE, SKIN};
use glam::DVec3;
use isoparticles_field::energy::{self, SUPPORT};
use isoparticles_field::neighbours::NeighbourLists;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use rayon::prelude::*;

/// The implicit function and the sizing field that the particles live on.
pub struct Fields<'a> {
    /// F.
    pub surface: &'a CubicSpline,
    /// h.
    pub sizing: &'a SizingField,
}

impl Fields<'_> {
    /// Projects a point onto F = 0; returns position, unit normal and h there.
    pub(crate) fn project(&self, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3, f64)> {
        let (p, gradient) = self.surface.project_with_gradient(start, limit, tolerance)?;
        Some((p, gradient.normalize(), self.sizing.at(p)))
    }
}

/// Particles, their neighbour lists and the classes that may move together.
pub(crate) struct State {
    pub set: ParticleSet,
    /// Normals with a smaller dot product belong to different sheets: such particles do not interact.
    pub normal_agreement: f64,
    pub neighbours: NeighbourLists,
    pub classes: Vec<Vec<u32>>,
    /// Positions at which the lists were made.
    listed: Vec<DVec3>,
}

impl State {
    pub(crate) fn new(set: ParticleSet, normal_agreement: f64) -> Self {
        let mut state = Self::unlisted(set, normal_agreement);
        state.sort_by_place();
        state.rebuild();
        state
    }

    /// The particles in the order they have, without lists.
    pub(crate) fn unlisted(set: ParticleSet, normal_agreement: f64) -> Self {
        Self { set, normal_agreement, neighbours: NeighbourLists::default(), classes: Vec::new(), listed: Vec::new() }
    }

    pub(crate) fn len(&self) -> usize {
        self.set.positions.len()
    }

    /// Orders the particles along a Morton curve, so that neighbours lie near each other in memory.
    pub(crate) fn sort_by_place(&mut self) {
        let positions = &self.set.positions;
        let low = positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = positions.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let scale = f64::from(1u32 << 20) / (high - low).max_element().max(f64::MIN_POSITIVE);
        let mut keyed: Vec<(u64, u32)> = positions
            .par_iter()
            .enumerate()
            .map(|(i, &p)| {
                let cell = (p - low) * scale;
                (spread(cell.x as u64) | spread(cell.y as u64) << 1 | spread(cell.z as u64) << 2, i as u32)
            })
            .collect();
        keyed.par_sort_unstable();
        let order: Vec<u32> = keyed.into_iter().map(|(_, i)| i).collect();
        self.take(&order);
    }

    /// Keeps the particles named by `order`, in that order.
    pub(crate) fn take(&mut self, order: &[u32]) {
        fn pick<T: Copy>(from: &mut Vec<T>, order: &[u32]) {
            *from = order.iter().map(|&i| from[i as usize]).collect();
        }
        let set = &mut self.set;
        pick(&mut set.positions, order);
        pick(&mut set.normals, order);
        pick(&mut set.sizes, order);
        pick(&mut set.energies, order);
        pick(&mut set.lambdas, order);
    }

    /// Makes lists and classes anew.
    pub(crate) fn rebuild(&mut self) {
        self.rebuild_lists();
        self.classes = self.neighbours.independent_classes();
        self.listed.clone_from(&self.set.positions);
    }

    /// Makes the lists anew, for energies only.
    pub(crate) fn rebuild_lists(&mut self) {
        let normals = &self.set.normals;
        let agreement = self.normal_agreement;
        self.neighbours = NeighbourLists::new(&self.set.positions, &self.set.sizes, SUPPORT * (1.0 + SKIN), |i, j| {
            normals[i].dot(normals[j]) > agreement
        });
    }

    /// Makes the lists anew if a particle has moved too far for them; says whether it did.
    pub(crate) fn rebuild_if_moved(&mut self) -> bool {
        let stale = self.listed.len() != self.len()
            || self
                .set
                .positions
                .par_iter()
                .zip(&self.listed)
                .zip(&self.set.sizes)
                .any(|((p, was), h)| p.distance_squared(*was) > (REBUILD_MOVE * h).powi(2));
        if stale {
            self.rebuild();
        }
        stale
    }

    /// Energy (Eq. 1) of a particle of size h at `position`, among the neighbours listed for particle i.
    pub(crate) fn energy_at(&self, i: usize, position: DVec3, h: f64) -> f64 {
        let (positions, sizes) = (&self.set.positions, &self.set.sizes);
        self.neighbours
            .of(i)
            .iter()
            .map(|&j| {
                let j = j as usize;
                let reach = SUPPORT * h.min(sizes[j]);
                let squared = position.distance_squared(positions[j]);
                if squared < reach * reach { energy::pair_energy(squared.sqrt() / reach) } else { 0.0 }
            })
            .sum()
    }

    /// Recomputes every particle's energy and returns their sum, added in a fixed order.
    pub(crate) fn update_energies(&mut self) -> f64 {
        let energies: Vec<f64> = (0..self.len())
            .into_par_iter()
            .map(|i| self.energy_at(i, self.set.positions[i], self.set.sizes[i]))
            .collect();
        let total = energies.iter().sum();
        self.set.energies = energies;
        total
    }

    /// Number of particles that do not have exactly six neighbours in the first ring.
    pub(crate) fn lattice_defects(&self) -> usize {
        let (positions, sizes) = (&self.set.positions, &self.set.sizes);
        let in_ring = |i: usize, j: usize| {
            let reach = FIRST_RING * sizes[i].min(sizes[j]);
            positions[i].distance_squared(positions[j]) < reach * reach
        };
        (0..self.len())
            .into_par_iter()
            .filter(|&i| {
                self.neighbours.of(i).iter().filter(|&&j| in_ring(i, j as usize)).count() as u32 != LATTICE_NEIGHBOURS
            })
            .count()
    }
}

/// Spreads the low 21 bits of a number to every third bit.
fn spread(x: u64) -> u64 {
    let mut x = x & 0x1f_ffff;
    for (shift, mask) in [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ] {
        x = (x | x << shift) & mask;
    }
    x
}
