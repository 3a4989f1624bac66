//! `--scale`: a surface with as much of the data as a coarse mesh can carry.
//!
//! The share of each voxel that is inside is smoothed by a Gaussian of half the scale. Where the surface is curved or the object thin, half of the
//! smoothed share is not where the surface was: balls shrink, small parts and thin walls vanish. So the level that is taken varies from
//! place to place such that the volume within a window of the scale is kept: parts keep their volume one by one, tubes and walls their thickness, as
//! far as the smoothed share still shows them. What it does not show is gone, and [`crate::changes`] tells what and where.

use crate::changes::{Changes, remove_crumbs};
use crate::gaussian::smooth;
use crate::occupancy::{Occupancy, WHOLE};
use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_mesh::measure::measure;
use isoparticles_stage::error::Result;
use isoparticles_volume::Image;
use rayon::prelude::*;
use std::f64::consts::PI;

/// What is to be smoothed away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Twice the standard deviation of the Gaussian, mm.
    pub length: f64,
    /// Whether parts are kept that are thinner than such a mesh tells apart.
    pub keep_thin: bool,
}

/// Width of the window in which the volume is kept, in standard deviations of the smoothing: what bends within it may be rounded.
const WINDOW: f64 = 2.0;

/// Least width of the window, voxels: in a smaller one the steps of labels are what is kept.
const LEAST_WINDOW: f64 = 2.0;

/// Rounds that find the level. After six the volumes of heart and lungs are kept to 0.1 %.
const ROUNDS: usize = 6;

/// Furthest that the level moves in a round.
const LONGEST_STEP: f64 = 0.15;

/// Share of a level surface's density that is added to it, so that the level stays where no surface is near. That of a plane is 0.5.
const REGULAR: f64 = 0.02;

/// Least distance of the level from that of nothing and that of everything. What shows less is thinner than the mesh can carry: a ball of 1.2, a tube of 0.8
/// standard deviations, round which there is room for twelve vertices and for four.
const LEAST_LEVEL: f64 = 0.3;

/// The same where thin parts are to be kept: tubes of a quarter of a standard deviation, walls of a tenth.
const LEAST_LEVEL_THIN: f64 = 0.03;

/// Radius of the balls that are dropped, in scales: a mesh of the edge length that the scale is for ([`SCALE_OVER_SIZE`]) has 9 vertices round it.
const CRUMB_RADIUS: f64 = 0.5;

/// The scale that a mesh wants, over its edge length. `heart_label` (1.5 mm voxels) with h = 3.5 and 1.75 mm: mean and smallest radius ratio 0.985 / 0.69 and
/// 0.970 / 0.59 at 1, 0.989 / 0.67 and 0.981 / 0.72 at 1.4, 0.985 / 0.72 and 0.985 / 0.81 at 1.8, where 99 % of the voxels that changed side still
/// lay at the surface.
pub const SCALE_OVER_SIZE: f64 = 1.6;

/// How far round the object shares are smoothed, in standard deviations: beyond, the mean share of a half space is 0.001.
const REACH: f64 = 3.0;

/// The smoothed object.
pub struct Scaled {
    /// Zero on its surface, positive inside.
    pub level: Image<f32>,
    /// What is not as it was.
    pub changes: Changes,
}

/// The box round an object, smoothed.
struct Boxed {
    /// Its first voxel in the volume.
    first: [usize; 3],
    before: Occupancy,
    /// Zero on the surface, positive inside.
    level: Vec<f32>,
}

