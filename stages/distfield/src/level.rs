//! A level set of the smoothed occupancy that preserves the local volume.
//!
//! The occupancy of each voxel (its share that is inside, 0 to 1) is smoothed by a Gaussian. At
//! level 1/2 planes stay in place, convex surfaces shrink, and thin parts vanish. The level
//! therefore varies in space such that the volume within a window equals that of the occupancy. It
//! starts as the mean of the smoothed occupancy on the voxel faces between inside and outside, and
//! is then corrected by the difference of the volumes.
//!
//! With a clearance, every voxel centre keeps its side: sources are added at violating centres and
//! spread over their neighbours, so that the surface stays smooth there. Contacts are kept in the
//! same way.
//!
//! All lengths are in voxels along each axis. The staircase has the grid's spacing, so thick slices
//! need a wider Gaussian in mm.

use crate::bits::Bits;
use crate::gaussian::smooth;
use crate::mask::Mask;
use crate::occupancy::{Occupancy, WHOLE};
use crate::runs::Runs;
use glam::DVec3;
use isoparticles_field::marching_cubes::MIDPOINT_BEND;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Parameters of the level set.
pub(crate) struct Smoothing {
    /// Standard deviations of the Gaussian along the axes, voxels.
    pub sigma: DVec3,
    /// Minimum distance of the level from 0 and from 1. Parts whose smoothed occupancy stays below
    /// it vanish. With 0 the level is unbounded.
    pub least_level: f64,
    /// Distance to be kept from voxel centres; `None` lets centres change sides.
    pub clearance: Option<Clearance>,
}

/// Constraints on the surface: its distance from voxel centres, and contacts.
pub(crate) struct Clearance {
    /// Minimum distance from every voxel centre, in voxels (minimum spacing).
    pub distance: f64,
    /// The contacts to keep.
    pub contacts: Vec<Contact>,
}

/// A point between voxel centres of both sides whose side is prescribed: the middle of a grid edge
/// where two parts touch, or a grid corner that such edges share.
pub(crate) struct Contact {
    /// The lowest of the voxels around it.
    first: usize,
    /// The axes along which these voxels are neighbours: two or three.
    across: [bool; 3],
    /// Whether the point is inside.
    is_inside: bool,
}

impl Contact {
    /// The voxels around the point: four or eight.
    fn voxels(&self, size: [usize; 3]) -> impl Iterator<Item = usize> {
        let (stride, across, first) = (strides(size), self.across, self.first);
        let axes = move |n: usize| (0..3).filter(move |axis| n >> axis & 1 == 1);
        let along = (0..8).filter(move |&n| axes(n).all(|axis| across[axis]));
        along.map(move |n| first + axes(n).map(|axis| stride[axis]).sum::<usize>())
    }
}

/// Index strides along the axes.
fn strides([nx, ny, _]: [usize; 3]) -> [usize; 3] {
    [1, nx, nx * ny]
}

/// A level set on a grid of voxels, x fastest.
pub(crate) struct LevelSet {
    /// The smoothed occupancy minus the level: positive inside.
    pub above: Vec<f32>,
    /// The level, 0 to 1; empty if it is unbounded.
    pub level: Vec<f32>,
}

/// Standard deviations of the two windows, over that of the smoothing: for the initial level and
/// for the volume. Wider windows leave flat faces less flat near their edges; narrower ones follow
/// the staircase (tests `flat_faces_and_caps_stay_flat`, `a_binary_ball_becomes_round`).
const WINDOWS: [f64; 2] = [1.33, 2.67];

/// Rounds of source and volume corrections. After six rounds, plates, rods and shells have their
/// volume (test `thin_layers_and_rods_keep_their_volume`). [`Sources::hold`] moves the centres that
/// are still too near to the surface.
const ROUNDS: usize = 6;

/// Maximum change of the level in a round.
const LONGEST_STEP: f64 = 0.1;

/// Added to the density of the surface, so that the step stays finite where there is no surface. A
/// plane in the middle of the window has a density of 0.37.
const LEAST_DENSITY: f64 = 0.002;

