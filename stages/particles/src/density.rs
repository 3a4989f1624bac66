//! Density control (section 3.3 of the paper).
//!
//! A particle whose energy is too high (oversampling) is deleted. A particle whose energy is too
//! low (undersampling) gets a newcomer in the widest gap between its neighbours. The random bias of
//! Witkin and Heckbert makes it unlikely that two neighbours are both deleted, or both get
//! newcomers, in the same pass. In addition, each deletion immediately updates the energies of the
//! neighbours. Without this update, one pass would delete far too many particles of dense seeds.

use crate::constants::{INITIAL_LAMBDA, NEWCOMER_DISTANCE, PARENT_DISTANCE, PASS_TOLERANCE};
use crate::implicit::Implicit;
use crate::neighbourhood::TangentPlane;
use crate::state::{Fields, State};
use glam::DVec3;
use isoparticles_field::energy::{self, SUPPORT};
use isoparticles_field::neighbours::NeighbourLists;
use isoparticles_field::random::uniform;
use rayon::prelude::*;

/// The ideal energy, and the limits for adding and deleting particles as multiples of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub ideal_energy: f64,
    pub add_below: f64,
    pub delete_above: f64,
}

/// Numbers of particles added and deleted by density control in one pass.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Changes {
    pub inserted: usize,
    pub deleted: usize,
}

/// Deletes particles, then inserts newcomers if `allow_insert` is true. The energies must be up to
/// date. The neighbour lists are not updated.
pub(crate) fn control<S: Implicit>(
    state: &mut State,
    fields: &Fields<S>,
    limits: &Limits,
    seed: u64,
    pass: u64,
    allow_insert: bool,
) -> Changes {
    let mut energies = state.set.energies.clone();
    let deleted = delete(state, &mut energies, limits, seed, pass);
    let newcomers =
        if allow_insert { insert(state, fields, &energies, &deleted, limits, seed, pass) } else { Vec::new() };
    let gone = deleted.iter().filter(|&&d| d).count();
    let inserted = newcomers.len();
    if gone + inserted > 0 {
        // insert each newcomer next to its parent to preserve the spatial order
        let mut order = Vec::with_capacity(deleted.len() + inserted);
        let mut newcomers = newcomers.iter().zip(deleted.len() as u32..).peekable();
        for (i, &is_deleted) in deleted.iter().enumerate() {
            if !is_deleted {
                order.push(i as u32);
            }
            while let Some((_, number)) = newcomers.next_if(|(newcomer, _)| newcomer.parent == i) {
                order.push(number);
            }
        }
        state.take(&order);
    }
    Changes { inserted, deleted: gone }
}

/// Marks particles for deletion in descending order of energy. Subtracts the pair energies of each
/// deleted particle from the energies of its neighbours.
fn delete(state: &State, energies: &mut [f64], limits: &Limits, seed: u64, pass: u64) -> Vec<bool> {
    let set = &state.set;
    let mut deleted = vec![false; state.len()];
    let bar = limits.delete_above * limits.ideal_energy;
    let mut oversampled: Vec<u32> =
        (state.held as u32..state.len() as u32).filter(|&i| energies[i as usize] > bar).collect();
    oversampled.sort_by(|&a, &b| energies[b as usize].total_cmp(&energies[a as usize]).then(a.cmp(&b)));
    for i in oversampled {
        let i = i as usize;
        // bias of Witkin and Heckbert: the excess times a random number must exceed the threshold
        let excess = energies[i] / limits.ideal_energy - 1.0;
        if uniform(seed, 2 * pass, i as u64) * excess <= limits.delete_above - 1.0 {
            continue;
        }
        deleted[i] = true;
        for &j in state.neighbours.of(i) {
            let j = j as usize;
            let d = energy::scaled_distance(set.positions[i].distance(set.positions[j]), set.sizes[i], set.sizes[j]);
            energies[j] -= energy::pair_energy(d);
        }
    }
    deleted
}

