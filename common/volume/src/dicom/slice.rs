//! Reads a single slice: the position and number format in its header, and its pixels.

use super::{lengths, rle, source};
use crate::error::bad;
use crate::error::{Error, Result};
use crate::voxels::ScalarType;
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, OpenFileOptions, Tag};
use dicom_pixeldata::PixelDecoder;
use glam::DVec3;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Tolerance for the directions in a header. It limits the deviation of a unit vector's length from
/// 1, the dot product of perpendicular unit vectors, and the relative difference between vectors
/// that should be equal. Some programs round directions to four decimals. Rounding changes a unit
/// vector by at most sqrt(3) * 5e-5 = 8.7e-5, so the tolerance is more than 5 times the combined
/// error of two vectors.
pub(super) const DIRECTION_TOLERANCE: f64 = 1e-3;

/// UID of the RLE transfer syntax, which [`rle`] decodes.
const RLE_LOSSLESS: &str = "1.2.840.10008.1.2.5";

/// A DICOM file that contains an image, which may be a slice of a volume.
#[derive(Debug)]
pub(super) struct Picture {
    /// Kind of DICOM object (SOP class UID).
    pub(super) class: String,
    pub(super) series: SeriesName,
    /// The slice, or an error that explains why the image is not a slice.
    pub(super) slice: Result<Slice>,
}

/// The header of a file that contains one slice.
#[derive(Clone, Debug)]
pub(super) struct Slice {
    pub(super) path: PathBuf,
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

/// The contents of a DICOM file.
pub(super) enum Found {
    /// An image.
    Image(Box<Picture>),
    /// Anything else: a report, a directory, contours, or a slice with a truncated header.
    NoImage { path: PathBuf, class: String },
}

/// Attributes that identify a series.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct SeriesName {
    pub(super) uid: String,
    pub(super) number: String,
    pub(super) description: String,
    pub(super) modality: String,
}

/// The conversion of stored pixels to values: number format, rescale slope and rescale intercept.
/// For CT images, the values are in Hounsfield units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pixels {
    /// Bytes per stored pixel: 1, 2 or 4.
    bytes: usize,
    /// Number of significant bits.
    bits: u32,
    /// Position of the most significant bit. The bits above it may contain overlays.
    high_bit: u32,
    is_signed: bool,
    slope: f64,
    intercept: f64,
}

impl Picture {
    /// Reads the header of a DICOM file.
    pub(super) fn read(path: &Path) -> Result<Found> {
        let is_whole = lengths::lie_within(path)
            .map_err(|error| Error::file(path, "read", error, "copy or export the file again"))?;
        if !is_whole {
            return Err(bad(
                path,
                "has an element that extends beyond the end of the file, or cannot be parsed",
                "it is truncated or damaged",
                "copy or export the file again, or move it to another folder if it is not a slice",
            ));
        }
        let object = OpenFileOptions::new()
            .read_until(tags::PIXEL_DATA)
            .from_reader(opened(path)?)
            .map_err(|error| damaged(path, &error))?;
        let header = Header { path, object: &object };
        let class = object.meta().media_storage_sop_class_uid().trim_end_matches(['\0', ' ']).to_owned();
        let (Some(rows), Some(columns)) = (header.whole(tags::ROWS)?, header.whole(tags::COLUMNS)?) else {
            return Ok(Found::NoImage { path: path.to_path_buf(), class });
        };
        let series = SeriesName {
            uid: header.text(tags::SERIES_INSTANCE_UID),
            number: header.text(tags::SERIES_NUMBER),
            description: header.text(tags::SERIES_DESCRIPTION),
            modality: header.text(tags::MODALITY),
        };
        Ok(Found::Image(Box::new(Self { class, series, slice: Slice::of(&header, rows, columns) })))
    }
}

impl Slice {
    fn of(header: &Header<'_>, rows: usize, columns: usize) -> Result<Self> {
        header.check_plain()?;
        let orientation = header.numbers::<6>(tags::IMAGE_ORIENTATION_PATIENT, "ImageOrientationPatient")?;
        let position = header.numbers::<3>(tags::IMAGE_POSITION_PATIENT, "ImagePositionPatient")?;
        // PixelSpacing contains the distance between rows, then the distance between columns
        let spacing = header.numbers::<2>(tags::PIXEL_SPACING, "PixelSpacing")?;
        let (row, column) = (DVec3::from_slice(&orientation[..3]), DVec3::from_slice(&orientation[3..]));
        let is_unit = |v: DVec3| (v.length() - 1.0).abs() < DIRECTION_TOLERANCE;
        if !is_unit(row) || !is_unit(column) || row.dot(column).abs() > DIRECTION_TOLERANCE {
            return Err(header.meaningless("ImageOrientationPatient", &format!("{orientation:?}")));
        }
        Ok(Self {
            path: header.path.to_path_buf(),
            columns,
            rows,
            along_row: row.normalize() * spacing[1],
            along_column: column.normalize() * spacing[0],
            position: DVec3::from_array(position),
            pixels: header.pixels()?,
        })
    }

