//! Applies `--scale` to several materials. The occupancy of each material is smoothed, and a level
//! set preserves its local volume, as for a single object ([`crate::scale`]). A comparison of how
//! far the materials exceed their levels then assigns every position to one material, without gaps
//! or overlaps.
//!
//! Where only two materials are near, their occupancies sum to one, and so do their levels: both
//! give the same surface as a single object. Where three materials meet, their borders no longer
//! coincide. A corner of a material is rounded, and its level there is far from 1/2. A straight
//! border where two other materials meet is unchanged, and its level is 1/2. Between two materials,
//! the border whose level is closer to 1/2 therefore has more weight. The outer border of an organ
//! that consists of several materials is then as smooth as that of a single material.
//!
//! Pairs of materials can have their own scales, given by the edge lengths of `--size`
//! ([`Scales`]). Each material then has one level set per scale, and each pair is compared at its
//! own scale.

use super::grid::{Extent, LabelGrid};
use super::scales::Scales;
use crate::bits::{Bits, Numbering};
use crate::changes::{Changes, remove_parts};
use crate::crop::on_coarse_nodes;
use crate::field::Demands;
use crate::level::{LevelSet, level_set};
use crate::occupancy::Occupancy;
use crate::scalar::{ScalarOptions, from_level};
use crate::scale::{Scale, area_at_faces, edge_length_by, room_round, smallest_part};
use crate::{Border, Inside, Keep, Redistanced};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::materials::MaterialId;
use isoparticles_mesh::measure::measure;
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::{CutFaces, Geometry, Image, VoxelBox};
use rayon::prelude::*;

/// Integer steps per unit of a stored value. Values are between -1 and 1. One step moves a border
/// by less than a thousandth of the width of the Gaussian.
const UNIT: f32 = i16::MAX as f32;

/// Value of a material where it is absent, and in its parts that are too small for the scale.
const ABSENT: i16 = i16::MIN;

/// A third material is near a voxel if its value there exceeds this limit. At a level of 1/2, its
/// smoothed occupancy is then above 0.01, and the values of the other two materials are no longer
/// the negatives of each other.
const NEAR_VALUE: i16 = -((0.49 * UNIT) as i16);

/// Maximum number of materials stored at a voxel where more than two are near. In general position,
/// at most four materials meet at a point.
const MOST_NEAR: usize = 4;

/// Deviation of the level from 1/2 that indicates a rounded border. For comparison, the level is
/// 0.3 at a right-angled edge and 0.43 on a ball with a radius of six standard deviations.
///
/// On a ball divided into three sectors, the normals deviate from those of an exact ball by 1.2
/// degrees (root mean square, away from the edges). The deviation is 2.2 degrees if both borders
/// have equal weight, and 0.7 degrees if the ball is a single object (test
/// `a_scale_keeps_the_volumes_of_all_and_smooths_their_borders`).
const ROUNDED_DEVIATION: f32 = 0.1;

/// Minimum smoothed occupancy, as a fraction of the level, at which a material can win a voxel. A
/// single object has a minimum of 1. Without a minimum, materials that are too thin for the scale
/// fill the gaps between others, as films with holes that no mesh represents.
///
/// The table gives the change in volume of label 1 of `thorax_labels`, the number of vertices and
/// the minimum radius ratio of meshes with N vertices
/// (`make surface MATERIALS=all VERTICES=N ACCEPT_FORCED=yes ACCEPT_LOSSES=yes`). As a single
/// object, label 1 loses 24 and 39 % at the scales for 20,000 and 5,000 vertices.
///
/// | minimum | `thorax_labels`, 20,000 | 5,000              | `frog_tissue_labels`, 50,000 |
/// |---------|-------------------------|--------------------|------------------------------|
/// | 1/3     | -12 %, 20,155, 0.55     | -27 %, 6,120, 0.53 | 51,502, 0.22                 |
/// | 2/3     | -17 %, 20,254, 0.61     | -38 %, 5,015, 0.61 | 49,829, 0.52                 |
/// | 1       | -21 %, 20,007, 0.61     | -40 %, 4,869, 0.76 | 49,303, 0.53                 |
const LEAST_SHARE: f32 = 2.0 / 3.0;

/// A material at a voxel.
#[derive(Clone, Copy)]
struct Share {
    material: u16,
    /// The smoothed occupancy minus the level, in units of 1 / [`UNIT`].
    above: i16,
    /// The level minus 1/2, in units of 1/255.
    off: i8,
}

