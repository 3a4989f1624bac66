//! Parses the region of a volume to keep, and finds it in the volume. It is a box in world
//! coordinates, a box of voxels, or the bounding box of a mask.
//!
//! The kept voxels form a box of the grid. It is the smallest one that contains every voxel whose
//! centre lies in the region. If the grid is parallel to the world axes, these are all its voxels.

use crate::error::{Error, Result, bad};
use crate::geometry::{Geometry, INDEX_TOLERANCE};
use crate::read::read_volume;
use crate::voxel_box::VoxelBox;
use glam::DVec3;
use rayon::prelude::*;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Prefix of a box in world coordinates.
const WORLD: &str = "mm:";

/// Prefix of a box of voxels.
const VOXELS: &str = "voxels:";

/// The lower and upper end of a box along x, y and z. Open ends are infinite.
type Ends = [[f64; 3]; 2];

/// A region of a volume.
#[derive(Clone, Debug, PartialEq)]
pub enum Crop {
    /// A box in world coordinates, mm.
    World(Ends),
    /// The indices of the first and the last voxel along each axis, from 0.
    Voxels(Ends),
    /// The bounding box of the voxels of this volume that are not 0 or NaN. It contains these
    /// voxels as a whole, not only their centres.
    Mask(PathBuf),
}

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if let Some(ends) = text.strip_prefix(WORLD) {
            let number = |end: &str| end.parse().ok().filter(|x: &f64| x.is_finite());
            return box_of(ends, number, "a number of mm").map(Self::World);
        }
        if let Some(ends) = text.strip_prefix(VOXELS) {
            let number = |end: &str| end.parse::<u32>().ok().map(f64::from);
            return box_of(ends, number, "the number of a voxel, from 0").map(Self::Voxels);
        }
        if text.split(',').count() == 3 && text.split(',').all(|range| range.contains("..")) {
            return Err(format!("needs a unit: {WORLD}{text} in mm, or {VOXELS}{text}"));
        }
        if text.is_empty() {
            return Err("names no region; write mm:x0..x1,y0..y1,z0..z1, voxels:i0..i1,j0..j1,k0..k1, or a mask".into());
        }
        Ok(Self::Mask(text.into()))
    }
}

/// Parses `x0..x1,y0..y1,z0..z1`, where ends may be missing.
fn box_of(text: &str, number: impl Fn(&str) -> Option<f64>, what: &str) -> std::result::Result<Ends, String> {
    let axes: Vec<&str> = text.split(',').collect();
    if axes.len() != 3 {
        return Err(format!("has {} ranges; write one for each of the three axes, such as 10..50,..,..20", axes.len()));
    }
    let mut ends = [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]];
    for (axis, range) in axes.into_iter().enumerate() {
        let (first, last) = range.split_once("..").ok_or(format!("'{range}' is not a range, such as 10..50"))?;
        for (end, side) in [first, last].map(str::trim).into_iter().zip(&mut ends) {
            if !end.is_empty() {
                side[axis] = number(end).ok_or(format!("'{end}' is not {what}"))?;
            }
        }
        if ends[0][axis] > ends[1][axis] {
            return Err(format!("'{range}' ends before it starts"));
        }
    }
    Ok(ends)
}

impl fmt::Display for Crop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (prefix, [low, high]) = match self {
            Self::Mask(path) => return write!(f, "{}", path.display()),
            Self::World(ends) => (WORLD, ends),
            Self::Voxels(ends) => (VOXELS, ends),
        };
        let end = |x: f64| if x.is_finite() { x.to_string() } else { String::new() };
        let ranges: Vec<String> =
            low.iter().zip(high).map(|(&low, &high)| format!("{}..{}", end(low), end(high))).collect();
        write!(f, "{prefix}{}", ranges.join(","))
    }
}

impl Crop {
    /// Returns the path of the mask, if there is one.
    pub fn mask(&self) -> Option<&Path> {
        match self {
            Self::Mask(path) => Some(path),
            _ => None,
        }
    }

    /// Returns the box of voxels to keep. `path` names the volume in messages.
    ///
    /// # Errors
    /// If the mask cannot be read, is empty or belongs to another space, if no voxel centre lies in
    /// the region, or if fewer than two voxels are left along an axis.
    pub fn locate(&self, path: &Path, geometry: &Geometry) -> Result<VoxelBox> {
        let found = match self {
            Self::World(ends) => within_world(geometry, ends.map(DVec3::from_array)),
            Self::Voxels(ends) => within_indices(geometry.size, ends.map(DVec3::from_array)),
            Self::Mask(mask) => within_indices(geometry.size, mask_bounds(mask, path, geometry)?),
        };
        let kept = found.ok_or_else(|| self.outside(path, geometry))?;
        match (0..3).find(|&axis| kept.size()[axis] < 2) {
            None => Ok(kept),
            Some(axis) => Err(bad(
                path,
                format!("the region {self} contains one voxel along the {} axis", ["first", "second", "third"][axis]),
                "a volume has at least two voxels along each axis",
                "enlarge the region",
            )),
        }
    }

