//! Reads volumes in NIfTI-1, a standard format in neuroimaging: `.nii`, `.nii.gz`, and pairs of
//! `.hdr` and `.img` files. The RAS world frame of NIfTI is converted to LPS.
//!
//! The `nifti` crate parses the header. This module reads the voxels itself, and allocates memory
//! only for data that is present in the file.

mod names;

use crate::error::bad;
use crate::error::{Error, Result};
use crate::geometry::{Geometry, Space};
use crate::limit::{geometry_from_steps, voxel_count};
use crate::volume::Volume;
use crate::voxel_data::{Coding, Stream, goes_on_remark};
use crate::voxels::{Endian, ScalarType, Voxels};
use glam::{DMat3, DQuat, DVec3};
use isoparticles_file::limit::check_memory;
use nifti::NiftiHeader;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Size of a NIfTI-1 header in bytes (`sizeof_hdr` of the format).
const HEADER_BYTES: u64 = 348;

/// Default byte offset of the voxels in a single file. They follow the header and four bytes that
/// indicate whether there are extensions.
const FIRST_VOXEL: u64 = 352;

/// Returns whether an uncompressed file that starts with these bytes has a NIfTI header.
pub(crate) fn is_nifti(start: &[u8]) -> bool {
    // the header starts with its size, 348 (NIfTI-1) or 540 (NIfTI-2), in the file's byte order
    matches!(start.get(..4), Some([0x5c, 1, 0, 0] | [0, 0, 1, 0x5c] | [0x1c, 2, 0, 0] | [0, 0, 2, 0x1c]))
}

/// Returns whether a file that starts with the bytes `start` is a gzip-compressed NIfTI file.
pub(crate) fn is_compressed_nifti(path: &Path, start: &[u8]) -> bool {
    let first = || -> io::Result<[u8; 4]> {
        let mut first = [0; 4];
        open(path)?.read_exact(&mut first)?;
        Ok(first)
    };
    start.starts_with(&[0x1f, 0x8b]) && first().is_ok_and(|first| is_nifti(&first))
}

/// Returns the other file of a pair: the voxel file (`.img`) of a header (`.hdr`), or the header of
/// a voxel file. Returns `None` if there is no such file.
pub(crate) fn partner(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?;
    let plain = name.strip_suffix(".gz").unwrap_or(name);
    let (stem, other) = match plain.strip_suffix(".hdr") {
        Some(stem) => (stem, "img"),
        None => (plain.strip_suffix(".img")?, "hdr"),
    };
    let beside = ["", ".gz"].map(|end| path.with_file_name(format!("{stem}.{other}{end}")));
    beside.into_iter().find(|path| path.is_file())
}

/// Opens a file for reading. A gzip-compressed file is decompressed as it is read.
fn open(path: &Path) -> io::Result<Stream<BufReader<File>>> {
    let mut file = BufReader::with_capacity(1 << 17, File::open(path)?);
    let is_compressed = file.fill_buf()?.starts_with(&[0x1f, 0x8b]);
    Ok(Stream::new(file, if is_compressed { Coding::Gzip } else { Coding::Raw }))
}

/// Reads a NIfTI-1 volume with one number per voxel.
pub(crate) fn read_nifti(path: &Path) -> Result<Volume> {
    let cannot = |error: io::Error| Error::file(path, "read", error, "copy or download the file again");
    let mut reader = open(path).map_err(cannot)?;
    let mut start = Vec::new();
    Read::take(&mut reader, HEADER_BYTES).read_to_end(&mut start).map_err(cannot)?;
    let header = header(path, &start)?;
    let (geometry, mut remarks) = geometry(path, &header)?;
    let scalar = scalar_type(path, &header)?;
    let count = geometry.voxel_count();
    check_memory(path, count as u64 * scalar.bytes() as u64)?;
    let endian = if header.endianness == nifti::Endianness::Little { Endian::Little } else { Endian::Big };
    let is_pair = header.magic == *PAIR;
    let (mut offset, voxels_path) =
        (f64::from(header.vox_offset), if is_pair { voxels_beside(path)? } else { path.into() });
    if is_pair {
        reader = open(&voxels_path).map_err(cannot)?;
    } else if offset < HEADER_BYTES as f64 {
        remarks.push(format!(
            "the header places the voxels at byte {offset}, which is inside the header; they are read from byte \
             {FIRST_VOXEL}"
        ));
        offset = FIRST_VOXEL as f64;
    }
    let skip = offset - if is_pair { 0.0 } else { HEADER_BYTES as f64 };
    let read = skip_to_voxels(&mut reader, skip)
        .and_then(|between| Ok((between, Voxels::read_from(&mut reader, scalar, endian, count)?)))
        .and_then(|(between, voxels)| Ok((between, voxels, reader.has_more()? || reader.leaves_bytes()?)));
    let (between, voxels, goes_on) = read.map_err(|error| {
        let next = "copy or download the file again";
        match error.kind() {
            io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidData => {
                let promised = format!("its header declares {count} voxels of type {}", scalar.name());
                bad(&voxels_path, format!("the data does not match the header: {error}"), promised, next)
            }
            _ => cannot(error),
        }
    })?;
    if goes_on {
        remarks.push(goes_on_remark(&voxels_path));
    }
    let segments = names::names(&between, endian, &mut remarks);
    let voxels = scaled(voxels, header.scl_slope, header.scl_inter, &mut remarks);
    Ok(Volume { segments, remarks, ..Volume::new(geometry, voxels) }.in_lps())
}

