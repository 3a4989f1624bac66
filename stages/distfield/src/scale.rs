//! Implements `--scale`: a surface with as much detail as a coarse mesh can represent.
//!
//! The occupancy of each voxel is smoothed by a Gaussian with a standard deviation of half the
//! scale. Where the surface is curved or the object is thin, the level set at 1/2 is displaced:
//! balls shrink, and small parts and thin walls vanish. The level therefore varies in space so that
//! the volume within a window is preserved (`level.rs`). Parts that survive the smoothing keep
//! their volume, and tubes and walls keep their thickness. All other parts vanish;
//! [`crate::changes`] reports their number, volume and position.

use crate::changes::{Changes, remove_crumbs};
use crate::crop::{Grid, on_coarse_nodes, room_of_spline};
use crate::level::{Smoothing, level_set};
use crate::occupancy::Occupancy;
use crate::{Border, Keep};
use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_mesh::measure::measure;
use isoparticles_stage::error::Result;
use isoparticles_volume::{CutFaces, Geometry, Image, VoxelBox};
use rayon::prelude::*;
use std::f64::consts::{LN_2, PI};

/// Parameters of the smoothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// The scale: twice the standard deviation of the Gaussian, mm.
    pub length: f64,
    /// Whether to keep parts that are too thin for a mesh of the edge length that matches the
    /// scale.
    pub keep_thin: bool,
}

impl Scale {
    /// Returns the smoothing parameters for a grid.
    pub(crate) fn smoothing(&self, geometry: &Geometry) -> Smoothing {
        let least_level = if self.keep_thin { LEAST_LEVEL_THIN } else { LEAST_LEVEL };
        Smoothing { sigma: 0.5 * self.length / geometry.spacing, least_level, clearance: None }
    }
}

/// Minimum distance of the level from 0 and from 1. Parts with a lower smoothed occupancy vanish:
/// balls of radius below 1.2 and tubes of radius below 0.8 standard deviations of the Gaussian. A
/// mesh of the edge length that matches the scale would have about twelve vertices on such a ball,
/// and four vertices around such a tube.
const LEAST_LEVEL: f64 = 0.3;

/// Minimum distance of the level from 0 and from 1 with `--keep-thin`. With this value, tubes of
/// radius below 0.25 and walls thinner than 0.08 standard deviations vanish.
const LEAST_LEVEL_THIN: f64 = 0.03;

/// Radius, in units of the scale, of the ball whose volume is the minimum volume of a part. Smaller
/// parts are dropped. A mesh of the edge length that matches the scale ([`SCALE_OVER_SIZE`]) has
/// about 9 vertices on such a ball.
const CRUMB_RADIUS: f64 = 0.5;

/// Ratio of the scale to the edge length of the mesh. On `heart_label` (1.5 mm voxels) with h = 3.5
/// and 1.75 mm, the mean / minimum radius ratio of the triangles is 0.985 / 0.69 and 0.970 / 0.59
/// with a ratio of 1, 0.989 / 0.67 and 0.981 / 0.72 with 1.4, and 0.985 / 0.72 and 0.985 / 0.81
/// with 1.8. Even with 1.8, 99 % of the voxels that change sides are at the surface.
pub const SCALE_OVER_SIZE: f64 = 1.6;

/// Distance around the object within which the occupancy is smoothed, in standard deviations. At
/// this distance, the smoothed occupancy of a half space is 0.001.
const SMOOTHING_REACH: f64 = 3.0;

/// The smoothed object.
pub struct Scaled {
    /// Level set of the smoothed object: zero on the surface, positive inside.
    pub level: Image<f32>,
    /// Faces of the grid of `level` that are cuts through the original grid.
    pub cut: CutFaces,
    /// Changes due to the smoothing.
    pub changes: Changes,
}

/// The smoothed object in its bounding box.
struct Boxed {
    /// Index of the first voxel of the box in the volume.
    first: [usize; 3],
    before: Occupancy,
    /// Zero on the surface, positive inside.
    level: Vec<f32>,
}

