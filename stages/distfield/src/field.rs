//! Computes F, a signed distance with a pinned zero set, from an implicit function (the source).
//!
//! [`redistance`] samples the zero set of the source ([`crate::samples`]), measures the distance
//! from every node to this zero set ([`crate::closest`]), and changes the distances so that their
//! cubic spline vanishes at the samples ([`crate::fit`]). It then compares the zero sets of F and
//! of the source.

use crate::ambiguous_faces::{ambiguous_faces, make_agree};
use crate::bits::Bits;
use crate::closest::distance_to_zero_set;
use crate::fit::{FitReport, pin_zero_set};
use crate::keep::{Dropped, Keep, drop_parts};
pub use crate::samples::Source;
use crate::samples::{ValueGradient, project, surface_samples};
use crate::topology::Parts;
use glam::DVec3;
use isoparticles_field::enclosed::enclosed_volumes;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::spline::BrickSpline;
use isoparticles_mesh::TriangleMesh;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;
use serde::Serialize;

/// Tolerance of the pinned zero set: root mean square of F at the samples, in units of the mean
/// voxel spacing. Remeshers deviate from their input triangles by about ten times as much. With
/// half the tolerance, the mean distance between the zero sets of F and of its source is about
/// halved, and the number of steps is about doubled: for the ribcage of `thorax_labels` with
/// `--scale 3`, 0.0004 voxel after 138 steps (1.24 s) instead of 0.0007 voxel after 60 (0.64 s);
/// for `tooth_ct` at iso value 600, 0.0005 voxel after 117 steps instead of 0.0009 after 54.
const PINNED: f64 = 0.001;

/// Maximum number of conjugate-gradient steps for pinning the zero set. The surfaces measured for
/// [`PINNED`] need 54 and 60 steps. Noisy surfaces that fold within a voxel reach the maximum.
const MOST_PIN_STEPS: usize = 160;

/// Half-width of the band in which Newton's method finds the closest points, in units of the mean
/// voxel spacing. The cardinal cubic spline (one at a node, zero at all others) is below 0.003 in
/// absolute value beyond 4 nodes. Its absolute values at the midpoints between these nodes sum to
/// 0.007 over both sides. Errors of the approximate distances beyond the band therefore move the
/// zero set by less than 1 % of their size.
///
/// The half-width is at least 1.5 times the maximum spacing, so that the band contains both ends of
/// every grid edge that crosses the surface.
const EXACT_BAND: f64 = 4.0;

/// Maximum number of points at which the zero sets of F and of its source are compared. With this
/// number, 2000 points lie beyond the 99th percentile, so their number has a sampling error of
/// about 2 %.
const CHECKED_POINTS: usize = 200_000;

/// First-order estimate of the distance (value divided by gradient length) between the zero sets of
/// F and of its source, in units of the mean voxel spacing.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Shift {
    /// Mean over the surface.
    pub mean: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
    /// Number of points compared.
    pub points: usize,
}

/// F and measurements of it.
pub struct Redistanced {
    /// Samples of the signed distance, mm, negative inside.
    pub field: Image<f32>,
    /// Parts that were dropped. The counts below exclude these parts.
    pub dropped: Dropped,
    /// Parts of the source, without the dropped parts, counted on its marching-cubes mesh.
    pub parts_before: Parts,
    /// Parts of F, counted on its marching-cubes mesh, with the volume enclosed by the spline.
    pub parts_after: Parts,
    /// Volume enclosed by each connected surface of F, mm^3, in descending order; negative for
    /// cavities. Empty if the surface leaves the grid.
    pub volumes: Vec<f64>,
    /// Distance between the zero sets of F and of its source.
    pub shift: Shift,
    /// Number of nodes whose |F| was set to its minimum after pinning.
    pub held_nodes: usize,
    /// Number of ambiguous faces at which F and its source connect the ends of different diagonals.
    pub undecided: usize,
    /// Report of the fit that pins the zero set.
    pub fit: FitReport,
    /// For labels: number of voxel centres on the wrong side of F = 0, excluding the voxels of
    /// dropped parts.
    pub changed: Option<usize>,
}

