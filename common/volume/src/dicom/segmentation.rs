//! Reads DICOM segmentations (PS3.3, section A.51): binary, fractional, and label maps.
//!
//! A frame of a binary or fractional segmentation contains the pixels of one segment in one slice.
//! Writers omit empty frames, so slices without a frame are background. A frame of a label map
//! contains the numbers of the segments.

use super::header::Header;
use super::masks::{Mask, Masks, check_room};
use super::pixels::PixelData;
use super::planes::Planes;
use super::slice::Slice;
use super::stack::{LARGEST_SHIFT, ROUNDING, check_alike};
use crate::error::{Result, bad};
use crate::geometry::{Geometry, Space};
use crate::layers::{Label, Layers};
use crate::limit::{geometry_from_steps, voxel_count};
use crate::masks::INSIDE;
use crate::segments::{LayerLabel, Segment};
use crate::volume::Volume;
use crate::voxels::Voxels;
use dicom_dictionary_std::tags;
use dicom_object::Tag;
use isoparticles_file::limit::check_memory;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

/// The header of a segmentation.
#[derive(Debug)]
pub(super) struct Segmentation {
    path: Arc<Path>,
    /// The frames of each segment. The frames of a label map have the number 0.
    frames: BTreeMap<u16, Vec<Slice>>,
    /// The numbers and names of the segments, in the order of the file.
    names: Vec<(u16, String)>,
    kind: Kind,
    planes: Planes,
}

/// How pixels encode segments.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// One bit per pixel.
    Binary,
    /// A probability or occupancy from 0 to this value.
    Fractional(f64),
    /// The number of the segment, or this value for background.
    LabelMap(Option<f64>),
}

impl Segmentation {
    /// Reads the header of a segmentation with the given frames, of which there is at least one.
    pub(super) fn of(header: &Header<'_>, slices: Vec<Slice>) -> Result<Self> {
        let path: Arc<Path> = header.path.into();
        let first = &slices[0];
        check_alike(first, &slices)?;
        let kind = match header.text(tags::SEGMENTATION_TYPE).as_str() {
            "BINARY" => Kind::Binary,
            "FRACTIONAL" => match header.positive(tags::MAXIMUM_FRACTIONAL_VALUE) {
                Some(most) => Kind::Fractional(most),
                None => {
                    return Err(
                        header.meaningless("MaximumFractionalValue", &header.text(tags::MAXIMUM_FRACTIONAL_VALUE))
                    );
                }
            },
            "LABELMAP" => Kind::LabelMap(header.positive(tags::PIXEL_PADDING_VALUE)),
            other => return Err(header.meaningless("SegmentationType", other)),
        };
        if (first.pixels.bytes == 0) != (kind == Kind::Binary) || first.pixels.bytes > 2 {
            return Err(header.meaningless("BitsAllocated", &header.text(tags::BITS_ALLOCATED)));
        }
        let normal = first.normal();
        let places = slices.iter().map(|slice| slice.position.dot(normal)).collect();
        let measures = header.of_frame(0, tags::PIXEL_MEASURES_SEQUENCE);
        let [declared, thickness] =
            [tags::SPACING_BETWEEN_SLICES, tags::SLICE_THICKNESS].map(|tag| measures.positive(tag));
        let tolerance = ROUNDING * first.along_row.length().min(first.along_column.length());
        let Some(planes) = Planes::new(places, tolerance, declared, thickness) else {
            return Err(bad(
                header.path,
                "has frames that are not on evenly spaced slices",
                "the voxels of a volume must lie on one regular grid",
                "resample the segmentation on the grid of its scan, for example in 3D Slicer",
            ));
        };
        let mut frames: BTreeMap<u16, Vec<Slice>> = BTreeMap::new();
        for slice in slices {
            let own = header.of_frame(slice.frame, tags::SEGMENT_IDENTIFICATION_SEQUENCE);
            let segment = match kind {
                Kind::LabelMap(_) => 0,
                _ => number(&own, tags::REFERENCED_SEGMENT_NUMBER, "ReferencedSegmentNumber")?,
            };
            frames.entry(segment).or_default().push(slice);
        }
        for (number, slices) in &frames {
            let indices = slices.iter().map(|slice| planes.index(slice.position.dot(normal))).collect();
            check_doubles(header.path, *number, indices)?;
        }
        let named = |label: String, number: u16| if label.is_empty() { format!("segment {number}") } else { label };
        let mut names = Vec::new();
        for item in header.items(tags::SEGMENT_SEQUENCE) {
            let number = number(&item, tags::SEGMENT_NUMBER, "SegmentNumber")?;
            names.push((number, named(item.text(tags::SEGMENT_LABEL), number)));
        }
        let known: BTreeSet<u16> = names.iter().map(|(number, _)| *number).collect();
        let is_named = |number: u16| known.contains(&number) || matches!(kind, Kind::LabelMap(_));
        let nameless = frames.keys().filter(|&&number| !is_named(number));
        names.extend(nameless.map(|&number| (number, named(String::new(), number))));
        Ok(Self { path, frames, names, kind, planes })
    }

