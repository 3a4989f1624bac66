//! Legacy VTK files (`.vtk`), read and written with vtkio. Writes surfaces for programs that
//! support no other VTK format, and reads points from files of such programs.
//!
//! docs/developer/formats.md lists the tasks for which vtkio is not used.

use crate::point_cloud::is_normals;
use crate::surface::{DataArray, Surface, provenance};
use glam::DVec3;
use isoparticles_file::history::History;
use isoparticles_volume::Voxels;
use std::io::{self, Write};
use vtkio::model::{
    Attribute, Attributes, ByteOrder, DataSet, IOBuffer, Piece, PolyDataPiece, UnstructuredGridPiece, Version,
    VertexNumbers, Vtk,
};

/// Points and their normals, if the file contains normals. Normals are neither normalised nor
/// checked.
pub(crate) type Points = (Vec<DVec3>, Option<Vec<DVec3>>);

/// Reads the points of `POLYDATA` or `UNSTRUCTURED_GRID`, and the point data `Normals` or `normal`.
/// The file may be text or binary.
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

/// Writes a surface as binary `POLYDATA` with its data. The format cannot store the history.
pub(crate) fn write(file: &mut dyn Write, surface: &Surface, history: &History) -> io::Result<()> {
    let triangles = &surface.mesh.triangles;
    let piece = PolyDataPiece {
        points: IOBuffer::F64(surface.mesh.vertices.iter().flat_map(|vertex| vertex.to_array()).collect()),
        polys: Some(VertexNumbers::Legacy {
            num_cells: u32::try_from(triangles.len()).map_err(io::Error::other)?,
            vertices: triangles.iter().flat_map(|&[a, b, c]| [3, a, b, c]).collect(),
        }),
        data: Attributes {
            point: surface.point_data.iter().map(attribute).collect(),
            cell: surface.cell_data.iter().map(attribute).collect(),
        },
        ..PolyDataPiece::default()
    };
    let file_of_vtk = Vtk {
        version: Version::new_legacy(3, 0),
        title: provenance(surface, history),
        byte_order: ByteOrder::BigEndian,
        data: DataSet::inline(piece),
        file_path: None,
    };
    file_of_vtk.write_legacy(file).map_err(io::Error::other)
}

fn attribute(array: &DataArray) -> Attribute {
    let name: String = array.name.chars().map(|c| if c.is_ascii_graphic() { c } else { '_' }).collect();
    let data = buffer(&array.values);
    let attribute = match array.components {
        3 if name.eq_ignore_ascii_case("normals") => Attribute::normals(name),
        3 => Attribute::vectors(name),
        // the format allows up to four components; arrays of this project have one
        components => Attribute::scalars(name, u32::try_from(components).unwrap_or(u32::MAX)),
    };
    attribute.with_data(data)
}

/// Converts numbers to types that all programs can read. The name of the 64-bit integer type
/// differs between versions of the format. 64-bit integers are therefore converted to 32-bit
/// integers, or to doubles if they do not fit.
fn buffer(values: &Voxels) -> IOBuffer {
    match values {
        Voxels::F32(values) => IOBuffer::F32(values.clone()),
        Voxels::U8(values) => IOBuffer::U8(values.clone()),
        Voxels::I32(values) => IOBuffer::I32(values.clone()),
        Voxels::I64(values) => match values.iter().map(|&value| i32::try_from(value)).collect() {
            Ok(values) => IOBuffer::I32(values),
            Err(_) => IOBuffer::F64(values.iter().map(|&value| value as f64).collect()),
        },
        other => IOBuffer::F64(other.to_f64()),
    }
}