    /// Reads and decodes the pixels, and returns their values row by row.
    pub(super) fn values(&self) -> Result<Vec<f64>> {
        let path = &self.path;
        let object = dicom_object::from_reader(opened(path)?).map_err(|error| damaged(path, &error))?;
        let syntax = object.meta().transfer_syntax().trim_end_matches('\0').to_owned();
        let stored = if syntax == RLE_LOSSLESS {
            let fragments = object.get(tags::PIXEL_DATA).and_then(|element| element.fragments());
            let frame = fragments.and_then(|fragments| if let [frame] = fragments { Some(frame) } else { None });
            let count = self.rows * self.columns;
            frame
                .and_then(|frame| rle::decode(frame, count, self.pixels.bytes))
                .ok_or_else(|| self.undecoded(&syntax, "damaged"))?
        } else {
            let decoded = object.decode_pixel_data().map_err(|error| self.undecoded(&syntax, &reason(&error)))?;
            self.numbers(decoded.data())?
        };
        Ok(stored.into_iter().map(|stored| self.pixels.value(stored)).collect())
    }

    fn undecoded(&self, syntax: &str, why: &str) -> Error {
        bad(
            &self.path,
            format!("its pixels cannot be decoded (transfer syntax {syntax}): {why}"),
            "only uncompressed, RLE and JPEG (baseline and lossless) pixels can be read; the file may also be damaged",
            "write the series uncompressed, for example with gdcmconv --raw or dcmdjpeg, or convert it to NRRD with 3D Slicer",
        )
    }

    /// Extracts the stored numbers from the decoded bytes, which are in native byte order.
    fn numbers(&self, bytes: &[u8]) -> Result<Vec<u64>> {
        let (count, width) = (self.rows * self.columns, self.pixels.bytes);
        // decoders append a padding byte if the number of bytes is odd
        if !(bytes.len() == count * width || bytes.len() == (count * width).next_multiple_of(2)) {
            return Err(bad(
                &self.path,
                format!("has {} bytes of pixels, but needs {}", bytes.len(), count * width),
                format!("its header declares {} x {} pixels", self.columns, self.rows),
                "copy or export the file again",
            ));
        }
        let number = |group: &[u8]| match *group {
            [a] => a.into(),
            [a, b] => u16::from_ne_bytes([a, b]).into(),
            [a, b, c, d] => u32::from_ne_bytes([a, b, c, d]).into(),
            _ => 0,
        };
        Ok(bytes[..count * width].chunks_exact(width).map(number).collect())
    }
}

impl Pixels {
    /// Converts a stored number to a value.
    fn value(&self, stored: u64) -> f64 {
        let shifted = stored >> (self.high_bit + 1 - self.bits);
        let whole = if self.is_signed {
            ((shifted << (64 - self.bits)) as i64) >> (64 - self.bits)
        } else {
            (shifted & (u64::MAX >> (64 - self.bits))) as i64
        };
        whole as f64 * self.slope + self.intercept
    }

    /// Returns the minimum and maximum values that the pixels can represent.
    fn range(&self) -> (f64, f64) {
        let (low, high) = match self.is_signed {
            true => (-(2f64.powi(self.bits as i32 - 1)), 2f64.powi(self.bits as i32 - 1) - 1.0),
            false => (0.0, 2f64.powi(self.bits as i32) - 1.0),
        };
        let (a, b) = (low * self.slope + self.intercept, high * self.slope + self.intercept);
        (a.min(b), a.max(b))
    }

    fn is_whole(&self) -> bool {
        self.slope.fract() == 0.0 && self.intercept.fract() == 0.0
    }

    /// Returns the first of the types U8, I16, U16, I32 and F64 that can represent the values of
    /// all slices, or F32 if any slope or intercept is not an integer.
    pub(super) fn common_type(all: impl Iterator<Item = Self> + Clone) -> ScalarType {
        if !all.clone().all(|pixels| pixels.is_whole()) {
            return ScalarType::F32;
        }
        let (low, high) = all
            .map(|pixels| pixels.range())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (a, b)| (low.min(a), high.max(b)));
        let fits = |least: f64, most: f64| least <= low && high <= most;
        match () {
            () if fits(0.0, u8::MAX.into()) => ScalarType::U8,
            () if fits(i16::MIN.into(), i16::MAX.into()) => ScalarType::I16,
            () if fits(0.0, u16::MAX.into()) => ScalarType::U16,
            () if fits(i32::MIN.into(), i32::MAX.into()) => ScalarType::I32,
            () => ScalarType::F64,
        }
    }

    /// Describes how values are computed from stored numbers. Returns `None` if the values equal
    /// the stored numbers.
    pub(super) fn remark(&self) -> Option<String> {
        (self.slope != 1.0 || self.intercept != 0.0).then(|| {
            format!("values are computed as stored value * {} + {}, as given in the slices", self.slope, self.intercept)
        })
    }
}