impl Share {
    fn above(self) -> f32 {
        f32::from(self.above) / UNIT
    }

    /// Returns the smoothed occupancy minus the minimum at which the material can win a voxel.
    fn surplus(self) -> f32 {
        self.above() + (1.0 - LEAST_SHARE) * (0.5 + f32::from(self.off) / 255.0)
    }
}

/// Entry of [`Levels::near`] without a material.
const NO_SHARE: Share = Share { material: u16::MAX, above: ABSENT, off: 0 };

/// Returns the border function of two materials, which is positive in the first material.
fn between(a: Share, b: Share) -> f32 {
    // weight of the first material, from the squared deviations of both levels in units of
    // `ROUNDED_DEVIATION`
    let off = |share: Share| (f32::from(share.off) / 255.0 / ROUNDED_DEVIATION).powi(2);
    let weight = 1.0 / (1.0 + (off(a) - off(b)).exp());
    let (low, high) = (-b.surplus(), a.surplus());
    if low > high { 0.5 * (low + high) } else { (weight * a.above() - (1.0 - weight) * b.above()).clamp(low, high) }
}

/// The smoothed occupancy of a material minus the level that preserves its volume, in a box around
/// the material.
#[derive(Default)]
struct Level {
    first: [usize; 3],
    size: [usize; 3],
    /// Values in units of 1 / [`UNIT`].
    above: Vec<i16>,
    /// The level minus 1/2, in units of 1/255.
    off: Vec<i8>,
}

impl Level {
    /// Returns, for each row of the box, the index of its first voxel in the grid and in the box.
    fn rows(&self, grid: [usize; 3]) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (first, size) = (self.first, self.size);
        (0..size[1] * size[2]).map(move |row| {
            let (j, k) = (first[1] + row % size[1], first[2] + row / size[1]);
            ((k * grid[1] + j) * grid[0] + first[0], row * size[0])
        })
    }
}

/// The three highest values at a voxel, and the materials with the two highest. Among equal values,
/// that of the material with the lowest number comes first.
#[derive(Clone, Copy)]
struct Highest {
    materials: [u16; 2],
    above: [i16; 3],
}

/// The level sets of all materials, with each interface at its own scale.
pub struct Levels<'a> {
    scales: &'a Scales,
    set: LevelsAt<'a>,
}

/// The level sets of all materials at one scale, on the grid of the volume.
struct LevelsAt<'a> {
    grid: &'a LabelGrid,
    /// The scale, mm.
    length: f64,
    levels: Vec<Level>,
    highest: Vec<Highest>,
    /// The voxels where more than two materials are near. For each of these voxels, `near` contains
    /// up to [`MOST_NEAR`] of the materials in descending order of their values.
    several: Numbering,
    near: Vec<[Share; MOST_NEAR]>,
}

/// The indicator of one material at a scale.
pub struct Made {
    /// F and its measurements; `None` if the whole material vanishes.
    pub result: Option<Redistanced>,
    /// Index of the first voxel of the material's box.
    pub first: [usize; 3],
    /// Changes due to the scale; `None` if the whole material vanishes.
    pub changes: Option<Changes>,
}

impl<'a> LevelsAt<'a> {
    /// Smooths the occupancies of all materials, whose bounding boxes are `extents`. Materials
    /// whose extent contains no voxel have no level set.
    fn new(
        grid: &'a LabelGrid,
        extents: &[Extent],
        scale: Scale,
        room: [usize; 3],
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let mut levels = Vec::new();
        let progress = monitor.counter("shares", Some(extents.len() as u64));
        for (id, extent) in extents.iter().enumerate() {
            monitor.check()?;
            let level = if extent.count == 0 {
                Level::default()
            } else {
                // the outside can be anywhere, so its box is the whole grid
                let whole = Extent { low: [0; 3], high: grid.geometry.size.map(|n| n - 1), count: extent.count };
                let extent = if id == 0 { &whole } else { extent };
                smoothed(grid, MaterialId(id as u16), extent, scale, room)
            };
            levels.push(level);
            progress.add(1);
        }
        let new = Self::of(grid, scale.length, levels);
        if scale.keep_thin {
            Ok(new)
        } else {
            new.without_crumbs(|_, volume, _| volume < smallest_part(scale.length), monitor)
        }
    }

    /// Compares the level sets of all materials.
    fn of(grid: &'a LabelGrid, length: f64, levels: Vec<Level>) -> Self {
        let nothing = Highest { materials: [0; 2], above: [ABSENT; 3] };
        let highest = vec![nothing; grid.numbers.len()];
        let several = Numbering::new(Bits::none(grid.numbers.len()));
        let mut new = Self { grid, length, levels, highest, several, near: Vec::new() };
        new.compare();
        new
    }

