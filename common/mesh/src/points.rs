//! Reads points, with one value per point, from VTK polygon (`.vtp`) and unstructured (`.vtu`)
//! files. Cells are ignored.

use crate::error::bad;
use crate::error::{Error, Result};
use glam::DVec3;
use isoparticles_volume::Space;
use isoparticles_volume::vtk_xml::{Element, VtkFile};
use std::path::Path;

/// Reads the points and the values of the point array `name`, and the world frame of the points.
/// All values must be finite and positive.
///
/// # Errors
/// If the file cannot be read or has the wrong type, or if the array is missing or has invalid
/// values.
pub fn read_sized_points(path: &Path, name: &str) -> Result<(Vec<(DVec3, f64)>, Space)> {
    let file = VtkFile::open(path)?;
    let is_unstructured = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("vtu"));
    let kind = if is_unstructured { "UnstructuredGrid" } else { "PolyData" };
    let piece = file.piece(kind)?;
    let space = file.text(file.data_set(kind)?, "space")?.and_then(|text| serde_json::from_str(&text).ok());
    let unusable = |what: &str| {
        bad(
            path,
            what,
            format!("points with an array '{name}' of positive numbers are needed"),
            format!("use a .vtp or .vtu file with '{name}' in its point data"),
        )
    };
    let positions = positions(&file, piece, unusable)?;
    let array = piece.child("PointData").and_then(|arrays| arrays.array(name));
    let array = array.filter(|array| VtkFile::components(array) == 1);
    let array = array.ok_or_else(|| unusable(&format!("has no point array '{name}' with one component")))?;
    let sizes = file.numbers(array, positions.len())?.to_f64();
    let points: Vec<(DVec3, f64)> = positions.into_iter().zip(sizes).collect();
    let is_usable = |&(p, size): &(DVec3, f64)| p.is_finite() && size.is_finite() && size > 0.0;
    match points.iter().position(|point| !is_usable(point)) {
        Some(n) => Err(unusable(&format!("has an invalid point: {} with '{name}' {}", points[n].0, points[n].1))),
        None => Ok((points, space.unwrap_or(Space::Unnamed))),
    }
}

/// Returns the point positions of a piece, which must not be empty. `unusable` creates an error
/// from a description of the problem.
pub(crate) fn positions(file: &VtkFile, piece: &Element, unusable: impl Fn(&str) -> Error) -> Result<Vec<DVec3>> {
    let count = piece.attribute("NumberOfPoints").and_then(|text| text.parse::<usize>().ok());
    let count = count.filter(|&count| count > 0).ok_or_else(|| unusable("has no points"))?;
    let values = count.checked_mul(3).ok_or_else(|| unusable("declares too many points"))?;
    let section = piece.child("Points").and_then(|section| section.children.first());
    let numbers = file.numbers(section.ok_or_else(|| unusable("has no Points"))?, values)?.to_f64();
    Ok(numbers.as_chunks::<3>().0.iter().map(|&p| DVec3::from_array(p)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(body: &str) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("points.vtp");
        let text = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" \
             header_type=\"UInt64\">\n<PolyData><Piece NumberOfPoints=\"2\" NumberOfVerts=\"0\" NumberOfLines=\"0\" \
             NumberOfStrips=\"0\" NumberOfPolys=\"0\">{body}<Points><DataArray type=\"Float32\" Name=\"Points\" \
             NumberOfComponents=\"3\" format=\"ascii\">1 2 3 4 5 6.5</DataArray></Points></Piece></PolyData></VTKFile>\n"
        );
        std::fs::write(&path, text).expect("written");
        (folder, path)
    }

    fn array(name: &str, values: &str) -> String {
        format!(
            "<PointData><DataArray type=\"Float64\" Name=\"{name}\" format=\"ascii\">{values}</DataArray></PointData>"
        )
    }

    #[test]
    fn points_and_their_sizes_are_read_or_refused() {
        let (_folder, path) = file(&array("h", "0.5 0.25"));
        let (points, space) = read_sized_points(&path, "h").expect("points");
        assert_eq!(space, Space::Unnamed);
        assert_eq!(points, [(DVec3::new(1.0, 2.0, 3.0), 0.5), (DVec3::new(4.0, 5.0, 6.5), 0.25)]);
        for (body, says) in [
            (String::new(), "no point array 'h'"),
            (array("size", "0.5 0.25"), "no point array 'h'"),
            (array("h", "0.5 0"), "invalid point"),
            (array("h", "0.5 nan"), "invalid point"),
        ] {
            let (_folder, path) = file(&body);
            let error = read_sized_points(&path, "h").expect_err(says);
            assert!(error.to_string().contains(says), "{error}");
        }
    }
}
