//! Reads one series from a folder of DICOM files. The world frame is LPS.
//!
//! The dicom-rs crates decode headers and pixels. This module chooses the series ([`choose`]),
//! sorts the slices and computes their spacing ([`stack`]), and selects the number type
//! ([`Pixels`](slice::Pixels)).

mod choose;
mod lengths;
mod rle;
mod slice;
mod source;
mod stack;

use crate::error::Result;
use crate::error::bad;
use crate::volume::Volume;
use crate::voxels::Voxels;
use isoparticles_file::limit::check_memory;
use slice::{Found, Picture};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Returns whether a file that starts with these bytes is a DICOM file.
pub(crate) fn is_dicom(start: &[u8]) -> bool {
    source::missing(start).is_some()
}

/// Reads the series that `wanted` selects from `files`, the DICOM files in a folder. If `wanted` is
/// `None`, there must be exactly one series of slices.
pub(crate) fn read_series(folder: &Path, files: &[PathBuf], wanted: Option<&str>) -> Result<Volume> {
    let (mut pictures, mut no_images) = (Vec::new(), Vec::new());
    for path in files {
        match Picture::read(path)? {
            Found::Image(picture) => pictures.push(*picture),
            Found::NoImage { path, class } => no_images.push((path, class)),
        }
    }
    let (series, own_class, mut remarks) = choose::choose(folder, pictures, wanted)?;
    if let Some((path, _)) = no_images.iter().find(|(_, class)| *class == own_class) {
        return Err(bad(
            path,
            "is of the same kind as the slices, but its header ends before the image",
            "it is truncated, and the volume would lack a slice",
            "copy or export the file again",
        ));
    }
    let stack = stack::Stack::new(folder, series)?;
    let scalar = stack.scalar_type();
    check_memory(folder, (stack.geometry.voxel_count() as u64).saturating_mul(scalar.bytes() as u64))?;
    let mut voxels = Voxels::empty(scalar);
    for slice in &stack.slices {
        voxels.extend_from_f64(slice.values()?);
    }
    remarks.extend(stack.remarks());
    Ok(Volume { remarks, ..Volume::new(stack.geometry, voxels) })
}

/// Returns whether a file starts like a DICOM file. Unreadable files are skipped; if one of them is
/// an inner slice, the gap in the stack is reported later.
pub(crate) fn is_dicom_file(path: &Path) -> bool {
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(source::START as u64).read_to_end(&mut start));
    read.is_ok() && is_dicom(&start)
}

#[cfg(test)]
mod tests;
