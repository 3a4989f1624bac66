//! Measures the changes due to `--scale`: the voxel centres that change sides and their depths, the
//! parts that vanish, split, merge or lose thin ends, and the gaps that are filled. The input is
//! the occupancy before smoothing and the level set after smoothing, on one grid. The output is
//! [`Changes`], with the position of each event. Parts are sets of voxels connected through faces.

use crate::bits::Bits;
use crate::keep::{Keep, parts_of_runs};
use crate::occupancy::Occupancy;
use crate::runs::Runs;
use glam::DVec3;
use isoparticles_stage::error::Result;
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of events of each kind listed in the report. All events are counted.
const MOST_LISTED: usize = 20;

/// Minimum absolute value of the (negative) level at the voxels of removed parts. Near a plane
/// surface, the level changes by 1 / sqrt(2 pi) = 0.4 per standard deviation of the Gaussian, so
/// this value corresponds to a distance of 0.13 standard deviations. The values 0.0125, 0.05 and
/// 0.2 give the same parts and volumes for label 13 of `frog_tissue_labels` and label 2 of
/// `brain_parcellation` at SCALE=3, and for label 1 of `thorax_labels` at SCALE=6 (`make
/// distfield`).
const CLEARLY_OUTSIDE: f32 = 0.05;

/// Fraction of the original volume below which losses are treated as specks. It is a twentieth of
/// the volume change above which a warning is printed (`SCALED_VOLUME_LIMITS`).
pub const SPECK_SHARE: f64 = 1e-3;

/// The kind of change to a part of the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A part has been split into several pieces.
    Broken,
    /// A part has vanished.
    Gone,
    /// Several parts have merged.
    Joined,
    /// A piece that extended farther than the scale from the rest of its part has vanished.
    Shortened,
    /// A gap deeper than the scale has been filled.
    Filled,
}

/// A change to a part, with its position.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// The kind.
    pub kind: Kind,
    /// Volume in mm^3 by voxel count: of the lost or filled voxels, of the part that was split, or
    /// of the merged part. For shortened ends and filled gaps, only voxels deeper than half the
    /// scale are included.
    pub volume: f64,
    /// Mean position of the centres of these voxels in world coordinates, mm.
    pub place: [f64; 3],
    /// Number of pieces of a broken part, or of parts that merged; otherwise 1.
    pub pieces: usize,
}

/// Distances of changed voxel centres from the original voxel surface (voxel faces), in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Depth {
    /// Mean.
    pub mean: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

/// The difference between the object before and after smoothing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Changes {
    /// Volume of the whole object before smoothing, mm^3.
    pub volume_before: f64,
    /// Number of voxel centres that changed sides.
    pub voxels_changed: usize,
    /// Distances of these voxel centres from the original surface.
    pub depth: Depth,
    /// Number of parts before and after smoothing; voxels are connected through faces.
    pub components: [usize; 2],
    /// Euler characteristic of the solid (components - handles + cavities) before and after
    /// smoothing; voxels are connected through faces.
    pub euler: [i64; 2],
    /// Number of events of each kind.
    pub counts: BTreeMap<Kind, usize>,
    /// Total volume of the events of each kind, mm^3.
    pub volumes: BTreeMap<Kind, f64>,
    /// The events with the largest volumes, at most 20 of each kind.
    pub events: Vec<Event>,
}

/// Removes the parts of `level > 0` whose volume (voxel count, mm^3) is below `smallest`. If all
/// parts are smaller, no part is removed.
///
/// # Errors
/// If there are too many runs of voxels to label the parts.
pub fn remove_crumbs(level: &mut [f32], geometry: &Geometry, smallest: f64) -> Result<()> {
    remove_parts(level, geometry, |_| true, |volume, _| volume < smallest)
}

