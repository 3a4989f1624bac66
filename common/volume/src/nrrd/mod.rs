//! Reads NRRD ("nearly raw raster data"), the format of Teem and 3D Slicer, with attached (`.nrrd`)
//! or detached (`.nhdr`) headers. Writes NRRD with attached headers.
//!
//! Supports versions 1 to 5 of Teem's format specification. Coordinates in anatomical spaces are
//! converted to LPS.

mod grid;
mod header;
mod segments;
mod write;

pub use write::{Encoding, write_nrrd};

use crate::error::bad;
use crate::error::{Error, Result};
use crate::volume::Volume;
use crate::voxel_data::{DataFiles, read_voxels};
use isoparticles_file::limit::check_memory;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Reads an NRRD volume that has three spatial axes and one number per voxel, or a 3D Slicer
/// segmentation with all its layers.
pub fn read_nrrd(path: &Path) -> Result<Volume> {
    let file = File::open(path).map_err(|error| Error::file(path, "read", error, "check the name of the volume"))?;
    let mut reader = BufReader::new(file);
    let header = header::Header::read(path, &mut reader)?;
    let is_segmentation = segments::is_segmentation(&header);
    let grid::Grid { geometry, mut remarks, layer_axis } = grid::grid(path, &header, is_segmentation)?;
    let layers = layer_axis.map_or(1, |axis| header.sizes[axis]);
    let segments = segments::segments(path, &header, layers)?;
    let voxels = geometry.voxel_count();
    let count = voxels.checked_mul(layers).filter(|&count| count > 0);
    let count = count.ok_or_else(|| {
        bad(
            path,
            format!("its header declares {layers} layers"),
            "this is more than a computer can address",
            "write the file again; its header is damaged",
        )
    })?;
    // separating the layers requires a second copy of the voxels
    let copies = if layers > 1 { 2 } else { 1 };
    check_memory(path, (count as u64).saturating_mul(copies * header.layout.scalar.bytes() as u64))?;
    let all = read_voxels(path, &header.layout, count, reader, &mut remarks)?;
    let Some(axis) = layer_axis else {
        return Ok(Volume { remarks, segments, ..Volume::new(geometry, all) }.in_lps());
    };
    let mut more_layers = all.part(header.sizes[..axis].iter().product(), layers);
    let first = more_layers.remove(0);
    Ok(Volume { remarks, segments, more_layers, ..Volume::new(geometry, first) }.in_lps())
}

/// Returns the data files that the header specifies.
pub(crate) fn data_files(path: &Path, reader: &mut impl BufRead) -> Result<DataFiles> {
    Ok(header::Header::read(path, reader)?.layout.files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Geometry, Space};
    use crate::voxels::Voxels;
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