/// Minimum slope used for distances, over that of a plane. The slope vanishes in the middle of a
/// thin part and of a contact.
const LEAST_SLOPE: f64 = 0.15;

/// Value, slopes and second differences along the axes at a voxel. Values are mirrored half a voxel
/// beyond the faces of the grid.
#[derive(Clone, Copy)]
struct Shape {
    own: f32,
    slope: [f32; 3],
    bend: [f32; 3],
}

/// A row of values and the rows around it.
struct Around<'a> {
    own: &'a [f32],
    y: [&'a [f32]; 2],
    z: [&'a [f32]; 2],
    /// The rows that are neighbours along both y and z.
    yz: [[&'a [f32]; 2]; 2],
}

impl<'a> Around<'a> {
    fn row(values: &'a [f32], [nx, ny, nz]: [usize; 3], row: usize) -> Self {
        let (j, k) = (row % ny, row / ny);
        let line = |j: usize, k: usize| &values[(k * ny + j) * nx..][..nx];
        let (front, back) = (j.saturating_sub(1), (j + 1).min(ny - 1));
        let (below, above) = (k.saturating_sub(1), (k + 1).min(nz - 1));
        Self {
            own: line(j, k),
            y: [line(front, k), line(back, k)],
            z: [line(j, below), line(j, above)],
            yz: [front, back].map(|j| [line(j, below), line(j, above)]),
        }
    }

    #[inline(always)]
    fn shape(&self, i: usize) -> Shape {
        let own = self.own[i];
        let x = [self.own[i.saturating_sub(1)], self.own[(i + 1).min(self.own.len() - 1)]];
        let pairs = [x, self.y.map(|row| row[i]), self.z.map(|row| row[i])];
        let slope = pairs.map(|[low, high]| 0.5 * (high - low));
        let bend = pairs.map(|[low, high]| low + high - 2.0 * own);
        Shape { own, slope, bend }
    }

    /// Mixed second differences: xy, yz, zx.
    #[inline(always)]
    fn mixed(&self, i: usize) -> [f32; 3] {
        let x = [i.saturating_sub(1), (i + 1).min(self.own.len() - 1)];
        let of = |[[a, b], [c, d]]: [[f32; 2]; 2]| 0.25 * (a - b - c + d);
        [
            of(self.y.map(|row| x.map(|i| row[i]))),
            of(self.yz.map(|rows| rows.map(|row| row[i]))),
            of(self.z.map(|row| x.map(|i| row[i]))),
        ]
    }
}

impl Shape {
    /// Share of the voxel in which the value is above zero, and the derivative of this share by the
    /// value.
    ///
    /// The voxel is divided into eight parts. In each, the value is taken as a plane that changes
    /// by `width` across the part. `mixed` gives the mixed second differences; without them, the
    /// volume of a rod of 2 by 2 voxels is off by 3 %.
    #[inline(always)]
    fn part_above(&self, mixed: impl FnOnce() -> [f32; 3]) -> (f32, f32) {
        let reach: f32 = (0..3).map(|a| 0.5 * (self.slope[a].abs() + self.bend[a].abs())).sum();
        if self.own.abs() > reach {
            return (if self.own > 0.0 { 1.0 } else { 0.0 }, 0.0);
        }
        let [xy, yz, zx] = mixed();
        let across = [[0.0, xy, zx], [xy, 0.0, yz], [zx, yz, 0.0]];
        let (mut part, mut density) = (0.0, 0.0);
        // mean of the value over a part of half a voxel, which differs from the value in its middle
        let mean = self.own + self.bend.iter().sum::<f32>() / 96.0;
        for corner in 0..8 {
            let (mut value, mut width) = (mean, 1e-4);
            let at: [f32; 3] = [0, 1, 2].map(|axis| if corner >> axis & 1 == 0 { -0.25 } else { 0.25 });
            for axis in 0..3 {
                let twist: f32 = (0..3).map(|other| at[other] * across[axis][other]).sum();
                value += at[axis] * (self.slope[axis] + 0.5 * (at[axis] * self.bend[axis] + twist));
                width += 0.5 * (self.slope[axis] + at[axis] * self.bend[axis] + twist).abs();
            }
            let share = 0.5 + value / width;
            part += 0.125 * share.clamp(0.0, 1.0);
            density += if (0.0..1.0).contains(&share) { 0.125 / width } else { 0.0 };
        }
        (part, density)
    }
}

/// The level set of an occupancy.
pub(crate) fn level_set(occupancy: &Occupancy, smoothing: &Smoothing) -> LevelSet {
    let mut work = Work::new(occupancy, smoothing);
    let mut sources = smoothing.clearance.as_ref().map(|clearance| Sources::new(occupancy, clearance));
    for _ in 0..ROUNDS {
        if let Some(sources) = &mut sources {
            sources.grow(&mut work);
        }
        work.keep_volume();
    }
    if let Some(sources) = &mut sources {
        sources.hold(&mut work);
    }
    LevelSet { above: work.above, level: work.level }
}

struct Work<'a> {
    occupancy: &'a Occupancy,
    smoothing: &'a Smoothing,
    size: [usize; 3],
    above: Vec<f32>,
    level: Vec<f32>,
}

impl<'a> Work<'a> {
    fn new(occupancy: &'a Occupancy, smoothing: &'a Smoothing) -> Self {
        let size = occupancy.geometry.size;
        let mut above: Vec<f32> = (0..occupancy.shares.len()).into_par_iter().map(|n| share(occupancy, n)).collect();
        smooth(&mut above, size, smoothing.sigma.to_array());
        let count = if smoothing.least_level > 0.0 { above.len() } else { 0 };
        let mut work = Self { occupancy, smoothing, size, above, level: vec![0.0; count] };
        let first = work.first_level();
        work.raise_level(&first);
        work
    }

    /// Mean of the smoothed occupancy on the faces between voxels of different sides, within a
    /// window; 0.5 where there are no such faces.
    fn first_level(&self) -> Blocks<f32> {
        let Self { occupancy, above, size, .. } = self;
        let [nx, ny, nz] = *size;
        let mut sums = Blocks::of(*size, |row| {
            let (j, k) = (row % ny, row / ny);
            move |i| {
                let n = row * nx + i;
                let side = occupancy.is_inside(n);
                let mut sum = [0.0; 2];
                let mut add = |exists: bool, near: usize| {
                    if exists && occupancy.is_inside(near) != side {
                        sum[0] += 0.5 * (above[n] + above[near]);
                        sum[1] += 1.0;
                    }
                };
                add(i > 0, n.wrapping_sub(1));
                add(i + 1 < nx, n + 1);
                add(j > 0, n.wrapping_sub(nx));
                add(j + 1 < ny, n + nx);
                add(k > 0, n.wrapping_sub(nx * ny));
                add(k + 1 < nz, n + nx * ny);
                sum
            }
        });
        sums.smooth(WINDOWS[0] * self.smoothing.sigma);
        sums.map(|[sum, count]| if count > 1e-6 { sum / count } else { 0.5 })
    }

    /// Corrects the level by the excess or deficit of volume within the window.
    fn keep_volume(&mut self) {
        let (occupancy, above, size) = (self.occupancy, &self.above, self.size);
        let mut sums = Blocks::of(size, |row| {
            let around = Around::row(above, size, row);
            move |i| {
                let (part, density) = around.shape(i).part_above(|| around.mixed(i));
                [part - share(occupancy, row * size[0] + i), density]
            }
        });
        sums.smooth(WINDOWS[1] * self.smoothing.sigma);
        let longest = LONGEST_STEP as f32;
        let steps = sums.map(|[excess, density]| (excess / (density + LEAST_DENSITY as f32)).clamp(-longest, longest));
        self.raise_level(&steps);
    }

    /// Slope of the smoothed occupancy at a plane, per voxel.
    fn plane_slope(&self) -> f64 {
        1.0 / (TAU.sqrt() * self.smoothing.sigma.max_element())
    }

    /// Raises the level by interpolated block values, within its bounds.
    fn raise_level(&mut self, steps: &Blocks<f32>) {
        let nx = self.size[0];
        let [least, most] = [self.smoothing.least_level as f32, 1.0 - self.smoothing.least_level as f32];
        let has_level = !self.level.is_empty();
        let levels = self.level.par_chunks_mut(nx.max(1));
        if has_level {
            self.above.par_chunks_mut(nx).zip(levels).enumerate().for_each(|(row, (above, level))| {
                for (i, (above, level)) in above.iter_mut().zip(level).enumerate() {
                    let next = (*level + steps.at(row, i)).clamp(least, most);
                    *above += *level - next;
                    *level = next;
                }
            });
        } else {
            self.above.par_chunks_mut(nx).enumerate().for_each(|(row, above)| {
                above.iter_mut().enumerate().for_each(|(i, above)| *above -= steps.at(row, i));
            });
        }
    }
}

/// Values on blocks of two voxels along each axis; windows are several voxels wide.
struct Blocks<T> {
    /// Voxels along each axis.
    voxels: [usize; 3],
    values: Vec<T>,
}

/// Blocks along each axis.
fn blocks_along(voxels: [usize; 3]) -> [usize; 3] {
    voxels.map(|n| n.div_ceil(2))
}

impl Blocks<[f32; 2]> {
    /// Sums of two values per voxel. `values(row)` returns a function of the x index that gives
    /// them.
    fn of<Row: Fn(usize) -> [f32; 2]>(voxels: [usize; 3], values: impl Fn(usize) -> Row + Sync) -> Self {
        let [nx, ny, nz] = voxels;
        let [bx, by, bz] = blocks_along(voxels);
        let mut sums = vec![[0.0; 2]; bx * by * bz];
        sums.par_chunks_mut(bx).enumerate().for_each(|(block_row, sums)| {
            let (j, k) = (2 * (block_row % by), 2 * (block_row / by));
            for (j, k) in [(j, k), (j + 1, k), (j, k + 1), (j + 1, k + 1)] {
                if j < ny && k < nz {
                    let row = values(k * ny + j);
                    for i in 0..nx {
                        let value = row(i);
                        let sum = &mut sums[i / 2];
                        *sum = [sum[0] + value[0], sum[1] + value[1]];
                    }
                }
            }
        });
        Self { voxels, values: sums }
    }

    /// Smooths both values by a Gaussian with standard deviations `sigma`, voxels. Binning into
    /// blocks already adds a variance of 0.25.
    fn smooth(&mut self, sigma: DVec3) {
        let size = blocks_along(self.voxels);
        let sigma = sigma.to_array().map(|sigma| 0.5 * (sigma * sigma - 0.25).max(0.25).sqrt());
        for n in 0..2 {
            let mut values: Vec<f32> = self.values.par_iter().map(|value| value[n]).collect();
            smooth(&mut values, size, sigma);
            self.values.par_iter_mut().zip(values).for_each(|(to, value)| to[n] = value);
        }
    }

    fn map(&self, value: impl Fn([f32; 2]) -> f32 + Sync) -> Blocks<f32> {
        Blocks { voxels: self.voxels, values: self.values.par_iter().map(|&own| value(own)).collect() }
    }
}

impl Blocks<f32> {
    /// The value at a voxel, by trilinear interpolation between block centres.
    #[inline(always)]
    fn at(&self, row: usize, i: usize) -> f32 {
        let ny = self.voxels[1];
        let size = blocks_along(self.voxels);
        let pair = |at: usize, size: usize| {
            let own = at / 2;
            let other = if at.is_multiple_of(2) { own.saturating_sub(1) } else { (own + 1).min(size - 1) };
            [(own, 0.75f32), (other, 0.25)]
        };
        let (x, y, z) = (pair(i, size[0]), pair(row % ny, size[1]), pair(row / ny, size[2]));
        let mut sum = 0.0;
        for (k, wz) in z {
            for (j, wy) in y {
                let row = &self.values[(k * size[1] + j) * size[0]..][..size[0]];
                sum += wz * wy * (x[0].1 * row[x[0].0] + x[1].1 * row[x[1].0]);
            }
        }
        sum
    }
}

fn share(occupancy: &Occupancy, voxel: usize) -> f32 {
    f32::from(occupancy.shares[voxel]) / f32::from(WHOLE)
}

/// Corrections to the level set near voxel centres that are on the wrong side of the surface or too
/// near to it.
struct Sources<'a> {
    /// Voxels with a voxel of the other side among their 26 neighbours.
    near: Runs,
    /// Source at each of these voxels, towards its own side; at least zero.
    added: Vec<f32>,
    /// Minimum distance from the surface, mm.
    least: f32,
    contacts: &'a [Contact],
    /// For the voxels of contacts: how much they must rise so that the value at the contact reaches
    /// its minimum; negative if it exceeds it. Minus infinity at voxels without a contact.
    short: Vec<f32>,
}

impl<'a> Sources<'a> {
    fn new(occupancy: &Occupancy, clearance: &'a Clearance) -> Self {
        let size = occupancy.geometry.size;
        let inside = Bits::of(occupancy.shares.len(), |n| occupancy.is_inside(n));
        let near = inside.near_the_rest(strides(size));
        let near = Runs::of(size, |n| near.holds(n));
        let least = (clearance.distance * occupancy.geometry.min_spacing()) as f32;
        let all = |value: f32| vec![value; near.count];
        Self { added: all(0.0), short: all(f32::NEG_INFINITY), near, least, contacts: &clearance.contacts }
    }

    /// Slope (per mm) assumed where the actual slope is smaller: in the middle of thin parts and of
    /// contacts.
    fn least_slope(work: &Work) -> f64 {
        LEAST_SLOPE * work.plane_slope() / work.occupancy.geometry.spacing.max_element()
    }

    /// Computes how much the voxels of each contact must rise for its minimum value, and stores the
    /// maximum over the contacts of a voxel.
    fn look_at_contacts(&mut self, work: &Work) {
        self.short.fill(f32::NEG_INFINITY);
        let wanted = self.least * Self::least_slope(work) as f32;
        let nx = work.size[0];
        let short = |contact: &Contact| {
            let (mut sum, mut count) = (0.0, 0.0);
            for voxel in contact.voxels(work.size) {
                let shape = Around::row(&work.above, work.size, voxel / nx).shape(voxel % nx);
                let bend: f32 = (0..3).filter(|&axis| contact.across[axis]).map(|axis| shape.bend[axis]).sum();
                sum += shape.own - MIDPOINT_BEND as f32 * bend;
                count += 1.0;
            }
            (wanted - if contact.is_inside { sum / count } else { -sum / count }) / GAIN_AT_CONTACT
        };
        let short: Vec<f32> = self.contacts.par_iter().map(short).collect();
        for (contact, short) in self.contacts.iter().zip(short) {
            let own = contact.voxels(work.size).filter(|&n| work.occupancy.is_inside(n) == contact.is_inside);
            for number in own.filter_map(|voxel| self.near.number(voxel)) {
                self.short[number] = self.short[number].max(short);
            }
        }
    }

    /// Calls `each(number, voxel, lack)` for the near voxels of slice `k`. `number` counts them
    /// within the slice. `lack` is how far the value falls short of that at the minimum distance;
    /// positive if it is too small.
    fn each_lack(&self, work: &Work, k: usize, mut each: impl FnMut(usize, usize, f32)) {
        let [nx, ny, _] = work.size;
        let spacing = work.occupancy.geometry.spacing;
        let least_slope = Self::least_slope(work);
        let mut number = 0;
        for row in k * ny..(k + 1) * ny {
            let runs = self.near.row(row);
            let around = Around::row(&work.above, work.size, row);
            for run in runs {
                for i in run.columns() {
                    let shape = around.shape(i);
                    let slope = (DVec3::from_array(shape.slope.map(f64::from)) / spacing).length();
                    let n = row * nx + i;
                    let value = if work.occupancy.is_inside(n) { shape.own } else { -shape.own };
                    let lack = self.least * slope.max(least_slope) as f32 - value;
                    let short = self.short[run.number + i - run.first as usize];
                    each(number, n, lack.max(short));
                    number += 1;
                }
            }
        }
    }

    /// Adds sources at voxel centres that are too near to the surface, and reduces them at centres
    /// that are farther away than required.
    fn grow(&mut self, work: &mut Work) {
        self.look_at_contacts(work);
        let lacking = self.lacking(work);
        let mut added = std::mem::take(&mut self.added);
        let slices = self.near.slices(&mut added);
        let own = &*self;
        let changes: Vec<Vec<(usize, f32)>> = slices
            .into_par_iter()
            .enumerate()
            .map(|(k, added)| {
                let mut changes = Vec::new();
                own.each_lack(work, k, |number, n, lack| {
                    // how much unit sources at all violating voxels would raise this one
                    let gain: f32 = near_pairs(n, work.size)
                        .filter(|&(near, _)| lacking.holds(near))
                        .map(|(_, weight)| weight)
                        .sum();
                    let next = (added[number] + lack / gain.max(OWN_WEIGHT)).max(0.0);
                    if next != added[number] {
                        let sign = if work.occupancy.is_inside(n) { 1.0 } else { -1.0 };
                        changes.push((n, sign * (next - added[number])));
                        added[number] = next;
                    }
                });
                changes
            })
            .collect();
        self.added = added;
        let size = work.size;
        work.above.par_chunks_mut(size[0] * size[1]).enumerate().for_each(|(k, slice)| {
            changes[k.saturating_sub(2)..(k + 3).min(size[2])].iter().for_each(|own| spread(own, k, size, slice));
        });
    }

    /// The voxels that are too near to the surface.
    fn lacking(&self, work: &Work) -> Bits {
        let slices = (0..work.size[2]).into_par_iter().map(|k| {
            let mut found = Vec::new();
            self.each_lack(work, k, |_, n, lack| {
                if lack > 0.0 {
                    found.push(n);
                }
            });
            found
        });
        let mut lacking = Bits::none(work.above.len());
        for n in slices.collect::<Vec<_>>().into_iter().flatten() {
            lacking.insert(n..n + 1);
        }
        lacking
    }

    /// Moves the remaining violating voxel centres and contacts to their minimum distance. Also
    /// corrects centres on the wrong side that no source reaches.
    fn hold(&mut self, work: &mut Work) {
        let occupancy = work.occupancy;
        for _ in 0..HOLDS {
            self.look_at_contacts(work);
            let own = &*self;
            let slices = (0..work.size[2]).into_par_iter().map(|k| {
                let mut held = Vec::new();
                own.each_lack(work, k, |_, n, lack| {
                    if lack > 0.0 {
                        held.push((n, lack));
                    }
                });
                held
            });
            let held: Vec<(usize, f32)> = slices.collect::<Vec<_>>().into_iter().flatten().collect();
            if held.is_empty() {
                break;
            }
            for (n, lack) in held {
                work.above[n] += if occupancy.is_inside(n) { lack } else { -lack };
            }
        }
        work.above.par_iter_mut().enumerate().for_each(|(n, above)| {
            if (*above > 0.0) != occupancy.is_inside(n) {
                *above = if occupancy.is_inside(n) { CLEAR_VALUE } else { -CLEAR_VALUE };
            }
        });
    }
}

/// How much the middle of an edge rises if the two voxels on its side rise by one: 0.5 from the
/// mean, 0.4 from their second differences and -0.2 from those of the other two.
const GAIN_AT_CONTACT: f32 = 0.7;

/// Maximum number of passes that hold voxel centres and contacts. Neighbours change each other's
/// slopes and second differences.
const HOLDS: usize = 6;

/// Value given to a voxel on the wrong side that has no voxel of the other side beside it. Between
/// specks a few voxels apart, the smoothed occupancy can exceed the level.
const CLEAR_VALUE: f32 = 0.1;

/// Kernel of a unit source by distance in voxels along one axis: a Gaussian with standard deviation
/// 0.75. The weights of the three axes multiply.
const SPREAD: [f32; 3] = [0.532, 0.219, 0.015];

/// How much a unit source raises its own voxel.
const OWN_WEIGHT: f32 = SPREAD[0] * SPREAD[0] * SPREAD[0];

/// A voxel and its 26 neighbours on the grid, each with the amount by which a unit source at
/// `voxel` raises it.
fn near_pairs(voxel: usize, [nx, ny, nz]: [usize; 3]) -> impl Iterator<Item = (usize, f32)> {
    let at = [voxel % nx, voxel / nx % ny, voxel / (nx * ny)];
    (0..27).filter_map(move |n| {
        let step = [n % 3, n / 3 % 3, n / 9];
        let weight = step.iter().map(|&s| SPREAD[usize::from(s != 1)]).product();
        let [i, j, k] = std::array::from_fn(|a| (at[a] + step[a]).wrapping_sub(1));
        (i < nx && j < ny && k < nz).then(|| ((k * ny + j) * nx + i, weight))
    })
}

/// The positions along an axis that a source raises, with their weights. Positions beyond the ends
/// are mirrored.
fn spread_along(at: usize, count: usize) -> [(usize, f32); 5] {
    std::array::from_fn(|n| {
        let to = (at + n).checked_sub(2).unwrap_or(1 - (at + n).min(1));
        let to = if to < count { to } else { (2 * count - 1).saturating_sub(to) };
        (to, SPREAD[n.abs_diff(2)])
    })
}

/// Adds sources, each given by its voxel and its strength, to the voxels of slice `k`.
fn spread(sources: &[(usize, f32)], k: usize, [nx, ny, nz]: [usize; 3], slice: &mut [f32]) {
    for &(n, change) in sources {
        let across: f32 = spread_along(n / (nx * ny), nz).iter().filter(|to| to.0 == k).map(|to| to.1).sum();
        let columns = spread_along(n % nx, nx);
        for (j, weight) in spread_along(n / nx % ny, ny) {
            let row = &mut slice[j * nx..][..nx];
            columns.iter().for_each(|&(i, own)| row[i] += change * across * weight * own);
        }
    }
}

/// The contacts of a mask. Inside parts are connected, unless `gives_way` is true for the two
/// outside voxels at an edge. A grid corner shared by several contacts of the same side takes their
/// side; without it, only a row of separate bridges would connect the parts.
pub(crate) fn contacts(mask: &Mask, gives_way: impl Fn([usize; 2]) -> bool + Sync) -> Vec<Contact> {
    let size = mask.geometry.size;
    let [nx, ny, nz] = size;
    let stride = strides(size);
    let slices = (0..nz).into_par_iter().flat_map_iter(|k| {
        let mut found = Vec::new();
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut across = [true; 3];
            across[axis] = false;
            mask.inside.each_alternating(k * nx * ny..(k + 1) * nx * ny, [stride[u], stride[v]], |first| {
                let at = [first % nx, first / nx % ny, k];
                if at[u] + 1 < size[u] && at[v] + 1 < size[v] {
                    let diagonals = [[first, first + stride[u] + stride[v]], [first + stride[u], first + stride[v]]];
                    let outside = diagonals[usize::from(mask.inside.holds(first))];
                    found.push(Contact { first, across, is_inside: !gives_way(outside) });
                }
            });
        }
        found
    });
    let mut contacts: Vec<Contact> = slices.collect();
    let mut corners: Vec<(usize, bool)> = Vec::new();
    for contact in &contacts {
        let axis = contact.across.iter().position(|across| !across).unwrap_or(0);
        let at = contact.first / stride[axis] % size[axis];
        corners.extend((at > 0).then(|| (contact.first - stride[axis], contact.is_inside)));
        corners.extend((at + 1 < size[axis]).then_some((contact.first, contact.is_inside)));
    }
    corners.sort_unstable();
    for shared in corners.chunk_by(|a, b| a.0 == b.0) {
        let (first, is_inside) = shared[0];
        if shared.len() > 1 && shared.iter().all(|corner| corner.1 == is_inside) {
            contacts.push(Contact { first, across: [true; 3], is_inside });
        }
    }
    contacts
}
