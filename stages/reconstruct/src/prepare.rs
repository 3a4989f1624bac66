//! Projects the particles of one object onto F = 0 and triangulates them. Drops particles that are
//! invalid, outside the volume, far from F = 0, or too close to another one.

use glam::DVec3;
use isoparticles_delaunay::{Delaunay, INFINITE};
use isoparticles_field::materials::Stratum;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::spline::CubicSpline;
use isoparticles_stage::error::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeSet;

/// Tolerance of projections onto F = 0: maximum |F| / |grad F| of a vertex, in voxels. It is far
/// below the limit of the check, 1e-4.
pub const ON_SURFACE: f64 = 1e-7;

/// Maximum distance by which a particle is moved onto the surface or onto its stratum, in voxels.
pub(crate) const LONGEST_MOVE: f64 = 1.0;

/// Minimum distance of two particles, as a share of the smaller h. Closer particles would only form
/// slivers, so one of them is removed.
const TOO_CLOSE: f64 = 0.05;

/// Returns the edges of a tetrahedron, each with the lower vertex first.
fn edges(t: [u32; 4]) -> [(u32, u32); 6] {
    [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]].map(|ends| ends.map(|n| t[n])).map(|[a, b]| (a.min(b), a.max(b)))
}

/// Points on the surface with their target edge lengths.
#[derive(Clone, Debug, Default)]
pub struct SurfacePoints {
    /// Positions in the grid frame, mm.
    pub positions: Vec<DVec3>,
    /// Target edge length h at each point, mm. If empty, [`Self::triangulate`] sets it to the
    /// spacing of the points.
    pub sizes: Vec<f64>,
    /// Normals of the input for Tight Cocone without a field; otherwise empty.
    pub normals: Vec<DVec3>,
    /// Strata of the points at junction points and on junction curves, which come first; empty for
    /// one object. Such points of different strata are kept even if they are close, because curves
    /// would otherwise lose their ends and hairpins. Only exact duplicates are removed.
    pub lower: Vec<Stratum>,
    /// Numbers of particles read and dropped.
    pub report: PrepareReport,
}

/// Returns the error for points that cannot be triangulated, with its reason and a remedy.
pub fn not_triangulated(error: isoparticles_delaunay::Error) -> Error {
    use isoparticles_delaunay::Error as Cause;
    let (why, next) = match error {
        Cause::Coordinate(_) => ("the exact predicates work up to 1e50", "check the source of the points"),
        Cause::TooFew(_) | Cause::Collinear(_) | Cause::Coplanar(_) => (
            "a tetrahedralization needs four points that are not coplanar",
            "check that the points sample a closed surface and that no coordinate is constant",
        ),
        Cause::TooManyPoints(_) | Cause::TooManyTetrahedra(_) => {
            ("the limit is 2^32 points", "reduce the number of points")
        }
    };
    Error::input(error.to_string(), why, next)
}

impl SurfacePoints {
    /// Returns the Delaunay triangulation, and removes points that coincide with others or are too
    /// close to them. Testing the edges is sufficient, because a point and its nearest neighbour
    /// share an edge.
    ///
    /// # Errors
    /// Those of [`Delaunay::new`], with a reason and a remedy.
    pub fn triangulate(&mut self) -> Result<Delaunay> {
        loop {
            let delaunay = Delaunay::new(&self.positions).map_err(not_triangulated)?;
            if self.sizes.is_empty() {
                self.sizes = spacings(&delaunay);
            }
            let crowded = self.crowded(&delaunay);
            if crowded.is_empty() {
                return Ok(delaunay);
            }
            self.report.crowded += crowded.len();
            let kept: Vec<usize> =
                (0..self.positions.len()).filter(|v| crowded.binary_search(&(*v as u32)).is_err()).collect();
            self.positions = kept.iter().map(|&v| self.positions[v]).collect();
            self.lower = kept.iter().filter_map(|&v| self.lower.get(v).copied()).collect();
            self.sizes = kept.iter().map(|&v| self.sizes[v]).collect();
            if !self.normals.is_empty() {
                self.normals = kept.iter().map(|&v| self.normals[v]).collect();
            }
        }
    }

    /// Returns whether two points may be arbitrarily close: two junction points, points on
    /// different junction curves, or a point on a curve and a junction point at which this curve
    /// does not end.
    fn are_strangers(&self, a: usize, b: usize) -> bool {
        let (Some(a), Some(b)) = (self.lower.get(a), self.lower.get(b)) else { return false };
        let holds = |one: &Stratum, other: &Stratum| other.materials().iter().all(|&id| one.has(id));
        a.dimension() + b.dimension() == 0 || !holds(a, b) && !holds(b, a)
    }

    /// Returns the points to remove, ascending: duplicates, and the later end of each edge that is
    /// too short. The later end stays if the earlier end is removed, or if the two may be
    /// arbitrarily close.
    fn crowded(&self, delaunay: &Delaunay) -> Vec<u32> {
        let mut gone: BTreeSet<u32> =
            (0..self.positions.len() as u32).filter(|&v| delaunay.duplicate_of(v).is_some()).collect();
        let is_short = |&(a, b): &(u32, u32)| {
            // the infinite vertex has the highest number, so it can only be the second
            if b == INFINITE {
                return false;
            }
            let (a, b) = (a as usize, b as usize);
            let limit = TOO_CLOSE * self.sizes[a].min(self.sizes[b]);
            self.positions[a].distance(self.positions[b]) < limit && !self.are_strangers(a, b)
        };
        let short = delaunay.par_tetrahedra().flat_map_iter(|(_, t)| edges(t).into_iter().filter(is_short));
        let mut short: Vec<(u32, u32)> = short.collect();
        short.sort_unstable();
        short.dedup();
        for (a, b) in short {
            if !gone.contains(&a) {
                gone.insert(b);
            }
        }
        gone.into_iter().collect()
    }
}

