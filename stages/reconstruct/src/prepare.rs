//! From particles to points that may be triangulated: on F = 0 to the tolerance of the mesh, inside the volume, and no
//! two on one spot.

use glam::DVec3;
use isoparticles_common::error::{Error, Result};
use isoparticles_common::neighbours::NeighbourLists;
use isoparticles_common::particle_set::ParticleSet;
use isoparticles_common::spline::CubicSpline;
use rayon::prelude::*;
use serde::Serialize;

/// |F| / |grad F| of a vertex, in voxels: far below the 1e-4 that is promised.
pub const ON_SURFACE: f64 = 1e-7;

/// Farthest that a particle may be moved on to the surface, in voxels.
const LONGEST_MOVE: f64 = 1.0;

/// Two particles nearer than this part of the smaller h would only make slivers; one of them goes.
const TOO_CLOSE: f64 = 0.05;

/// Points on F = 0, with their target edge lengths.
#[derive(Clone, Debug, Default)]
pub struct SurfacePoints {
    /// Positions, grid frame, mm.
    pub positions: Vec<DVec3>,
    /// Target edge length h, mm.
    pub sizes: Vec<f64>,
    /// What happened on the way.
    pub report: PrepareReport,
}

/// Particles that were not taken, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PrepareReport {
    /// Particles in the file.
    pub particles: usize,
    /// Not a number, or a target edge length that is not positive.
    pub invalid: usize,
    /// Outside the volume, or too far from F = 0 to be projected.
    pub astray: usize,
    /// On the same spot as an earlier one, or nearly.
    pub crowded: usize,
}

/// Projects particles on F = 0 and takes those that a mesh can be made of.
///
/// # Errors
/// When arrays of the set differ in length, or hardly any particle lies near F = 0: the files do not belong together.
pub fn prepare(particles: &ParticleSet, field: &CubicSpline) -> Result<SurfacePoints> {
    let count = particles.positions.len();
    if particles.sizes.len() != count {
        return Err(Error::input(
            format!("{count} particles with {} target edge lengths", particles.sizes.len()),
            "each particle needs its own",
            "rerun the stage `particles`",
        ));
    }
    let mut report = PrepareReport { particles: count, ..Default::default() };
    let voxel = field.geometry().mean_spacing();
    let upper = field.geometry().upper_corner();
    let in_volume = |p: DVec3| p.cmpge(DVec3::ZERO).all() && p.cmple(upper).all();
    let valid: Vec<(DVec3, f64)> = particles
        .positions
        .iter()
        .zip(&particles.sizes)
        .map(|(p, h)| (*p, *h))
        .filter(|(p, h)| p.is_finite() && h.is_finite() && *h > 0.0)
        .collect();
    report.invalid = count - valid.len();
    let projected: Vec<Option<(DVec3, f64)>> = valid
        .par_iter()
        .map(|&(p, h)| {
            let on = field.project(p, LONGEST_MOVE * voxel, ON_SURFACE * voxel)?;
            in_volume(on).then_some((on, h))
        })
        .collect();
    let (positions, sizes): (Vec<DVec3>, Vec<f64>) = projected.into_iter().flatten().unzip();
    report.astray = valid.len() - positions.len();
    if positions.len() < 4 || positions.len() * 2 < count {
        return Err(Error::input(
            format!("only {} of {count} particles lie within {LONGEST_MOVE} voxel of F = 0", positions.len()),
            "a surface needs particles on it; the particles and the distance field do not seem to belong together",
            "give the distance field that the particles were made from, or rerun `seed` and `particles`",
        ));
    }
    let near = NeighbourLists::new(&positions, &sizes, TOO_CLOSE, |_, _| true);
    let mut kept = vec![true; positions.len()];
    for i in 0..positions.len() {
        kept[i] = !near.of(i).iter().any(|&j| (j as usize) < i && kept[j as usize]);
    }
    let take = |i: &usize| kept[*i];
    let survivors: Vec<usize> = (0..positions.len()).filter(take).collect();
    report.crowded = positions.len() - survivors.len();
    Ok(SurfacePoints {
        positions: survivors.iter().map(|&i| positions[i]).collect(),
        sizes: survivors.iter().map(|&i| sizes[i]).collect(),
        report,
    })
}
