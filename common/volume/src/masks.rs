//! Joins masks, one per object, into a label volume with named segments.
//!
//! Each mask becomes a segment. Masks in a folder are named after their files. Masks that overlap
//! go to different layers, so every mask keeps all its voxels. Besides one byte per voxel and
//! layer, only one mask of a folder at a time is in memory.
//!
//! The grid is that of the finest mask, extended to contain all masks. A voxel is inside a mask if
//! the nearest voxel of the mask is. No average is taken, because a voxel of the grid rarely
//! contains several voxel centres of a mask: only if the mask is finer along one axis.

use crate::error::{Result, bad};
use crate::foreign::foreign_content;
use crate::geometry::{Geometry, INDEX_TOLERANCE, Space};
use crate::layers::{Label, Layers, Part};
use crate::volume::Volume;
use crate::voxels::Voxels;
use glam::{DMat3, DVec3};
use isoparticles_file::history::file_name;
use isoparticles_file::limit::check_memory;
use rayon::prelude::*;
use std::ffi::OsStr;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Endings of the names of mask files. A mask has the name of its file without the ending. The
/// first match counts, so `.seg.nrrd` comes before `.nrrd`.
pub const ENDINGS: [&str; 12] =
    [".nii.gz", ".nii", ".hdr.gz", ".hdr", ".mgz", ".mgh", ".seg.nrrd", ".nrrd", ".nhdr", ".mha", ".mhd", ".vti"];

/// Maximum number of masks: a byte holds this many labels besides 0. TotalSegmentator writes 117.
const MOST_MASKS: usize = u8::MAX as usize;

/// Smallest value of a voxel inside a mask, relative to the maximum. For probabilities, such a
/// voxel is at least as likely inside as outside.
pub(crate) const INSIDE: f64 = 0.5;

/// Returns the name of a mask, or `None` if a file with this name is not read as a mask.
pub(crate) fn mask_name(path: &Path) -> Option<String> {
    let name = file_name(path);
    let lower = name.to_ascii_lowercase();
    let ending = ENDINGS.iter().find(|ending| lower.ends_with(*ending))?;
    (!name.starts_with('.')).then(|| name[..name.len() - ending.len()].to_owned())
}

/// Returns whether a file is a volume in a format that is not supported for masks.
pub(crate) fn is_other_volume(path: &Path) -> bool {
    let is_numpy = |ending: &OsStr| ["npy", "npz"].iter().any(|other| ending.eq_ignore_ascii_case(other));
    !file_name(path).starts_with('.') && (path.extension().is_some_and(is_numpy) || foreign_content(path).is_some())
}

/// Reads `files`, the masks in a folder, of which there is at least one. `read` reads a file.
///
/// # Errors
/// If a file is not a mask, if the masks are not in one space, or if they do not fit in memory.
pub(crate) fn read_masks(folder: &Path, files: &[PathBuf], read: Reader) -> Result<Volume> {
    check_count(folder, files.len())?;
    let names: Vec<Option<String>> = files.iter().map(|file| mask_name(file)).collect();
    if let Some(Some(name)) = (1..names.len()).find(|&n| names[..n].contains(&names[n])).map(|n| &names[n]) {
        return Err(bad(
            folder,
            format!("contains two masks of '{name}'"),
            "the name of a file is the name of its object",
            "rename one of the files, or move it to another folder",
        ));
    }
    let mut masks = Masks::read(files, read, None)?;
    let grid = common_grid(&masks.grids);
    if masks.grids[0] != grid {
        // frees the layers before the masks are read again
        drop(masks);
        masks = Masks::read(files, read, Some(&grid))?;
    }
    masks.join(folder, grid)
}

/// Joins masks in memory, each with the name of its object. `named` must not be empty.
///
/// # Errors
/// If a volume is not a mask, if the masks are not in one space, or if they do not fit in memory.
pub fn join_masks(named: Vec<(String, Volume)>) -> Result<Volume> {
    let masks_path = Path::new("masks");
    check_count(masks_path, named.len())?;
    let grids: Vec<Geometry> = named.iter().map(|(_, mask)| mask.geometry.clone()).collect();
    let grid = common_grid(&grids);
    let mut masks = Masks { grids, ..Masks::default() };
    for (name, mask) in named {
        masks.add(Path::new(&name), name.clone(), mask, &grid)?;
    }
    masks.join(masks_path, grid)
}

fn check_count(folder: &Path, count: usize) -> Result<()> {
    if count <= MOST_MASKS {
        return Ok(());
    }
    Err(bad(
        folder,
        format!("contains {count} volumes"),
        format!("they are read as masks, at most {MOST_MASKS}"),
        "remove those that you do not need",
    ))
}

/// Reads a volume file.
type Reader = fn(&Path) -> Result<Volume>;