/// The magic number at the end of a header whose voxels are in a separate file.
const PAIR: &[u8; 4] = b"ni1\0";

fn header(path: &Path, start: &[u8]) -> Result<NiftiHeader> {
    let next = "convert it to a single NIfTI-1 file (.nii or .nii.gz) or to NRRD";
    if start.len() >= 4 && is_nifti(start) && (start[0] == 0x1c || start[3] == 0x1c) {
        return Err(bad(path, "is a NIfTI-2 file", "only NIfTI-1 can be read", next));
    }
    if start.get(344..348).is_some_and(|magic| magic != b"n+1\0" && magic != PAIR) {
        return Err(bad(
            path,
            "is an Analyze 7.5 header, not NIfTI",
            "it does not define which side is left, and programs differ on that",
            next,
        ));
    }
    NiftiHeader::from_reader(start)
        .map_err(|error| bad(path, format!("has no NIfTI-1 header: {error}"), "it is damaged or not NIfTI", next))
}

/// Returns the voxel file that belongs to a separate header.
fn voxels_beside(path: &Path) -> Result<PathBuf> {
    partner(path).ok_or_else(|| {
        bad(
            path,
            "is the header of a NIfTI pair whose voxels are missing",
            "they are in a file of the same name that ends with .img or .img.gz",
            "put that file into the same folder",
        )
    })
}

fn scalar_type(path: &Path, header: &NiftiHeader) -> Result<ScalarType> {
    Ok(match header.datatype {
        2 => ScalarType::U8,
        4 => ScalarType::I16,
        8 => ScalarType::I32,
        16 => ScalarType::F32,
        64 => ScalarType::F64,
        256 => ScalarType::I8,
        512 => ScalarType::U16,
        768 => ScalarType::U32,
        1024 => ScalarType::I64,
        1280 => ScalarType::U64,
        other => {
            let name = match other {
                32 | 1792 | 2048 => "complex numbers",
                128 | 2304 => "colours",
                _ => "values",
            };
            return Err(bad(
                path,
                format!("contains {name} (NIfTI type {other})"),
                "a volume must have one real value per voxel",
                "write one component to a separate file",
            ));
        }
    })
}

/// Returns the geometry in mm, and in RAS if the header defines an orientation. Uses the sform if
/// it is valid, otherwise the qform, otherwise only the voxel spacings.
fn geometry(path: &Path, header: &NiftiHeader) -> Result<(Geometry, Vec<String>)> {
    let dimension = usize::from(header.dim[0]);
    if !(1..=7).contains(&dimension) {
        return Err(bad(path, format!("has dimension {dimension}"), "it must be from 1 to 7", "write the file again"));
    }
    let sizes: Vec<usize> = header.dim[1..=dimension].iter().map(|&n| usize::from(n)).collect();
    if let Some(axis) = (3..dimension).find(|&axis| sizes[axis] > 1) {
        return Err(bad(
            path,
            format!("has {} samples along axis {axis} (sizes {sizes:?})", sizes[axis]),
            "a single volume with one value per voxel is needed",
            "write one volume or component to a separate file",
        ));
    }
    if dimension < 3 || sizes[..3].contains(&1) {
        return Err(bad(
            path,
            format!("is a flat image (sizes {sizes:?})"),
            "a volume must have at least two voxels along each axis",
            "use a 3-D volume",
        ));
    }
    let size = [sizes[0], sizes[1], sizes[2]];
    voxel_count(path, size)?;
    let mut remarks = Vec::new();
    let millimetres = match header.xyzt_units & 7 {
        1 => 1000.0,
        3 => 0.001,
        _ => 1.0,
    };
    let has_steps = sform(header).0.determinant().abs() > 0.0;
    if header.sform_code > 0 && !has_steps {
        remarks.push("the sform of the header has no directions and is ignored".to_owned());
    }
    let (steps, origin, space) = if header.sform_code > 0 && has_steps {
        sform(header)
    } else if header.qform_code > 0 {
        qform(header)
    } else {
        remarks.push("the header has no orientation; axis-aligned voxels at the origin are assumed".to_owned());
        let spacing = pixel_spacing(header);
        (DMat3::from_diagonal(spacing), DVec3::ZERO, Space::Unnamed)
    };
    let steps = [0, 1, 2].map(|axis| steps.col(axis) * millimetres);
    Ok((geometry_from_steps(path, size, steps, origin * millimetres, space)?, remarks))
}

