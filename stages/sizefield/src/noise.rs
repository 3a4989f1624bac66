//! Distinguishes noise from shape, and computes the denoised surface.
//!
//! The criterion is the residual of a least-squares patch ([`crate::patch`]) as a function of the
//! radius of the patch. If the shape is more complex than a quadric, the residual grows with a
//! power of the radius. If the samples scatter about a quadric, as with intensity noise, the
//! residual hardly grows. A patch is therefore widened as long as its residual stays nearly the
//! same, so that the data determines the radius at each sample (as in Lepski 1990). If the residual
//! already grows in the first step, the surface is left unchanged.
//!
//! Ripple from sampling, such as the terraces that thick slices leave on a clean surface, also
//! scatters about a quadric and is treated as noise.

use crate::averages::average;
use crate::patch::{Marks, Patch, Samples};
use glam::{DVec2, DVec3};
use isoparticles_mesh::incidence::Incidence;
use rayon::prelude::*;

/// Radius of the first patches, in voxels. A smaller radius would give too few samples: at two
/// voxels, some patches have fewer than 18 samples, and [`crate::patch`] needs 9.
const FIRST_RADIUS: f64 = 2.0;

/// Radii in voxels of the wider patches, and the maximum factor by which the residual (root mean
/// square over nearby samples) may grow from the previous radius. For white noise, which causes
/// bumps about 1.5 voxels wide on the surface, the measured factors are 1.5 to 1.6, 1.1 and 1.06 to
/// 1.12 (on balls of radius 11 and 19 voxels and a torus with a tube radius of 8 voxels). A torus
/// without noise has factors of 2.3 or more at each step. The first limit is larger because patches
/// of two voxels partly follow such bumps.
const WIDER: [(f64, f64); 3] = [(3.0, 1.8), (4.0, 1.25), (6.0, 1.2)];

/// Maximum residual (root mean square, in voxels) that is treated as noise. Steps one voxel high
/// cause a residual of 1 / sqrt(12) = 0.29; the limit is half of this. Larger residuals, for
/// example from the steps of a coarse mask, are always treated as shape.
const LARGEST_NOISE: f64 = 0.15;

/// Stride between the samples at which residuals are measured. An average over [`AVERAGING_ROUNDS`]
/// rounds still covers about 16 residuals: a Gaussian of variance 40 / 3 has an effective area of
/// `4 * pi * 40 / 3` = 168 squared edge lengths, and each residual represents `12 * sqrt(3) / 2` =
/// 10.4 of them.
const RESIDUAL_STRIDE: usize = 12;

/// Number of averaging rounds along the surface, for the residuals and for the vote on which
/// samples are noisy. Forty rounds act like a Gaussian with a standard deviation of sqrt(40 / 3) =
/// 3.7 marching-cubes edges ([`crate::averages`]). With 20 rounds for either, the test
/// `a_half_noisy_ball_has_its_radius_everywhere` measures a minimum feature size of 1.2 instead of
/// 17.4 voxels. With 80 rounds, it is 18.1, but nearly the whole clean half is classified as noisy.
const AVERAGING_ROUNDS: usize = 40;

/// Number of triangles by which the noise is extended beyond the edge of a noisy region, where
/// samples with and without noise alternate. With 2 triangles, the test
/// `a_half_noisy_ball_has_its_radius_everywhere` measures a minimum feature size of 1.5 instead of
/// 17.4 voxels; 8 triangles give the same result as 4.
const EDGE_TRIANGLES: usize = 4;

/// Number of samples in one parallel task.
const CHUNK: usize = 4096;

/// Patch and noise height of each sample.
pub struct Smoothed {
    /// The patch fitted through the noise; `None` where there is no significant noise.
    pub patches: Vec<Option<Patch>>,
    /// Root mean square height of the noise in mm, extended by a few triangles beyond the edge of
    /// noisy regions.
    pub noise: Vec<f64>,
}

impl Smoothed {
    /// Detects noise. `voxel` is the mean spacing in mm.
    pub(crate) fn new(samples: &Samples<'_>, incidence: &Incidence<'_>, voxel: f64) -> Self {
        let scale = scales(samples, incidence, voxel);
        let patches = in_chunks(samples.points.len(), |i, marks| {
            let (radius, _) = *WIDER.get(scale[i].checked_sub(1)?)?;
            samples.patch(i, radius * voxel, marks)
        });
        let mut noise: Vec<f64> = patches.iter().map(|patch| patch.map_or(0.0, |patch| patch.residual)).collect();
        for _ in 0..EDGE_TRIANGLES {
            spread_largest(&mut noise, incidence.triangles());
        }
        Self { patches, noise }
    }

    /// Returns the result for a surface without noise.
    pub fn none(samples: usize) -> Self {
        // in parallel, because the first write to newly allocated memory is slow
        Self { patches: (0..samples).into_par_iter().map(|_| None).collect(), noise: vec![0.0; samples] }
    }
}

/// Returns, for each sample, the index of the widest patch whose residual is noise. Index 1 is the
/// first patch in [`WIDER`]; 0 means that the sample has no noise.
fn scales(samples: &Samples<'_>, incidence: &Incidence<'_>, voxel: f64) -> Vec<usize> {
    let limit = LARGEST_NOISE * voxel;
    let mut scale = vec![0; samples.points.len()];
    let mut before = residuals(samples, FIRST_RADIUS * voxel, |_| true);
    for (n, (radius, growth)) in WIDER.into_iter().enumerate() {
        let after = residuals(samples, radius * voxel, |i| scale[i] == n);
        // the squared residuals for both radii, and a weight of 1 if both exist
        let squares = |pair: (&Option<f64>, &Option<f64>)| match pair {
            (Some(b), Some(a)) => DVec3::new(b * b, a * a, 1.0),
            _ => DVec3::ZERO,
        };
        let mut sums: Vec<DVec3> = before.iter().zip(&after).map(squares).collect();
        average(incidence, &mut sums, DVec3::ZERO, AVERAGING_ROUNDS);
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

/// Decides by a majority vote of the nearby samples whether a sample is noisy. The patch index of a
/// noisy sample becomes the rounded mean over the nearby noisy samples.
fn vote(scale: &mut [usize], incidence: &Incidence<'_>) {
    let mut votes: Vec<DVec2> = scale.iter().map(|&s| DVec2::new(s.min(1) as f64, s as f64)).collect();
    average(incidence, &mut votes, DVec2::ZERO, AVERAGING_ROUNDS);
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

/// Returns the residuals (mm) of patches with the given radius (mm), at every
/// [`RESIDUAL_STRIDE`]-th sample for which `wanted` is true.
fn residuals(samples: &Samples<'_>, radius: f64, wanted: impl Fn(usize) -> bool + Sync) -> Vec<Option<f64>> {
    in_chunks(samples.points.len(), |i, marks| {
        (i % RESIDUAL_STRIDE == 0 && wanted(i))
            .then(|| samples.patch(i, radius, marks))
            .flatten()
            .map(|patch| patch.residual)
    })
}

/// Calls `at` for every sample, in parallel chunks. Each chunk has its own [`Marks`].
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
