//! One pass of movement: sections 3.2.1 and 3.2.2 and Algorithm 1 of the paper.
//!
//! A particle takes a damped Newton step on its energy in the tangent plane of F and is then
//! projected back onto F = 0 (Eq. 5). The step is accepted if it lowers the energy. Otherwise the
//! damping lambda is multiplied by ten and the particle tries again. The particles of a block move
//! one after the other. The blocks of an independent class do not interact and move concurrently.
//! The pass is therefore the paper's Gauss-Seidel sweep in another order, and its result does not
//! depend on the number of threads.

use crate::constants::{
    EIGENVALUE_FLOOR, EQUAL_EIGENVALUES_F64, FARTHEST_MOVE, LAMBDA_FALL, LAMBDA_GROWTH, LARGEST_LAMBDA, LEAST_FORCE,
    LEAST_LAMBDA, LONGEST_STEP, PASS_TOLERANCE, PROJECTION_REACH,
};
use crate::implicit::Implicit;
use crate::neighbourhood::{Neighbourhood, Record, TangentPlane};
use crate::state::{Fields, State};
use fearless_simd::{Level, Simd, dispatch};
use glam::DVec3;
use isoparticles_field::neighbours::BLOCK;
use isoparticles_mesh::buckets::ranges_mut;
use rayon::prelude::*;
use std::ops::Range;

/// Statistics of a movement pass.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Moves {
    /// Number of particles that took a step.
    pub moved: usize,
    /// Number of attempted steps, including rejected steps.
    pub tries: usize,
}

/// Result of the movement of one particle.
#[derive(Clone, Copy)]
pub(crate) struct Step {
    pub position: DVec3,
    normal: DVec3,
    size: f64,
    lambda: f64,
    tries: u32,
    pub moved: bool,
}

/// Returns the particles of a block, except held particles.
fn members_of(state: &State, block: u32) -> Range<usize> {
    let end = state.len().min((block as usize + 1) * BLOCK);
    (block as usize * BLOCK).max(state.held).min(end)..end
}

/// Moves every particle once, except held particles.
pub(crate) fn pass<S: Implicit>(state: &mut State, fields: &Fields<S>) -> Moves {
    let mut moves = Moves::default();
    let classes = std::mem::take(&mut state.classes);
    for class in &classes {
        let settled: &State = state;
        let steps: Vec<Vec<Step>> = class
            .par_iter()
            .map_init(Neighbourhood::default, |near, &block| {
                block_steps(settled, fields, near, members_of(settled, block))
            })
            .collect();
        let ranges: Vec<Range<usize>> = class.iter().map(|&block| members_of(state, block)).collect();
        let set = &mut state.set;
        let points = ranges_mut(&mut set.positions, &ranges).into_par_iter().zip(ranges_mut(&mut set.normals, &ranges));
        let others = ranges_mut(&mut set.sizes, &ranges).into_par_iter().zip(ranges_mut(&mut set.lambdas, &ranges));
        let records = ranges_mut(&mut state.records, &ranges);
        points.zip(others).zip(records).zip(&steps).for_each(
            |((((positions, normals), (sizes, lambdas)), records), steps)| {
                for (k, step) in steps.iter().enumerate() {
                    (positions[k], normals[k]) = (step.position, step.normal);
                    (sizes[k], lambdas[k]) = (step.size, step.lambda);
                    records[k] = Record::new(step.position, step.size);
                }
            },
        );
        for step in steps.iter().flatten() {
            moves.tries += step.tries as usize;
            moves.moved += usize::from(step.moved);
        }
    }
    state.classes = classes;
    moves
}

/// Moves the particles of a block one after the other, using the best SIMD instructions that the
/// processor supports.
fn block_steps<S: Implicit>(
    state: &State,
    fields: &Fields<S>,
    near: &mut Neighbourhood,
    members: Range<usize>,
) -> Vec<Step> {
    let mut steps = Vec::with_capacity(members.len());
    // records of the particles of this block, updated as the particles move; their neighbours in
    // other blocks do not move at the same time
    let mut own = state.records[members.clone()].to_vec();
    let first = members.start;
    dispatch!(Level::new(), simd => {
        for i in members {
            let record_of = |j: usize| own.get(j.wrapping_sub(first)).copied().unwrap_or_else(|| state.records[j]);
            near.gather(record_of, state.neighbours.of(i), state.set.positions[i]);
            let step = step(simd, state, fields, near, i);
            if step.moved {
                own[i - first] = Record::new(step.position, step.size);
            }
            steps.push(step);
        }
    });
    steps
}

/// Returns the step of a single particle.
#[cfg(test)]
pub(crate) fn step_alone<S: Implicit>(state: &State, fields: &Fields<S>, i: usize) -> Step {
    block_steps(state, fields, &mut Neighbourhood::default(), i..i + 1)[0]
}