fn pixel_spacing(header: &NiftiHeader) -> DVec3 {
    DVec3::new(header.pixdim[1].into(), header.pixdim[2].into(), header.pixdim[3].into())
}

/// Returns the sform as the vectors between neighbouring voxels, the origin and the space.
fn sform(header: &NiftiHeader) -> (DMat3, DVec3, Space) {
    let row = |row: [f32; 4]| row.map(f64::from);
    let (x, y, z) = (row(header.srow_x), row(header.srow_y), row(header.srow_z));
    let column = |axis: usize| DVec3::new(x[axis], y[axis], z[axis]);
    (DMat3::from_cols(column(0), column(1), column(2)), column(3), Space::Ras)
}

/// Returns the qform as the vectors between neighbouring voxels, the origin and the space.
fn qform(header: &NiftiHeader) -> (DMat3, DVec3, Space) {
    let vector = DVec3::new(header.quatern_b.into(), header.quatern_c.into(), header.quatern_d.into());
    // The first component of the quaternion is not stored. The norm of the other three may exceed
    // one because of rounding.
    let quaternion = DQuat::from_xyzw(vector.x, vector.y, vector.z, (1.0 - vector.length_squared()).max(0.0).sqrt());
    let rotation = DMat3::from_quat(quaternion.normalize());
    let mut spacing = pixel_spacing(header);
    if header.pixdim[0] < 0.0 {
        spacing.z = -spacing.z;
    }
    let origin = DVec3::new(header.quatern_x.into(), header.quatern_y.into(), header.quatern_z.into());
    (rotation * DMat3::from_diagonal(spacing), origin, Space::Ras)
}

/// Maximum number of extension bytes that are read. This is enough for 65,535 label names of 256
/// bytes.
const MOST_EXTENSIONS: u64 = 1 << 24;

/// Skips the `skip` bytes between the header and the voxels. Returns at most the first
/// [`MOST_EXTENSIONS`] of these bytes, which contain the extensions.
fn skip_to_voxels(reader: &mut dyn Read, skip: f64) -> io::Result<Vec<u8>> {
    if !(0.0..1e9).contains(&skip) {
        let what = if skip < 0.0 { "the voxels start inside the header" } else { "vox_offset is not below 1e9" };
        return Err(io::Error::new(io::ErrorKind::InvalidData, what));
    }
    let mut between = Vec::new();
    let mut reader = reader.take(skip as u64);
    reader.by_ref().take(MOST_EXTENSIONS).read_to_end(&mut between)?;
    io::copy(&mut reader, &mut io::sink())?;
    if reader.limit() > 0 { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(between) }
}

/// Applies the slope and intercept of the header. Values remain unchanged if the slope is zero, if
/// either number is not finite, or if the transformation is the identity.
fn scaled(voxels: Voxels, slope: f32, intercept: f32, remarks: &mut Vec<String>) -> Voxels {
    let plain = slope == 0.0 || !slope.is_finite() || !intercept.is_finite() || (slope == 1.0 && intercept == 0.0);
    if plain {
        return voxels;
    }
    remarks.push(format!("values are computed as stored value * {slope} + {intercept}, as given in the header"));
    let (slope, intercept) = (f64::from(slope), f64::from(intercept));
    match voxels.scalar_type() {
        // single precision is sufficient for these types and halves the memory
        ScalarType::I8 | ScalarType::U8 | ScalarType::I16 | ScalarType::U16 | ScalarType::F32 => {
            Voxels::F32(voxels.to_f32().into_iter().map(|x| (f64::from(x) * slope + intercept) as f32).collect())
        }
        _ => Voxels::F64(voxels.to_f64().into_iter().map(|x| x * slope + intercept).collect()),
    }
}

#[cfg(test)]
mod tests;
