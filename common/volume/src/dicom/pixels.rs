//! Decodes the pixels of the frames of a DICOM file, and converts them to values.

use super::elements::{self, Elements};
use super::header::{Header, damaged, unreadable};
use super::{jpeg, rle};
use crate::error::bad;
use crate::error::{Error, Result};
use crate::voxels::ScalarType;
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use isoparticles_file::limit::check_memory;
use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// The conversion of stored pixels to values: number format, rescale slope and rescale intercept.
/// For CT images, the values are in Hounsfield units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pixels {
    /// Number of pixels in a frame.
    pub(super) count: usize,
    /// Bytes per stored pixel: 1, 2 or 4, or 0 if a byte contains eight pixels.
    pub(super) bytes: usize,
    /// Number of significant bits.
    bits: u32,
    /// Position of the most significant bit. The bits above it may contain overlays.
    high_bit: u32,
    is_signed: bool,
    slope: f64,
    intercept: f64,
}

impl Pixels {
    /// Reads the number format of a frame.
    pub(super) fn of(header: &Header<'_>, frame: usize, count: usize) -> Result<Self> {
        let allocated = header.whole(tags::BITS_ALLOCATED)?.unwrap_or(16);
        let bits = header.whole(tags::BITS_STORED)?.unwrap_or(allocated);
        if !matches!(allocated, 1 | 8 | 16 | 32) || !(1..=allocated).contains(&bits) {
            return Err(header.meaningless("BitsAllocated and BitsStored", &format!("{allocated} and {bits}")));
        }
        let rescale = header.of_frame(frame, tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE);
        let (slope, intercept) = (
            rescale.number_or(tags::RESCALE_SLOPE, "RescaleSlope", 1.0)?,
            rescale.number_or(tags::RESCALE_INTERCEPT, "RescaleIntercept", 0.0)?,
        );
        let high_bit = header.whole(tags::HIGH_BIT)?.unwrap_or(bits - 1);
        if !(bits - 1..allocated).contains(&high_bit) {
            return Err(header.meaningless("HighBit", &high_bit.to_string()));
        }
        if slope == 0.0 {
            return Err(header.meaningless("RescaleSlope", "0"));
        }
        let is_signed = header.whole(tags::PIXEL_REPRESENTATION)? == Some(1);
        let (bits, high_bit) = (bits as u32, high_bit as u32);
        Ok(Self { count, bytes: allocated / 8, bits, high_bit, is_signed, slope, intercept })
    }

    /// Converts the stored numbers of a frame, which are in native byte order, to values.
    pub(super) fn convert<T>(&self, stored: &[u8], values: &mut [T], rounded: impl Fn(f64) -> T) {
        fn each<const N: usize, T>(stored: &[u8], values: &mut [T], value: impl Fn([u8; N]) -> T) {
            values.iter_mut().zip(stored.as_chunks::<N>().0).for_each(|(to, &bytes)| *to = value(bytes));
        }
        match self.bytes {
            1 => each(stored, values, |[byte]| rounded(self.value(byte.into()))),
            2 => each(stored, values, |bytes| rounded(self.value(u16::from_ne_bytes(bytes).into()))),
            _ => each(stored, values, |bytes| rounded(self.value(u32::from_ne_bytes(bytes).into()))),
        }
    }

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

/// A DICOM file in memory, with the pixels of its frames.
pub(super) struct PixelData {
    path: PathBuf,
    object: InMemDicomObject,
    syntax: String,
    columns: usize,
}

impl PixelData {
    /// Reads a whole file into memory.
    pub(super) fn read(path: &Path, columns: usize) -> Result<Self> {
        let size = std::fs::metadata(path).map_or(0, |file| file.len());
        check_memory(path, size)?;
        let read = elements::read(path, true).map_err(|error| unreadable(path, error))?;
        let Elements { object, syntax, damage: None, .. } = read else {
            return Err(damaged(path, &read.damage.unwrap_or_default()));
        };
        Ok(Self { path: path.to_path_buf(), object, syntax, columns })
    }

    /// Returns the stored numbers of a frame in native byte order.
    pub(super) fn frame(&self, frame: usize, pixels: &Pixels) -> Result<Cow<'_, [u8]>> {
        if self.native().is_some() {
            return self.native_bits(frame, 8 * pixels.bytes, pixels.count).map(|(bytes, _)| bytes);
        }
        let encoded = self.encoded(frame)?;
        let shape = [self.columns, pixels.count / self.columns.max(1)];
        let decoded = match self.syntax.as_str() {
            uids::RLE_LOSSLESS => {
                rle::decode(&encoded, pixels.count, pixels.bytes).ok_or_else(|| "the data is damaged".to_owned())
            }
            uids::JPEG_BASELINE8_BIT | uids::JPEG_EXTENDED12_BIT | uids::JPEG_LOSSLESS | uids::JPEG_LOSSLESS_SV1 => {
                jpeg::decode(&encoded, shape, pixels.bytes)
            }
            uids::JPEG2000_LOSSLESS | uids::JPEG2000 => jpeg::decode_2000(&encoded, shape, pixels.bytes),
            _ => Err("it is not supported".to_owned()),
        };
        decoded.map(Cow::Owned).map_err(|why| self.undecoded(&why))
    }