/// A DICOM header and the path of its file.
struct Header<'a> {
    path: &'a Path,
    object: &'a DefaultDicomObject,
}

impl Header<'_> {
    /// Returns an element as a string, or an empty string if the element is missing.
    fn text(&self, tag: Tag) -> String {
        let text = self.object.get(tag).and_then(|element| element.to_str().ok());
        text.map_or_else(String::new, |text| text.trim_matches([' ', '\0']).to_owned())
    }

    /// Returns an element as an integer from 0 to 65,535, or `None` if the element is missing.
    fn whole(&self, tag: Tag) -> Result<Option<usize>> {
        let Some(element) = self.object.get(tag) else { return Ok(None) };
        match element.to_int::<u16>() {
            Ok(number) => Ok(Some(number.into())),
            Err(error) => Err(self.meaningless(&tag.to_string(), &error.to_string())),
        }
    }

    /// Returns the `COUNT` finite numbers of an element. Fails if the element is missing or
    /// invalid.
    fn numbers<const COUNT: usize>(&self, tag: Tag, name: &str) -> Result<[f64; COUNT]> {
        let Some(element) = self.object.get(tag) else {
            return Err(bad(
                self.path,
                format!("has no {name}"),
                "without it, the position of the slice is unknown",
                "export the series again from a program that keeps it, or move files that are not slices to another \
                 folder",
            ));
        };
        let numbers = element.to_multi_float64().ok().and_then(|numbers| <[f64; COUNT]>::try_from(numbers).ok());
        numbers
            .filter(|numbers| numbers.iter().all(|number| number.is_finite()))
            .ok_or_else(|| self.meaningless(name, &self.text(tag)))
    }

    /// Returns an element as a number, or `default` if the element is missing.
    fn number_or(&self, tag: Tag, name: &str, default: f64) -> Result<f64> {
        match self.object.get(tag) {
            None => Ok(default),
            Some(_) => self.numbers::<1>(tag, name).map(|[number]| number),
        }
    }

    fn meaningless(&self, name: &str, value: &str) -> Error {
        let shown: String = value.chars().take(80).collect();
        bad(
            self.path,
            format!("has {name} '{shown}' in its header"),
            "this value is invalid",
            "copy or export the file again",
        )
    }

    /// Fails unless the file contains a single frame with one number per pixel.
    fn check_plain(&self) -> Result<()> {
        let frames = self.text(tags::NUMBER_OF_FRAMES);
        if !matches!(frames.as_str(), "" | "1") {
            return Err(bad(
                self.path,
                format!("contains {frames} frames in one file"),
                "each slice must be in a separate file",
                "convert it to NIfTI with dcm2niix or to NRRD with 3D Slicer",
            ));
        }
        if let Some(samples) = self.whole(tags::SAMPLES_PER_PIXEL)?.filter(|&samples| samples != 1) {
            return Err(bad(
                self.path,
                format!("has {samples} values per pixel ({})", self.text(tags::PHOTOMETRIC_INTERPRETATION)),
                "a volume must have one value per voxel",
                "move colour pictures (screenshots, reports) to another folder, or choose another series",
            ));
        }
        Ok(())
    }

    fn pixels(&self) -> Result<Pixels> {
        let allocated = self.whole(tags::BITS_ALLOCATED)?.unwrap_or(16);
        let bits = self.whole(tags::BITS_STORED)?.unwrap_or(allocated);
        if !matches!(allocated, 8 | 16 | 32) || !(1..=allocated).contains(&bits) {
            return Err(self.meaningless("BitsAllocated and BitsStored", &format!("{allocated} and {bits}")));
        }
        let (slope, intercept) = (
            self.number_or(tags::RESCALE_SLOPE, "RescaleSlope", 1.0)?,
            self.number_or(tags::RESCALE_INTERCEPT, "RescaleIntercept", 0.0)?,
        );
        let high_bit = self.whole(tags::HIGH_BIT)?.unwrap_or(bits - 1);
        if !(bits - 1..allocated).contains(&high_bit) {
            return Err(self.meaningless("HighBit", &high_bit.to_string()));
        }
        if slope == 0.0 {
            return Err(self.meaningless("RescaleSlope", "0"));
        }
        let is_signed = self.whole(tags::PIXEL_REPRESENTATION)? == Some(1);
        Ok(Pixels { bytes: allocated / 8, bits: bits as u32, high_bit: high_bit as u32, is_signed, slope, intercept })
    }
}

fn opened(path: &Path) -> Result<BufReader<Box<dyn source::Source>>> {
    let opened = source::open(path).map(|(reader, _)| reader);
    opened.map_err(|error| Error::file(path, "read", error, "copy or export the file again"))
}

fn damaged(path: &Path, error: &impl std::error::Error) -> Error {
    bad(
        path,
        format!("cannot be read as DICOM: {}", reason(error)),
        "it is truncated or damaged",
        "copy or export the file again, or move it to another folder if it is not a slice",
    )
}

/// Joins the messages of an error and all its causes.
fn reason(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}