    /// Removes the parts of each material for which `is_crumb` is true. Its arguments are the
    /// number of the material, the volume of the part (mm^3), and the fraction of the part's voxels
    /// that have the label of the material.
    fn without_crumbs(mut self, is_crumb: impl Fn(usize, f64, f64) -> bool, monitor: &dyn Monitor) -> Result<Self> {
        for id in 0..self.levels.len() {
            monitor.check()?;
            if !self.levels[id].above.is_empty() {
                self.remove_crumbs(id, |volume, share| is_crumb(id, volume, share))?;
            }
        }
        self.compare();
        Ok(self)
    }

    /// Finds the highest values at each voxel, and the near materials where there are more than
    /// two.
    fn compare(&mut self) {
        let Self { grid, levels, highest, several, near, .. } = self;
        let size = grid.geometry.size;
        highest.par_iter_mut().for_each(|highest| highest.above = [ABSENT; 3]);
        for (id, level) in levels.iter().enumerate() {
            for (to, from) in level.rows(size) {
                for (highest, &value) in highest[to..].iter_mut().zip(&level.above[from..][..level.size[0]]) {
                    let ([first, second, third], own) = (highest.above, id as u16);
                    if value > first {
                        *highest = Highest { materials: [own, highest.materials[0]], above: [value, first, second] };
                    } else if value > second {
                        *highest = Highest { materials: [highest.materials[0], own], above: [first, value, second] };
                    } else {
                        highest.above[2] = third.max(value);
                    }
                }
            }
        }
        *several = Numbering::new(Bits::of(highest.len(), |n| highest[n].above[2] > NEAR_VALUE));
        *near = vec![[NO_SHARE; MOST_NEAR]; several.count];
        for (id, level) in levels.iter().enumerate() {
            for (in_grid, in_box) in level.rows(size) {
                several.each(in_grid..in_grid + level.size[0], |n, number| {
                    let at = in_box + n - in_grid;
                    let share = Share { material: id as u16, above: level.above[at], off: level.off[at] };
                    let near = &mut near[number];
                    if let Some(index) = near.iter().position(|other| share.above > other.above) {
                        near[index..].rotate_right(1);
                        near[index] = share;
                    }
                });
            }
        }
    }

    /// Returns the minimum of the border functions ([`between`]) of the material of `own` and the
    /// other materials near a voxel. Where at most two materials are near, only the highest other
    /// material counts. If `scales` are given, materials whose interface has another scale are
    /// skipped; the value is 1 if none remains. It is positive where the voxel belongs to the
    /// material of `own`.
    fn above_others(&self, voxel: usize, own: Share, scales: Option<&Scales>) -> f32 {
        let has_scale = |other: u16| {
            other != own.material && scales.is_none_or(|scales| scales.of_pair(own.material, other) == self.length)
        };
        if let Some(number) = self.several.find(voxel) {
            let others = self.near[number].iter().filter(|other| other.above > ABSENT && has_scale(other.material));
            return others.map(|&other| between(own, other)).fold(1.0, f32::min);
        }
        let Highest { materials, above } = self.highest[voxel];
        let other = usize::from(materials[0] == own.material);
        if !has_scale(materials[other]) {
            return 1.0;
        }
        0.5 * (f32::from(own.above) - f32::from(above[other])) / UNIT
    }

    /// Computes the values of [`Self::above_others`] at all voxels of a material's box.
    fn above(&self, id: usize, scales: Option<&Scales>) -> Vec<f32> {
        let level = &self.levels[id];
        let rows: Vec<(usize, usize)> = level.rows(self.grid.geometry.size).collect();
        let row = |&(in_grid, in_box): &(usize, usize)| {
            (0..level.size[0]).map(move |i| {
                let at = in_box + i;
                let own = Share { material: id as u16, above: level.above[at], off: level.off[at] };
                self.above_others(in_grid + i, own, scales)
            })
        };
        rows.par_iter().flat_map_iter(row).collect()
    }

