//! The particles while they move: positions with what depends on them, and who interacts with whom.

use crate::constants::{LATTICE_NEIGHBOURS, REBUILD_MOVE, SKIN};
use crate::neighbourhood::{Neighbourhood, Record};
use fearless_simd::{Level, dispatch};
use glam::DVec3;
use isoparticles_field::energy::SUPPORT;
use isoparticles_field::neighbours::{NeighbourLists, space_order};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use rayon::prelude::*;

/// Neighbours are listed within this many times the smaller h.
const LISTED: f64 = SUPPORT * (1.0 + SKIN);

/// Particles that one thread measures at a time.
const CHUNK: usize = 256;

/// The implicit function and the sizing field that the particles live on.
pub struct Fields<'a> {
    /// F.
    pub surface: &'a CubicSpline,
    /// h.
    pub sizing: &'a SizingField,
}

impl Fields<'_> {
    /// Projects a point onto F = 0 (Eq. 5); returns position, unit normal and h there.
    #[inline(always)]
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
    /// Position and h of every particle, as the sums over neighbours read them; as old as the lists, but for what moves.
    pub records: Vec<Record>,
    /// Classes of blocks of particles ([`NeighbourLists::independent_blocks`]).
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
        let (neighbours, records) = (NeighbourLists::default(), Vec::new());
        Self { set, normal_agreement, neighbours, records, classes: Vec::new(), listed: Vec::new() }
    }

    pub(crate) fn len(&self) -> usize {
        self.set.positions.len()
    }

    /// Orders the particles by place, so that neighbours lie near each other in memory.
    pub(crate) fn sort_by_place(&mut self) {
        let order = space_order(&self.set.positions, &self.set.sizes, LISTED);
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
        self.classes = self.neighbours.independent_blocks();
        self.listed.clone_from(&self.set.positions);
    }

    /// Makes the lists anew, for energies only.
    pub(crate) fn rebuild_lists(&mut self) {
        let normals = &self.set.normals;
        let agreement = self.normal_agreement;
        self.neighbours = NeighbourLists::new(&self.set.positions, &self.set.sizes, LISTED, |i, j| {
            normals[i].dot(normals[j]) > agreement
        });
        let places = self.set.positions.iter().zip(&self.set.sizes);
        self.records = places.map(|(&position, &size)| Record::new(position, size)).collect();
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

    /// Recomputes every particle's energy (Eq. 1) and looks for lattice defects.
    pub(crate) fn measure(&mut self) -> Measures {
        let mut energies = std::mem::take(&mut self.set.energies);
        energies.resize(self.len(), 0.0);
        let (positions, sizes) = (&self.set.positions, &self.set.sizes);
        let lattice_defects = energies
            .par_chunks_mut(CHUNK)
            .enumerate()
            .map_init(Neighbourhood::default, |near, (chunk, energies)| {
                dispatch!(Level::new(), simd => {
                    let mut defects = 0;
                    for (i, to) in (chunk * CHUNK..).zip(energies) {
                        near.gather(|j| self.records[j], self.neighbours.of(i), positions[i]);
                        let (energy, ring) = near.energy_and_ring(simd, sizes[i]);
                        *to = energy;
                        defects += usize::from(ring != LATTICE_NEIGHBOURS);
                    }
                    defects
                })
            })
            .sum();
        let energy = energies.iter().sum();
        self.set.energies = energies;
        Measures { energy, lattice_defects }
    }
}

/// What a pass is judged by.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measures {
    /// Sum of the particles' energies, added in a fixed order.
    pub energy: f64,
    /// Particles that do not have exactly six neighbours in the first ring.
    pub lattice_defects: usize,
}