/// Returns the spacing at each point: the distance to the third nearest neighbour in the
/// triangulation, so that one or two near duplicates do not reduce it. It is zero for duplicates.
fn spacings(delaunay: &Delaunay) -> Vec<f64> {
    let mut nearest = vec![[f64::INFINITY; 3]; delaunay.points().len()];
    let finite = delaunay.par_tetrahedra().filter(|(_, t)| !t.contains(&INFINITE));
    let mut edges: Vec<(u32, u32)> = finite.flat_map_iter(|(_, t)| edges(t)).collect();
    edges.par_sort_unstable();
    edges.dedup();
    for (a, b) in edges {
        let distance = delaunay.points()[a as usize].distance(delaunay.points()[b as usize]);
        for v in [a, b] {
            let list = &mut nearest[v as usize];
            if distance < list[2] {
                list[2] = distance;
                list.sort_unstable_by(f64::total_cmp);
            }
        }
    }
    nearest.into_iter().map(|list| if list[2].is_finite() { list[2] } else { 0.0 }).collect()
}

/// Numbers of particles and segments that were used, added or not used. The numbers from
/// `encroaching` on are zero for one object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PrepareReport {
    /// Number of particles in the file.
    pub particles: usize,
    /// Particles with a coordinate that is not finite, or with h not finite or not positive.
    pub invalid: usize,
    /// Particles outside the volume, or too far from F = 0 to be projected.
    pub not_projected: usize,
    /// Particles that coincide with an earlier one, or are too close to it.
    pub crowded: usize,
    /// Particles on interfaces in the diametral ball of a segment of a junction curve.
    pub encroaching: usize,
    /// Segments of junction curves at the start.
    pub segments: usize,
    /// Segments that replace particles that were not used.
    pub bridged: usize,
    /// Points added on closed curves of one or two particles.
    pub on_small_loops: usize,
    /// Closed curves without particles that got points.
    pub loops_added: usize,
}

impl PrepareReport {
    /// Returns the number of dropped particles.
    pub fn dropped(&self) -> usize {
        self.invalid + self.not_projected + self.crowded + self.encroaching
    }
}

/// Projects particles onto F = 0, and returns those that reach it inside the volume.
///
/// # Errors
/// If there is not one target edge length for each particle, or if fewer than half of the particles
/// (or fewer than four) can be projected. The files then do not belong together.
pub fn prepare(particles: &ParticleSet, field: &CubicSpline) -> Result<SurfacePoints> {
    let voxel = field.geometry().mean_spacing();
    let project = |v: usize| field.project(particles.positions[v], LONGEST_MOVE * voxel, ON_SURFACE * voxel);
    let (points, report) = projected(particles, field.geometry().upper_corner(), project)?;
    let (positions, sizes) = points.into_iter().flatten().unzip();
    Ok(SurfacePoints { positions, sizes, report, ..SurfacePoints::default() })
}

/// Position (grid frame, mm) and h (mm) of a projected particle.
pub(crate) type Placed = (DVec3, f64);

/// Projects particles onto the surface or onto their strata. `project` is called with the index of
/// a particle, which it moves by at most [`LONGEST_MOVE`]. The result is `None` for particles that
/// are invalid, that cannot be projected, or that leave the volume. `upper` is the last corner of
/// the volume.
///
/// # Errors
/// Those of [`prepare`].
pub(crate) fn projected(
    particles: &ParticleSet,
    upper: DVec3,
    project: impl Fn(usize) -> Option<DVec3> + Sync,
) -> Result<(Vec<Option<Placed>>, PrepareReport)> {
    let ParticleSet { positions, sizes, .. } = particles;
    let count = positions.len();
    if sizes.len() != count {
        return Err(Error::input(
            format!("{count} particles with {} target edge lengths", sizes.len()),
            "each particle needs one",
            "run the stage `particles` again",
        ));
    }
    let is_valid = |v: usize| positions[v].is_finite() && sizes[v].is_finite() && sizes[v] > 0.0;
    let in_volume = |p: &DVec3| p.cmpge(DVec3::ZERO).all() && p.cmple(upper).all();
    let point = |v: usize| Some((is_valid(v).then(|| project(v))?.filter(in_volume)?, sizes[v]));
    let points: Vec<Option<Placed>> = (0..count).into_par_iter().map(point).collect();
    let invalid = (0..count).filter(|&v| !is_valid(v)).count();
    let taken = points.iter().flatten().count();
    if taken < 4 || taken * 2 < count {
        return Err(Error::input(
            format!("only {taken} of {count} particles lie within {LONGEST_MOVE} voxel of the surface"),
            "the particles and the distance field probably do not belong together",
            "pass the distance field that the particles were made from, or run `seed` and `particles` again",
        ));
    }
    let report =
        PrepareReport { particles: count, invalid, not_projected: count - invalid - taken, ..Default::default() };
    Ok((points, report))
}
