//! Density control: section 3.3 of the paper.
//!
//! Where the energy says that particles crowd, one goes; where it says that there is room, one is added, in the widest
//! gap between the neighbours. The random bias of Witkin and Heckbert keeps neighbours from acting all at once; on top of
//! it the energies are kept up to date while the pass goes on, so that the first deletion relieves the others (without
//! that, a dense seeding loses far too many particles in one pass).

use crate::movement::TangentPlane;
use crate::state::{Fields, State};
use isoparticles_common::energy::{self, SUPPORT};
use isoparticles_common::random::uniform;

/// When to add and delete, as shares of the ideal energy.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub ideal_energy: f64,
    pub add_below: f64,
    pub delete_above: f64,
}

/// A newcomer keeps this share of h from everybody; the lattice makes room for it in the next passes.
const CLOSEST: f64 = 0.45;

/// What a pass of density control did.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Changes {
    pub inserted: usize,
    pub deleted: usize,
}

/// Deletes, then inserts; energies must be up to date on entry. `allow_insert` is off in the paper's synthetic test.
pub(crate) fn control(
    state: &mut State,
    fields: &Fields,
    limits: &Limits,
    seed: u64,
    pass: u64,
    allow_insert: bool,
) -> Changes {
    let mut energies = state.set.energies.clone();
    let deleted = delete(state, &mut energies, limits, seed, pass);
    let inserted = if allow_insert { insert(state, fields, &mut energies, &deleted, limits, seed, pass) } else { 0 };
    let gone = deleted.iter().filter(|&&d| d).count();
    if gone > 0 {
        let kept: Vec<u32> =
            (0..state.len() as u32).filter(|&i| deleted.get(i as usize).is_none_or(|gone| !gone)).collect();
        state.take(&kept);
    }
    if gone + inserted > 0 {
        state.rebuild();
    }
    Changes { inserted, deleted: gone }
}

/// Marks particles for deletion, the most crowded first.
fn delete(state: &State, energies: &mut [f64], limits: &Limits, seed: u64, pass: u64) -> Vec<bool> {
    let set = &state.set;
    let mut deleted = vec![false; state.len()];
    let bar = limits.delete_above * limits.ideal_energy;
    let mut crowded: Vec<u32> = (0..state.len() as u32).filter(|&i| energies[i as usize] > bar).collect();
    crowded.sort_by(|&a, &b| energies[b as usize].total_cmp(&energies[a as usize]).then(a.cmp(&b)));
    for i in crowded {
        let i = i as usize;
        // Witkin and Heckbert's bias: the excess, times a random number, must exceed the threshold's
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

/// Adds particles (at the end of the set) where the energy is low and a gap has room; says how many.
fn insert(
    state: &mut State,
    fields: &Fields,
    energies: &mut [f64],
    deleted: &[bool],
    limits: &Limits,
    seed: u64,
    pass: u64,
) -> usize {
    let before = state.len();
    let bar = limits.add_below * limits.ideal_energy;
    let mut busy = vec![false; before];
    for i in 0..before {
        if deleted[i] || busy[i] || energies[i] >= bar {
            continue;
        }
        let lack = 1.0 - energies[i] / limits.ideal_energy;
        if uniform(seed, 2 * pass + 1, i as u64) * lack <= 1.0 - limits.add_below {
            continue;
        }
        let Some((position, normal, size)) = place_in_widest_gap(state, fields, deleted, i) else { continue };
        let mut energy = 0.0;
        let mut room = true;
        for j in state.neighbours.of(i).iter().map(|&j| j as usize).chain([i]).filter(|&j| !deleted[j]) {
            let distance = position.distance(state.set.positions[j]);
            let smaller = size.min(state.set.sizes[j]);
            room &= distance > CLOSEST * smaller;
            energy += energy::pair_energy(energy::scaled_distance(distance, smaller, smaller));
        }
        if !room {
            continue;
        }
        // one newcomer a neighbourhood and pass
        for &j in state.neighbours.of(i) {
            busy[j as usize] = true;
        }
        let set = &mut state.set;
        set.positions.push(position);
        set.normals.push(normal);
        set.sizes.push(size);
        set.energies.push(energy);
        set.lambdas.push(crate::INITIAL_LAMBDA);
    }
    state.len() - before
}

/// The point at distance h from particle i in the middle of its widest gap, on the surface.
pub(crate) fn place_in_widest_gap(
    state: &State,
    fields: &Fields,
    deleted: &[bool],
    i: usize,
) -> Option<(glam::DVec3, glam::DVec3, f64)> {
    let set = &state.set;
    let (p, h) = (set.positions[i], set.sizes[i]);
    let plane = TangentPlane::new(set.normals[i]);
    let mut angles: Vec<f64> = state
        .neighbours
        .of(i)
        .iter()
        .map(|&j| j as usize)
        .filter(|&j| !deleted[j] && p.distance(set.positions[j]) < SUPPORT * h)
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
    let start = p + plane.out_of_plane([h * direction.cos(), h * direction.sin()]);
    let tolerance = 1e-5 * fields.surface.geometry().min_spacing();
    let (position, normal, size) = fields.project(start, h, tolerance)?;
    (normal.dot(set.normals[i]) > state.normal_agreement && position.distance(p) > 0.6 * h.min(size))
        .then_some((position, normal, size))
}