/// A candidate for insertion.
pub(crate) struct Newcomer {
    /// Index of the particle that proposes the newcomer.
    parent: usize,
    pub position: DVec3,
    normal: DVec3,
    pub size: f64,
}

/// Adds a newcomer next to each particle (its parent) that has low energy and a sufficiently wide
/// gap between its neighbours. Returns the newcomers in the order of their parents.
///
/// Two newcomers conflict if their parents are neighbours, or if they are on the same interface and
/// closer together than [`NEWCOMER_DISTANCE`] spacings. Of two conflicting newcomers, at most one
/// is added per pass. Priority goes to the parent with the smaller index on the CPU, and to the
/// parent with the higher random number on the GPU.
fn insert<S: Implicit>(
    state: &mut State,
    fields: &Fields<S>,
    energies: &[f64],
    deleted: &[bool],
    limits: &Limits,
    seed: u64,
    pass: u64,
) -> Vec<Newcomer> {
    let before = state.len();
    let settled: &State = state;
    let newcomers: Vec<Newcomer> = (state.held..before)
        .into_par_iter()
        .filter(|&i| {
            // bias of Witkin and Heckbert, as in `delete`
            let lack = 1.0 - energies[i] / limits.ideal_energy;
            let bar = 1.0 - limits.add_below;
            !deleted[i] && lack > bar && uniform(seed, 2 * pass + 1, i as u64) * lack > bar
        })
        .filter_map(|i| propose(settled, fields, deleted, i))
        .collect();
    let positions: Vec<DVec3> = newcomers.iter().map(|n| n.position).collect();
    let sizes: Vec<f64> = newcomers.iter().map(|n| n.size).collect();
    let near = NeighbourLists::new(&positions, &sizes, NEWCOMER_DISTANCE * state.spacing, |a, b| {
        newcomers[a].normal.dot(newcomers[b].normal) > state.normal_agreement
            && state.stratum(newcomers[a].parent) == state.stratum(newcomers[b].parent)
    });
    let mut spoken_for = vec![false; before];
    let mut chosen = vec![false; newcomers.len()];
    for (n, newcomer) in newcomers.iter().enumerate() {
        if spoken_for[newcomer.parent] || near.of(n).iter().any(|&other| chosen[other as usize]) {
            continue;
        }
        chosen[n] = true;
        for &j in state.neighbours.of(newcomer.parent) {
            spoken_for[j as usize] = true;
        }
        state.strata.extend(state.stratum(newcomer.parent));
        let set = &mut state.set;
        set.positions.push(newcomer.position);
        set.normals.push(newcomer.normal);
        set.sizes.push(newcomer.size);
        set.energies.push(0.0);
        set.lambdas.push(INITIAL_LAMBDA);
    }
    let mut chosen = chosen.into_iter();
    newcomers.into_iter().filter(|_| chosen.next() == Some(true)).collect()
}

/// Proposes a newcomer in the widest gap between the neighbours of particle i. Returns `None` if
/// `place_in_widest_gap` finds no position or if a neighbour of particle i is closer than
/// [`NEWCOMER_DISTANCE`] spacings to the newcomer.
pub(crate) fn propose<S: Implicit>(state: &State, fields: &Fields<S>, deleted: &[bool], i: usize) -> Option<Newcomer> {
    let (position, normal, size) = place_in_widest_gap(state, fields, deleted, i)?;
    let set = &state.set;
    let distance = NEWCOMER_DISTANCE * state.spacing;
    let has_room = state
        .neighbours
        .of(i)
        .iter()
        .map(|&j| j as usize)
        .filter(|&j| !deleted[j])
        .all(|j| position.distance(set.positions[j]) > distance * size.min(set.sizes[j]));
    has_room.then_some(Newcomer { parent: i, position, normal, size })
}

