//! Sorts slices, computes the regular grid that they form, and reads their values. Fails if they do
//! not form a regular grid.

use super::pixels::{PixelData, Pixels};
use super::slice::{DIRECTION_TOLERANCE, Slice};
use crate::error::Result;
use crate::error::bad;
use crate::geometry::{Geometry, Space};
use crate::limit::{geometry_from_steps, voxel_count};
use crate::voxels::{ScalarType, Voxels};
use glam::DVec3;
use isoparticles_file::limit::check_memory;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// Maximum distance from a slice to its position in an evenly spaced stack, in units of the slice
/// distance. The limit detects a missing inner slice: if N slices remain, the maximum distance is
/// 1/3 for N = 3, and at least `(N - 2) / (2 N)`, which is 0.25 or more, for N >= 4.
pub(super) const LARGEST_SHIFT: f64 = 0.1;

/// Tolerance for rounded positions, in units of the slice distance. If slices are 1 mm apart,
/// rounding to 0.01 mm moves a slice by up to 0.005. Deviations from even spacing above this
/// tolerance are reported. Slices closer together than this tolerance count as duplicates.
pub(super) const ROUNDING: f64 = 0.01;

/// The slices of a volume in spatial order, and the grid that they form.
pub(super) struct Stack {
    pub(super) slices: Vec<Slice>,
    pub(super) geometry: Geometry,
    /// Maximum distance from a slice to its regular position, in units of the slice distance.
    shift: f64,
}

impl Stack {
    /// Sorts slices by their position along the slice normal. Fails unless the slices are evenly
    /// spaced and have the same size and orientation.
    pub(super) fn new(folder: &Path, mut slices: Vec<Slice>) -> Result<Self> {
        let Some(first) = slices.first().cloned() else {
            return Err(bad(folder, "contains no slice", "a volume is made from slices", "use another folder"));
        };
        check_alike(&first, &slices)?;
        let size = [first.columns, first.rows, slices.len()];
        voxel_count(folder, size)?;
        if size.contains(&1) {
            return Err(bad(
                folder,
                format!("contains a flat image of {} x {} pixels in {} slices", size[0], size[1], size[2]),
                "a volume must have at least two voxels along each axis",
                "use the folder or file of the whole series",
            ));
        }
        let normal = first.normal();
        slices.sort_by(|a, b| a.position.dot(normal).total_cmp(&b.position.dot(normal)));
        let places: Vec<f64> = slices.iter().map(|slice| slice.position.dot(normal)).collect();
        check_doubles(&slices, &places)?;
        let start = slices[0].position;
        let step = (slices[slices.len() - 1].position - start) / (slices.len() - 1) as f64;
        let shift_of = |n: usize| (slices[n].position - (start + step * n as f64)).length() / step.length();
        let farthest = (0..slices.len()).max_by(|&a, &b| shift_of(a).total_cmp(&shift_of(b))).unwrap_or(0);
        let shift = shift_of(farthest);
        if shift > LARGEST_SHIFT {
            check_gaps(&slices, &places)?;
            return Err(bad(
                &slices[farthest].path,
                format!(
                    "{}is {:.3} mm away from its regular position in the stack",
                    of_frame(&slices[farthest]),
                    shift * step.length()
                ),
                "the voxels of a volume must lie on one regular grid",
                "resample the series, for example in 3D Slicer, which can read irregular stacks",
            ));
        }
        let steps = [first.along_row, first.along_column, step];
        let geometry = geometry_from_steps(folder, size, steps, start, Space::Lps)?;
        Ok(Self { slices, geometry, shift })
    }

    /// Reads the values of all slices, in a number type that can represent them.
    pub(super) fn voxels(&self, path: &Path) -> Result<Voxels> {
        let scalar = Pixels::common_type(self.slices.iter().map(|slice| slice.pixels));
        check_memory(path, (self.geometry.voxel_count() as u64).saturating_mul(scalar.bytes() as u64))?;
        Ok(match scalar {
            ScalarType::U8 => Voxels::U8(self.values(|value| value as u8)?),
            ScalarType::I16 => Voxels::I16(self.values(|value| value as i16)?),
            ScalarType::U16 => Voxels::U16(self.values(|value| value as u16)?),
            ScalarType::I32 => Voxels::I32(self.values(|value| value as i32)?),
            ScalarType::F32 => Voxels::F32(self.values(|value| value as f32)?),
            _ => Voxels::F64(self.values(|value| value)?),
        })
    }

    /// Reads the values of all slices. `rounded` converts a value to the number type.
    fn values<T: Clone + Default + Send>(&self, rounded: impl Fn(f64) -> T + Sync) -> Result<Vec<T>> {
        let [columns, rows, _] = self.geometry.size;
        let mut values = vec![T::default(); self.geometry.voxel_count()];
        let mut files: BTreeMap<&Path, Vec<(&Slice, &mut [T])>> = BTreeMap::new();
        for (slice, values) in self.slices.iter().zip(values.chunks_mut(columns * rows)) {
            files.entry(&slice.path).or_default().push((slice, values));
        }
        let files: Vec<_> = files.into_iter().collect();
        // threads work in parallel on files, and on the frames of a multi-frame file
        let read: Vec<Result<()>> = files
            .into_par_iter()
            .map(|(path, slices)| {
                let data = PixelData::read(path, columns)?;
                let frames: Vec<Result<()>> = slices
                    .into_par_iter()
                    .map(|(slice, values)| {
                        let stored = data.frame(slice.frame, &slice.pixels)?;
                        slice.pixels.convert(&stored, values, &rounded);
                        Ok(())
                    })
                    .collect();
                frames.into_iter().collect()
            })
            .collect();
        read.into_iter().collect::<Result<()>>()?;
        Ok(values)
    }

