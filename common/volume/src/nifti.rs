//! Reads volumes in NIfTI-1 and NIfTI-2, the standard formats in neuroimaging, and in their
//! predecessor Analyze 7.5: `.nii`, `.nii.gz`, and pairs of `.hdr` and `.img` files. The RAS world
//! frame of NIfTI is converted to LPS.
//!
//! Analyze 7.5 does not define which side is left. As in nibabel and SPM, x is assumed to run from
//! right to left, y from posterior to anterior, and z from inferior to superior. The space is
//! unnamed, because this is an assumption.

mod header;
mod names;

use crate::error::bad;
use crate::error::{Error, Result};
use crate::geometry::{Geometry, Space};
use crate::limit::{geometry_from_steps, voxel_count};
use crate::volume::Volume;
use crate::voxel_data::{goes_on_remark, open};
use crate::voxels::{ScalarType, Voxels};
use glam::{DMat3, DQuat, DVec3};
use header::{Header, Kind};
use isoparticles_file::limit::check_memory;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Number of bytes between a header and the voxels of the same file. They indicate whether there
/// are extensions.
const EXTENSION_FLAG: usize = 4;

/// Returns whether an uncompressed file that starts with these bytes has a NIfTI header.
pub(crate) fn is_nifti(start: &[u8]) -> bool {
    header::size_and_order(start).is_some()
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

/// Reads a volume in NIfTI-1, NIfTI-2 or Analyze 7.5 with one number per voxel.
pub(crate) fn read_nifti(path: &Path) -> Result<Volume> {
    let cannot = |error: io::Error| Error::file(path, "read", error, "copy or download the file again");
    let mut reader = open(path).map_err(cannot)?;
    let mut start = Vec::new();
    Read::take(&mut reader, header::NIFTI_2_BYTES as u64).read_to_end(&mut start).map_err(cannot)?;
    let header = Header::parse(path, &start)?;
    let (geometry, mut remarks) = match header.kind {
        Kind::Analyze => analyze_geometry(path, &header, &start)?,
        Kind::Single | Kind::Pair => geometry(path, &header)?,
    };
    let scalar = scalar_type(path, &header)?;
    let count = geometry.voxel_count();
    check_memory(path, (count as u64).saturating_mul(scalar.bytes() as u64))?;
    let is_pair = header.kind != Kind::Single;
    let (mut offset, voxels_path) = (header.vox_offset, if is_pair { voxels_beside(path)? } else { path.into() });
    if !is_pair && offset < header.bytes as f64 {
        let first = header.bytes + EXTENSION_FLAG;
        remarks.push(format!(
            "the header places the voxels at byte {offset}, which is inside the header; they are read from byte {first}"
        ));
        offset = first as f64;
    }
    reader = open(&voxels_path).map_err(cannot)?;
    let read = skip_to_voxels(&mut reader, offset)
        .and_then(|before| Ok((before, Voxels::read_from(&mut reader, scalar, header.endian, count)?)))
        .and_then(|(before, voxels)| Ok((before, voxels, reader.has_more()? || reader.leaves_bytes()?)));
    let (before, voxels, goes_on) = read.map_err(|error| {
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
    let extensions = before.get(if is_pair { 0 } else { header.bytes }..).unwrap_or_default();
    let segments = names::names(extensions, header.endian, &mut remarks);
    let voxels = scaled(voxels, header.slope, header.intercept, &mut remarks);
    Ok(Volume { segments, remarks, ..Volume::new(geometry, voxels) }.in_lps())
}

/// Returns the voxel file that belongs to a separate header.
fn voxels_beside(path: &Path) -> Result<PathBuf> {
    partner(path).ok_or_else(|| {
        bad(
            path,
            "is the header of a pair whose voxels are missing",
            "they are in a file of the same name that ends with .img or .img.gz",
            "put that file into the same folder",
        )
    })
}

fn scalar_type(path: &Path, header: &Header) -> Result<ScalarType> {
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

/// Returns the size of the volume.
fn size(path: &Path, header: &Header) -> Result<[usize; 3]> {
    let sizes = header.sizes(path)?;
    if let Some(axis) = (3..sizes.len()).find(|&axis| sizes[axis] > 1) {
        return Err(bad(
            path,
            format!("has {} samples along axis {axis} (sizes {sizes:?})", sizes[axis]),
            "a single volume with one value per voxel is needed",
            "write one volume or component to a separate file",
        ));
    }
    if sizes.len() < 3 || sizes[..3].contains(&1) {
        return Err(bad(
            path,
            format!("is a flat image (sizes {sizes:?})"),
            "a volume must have at least two voxels along each axis",
            "use a 3-D volume",
        ));
    }
    let size = [sizes[0], sizes[1], sizes[2]];
    voxel_count(path, size)?;
    Ok(size)
}

/// Returns the geometry in mm, and in RAS if the header defines an orientation. Uses the sform if
/// it is valid, otherwise the qform, otherwise only the voxel spacings.
fn geometry(path: &Path, header: &Header) -> Result<(Geometry, Vec<String>)> {
    let size = size(path, header)?;
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
        (DMat3::from_diagonal(header.spacing()), DVec3::ZERO, Space::Unnamed)
    };
    let steps = [0, 1, 2].map(|axis| steps.col(axis) * millimetres);
    Ok((geometry_from_steps(path, size, steps, origin * millimetres, space)?, remarks))
}

/// Returns the geometry of an Analyze file. If x runs from right to left, as assumed, the
/// coordinates are LPS. As in nibabel and SPM, the world origin is the voxel that SPM stores in the
/// header or, if it is missing or far outside the volume, the centre of the volume.
fn analyze_geometry(path: &Path, header: &Header, start: &[u8]) -> Result<(Geometry, Vec<String>)> {
    let size = size(path, header)?;
    let voxels = DVec3::from_array(size.map(|n| n as f64));
    let origin = header::spm_origin(start, header.endian);
    let is_kept = origin != DVec3::ZERO && origin.cmpgt(-voxels).all() && origin.cmplt(2.0 * voxels).all();
    let origin = if is_kept { origin - 1.0 } else { 0.5 * (voxels - 1.0) };
    let steps = header.spacing().abs() * DVec3::new(1.0, -1.0, 1.0);
    let axes = [DVec3::X * steps.x, DVec3::Y * steps.y, DVec3::Z * steps.z];
    let remark = "the file is in Analyze 7.5, which does not define which side is left; x is assumed to run from right \
                  to left, as in nibabel and SPM";
    Ok((geometry_from_steps(path, size, axes, -origin * steps, Space::Unnamed)?, vec![remark.to_owned()]))
}

/// Returns the sform as the vectors between neighbouring voxels, the origin and the space.
fn sform(header: &Header) -> (DMat3, DVec3, Space) {
    let column = |axis: usize| DVec3::from_array(header.srow.map(|row| row[axis]));
    (DMat3::from_cols(column(0), column(1), column(2)), column(3), Space::Ras)
}

/// Returns the qform as the vectors between neighbouring voxels, the origin and the space.
fn qform(header: &Header) -> (DMat3, DVec3, Space) {
    let vector = header.quatern;
    // The first component of the quaternion is not stored. The norm of the other three may exceed
    // one because of rounding.
    let quaternion = DQuat::from_xyzw(vector.x, vector.y, vector.z, (1.0 - vector.length_squared()).max(0.0).sqrt());
    let rotation = DMat3::from_quat(quaternion.normalize());
    let mut spacing = header.spacing();
    if header.pixdim[0] < 0.0 {
        spacing.z = -spacing.z;
    }
    (rotation * DMat3::from_diagonal(spacing), header.qoffset, Space::Ras)
}

/// Maximum number of extension bytes that are read. This is enough for 65,535 label names of 256
/// bytes.
const MOST_EXTENSIONS: u64 = 1 << 24;

/// Skips the `skip` bytes before the voxels. Returns at most the first [`MOST_EXTENSIONS`] of these
/// bytes, which contain the extensions.
fn skip_to_voxels(reader: &mut dyn Read, skip: f64) -> io::Result<Vec<u8>> {
    if !(0.0..1e9).contains(&skip) {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "vox_offset is not from 0 to 1e9"));
    }
    let mut before = Vec::new();
    let mut reader = reader.take(skip as u64);
    reader.by_ref().take(MOST_EXTENSIONS).read_to_end(&mut before)?;
    io::copy(&mut reader, &mut io::sink())?;
    if reader.limit() > 0 { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(before) }
}

/// Applies the slope and intercept of the header. Values remain unchanged if the slope is zero, if
/// either number is not finite, or if the transformation is the identity.
fn scaled(voxels: Voxels, slope: f64, intercept: f64, remarks: &mut Vec<String>) -> Voxels {
    let plain = slope == 0.0 || !slope.is_finite() || !intercept.is_finite() || (slope == 1.0 && intercept == 0.0);
    if plain {
        return voxels;
    }
    // NIfTI-1 stores 32-bit numbers; in double precision, they would be shown with spurious digits
    let shown = [slope, intercept].map(|number| number as f32);
    remarks.push(format!("values are computed as stored value * {} + {}, as given in the header", shown[0], shown[1]));
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
