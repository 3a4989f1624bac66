//! Writes NRRD volumes with attached headers.

use crate::error::Result;
use crate::geometry::{Geometry, Space};
use crate::voxels::{Endian, Voxels};
use isoparticles_file::output::write_atomically;
use std::path::Path;

/// Encoding of the voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// Uncompressed, little-endian.
    Raw,
    /// Little-endian, compressed with gzip.
    #[default]
    Gzip,
}

/// Writes a volume to an NRRD file with an attached header. `voxels` must contain one value per
/// voxel of `geometry`.
pub fn write_nrrd(path: &Path, geometry: &Geometry, voxels: &Voxels, encoding: Encoding) -> Result<()> {
    let header = header(geometry, voxels, encoding);
    Ok(write_atomically(path, |mut file| {
        file.write_all(header.as_bytes())?;
        match encoding {
            Encoding::Raw => voxels.write_to(file, Endian::Little),
            Encoding::Gzip => {
                let mut encoder = flate2::write::GzEncoder::new(&mut file, flate2::Compression::default());
                voxels.write_to(&mut encoder, Endian::Little)?;
                encoder.finish().map(drop)
            }
        }
    })?)
}

fn header(geometry: &Geometry, voxels: &Voxels, encoding: Encoding) -> String {
    let [nx, ny, nz] = geometry.size;
    let vector = |v: glam::DVec3| format!("({},{},{})", v.x, v.y, v.z);
    let step = |axis: usize| vector(geometry.directions.col(axis) * geometry.spacing[axis]);
    let kind = match voxels.type_name() {
        "float32" => "float",
        "float64" => "double",
        other => other,
    };
    let space = match geometry.space {
        Space::Lps => "space: left-posterior-superior",
        Space::Ras => "space: right-anterior-superior",
        Space::Unnamed => "space dimension: 3",
    };
    let encoding = match encoding {
        Encoding::Raw => "raw",
        Encoding::Gzip => "gzip",
    };
    format!(
        "NRRD0004\ntype: {kind}\ndimension: 3\n{space}\nsizes: {nx} {ny} {nz}\nspace directions: {} {} {}\n\
         kinds: domain domain domain\nendian: little\nencoding: {encoding}\nspace origin: {}\n\n",
        step(0),
        step(1),
        step(2),
        vector(geometry.origin),
    )
}
