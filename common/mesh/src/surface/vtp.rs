//! Reads and writes VTK polygon files (`.vtp`), including all data arrays. Positions are stored
//! exactly, as 64-bit floats.

use super::{DataArray, Simplices, Surface, SurfaceFile, check_indices};
use crate::TriangleMesh;
use crate::error::bad;
use crate::error::{Error, Result};
use glam::DVec3;
use isoparticles_file::history::History;
use isoparticles_volume::vtk_xml::{Document, Element, Payload, VtkFile, ascii_json};
use isoparticles_volume::{Space, Voxels};
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;

/// Name of the file kind.
const KIND: &str = "surface";
/// Format version of the files that are written. Version 1 stored strings as VTK strings instead of
/// bytes. Both versions can be read.
const VERSION: u32 = 2;

/// Cells of one type: their section in the file, their vertex indices, and the number of vertices
/// per cell.
struct Cells<'a> {
    section: &'static str,
    indices: &'a [u32],
    size: usize,
}

pub(super) fn encode(file: &mut dyn Write, surface: &Surface, meta: &Value, history: &History) -> io::Result<()> {
    let texts = [("space", ascii_json(&surface.space)), ("meta", ascii_json(meta))];
    let cells = [Cells { section: "Polys", indices: surface.mesh.triangles.as_flattened(), size: 3 }];
    let data = (surface.point_data.as_slice(), surface.cell_data.as_slice());
    encode_poly_data(file, (KIND, &texts, history), &surface.mesh.vertices, &cells, data)
}

pub(super) fn encode_simplices(file: &mut dyn Write, simplices: &Simplices, history: &History) -> io::Result<()> {
    let cells = [
        Cells { section: "Verts", indices: &simplices.vertices, size: 1 },
        Cells { section: "Lines", indices: simplices.edges.as_flattened(), size: 2 },
        Cells { section: "Polys", indices: simplices.triangles.as_flattened(), size: 3 },
    ];
    encode_poly_data(file, ("simplices", &[], history), &simplices.points, &cells, (&[], &simplices.cell_data))
}