impl Boxed {
    /// Smooths the object in its bounding box. Returns `None` if there is no object.
    fn new(occupancy: &Occupancy, scale: Scale) -> Result<Option<Self>> {
        let Some(object) = occupancy.extent() else { return Ok(None) };
        let geometry = &occupancy.geometry;
        let sigma = 0.5 * scale.length / geometry.spacing;
        let kept = on_coarse_nodes(object.with_room(room_round(sigma), geometry.size));
        let (first, size) = (kept.low, kept.size());
        let before = Occupancy {
            geometry: geometry.cropped(first, size),
            shares: crop(&occupancy.shares, geometry.size, first, size),
        };
        let mut level = level_set(&before, &scale.smoothing(geometry)).above;
        if !scale.keep_thin {
            remove_crumbs(&mut level, &before.geometry, smallest_part(scale.length))?;
        }
        Ok(Some(Self { first, before, level }))
    }

    /// Returns the area of the surface in mm^2. `size` is the number of voxels of the volume. With
    /// [`Border::Cap`], the faces that close the object at the border of the volume are included.
    fn area(self, border: Border, size: [usize; 3]) -> f64 {
        let Self { first, before: Occupancy { geometry, .. }, level } = self;
        let high = std::array::from_fn(|a| first[a] + geometry.size[a] - 1);
        let cut = VoxelBox { low: first, high }.cut_faces(size);
        let closing = match border {
            Border::Cap => area_at_faces(&geometry, cut, |voxel| level[voxel] > 0.0),
            Border::Open => 0.0,
        };
        closing + measure(&marching_cubes(&Image { geometry, data: level }, 0.0)).area
    }
}

/// Returns how many voxels the smoothed occupancy extends beyond an object, for `sigma` in voxels.
pub(crate) fn room_round(sigma: DVec3) -> [usize; 3] {
    sigma.to_array().map(|sigma| (SMOOTHING_REACH * sigma).ceil() as usize + 2)
}

/// Returns the volume (mm^3) below which parts are dropped, for a scale in mm.
pub(crate) fn smallest_part(scale: f64) -> f64 {
    4.0 / 3.0 * PI * (CRUMB_RADIUS * scale).powi(3)
}

/// Smooths an object. `grid` selects the grid of the result. Parts that `keep` drops later are also
/// smoothed, but their loss is not reported. Returns `None` if nothing is left of the object.
///
/// # Errors
/// If there are too many runs of voxels to label the parts.
pub fn scaled(occupancy: Occupancy, scale: Scale, keep: Keep, grid: Grid) -> Result<Option<Scaled>> {
    let (geometry, volume) = (occupancy.geometry.clone(), occupancy.volume());
    let Some(Boxed { first, before, level }) = Boxed::new(&occupancy, scale)? else { return Ok(None) };
    drop(occupancy);
    let Some(changes) = Changes::between(&before, &level, volume, scale.length, keep)? else { return Ok(None) };
    let size = before.geometry.size;
    drop(before);
    let whole = VoxelBox { low: [0; 3], high: geometry.size.map(|n| n - 1) };
    let kept = match grid {
        Grid::Volume => whole,
        Grid::Object => round_level(&level, size).map_or(whole, |left| {
            let left = VoxelBox { low: add(left.low, first), high: add(left.high, first) };
            on_coarse_nodes(left.with_room(room_of_spline(), geometry.size))
        }),
    };
    let cut = kept.cut_faces(geometry.size);
    let mut image = Image::filled(geometry.cropped(kept.low, kept.size()), EMPTY_LEVEL);
    let level = Image { geometry: Geometry { size, ..geometry }, data: level };
    paste(&level, first, &mut image, kept.low);
    Ok(Some(Scaled { level: image, cut, changes }))
}

