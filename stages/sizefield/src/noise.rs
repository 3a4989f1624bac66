//! Distinguishes noise from shape, and computes the surface under the noise.
//!
//! The residual of a least-squares patch ([`crate::patch`]) grows with its radius: by a power of it
//! if the shape is richer than a quadric, and hardly at all if the samples scatter about a quadric,
//! as with intensity noise. A patch is therefore widened as long as its residual stays nearly the
//! same, so the data chooses the scale at each place (in the manner of Lepski 1990). Where the
//! first widening already shows shape, the surface is left unchanged.
//!
//! Ripple of the sampling, such as terraces of thick slices on a clean surface, scatters about a
//! quadric in the same way and is treated as noise.

use crate::averages::average;
use crate::patch::{Marks, Patch, Samples};
use glam::{DVec2, DVec3};
use isoparticles_mesh::incidence::Incidence;
use rayon::prelude::*;

/// Radius of the first patches, in voxels.
const FIRST_RADIUS: f64 = 2.0;

/// Radii of the wider patches, in voxels, and the maximum factor by which the residual (root mean
/// square over the surroundings) may grow from the previous radius. White noise gives bumps about
/// 1.5 voxels wide on the surface. Measured for it: factors of 1.5 to 1.6, 1.1 and 1.06 to 1.12
/// (balls of 11 and 19 voxels, a torus of 8). A torus without noise gives 2.3 and more at each
/// step. The first step is wider because a patch of two voxels follows such bumps in part.
const WIDER: [(f64, f64); 3] = [(3.0, 1.8), (4.0, 1.25), (6.0, 1.2)];

/// Maximum residual (voxels, root mean square) that counts as noise. Larger ones are shape, however
/// they scatter, such as the steps of a coarse mask.
const LARGEST_NOISE: f64 = 0.15;

/// Residuals are measured at every n-th sample ...
const EVERY: usize = 12;

/// ... and averaged over the surface in this many rounds.
const ROUNDS: usize = 40;

/// Rounds of averaging over the surface before the vote: a place is noisy if most places around it
/// are.
const VOTE_ROUNDS: usize = 40;

/// Rounds that extend the noise, triangle by triangle, beyond the edge of a noisy place, where
/// samples with and without noise are adjacent.
const EDGE_ROUNDS: usize = 4;

/// Samples of one task.
const CHUNK: usize = 4096;

/// Result for each sample.
pub struct Smoothed {
    /// The patch under the noise; `None` where there is no significant noise.
    pub patches: Vec<Option<Patch>>,
    /// Height of the noise, root mean square, mm; extended a little beyond the edge of noisy
    /// places.
    pub noise: Vec<f64>,
}

impl Smoothed {
    /// Detects noise; `voxel` is the mean spacing, mm.
    pub(crate) fn new(samples: &Samples<'_>, incidence: &Incidence<'_>, voxel: f64) -> Self {
        let scale = scales(samples, incidence, voxel);
        let patches = in_chunks(samples.points.len(), |i, marks| {
            let (radius, _) = *WIDER.get(scale[i].checked_sub(1)?)?;
            samples.patch(i, radius * voxel, marks)
        });
        let mut noise: Vec<f64> = patches.iter().map(|patch| patch.map_or(0.0, |patch| patch.residual)).collect();
        for _ in 0..EDGE_ROUNDS {
            spread_largest(&mut noise, incidence.triangles());
        }
        Self { patches, noise }
    }

    /// No noise anywhere.
    pub fn none(samples: usize) -> Self {
        // in parallel, because the memory of the patches is touched for the first time
        Self { patches: (0..samples).into_par_iter().map(|_| None).collect(), noise: vec![0.0; samples] }
    }
}

/// For each sample the number of the widest patch that still fits, counted from 1 in [`WIDER`]; 0
/// if none does.
fn scales(samples: &Samples<'_>, incidence: &Incidence<'_>, voxel: f64) -> Vec<usize> {
    let limit = LARGEST_NOISE * voxel;
    let mut scale = vec![0; samples.points.len()];
    let mut before = residuals(samples, FIRST_RADIUS * voxel, |_| true);
    for (n, (radius, growth)) in WIDER.into_iter().enumerate() {
        let after = residuals(samples, radius * voxel, |i| scale[i] == n);
        // squares of both residuals, and the share of samples with residuals
        let squares = |pair: (&Option<f64>, &Option<f64>)| match pair {
            (Some(b), Some(a)) => DVec3::new(b * b, a * a, 1.0),
            _ => DVec3::ZERO,
        };
        let mut sums: Vec<DVec3> = before.iter().zip(&after).map(squares).collect();
        average(incidence, &mut sums, DVec3::ZERO, ROUNDS);
        let mut is_wider = false;
        for (scale, sum) in scale.iter_mut().zip(&sums).filter(|(scale, _)| **scale == n) {
            if sum.z > 0.0 && sum.y <= growth * growth * sum.x && sum.y <= limit * limit * sum.z {
                *scale = n + 1;
                is_wider = true;
            }
        }
        if !is_wider {
            break;
        }
        before = after;
    }
    vote(&mut scale, incidence);
    scale
}

/// Decides by the surroundings which samples are noisy, and at which scale.
fn vote(scale: &mut [usize], incidence: &Incidence<'_>) {
    let mut votes: Vec<DVec2> = scale.iter().map(|&s| DVec2::new(s.min(1) as f64, s as f64)).collect();
    average(incidence, &mut votes, DVec2::ZERO, VOTE_ROUNDS);
    for (scale, vote) in scale.iter_mut().zip(votes) {
        *scale = if vote.x > 0.5 { (vote.y / vote.x).round() as usize } else { 0 };
    }
}

/// Gives every sample the maximum value of the samples that share a triangle with it.
fn spread_largest(values: &mut [f64], triangles: &[[u32; 3]]) {
    let before = values.to_vec();
    for t in triangles {
        let largest = t.iter().map(|&v| before[v as usize]).fold(0.0, f64::max);
        t.iter().for_each(|&v| values[v as usize] = values[v as usize].max(largest));
    }
}

/// Residuals (mm) of patches of a radius, at every n-th sample for which `wanted` is true.
fn residuals(samples: &Samples<'_>, radius: f64, wanted: impl Fn(usize) -> bool + Sync) -> Vec<Option<f64>> {
    in_chunks(samples.points.len(), |i, marks| {
        (i % EVERY == 0 && wanted(i)).then(|| samples.patch(i, radius, marks)).flatten().map(|patch| patch.residual)
    })
}

/// Calls `at` for every sample, in parallel chunks, each with its own marks.
fn in_chunks<T: Send>(count: usize, at: impl Fn(usize, &mut Marks) -> T + Sync) -> Vec<T> {
    let starts: Vec<usize> = (0..count).step_by(CHUNK).collect();
    let chunks: Vec<Vec<T>> = starts
        .par_iter()
        .map(|&start| {
            let mut marks = Marks::new(count);
            (start..(start + CHUNK).min(count)).map(|i| at(i, &mut marks)).collect()
        })
        .collect();
    chunks.into_iter().flatten().collect()
}
