//! Reads DICOM files: slices and multi-frame images, segmentations, and contours. The world frame
//! is LPS.
//!
//! Each file becomes a [`Picture`](picture::Picture) with its frames ([`slice`]), its segments
//! ([`segmentation`]) or its contours ([`structures`]). [`choose`] sorts the pictures into groups,
//! one per volume, and chooses one. [`stack`] sorts its slices and computes their spacing.
//! [`pixels`] decodes the frames. Overlapping segments go to different layers
//! ([`crate::layers`]).
//!
//! The dicom-rs crates parse the files.

mod choose;
mod elements;
mod header;
mod jpeg;
mod masks;
mod picture;
mod pixels;
mod planes;
mod polygon;
mod rle;
mod segmentation;
mod slice;
mod source;
mod stack;
mod structures;

use crate::error::{Content as Kind, Error, Result, bad};
use crate::geometry::Geometry;
use crate::limit::without_spacing;
use crate::volume::Volume;
use choose::Group;
use glam::DVec3;
use picture::{Content, Found, Picture, Unread};
use slice::Slice;
use stack::Stack;
use std::io::Read;
use std::path::{Path, PathBuf};
use structures::Structures;

/// Smallest number of slices in which the spacing reveals a missing inner slice.
const FEWEST_WITH_GAP: usize = 3;

/// Returns whether a file that starts with these bytes is a DICOM file.
pub(crate) fn is_dicom(start: &[u8]) -> bool {
    source::missing(start).is_some()
}

/// Returns whether a file starts like a DICOM file. Unreadable files are skipped; if one of them is
/// an inner slice, the gap in the stack is reported later.
pub(crate) fn is_dicom_file(path: &Path) -> bool {
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(source::START as u64).read_to_end(&mut start));
    read.is_ok() && is_dicom(&start)
}

/// Reads the series that `wanted` selects from `files`, the DICOM files in a folder. If `wanted` is
/// `None`, there must be exactly one series of slices. `spacing` is for contours only.
pub(crate) fn read_series(
    folder: &Path,
    files: &[PathBuf],
    wanted: Option<&str>,
    spacing: Option<DVec3>,
) -> Result<Volume> {
    let Files { mut groups, no_images, mut unread } = Files::read(files)?;
    if groups.is_empty() && !unread.is_empty() {
        return Err(unread.swap_remove(0).error);
    }
    let Group { class, series, content, .. } = choose::choose(folder, &mut groups, wanted)?;
    let left_out: Vec<String> = choose::left_out(&groups).collect();
    let is_own = |file: &Unread| file.class.as_ref().is_none_or(|own| *own == class);
    unread.extend(no_images.into_iter().filter(is_own));
    let mut volume = match content? {
        Content::Slices(slices) => {
            without_spacing(folder, spacing)?;
            read_slices(folder, slices, &series.uid, &mut unread)?
        }
        Content::Segmentation(segmentation) => {
            without_spacing(folder, spacing)?;
            segmentation.read()?
        }
        Content::Structures(structures) => read_structures(&structures, groups, spacing)?,
    };
    volume.remarks.splice(0..0, left_out);
    volume.remarks.extend(unread.iter().map(|file| format!("a file could not be read: {}", file.error)));
    Ok(volume)
}

/// Reads a single file: a multi-frame image, a segmentation, or contours. The grid of contours is
/// that of the slices to which they refer, if these are in the same folder.
pub(crate) fn read_file(path: &Path, wanted: Option<&str>, spacing: Option<DVec3>) -> Result<Volume> {
    let Files { mut groups, no_images, unread } = Files::read(&[path.to_path_buf()])?;
    if let Some(file) = unread.into_iter().next() {
        return Err(file.error);
    }
    let is_slice = |group: &Group| matches!(&group.content, Ok(Content::Slices(slices)) if slices.len() == 1);
    if !no_images.is_empty() || groups.iter().all(is_slice) {
        return Err(Error::NotAVolume { path: path.to_path_buf(), content: Kind::DicomSlice });
    }
    match choose::choose(path, &mut groups, wanted)?.content? {
        Content::Slices(slices) => {
            without_spacing(path, spacing)?;
            volume(path, slices)
        }
        Content::Segmentation(segmentation) => {
            without_spacing(path, spacing)?;
            segmentation.read()
        }
        Content::Structures(structures) => {
            read_structures(&structures, Files::read(&files_beside(path))?.groups, spacing)
        }
    }
}