impl Boxed {
    /// `None` if there is no object.
    fn new(occupancy: &Occupancy, scale: Scale) -> Result<Option<Self>> {
        let Some((low, high)) = occupancy.extent() else { return Ok(None) };
        let geometry = &occupancy.geometry;
        let sigma = 0.5 * scale.length / geometry.spacing;
        let room = room_round(sigma);
        let first: [usize; 3] = std::array::from_fn(|axis| low[axis].saturating_sub(room[axis]));
        let size: [usize; 3] =
            std::array::from_fn(|axis| (high[axis] + 1 + room[axis]).min(geometry.size[axis]) - first[axis]);
        let before = Occupancy {
            geometry: geometry.cropped(first, size),
            shares: crop(&occupancy.shares, geometry.size, first, size),
        };
        let mut level = level_set(&before, sigma, scale.keep_thin).0;
        if !scale.keep_thin {
            remove_crumbs(&mut level, &before.geometry, smallest_part(scale.length))?;
        }
        Ok(Some(Self { first, before, level }))
    }
}

/// Voxels round an object that its smoothed share reaches; `sigma` in voxels.
pub(crate) fn room_round(sigma: DVec3) -> [usize; 3] {
    sigma.to_array().map(|sigma| (REACH * sigma).ceil() as usize + 2)
}

/// Volume (mm^3) below which a part is dropped.
pub(crate) fn smallest_part(scale: f64) -> f64 {
    4.0 / 3.0 * PI * (CRUMB_RADIUS * scale).powi(3)
}

/// Smooths an object. `None` if nothing is left of it.
///
/// # Errors
/// When its parts are too many to be told apart.
pub fn scaled(occupancy: Occupancy, scale: Scale) -> Result<Option<Scaled>> {
    let (geometry, volume) = (occupancy.geometry.clone(), occupancy.volume());
    let Some(Boxed { first, before, level }) = Boxed::new(&occupancy, scale)? else { return Ok(None) };
    drop(occupancy);
    let Some(changes) = Changes::between(&before, &level, volume, scale.length)? else { return Ok(None) };
    let size = before.geometry.size;
    drop(before);
    let mut whole = Image::filled(geometry, -0.5f32);
    paste(&level, size, &mut whole.data, whole.geometry.size, first);
    Ok(Some(Scaled { level: whole, changes }))
}

/// Standard deviation of the smoothing, in voxels, down to which areas are measured on a coarser grid.
const COARSE_SIGMA: f64 = 1.5;

/// Voxels of the coarsest grid, at least.
const FEWEST_VOXELS: usize = 10_000;

/// Rounds of scale and area that find an edge length, at most, and how near to each other two of them end the search.
const AREA_ROUNDS: (usize, f64) = (10, 0.01);

/// Edge lengths below this many voxels are not looked for: there is no object.
const SMALLEST_SHARE: f64 = 0.02;

/// The edge length (mm) of which a mesh of the object smoothed for it has about so many vertices. `None` if there is no object, or nothing
/// left of it.
///
/// # Errors
/// When its parts are too many to be told apart.
pub fn edge_length(occupancy: &Occupancy, vertices: f64, keep_thin: bool) -> Result<Option<f64>> {
    let mut coarser: Vec<Occupancy> = Vec::new();
    while coarser.last().unwrap_or(occupancy).shares.len() > 8 * FEWEST_VOXELS {
        coarser.push(coarser.last().unwrap_or(occupancy).halved());
    }
    let mut length = coarser.last().unwrap_or(occupancy).geometry.mean_spacing();
    for _ in 0..AREA_ROUNDS.0 {
        let scale = Scale { length: SCALE_OVER_SIZE * length, keep_thin };
        let coarse_enough = |grid: &&Occupancy| 0.5 * scale.length >= COARSE_SIGMA * grid.geometry.mean_spacing();
        let grid = coarser.iter().rev().find(coarse_enough).unwrap_or(occupancy);
        let area = Boxed::new(grid, scale)?.map_or(0.0, |boxed| {
            measure(&marching_cubes(&Image { geometry: boxed.before.geometry, data: boxed.level }, 0.0)).area
        });
        let found = (2.0 * area / (3f64.sqrt() * vertices)).sqrt();
        if (found / length - 1.0).abs() < AREA_ROUNDS.1 {
            return Ok(Some(found));
        }
        // the area falls with the scale, all of it where that is above the thickness of everything: not too far at a time
        let is_near = (0.5..2.0).contains(&(found / length));
        length = if is_near { found } else { length * (found / length).clamp(0.25, 4.0).sqrt() };
        if length < SMALLEST_SHARE * occupancy.geometry.mean_spacing() {
            break;
        }
    }
    Ok((length >= SMALLEST_SHARE * occupancy.geometry.mean_spacing()).then_some(length))
}