/// The masks read so far.
#[derive(Default)]
struct Masks {
    layers: Layers<u8>,
    /// The grid of each mask.
    grids: Vec<Geometry>,
    /// The world frame of each file.
    spaces: Vec<Space>,
    remarks: Vec<String>,
}

impl Masks {
    /// Reads all masks onto a grid. Without a grid, uses that of the first mask.
    fn read(files: &[PathBuf], read: Reader, grid: Option<&Geometry>) -> Result<Self> {
        let mut masks = Self::default();
        for path in files {
            let mask = read(path)?;
            masks.grids.push(mask.geometry.clone());
            let grid = grid.unwrap_or(&masks.grids[0]).clone();
            masks.add(path, mask_name(path).unwrap_or_default(), mask, &grid)?;
        }
        Ok(masks)
    }

    fn add(&mut self, path: &Path, name: String, mask: Volume, grid: &Geometry) -> Result<()> {
        if mask.geometry.space != grid.space {
            return Err(bad(
                path,
                "is not in the same space as the other masks",
                "some of them specify an anatomical space and others do not, so their positions cannot be compared",
                "write all masks with the same program, in the frame of the scan",
            ));
        }
        self.spaces.push(mask.file_space);
        for remark in &mask.remarks {
            if !self.remarks.iter().any(|known| known.ends_with(remark)) {
                self.remarks.push(format!("{}: {remark}", file_name(path)));
            }
        }
        check_memory(path, mask.voxels.len() as u64)?;
        let level = level(path, &mask)?;
        let Volume { geometry, voxels, .. } = mask;
        let placed = Placed::new(inside(voxels, geometry.size[0], level), &geometry, grid);
        let number = self.layers.part_count() as u16 + 1;
        self.layers.add(path, grid, (number, name), &placed)
    }

    /// Returns the volume of the layers, which have the given grid.
    fn join(self, folder: &Path, grid: Geometry) -> Result<Volume> {
        let Self { layers, grids, spaces, mut remarks } = self;
        if grids.first().is_some_and(|first| *first != grid) {
            let [nx, ny, nz] = grid.size;
            remarks.push(format!(
                "the masks have different grids; they are resampled to {nx} x {ny} x {nz} voxels of the finest mask"
            ));
        }
        // files in different frames have none in common
        let common = spaces.first().filter(|first| spaces.iter().all(|space| space == *first));
        let file_space = common.copied().unwrap_or(grid.space);
        let volume = layers.join(folder, grid, "masks")?;
        remarks.extend(volume.remarks);
        Ok(Volume { file_space, remarks, ..volume })
    }
}

/// Returns the value from which a voxel is inside a mask. A mask contains probabilities from 0 to
/// 1, or 0 and one positive label.
fn level(path: &Path, mask: &Volume) -> Result<f32> {
    let (low, high) = mask.voxels.range().unwrap_or_default();
    let has_one_label = || mask.voxels.label_set().is_ok_and(|labels| labels.iter().filter(|&&n| n != 0).count() == 1);
    if mask.more_layers.is_empty() && low >= 0.0 && (high <= 1.0 || has_one_label()) {
        return Ok((INSIDE * high.max(1.0)) as f32);
    }
    Err(bad(
        path,
        format!("is not a mask; it contains values from {low} to {high}"),
        "several volumes are read as masks: 0 and one other value, or probabilities from 0 to 1",
        "omit it, or move it to another folder; mesh a label map or a scan alone",
    ))
}

/// Marks the voxels with at least the value `level`. `nx` is the length of a row.
fn inside(voxels: Voxels, nx: usize, level: f32) -> Vec<bool> {
    let mut inside = vec![false; voxels.len()];
    inside.par_chunks_mut(nx).enumerate().for_each_init(
        || vec![0.0; nx],
        |values, (row, inside)| {
            voxels.copy_as_f32(row * nx, values);
            inside.iter_mut().zip(values).for_each(|(inside, value)| *inside = *value >= level);
        },
    );
    inside
}

/// Returns the grid of the finest mask, extended by whole voxels to contain all masks.
fn common_grid(grids: &[Geometry]) -> Geometry {
    let voxel = |grid: &Geometry| grid.spacing.element_product();
    // of masks with the same voxels but for rounding, the first one counts
    let finest = grids.iter().fold(&grids[0], |a, b| if voxel(b) < (1.0 - INDEX_TOLERANCE) * voxel(a) { b } else { a });
    let size = DVec3::from_array(finest.size.map(|n| n as f64));
    let (mut low, mut high) = (DVec3::ZERO, size);
    for grid in grids {
        let index = finest.index_from(grid);
        for corner in 0..8 {
            let at = [0, 1, 2].map(|a| if corner >> a & 1 == 0 { -0.5 } else { grid.size[a] as f64 - 0.5 });
            let at = index.0 * DVec3::from_array(at) + index.1;
            low = low.min((at + INDEX_TOLERANCE).ceil());
            high = high.max((at - INDEX_TOLERANCE).floor() + 1.0);
        }
    }
    if (low, high) == (DVec3::ZERO, size) {
        return finest.clone();
    }
    let size = (high - low).to_array().map(|n| n as usize);
    Geometry { size, origin: finest.grid_to_world(finest.index_to_grid(low)), ..finest.clone() }
}

