//! What the indicators make of the volume: the material of every node and its distance from the next one, volumes of materials and areas of their interfaces,
//! places where three and four meet, and voxel centres that changed.

use super::grid::LabelGrid;
use crate::Border;
use glam::DVec3;
use isoparticles_field::materials::{Indicators, KNOWN_VOXELS, MaterialId};
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::Range;

/// Two materials that touch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interface {
    /// The materials, the lower number first.
    pub materials: [MaterialId; 2],
    /// Area of the sheet, mm^2.
    pub area: f64,
    /// Grid edges that it crosses.
    pub crossings: usize,
}

/// Where three and more materials meet, by the nodes: grid faces are crossed by junction curves, cells hold junction points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Junctions {
    /// Grid faces whose corners are of three materials.
    pub edges_of_three: usize,
    /// Grid faces whose corners are of four.
    pub edges_of_four: usize,
    /// Grid cells whose corners are of four materials or more.
    pub corners: usize,
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// Number of the material of each node, x fastest.
    pub material: Vec<u16>,
    /// Half the difference of the two smallest indicators at each node, mm, no more than [`distance_limit`].
    pub interface_distance: Vec<f32>,
    /// Voxel centres of each material that another one has taken.
    pub changed: Vec<usize>,
    /// Volume of each material, mm^3; of the outside that within the volume's own voxels alone.
    pub volumes: Vec<f64>,
    /// The pairs that touch.
    pub interfaces: Vec<Interface>,
    /// Where more than two meet.
    pub junctions: Junctions,
}

/// Distance (mm) from which on two indicators are not both known everywhere.
pub fn distance_limit(geometry: &Geometry) -> f64 {
    KNOWN_VOXELS as f64 * geometry.min_spacing()
}

/// What the sheets add up to in some slices.
#[derive(Default)]
struct Sums {
    /// Of each pair: area in mm^2, crossings.
    pairs: BTreeMap<[MaterialId; 2], (f64, usize)>,
    /// Of each material: volume, mm^3, nodes and what crossings add.
    volumes: BTreeMap<MaterialId, f64>,
    junctions: Junctions,
}

/// Looks at every node of the padded grid and the edges between them.
///
/// The area of a sheet is that of the grid's faces it crosses, each weighted by the share |n_a| of its unit normal along the edge that crosses it: the
/// faces across axis a that a piece dA of the sheet crosses have the area |n_a| dA, and the squares of n_a sum to one. The volume of a material is its voxels', and at
/// each crossing the part of the edge between its middle and the sheet.
///
/// # Errors
/// When the run is interrupted.
pub fn survey(
    indicators: &impl Indicators,
    geometry: &Geometry,
    grid: &LabelGrid,
    materials: usize,
    monitor: &dyn Monitor,
) -> Result<Survey> {
    let [nx, ny, _] = geometry.size;
    let plane = nx * ny;
    let limit = distance_limit(geometry) as f32;
    let (mut material, mut distance) = (vec![0u16; geometry.voxel_count()], vec![0.0f32; geometry.voxel_count()]);
    let place = |i: usize, j: usize, k: usize| geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64));
    let slices = material.par_chunks_mut(plane).zip(distance.par_chunks_mut(plane)).enumerate();
    let changed: Vec<BTreeMap<MaterialId, usize>> = slices
        .map(|(k, (material, distance))| {
            let mut changed = BTreeMap::new();
            for (n, (material, distance)) in material.iter_mut().zip(distance).enumerate() {
                let (i, j) = (n % nx, n / nx);
                let near = indicators.near(place(i, j, k));
                let own = near.first().unwrap_or(MaterialId::OUTSIDE);
                *material = own.0;
                *distance = (near.interface_distance() as f32).min(limit);
                let label = grid.at([i, j, k]);
                if label != own {
                    *changed.entry(label).or_default() += 1;
                }
            }
            changed
        })
        .collect();
    monitor.check()?;
    // beyond an open border the sheets go on, but are none of the volume's
    let counted: [Range<usize>; 3] = std::array::from_fn(|a| match grid.border {
        Border::Cap => 0..geometry.size[a],
        Border::Open => grid.margin..geometry.size[a] - grid.margin,
    });
    let slices = counted[2].clone().into_par_iter();
    let sums: Vec<Sums> = slices.map(|k| slice_sums(indicators, geometry, &material, &counted, k)).collect();
    monitor.check()?;
    let mut survey = Survey { changed: vec![0; materials], volumes: vec![0.0; materials], ..Survey::default() };
    for (id, count) in changed.into_iter().flatten() {
        survey.changed[id.index()] += count;
    }
    let voxel = geometry.spacing.element_product();
    let mut pairs: BTreeMap<[MaterialId; 2], (f64, usize)> = BTreeMap::new();
    for slice in sums {
        for (pair, (area, crossings)) in slice.pairs {
            let sum = pairs.entry(pair).or_default();
            *sum = (sum.0 + area, sum.1 + crossings);
        }
        for (id, volume) in slice.volumes {
            survey.volumes[id.index()] += volume;
        }
        let (all, own) = (&mut survey.junctions, slice.junctions);
        all.edges_of_three += own.edges_of_three;
        all.edges_of_four += own.edges_of_four;
        all.corners += own.corners;
    }
    let [vx, vy, vz] = grid.geometry.size;
    for (j, k) in (0..vz).flat_map(|k| (0..vy).map(move |j| (j, k))) {
        let start = ((k + grid.margin) * ny + j + grid.margin) * nx + grid.margin;
        material[start..start + vx].iter().for_each(|&number| survey.volumes[usize::from(number)] += voxel);
    }
    let told = |(materials, (area, crossings))| Interface { materials, area, crossings };
    survey.interfaces = pairs.into_iter().map(told).collect();
    (survey.material, survey.interface_distance) = (material, distance);
    Ok(survey)
}