/// Values in a box of a grid.
fn crop(from: &[u8], whole: [usize; 3], first: [usize; 3], size: [usize; 3]) -> Vec<u8> {
    let rows = (0..size[1] * size[2]).map(|row| (row % size[1] + first[1], row / size[1] + first[2]));
    rows.flat_map(|(j, k)| &from[(k * whole[1] + j) * whole[0] + first[0]..][..size[0]]).copied().collect()
}

/// Puts values into a box of a grid.
fn paste(from: &[f32], size: [usize; 3], to: &mut [f32], whole: [usize; 3], first: [usize; 3]) {
    for (row, values) in from.chunks(size[0]).enumerate() {
        let (j, k) = (row % size[1] + first[1], row / size[1] + first[2]);
        to[(k * whole[1] + j) * whole[0] + first[0]..][..size[0]].copy_from_slice(values);
    }
}

/// The smoothed share less the level that keeps the volume of each place, and that level; `sigma` in voxels.
pub(crate) fn level_set(occupancy: &Occupancy, sigma: DVec3, keep_thin: bool) -> (Vec<f32>, Vec<f32>) {
    let size = occupancy.geometry.size;
    let share = |n: usize| f32::from(occupancy.shares[n]) / f32::from(WHOLE);
    let mut smoothed: Vec<f32> = (0..occupancy.shares.len()).into_par_iter().map(share).collect();
    smooth(&mut smoothed, size, sigma.to_array());
    let window = sigma.to_array().map(|sigma| (WINDOW * sigma).max(LEAST_WINDOW));
    let least = if keep_thin { LEAST_LEVEL_THIN } else { LEAST_LEVEL };
    let mut level = vec![0.5f32; smoothed.len()];
    for _ in 0..ROUNDS {
        let mut excess = vec![0.0f32; smoothed.len()];
        let mut density = vec![0.0f32; smoothed.len()];
        excess.par_iter_mut().zip(&mut density).enumerate().for_each(|(n, (excess, density))| {
            let width = change_across(&smoothed, size, n).max(1e-4);
            let part = 0.5 + (smoothed[n] - level[n]) / width;
            *excess = part.clamp(0.0, 1.0) - share(n);
            *density = if (0.0..1.0).contains(&part) { 1.0 / width } else { 0.0 };
        });
        smooth(&mut excess, size, window);
        smooth(&mut density, size, window);
        level.par_iter_mut().zip(&excess).zip(&density).for_each(|((level, excess), density)| {
            let step = f64::from(*excess) / (f64::from(*density) + REGULAR);
            let moved = f64::from(*level) + step.clamp(-LONGEST_STEP, LONGEST_STEP);
            *level = moved.clamp(least, 1.0 - least) as f32;
        });
    }
    smoothed.par_iter_mut().zip(&level).for_each(|(smoothed, level)| *smoothed -= level);
    (smoothed, level)
}

/// By how much values differ across a voxel: the sum of the slopes along the axes.
fn change_across(values: &[f32], size: [usize; 3], n: usize) -> f32 {
    let at = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
    let stride = [1, size[0], size[0] * size[1]];
    (0..3)
        .map(|axis| {
            let low = values[n - stride[axis] * usize::from(at[axis] > 0)];
            let high = values[n + stride[axis] * usize::from(at[axis] + 1 < size[axis])];
            0.5 * (high - low).abs()
        })
        .sum()
}
