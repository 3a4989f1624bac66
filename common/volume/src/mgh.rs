//! Reads FreeSurfer volumes: `.mgh`, and `.mgz`, its gzip-compressed form. The RAS world frame is
//! converted to LPS. The files contain no label names; these are in FreeSurfer's colour tables.

use crate::error::{Error, Result, bad};
use crate::geometry::{Geometry, Space};
use crate::limit::{geometry_from_steps, voxel_count};
use crate::volume::Volume;
use crate::voxel_data::open;
use crate::voxels::{Endian, ScalarType, Voxels};
use glam::DVec3;
use isoparticles_file::limit::check_memory;
use std::io::{self, Read};
use std::path::Path;

/// Number of bytes before the voxels: 7 integers of 4 bytes, and the 256 bytes of FreeSurfer's
/// `UNUSED_SPACE_SIZE`.
const HEADER_BYTES: usize = 284;

/// Number of header bytes that this module uses: 7 integers of 4 bytes, a flag of 2 bytes and 15
/// floats of 4 bytes.
const FIELD_BYTES: usize = 90;

/// Returns whether an uncompressed file that starts with these bytes has an MGH header: version 1,
/// positive sizes, a known type, all as 32-bit big-endian integers.
pub(crate) fn is_mgh(start: &[u8]) -> bool {
    start.len() >= FIELD_BYTES
        && integer(start, 0) == 1
        && (1..5).all(|n| integer(start, n) > 0)
        && (0..=10).contains(&integer(start, 5))
}

/// Returns the integer with index `n` of a header.
fn integer(header: &[u8], n: usize) -> i32 {
    header[4 * n..].first_chunk().map_or(0, |bytes| i32::from_be_bytes(*bytes))
}

/// Reads an MGH volume with one number per voxel.
pub(crate) fn read_mgh(path: &Path) -> Result<Volume> {
    let cannot = |error: io::Error| match error.kind() {
        io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput => bad(
            path,
            format!("the data does not match the header: {error}"),
            "the voxels would be incomplete",
            "copy or download the file again",
        ),
        _ => Error::file(path, "read", error, "copy or download the file again"),
    };
    let mut reader = open(path).map_err(cannot)?;
    let mut header = [0; HEADER_BYTES];
    reader.read_exact(&mut header).map_err(cannot)?;
    let scalar = scalar_type(path, integer(&header, 5))?;
    let (geometry, remarks) = geometry(path, &header)?;
    let count = geometry.voxel_count();
    check_memory(path, (count as u64).saturating_mul(scalar.bytes() as u64))?;
    let voxels = Voxels::read_from(&mut reader, scalar, Endian::Big, count).map_err(cannot)?;
    // read the acquisition parameters and tags that follow the voxels, so that the checksum of
    // compressed data is verified
    io::copy(&mut reader, &mut io::sink()).map_err(cannot)?;
    Ok(Volume { remarks, ..Volume::new(geometry, voxels) }.in_lps())
}

fn scalar_type(path: &Path, code: i32) -> Result<ScalarType> {
    Ok(match code {
        0 => ScalarType::U8,
        1 => ScalarType::I32,
        3 => ScalarType::F32,
        4 => ScalarType::I16,
        10 => ScalarType::U16,
        other => {
            let name = if other == 6 { "tensors" } else { "values" };
            return Err(bad(
                path,
                format!("contains {name} of MGH type {other}"),
                "a volume must have one number per voxel",
                "convert it with mri_convert of FreeSurfer",
            ));
        }
    })
}

