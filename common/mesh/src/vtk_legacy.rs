//! Reads the points and normals of legacy VTK files (`.vtk`) with vtkio. docs/developer/formats.md
//! explains why vtkio is not used for XML files.

use glam::DVec3;
use vtkio::model::{Attribute, DataSet, IOBuffer, Piece, UnstructuredGridPiece, Vtk};

/// Points and their normals, if the file contains normals. Normals are neither normalised nor
/// checked.
pub(crate) type Points = (Vec<DVec3>, Option<Vec<DVec3>>);

/// Reads the points of a `POLYDATA` or `UNSTRUCTURED_GRID` file (text or binary), and its point
/// array `normals` or `normal` (in upper or lower case).
///
/// # Errors
/// If the file is not a legacy VTK file or has no usable points. The error describes the problem.
pub(crate) fn read_points(bytes: &[u8]) -> Result<Points, String> {
    let file = Vtk::parse_legacy_be(bytes).map_err(|error| format!("is not a legacy VTK file: {error}"))?;
    let (points, data) = match file.data {
        DataSet::PolyData { pieces, .. } => match pieces.into_iter().next() {
            Some(Piece::Inline(piece)) => (piece.points, piece.data),
            _ => return Err("contains no polygons".to_owned()),
        },
        DataSet::UnstructuredGrid { pieces, .. } => match pieces.into_iter().next() {
            Some(Piece::Inline(piece)) => {
                let UnstructuredGridPiece { points, data, .. } = *piece;
                (points, data)
            }
            _ => return Err("contains no cells".to_owned()),
        },
        _ => return Err("is neither POLYDATA nor UNSTRUCTURED_GRID".to_owned()),
    };
    let positions = vectors(&points).ok_or("has coordinates that are not numbers")?;
    let normals = data.point.iter().find_map(|attribute| normals(attribute, positions.len()));
    Ok((positions, normals))
}

fn vectors(buffer: &IOBuffer) -> Option<Vec<DVec3>> {
    let values = buffer.cast_into::<f64>()?;
    let (vectors, rest) = values.as_chunks::<3>();
    rest.is_empty().then(|| vectors.iter().copied().map(DVec3::from_array).collect())
}

fn normals(attribute: &Attribute, count: usize) -> Option<Vec<DVec3>> {
    let buffer = match attribute {
        Attribute::DataArray(array) => is_normals(&array.name).then_some(&array.data),
        Attribute::Field { data_array, .. } => {
            data_array.iter().find(|array| is_normals(&array.name)).map(|array| &array.data)
        }
    }?;
    vectors(buffer).filter(|normals| normals.len() == count)
}

/// Returns whether a point array contains normals, according to its name.
pub(crate) fn is_normals(name: &str) -> bool {
    name.eq_ignore_ascii_case("normals") || name.eq_ignore_ascii_case("normal")
}
