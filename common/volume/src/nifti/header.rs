//! Parses the headers of NIfTI-1, NIfTI-2 and Analyze 7.5. Analyze has a subset of the fields of
//! NIfTI-1.

use crate::error::{Result, bad};
use crate::voxels::Endian;
use glam::DVec3;
use std::path::Path;

/// Size of a header of NIfTI-1 and of Analyze 7.5 in bytes (`sizeof_hdr` of the format).
const NIFTI_1_BYTES: usize = 348;

/// Size of a NIfTI-2 header in bytes (`sizeof_hdr` of the format).
pub(super) const NIFTI_2_BYTES: usize = 540;

/// The format of a header and the location of its voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// NIfTI with the voxels in the same file.
    Single,
    /// NIfTI with the voxels in a separate file.
    Pair,
    /// Analyze 7.5, always with the voxels in a separate file.
    Analyze,
}

/// The fields that determine the voxels and their geometry, named as in the NIfTI standard.
#[derive(Clone, Debug)]
pub(super) struct Header {
    /// Size of the header in bytes.
    pub(super) bytes: usize,
    pub(super) kind: Kind,
    pub(super) endian: Endian,
    /// Number of axes, from 1 to 7, and the size of each axis.
    pub(super) dim: [i64; 8],
    pub(super) datatype: i64,
    /// The sign of the third axis of the qform, and the spacing of each axis.
    pub(super) pixdim: [f64; 8],
    pub(super) vox_offset: f64,
    pub(super) slope: f64,
    pub(super) intercept: f64,
    pub(super) xyzt_units: i64,
    pub(super) qform_code: i64,
    pub(super) sform_code: i64,
    pub(super) quatern: DVec3,
    pub(super) qoffset: DVec3,
    /// The rows of the sform, each with its offset.
    pub(super) srow: [[f64; 4]; 3],
}

/// Reads the numbers of a header in the byte order of its file.
struct Fields<'a> {
    bytes: &'a [u8],
    endian: Endian,
}

impl Fields<'_> {
    /// Returns the bytes of a number in big-endian order.
    fn number<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.copy_from_slice(&self.bytes[at..at + N]);
        if self.endian == Endian::Little {
            bytes.reverse();
        }
        bytes
    }

    /// Returns an integer of `size` bytes.
    fn integer(&self, at: usize, size: usize) -> i64 {
        match size {
            1 => self.bytes[at].into(),
            2 => i16::from_be_bytes(self.number(at)).into(),
            4 => i32::from_be_bytes(self.number(at)).into(),
            _ => i64::from_be_bytes(self.number(at)),
        }
    }

    /// Returns a floating-point number of 4 or 8 bytes.
    fn real(&self, at: usize, size: usize) -> f64 {
        match size {
            4 => f32::from_be_bytes(self.number(at)).into(),
            _ => f64::from_be_bytes(self.number(at)),
        }
    }

    /// Returns consecutive floating-point numbers.
    fn reals<const N: usize>(&self, at: usize, size: usize) -> [f64; N] {
        std::array::from_fn(|n| self.real(at + n * size, size))
    }
}

/// Returns the size of the header and its byte order, or `None` if the file does not start with the
/// size of a header.
pub(super) fn size_and_order(start: &[u8]) -> Option<(usize, Endian)> {
    let first = *start.first_chunk::<4>()?;
    let size = |n: u32| [NIFTI_1_BYTES, NIFTI_2_BYTES].into_iter().find(|&size| size == n as usize);
    let little = size(u32::from_le_bytes(first)).map(|size| (size, Endian::Little));
    little.or_else(|| size(u32::from_be_bytes(first)).map(|size| (size, Endian::Big)))
}

impl Header {
    /// Parses the header at the start of a file.
    pub(super) fn parse(path: &Path, start: &[u8]) -> Result<Self> {
        let damaged =
            |what: String| bad(path, what, "it is damaged or not NIfTI", "copy, download or write the file again");
        let size = size_and_order(start).filter(|&(size, _)| start.len() >= size);
        let (bytes, endian) = size.ok_or_else(|| damaged("has no complete NIfTI header".to_owned()))?;
        let is_two = bytes == NIFTI_2_BYTES;
        let kind = match &start[if is_two { 4..8 } else { 344..348 }] {
            b"n+1\0" | b"n+2\0" => Kind::Single,
            b"ni1\0" | b"ni2\0" => Kind::Pair,
            _ if is_two => return Err(damaged("has no magic number of NIfTI-2".to_owned())),
            _ => Kind::Analyze,
        };
        let fields = Fields { bytes: start, endian };
        // the position of a field in NIfTI-1 and NIfTI-2, and the sizes of its numbers
        let at = |one: usize, two: usize| if is_two { two } else { one };
        let (size, code, real) = if is_two { (8, 4, 8) } else { (2, 2, 4) };
        let vox_offset = if is_two { fields.integer(168, 8) as f64 } else { fields.real(108, 4) };
        let srow = at(280, 400);
        Ok(Self {
            bytes,
            kind,
            endian,
            dim: std::array::from_fn(|n| fields.integer(at(40, 16) + n * size, size)),
            datatype: fields.integer(at(70, 12), 2),
            pixdim: fields.reals(at(76, 104), real),
            vox_offset,
            slope: fields.real(at(112, 176), real),
            intercept: fields.real(at(116, 184), real),
            xyzt_units: fields.integer(at(123, 500), at(1, 4)),
            qform_code: fields.integer(at(252, 344), code),
            sform_code: fields.integer(at(254, 348), code),
            quatern: DVec3::from_array(fields.reals(at(256, 352), real)),
            qoffset: DVec3::from_array(fields.reals(at(268, 376), real)),
            srow: std::array::from_fn(|n| fields.reals(srow + n * 4 * real, real)),
        })
    }

    /// Returns the sizes of the axes in the header.
    ///
    /// # Errors
    /// If the number of axes is not from 1 to 7, or a size is negative.
    pub(super) fn sizes(&self, path: &Path) -> Result<Vec<usize>> {
        let wrong = |what| bad(path, what, "it must be from 1 to 7, and no size negative", "write the file again");
        let axes = usize::try_from(self.dim[0]).ok().filter(|axes| (1..=7).contains(axes));
        let axes = axes.ok_or_else(|| wrong(format!("has dimension {}", self.dim[0])))?;
        let sizes = &self.dim[1..=axes];
        let whole: Option<Vec<usize>> = sizes.iter().map(|&n| usize::try_from(n).ok()).collect();
        whole.ok_or_else(|| wrong(format!("has dimension {axes} and the sizes {sizes:?}")))
    }

    /// Returns the spacing of the spatial axes.
    pub(super) fn spacing(&self) -> DVec3 {
        DVec3::from_slice(&self.pixdim[1..])
    }
}

/// Returns the origin that SPM stores in the header of an Analyze file: the indices of the voxel at
/// the world origin, from 1. All of them are 0 if the header has no origin.
pub(super) fn spm_origin(start: &[u8], endian: Endian) -> DVec3 {
    let fields = Fields { bytes: start, endian };
    DVec3::from_array(std::array::from_fn(|n| fields.integer(253 + 2 * n, 2) as f64))
}