    /// Returns which pixels of a frame are not 0, if each pixel is one bit. The bits of all frames
    /// form one sequence. The least significant bit of a byte comes first.
    pub(super) fn bits(&self, frame: usize, count: usize) -> Result<Vec<bool>> {
        if self.native().is_none() {
            return Err(self.undecoded("frames of one bit per pixel must not be compressed"));
        }
        let (bytes, first) = self.native_bits(frame, 1, count)?;
        let mut bits = vec![false; count];
        if first == 0 {
            // the common case: eight pixels at a time
            for (bits, byte) in bits.chunks_mut(8).zip(bytes.iter()) {
                bits.iter_mut().enumerate().for_each(|(n, bit)| *bit = byte >> n & 1 == 1);
            }
        } else {
            let at = |n: usize| bytes[(first + n) / 8] >> ((first + n) % 8) & 1 == 1;
            bits.iter_mut().enumerate().for_each(|(n, bit)| *bit = at(n));
        }
        Ok(bits)
    }

    /// Returns the pixel data if it is not compressed.
    fn native(&self) -> Option<Cow<'_, [u8]>> {
        Some(self.object.get(tags::PIXEL_DATA)?.value().primitive()?.to_bytes())
    }

    /// Returns the bytes of a frame that is not compressed, and the position of the first bit.
    fn native_bits(&self, frame: usize, width: usize, count: usize) -> Result<(Cow<'_, [u8]>, usize)> {
        let bytes = self.native().unwrap_or_default();
        let range = || {
            let first = frame.checked_mul(count)?.checked_mul(width)?;
            let end = first.checked_add(count.checked_mul(width)?)?.div_ceil(8);
            (end <= bytes.len()).then_some((first, first / 8..end))
        };
        let Some((first, range)) = range() else {
            return Err(bad(
                &self.path,
                format!(
                    "has {} bytes of pixels, but needs {}",
                    bytes.len(),
                    (frame + 1) as u128 * (count * width).div_ceil(8) as u128
                ),
                format!("its header declares {} x {} pixels", self.columns, count / self.columns.max(1)),
                "copy or export the file again",
            ));
        };
        let bytes = match bytes {
            Cow::Borrowed(bytes) => Cow::Borrowed(&bytes[range]),
            Cow::Owned(bytes) => Cow::Owned(bytes[range].to_vec()),
        };
        Ok((bytes, first % 8))
    }

    /// Returns the compressed bytes of a frame. A frame consists of one fragment, or of the
    /// fragments from its entry in the offset table up to the next entry.
    fn encoded(&self, frame: usize) -> Result<Cow<'_, [u8]>> {
        let value = self.object.get(tags::PIXEL_DATA).map(|element| element.value());
        let fragments = value.and_then(|value| value.fragments()).unwrap_or_default();
        let frames = Header { path: &self.path, object: &self.object }.text(tags::NUMBER_OF_FRAMES);
        let frames = frames.parse().unwrap_or(1);
        if frames == 1 || frames == fragments.len() {
            let own = if frames == 1 { fragments } else { fragments.get(frame..=frame).unwrap_or_default() };
            return match own {
                [] => Err(self.undecoded("a frame is missing")),
                [one] => Ok(Cow::Borrowed(one)),
                several => Ok(Cow::Owned(several.concat())),
            };
        }
        let offsets = value.and_then(|value| value.offset_table()).unwrap_or_default();
        let Some(&start) = offsets.get(frame).filter(|_| offsets.len() == frames) else {
            return Err(self.undecoded("the frames have several fragments, and their offsets are missing"));
        };
        let end = offsets.get(frame + 1).map_or(u64::MAX, |&end| end.into());
        let mut position = 0;
        let own = fragments.iter().filter(|fragment| {
            let is_own = (u64::from(start)..end).contains(&position);
            // each fragment follows a tag and a length of 4 bytes each
            position += 8 + fragment.len() as u64;
            is_own
        });
        Ok(Cow::Owned(own.flatten().copied().collect()))
    }

    fn undecoded(&self, why: &str) -> Error {
        bad(
            &self.path,
            format!("its pixels cannot be decoded (transfer syntax {}): {why}", self.syntax),
            "only uncompressed, RLE, JPEG (baseline and lossless) and JPEG 2000 pixels can be read; the file may also \
             be damaged",
            "write the series uncompressed, for example with gdcmconv --raw or dcmdjpeg, or convert it to NRRD with 3D Slicer",
        )
    }
}
