//! A minimal NRRD writer (format: teem.sourceforge.net/nrrd/format.html). It is independent of the
//! reader under test, and supports spaces that the pipeline's own writer does not support.

use flate2::{Compression, write::GzEncoder};
use glam::DVec3;
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::Geometry;
use std::io::Write;
use std::path::Path;

/// Voxels to write.
#[derive(Clone, Debug)]
pub enum Voxels {
    /// 8-bit labels.
    U8(Vec<u8>),
    /// 16-bit scalars.
    I16(Vec<i16>),
    /// 32-bit scalars.
    F32(Vec<f32>),
}

/// World frame that the file specifies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum FileSpace {
    /// `left-posterior-superior`.
    #[value(name = "LPS")]
    Lps,
    /// `right-anterior-superior`: x and y change sign in the file.
    #[value(name = "RAS")]
    Ras,
    /// `space dimension: 3`, without an anatomical name.
    #[value(name = "none")]
    Unnamed,
}

/// Writes an NRRD file with an attached header and gzip or raw encoding. The file is written under
/// a temporary name and renamed when it is complete.
///
/// # Errors
/// If the file cannot be written.
pub fn write(path: &Path, geometry: &Geometry, space: FileSpace, voxels: &Voxels, gzip: bool) -> Result<()> {
    let (type_name, bytes): (&str, Vec<u8>) = match voxels {
        Voxels::U8(data) => ("uint8", data.clone()),
        Voxels::I16(data) => ("int16", data.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Voxels::F32(data) => ("float", data.iter().flat_map(|v| v.to_le_bytes()).collect()),
    };
    let partial = path.with_extension("nrrd.partial");
    let attempt = || -> std::io::Result<()> {
        let mut file = std::io::BufWriter::new(std::fs::File::create(&partial)?);
        file.write_all(header(geometry, space, type_name, gzip).as_bytes())?;
        if gzip {
            let mut encoder = GzEncoder::new(&mut file, Compression::fast());
            encoder.write_all(&bytes)?;
            encoder.finish()?;
        } else {
            file.write_all(&bytes)?;
        }
        file.flush()?;
        std::fs::rename(&partial, path)
    };
    attempt().map_err(|source| {
        // If the partial file does not exist, removing it fails. Only the first error is reported.
        std::fs::remove_file(&partial).ok();
        Error::file(path, "write the phantom", &source, "choose a folder that exists and can be written")
    })
}

fn header(geometry: &Geometry, space: FileSpace, type_name: &str, gzip: bool) -> String {
    let to_file = |v: DVec3| match space {
        FileSpace::Ras => DVec3::new(-v.x, -v.y, v.z),
        FileSpace::Lps | FileSpace::Unnamed => v,
    };
    // `+ 0.0` turns -0 into 0.
    let vector = |v: DVec3| format!("({},{},{})", v.x + 0.0, v.y + 0.0, v.z + 0.0);
    let space_field = match space {
        FileSpace::Lps => "space: left-posterior-superior",
        FileSpace::Ras => "space: right-anterior-superior",
        FileSpace::Unnamed => "space dimension: 3",
    };
    let axes = [geometry.directions.x_axis, geometry.directions.y_axis, geometry.directions.z_axis];
    let directions: Vec<String> =
        axes.iter().zip(geometry.spacing.to_array()).map(|(axis, step)| vector(to_file(*axis * step))).collect();
    let [nx, ny, nz] = geometry.size;
    format!(
        "NRRD0005\n# An analytic phantom of isoparticles.\ntype: {type_name}\ndimension: 3\n{space_field}\n\
         sizes: {nx} {ny} {nz}\nspace directions: {}\nkinds: domain domain domain\nendian: little\n\
         encoding: {}\nspace origin: {}\n\n",
        directions.join(" "),
        if gzip { "gzip" } else { "raw" },
        vector(to_file(geometry.origin)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ras_changes_the_sign_of_x_and_y() {
        let mut geometry = Geometry::axis_aligned([2, 3, 4], DVec3::new(1.0, 2.0, 3.0));
        geometry.origin = DVec3::new(10.0, -20.0, 30.0);
        let text = header(&geometry, FileSpace::Ras, "uint8", false);
        assert!(text.contains("space directions: (-1,0,0) (0,-2,0) (0,0,3)\n"), "{text}");
        assert!(text.contains("space origin: (-10,20,30)\n"), "{text}");
    }
}