/// Finds the next position of particle i (Algorithm 1). `near` contains its neighbours.
#[inline(always)]
fn step<L: Simd, S: Implicit>(simd: L, state: &State, fields: &Fields<S>, near: &Neighbourhood, i: usize) -> Step {
    let set = &state.set;
    let (position, normal, size) = (set.positions[i], set.normals[i], set.sizes[i]);
    let mut result = Step { position, normal, size, lambda: set.lambdas[i], tries: 0, moved: false };
    let plane = TangentPlane::new(normal);
    let jet = near.jet(simd, &plane, size);
    if jet.energy == 0.0 {
        return result;
    }
    // Eq. 4 plus the term for the change in the particle's own h with position; the Hessian is for
    // fixed h
    let along_size = plane.coordinates(fields.sizing.value_gradient(position).1);
    let force = [0, 1].map(|a| jet.gradient[a] + jet.by_size * along_size[a]);
    if (force[0] * force[0] + force[1] * force[1]).sqrt() * size < LEAST_FORCE * jet.energy {
        return result;
    }
    let curvature = positive_definite(jet.hessian);
    let tolerance = PASS_TOLERANCE * fields.surface.min_spacing();
    let mut lambda = set.lambdas[i];
    while lambda < LARGEST_LAMBDA {
        result.tries += 1;
        let motion = plane.out_of_plane(damped_newton(&curvature, force, lambda)).clamp_length_max(LONGEST_STEP * size);
        let limit = motion.length() + PROJECTION_REACH * size;
        if let Some((p, n, h)) = fields.project(state.stratum(i), position + motion, limit, tolerance)
            && n.dot(normal) > 0.0
            && p.distance_squared(position) < (FARTHEST_MOVE * size).powi(2)
            && near.energy(simd, p - position, h) < jet.energy
        {
            let lambda = if result.tries == 1 { (LAMBDA_FALL * lambda).max(LEAST_LAMBDA) } else { lambda };
            return Step { position: p, normal: n, size: h, lambda, moved: true, ..result };
        }
        lambda *= LAMBDA_GROWTH;
    }
    // no attempt was accepted; lambda keeps its value from before the pass, as in Algorithm 1
    result
}

/// Replaces the eigenvalues of a symmetric 2 x 2 matrix (entries uu, uv, vv) with their magnitudes,
/// bounded away from zero. The Newton step then points in a descent direction.
#[inline(always)]
fn positive_definite(m: [f64; 3]) -> [f64; 3] {
    let [a, b, c] = m;
    let (mean, half) = (0.5 * (a + c), (0.25 * (a - c) * (a - c) + b * b).sqrt());
    let (low, high) = (mean - half, mean + half);
    let floor = EIGENVALUE_FLOOR * low.abs().max(high.abs());
    let (l, h) = (low.abs().max(floor), high.abs().max(floor));
    if half <= EQUAL_EIGENVALUES_F64 * mean.abs() {
        return [l, 0.0, l];
    }
    // the eigenvector of the larger eigenvalue is (cos t, sin t); `cos2` and `sin2` are the cosine
    // and sine of 2 t
    let (cos2, sin2) = (0.5 * (a - c) / half, b / half);
    let (middle, spread) = (0.5 * (l + h), 0.5 * (h - l));
    [middle + spread * cos2, spread * sin2, middle - spread * cos2]
}

/// Solves (H + lambda diag H) x = -g (Eq. 3, with H as the sum over the neighbours).
#[inline(always)]
fn damped_newton(h: &[f64; 3], g: [f64; 2], lambda: f64) -> [f64; 2] {
    let (a, b, c) = (h[0] * (1.0 + lambda), h[1], h[2] * (1.0 + lambda));
    let determinant = a * c - b * b;
    [-(c * g[0] - b * g[1]) / determinant, -(a * g[1] - b * g[0]) / determinant]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::UNSEEN_DISTANCE;
    use crate::scenes::Scene;

    #[test]
    fn unlisted_particles_stay_beyond_the_first_ring() {
        // twice as many particles as the lattice of edge h has, at random positions: dense
        // particles take the longest steps
        let scene = Scene::ball(1600, 1.6);
        let fields = scene.fields();
        let mut state = State::new(scene.seeds.clone(), 0.0);
        let (mut farthest, mut nearest) = (0.0f64, f64::INFINITY);
        for _ in 0..12 {
            state.rebuild();
            let before = state.set.positions.clone();
            pass(&mut state, &fields);
            let set = &state.set;
            for (i, was) in before.iter().enumerate() {
                farthest = farthest.max(was.distance(set.positions[i]) / set.sizes[i]);
                let seen = state.neighbours.of(i);
                for j in (0..i).filter(|&j| set.normals[i].dot(set.normals[j]) > 0.1 && !seen.contains(&(j as u32))) {
                    nearest = nearest.min(set.positions[i].distance(set.positions[j]) / set.sizes[i].min(set.sizes[j]));
                }
            }
        }
        println!("moves up to {farthest} h, unseen pairs from {nearest} h");
        assert!(farthest > 0.2 && farthest < FARTHEST_MOVE, "moves up to {farthest} h");
        assert!(nearest > UNSEEN_DISTANCE, "{nearest} h apart and not in each other's lists");
    }

    #[test]
    fn newton_step_solves_the_damped_system() {
        let h = [3.0, 0.7, 2.0];
        let x = damped_newton(&h, [0.4, -0.9], 0.25);
        assert!((h[0] * 1.25 * x[0] + h[1] * x[1] + 0.4).abs() < 1e-14);
        assert!((h[1] * x[0] + h[2] * 1.25 * x[1] - 0.9).abs() < 1e-14);
    }

    #[test]
    fn only_indefinite_matrices_are_made_positive_definite() {
        let good = [3.0, 0.7, 2.0];
        let kept = positive_definite(good);
        assert!(good.iter().zip(kept).all(|(a, b)| (a - b).abs() < 1e-12), "{kept:?}");
        for m in [[1.0, 0.0, -2.0], [-1.0, 0.5, -3.0], [0.0, 2.0, 0.0], [-1.0, 0.0, -1.0]] {
            let [a, b, c] = positive_definite(m);
            assert!(a > 0.0 && a * c - b * b > 0.0, "{m:?}");
        }
        // the eigenvalues 1 and -2 along the axes become 1 and 2
        let [a, b, c] = positive_definite([1.0, 0.0, -2.0]);
        assert!((a - 1.0).abs() < 1e-12 && b.abs() < 1e-12 && (c - 2.0).abs() < 1e-12);
    }
}
