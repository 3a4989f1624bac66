//! Computes a level set of the smoothed occupancy that preserves the local volume.
//!
//! The occupancy of a voxel is the fraction of its volume that is inside, 0 to 1. It is smoothed by
//! a Gaussian. At a constant level of 1/2, planes stay in place, convex surfaces shrink, and thin
//! parts vanish. The level therefore varies in space, so that the volume is preserved within a
//! window wider than the Gaussian. It starts as the mean of the smoothed occupancy on the voxel
//! faces between inside and outside. In each round of corrections, every block of voxels transfers
//! its excess or deficit of volume to the surface within the window. The transfers preserve the
//! total volume.
//!
//! If a clearance is given, every voxel centre stays on its side of the surface, at a minimum
//! distance. At voxel centres that violate this condition, sources raise or lower the values of the
//! level set. Each source acts on the neighbouring voxels as well, so that the surface stays
//! smooth. Contacts are preserved in the same way.
//!
//! The standard deviations are in voxels along each axis, because the voxel staircase has the
//! spacing of the grid. Across thick slices, the Gaussian is therefore wider in mm.

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
    /// Standard deviations of the Gaussian along the axes, in voxels.
    pub sigma: DVec3,
    /// Minimum distance of the level from 0 and from 1. Parts whose smoothed occupancy stays below
    /// this value vanish. With 0, the level is unbounded.
    pub least_level: f64,
    /// Constraints on the surface. With `None`, voxel centres may change sides.
    pub clearance: Option<Clearance>,
}

/// Constraints on the surface: its distance from voxel centres, and contacts.
pub(crate) struct Clearance {
    /// Minimum distance from every voxel centre, in units of the minimum voxel spacing.
    pub distance: f64,
    /// The contacts to preserve.
    pub contacts: Vec<Contact>,
}

/// A point with a prescribed side, surrounded by voxels of both sides: the midpoint of a voxel edge
/// where two parts touch, or a voxel corner shared by several such edges.
pub(crate) struct Contact {
    /// The surrounding voxel with the lowest index.
    first: usize,
    /// For each axis, whether the surrounding voxels have two different positions along it. True
    /// for two or three axes.
    across: [bool; 3],
    /// Whether the point is inside.
    is_inside: bool,
}

impl Contact {
    /// Returns the four or eight voxels around the point.
    fn voxels(&self, size: [usize; 3]) -> impl Iterator<Item = usize> {
        let (stride, across, first) = (strides(size), self.across, self.first);
        let axes = move |n: usize| (0..3).filter(move |axis| n >> axis & 1 == 1);
        let along = (0..8).filter(move |&n| axes(n).all(|axis| across[axis]));
        along.map(move |n| first + axes(n).map(|axis| stride[axis]).sum::<usize>())
    }
}

/// Returns the index strides along the axes.
fn strides([nx, ny, _]: [usize; 3]) -> [usize; 3] {
    [1, nx, nx * ny]
}

/// A level set on a grid of voxels. Arrays are stored x fastest.
pub(crate) struct LevelSet {
    /// The smoothed occupancy minus the level: positive inside.
    pub above: Vec<f32>,
    /// The level, 0 to 1; empty if it is unbounded.
    pub level: Vec<f32>,
}

/// Ratio of the standard deviation of the window to the standard deviation of the smoothing. Wider
/// windows leave flat faces less flat near their edges; narrower windows follow the voxel staircase
/// (tests `flat_faces_and_caps_stay_flat`, `a_binary_ball_becomes_round`). With 1.5, 1.6 and 1.75,
/// the root-mean-square error of the radius of a ball of radius 20 voxels is 0.059, 0.057 and 0.056
/// voxel, and the faces of a cube of 20^3 voxels deviate from planes by up to 0.031, 0.031 and
/// 0.039 voxel.
const WINDOW: f64 = 1.6;

/// Number of rounds of source and volume corrections. Six rounds preserve the volumes of plates,
/// rods and shells within the limits of the test `thin_layers_and_rods_keep_their_volume`.
/// [`Sources::hold`] then corrects the centres that are still too close to the surface.
const ROUNDS: usize = 6;