    /// Removes the parts of a material for which `is_crumb` is true, unless it is true for all
    /// parts. Its arguments are the volume of the part (mm^3) and the fraction of the part's voxels
    /// that have the label of the material. Other materials take over the voxels of removed parts.
    fn remove_crumbs(&mut self, id: usize, is_crumb: impl Fn(f64, f64) -> bool) -> Result<()> {
        let before = self.above(id, None);
        let mut after = before.clone();
        let mut is_own = vec![false; before.len()];
        for (in_grid, in_box) in self.levels[id].rows(self.grid.geometry.size) {
            let row = is_own[in_box..].iter_mut().zip(&self.grid.numbers[in_grid..]).take(self.levels[id].size[0]);
            row.for_each(|(is_own, number)| *is_own = usize::from(*number) == id);
        }
        remove_parts(&mut after, &self.geometry(id), |n| is_own[n], is_crumb)?;
        let level = &mut self.levels[id];
        level.above.par_iter_mut().zip(before.par_iter().zip(&after)).for_each(|(value, (before, after))| {
            if before != after {
                *value = ABSENT;
            }
        });
        Ok(())
    }

    /// Returns the total area of all interfaces in mm^2, with each interface counted once. With a
    /// closed border, the faces that close the materials at the border of the volume are included.
    fn area(&self) -> f64 {
        let of = |id: usize| {
            let geometry = self.geometry(id);
            if geometry.voxel_count() == 0 {
                return 0.0;
            }
            measure(&marching_cubes(&Image { geometry, data: self.above(id, None) }, 0.0)).area
        };
        let inner = 0.5 * (0..self.levels.len()).map(of).sum::<f64>();
        let is_named = |voxel: usize| self.highest[voxel].materials[0] != MaterialId::OUTSIDE.0;
        let border = match self.grid.border {
            Border::Cap => area_at_faces(&self.grid.geometry, CutFaces::default(), is_named),
            Border::Open => 0.0,
        };
        inner + border
    }

    /// Returns the grid of a material's box.
    fn geometry(&self, id: usize) -> Geometry {
        let level = &self.levels[id];
        self.grid.geometry.cropped(level.first, level.size)
    }
}

impl<'a> Levels<'a> {
    /// Smooths the occupancies of all materials, whose bounding boxes are `extents`, at the scales
    /// of their interfaces.
    ///
    /// # Errors
    /// If there are too many runs of voxels to label the parts of a material, or if the run is
    /// interrupted.
    pub fn new(grid: &'a LabelGrid, extents: &[Extent], scales: &'a Scales, monitor: &dyn Monitor) -> Result<Self> {
        let lengths = scales.lengths(extents.len());
        let longest = lengths.last().copied().unwrap_or_default();
        let room = room_round(0.5 * longest / grid.geometry.spacing);
        let ids = || 0..extents.len() as u16;
        let set = |&length: &f64| {
            let has_scale = |a: u16| extents.len() == 1 || ids().any(|b| b != a && scales.of_pair(a, b) == length);
            let needed = |(a, extent): (u16, &Extent)| {
                if has_scale(a) { *extent } else { Extent { count: 0, ..*extent } }
            };
            let extents: Vec<Extent> = ids().zip(extents).map(needed).collect();
            LevelsAt::new(grid, &extents, Scale { length, keep_thin: scales.keep_thin }, room, monitor)
        };
        let mut sets = lengths.iter().map(set).collect::<Result<Vec<_>>>()?;
        let set = if sets.len() > 1 { Self::combined(sets, scales, monitor)? } else { sets.remove(0) };
        Ok(Self { scales, set })
    }

