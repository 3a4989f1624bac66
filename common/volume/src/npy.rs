//! Reads NumPy arrays: `.npy`, versions 1 to 3. The first axis is x, as in the Python package of
//! this project. The file has no spacing, so the caller must give one.
//!
//! The header is a Python dictionary with three entries. This module parses it without a crate,
//! because the crates for this format parse arbitrary Python literals.

use crate::error::{Error, Result, bad};
use crate::geometry::Geometry;
use crate::limit::{checked_spacing, voxel_count};
use crate::volume::Volume;
use crate::voxel_data::goes_on_remark;
use crate::voxels::{Endian, ScalarType, Voxels};
use glam::DVec3;
use isoparticles_file::limit::check_memory;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// First bytes of the format.
const MAGIC: &[u8] = b"\x93NUMPY";

/// Maximum length of a header in bytes. NumPy refuses to read longer ones by default.
const MOST_HEADER_BYTES: usize = 10_000;

/// Returns whether a file that starts with these bytes is a NumPy array.
pub(crate) fn is_npy(start: &[u8]) -> bool {
    start.starts_with(MAGIC)
}

/// Reads an array of three axes. `spacing` is the distance between voxel centres in mm.
pub(crate) fn read_npy(path: &Path, spacing: Option<DVec3>) -> Result<Volume> {
    let unreadable = |error| Error::file(path, "read", error, "copy the file again");
    let mut file = File::open(path).map_err(unreadable)?;
    let mut start = Vec::new();
    Read::take(&mut file, (MOST_HEADER_BYTES + 12) as u64).read_to_end(&mut start).map_err(unreadable)?;
    let (header, first) = Header::parse(&start).map_err(|what| {
        bad(path, what, "the header of a NumPy array names its type, order and shape", "save the array again")
    })?;
    let (scalar, endian) = scalar_type(path, &header.descr)?;
    let [nx, ny, nz] = size(path, &header.shape)?;
    let spacing = checked_spacing(path, spacing)?;
    let count = voxel_count(path, [nx, ny, nz])?;
    // values in C order are read into one array and reordered into another
    let copies = if header.fortran_order { 1 } else { 2 };
    check_memory(path, (count as u64).saturating_mul(copies * scalar.bytes() as u64))?;
    let voxels = Voxels::read_file(path, first as u64, scalar, endian, count).map_err(|error| match error.kind() {
        std::io::ErrorKind::UnexpectedEof => {
            let promised = format!("its header declares {nx} x {ny} x {nz} values of type {}", scalar.name());
            bad(path, format!("the data does not match the header: {error}"), promised, "save the array again")
        }
        _ => unreadable(error),
    })?;
    let voxels = if header.fortran_order { voxels } else { voxels.reversed_axes([nz, ny, nx]) };
    let mut remarks = vec![format!(
        "the axes of the array are read as x, y, z ({nx} x {ny} x {nz}); an array with the axes z, y, x must be \
         transposed before it is saved, or the mesh is mirrored"
    )];
    let end = (first + count * scalar.bytes()) as u64;
    if std::fs::metadata(path).map_err(unreadable)?.len() > end {
        remarks.push(goes_on_remark(path));
    }
    Ok(Volume { remarks, ..Volume::new(Geometry::axis_aligned([nx, ny, nz], spacing), voxels) })
}

/// The entries of a header.
struct Header {
    descr: String,
    fortran_order: bool,
    shape: Vec<usize>,
}

impl Header {
    /// Parses the header at the start of a file. Also returns the position of the first value.
    fn parse(start: &[u8]) -> std::result::Result<(Self, usize), String> {
        let short = || "has a header that is damaged or too long".to_owned();
        let (text, length) = match start.get(MAGIC.len()..).ok_or_else(short)? {
            [1, _, a, b, ..] => (10, u16::from_le_bytes([*a, *b]).into()),
            [2 | 3, _, a, b, c, d, ..] => (12, u32::from_le_bytes([*a, *b, *c, *d]) as usize),
            [version, ..] => return Err(format!("has version {version} of NumPy's format")),
            [] => return Err(short()),
        };
        let first = length.checked_add(text).ok_or_else(short)?;
        let text = start.get(text..first).ok_or_else(short)?;
        let text = std::str::from_utf8(text).map_err(|_| short())?;
        let value = |name: &str| {
            let (_, rest) = text.split_once(&format!("'{name}':"))?;
            Some(rest.trim_start())
        };
        let lacks = |name: &str| format!("has no valid '{name}' in its header");
        let descr = value("descr").ok_or_else(|| lacks("descr"))?;
        // the type of a structured array is a list
        let descr = match descr.strip_prefix('\'').and_then(|rest| rest.split_once('\'')) {
            Some((descr, _)) => descr.to_owned(),
            None => descr.chars().take(40).collect(),
        };
        let order = value("fortran_order").unwrap_or_default();
        let fortran_order = match () {
            () if order.starts_with("True") => true,
            () if order.starts_with("False") => false,
            () => return Err(lacks("fortran_order")),
        };
        let shape = value("shape").and_then(|shape| shape.strip_prefix('(')?.split_once(')'));
        let shape: Option<Vec<usize>> = shape.and_then(|(shape, _)| {
            let sizes = shape.split(',').map(str::trim).filter(|size| !size.is_empty());
            sizes.map(|size| size.trim_end_matches('L').parse().ok()).collect()
        });
        Ok((Self { descr, fortran_order, shape: shape.ok_or_else(|| lacks("shape"))? }, first))
    }
}