/// Removes the parts of `level > 0` for which `is_crumb` is true, unless it is true for all parts.
/// The arguments of `is_crumb` are the volume of the part (voxel count, mm^3) and the fraction of
/// the part's nodes for which `is_own` is true.
///
/// # Errors
/// If there are too many runs of voxels to label the parts.
pub fn remove_parts(
    level: &mut [f32],
    geometry: &Geometry,
    is_own: impl Fn(usize) -> bool,
    is_crumb: impl Fn(f64, f64) -> bool,
) -> Result<()> {
    let inside = Runs::of(geometry.size, |n| level[n] > 0.0);
    let part = parts_of_runs(&inside, geometry.size, &[])?;
    let voxel = geometry.spacing.element_product();
    // for each part, the number of nodes and the number of nodes for which `is_own` is true
    let mut counts = vec![[0usize; 2]; part.len()];
    inside.each_in_nodes(|run, nodes| {
        let [all, own] = &mut counts[part[run] as usize];
        *all += nodes.len();
        *own += nodes.filter(|&n| is_own(n)).count();
    });
    let is_crumb = |[all, own]: [usize; 2]| is_crumb(all as f64 * voxel, own as f64 / all as f64);
    if counts.iter().filter(|[all, _]| *all > 0).all(|&counts| is_crumb(counts)) {
        return Ok(());
    }
    inside.each_in_nodes(|run, nodes| {
        if is_crumb(counts[part[run] as usize]) {
            level[nodes].iter_mut().for_each(|value| *value = -CLEARLY_OUTSIDE - *value);
        }
    });
    Ok(())
}

impl Changes {
    /// Compares the occupancy before smoothing with `level > 0`. Returns `None` if no level is
    /// positive. `volume` is the volume of the whole object before smoothing (mm^3), and `scale` is
    /// the scale (mm). Vanished parts that `keep` drops anyway are not counted.
    ///
    /// # Errors
    /// If there are too many runs of voxels to label the parts.
    pub fn between(before: &Occupancy, level: &[f32], volume: f64, scale: f64, keep: Keep) -> Result<Option<Self>> {
        let geometry = &before.geometry;
        let count = level.len();
        let old = Bits::of(count, |n| before.is_inside(n));
        let new = Bits::of(count, |n| level[n] > 0.0);
        if new.count() == 0 {
            return Ok(None);
        }
        let changed: Vec<usize> = (0..count).into_par_iter().filter(|&n| old.holds(n) != new.holds(n)).collect();
        let mut depths: Vec<f64> = changed.par_iter().map(|&n| depth(&old, geometry, n)).collect();
        depths.par_sort_by(f64::total_cmp);
        let (mut events, components, largest) = compare_parts(&old, &new, geometry)?;
        events.retain(|event| event.kind != Kind::Gone || keep.keeps(event.volume, largest));
        events.extend(reaching_out(&old, &new, geometry, scale, Kind::Shortened)?);
        events.extend(reaching_out(&new, &old, geometry, scale, Kind::Filled)?);
        events.sort_by(|a, b| a.kind.cmp(&b.kind).then(b.volume.total_cmp(&a.volume)));
        let (mut counts, mut volumes) = (BTreeMap::new(), BTreeMap::new());
        events.retain(|event| {
            *volumes.entry(event.kind).or_insert(0.0) += event.volume;
            let number = counts.entry(event.kind).or_insert(0);
            *number += 1;
            *number <= MOST_LISTED
        });
        Ok(Some(Self {
            volume_before: volume,
            voxels_changed: changed.len(),
            depth: Depth {
                mean: depths.iter().sum::<f64>() / depths.len().max(1) as f64,
                p99: depths.get(depths.len().saturating_sub(1) * 99 / 100).copied().unwrap_or(0.0),
                max: depths.last().copied().unwrap_or(0.0),
            },
            components,
            euler: [euler(&old, geometry.size), euler(&new, geometry.size)],
            counts,
            volumes,
            events,
        }))
    }

    /// Returns the number of events of a kind.
    pub fn count(&self, kind: Kind) -> usize {
        self.counts.get(&kind).copied().unwrap_or(0)
    }

    /// Returns the total volume of vanished parts and lost thin ends, mm^3.
    pub fn lost(&self) -> f64 {
        [Kind::Gone, Kind::Shortened].iter().filter_map(|kind| self.volumes.get(kind)).sum()
    }
}

/// Returns the x, y and z indices of a voxel.
fn index(size: [usize; 3], n: usize) -> [usize; 3] {
    [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])]
}