/// Accuracy required of F.
#[derive(Clone, Copy)]
pub struct Demands {
    /// Distance at which F is clamped, in units of the mean voxel spacing. It is raised to the
    /// half-width of the exact band (`EXACT_BAND`) if it is smaller.
    pub limit: f64,
    /// Tolerance of the pinned zero set: root mean square of F at the samples, in units of the mean
    /// voxel spacing.
    pub pinned: f64,
    /// Maximum number of conjugate-gradient steps for pinning the zero set.
    pub pin_steps: usize,
}

impl Default for Demands {
    /// Returns the demands for an unclamped F, pinned with `PINNED` and `MOST_PIN_STEPS`.
    fn default() -> Self {
        Self { limit: f64::INFINITY, pinned: PINNED, pin_steps: MOST_PIN_STEPS }
    }
}

/// Minimum |F| at the nodes, mm.
pub struct LeastDistances<At> {
    /// Maximum of `at` over all nodes, mm.
    pub most: f32,
    /// Minimum |F| at a node, mm.
    pub at: At,
}

/// Computes F from a source.
///
/// `nodes` contains the values of the source at the nodes: negative inside, zero or positive
/// outside. They are the input of marching cubes, and their memory is freed afterwards. The
/// outermost `margin` layers of nodes on each face lie beyond the input.
///
/// # Errors
/// If the source has no zero set, no part is kept, or the run is interrupted.
pub fn redistance(
    mut nodes: Image<f32>,
    source: &Source,
    least: LeastDistances<impl Fn(usize) -> f32 + Sync>,
    (keep, margin): (Keep, usize),
    demands: &Demands,
    monitor: &dyn Monitor,
) -> Result<Redistanced> {
    let dropped_from = |nodes: &mut Image<f32>| match keep {
        Keep::All => Ok(Dropped::default()),
        _ => {
            let faces = ambiguous_faces(nodes);
            drop_parts(nodes, margin, &faces, keep)
        }
    };
    let mut dropped = dropped_from(&mut nodes)?;
    let mut fitted = fit_field(nodes, source, &least, demands, monitor)?;
    loop {
        // F may cut necks of the source that are thinner than a voxel; repeat until F cuts off no
        // part
        let cut_off = dropped_from(&mut fitted.field)?;
        if cut_off.components == 0 {
            break;
        }
        dropped.add_cut_off(cut_off);
        fitted = fit_field(fitted.field, source, &least, demands, monitor)?;
    }
    let Fitted { field, parts_before, held_nodes, undecided, fit } = fitted;

    let _step = monitor.phase("result checked");
    let Measured { parts: parts_after, volumes, shift } = measure(&field, source);
    Ok(Redistanced {
        field,
        dropped,
        parts_before,
        parts_after,
        volumes,
        shift,
        held_nodes,
        undecided,
        fit,
        changed: None,
    })
}

/// F after its zero set is pinned; see [`Redistanced`] for the fields.
struct Fitted {
    field: Image<f32>,
    parts_before: Parts,
    held_nodes: usize,
    undecided: usize,
    fit: FitReport,
}

/// Computes F of the parts of a source whose nodes are negative in `nodes`. `nodes` contains the
/// values of the source or of an earlier F.
fn fit_field(
    nodes: Image<f32>,
    source: &Source,
    least: &LeastDistances<impl Fn(usize) -> f32 + Sync>,
    demands: &Demands,
    monitor: &dyn Monitor,
) -> Result<Fitted> {
    let voxel = nodes.geometry.mean_spacing();
    let band = (EXACT_BAND * voxel).max(1.5 * nodes.geometry.spacing.max_element());

    let step = monitor.phase("surface samples");
    let choices = ambiguous_faces(&nodes);
    let mesh = marching_cubes(&nodes, 0.0);
    if mesh.triangles.is_empty() {
        return Err(no_surface());
    }
    let samples = surface_samples(source, &nodes, &mesh);
    let parts_before = Parts::of(&mesh);
    drop(mesh);
    // from here on, only the signs are needed (a value of -0 is outside)
    let inside = Bits::of(nodes.data.len(), |n| nodes.data[n] < 0.0);
    let geometry = nodes.geometry;
    drop(nodes.data);
    drop(step);
    monitor.check()?;

    let step = monitor.phase("distance");
    let mut field = distance_to_zero_set(geometry, &inside, source, &samples, band, band.max(demands.limit * voxel));
    drop(step);
    monitor.check()?;

    let step = monitor.phase("zero set pinned");
    let fit = pin_zero_set(&mut field, samples, demands.pinned * voxel, demands.pin_steps);
    let held_nodes = hold_nodes(&mut field, &inside, least);
    let undecided = make_agree(&mut field, &choices, &least.at);
    drop(inside);
    drop(step);
    monitor.check()?;
    Ok(Fitted { field, parts_before, held_nodes, undecided, fit })
}