/// Returns the type of the values and their byte order.
fn scalar_type(path: &Path, descr: &str) -> Result<(ScalarType, Endian)> {
    let (order, name) = descr.split_at_checked(1).unwrap_or_default();
    let scalar = match name {
        "b1" | "u1" => ScalarType::U8,
        "i1" => ScalarType::I8,
        "u2" => ScalarType::U16,
        "i2" => ScalarType::I16,
        "u4" => ScalarType::U32,
        "i4" => ScalarType::I32,
        "u8" => ScalarType::U64,
        "i8" => ScalarType::I64,
        "f4" => ScalarType::F32,
        "f8" => ScalarType::F64,
        _ => {
            return Err(bad(
                path,
                format!("contains values of NumPy's type {descr}"),
                "a volume must have one number of 8 to 64 bits per voxel",
                "convert the array before you save it, for example with array.astype('float32')",
            ));
        }
    };
    Ok((scalar, if order == ">" { Endian::Big } else { Endian::Little }))
}

/// Returns the size of the volume.
fn size(path: &Path, shape: &[usize]) -> Result<[usize; 3]> {
    match <[usize; 3]>::try_from(shape) {
        Ok(size) if size.iter().all(|&n| n >= 2) => Ok(size),
        _ => Err(bad(
            path,
            format!("is an array of shape {shape:?}"),
            "a volume must have three axes of at least two voxels",
            "save one volume with one value per voxel",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read::{ReadOptions, read_volume, read_volume_with};

    /// Creates a file with this header dictionary, of the given version.
    fn file(version: u8, dictionary: &str, data: &[u8]) -> Vec<u8> {
        let length = (dictionary.len() as u32).to_le_bytes();
        let length = if version == 1 { &length[..2] } else { &length };
        [MAGIC, &[version, 0], length, dictionary.as_bytes(), data].concat()
    }

    fn read(bytes: &[u8], spacing: Option<DVec3>) -> Result<Volume> {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("v.dat");
        std::fs::write(&path, bytes).expect("written");
        read_volume_with(&path, &ReadOptions { spacing, ..ReadOptions::default() })
    }

    const SHAPE: &str = "{'descr': '|u1', 'fortran_order': False, 'shape': (2, 3, 4), }\n";

    #[test]
    fn the_first_axis_is_x_in_both_orders() {
        let data: Vec<u8> = (0..24).collect();
        let spacing = DVec3::new(0.5, 1.0, 2.0);
        for version in 1..=3 {
            let volume = read(&file(version, SHAPE, &data), Some(spacing)).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!((volume.geometry.size, volume.geometry.spacing), ([2, 3, 4], spacing));
            let Voxels::U8(values) = &volume.voxels else { panic!("{:?}", volume.voxels) };
            assert_eq!(values[volume.geometry.linear(1, 2, 3)], 23);
            assert_eq!(values[volume.geometry.linear(1, 0, 2)], 14);
        }
        let fortran = file(1, &SHAPE.replace("False", "True"), &data);
        assert_eq!(read(&fortran, Some(spacing)).expect("read").voxels, Voxels::U8(data));
    }

    #[test]
    fn without_a_spacing_the_error_names_it() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("v.npy");
        std::fs::write(&path, file(1, SHAPE, &[0; 24])).expect("written");
        let error = read_volume(&path).expect_err("no spacing");
        assert!(error.remedy().contains("SPACING=") && error.remedy().contains("--spacing"), "{}", error.remedy());
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
            let error = read(&file(1, SHAPE, &[0; 24]), Some(DVec3::new(1.0, wrong, 1.0))).expect_err("no spacing");
            assert!(error.to_string().contains("spacing"), "{error}");
        }
    }

    #[test]
    fn damaged_headers_are_refused() {
        for (header, word) in [
            ("", "no valid 'descr'"),
            ("{'descr': '<f2', 'fortran_order': False, 'shape': (2, 3, 4)}", "type <f2"),
            ("{'descr': [('a', '<i4')], 'fortran_order': False, 'shape': (2, 3, 4)}", "type [('a'"),
            ("{'descr': '<u2', 'shape': (2, 3, 4)}", "'fortran_order'"),
            ("{'descr': '<u2', 'fortran_order': maybe, 'shape': (2, 3, 4)}", "'fortran_order'"),
            ("{'descr': '<u2', 'fortran_order': True, 'shape': (2, 3, 4)}", "ends after 12 of 24"),
            ("{'descr': '|u1', 'fortran_order': True, 'shape': (2, 3, -4)}", "'shape'"),
            ("{'descr': '|u1', 'fortran_order': True, 'shape': 24}", "'shape'"),
            ("{'descr': '|u1', 'fortran_order': True, 'shape': (24,)}", "shape [24]"),
            ("{'descr': '|u1', 'fortran_order': True, 'shape': (24, 1, 1)}", "shape [24, 1, 1]"),
            ("{'descr': '|u1', 'fortran_order': True, 'shape': (9999999999, 9999999999, 9999999999)}", "declares"),
        ] {
            let error = read(&file(1, header, &[0; 24]), Some(DVec3::ONE)).expect_err(header);
            assert!(error.to_string().contains(word) && !error.remedy().is_empty(), "'{word}' is not in '{error}'");
        }
        let whole = file(2, SHAPE, &[0; 24]);
        (6..whole.len()).for_each(|end| assert!(read(&whole[..end], Some(DVec3::ONE)).is_err(), "{end}"));
        assert!(read(&file(4, SHAPE, &[0; 24]), Some(DVec3::ONE)).is_err());
    }
}