/// The contents of several files.
#[derive(Default)]
struct Files {
    groups: Vec<Group>,
    no_images: Vec<Unread>,
    unread: Vec<Unread>,
}

impl Files {
    fn read(paths: &[PathBuf]) -> Result<Self> {
        let (mut files, mut pictures) = (Self::default(), Vec::new());
        for path in paths {
            match Picture::read(path)? {
                Found::Image(picture) => pictures.push(*picture),
                Found::NoImage(file) => files.no_images.push(file),
                Found::Unread(file) => files.unread.push(file),
            }
        }
        files.groups = choose::groups(pictures);
        Ok(files)
    }
}

/// Returns the files in the same folder that determine the grid of contours. For a file without
/// contours, there are none.
///
/// # Errors
/// If the file cannot be read.
pub(crate) fn data_files(path: &Path) -> Result<Vec<PathBuf>> {
    match Picture::read(path)? {
        Found::Image(picture) if matches!(picture.content, Ok(Content::Structures(_))) => Ok(files_beside(path)),
        _ => Ok(Vec::new()),
    }
}

/// Returns the other DICOM files in the folder of a file.
fn files_beside(path: &Path) -> Vec<PathBuf> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).map(|entries| entries.flatten().map(|entry| entry.path()));
    let mut files: Vec<PathBuf> =
        entries.into_iter().flatten().filter(|other| other.is_file() && is_dicom_file(other)).collect();
    files.sort();
    files.retain(|other| other.file_name() != path.file_name());
    files
}

/// Reads slices. A file of another series does not matter if it cannot be read. If the series of
/// an unreadable file is unknown, a gap in the stack shows whether a slice is missing.
fn read_slices(folder: &Path, slices: Vec<Slice>, series: &str, unread: &mut Vec<Unread>) -> Result<Volume> {
    let is = |file: &Unread, known: bool| file.series.as_ref().map_or(!known, |other| known && other == series);
    if let Some(own) = unread.iter().position(|file| is(file, true)) {
        return Err(unread.swap_remove(own).error);
    }
    let unknown = unread.iter().position(|file| is(file, false));
    let count = slices.len();
    match (volume(folder, slices), unknown) {
        (Err(error), Some(unknown)) => {
            let file = &unread[unknown];
            Err(bad(
                &file.path,
                format!("cannot be read, and may be the missing slice: {error}"),
                file.error.reason(),
                file.error.remedy(),
            ))
        }
        (_, Some(unknown)) if count < FEWEST_WITH_GAP => Err(unread.swap_remove(unknown).error),
        (volume, _) => volume,
    }
}

/// Reads the volume that slices form.
fn volume(path: &Path, slices: Vec<Slice>) -> Result<Volume> {
    let stack = Stack::new(path, slices)?;
    let voxels = stack.voxels(path)?;
    Ok(Volume { remarks: stack.remarks(), ..Volume::new(stack.geometry, voxels) })
}

/// Reads contours on the grid of the slices to which they refer, if these are among `groups`.
fn read_structures(structures: &Structures, groups: Vec<Group>, spacing: Option<DVec3>) -> Result<Volume> {
    let mut slices: Vec<(bool, String, Vec<Slice>)> = Vec::new();
    for Group { series, content, .. } in groups {
        let rank = structures.rank(&series);
        if let (Some(is_named), Ok(Content::Slices(all))) = (rank, content)
            && all.len() > 1
        {
            slices.push((is_named, series.description, all));
        }
    }
    // the series that is named, or else the only one in the same coordinates
    let named = slices.iter().position(|(is_named, ..)| *is_named).or((slices.len() == 1).then_some(0));
    let Some((_, description, slices)) = named.map(|n| slices.swap_remove(n)) else {
        return structures.read_alone(spacing);
    };
    without_spacing(&structures.path, spacing)?;
    let grid: Geometry = Stack::new(&structures.path, slices)?.geometry;
    let mut volume = structures.read(grid)?;
    volume
        .remarks
        .insert(0, format!("the contours are drawn on the grid of the slices '{description}' beside the file"));
    Ok(volume)
}

#[cfg(test)]
mod tests;
