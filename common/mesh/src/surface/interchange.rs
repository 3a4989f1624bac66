//! Writes surfaces for other programs: PLY (binary, 64-bit positions and data), STL (binary, 32-bit
//! positions by definition), OBJ (text, positions with full precision) and legacy VTK (binary, with
//! vtkio).

use super::{DataArray, Surface};
use isoparticles_file::history::History;
use isoparticles_volume::Voxels;
use isoparticles_volume::vtk_xml::ascii_json;
use std::io::{self, Write};
use vtkio::model::{Attribute, Attributes, ByteOrder, DataSet, IOBuffer, PolyDataPiece, Version, VertexNumbers, Vtk};

/// Maximum number of characters of the history in one comment line. With its prefix, a line has at
/// most 216 characters. The PLY reader RPly has buffers of 256 characters per word and 1,024 per
/// line (`WORDSIZE` and `LINESIZE` in `rply.c`).
const COMMENT_WIDTH: usize = 200;

/// Returns a line that states which program wrote a surface, and the frame and unit of its
/// positions.
fn provenance(surface: &Surface, history: &History) -> String {
    let frame = surface.space.name().unwrap_or("of the input");
    format!("isoparticles {} {}; world frame {frame}, mm", history.tool, history.version)
}

/// Returns the comment lines of a file: provenance and history.
fn comments(surface: &Surface, history: &History) -> Vec<String> {
    let mut lines = vec![provenance(surface, history)];
    // an ASCII string can be split anywhere
    let text = ascii_json(history);
    lines
        .extend(text.as_bytes().chunks(COMMENT_WIDTH).map(|part| format!("history {}", String::from_utf8_lossy(part))));
    lines
}

/// Returns the property names of an array, one per component. Underscores replace special
/// characters.
fn property_names(array: &DataArray) -> Vec<String> {
    let name: String = array.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    match array.components {
        1 => vec![name],
        3 if name.eq_ignore_ascii_case("normals") => ["nx", "ny", "nz"].map(str::to_owned).to_vec(),
        components => (0..components).map(|component| format!("{name}_{component}")).collect(),
    }
}

pub(super) fn write_ply(file: &mut dyn Write, surface: &Surface, history: &History) -> io::Result<()> {
    writeln!(file, "ply\nformat binary_little_endian 1.0")?;
    for line in comments(surface, history) {
        writeln!(file, "comment {line}")?;
    }
    let properties = |file: &mut dyn Write, arrays: &[DataArray]| -> io::Result<()> {
        arrays.iter().flat_map(property_names).try_for_each(|name| writeln!(file, "property double {name}"))
    };
    writeln!(file, "element vertex {}", surface.mesh.vertices.len())?;
    writeln!(file, "property double x\nproperty double y\nproperty double z")?;
    properties(file, &surface.point_data)?;
    writeln!(file, "element face {}\nproperty list uchar int vertex_indices", surface.mesh.triangles.len())?;
    properties(file, &surface.cell_data)?;
    writeln!(file, "end_header")?;
    let doubles = |arrays: &[DataArray]| -> Vec<(usize, Vec<f64>)> {
        arrays.iter().map(|array| (array.components, array.values.to_f64())).collect()
    };
    let write_row = |file: &mut dyn Write, arrays: &[(usize, Vec<f64>)], row: usize| -> io::Result<()> {
        for (components, values) in arrays {
            for value in &values[row * components..(row + 1) * components] {
                file.write_all(&value.to_le_bytes())?;
            }
        }
        Ok(())
    };
    let data = doubles(&surface.point_data);
    for (row, vertex) in surface.mesh.vertices.iter().enumerate() {
        for coordinate in vertex.to_array() {
            file.write_all(&coordinate.to_le_bytes())?;
        }
        write_row(file, &data, row)?;
    }
    let data = doubles(&surface.cell_data);
    for (row, triangle) in surface.mesh.triangles.iter().enumerate() {
        file.write_all(&[3])?;
        for index in triangle {
            file.write_all(&index.to_le_bytes())?;
        }
        write_row(file, &data, row)?;
    }
    Ok(())
}

pub(super) fn write_stl(file: &mut dyn Write, surface: &Surface, history: &History) -> io::Result<()> {
    // The header must not start with "solid", because that word identifies the text format.
    let mut header = [b' '; 80];
    let text = comments(surface, history).swap_remove(0);
    let length = text.len().min(80);
    header[..length].copy_from_slice(&text.as_bytes()[..length]);
    file.write_all(&header)?;
    let count = u32::try_from(surface.mesh.triangles.len())
        .map_err(|_| io::Error::other("STL holds at most 2^32 triangles"))?;
    file.write_all(&count.to_le_bytes())?;
    for triangle in 0..surface.mesh.triangles.len() {
        let [a, b, c] = surface.mesh.corners(triangle);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        for vector in [normal, a, b, c] {
            for coordinate in vector.to_array() {
                file.write_all(&(coordinate as f32).to_le_bytes())?;
            }
        }
        file.write_all(&[0; 2])?;
    }
    Ok(())
}

pub(super) fn write_obj(file: &mut dyn Write, surface: &Surface, history: &History) -> io::Result<()> {
    for line in comments(surface, history) {
        writeln!(file, "# {line}")?;
    }
    for vertex in &surface.mesh.vertices {
        // Rust prints the shortest string that parses back to the same number.
        writeln!(file, "v {:?} {:?} {:?}", vertex.x, vertex.y, vertex.z)?;
    }
    for [a, b, c] in &surface.mesh.triangles {
        writeln!(file, "f {} {} {}", u64::from(*a) + 1, u64::from(*b) + 1, u64::from(*c) + 1)?;
    }
    Ok(())
}

/// Writes a surface with its data as binary `POLYDATA`. The format cannot store the history.
pub(super) fn write_vtk(file: &mut dyn Write, surface: &Surface, history: &History) -> io::Result<()> {
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
        // the format allows up to four components; all other arrays of this project have one
        components => Attribute::scalars(name, u32::try_from(components).unwrap_or(u32::MAX)),
    };
    attribute.with_data(data)
}

/// Converts numbers to types that all programs can read. 64-bit integers are converted to 32-bit
/// integers, or to doubles if they do not fit, because the name of the 64-bit type differs between
/// versions of the format.
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
