//! Reads TIFF stacks: one file with a page per slice, or a folder of files with one page each.
//! Supports BigTIFF, strips and tiles with one number per pixel, uncompressed or compressed by LZW,
//! deflate or PackBits.
//!
//! The values are those in the file, as in ImageJ, tifffile and ITK. A palette and an inverted gray
//! scale (`WhiteIsZero`) only affect the display. Rows run along x and start at the top, and pages
//! are ordered along z. The crate `tiff` (0.11) is not used, because it inverts `WhiteIsZero`,
//! refuses palettes, and overflows on some damaged sizes.

mod decode;
mod directory;
mod page;
mod spacing;

use crate::error::{Error, Result, bad};
use crate::geometry::Geometry;
use crate::limit::voxel_count;
use crate::volume::Volume;
use crate::voxels::Voxels;
use directory::Directory;
pub(crate) use directory::byte_order;
use glam::DVec3;
use isoparticles_file::history::file_name;
use isoparticles_file::limit::check_memory;
use page::{Chunk, Compression, Page};
use spacing::{IMAGEJ, Metadata, spacing};
use std::cmp::Ordering;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Returns whether a file has the name of a TIFF file.
pub(crate) fn has_tiff_name(path: &Path) -> bool {
    let name = file_name(path);
    let extension = Path::new(&name).extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    !name.starts_with('.') && matches!(extension.as_deref(), Some("tif" | "tiff"))
}

/// A slice of the volume.
struct Slice<'a> {
    path: &'a Path,
    /// Number of the page in its file, from 1.
    number: usize,
    page: Page,
}

/// Reads a file with one page per slice. `given` is the spacing in mm for files without one.
pub(crate) fn read_tiff(path: &Path, given: Option<DVec3>) -> Result<Volume> {
    let directory = Directory::read(path)?;
    let metadata = Metadata::parse(path, &directory)?;
    let pages = all_pages(path, directory, &metadata)?;
    let slices = pages.into_iter().enumerate().map(|(n, page)| Slice { path, number: n + 1, page }).collect();
    stack(path, slices, &metadata, given)
}

/// Reads a folder of files with one page each, in the natural order of their names. `files` are the
/// TIFF files in the folder, of which there is at least one.
pub(crate) fn read_tiff_folder(folder: &Path, mut files: Vec<PathBuf>, given: Option<DVec3>) -> Result<Volume> {
    if let [file] = files.as_slice() {
        return read_tiff(file, given);
    }
    files.sort_by(|a, b| natural_order(&file_name(a), &file_name(b)));
    let mut slices: Vec<Slice<'_>> = Vec::new();
    let mut first = None;
    for path in &files {
        let mut directory = Directory::read(path)?;
        let page = directory.pages.pop().filter(|_| directory.pages.is_empty());
        let page = page.ok_or_else(|| {
            bad(
                path,
                format!("is one of {} TIFF files and does not have one page", files.len()),
                "a folder of TIFF files is read as the slices of one volume, one per file",
                "move it to another folder, or use this file alone",
            )
        })?;
        if first.is_none() {
            first = Some(Metadata::parse(path, &directory)?);
        }
        slices.push(Slice { path, number: 1, page });
    }
    stack(folder, slices, &first.unwrap_or_default(), given)
}

/// Returns the pages of a file. ImageJ writes stacks above 4 GB as one page that is followed by the
/// uncompressed pixels of the others.
fn all_pages(path: &Path, directory: Directory, metadata: &Metadata) -> Result<Vec<Page>> {
    let Directory { pages, length, description, .. } = directory;
    let ([page], images) = (pages.as_slice(), metadata.slices) else { return Ok(pages) };
    if images <= 1 || page.compression != Compression::None || !description.starts_with(IMAGEJ) {
        return Ok(pages);
    }
    let bytes: u64 = page.chunks.iter().map(|chunk| chunk.bytes).sum();
    let first = page.chunks.first().map_or(0, |chunk| chunk.offset);
    if page.is_tiled || bytes.saturating_mul(images as u64) > length.saturating_sub(first) {
        return Err(bad(
            path,
            format!("declares {images} images and contains only one"),
            "the file is truncated",
            "copy the file again, or save it again with ImageJ",
        ));
    }
    let page = Page { chunk: page.size, chunks: vec![Chunk { offset: first, bytes }], ..page.clone() };
    let behind = |n: u64| Page { chunks: vec![Chunk { offset: first + n * bytes, bytes }], ..page.clone() };
    Ok((0..images as u64).map(behind).collect())
}