/// What lies in a slice and between it and the next, of the nodes that are counted.
fn slice_sums(
    indicators: &impl Indicators,
    geometry: &Geometry,
    material: &[u16],
    counted: &[Range<usize>; 3],
    k: usize,
) -> Sums {
    let [nx, ny, _] = geometry.size;
    let stride = [1, nx, nx * ny];
    let mut sums = Sums::default();
    for (i, j) in counted[1].clone().flat_map(|j| counted[0].clone().map(move |i| (i, j))) {
        let (at, n) = ([i, j, k], (k * ny + j) * nx + i);
        let has_next: [bool; 3] = std::array::from_fn(|a| at[a] + 1 < counted[a].end);
        for axis in 0..3 {
            if has_next[axis] && material[n] != material[n + stride[axis]] {
                sums.add_crossing(indicators, geometry, at, axis, [material[n], material[n + stride[axis]]]);
            }
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            if has_next[u] && has_next[v] {
                sums.add_face([0, stride[u], stride[v], stride[u] + stride[v]].map(|step| material[n + step]));
            }
        }
        if has_next == [true; 3] {
            let corner = |c: usize| material[n + (c & 1) + (c >> 1 & 1) * nx + (c >> 2) * nx * ny];
            sums.junctions.corners += usize::from(distinct(std::array::from_fn::<u16, 8, _>(corner)) >= 4);
        }
    }
    sums
}

/// How many different numbers there are.
fn distinct<const N: usize>(mut numbers: [u16; N]) -> usize {
    if numbers.iter().all(|number| *number == numbers[0]) {
        return 1;
    }
    numbers.sort_unstable();
    1 + numbers.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

impl Sums {
    /// Counts a face of the grid by the materials of its corners.
    fn add_face(&mut self, corners: [u16; 4]) {
        match distinct(corners) {
            3 => self.junctions.edges_of_three += 1,
            4 => self.junctions.edges_of_four += 1,
            _ => {}
        }
    }

    /// Adds the sheet between a node and the next one along an axis.
    fn add_crossing(
        &mut self,
        indicators: &impl Indicators,
        geometry: &Geometry,
        at: [usize; 3],
        axis: usize,
        numbers: [u16; 2],
    ) {
        let [i, j] = numbers.map(MaterialId);
        let step = DVec3::AXES[axis] * geometry.spacing[axis];
        let start = geometry.index_to_grid(DVec3::from_array(at.map(|n| n as f64)));
        let value = |p: DVec3| indicators.difference_gradient(i, j, p).0;
        let (low, high) = (value(start), value(start + step));
        // negative at the node itself, positive at the next, unless one of the two is not known there
        let share = if low < 0.0 && high > 0.0 && (high - low).is_finite() { low / (low - high) } else { 0.5 };
        let (_, gradient) = indicators.difference_gradient(i, j, start + step * share);
        let face = geometry.spacing.element_product() / geometry.spacing[axis];
        let weight = gradient.try_normalize().map_or(1.0 / 3f64.sqrt(), |normal| normal[axis].abs());
        let pair = self.pairs.entry([i.min(j), i.max(j)]).or_default();
        *pair = (pair.0 + face * weight, pair.1 + 1);
        // a third for each axis: each of them alone gives the volume
        let moved = face * geometry.spacing[axis] * (share - 0.5) / 3.0;
        *self.volumes.entry(i).or_default() += moved;
        *self.volumes.entry(j).or_default() -= moved;
    }
}