    /// Reads the voxels of all segments.
    pub(super) fn read(&self) -> Result<Volume> {
        let columns = self.slices().next().map_or(0, |slice| slice.columns);
        let data = PixelData::read(&self.path, columns)?;
        let pads = [self.is_inside(&data, 0)?, self.is_inside(&data, self.planes.count() - 1)?].map(usize::from);
        let grid = self.grid(pads)?;
        // larger numbers need larger labels
        let is_byte = self.names.iter().all(|(number, _)| *number <= u8::MAX.into());
        let mut volume = match self.kind {
            Kind::LabelMap(_) => self.label_map(&data, grid, pads[0])?,
            _ if is_byte => self.layered::<u8>(&data, grid, pads[0])?,
            _ => self.layered::<u16>(&data, grid, pads[0])?,
        };
        if pads != [0, 0] {
            volume.remarks.push(
                "slices without a frame are background; an empty slice was added where a segment reaches the first or \
                 last frame"
                    .to_owned(),
            );
        }
        Ok(volume)
    }

    fn slices(&self) -> impl Iterator<Item = &Slice> {
        self.frames.values().flatten()
    }

    /// Returns the index of the slice of a frame, from the first slice with a frame.
    fn index(&self, slice: &Slice) -> usize {
        self.planes.index(slice.position.dot(slice.normal()))
    }