/// Maximum change of the level per round. With the smoothing of labels (a standard deviation of 1.5
/// voxels), the slope of the smoothed occupancy at a plane is 0.266 per voxel, so a plane moves by
/// at most 0.38 voxel per round. All [`ROUNDS`] together can change the level by 0.6, which exceeds
/// the distance from 1/2 to either bound.
const LONGEST_STEP: f64 = 0.1;

/// Constant added to the surface density to keep the step finite where there is no surface. On a
/// plane, the surface density within the window is `8 / WINDOW` = 5 for a block of eight voxels, so
/// this value changes the step there by 0.04 %.
const LEAST_DENSITY: f64 = 0.002;

/// Minimum slope used to compute distances, relative to the slope at a plane. The actual slope
/// vanishes in the middle of a thin part and at a contact. At the surface of a layer one voxel
/// thick, the relative slope is 1 - exp(-1 / (2 * 1.5^2)) = 0.20, so the limit does not apply
/// there.
const LEAST_SLOPE: f64 = 0.15;

/// Value of the level set at a voxel, with its slopes and second differences along the axes. Values
/// are mirrored half a voxel beyond the outermost voxel centres of the grid.
#[derive(Clone, Copy)]
struct Shape {
    own: f32,
    slope: [f32; 3],
    bend: [f32; 3],
}

