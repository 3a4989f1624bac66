//! Reference for the tests of the SIMD sums and of the GPU kernels: energies and forces, summed
//! pair by pair. The reference uses the tangent function; the tested code uses polynomials.

use crate::state::{Fields, State};
use glam::{DMat3, DVec3};
use isoparticles_field::energy::{pair_energy, pair_jet, pair_size_derivative, scaled_distance};

/// Returns the energy, gradient and Hessian of particle i at its position. The gradient includes
/// the effect of the change in the particle's own h with position; the Hessian is for fixed h.
pub(crate) fn energy_jet<S>(state: &State, fields: &Fields<S>, i: usize) -> (f64, DVec3, DMat3) {
    let set = &state.set;
    let (position, size) = (set.positions[i], set.sizes[i]);
    let mut sum = (0.0, DVec3::ZERO, DMat3::ZERO);
    let mut by_size = 0.0;
    for &j in state.neighbours.of(i) {
        let j = j as usize;
        let offset = position - set.positions[j];
        let (energy, gradient, hessian) = pair_jet(offset, size, set.sizes[j]);
        sum = (sum.0 + energy, sum.1 + gradient, sum.2 + hessian);
        by_size += pair_size_derivative(offset.length(), size, set.sizes[j]);
    }
    (sum.0, sum.1 + fields.sizing.value_gradient(position).1 * by_size, sum.2)
}

/// Returns the energy (Eq. 1) that particle i would have at `position` with size h. The sum is over
/// the particles in its neighbour list.
pub(crate) fn energy_at(state: &State, i: usize, position: DVec3, h: f64) -> f64 {
    let set = &state.set;
    let pair = |j: usize| pair_energy(scaled_distance(position.distance(set.positions[j]), h, set.sizes[j]));
    state.neighbours.of(i).iter().map(|&j| pair(j as usize)).sum()
}