    fn outside(&self, path: &Path, geometry: &Geometry) -> Error {
        let [low, high] = geometry.world_box([DVec3::ZERO, geometry.upper_corner()]);
        let ([nx, ny, nz], range) = (geometry.size, |a: usize| format!("{:.3}..{:.3}", low[a], high[a]));
        bad(
            path,
            format!("no voxel centre lies in the region {self}"),
            "nothing would be left of the volume",
            format!(
                "choose a region that overlaps the volume: {WORLD}{},{},{} or {VOXELS}0..{},0..{},0..{}",
                range(0),
                range(1),
                range(2),
                nx - 1,
                ny - 1,
                nz - 1
            ),
        )
    }
}

/// Returns the voxels between two corners in the index frame.
fn within_indices(size: [usize; 3], [low, high]: [DVec3; 2]) -> Option<VoxelBox> {
    let last = DVec3::from_array(size.map(|n| n as f64 - 1.0));
    let (low, high) = ((low - INDEX_TOLERANCE).ceil().max(DVec3::ZERO), (high + INDEX_TOLERANCE).floor().min(last));
    let whole = |corner: DVec3| corner.to_array().map(|index| index as usize);
    low.cmple(high).all().then(|| VoxelBox { low: whole(low), high: whole(high) })
}

/// Returns the bounding box of the voxels whose centres lie in a box in the world frame.
fn within_world(geometry: &Geometry, [low, high]: [DVec3; 2]) -> Option<VoxelBox> {
    let tolerance = INDEX_TOLERANCE * geometry.min_spacing();
    let (low, high) = (low - tolerance, high + tolerance);
    let step = geometry.directions.x_axis * geometry.spacing.x;
    let [nx, ny, _] = geometry.size;
    VoxelBox::of_rows(geometry.size, |row| {
        let start =
            geometry.grid_to_world(geometry.index_to_grid(DVec3::new(0.0, (row % ny) as f64, (row / ny) as f64)));
        let (mut first, mut last) = (0.0, nx as f64 - 1.0);
        for axis in 0..3 {
            let (from, to) = (low[axis] - start[axis], high[axis] - start[axis]);
            if step[axis].abs() * nx as f64 <= tolerance {
                // the row is parallel to these faces of the box
                if !(from..=to).contains(&0.0) {
                    return None;
                }
                continue;
            }
            let (one, other) = (from / step[axis], to / step[axis]);
            first = one.min(other).max(first);
            last = one.max(other).min(last);
        }
        let (first, last) = (first.ceil(), last.floor());
        (first <= last).then_some((first as usize, last as usize))
    })
}

/// Returns the bounding box of the voxels of a mask in the index frame of the volume at `path`.
fn mask_bounds(file: &Path, path: &Path, geometry: &Geometry) -> Result<[DVec3; 2]> {
    let mask = read_volume(file)?;
    let own = &mask.geometry;
    if own.space != geometry.space {
        return Err(bad(
            file,
            format!("is not in the same space as {}", path.display()),
            "one of them specifies an anatomical space and the other does not, so their positions cannot be compared",
            "write the mask in the frame of the volume, or give a box",
        ));
    }
    let (steps, start) = geometry.index_from(own);
    let steps = [steps.x_axis, steps.y_axis, steps.z_axis];
    let half = 0.5 * (steps[0].abs() + steps[1].abs() + steps[2].abs());
    let [nx, ny, nz] = own.size;
    let of_row = |row: usize| {
        let (j, k) = ((row % ny) as f64, (row / ny) as f64);
        let ends = mask.layers().filter_map(|layer| {
            layer.ends_of_values(row * nx..(row + 1) * nx, |value| value != 0.0 && !value.is_nan())
        });
        ends.flat_map(|(first, last)| [first, last])
            .map(|i| start + steps[0] * i as f64 + steps[1] * j + steps[2] * k)
            .map(|centre| [centre - half, centre + half])
            .reduce(around)
    };
    (0..ny * nz).into_par_iter().with_min_len(ny).filter_map(of_row).reduce_with(around).ok_or_else(|| {
        bad(file, "contains no voxel other than 0", "the region is the bounding box of the mask", "choose another mask")
    })
}

fn around(a: [DVec3; 2], b: [DVec3; 2]) -> [DVec3; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

#[cfg(test)]
mod tests;