/// Finds the widest angular gap between the neighbours of particle i that are closer than the
/// second ring. Projects the point one spacing from the particle, in the middle of this gap, onto
/// the surface. Returns the position, normal and h of the projected point. Returns `None` if the
/// projection fails, the normals disagree, or the point is closer than [`PARENT_DISTANCE`] spacings
/// to particle i.
fn place_in_widest_gap<S: Implicit>(
    state: &State,
    fields: &Fields<S>,
    deleted: &[bool],
    i: usize,
) -> Option<(DVec3, DVec3, f64)> {
    let set = &state.set;
    let (p, edge) = (set.positions[i], state.spacing * set.sizes[i]);
    let plane = TangentPlane::new(set.normals[i]);
    let mut angles: Vec<f64> = state
        .neighbours
        .of(i)
        .iter()
        .map(|&j| j as usize)
        .filter(|&j| !deleted[j] && p.distance(set.positions[j]) < SUPPORT * edge)
        .map(|j| {
            let offset = set.positions[j] - p;
            plane.v.dot(offset).atan2(plane.u.dot(offset))
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    let mut direction = 0.0;
    if let Some(&first) = angles.first() {
        let mut widest = 0.0;
        for (k, &a) in angles.iter().enumerate() {
            let next = angles.get(k + 1).copied().unwrap_or(first + std::f64::consts::TAU);
            if next - a > widest {
                widest = next - a;
                direction = 0.5 * (a + next);
            }
        }
    }
    let start = p + plane.out_of_plane([edge * direction.cos(), edge * direction.sin()]);
    let tolerance = PASS_TOLERANCE * fields.surface.min_spacing();
    let (position, normal, size) = fields.project(state.stratum(i), start, edge, tolerance)?;
    (normal.dot(set.normals[i]) > state.normal_agreement
        && position.distance(p) > PARENT_DISTANCE * edge.min(state.spacing * size))
    .then_some((position, normal, size))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::Scene;
    use crate::settle::Parameters;
    use std::collections::HashSet;

    /// Runs density control, without deletion, on the seeds of a scene. Returns the indices of the
    /// newcomers and the resulting state.
    fn controlled(scene: &Scene, pass: u64) -> (Vec<usize>, State) {
        let parameters = Parameters::default();
        let mut state = State::new(scene.seeds.clone(), parameters.normal_agreement);
        state.measure();
        // the high limit prevents deletion, so that the tests can check the distance of each
        // newcomer from every particle
        let limits =
            Limits { ideal_energy: parameters.ideal_energy, add_below: parameters.add_below, delete_above: 1e9 };
        let before: HashSet<_> = state.set.positions.iter().map(|p| p.to_array().map(f64::to_bits)).collect();
        let changes = control(&mut state, &scene.fields(), &limits, 0, pass, true);
        let is_new = |i: &usize| !before.contains(&state.set.positions[*i].to_array().map(f64::to_bits));
        let newcomers: Vec<usize> = (0..state.len()).filter(is_new).collect();
        assert_eq!(newcomers.len(), changes.inserted);
        (newcomers, state)
    }

    #[test]
    fn newcomers_keep_their_distance_on_an_interface() {
        let tori = (120..420).step_by(100).map(Scene::bumpy_torus);
        let balls = (40..400).step_by(60).map(|n| Scene::ball(n, 1.6));
        let mut came = 0;
        for scene in tori.chain(balls).chain([Scene::meeting_newcomers()]) {
            for pass in 1..4 {
                let (newcomers, state) = controlled(&scene, pass);
                let set = &state.set;
                for i in newcomers {
                    came += 1;
                    for j in (0..state.len())
                        .filter(|&j| j != i && set.normals[i].dot(set.normals[j]) > state.normal_agreement)
                    {
                        let apart = set.positions[i].distance(set.positions[j]) / set.sizes[i].min(set.sizes[j]);
                        assert!(apart >= NEWCOMER_DISTANCE, "{i}: {apart} h from {j}");
                    }
                }
            }
        }
        assert!(came > 500, "{came} newcomers: too few for a test");
    }
}
