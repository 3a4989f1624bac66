//! From an implicit function to F: samples of its zero set, signed distance, and the zero set pinned.

use crate::bits::Bits;
use crate::cap::BorderBox;
use crate::closest::distance_to_zero_set;
use crate::fit::{FitReport, pin_zero_set};
use crate::junctions::{junctions, make_agree};
use crate::keep::{Dropped, Keep, drop_parts};
use crate::samples::{Implicit, project, surface_samples};
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

/// The zero set counts as pinned at this root-mean-square of F at the samples, in voxels: a tenth of what a remesher strays from the triangles that it is given. Half of it halves the mean distance of the zero sets in twice the
/// steps: ribcage of `thorax_labels`, `--scale 3`, 0.0004 voxel in 138 steps (1.24 s), 0.0007 in 60 (0.64 s); `tooth_ct` at 600 0.0005 in 117 and 0.0009 in 54.
const PINNED: f64 = 0.001;

/// Conjugate-gradient steps that pin the zero set, at most. Smooth surfaces need about 10; noise, where the surface
/// folds within a voxel, takes them all.
const MOST_PIN_STEPS: usize = 160;

/// Half-width of the band with exact distances, in voxels.
const BAND: f64 = 4.0;

/// Points at which the result is compared with its source, at most.
const CHECKED_POINTS: usize = 200_000;

/// A source to re-distance: an implicit function near its zero set.
pub struct Source {
    /// The spline whose zero set is the surface (before it is cut at the border).
    pub spline: BrickSpline,
    /// The box that closes the object, if any.
    pub cap: Option<BorderBox>,
}

/// How far the zero set of F is from that of its source, to first order (value over slope), in voxels (mean spacing).
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Shift {
    /// Mean over the surface.
    pub mean: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
    /// Points it was measured at.
    pub points: usize,
}

/// F with what is known about it.
pub struct Redistanced {
    /// Signed distance samples, in mm, negative inside.
    pub field: Image<f32>,
    /// Parts that were dropped, before anything else was counted.
    pub dropped: Dropped,
    /// Parts of the source that stay, by marching cubes at its nodes.
    pub parts_before: Parts,
    /// Parts of F: their number by marching cubes, their volume from the spline.
    pub parts_after: Parts,
    /// Volume within each connected surface of F, mm^3, the largest first; those of cavities are
    /// negative. None where the surface leaves the grid.
    pub volumes: Vec<f64>,
    /// Distance of the zero sets.
    pub shift: Shift,
    /// Nodes whose |F| was raised to the clearance after the zero set was pinned.
    pub held_nodes: usize,
    /// Places where two parts touch along an edge and F does not join or part them as the source does.
    pub undecided: usize,
    /// How the zero set was pinned.
    pub fit: FitReport,
    /// Labels: voxel centres that F puts on the other side, those of dropped parts aside.
    pub changed: Option<usize>,
}

/// What is asked of F beside its surface.
#[derive(Clone, Copy)]
pub struct Demands {
    /// Distance beyond which that will do, in voxels (mean spacing); no less than the band with exact distances.
    pub limit: f64,
    /// The zero set counts as pinned at this root-mean-square of F at the samples, in voxels.
    pub pinned: f64,
    /// Conjugate-gradient steps that pin the zero set, at most.
    pub pin_steps: usize,
}

impl Default for Demands {
    /// Distances everywhere.
    fn default() -> Self {
        Self { limit: f64::INFINITY, pinned: PINNED, pin_steps: MOST_PIN_STEPS }
    }
}

/// Least |F| at the nodes, in mm.
pub struct LeastDistances<At> {
    /// The largest of them.
    pub most: f32,
    /// That of a node.
    pub at: At,
}

impl Implicit for Source {
    /// First-order distance to the surface, cut at the border, and its gradient.
    #[inline(always)]
    fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        let (f, g) = self.spline.value_gradient(grid);
        self.cap
            .as_ref()
            .map_or((f, g), |cap| cap.intersect(grid, first_order_distance(f, g.length()), g.normalize_or_zero()))
    }
}