/// Returns the geometry in RAS. If the header has no valid orientation, coronal slices of 1 mm
/// voxels are assumed, as in FreeSurfer, and the space is unnamed. nibabel 5.4 transposes the
/// directions of these slices.
fn geometry(path: &Path, header: &[u8; HEADER_BYTES]) -> Result<(Geometry, Vec<String>)> {
    let declared = [1, 2, 3, 4].map(|n| integer(header, n));
    let sizes = declared.map(|n| usize::try_from(n).unwrap_or(0));
    let size = [sizes[0], sizes[1], sizes[2]];
    voxel_count(path, size)?;
    if sizes[3] > 1 || size.contains(&1) {
        return Err(bad(
            path,
            format!("has {} x {} x {} voxels and {} frames", size[0], size[1], size[2], sizes[3]),
            "a volume must have one frame and at least two voxels along each axis",
            "write one frame of a 3-D volume with mri_convert of FreeSurfer",
        ));
    }
    let real = |n: usize| f64::from(header[30 + 4 * n..].first_chunk().map_or(0.0, |bytes| f32::from_be_bytes(*bytes)));
    let vector = |n: usize| DVec3::new(real(n), real(n + 1), real(n + 2));
    let is_good = header[28] < 0x80 && header[28..30] != [0, 0];
    let (spacing, axes, centre, space) = if is_good {
        (vector(0), [vector(3), vector(6), vector(9)], vector(12), Space::Ras)
    } else {
        (DVec3::ONE, [DVec3::X, DVec3::NEG_Z, DVec3::NEG_Y], DVec3::ZERO, Space::Unnamed)
    };
    let steps = [0, 1, 2].map(|axis| axes[axis] * spacing[axis]);
    // the header contains the world position of the index position `size / 2`
    let half = size.map(|n| n as f64 / 2.0);
    let origin = centre - steps[0] * half[0] - steps[1] * half[1] - steps[2] * half[2];
    let remark = "the header has no valid orientation; coronal slices of 1 mm voxels are assumed, as in FreeSurfer";
    let remarks = if is_good { Vec::new() } else { vec![remark.to_owned()] };
    Ok((geometry_from_steps(path, size, steps, origin, space)?, remarks))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read::read_volume;

    /// Creates a file of 2 x 3 x 2 short numbers with an oblique orientation.
    fn file() -> Vec<u8> {
        let mut bytes = vec![0; HEADER_BYTES];
        for (n, value) in [1, 2, 3, 2, 1, 4].into_iter().enumerate() {
            bytes[4 * n..4 * n + 4].copy_from_slice(&i32::to_be_bytes(value));
        }
        bytes[29] = 1;
        let numbers = [0.5, 1.0, 2.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 10.0, 20.0, 30.0];
        for (n, value) in numbers.into_iter().enumerate() {
            bytes[30 + 4 * n..34 + 4 * n].copy_from_slice(&f32::to_be_bytes(value));
        }
        (0..12i16).for_each(|value| bytes.extend(value.to_be_bytes()));
        bytes
    }

    fn read(bytes: &[u8]) -> Result<Volume> {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("v.dat");
        std::fs::write(&path, bytes).expect("written");
        read_volume(&path)
    }

    #[test]
    fn the_position_in_the_header_is_that_of_half_the_size() {
        let volume = read(&file()).unwrap_or_else(|error| panic!("{error}"));
        let world = |x: f64, y: f64, z: f64| volume.geometry.grid_to_world(DVec3::new(x, y, z));
        assert_eq!(world(0.5, 1.5, 2.0), DVec3::new(-10.0, -20.0, 30.0));
        assert_eq!(world(1.0, 1.5, 2.0), DVec3::new(-9.5, -20.0, 30.0));
        assert_eq!(volume.voxels, Voxels::I16((0..12).collect()));
    }

    #[test]
    fn without_an_orientation_slices_are_coronal() {
        for flag in [[0, 0], [0xff, 0xff]] {
            let mut bytes = file();
            bytes[28..30].copy_from_slice(&flag);
            let Geometry { spacing, directions, space, .. } = read(&bytes).expect("read").geometry;
            assert_eq!((spacing, space), (DVec3::ONE, Space::Unnamed));
            assert_eq!(directions.z_axis, DVec3::NEG_Y);
        }
    }

    #[test]
    fn damaged_files_are_refused() {
        let with = |at: usize, byte: u8| {
            let mut bytes = file();
            bytes[at] = byte;
            bytes
        };
        let cases = [
            (file()[..307].to_vec(), "ends after 11 of 12 values"),
            (file()[..100].to_vec(), "does not match"),
            (with(23, 6), "tensors"),
            (with(23, 2), "MGH type 2"),
            (with(19, 2), "2 frames"),
            (with(15, 1), "2 x 3 x 1"),
            (with(5, 1), "ends after 12 of 393228 values"),
            (with(30, 0xff), "spacing"),
        ];
        for (bytes, word) in cases {
            let error = read(&bytes).expect_err(word);
            assert!(error.to_string().contains(word) && !error.remedy().is_empty(), "'{word}' is not in '{error}'");
        }
    }
}
