//! Reads the header of a file with an image: the position and number format of each frame. A file
//! of one frame is a slice, and a multi-frame file contains many.

use super::header::Header;
use super::pixels::Pixels;
use crate::error::Result;
use crate::error::bad;
use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_dictionary_std::{StandardDataDictionary, tags};
use dicom_object::Tag;
use glam::DVec3;
use std::path::Path;
use std::sync::Arc;

/// Tolerance for the directions in a header. It limits the deviation of a unit vector's length from
/// 1, the dot product of perpendicular unit vectors, and the relative difference between vectors
/// that should be equal. Some programs round directions to four decimals. Rounding changes a unit
/// vector by at most sqrt(3) * 5e-5 = 8.7e-5, so the tolerance is more than 5 times the combined
/// error of two vectors.
pub(super) const DIRECTION_TOLERANCE: f64 = 1e-3;

/// Dimensions along which the frames of one volume differ. Frames that differ along other
/// dimensions, such as time, belong to different volumes.
const POSITIONS: [Tag; 5] = [
    tags::IN_STACK_POSITION_NUMBER,
    tags::IMAGE_POSITION_PATIENT,
    tags::IMAGE_POSITION_VOLUME,
    tags::SLICE_LOCATION,
    tags::INSTANCE_NUMBER,
];

/// A frame that is a slice of a volume.
#[derive(Clone, Debug)]
pub(super) struct Slice {
    pub(super) path: Arc<Path>,
    /// Index of the frame in the file.
    pub(super) frame: usize,
    /// Indices along the dimensions other than position. They are equal for all frames of a volume.
    pub(super) part: Vec<(Tag, u32)>,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// World vector in mm from a pixel to the next pixel in the same row.
    pub(super) along_row: DVec3,
    /// World vector in mm from a pixel to the next pixel in the same column.
    pub(super) along_column: DVec3,
    /// World position in mm of the centre of the first pixel.
    pub(super) position: DVec3,
    pub(super) pixels: Pixels,
}

impl Slice {
    /// Reads the frames of a file. Fails if a frame is not a slice.
    pub(super) fn frames(header: &Header<'_>, rows: usize, columns: usize) -> Result<Vec<Self>> {
        let count = frame_count(header)?;
        check_plain(header)?;
        let path: Arc<Path> = header.path.into();
        let dimensions: Vec<Tag> = header
            .items(tags::DIMENSION_INDEX_SEQUENCE)
            .map(|item| {
                item.object.get(tags::DIMENSION_INDEX_POINTER).and_then(|pointer| pointer.value().to_tag().ok())
            })
            .map(|tag| tag.unwrap_or(Tag(0, 0)))
            .collect();
        let frame = |frame: usize| -> Result<Self> {
            let content = header.of_frame(frame, tags::FRAME_CONTENT_SEQUENCE);
            let indices =
                content.object.get(tags::DIMENSION_INDEX_VALUES).and_then(|all| all.to_multi_int::<u32>().ok());
            let indices = dimensions.iter().copied().zip(indices.unwrap_or_default());
            let place = Place::of(header, frame)?;
            Ok(Self {
                path: Arc::clone(&path),
                frame,
                part: indices.filter(|(tag, _)| !POSITIONS.contains(tag)).collect(),
                columns,
                rows,
                along_row: place.along_row,
                along_column: place.along_column,
                position: place.position,
                pixels: Pixels::of(header, frame, rows * columns)?,
            })
        };
        (0..count).map(frame).collect()
    }

    /// Returns the unit normal of the slice.
    pub(super) fn normal(&self) -> DVec3 {
        self.along_row.cross(self.along_column).normalize_or_zero()
    }
}

/// Describes a part of a series, for example `TemporalPositionIndex 2`.
pub(super) fn described(part: &[(Tag, u32)]) -> String {
    let name =
        |tag: Tag| StandardDataDictionary.by_tag(tag).map_or_else(|| tag.to_string(), |entry| entry.alias().to_owned());
    part.iter().map(|&(tag, index)| format!("{} {index}", name(tag))).collect::<Vec<_>>().join(", ")
}

/// The position of a frame, as in [`Slice`].
struct Place {
    along_row: DVec3,
    along_column: DVec3,
    position: DVec3,
}

impl Place {
    fn of(header: &Header<'_>, frame: usize) -> Result<Self> {
        let [plane, orientation, measures] =
            [tags::PLANE_POSITION_SEQUENCE, tags::PLANE_ORIENTATION_SEQUENCE, tags::PIXEL_MEASURES_SEQUENCE]
                .map(|tag| header.of_frame(frame, tag));
        let orientation = orientation.numbers::<6>(tags::IMAGE_ORIENTATION_PATIENT, "ImageOrientationPatient")?;
        let position = plane.numbers::<3>(tags::IMAGE_POSITION_PATIENT, "ImagePositionPatient")?;
        // PixelSpacing contains the distance between rows, then the distance between columns
        let spacing = measures.numbers::<2>(tags::PIXEL_SPACING, "PixelSpacing")?;
        let (row, column) = (DVec3::from_slice(&orientation[..3]), DVec3::from_slice(&orientation[3..]));
        let is_unit = |v: DVec3| (v.length() - 1.0).abs() < DIRECTION_TOLERANCE;
        if !is_unit(row) || !is_unit(column) || row.dot(column).abs() > DIRECTION_TOLERANCE {
            return Err(header.meaningless("ImageOrientationPatient", &format!("{orientation:?}")));
        }
        Ok(Self {
            along_row: row.normalize() * spacing[1],
            along_column: column.normalize() * spacing[0],
            position: DVec3::from_array(position),
        })
    }
}

/// Returns the number of frames. Fails if there are several without a position for each.
fn frame_count(header: &Header<'_>) -> Result<usize> {
    let frames = header.text(tags::NUMBER_OF_FRAMES);
    let placed = header.items(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).len();
    if matches!(frames.as_str(), "" | "1") {
        return Ok(1);
    }
    if frames.parse() == Ok(placed) && placed > 0 {
        return Ok(placed);
    }
    Err(bad(
        header.path,
        format!("contains {frames} frames in one file, and positions for {placed}"),
        "without its position, a frame cannot become a slice of a volume",
        "convert it to NIfTI with dcm2niix or to NRRD with 3D Slicer",
    ))
}

/// Fails unless each pixel has one value.
fn check_plain(header: &Header<'_>) -> Result<()> {
    match header.whole(tags::SAMPLES_PER_PIXEL)?.filter(|&samples| samples != 1) {
        Some(samples) => Err(bad(
            header.path,
            format!("has {samples} values per pixel ({})", header.text(tags::PHOTOMETRIC_INTERPRETATION)),
            "a volume must have one value per voxel",
            "move colour pictures (screenshots, reports) to another folder, or choose another series",
        )),
        None => Ok(()),
    }
}