/// Returns the distance (mm) from the centre of voxel `n` to the box of the nearest voxel on the
/// other side. Searches cubic shells of increasing radius.
fn depth(old: &Bits, geometry: &Geometry, n: usize) -> f64 {
    let (size, spacing) = (geometry.size, geometry.spacing);
    let (at, side) = (index(size, n), old.holds(n));
    let mut best = f64::INFINITY;
    let mut reach = 1;
    while (reach as f64 - 0.5) * spacing.min_element() < best && reach < size.into_iter().max().unwrap_or(0) {
        let span = |axis: usize| at[axis].saturating_sub(reach)..=(at[axis] + reach).min(size[axis] - 1);
        for k in span(2) {
            for j in span(1) {
                let is_shell = k.abs_diff(at[2]) == reach || j.abs_diff(at[1]) == reach;
                let step = if is_shell { 1 } else { 2 * reach };
                // in rows through the interior, only the two end voxels belong to the shell
                let first = if is_shell { *span(0).start() as isize } else { at[0] as isize - reach as isize };
                for i in (first..=*span(0).end() as isize).step_by(step).filter(|&i| i >= 0) {
                    let near = [i as usize, j, k];
                    if old.holds((k * size[1] + j) * size[0] + near[0]) != side {
                        let gap = |axis: usize| (near[axis].abs_diff(at[axis]) as f64 - 0.5).max(0.0) * spacing[axis];
                        best = best.min(DVec3::new(gap(0), gap(1), gap(2)).length());
                    }
                }
            }
        }
        reach += 1;
    }
    best
}

/// The voxel count of a part and the sum of its voxel positions (index space).
#[derive(Clone, Copy, Default)]
struct Sum {
    voxels: usize,
    positions: DVec3,
}

impl Sum {
    fn add(&mut self, row: [usize; 2], columns: std::ops::Range<usize>) {
        let (count, ends) = (columns.len(), columns.start + columns.end);
        let middle = 0.5 * (ends as f64 - 1.0);
        self.voxels += count;
        self.positions += count as f64 * DVec3::new(middle, row[0] as f64, row[1] as f64);
    }

    fn event(&self, kind: Kind, pieces: usize, geometry: &Geometry) -> Event {
        let centre = geometry.index_to_grid(self.positions / self.voxels.max(1) as f64);
        Event {
            kind,
            volume: self.voxels as f64 * geometry.spacing.element_product(),
            place: geometry.grid_to_world(centre).to_array(),
            pieces,
        }
    }
}

/// The connected parts of a set, with a [`Sum`] for each. Each part is identified by the index of
/// its first run.
struct Parts {
    runs: Runs,
    part: Vec<u32>,
    sums: BTreeMap<u32, Sum>,
}

impl Parts {
    fn of(bits: &Bits, size: [usize; 3]) -> Result<Self> {
        let runs = Runs::of(size, |n| bits.holds(n));
        let part = parts_of_runs(&runs, size, &[])?;
        let mut sums: BTreeMap<u32, Sum> = BTreeMap::new();
        runs.each_in_nodes(|run, nodes| {
            let row = nodes.start / size[0];
            sums.entry(part[run]).or_default().add([row % size[1], row / size[1]], runs.all()[run].columns());
        });
        Ok(Self { runs, part, sums })
    }
}

/// Returns events for parts that vanished, split or merged, the number of parts before and after
/// smoothing, and the volume (mm^3) of the largest part before smoothing.
fn compare_parts(old: &Bits, new: &Bits, geometry: &Geometry) -> Result<(Vec<Event>, [usize; 2], f64)> {
    let [_, ny, nz] = geometry.size;
    let (before, after) = (Parts::of(old, geometry.size)?, Parts::of(new, geometry.size)?);
    let both = Runs::of(geometry.size, |n| old.holds(n) && new.holds(n));
    let mut became: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    let mut came_from: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    for row in 0..ny * nz {
        for run in both.row(row) {
            let node = row * geometry.size[0] + run.first as usize;
            let Some((a, b)) = before.runs.find(node).zip(after.runs.find(node)) else { continue };
            let (a, b) = (before.part[a], after.part[b]);
            became.entry(a).or_default().insert(b);
            came_from.entry(b).or_default().insert(a);
        }
    }
    let mut events = Vec::new();
    for (part, sum) in &before.sums {
        match became.get(part).map_or(0, BTreeSet::len) {
            0 => events.push(sum.event(Kind::Gone, 1, geometry)),
            1 => {}
            pieces => events.push(sum.event(Kind::Broken, pieces, geometry)),
        }
    }
    for (part, from) in came_from.iter().filter(|(_, from)| from.len() > 1) {
        events.push(after.sums[part].event(Kind::Joined, from.len(), geometry));
    }
    let largest = before.sums.values().map(|sum| sum.voxels).max().unwrap_or(0) as f64;
    let largest = largest * geometry.spacing.element_product();
    Ok((events, [before.sums.len(), after.sums.len()], largest))
}