/// Value of the level set outside the smoothed box: occupancy 0 minus a level of 1/2.
const EMPTY_LEVEL: f32 = -0.5;

/// Returns the bounding box of the voxels with a positive level.
fn round_level(level: &[f32], size: [usize; 3]) -> Option<VoxelBox> {
    VoxelBox::of_rows(size, |row| {
        let values = &level[row * size[0]..(row + 1) * size[0]];
        Some((values.iter().position(|&value| value > 0.0)?, values.iter().rposition(|&value| value > 0.0)?))
    })
}

fn add(a: [usize; 3], b: [usize; 3]) -> [usize; 3] {
    std::array::from_fn(|axis| a[axis] + b[axis])
}

/// Minimum standard deviation of the smoothing, in voxels of the grid on which an area is measured.
/// Areas are measured on the coarsest grid that satisfies it. This standard deviation removes the
/// voxel steps of labels (`labels::SIGMA`).
const COARSE_SIGMA: f64 = 1.5;

/// Minimum number of voxels of a halved grid: grids of more than eight times this number are halved
/// again. Computing an area on 80,000 voxels (43^3) takes about 10 ms of processor time (`cargo
/// test -p isoparticles-distfield --test scale edge_length_includes`).
const FEWEST_VOXELS: usize = 10_000;

/// Maximum number of iterations of the search for an edge length, and tolerance of the relative
/// difference between the assumed edge length and the edge length computed from the area.
///
/// The tolerance of 1 % corresponds to 2 % of the number of vertices. An iteration changes the
/// length by at most a factor of two, so ten iterations cover a factor of 1000 in length. The
/// objects of `tests/scale.rs` take at most four iterations. After the last iteration, the search
/// returns its current length.
const AREA_ROUNDS: (usize, f64) = (10, 0.01);

/// Edge length, in voxels, below which the search ends. It is reached from one voxel by six
/// halvings. The standard deviation of the smoothing is then below 0.016 voxel, so the smoothing
/// has no effect. An object without area at this scale is empty.
const SHORTEST_EDGE: f64 = 0.02;

/// A grid that can be halved in resolution, so that areas at large scales are measured on few
/// voxels.
pub(crate) trait Coarser: Sized {
    /// Returns the geometry of the grid.
    fn geometry(&self) -> &Geometry;

    /// Returns the grid with voxels twice as long along each axis.
    fn halved(&self) -> Self;
}

impl Coarser for Occupancy {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn halved(&self) -> Self {
        self.halved()
    }
}

/// Returns the edge length (mm) at which a mesh of the smoothed object has about `vertices`
/// vertices. Returns `None` if there is no object or nothing is left of it.
///
/// # Errors
/// If there are too many runs of voxels to label the parts.
pub fn edge_length(occupancy: &Occupancy, border: Border, vertices: f64, keep_thin: bool) -> Result<Option<f64>> {
    let area = |grid: &Occupancy, scale: Scale| {
        Ok(Boxed::new(grid, scale)?.map_or(0.0, |boxed| boxed.area(border, grid.geometry.size)))
    };
    edge_length_by(occupancy, area, vertices, keep_thin)
}