/// Value over slope; where there is no slope, far away on the side of the value (zero being outside).
#[inline(always)]
pub(crate) fn first_order_distance(value: f64, slope: f64) -> f64 {
    if slope > 1e-12 {
        value / slope
    } else if value < 0.0 {
        -1e6
    } else {
        1e6
    }
}

/// Re-distances a source. The signs of `nodes` say which nodes are inside (negative); zero is outside.
/// Marching cubes starts from its values, and it becomes F. The `margin` nodes on each face are beyond
/// the input.
///
/// # Errors
/// When the source has no zero set, no part of the object is to stay, or the run is interrupted.
pub fn redistance(
    mut nodes: Image<f32>,
    source: &Source,
    least: LeastDistances<impl Fn(usize) -> f32 + Sync>,
    (keep, margin): (Keep, usize),
    demands: &Demands,
    monitor: &dyn Monitor,
) -> Result<Redistanced> {
    let voxel = nodes.geometry.mean_spacing();
    let band = (BAND * voxel).max(1.5 * nodes.geometry.spacing.max_element());

    let step = monitor.phase("surface samples");
    let mut choices = junctions(&nodes);
    let dropped = drop_parts(&mut nodes, margin, &choices, keep)?;
    if dropped.nodes.is_some() {
        choices = junctions(&nodes);
    }
    let mesh = marching_cubes(&nodes, 0.0);
    if mesh.triangles.is_empty() {
        return Err(Error::input(
            "the object has no surface on the grid",
            "there is nothing to measure distances from",
            "choose another iso value or other labels, or --border cap",
        ));
    }
    let samples = surface_samples(source, &nodes, &mesh);
    let parts_before = Parts::of(&mesh);
    drop(mesh);
    // only the signs are needed from here on (a value of -0 is outside)
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
    let held_nodes = hold_nodes(&mut field, &inside, &least);
    let undecided = make_agree(&mut field, &choices, &least.at);
    drop(inside);
    drop(step);
    monitor.check()?;

    let _step = monitor.phase("result checked");
    let mesh = marching_cubes(&field, 0.0);
    let points = checked_points(&mesh);
    let spline = BrickSpline::new(&field);
    let mut parts_after = Parts::of(&mesh);
    let mut volumes = Vec::new();
    if !leaves_grid(&field) {
        volumes = enclosed_volumes(&mesh, field.geometry.min_spacing(), |p| spline.value_gradient(p));
        parts_after.volume = volumes.iter().sum();
    }
    drop(mesh);
    volumes.sort_by(|a, b| b.total_cmp(a));
    let shift = measure_shift(source, &spline, &field.geometry, &points);
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

/// Whether the object reaches the faces of the grid, as it does through an open border.
fn leaves_grid(field: &Image<f32>) -> bool {
    let [nx, ny, nz] = field.geometry.size;
    let on_face = |i: usize, n: usize| i == 0 || i + 1 == n;
    field.data.par_chunks(nx).enumerate().any(|(row, values)| {
        let is_face = on_face(row % ny, ny) || on_face(row / ny, nz);
        values.iter().enumerate().any(|(i, &f)| f < 0.0 && (is_face || on_face(i, nx)))
    })
}

/// Keeps every node its least distance away from zero on its side; returns how many had to be moved.
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

/// An edge midpoint of each triangle, or of every so many where there are more than enough: places that the fit has not seen.
fn checked_points(mesh: &TriangleMesh) -> Vec<DVec3> {
    let middle = |t: &[u32; 3]| 0.5 * (mesh.vertices[t[0] as usize] + mesh.vertices[t[1] as usize]);
    let every = mesh.triangles.len().div_ceil(CHECKED_POINTS).max(1);
    mesh.triangles.iter().step_by(every).map(middle).collect()
}

/// Distance of the zero set of a spline on a grid to that of the source, at projections of
/// `points`.
fn measure_shift(source: &impl Implicit, spline: &BrickSpline, geometry: &Geometry, points: &[DVec3]) -> Shift {
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