fn no_surface() -> Error {
    Error::input(
        "the object has no surface on the grid",
        "F is the distance from the surface",
        "choose another ISO (--iso) or other LABELS (--labels), or set BORDER=cap (--border cap)",
    )
}

/// Measurements of F; see [`Redistanced`].
struct Measured {
    parts: Parts,
    volumes: Vec<f64>,
    shift: Shift,
}

/// Measures the parts and volumes of F, and the distance of its zero set from the zero set of
/// `source`.
fn measure(field: &Image<f32>, source: &Source) -> Measured {
    let mesh = marching_cubes(field, 0.0);
    let points = checked_points(&mesh);
    let spline = BrickSpline::new(field);
    let mut parts = Parts::of(&mesh);
    let mut volumes = Vec::new();
    if !leaves_grid(field) {
        volumes = enclosed_volumes(&mesh, field.geometry.min_spacing(), |p| spline.value_gradient(p));
        parts.volume = volumes.iter().sum();
    }
    drop(mesh);
    volumes.sort_by(|a, b| b.total_cmp(a));
    let shift = measure_shift(source, &spline, &field.geometry, &points);
    Measured { parts, volumes, shift }
}

/// Returns whether the object reaches a face of the grid, which is possible with an open border.
fn leaves_grid(field: &Image<f32>) -> bool {
    let [nx, ny, nz] = field.geometry.size;
    let on_face = |i: usize, n: usize| i == 0 || i + 1 == n;
    field.data.par_chunks(nx).enumerate().any(|(row, values)| {
        let is_face = on_face(row % ny, ny) || on_face(row / ny, nz);
        values.iter().enumerate().any(|(i, &f)| f < 0.0 && (is_face || on_face(i, nx)))
    })
}

/// Sets |F| to its minimum, with the correct sign, at nodes where |F| is smaller or the sign is
/// wrong. Returns the number of changed nodes.
fn hold_nodes(field: &mut Image<f32>, inside: &Bits, least: &LeastDistances<impl Fn(usize) -> f32 + Sync>) -> usize {
    let moved = field.data.par_iter_mut().enumerate().map(|(n, f)| {
        let sign = if inside.holds(n) { -1.0 } else { 1.0 };
        if *f * sign >= least.most {
            return 0;
        }
        let least = (least.at)(n);
        let moves = *f * sign < least;
        if moves {
            *f = sign * least;
        }
        usize::from(moves)
    });
    moved.sum()
}

/// Returns an edge midpoint of every triangle, or of every n-th triangle if there are more than
/// [`CHECKED_POINTS`]. The fit does not use these points.
fn checked_points(mesh: &TriangleMesh) -> Vec<DVec3> {
    let middle = |t: &[u32; 3]| 0.5 * (mesh.vertices[t[0] as usize] + mesh.vertices[t[1] as usize]);
    let every = mesh.triangles.len().div_ceil(CHECKED_POINTS).max(1);
    mesh.triangles.iter().step_by(every).map(middle).collect()
}

/// Measures the distance between the zero sets of a spline and of the source, at the projections of
/// `points` onto the zero set of the spline. `geometry` is the grid of the spline.
fn measure_shift(source: &impl ValueGradient, spline: &BrickSpline, geometry: &Geometry, points: &[DVec3]) -> Shift {
    let voxel = geometry.mean_spacing();
    let own = |p: DVec3| spline.value_gradient(p);
    let mut shifts: Vec<f64> = points
        .par_iter()
        .filter_map(|&start| {
            let p = project(&own, start, geometry.min_spacing())?;
            let (f, g) = source.value_gradient(p);
            let slope = g.length();
            (slope > 0.0).then(|| f.abs() / slope / voxel)
        })
        .collect();
    shifts.par_sort_by(f64::total_cmp);
    let Some(&max) = shifts.last() else {
        return Shift::default();
    };
    Shift {
        mean: shifts.iter().sum::<f64>() / shifts.len() as f64,
        p99: shifts[(shifts.len() - 1) * 99 / 100],
        max,
        points: shifts.len(),
    }
}