/// A row of values and the neighbouring rows.
struct Around<'a> {
    own: &'a [f32],
    y: [&'a [f32]; 2],
    z: [&'a [f32]; 2],
    /// The rows that are offset along both y and z.
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

    /// Computes the mixed second differences xy, yz and zx.
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
    /// Returns the fraction of the voxel in which the value is positive, and the derivative of this
    /// fraction with respect to the value.
    ///
    /// The voxel is divided into eight parts. In each part, the value is approximated by a linear
    /// function that changes by `width` across the part. `mixed` supplies the mixed second
    /// differences; without them, the volume of a rod of 2 by 2 voxels is off by 3 %.
    #[inline(always)]
    fn part_above(&self, mixed: impl FnOnce() -> [f32; 3]) -> (f32, f32) {
        let reach: f32 = (0..3).map(|a| 0.5 * (self.slope[a].abs() + self.bend[a].abs())).sum();
        if self.own.abs() > reach {
            return (if self.own > 0.0 { 1.0 } else { 0.0 }, 0.0);
        }
        let [xy, yz, zx] = mixed();
        let across = [[0.0, xy, zx], [xy, 0.0, yz], [zx, yz, 0.0]];
        let (mut part, mut density) = (0.0, 0.0);
        // corrects for the difference between the mean over a part, half a voxel wide, and the
        // value at its centre
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

/// Computes the level set of an occupancy.
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
    /// Volume, in voxels, that each block keeps in excess of its occupancy: the volume received
    /// from other blocks minus the volume transferred to them.
    transferred: Vec<f32>,
}

impl<'a> Work<'a> {
    fn new(occupancy: &'a Occupancy, smoothing: &'a Smoothing) -> Self {
        let size = occupancy.geometry.size;
        let mut above: Vec<f32> = (0..occupancy.shares.len()).into_par_iter().map(|n| share(occupancy, n)).collect();
        smooth(&mut above, size, smoothing.sigma.to_array());
        let count = if smoothing.least_level > 0.0 { above.len() } else { 0 };
        let (level, transferred) = (vec![0.0; count], vec![0.0; blocks_along(size).iter().product()]);
        let mut work = Self { occupancy, smoothing, size, above, level, transferred };
        let first = work.first_level();
        work.raise_level(&first);
        work
    }

    /// Returns the mean of the smoothed occupancy on the faces between inside and outside voxels
    /// within the window of each block, or 0.5 if the window contains no such faces.
    fn first_level(&self) -> Blocks<f32> {
        let Self { occupancy, above, size, .. } = self;
        let [nx, ny, nz] = *size;
        let sums = Blocks::of(*size, |row| {
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
        let mut means = sums.map(|[sum, _]| sum).smoothed(self.window());
        let counts = sums.map(|[_, count]| count).smoothed(self.window());
        means.values.par_iter_mut().zip(&counts.values).for_each(|(mean, &count)| {
            *mean = if count > 1e-6 { *mean / count } else { 0.5 };
        });
        means
    }

    /// Returns the standard deviations of the window, in voxels.
    fn window(&self) -> DVec3 {
        WINDOW * self.smoothing.sigma
    }

    /// Transfers the excess volume of each block to the surface within the window, in proportion to
    /// the weight of the window and the surface density, and corrects the level accordingly.
    ///
    /// `transferred` records the transfers, so later rounds correct only the difference between the
    /// volume and its linear prediction. If they corrected the same excess again, the level would
    /// oscillate along flat faces near edges.
    fn keep_volume(&mut self) {
        let (occupancy, above, size) = (self.occupancy, &self.above, self.size);
        let sums = Blocks::of(size, |row| {
            let around = Around::row(above, size, row);
            move |i| {
                let (part, density) = around.shape(i).part_above(|| around.mixed(i));
                [part - share(occupancy, row * size[0] + i), density]
            }
        });
        let (least, longest) = (LEAST_DENSITY as f32, LONGEST_STEP as f32);
        // `rates` first contains the surface density within the window, then the excess divided by
        // this density
        let mut rates = sums.map(|[_, density]| density).smoothed(self.window());
        let blocks = self.transferred.par_iter_mut().zip(&mut rates.values).zip(&sums.values);
        blocks.for_each(|((transferred, rate), [excess, _])| {
            let density = *rate;
            *rate = ((excess - *transferred) / (density + least)).clamp(-longest, longest);
            *transferred += *rate * density;
        });
        let steps = rates.smoothed(self.window());
        let blocks = self.transferred.par_iter_mut().zip(&steps.values).zip(&sums.values);
        blocks.for_each(|((transferred, step), [_, density])| *transferred -= step * density);
        self.raise_level(&steps);
    }

    /// Returns the slope, per voxel, of the smoothed occupancy at a plane.
    fn plane_slope(&self) -> f64 {
        1.0 / (TAU.sqrt() * self.smoothing.sigma.max_element())
    }

    /// Adds interpolated block values to the level and clamps the level to its bounds, if any.
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

/// Values on blocks of 2 x 2 x 2 voxels. Windows are several voxels wide, so this resolution
/// suffices.
struct Blocks<T> {
    /// Number of voxels along each axis.
    voxels: [usize; 3],
    values: Vec<T>,
}

/// Returns the number of blocks along each axis.
fn blocks_along(voxels: [usize; 3]) -> [usize; 3] {
    voxels.map(|n| n.div_ceil(2))
}

impl Blocks<[f32; 2]> {
    /// Sums two values per voxel over each block. `values(row)` returns a function that maps the x
    /// index to the two values.
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

    fn map(&self, value: impl Fn([f32; 2]) -> f32 + Sync) -> Blocks<f32> {
        Blocks { voxels: self.voxels, values: self.values.par_iter().map(|&own| value(own)).collect() }
    }
}

impl Blocks<f32> {
    /// Smooths the values by a Gaussian with standard deviations `sigma`, in voxels. Summing over
    /// blocks already contributes a variance of 0.25.
    fn smoothed(mut self, sigma: DVec3) -> Self {
        let sigma = sigma.to_array().map(|sigma| 0.5 * (sigma * sigma - 0.25).max(0.25).sqrt());
        smooth(&mut self.values, blocks_along(self.voxels), sigma);
        self
    }

    /// Returns the value at a voxel, interpolated trilinearly between block centres.
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
/// close to it.
struct Sources<'a> {
    /// Voxels that have at least one of their 26 neighbours on the other side.
    near: Runs,
    /// Strength of the source at each voxel of `near`, non-negative. A source moves values towards
    /// the side of its voxel.
    added: Vec<f32>,
    /// Minimum distance of a voxel centre from the surface, mm.
    least: f32,
    contacts: &'a [Contact],
    /// For each voxel of `near` on the prescribed side of a contact, the rise that brings the value
    /// at the contact to its minimum. It is negative if the value exceeds the minimum, and minus
    /// infinity for all other voxels.
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

    /// Returns the minimum slope (per mm) used to compute distances. The actual slope can be
    /// smaller in the middle of thin parts and at contacts.
    fn least_slope(work: &Work) -> f64 {
        LEAST_SLOPE * work.plane_slope() / work.occupancy.geometry.spacing.max_element()
    }

    /// Computes how much the voxels on the prescribed side of a contact must rise so that the value
    /// at the contact reaches its minimum. Stores, for each voxel, the maximum over its contacts.
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

    /// Calls `each(number, voxel, lack)` for each voxel of `near` in slice `k`; `number` is its
    /// index among these voxels. `lack` is the value required by the minimum distance minus the
    /// actual value, or the rise that a contact requires if this is larger. If it is positive, the
    /// value is too small.
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

    /// Adds sources at voxel centres that are too close to the surface, and weakens sources at
    /// centres that are farther away than required.
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
                    // rise of this voxel due to unit sources at all voxels in `lacking`
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

    /// Returns the voxels whose centres are too close to the surface.
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

    /// Corrects the values of voxels whose centres or contacts still violate the minimum distance.
    /// Also corrects voxels on the wrong side that no source reaches.
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

/// Rise of the value at a contact on an edge if the values of the two voxels on its side rise by
/// one: 0.5 from the mean, 0.4 from the second differences of these two voxels and -0.2 from the
/// second differences of the other two voxels.
const GAIN_AT_CONTACT: f32 = 0.7;

/// Maximum number of passes of [`Sources::hold`]. Several passes are needed because neighbours
/// change each other's slopes and second differences. The objects of `tests/labels.rs` need at most
/// five. Checkerboards and random labels (`tests/materials.rs`) use all six; the values are then at
/// most 0.0017 too small, and |F| is raised there (`field::hold_nodes`).
const HOLDS: usize = 6;

/// Absolute value assigned to a voxel that is on the wrong side of the surface and beyond the reach
/// of the sources. For example, the smoothed occupancy can exceed the level between specks a few
/// voxels apart. At the slope of a plane (0.266 per voxel), this value corresponds to a distance of
/// 0.38 voxel from the surface, which exceeds the maximum clearance (0.3).
const CLEAR_VALUE: f32 = 0.1;

/// Kernel of a unit source along one axis, by distance in voxels: a Gaussian with a standard
/// deviation of 0.75. The kernel in space is the product over the three axes.
const SPREAD: [f32; 3] = [0.532, 0.219, 0.015];

/// Rise of a voxel due to a unit source at the voxel itself.
const OWN_WEIGHT: f32 = SPREAD[0] * SPREAD[0] * SPREAD[0];

/// Returns a voxel and its 26 neighbours on the grid, each with its rise due to a unit source at
/// `voxel`.
fn near_pairs(voxel: usize, [nx, ny, nz]: [usize; 3]) -> impl Iterator<Item = (usize, f32)> {
    let at = [voxel % nx, voxel / nx % ny, voxel / (nx * ny)];
    (0..27).filter_map(move |n| {
        let step = [n % 3, n / 3 % 3, n / 9];
        let weight = step.iter().map(|&s| SPREAD[usize::from(s != 1)]).product();
        let [i, j, k] = std::array::from_fn(|a| (at[a] + step[a]).wrapping_sub(1));
        (i < nx && j < ny && k < nz).then(|| ((k * ny + j) * nx + i, weight))
    })
}

/// Returns the positions along an axis that a source raises, with their weights. Positions beyond
/// the ends of the axis are mirrored.
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

/// Finds the contacts of a mask. Inside parts are connected at a contact unless `gives_way` is true
/// for the two outside voxels there. A voxel corner shared by several contacts also becomes a
/// contact if they all have the same prescribed side. Without these corners, only a row of separate
/// bridges would connect the parts.
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
