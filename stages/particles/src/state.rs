//! State of the particles while they move: positions and values derived from them, neighbour lists,
//! and classes of blocks that can move concurrently.

use crate::constants::{CPU_LIST_REACH, FIRST_RING, LATTICE_NEIGHBOURS};
use crate::implicit::Implicit;
use crate::neighbourhood::{Neighbourhood, Record};
use fearless_simd::{Level, dispatch};
use glam::DVec3;
use isoparticles_field::materials::Stratum;
use isoparticles_field::neighbours::{BLOCK, NeighbourLists, space_order};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use rayon::prelude::*;

/// The implicit function and the size field of a run.
pub struct Fields<'a, S = CubicSpline> {
    /// The implicit function F, or the interfaces of many materials.
    pub surface: &'a S,
    /// The target edge length h.
    pub sizing: &'a SizingField,
}

impl<S: Implicit> Fields<'_, S> {
    /// Projects a point onto F = 0 or, with many materials, onto the interface `stratum` (Eq. 5).
    /// Returns position, unit normal and h at the projected point, or `None` if the projection
    /// fails. `limit` and `tolerance` have the same meaning as in [`Implicit::project`].
    #[inline(always)]
    pub(crate) fn project(
        &self,
        stratum: Option<Stratum>,
        start: DVec3,
        limit: f64,
        tolerance: f64,
    ) -> Option<(DVec3, DVec3, f64)> {
        let (p, gradient) = self.surface.project(stratum, start, limit, tolerance)?;
        Some((p, gradient.normalize(), self.sizing.at(p)))
    }
}

/// Particles, their neighbour lists and classes of blocks that can move concurrently.
pub(crate) struct State {
    pub set: ParticleSet,
    /// The stratum of each particle; empty for one object.
    pub strata: Vec<Stratum>,
    /// Number of held particles: the particles of junction points and curves, which come first in
    /// `set`. Zero for one object. Held particles are never moved or deleted, get no newcomers, and
    /// are excluded from the statistics of a pass. Particles on the adjoining interfaces interact
    /// with them.
    pub held: usize,
    /// Minimum dot product of the normals of two interacting particles. If the dot product is
    /// smaller, the particles are assumed to be on different parts of the surface.
    pub normal_agreement: f64,
    /// Edge of the target lattice in units of h ([`crate::Parameters::spacing`]).
    pub spacing: f64,
    pub neighbours: NeighbourLists,
    /// Position and 1/h of every particle, used by the sums over neighbours.
    pub records: Vec<Record>,
    /// Classes of blocks of particles ([`NeighbourLists::independent_blocks`]).
    pub classes: Vec<Vec<u32>>,
}

impl State {
    /// Creates a state for one object: sorts the particles spatially and builds lists and classes.
    #[cfg(test)]
    pub(crate) fn new(set: ParticleSet, normal_agreement: f64) -> Self {
        Self::unlisted(set, normal_agreement).in_order()
    }

    /// Creates a state with the particles in the given order, without lists, for a lattice of
    /// spacing h.
    pub(crate) fn unlisted(set: ParticleSet, normal_agreement: f64) -> Self {
        let (neighbours, records) = (NeighbourLists::default(), Vec::new());
        let (classes, strata) = (Vec::new(), Vec::new());
        Self { set, strata, held: 0, normal_agreement, spacing: 1.0, neighbours, records, classes }
    }

    /// Sets the spacing of the target lattice in units of h.
    pub(crate) fn at_spacing(self, spacing: f64) -> Self {
        Self { spacing, ..self }
    }

    /// Sets the strata of the particles (empty for one object). Particles of junction points and
    /// curves must come first.
    pub(crate) fn on(mut self, strata: Vec<Stratum>) -> Self {
        self.held = strata.partition_point(|stratum| stratum.dimension() < 2);
        self.strata = strata;
        self
    }

    /// Sorts the particles spatially and builds lists and classes.
    #[cfg(test)]
    pub(crate) fn in_order(mut self) -> Self {
        self.sort_spatially();
        self.rebuild();
        self
    }

    /// Returns the stratum of particle i; `None` for one object.
    #[inline(always)]
    pub(crate) fn stratum(&self, i: usize) -> Option<Stratum> {
        self.strata.get(i).copied()
    }

    /// Returns the number of particles that are not held.
    pub(crate) fn movable(&self) -> usize {
        self.len() - self.held
    }

    pub(crate) fn len(&self) -> usize {
        self.set.positions.len()
    }