/// Returns an event for each region of `from` outside `kept` that extends farther than `scale` (mm)
/// from `kept`. The distance is the number of steps between face neighbours within the region,
/// times the mean spacing. The volume of an event includes only voxels farther away than half the
/// scale. Regions without a face neighbour in `kept` are excluded.
fn reaching_out(from: &Bits, kept: &Bits, geometry: &Geometry, scale: f64, kind: Kind) -> Result<Vec<Event>> {
    let size = geometry.size;
    let gone = Runs::of(size, |n| from.holds(n) && !kept.holds(n));
    let part = parts_of_runs(&gone, size, &[])?;
    let neighbours = |n: usize| {
        let at = index(size, n);
        let stride = [1, size[0], size[0] * size[1]];
        (0..3).flat_map(move |axis| {
            let low = (at[axis] > 0).then(|| n - stride[axis]);
            let high = (at[axis] + 1 < size[axis]).then(|| n + stride[axis]);
            [low, high].into_iter().flatten()
        })
    };
    let mut steps = vec![u32::MAX; gone.count];
    let mut front = Vec::new();
    gone.each_in_nodes(|_, nodes| {
        for n in nodes.filter(|&n| neighbours(n).any(|near| kept.holds(near))) {
            if let Some(number) = gone.number(n) {
                steps[number] = 1;
                front.push(n);
            }
        }
    });
    let most = scale / geometry.mean_spacing();
    let mut far: BTreeMap<u32, (Sum, bool)> = BTreeMap::new();
    let mut step = 1;
    while !front.is_empty() {
        let mut next = Vec::new();
        for n in std::mem::take(&mut front) {
            for near in neighbours(n) {
                let Some(number) = gone.number(near).filter(|&number| steps[number] == u32::MAX) else { continue };
                steps[number] = step + 1;
                next.push(near);
            }
        }
        step += 1;
        front = next;
    }
    gone.each_in_nodes(|run, nodes| {
        let row = nodes.start / size[0];
        for n in nodes {
            let steps = gone.number(n).map_or(u32::MAX, |number| steps[number]);
            if steps < u32::MAX && 2.0 * f64::from(steps) > most {
                let (sum, reaches) = far.entry(part[run]).or_default();
                sum.add([row % size[1], row / size[1]], n % size[0]..n % size[0] + 1);
                *reaches |= f64::from(steps) > most;
            }
        }
    });
    Ok(far.values().filter(|(_, reaches)| *reaches).map(|(sum, _)| sum.event(kind, 1, geometry)).collect())
}

/// Computes the Euler characteristic of the cubical complex of the inside voxel centres: vertices -
/// edges + squares - cubes.
fn euler(inside: &Bits, size: [usize; 3]) -> i64 {
    let [nx, ny, nz] = size;
    let slices = (0..nz).into_par_iter().map(|k| {
        let mut sum = 0i64;
        for n in k * nx * ny..(k + 1) * nx * ny {
            if !inside.holds(n) {
                continue;
            }
            let at = index(size, n);
            let holds = |x: usize, y: usize, z: usize| {
                at[0] + x < nx && at[1] + y < ny && at[2] + z < nz && inside.holds(n + (z * ny + y) * nx + x)
            };
            let (x, y, z) = (holds(1, 0, 0), holds(0, 1, 0), holds(0, 0, 1));
            let (xy, xz, yz) = (x && y && holds(1, 1, 0), x && z && holds(1, 0, 1), y && z && holds(0, 1, 1));
            let cube = xy && xz && yz && holds(1, 1, 1);
            let count = |cells: [bool; 3]| cells.into_iter().filter(|&cell| cell).count() as i64;
            sum += 1 - count([x, y, z]) + count([xy, xz, yz]) - i64::from(cube);
        }
        sum
    });
    slices.sum()
}