fn encode_poly_data(
    file: &mut dyn Write,
    (kind, texts, history): (&str, &[(&str, String)], &History),
    points: &[DVec3],
    cells: &[Cells<'_>],
    (point_data, cell_data): (&[DataArray], &[DataArray]),
) -> io::Result<()> {
    let mut document = Document::new("PolyData");
    document.open("PolyData", &[]);
    document.identity(kind, VERSION, texts, Some(history));
    let mut attributes = vec![("NumberOfPoints", points.len().to_string())];
    let number = |section: &str| {
        let cells = cells.iter().find(|cells| cells.section == section);
        cells.map_or(0, |cells| cells.indices.len() / cells.size).to_string()
    };
    for (name, section) in [
        ("NumberOfVerts", "Verts"),
        ("NumberOfLines", "Lines"),
        ("NumberOfStrips", "Strips"),
        ("NumberOfPolys", "Polys"),
    ] {
        attributes.push((name, number(section)));
    }
    document.open("Piece", &attributes);
    for (section, arrays) in [("PointData", point_data), ("CellData", cell_data)] {
        document.open(section, &[]);
        for array in arrays {
            document.array(&array.name, array.components, Payload::Values(array.values.clone()));
        }
        document.close();
    }
    document.open("Points", &[]);
    let positions = points.iter().flat_map(|point| point.to_array()).collect();
    document.array("Points", 3, Payload::Values(Voxels::F64(positions)));
    document.close();
    for cells in cells {
        document.open(cells.section, &[]);
        let connectivity = cells.indices.iter().map(|&index| i64::from(index)).collect();
        document.array("connectivity", 1, Payload::Values(Voxels::I64(connectivity)));
        let ends = (1..=cells.indices.len() / cells.size).map(|cell| (cell * cells.size) as i64).collect();
        document.array("offsets", 1, Payload::Values(Voxels::I64(ends)));
        document.close();
    }
    document.write(file)
}

/// Reads a `.vtp` surface of triangles.
pub fn read_surface(path: &Path) -> Result<SurfaceFile> {
    let file = VtkFile::open(path)?;
    let data_set = file.data_set("PolyData")?;
    let piece = file.piece("PolyData")?;
    let found = file.text(data_set, "isoparticles_kind")?;
    if let Some(found) = found.filter(|found| found != KIND) {
        return Err(unusable(path, &format!("is a {found} file")));
    }
    let count = |name: &str| piece.attribute(name).and_then(|text| text.parse::<usize>().ok()).unwrap_or(0);
    let (points, polygons) = (count("NumberOfPoints"), count("NumberOfPolys"));
    if ["NumberOfVerts", "NumberOfLines", "NumberOfStrips"].iter().any(|name| count(name) > 0) {
        return Err(unusable(path, "contains cells other than polygons"));
    }
    let section = |name: &str, array: &str| {
        let section = piece.child(name);
        let array = if array.is_empty() {
            section.and_then(|section| section.children.first())
        } else {
            section.and_then(|section| section.array(array))
        };
        array.ok_or_else(|| unusable(path, &format!("has no {name}")))
    };
    let values = points.checked_mul(3).ok_or_else(|| unusable(path, "declares too many points"))?;
    let positions = file.numbers(section("Points", "")?, values)?.to_f64();
    let (groups, _) = positions.as_chunks::<3>();
    let vertices: Vec<DVec3> = groups.iter().map(|&group| DVec3::from_array(group)).collect();
    let triangles = if polygons == 0 { Vec::new() } else { triangles(path, &file, &section, polygons)? };
    check_indices(path, triangles.as_flattened(), vertices.len())?;
    let arrays = |name: &str, tuples: usize| read_arrays(&file, piece.child(name), tuples);
    let surface = Surface {
        point_data: arrays("PointData", points)?,
        cell_data: arrays("CellData", triangles.len())?,
        mesh: TriangleMesh { vertices, triangles },
        space: file
            .text(data_set, "space")?
            .and_then(|text| serde_json::from_str(&text).ok())
            .unwrap_or(Space::Unnamed),
    };
    let meta = file.text(data_set, "meta")?.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or(Value::Null);
    let history = file.text(data_set, "history")?.and_then(|text| serde_json::from_str(&text).ok());
    Ok(SurfaceFile { surface, meta, history })
}

/// Returns the polygons of a piece, or an error unless all polygons are triangles.
fn triangles<'a>(
    path: &Path,
    file: &VtkFile,
    section: &impl Fn(&str, &str) -> Result<&'a Element>,
    count: usize,
) -> Result<Vec<[u32; 3]>> {
    let ends = whole(file.numbers(section("Polys", "offsets")?, count)?);
    if ends.iter().enumerate().any(|(cell, &end)| end != Some(3 * (cell as u32 + 1))) {
        return Err(unusable(path, "has polygons that are not triangles"));
    }
    let indices = whole(file.numbers(section("Polys", "connectivity")?, 3 * count)?);
    let indices: Vec<u32> =
        indices.into_iter().collect::<Option<_>>().ok_or_else(|| unusable(path, "has negative indices"))?;
    Ok(indices.as_chunks::<3>().0.to_vec())
}

/// Converts values to integers from 0 to `u32::MAX`. Any other value becomes `None`.
fn whole(values: Voxels) -> Vec<Option<u32>> {
    values
        .to_f64()
        .into_iter()
        .map(|x| (x >= 0.0 && x.fract() == 0.0 && x <= f64::from(u32::MAX)).then_some(x as u32))
        .collect()
}

fn read_arrays(file: &VtkFile, section: Option<&Element>, tuples: usize) -> Result<Vec<DataArray>> {
    let arrays = section.map_or(&[][..], |section| &section.children);
    arrays
        .iter()
        .map(|array| {
            let components = VtkFile::components(array);
            let values = file.numbers(array, components.saturating_mul(tuples))?;
            Ok(DataArray { name: array.attribute("Name").unwrap_or("").to_owned(), components, values })
        })
        .collect()
}

fn unusable(path: &Path, what: &str) -> Error {
    bad(path, what, "a surface of triangles is needed", "write the triangles to a .vtp file again")
}