/// Returns the edge length for a number of vertices, given a function that computes the area (mm^2)
/// on a grid at a scale. The secant method finds the root of ln(L / length), where L is the edge
/// length computed from the area at the scale of `length`.
///
/// # Errors
/// If the area cannot be computed.
pub(crate) fn edge_length_by<G: Coarser>(
    finest: &G,
    area: impl Fn(&G, Scale) -> Result<f64>,
    vertices: f64,
    keep_thin: bool,
) -> Result<Option<f64>> {
    let mut coarser: Vec<G> = Vec::new();
    while coarser.last().unwrap_or(finest).geometry().voxel_count() > 8 * FEWEST_VOXELS {
        coarser.push(coarser.last().unwrap_or(finest).halved());
    }
    let smallest = SHORTEST_EDGE * finest.geometry().mean_spacing();
    let mut length = coarser.last().unwrap_or(finest).geometry().mean_spacing();
    let mut last: Option<(f64, f64)> = None;
    for _ in 0..AREA_ROUNDS.0 {
        let scale = Scale { length: SCALE_OVER_SIZE * length, keep_thin };
        let coarse_enough = |grid: &&G| 0.5 * scale.length >= COARSE_SIGMA * grid.geometry().mean_spacing();
        let grid = coarser.iter().rev().find(coarse_enough).unwrap_or(finest);
        let found = (2.0 * area(grid, scale)? / (3f64.sqrt() * vertices)).sqrt();
        let off = (found / length).ln();
        if off.abs() < AREA_ROUNDS.1 {
            return Ok(Some(found));
        }
        let step = if off.abs() < LN_2 {
            // the area does not grow with the scale, so the slope is at most -1
            let slope = last.map_or(-1.0, |(last, last_off)| ((off - last_off) / (length / last).ln()).min(-1.0));
            -off / slope
        } else {
            // limit the step, because the area vanishes once the scale exceeds the thickness of all
            // parts
            0.5 * off.clamp(-2.0 * LN_2, 2.0 * LN_2)
        };
        last = off.is_finite().then_some((length, off));
        length *= step.exp();
        if length < smallest {
            break;
        }
    }
    Ok((length >= smallest).then_some(length))
}

/// Returns the area (mm^2) of the object on the faces of a voxel grid that are not `cut`.
pub(crate) fn area_at_faces(geometry: &Geometry, cut: CutFaces, is_inside: impl Fn(usize) -> bool) -> f64 {
    let size = geometry.size;
    let at_face = |(axis, end): (usize, usize)| {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let is_inside = |(a, b): (usize, usize)| {
            let mut at = [0; 3];
            (at[axis], at[u], at[v]) = (end * (size[axis] - 1), a, b);
            is_inside(geometry.linear(at[0], at[1], at[2]))
        };
        let count = (0..size[u]).flat_map(|a| (0..size[v]).map(move |b| (a, b))).filter(|&at| is_inside(at)).count();
        count as f64 * geometry.spacing[u] * geometry.spacing[v]
    };
    let faces = (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]);
    faces.filter(|&(axis, end)| !cut[axis][end]).map(at_face).sum()
}

/// Copies the values in a box of a grid.
fn crop(from: &[u8], whole: [usize; 3], first: [usize; 3], size: [usize; 3]) -> Vec<u8> {
    let mut values = vec![0; size.iter().product()];
    values.par_chunks_mut(size[0]).enumerate().for_each(|(row, values)| {
        let (j, k) = (row % size[1] + first[1], row / size[1] + first[2]);
        values.copy_from_slice(&from[(k * whole[1] + j) * whole[0] + first[0]..][..size[0]]);
    });
    values
}

/// Copies the values of one box of a grid to another box where the boxes intersect. `from_first`
/// and `to_first` are the grid indices of the first voxels of the boxes.
fn paste(from: &Image<f32>, from_first: [usize; 3], to: &mut Image<f32>, to_first: [usize; 3]) {
    let (source, target) = (from.geometry.size, to.geometry.size);
    let low: [usize; 3] = std::array::from_fn(|a| from_first[a].max(to_first[a]));
    let end: [usize; 3] = std::array::from_fn(|a| (from_first[a] + source[a]).min(to_first[a] + target[a]));
    let count = end[0].saturating_sub(low[0]);
    for (k, j) in (low[2]..end[2]).flat_map(|k| (low[1]..end[1]).map(move |j| (k, j))) {
        let at = |first: [usize; 3], size: [usize; 3]| {
            ((k - first[2]) * size[1] + j - first[1]) * size[0] + low[0] - first[0]
        };
        let (source, target) = (at(from_first, source), at(to_first, target));
        to.data[target..target + count].copy_from_slice(&from.data[source..source + count]);
    }
}
