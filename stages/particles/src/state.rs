//! The particles while they move: positions with what depends on them, and who interacts with whom.

use crate::constants::{FIRST_RING, LATTICE_NEIGHBOURS, LISTED};
use crate::implicit::Implicit;
use crate::neighbourhood::{Neighbourhood, Record};
use fearless_simd::{Level, dispatch};
use glam::DVec3;
use isoparticles_field::materials::Stratum;
use isoparticles_field::neighbours::{NeighbourLists, space_order};
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use rayon::prelude::*;

/// Particles that one thread measures at a time.
const CHUNK: usize = 256;

/// The implicit function and the sizing field that the particles live on.
pub struct Fields<'a, S = CubicSpline> {
    /// F, or the sheets of many materials.
    pub surface: &'a S,
    /// h.
    pub sizing: &'a SizingField,
}

impl<S: Implicit> Fields<'_, S> {
    /// Projects a point onto F = 0, or onto the sheet that is its stratum (Eq. 5); returns position, unit normal and h there.
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

/// Particles, their neighbour lists and the classes that may move together.
pub(crate) struct State {
    pub set: ParticleSet,
    /// The stratum of each particle; empty of one object.
    pub strata: Vec<Stratum>,
    /// How many particles are held, the first ones: those of junction points and curves. They are never moved, deleted or given newcomers, and nothing is
    /// counted of them; those on the sheets around them see them. None of one object.
    pub held: usize,
    /// Normals with a smaller dot product belong to different sheets: such particles do not interact.
    pub normal_agreement: f64,
    /// Edge of the lattice that they are to form, in h ([`crate::Parameters::spacing`]).
    pub spacing: f64,
    pub neighbours: NeighbourLists,
    /// Position and h of every particle, as the sums over neighbours read them.
    pub records: Vec<Record>,
    /// Classes of blocks of particles ([`NeighbourLists::independent_blocks`]).
    pub classes: Vec<Vec<u32>>,
}

impl State {
    /// The particles of one object, in order of place.
    #[cfg(test)]
    pub(crate) fn new(set: ParticleSet, normal_agreement: f64) -> Self {
        Self::unlisted(set, normal_agreement).in_order()
    }

    /// The particles in the order they have, without lists, that are to form a lattice of spacing h.
    pub(crate) fn unlisted(set: ParticleSet, normal_agreement: f64) -> Self {
        let (neighbours, records) = (NeighbourLists::default(), Vec::new());
        let (classes, strata) = (Vec::new(), Vec::new());
        Self { set, strata, held: 0, normal_agreement, spacing: 1.0, neighbours, records, classes }
    }

    /// The same particles, to form a lattice of this spacing, in h.
    pub(crate) fn at_spacing(self, spacing: f64) -> Self {
        Self { spacing, ..self }
    }

    /// The same particles on these strata, lower ones first; none are those of one object.
    pub(crate) fn on(mut self, strata: Vec<Stratum>) -> Self {
        self.held = strata.partition_point(|stratum| stratum.dimension() < 2);
        self.strata = strata;
        self
    }

    /// The same particles in order of place, with lists and classes.
    #[cfg(test)]
    pub(crate) fn in_order(mut self) -> Self {
        self.sort_by_place();
        self.rebuild();
        self
    }

    /// The stratum of particle i; of one object it has none.
    #[inline(always)]
    pub(crate) fn stratum(&self, i: usize) -> Option<Stratum> {
        self.strata.get(i).copied()
    }

    /// How many particles are not held.
    pub(crate) fn movable(&self) -> usize {
        self.len() - self.held
    }

    pub(crate) fn len(&self) -> usize {
        self.set.positions.len()
    }

    /// Orders the particles by place, so that neighbours lie near each other in memory. Those that are held stay in front as they are.
    pub(crate) fn sort_by_place(&mut self) {
        let held = self.held;
        let order = space_order(&self.set.positions[held..], &self.set.sizes[held..], LISTED);
        let order: Vec<u32> = (0..held as u32).chain(order.into_iter().map(|i| i + held as u32)).collect();
        self.take(&order);
    }

    /// Keeps the particles named by `order`, in that order; those that are held must come first, all of them. The lists are still the former ones.
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

    /// Makes lists and classes anew.
    pub(crate) fn rebuild(&mut self) {
        self.rebuild_lists();
        self.classes = self.neighbours.independent_blocks();
    }

    /// Makes the lists anew, for energies only. Particles see each other where their normals agree; of many materials those of one sheet alone, and on each sheet
    /// those that are held on its border: these keep the sheets apart.
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
            former.anew(positions, sizes, LISTED, agree)
        } else {
            former.anew(positions, sizes, LISTED, meet)
        };
        let places = positions.par_iter().zip(sizes);
        places.map(|(&position, &size)| Record::new(position, size)).collect_into_vec(&mut self.records);
    }

    /// Whether particle i has one that is held in its first ring.
    fn is_at_border(&self, i: usize) -> bool {
        let (positions, sizes) = (&self.set.positions, &self.set.sizes);
        let held = self.neighbours.of(i).iter().map(|&j| j as usize).filter(|&j| j < self.held);
        let radius = FIRST_RING * self.spacing;
        held.into_iter().any(|j| positions[i].distance(positions[j]) < radius * sizes[i].min(sizes[j]))
    }

    /// Recomputes every particle's energy (Eq. 1) and looks for lattice defects: next to a border of a sheet the lattice cannot have its six neighbours
    /// wherever the border bends, and nobody is counted there. Those that are held have no energy of their own.
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

/// What a pass is judged by.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measures {
    /// Sum of the particles' energies, added in a fixed order.
    pub energy: f64,
    /// Particles that do not have exactly six neighbours in the first ring.
    pub lattice_defects: usize,
}