    /// Sorts the particles spatially to keep neighbours close in memory. Held particles stay at the
    /// front and keep their order.
    pub(crate) fn sort_spatially(&mut self) {
        let held = self.held;
        let order = space_order(&self.set.positions[held..], &self.set.sizes[held..], CPU_LIST_REACH);
        let order: Vec<u32> = (0..held as u32).chain(order.into_iter().map(|i| i + held as u32)).collect();
        self.take(&order);
    }

    /// Keeps the particles whose indices are in `order`, in that order. `order` must begin with all
    /// held particles. The lists are not updated.
    pub(crate) fn take(&mut self, order: &[u32]) {
        fn pick<T: Copy + Send + Sync>(from: &mut Vec<T>, order: &[u32]) {
            *from = order.par_iter().map(|&i| from[i as usize]).collect();
        }
        let set = &mut self.set;
        pick(&mut set.positions, order);
        pick(&mut set.normals, order);
        pick(&mut set.sizes, order);
        pick(&mut set.energies, order);
        pick(&mut set.lambdas, order);
        if !self.strata.is_empty() {
            pick(&mut self.strata, order);
        }
    }

    /// Rebuilds lists and classes.
    pub(crate) fn rebuild(&mut self) {
        self.rebuild_lists();
        self.classes = self.neighbours.independent_blocks();
    }

    /// Rebuilds only the lists, which is enough to compute energies. Particles interact if their
    /// normals agree. With many materials, two particles must also be on the same interface. A held
    /// particle interacts with all particles on the adjoining interfaces, regardless of their
    /// normals.
    pub(crate) fn rebuild_lists(&mut self) {
        let normals = &self.set.normals;
        let agreement = self.normal_agreement;
        let (strata, held) = (&self.strata, self.held);
        let agree = |i: usize, j: usize| normals[i].dot(normals[j]) > agreement;
        let meet = |i: usize, j: usize| match (i < held, j < held) {
            (false, false) => strata[i] == strata[j] && agree(i, j),
            (true, false) => strata[i].is_on(&strata[j]),
            (false, true) => strata[j].is_on(&strata[i]),
            (true, true) => false,
        };
        let (positions, sizes) = (&self.set.positions, &self.set.sizes);
        let former = std::mem::take(&mut self.neighbours);
        self.neighbours = if strata.is_empty() {
            former.anew(positions, sizes, CPU_LIST_REACH, agree)
        } else {
            former.anew(positions, sizes, CPU_LIST_REACH, meet)
        };
        let points = positions.par_iter().zip(sizes);
        points.map(|(&position, &size)| Record::new(position, size)).collect_into_vec(&mut self.records);
    }

    /// Returns whether a held particle is in the first ring of particle i.
    fn is_at_border(&self, i: usize) -> bool {
        let (positions, sizes) = (&self.set.positions, &self.set.sizes);
        let held = self.neighbours.of(i).iter().map(|&j| j as usize).filter(|&j| j < self.held);
        let radius = FIRST_RING * self.spacing;
        held.into_iter().any(|j| positions[i].distance(positions[j]) < radius * sizes[i].min(sizes[j]))
    }

    /// Recomputes the energy of every particle (Eq. 1) and counts lattice defects. Particles with a
    /// held particle in their first ring are not counted, because a particle next to a curved
    /// border need not have six neighbours. Held particles have energy zero.
    pub(crate) fn measure(&mut self) -> Measures {
        let mut energies = std::mem::take(&mut self.set.energies);
        energies.resize(self.len(), 0.0);
        let (positions, sizes) = (&self.set.positions, &self.set.sizes);
        let lattice_defects = energies
            .par_chunks_mut(BLOCK)
            .enumerate()
            .map_init(Neighbourhood::default, |near, (chunk, energies)| {
                dispatch!(Level::new(), simd => {
                    let mut defects = 0;
                    for (i, to) in (chunk * BLOCK..).zip(energies) {
                        if i < self.held {
                            *to = 0.0;
                            continue;
                        }
                        near.gather(|j| self.records[j], self.neighbours.of(i), positions[i]);
                        let (energy, ring) = near.energy_and_ring(simd, sizes[i], self.spacing);
                        *to = energy;
                        defects += usize::from(ring != LATTICE_NEIGHBOURS && (self.held == 0 || !self.is_at_border(i)));
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

/// Total energy and number of lattice defects of the particles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measures {
    /// Sum of the energies of the particles, added in a fixed order.
    pub energy: f64,
    /// Number of lattice defects: particles that do not have exactly six neighbours in the first
    /// ring. Held particles and particles with a held particle in the first ring are not counted.
    pub lattice_defects: usize,
}