    /// Returns whether a pixel in the slice with this index is inside a segment.
    fn is_inside(&self, data: &PixelData, index: usize) -> Result<bool> {
        for slice in self.slices().filter(|slice| self.index(slice) == index) {
            if self.mask(data, slice)?.contains(&true) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Returns the pixels of a frame that are inside a segment.
    fn mask(&self, data: &PixelData, slice: &Slice) -> Result<Vec<bool>> {
        let pixels = &slice.pixels;
        if self.kind == Kind::Binary {
            return data.bits(slice.frame, pixels.count);
        }
        let stored = data.frame(slice.frame, pixels)?;
        let mut mask = vec![false; pixels.count];
        pixels.convert(&stored, &mut mask, |value| match self.kind {
            Kind::Fractional(most) => value >= INSIDE * most,
            _ => value != 0.0 && !self.is_background(value),
        });
        Ok(mask)
    }

    fn is_background(&self, value: f64) -> bool {
        matches!(self.kind, Kind::LabelMap(Some(background)) if background == value)
    }

    /// Returns the grid of all frames and, at its two ends, `pads` slices without a frame.
    fn grid(&self, pads: [usize; 2]) -> Result<Geometry> {
        let count = self.planes.count();
        let at = |index: usize| self.slices().find(|slice| self.index(slice) == index);
        let (Some(first), Some(last)) = (at(0), at(count - 1)) else {
            return Err(bad(&self.path, "has no frame", "there is nothing to read", "write the file again"));
        };
        let step = match count {
            1 => first.normal() * self.planes.spacing,
            _ => (last.position - first.position) / (count - 1) as f64,
        };
        let shift = |slice: &Slice| (slice.position - first.position - step * self.index(slice) as f64).length();
        if let Some(slice) = self.slices().find(|slice| shift(slice) > LARGEST_SHIFT * step.length()) {
            return Err(bad(
                &self.path,
                format!("has frame {} {:.3} mm away from its regular position", slice.frame + 1, shift(slice)),
                "the voxels of a volume must lie on one regular grid",
                "resample the segmentation on the grid of its scan, for example in 3D Slicer",
            ));
        }
        let size = [first.columns, first.rows, pads[0] + count + pads[1]];
        voxel_count(&self.path, size)?;
        if size.contains(&1) {
            return Err(bad(
                &self.path,
                format!("contains a flat image of {} x {} pixels in {} slices", size[0], size[1], size[2]),
                "a volume must have at least two voxels along each axis",
                "use a segmentation of the whole scan",
            ));
        }
        let origin = first.position - step * pads[0] as f64;
        geometry_from_steps(&self.path, size, [first.along_row, first.along_column, step], origin, Space::Lps)
    }

    /// Reads binary and fractional segments. The frame with index 0 is in slice `shift`.
    fn layered<L: Label>(&self, data: &PixelData, grid: Geometry, shift: usize) -> Result<Volume> {
        check_room::<L>(&self.path, &grid)?;
        let mut layers = Layers::<L>::default();
        for (number, name) in &self.names {
            let slices = self.frames.get(number).map_or(&[][..], Vec::as_slice);
            let masks = slices.par_iter().map(|slice| Ok((shift + self.index(slice), self.mask(data, slice)?)));
            let masks: Vec<Result<Mask>> = masks.collect();
            let masks = masks.into_iter().collect::<Result<Vec<Mask>>>()?;
            layers.add(&self.path, &grid, (*number, name.clone()), &Masks::new(&masks, &grid))?;
        }
        layers.join(&self.path, grid, "segments")
    }

    /// Reads a label map, like [`Self::layered`].
    fn label_map(&self, data: &PixelData, grid: Geometry, shift: usize) -> Result<Volume> {
        let plane = grid.size[0] * grid.size[1];
        // 16-bit labels, and 8-bit ones if these suffice
        check_memory(&self.path, 3 * grid.voxel_count() as u64)?;
        let mut labels = vec![0u16; grid.voxel_count()];
        for slice in self.slices() {
            let to = shift + self.index(slice);
            let stored = data.frame(slice.frame, &slice.pixels)?;
            slice.pixels.convert(&stored, &mut labels[to * plane..(to + 1) * plane], |value| {
                if self.is_background(value) { 0 } else { value as u16 }
            });
        }
        let voxels = match labels.iter().all(|&label| label <= u8::MAX.into()) {
            true => Voxels::U8(labels.iter().map(|&label| label as u8).collect()),
            false => Voxels::U16(labels),
        };
        let segment = |(number, name): &(u16, String)| Segment {
            name: name.clone(),
            at: LayerLabel { layer: 0, label: (*number).into() },
        };
        let segments = self.names.iter().filter(|(number, _)| *number != 0).map(segment).collect();
        Ok(Volume { segments, ..Volume::new(grid, voxels) })
    }
}

/// Reads the number of a segment.
fn number(header: &Header<'_>, tag: Tag, name: &str) -> Result<u16> {
    match header.whole(tag)? {
        Some(number) => Ok(number as u16),
        None => Err(bad(
            header.path,
            format!("lacks a {name}"),
            "the segment of a frame would be unknown",
            "write the segmentation again",
        )),
    }
}

/// Fails if a segment has two frames in one slice.
fn check_doubles(path: &Path, number: u16, mut indices: Vec<usize>) -> Result<()> {
    indices.sort_unstable();
    match indices.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(bad(
            path,
            format!("has two frames of segment {number} in slice {}", pair[0] + 1),
            "it contains several points in time, or a frame twice",
            "write the segmentation of one point in time to a separate file",
        )),
        None => Ok(()),
    }
}
