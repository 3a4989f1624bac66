//! NRRD ("nearly raw raster data"), the format of Teem and 3D Slicer: attached (`.nrrd`) and detached (`.nhdr`) headers.
//!
//! Follows Teem's description of the format, versions 1 to 5. Anatomical spaces are converted to LPS here, once.

mod data;
mod grid;
mod header;
mod write;

pub use write::{Encoding, write_nrrd};

use super::limit::check_memory;
use super::volume::Volume;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Reads an NRRD volume with three spatial axes and one number a voxel.
pub fn read_nrrd(path: &Path) -> Result<Volume> {
    let file = File::open(path).map_err(|error| Error::file(path, "read", &error, "check the name of the volume"))?;
    let mut reader = BufReader::new(file);
    let header = header::Header::read(path, &mut reader)?;
    let (geometry, remarks) = grid::geometry(path, &header)?;
    let count = geometry.voxel_count();
    check_memory(path, count as u64 * header.scalar.bytes() as u64)?;
    let voxels = data::read_voxels(path, &header, count, reader)?;
    Ok(Volume { remarks, ..Volume::new(geometry, voxels) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Geometry, Space};
    use crate::io::volume::Voxels;
    use glam::{DMat3, DVec3};

    #[test]
    fn what_is_written_is_read_back() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("out.nrrd");
        let turn = DMat3::from_axis_angle(DVec3::new(0.3, 0.2, 0.9).normalize(), 1.1);
        let mut geometry = Geometry::axis_aligned([2, 3, 4], DVec3::new(0.5, 0.7, 1.9));
        geometry.directions = turn * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        geometry.origin = DVec3::new(1.5, -2.25, 1e3);
        geometry.space = Space::Lps;
        for encoding in [Encoding::Raw, Encoding::Gzip] {
            let voxels = Voxels::I16((-12..12).collect());
            write_nrrd(&path, &geometry, &voxels, encoding).expect("written");
            let volume = read_nrrd(&path).expect("read");
            assert_eq!(volume.voxels, voxels);
            assert_eq!(volume.geometry.size, geometry.size);
            assert_eq!(volume.geometry.space, Space::Lps);
            assert_eq!(volume.geometry.origin, geometry.origin);
            assert!(volume.geometry.spacing.abs_diff_eq(geometry.spacing, 1e-12));
            assert!(volume.geometry.directions.abs_diff_eq(geometry.directions, 1e-12));
            assert!(volume.geometry.is_left_handed());
        }
    }
}