/// A mask over the grid of the layers.
struct Placed {
    inside: Vec<bool>,
    /// Size of the mask.
    size: [usize; 3],
    /// Converts index positions of the layers to those of the mask.
    index: (DMat3, DVec3),
    /// Size of the layers.
    layer: [usize; 3],
    /// A box of the layers with all voxels that can be inside.
    bounds: [Range<usize>; 3],
}

impl Placed {
    fn new(inside: Vec<bool>, mask: &Geometry, grid: &Geometry) -> Self {
        let index = mask.index_from(grid);
        let bounds = bounds(&inside, mask, grid);
        Self { inside, size: mask.size, index, layer: grid.size, bounds }
    }

    /// Returns whether the voxel of the mask that is nearest to a voxel of the layers is inside.
    fn holds(&self, i: usize, j: usize, k: usize) -> bool {
        let index = self.index.0 * DVec3::new(i as f64, j as f64, k as f64) + self.index.1;
        // the tolerance keeps rounding errors from deciding halfway between two voxels
        let [i, j, k] = (index + 0.5 + INDEX_TOLERANCE).floor().to_array();
        let [nx, ny, nz] = self.size;
        let is_within = |i: f64, n: usize| i >= 0.0 && i < n as f64;
        is_within(i, nx)
            && is_within(j, ny)
            && is_within(k, nz)
            && self.inside[(k as usize * ny + j as usize) * nx + i as usize]
    }

    /// Returns the positions in slice `k` of the voxels of the mask.
    fn voxels(&self, k: usize) -> impl Iterator<Item = usize> {
        let [x, y, _] = &self.bounds;
        y.clone().flat_map(move |j| x.clone().filter(move |&i| self.holds(i, j, k)).map(move |i| j * self.layer[0] + i))
    }
}

impl Part for Placed {
    fn is_free<L: Label>(&self, layer: &[L]) -> bool {
        let plane = self.layer[0] * self.layer[1];
        let is_zero = |k: usize, voxel: usize| layer[k * plane + voxel] == L::default();
        self.bounds[2].clone().into_par_iter().all(|k| self.voxels(k).all(|voxel| is_zero(k, voxel)))
    }

    fn paint<L: Label>(&self, layer: &mut [L], label: L) -> usize {
        let Range { start, end } = self.bounds[2];
        let plane = self.layer[0] * self.layer[1];
        let slices = layer[start * plane..end * plane].par_chunks_mut(plane).enumerate();
        let painted = slices.map(|(n, slice)| self.voxels(start + n).map(|voxel| slice[voxel] = label).count());
        painted.sum()
    }
}

/// Returns a box of voxels of `grid` that contains all inside voxels of a mask.
fn bounds(inside: &[bool], mask: &Geometry, grid: &Geometry) -> [Range<usize>; 3] {
    let [nx, ny, _] = mask.size;
    let rows = inside.par_chunks(nx).enumerate().filter_map(|(row, inside)| {
        let ends = [inside.iter().position(|&inside| inside)?, inside.iter().rposition(|&inside| inside)?];
        Some(ends.map(|i| DVec3::new(i as f64, (row % ny) as f64, (row / ny) as f64)))
    });
    let none = || [DVec3::INFINITY, DVec3::NEG_INFINITY];
    let joined = |a: [DVec3; 2], b: [DVec3; 2]| [a[0].min(b[0]), a[1].max(b[1])];
    let [low, high] = rows.reduce(none, joined);
    if low.x > high.x {
        return [0..0, 0..0, 0..0];
    }
    // half a voxel around the centres, and one more against rounding
    let (matrix, origin) = grid.index_from(mask);
    let (centre, half) = (0.5 * (low + high), 0.5 * (high - low) + 0.5);
    let reach = DMat3::from_cols(matrix.x_axis.abs(), matrix.y_axis.abs(), matrix.z_axis.abs()) * half + 1.0;
    let centre = matrix * centre + origin;
    // the conversion of a negative number gives 0
    [0, 1, 2].map(|a| {
        let end = ((centre + reach)[a].ceil() as usize).saturating_add(1).min(grid.size[a]);
        ((centre - reach)[a].floor() as usize).min(end)..end
    })
}

#[cfg(test)]
mod tests;