    /// Combines the level sets of several scales. The value of a material is the minimum of its
    /// border functions with all others, each at its own scale. Where interfaces of different
    /// scales meet, the values of all materials can be negative. The position then belongs to the
    /// material with the largest value. Parts that are too small for the shortest scale of their
    /// material are removed. So are parts that are too small for the longest scale of all if most
    /// of their voxels have the labels of other materials.
    fn combined(sets: Vec<LevelsAt<'a>>, scales: &Scales, monitor: &dyn Monitor) -> Result<LevelsAt<'a>> {
        let level = |id: usize| {
            let mut with_id = sets.iter().filter(|set| !set.levels[id].above.is_empty());
            let Some(first) = with_id.next() else { return Level::default() };
            let mut above = first.above(id, Some(scales));
            for set in with_id {
                let own = set.above(id, Some(scales));
                above.par_iter_mut().zip(own).for_each(|(above, own)| *above = above.min(own));
            }
            let Level { first, size, .. } = first.levels[id];
            let above: Vec<i16> = above.into_par_iter().map(|above| (above * UNIT).round() as i16).collect();
            // equal levels give both materials of a border the same weight
            Level { first, size, off: vec![0; above.len()], above }
        };
        let levels: Vec<Level> = (0..sets[0].levels.len()).map(level).collect();
        let count = levels.len();
        let new = LevelsAt::of(sets[0].grid, sets[0].length, levels);
        let longest = sets.iter().map(|set| set.length).fold(0.0, f64::max);
        drop(sets);
        let is_crumb = |id: usize, volume: f64, share: f64| {
            let is_small = |scale: f64| volume < smallest_part(scale);
            is_small(scales.shortest_of(id as u16, count)) || share < 0.5 && is_small(longest)
        };
        if scales.keep_thin { Ok(new) } else { new.without_crumbs(is_crumb, monitor) }
    }

    /// Computes the indicator of a material that has voxels. For the outside, computes the
    /// indicator of the union of all other materials, which the caller negates.
    ///
    /// # Errors
    /// If there are too many runs of voxels to label its parts, if it fills the volume and the
    /// border is open, or if the run is interrupted.
    pub fn indicator(&self, id: MaterialId, demands: &Demands, monitor: &dyn Monitor) -> Result<Made> {
        let is_outside = id == MaterialId::OUTSIDE;
        let grid = self.set.grid;
        let scale = self.scales.of_material(id);
        let (first, geometry) = (self.set.levels[id.index()].first, self.set.geometry(id.index()));
        let mut above = self.set.above(id.index(), None);
        if is_outside {
            above.par_iter_mut().for_each(|above| *above = -*above);
        }
        if grid.border == Border::Open && above.par_iter().all(|&above| above > 0.0) {
            let all = if is_outside { "the other materials fill" } else { "it fills" };
            return Err(Error::input(
                format!("at a scale of {} mm, {all} the volume from border to border", significant(scale)),
                "no interface is left at so large a scale",
                "lower SCALE (--scale) or SIZE (--scale-for-size), or raise VERTICES (--scale-for-vertices)",
            ));
        }
        let inside = |number: u16| (number == id.0) != is_outside;
        let last: [usize; 3] = std::array::from_fn(|a| first[a] + geometry.size[a] - 1);
        let before = Occupancy::of_mask(&grid.mask(first, last, inside));
        let volume = before.volume();
        let Some(changes) = Changes::between(&before, &above, volume, scale, Keep::All)? else {
            return Ok(Made { result: None, first, changes: None });
        };
        drop(before);
        let options = ScalarOptions {
            inside: Inside::Above,
            border: grid.border,
            margin: grid.margin,
            cut: CutFaces::default(),
            keep: Keep::All,
        };
        let result = from_level(Image { geometry, data: above }, 0, 0.0, &options, demands, monitor)?;
        Ok(Made { result: Some(result), first, changes: Some(changes) })
    }
}

/// Returns the edge length (mm) at which a mesh of all smoothed materials has about `vertices`
/// vertices, computed from the area of their interfaces. Returns `None` if all materials vanish.
///
/// # Errors
/// See [`Levels::new`].
pub fn edge_length(
    grid: &LabelGrid,
    materials: usize,
    vertices: f64,
    keep_thin: bool,
    monitor: &dyn Monitor,
) -> Result<Option<f64>> {
    let area = |grid: &LabelGrid, scale: Scale| {
        let room = room_round(0.5 * scale.length / grid.geometry.spacing);
        Ok(LevelsAt::new(grid, &grid.extents(materials), scale, room, monitor)?.area())
    };
    edge_length_by(grid, area, vertices, keep_thin)
}

/// Smooths the occupancy of a material and subtracts the level that preserves its volume. `room` is
/// the number of voxels by which the box extends beyond the material along each axis.
fn smoothed(grid: &LabelGrid, id: MaterialId, extent: &Extent, scale: Scale, room: [usize; 3]) -> Level {
    let whole = grid.geometry.size;
    let smoothing = scale.smoothing(&grid.geometry);
    let VoxelBox { low: first, high: last } =
        on_coarse_nodes(VoxelBox { low: extent.low, high: extent.high }.with_room(room, whole));
    let occupancy = Occupancy::of_mask(&grid.mask(first, last, |number| number == id.0));
    let size = occupancy.geometry.size;
    let LevelSet { above, level } = level_set(&occupancy, &smoothing);
    let above = above.into_par_iter().map(|value| (value.clamp(-1.0, 1.0) * UNIT).round() as i16).collect();
    let off = level.into_par_iter().map(|level| ((level - 0.5) * 255.0).round() as i8).collect();
    Level { first, size, above, off }
}