    /// Returns remarks on uneven slice spacing and on the conversion of stored numbers to values.
    pub(super) fn remarks(&self) -> Vec<String> {
        let first = self.slices[0].pixels;
        let uneven = (self.shift > ROUNDING).then(|| {
            format!(
                "the slices are unevenly spaced: they deviate by up to {:.1} % of the slice distance from the \
                 regular grid that is used, with a distance of {:.4} mm",
                100.0 * self.shift,
                self.geometry.spacing.z
            )
        });
        let numbers = match self.slices.iter().all(|slice| slice.pixels == first) {
            true => first.remark(),
            false => Some(
                "values are computed as stored value * slope + intercept, which differ from slice to slice".to_owned(),
            ),
        };
        uneven.into_iter().chain(numbers).collect()
    }
}

/// Fails unless all slices have the same size, pixel spacing and orientation.
pub(super) fn check_alike(first: &Slice, slices: &[Slice]) -> Result<()> {
    let differs = |a: DVec3, b: DVec3| (a - b).length() > DIRECTION_TOLERANCE * a.length();
    for slice in slices {
        let what = match () {
            () if (slice.columns, slice.rows) != (first.columns, first.rows) => {
                format!("has {} x {} pixels, others have {} x {}", slice.columns, slice.rows, first.columns, first.rows)
            }
            () if differs(first.along_row, slice.along_row) || differs(first.along_column, slice.along_column) => {
                "differs from the other slices of its series in orientation or pixel spacing".to_owned()
            }
            () => continue,
        };
        return Err(bad(
            &slice.path,
            format!("{}{what}", of_frame(slice)),
            "the voxels of a volume must lie on one regular grid",
            "move localizers and single views of the series to another folder",
        ));
    }
    Ok(())
}

/// Returns the start of a message about a slice: its frame, unless it is the first in its file.
fn of_frame(slice: &Slice) -> String {
    if slice.frame == 0 { String::new() } else { format!("frame {} ", slice.frame + 1) }
}

/// Returns the file name of slice `n`, and its frame in a multi-frame file.
fn name(slices: &[Slice], n: usize) -> String {
    let name = slices[n].path.file_name().unwrap_or_default().to_string_lossy();
    let is_alone = slices.iter().all(|slice| slice.frame == 0);
    if is_alone { name.into_owned() } else { format!("frame {} of {name}", slices[n].frame + 1) }
}

/// Fails if two slices have the same position.
fn check_doubles(slices: &[Slice], places: &[f64]) -> Result<()> {
    let mean = (places[places.len() - 1] - places[0]) / (places.len() - 1) as f64;
    if let Some(n) = places.windows(2).position(|pair| pair[1] - pair[0] <= ROUNDING * mean) {
        return Err(bad(
            &slices[n + 1].path,
            format!(
                "{}is at the same position as {}, {:.3} mm along the normal",
                of_frame(&slices[n + 1]),
                name(slices, n),
                places[n]
            ),
            "the series contains several volumes (points in time, echoes), or a slice twice",
            "put the slices of one volume into a separate folder",
        ));
    }
    Ok(())
}

/// Fails if a gap between slices differs from the median gap by more than the fraction
/// [`LARGEST_SHIFT`], and reports the first such gap. Otherwise, an uneven stack has slices that
/// are shifted sideways.
fn check_gaps(slices: &[Slice], places: &[f64]) -> Result<()> {
    let gaps: Vec<f64> = places.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted[(sorted.len() - 1) / 2];
    let Some(n) = gaps.iter().position(|gap| (gap - usual).abs() > LARGEST_SHIFT * usual) else { return Ok(()) };
    let (times, folder) = (gaps[n] / usual, slices[n].path.parent().unwrap_or(Path::new("")));
    let missing = times.round() - 1.0;
    let is_multiple = missing >= 1.0 && (times - times.round()).abs() <= 2.0 * LARGEST_SHIFT;
    let between = format!(
        "between {} and {} ({:.3} and {:.3} mm along the normal)",
        name(slices, n),
        name(slices, n + 1),
        places[n],
        places[n + 1]
    );
    Err(bad(
        folder,
        match is_multiple {
            true => format!(
                "lacks {missing} of its slices {between}: the gap is {:.3} mm, the others {usual:.3} mm",
                gaps[n]
            ),
            false => format!("is unevenly spaced {between}: the gap is {:.3} mm, the others {usual:.3} mm", gaps[n]),
        },
        "the voxels of a volume must lie on one regular grid",
        "add the missing files, or resample the series on a regular grid, for example in 3D Slicer",
    ))
}