/// Joins slices to a volume. `path` is the file or folder.
fn stack(path: &Path, slices: Vec<Slice<'_>>, metadata: &Metadata, given: Option<DVec3>) -> Result<Volume> {
    let Some(Slice { page: first, .. }) = slices.first() else {
        return Err(bad(path, "has no pages", "there are no voxels", "write the file again"));
    };
    let [nx, ny] = first.size;
    let size = [nx, ny, slices.len()];
    if size.contains(&1) {
        return Err(bad(
            path,
            format!("is a flat image of {nx} x {ny} pixels and {} pages", slices.len()),
            "a volume must have at least two voxels along each axis",
            "use a file with a page per slice, or the folder that contains all slices",
        ));
    }
    for slice in &slices {
        let Page { size: [width, height], scalar, bits, .. } = slice.page;
        if (slice.page.size, scalar, bits) != (first.size, first.scalar, first.bits) {
            let (one, two) = (first.scalar.name(), scalar.name());
            return Err(bad(
                slice.path,
                format!(
                    "page {} has {width} x {height} pixels ({two}), and the first slice {nx} x {ny} ({one})",
                    slice.number
                ),
                "all slices of a volume have the same size and type",
                "remove what is not a slice, for example a preview",
            ));
        }
    }
    metadata.check(path, slices.len())?;
    let (spacing, remarks) = spacing(path, metadata, given)?;
    let (count, scalar) = (voxel_count(path, size)?, first.scalar);
    check_memory(path, (count as u64).saturating_mul(scalar.bytes() as u64))?;
    let voxels = Voxels::filled(scalar, count, nx * ny, |n, pixels| {
        let Slice { path, number, page } = &slices[n];
        let read = File::open(path).and_then(|mut file| decode::decode(&mut file, page, pixels));
        read.map(|()| page.endian).map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof | ErrorKind::InvalidData | ErrorKind::InvalidInput => bad(
                path,
                format!("page {number} cannot be decoded: {error}"),
                "some voxels would be missing",
                "copy, download or write the file again",
            ),
            _ => Error::file(path, "read", error, "copy the file again"),
        })
    })?;
    Ok(Volume { remarks, ..Volume::new(Geometry::axis_aligned(size, spacing), voxels) })
}

/// Compares names so that `slice2` comes before `slice10`.
fn natural_order(a: &str, b: &str) -> Ordering {
    let is_digit = |c: char| c.is_ascii_digit();
    /// Splits a name after its leading digits, or else before its first digit.
    fn split(name: &str) -> (&str, &str) {
        let is_number = name.starts_with(|c: char| c.is_ascii_digit());
        name.split_at(name.find(|c: char| c.is_ascii_digit() != is_number).unwrap_or(name.len()))
    }
    let (mut rest_a, mut rest_b) = (a, b);
    while !rest_a.is_empty() && !rest_b.is_empty() {
        let (part_a, part_b);
        (part_a, rest_a) = split(rest_a);
        (part_b, rest_b) = split(rest_b);
        let order = if part_a.starts_with(is_digit) && part_b.starts_with(is_digit) {
            // without leading zeros, a number with more digits is greater
            let [a, b] = [part_a, part_b].map(|part| part.trim_start_matches('0'));
            a.len().cmp(&b.len()).then_with(|| a.cmp(b))
        } else {
            part_a.cmp(part_b)
        };
        if order != Ordering::Equal {
            return order;
        }
    }
    rest_a.len().cmp(&rest_b.len()).then_with(|| a.cmp(b))
}

#[cfg(test)]
mod tests;
