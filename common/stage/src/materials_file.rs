//! Reads and writes the VTK image files in which stages exchange the indicators of several
//! materials.
//!
//! The point data, for ParaView and pyvista, contains the material of each node and an estimate of
//! its distance from the nearest interface. The field data contains a table of the materials, and
//! the material that fills each brick. It also contains the bricks and coefficients of the
//! indicators, concatenated in the order of the table. The format preserves indicators bit for bit.

use crate::error::{Error, Result};
use crate::output::write_atomically;
use isoparticles_field::materials::{Bound, Indicator, IndicatorParts, Material, Materials};
use isoparticles_file::history::History;
use isoparticles_volume::vtk_xml::{Document, Element, Payload, VtkFile, ascii_json};
use isoparticles_volume::{Voxels, vti};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;

/// Name of the file kind.
pub const KIND: &str = "materials";

/// Version of the file layout.
const VERSION: u32 = 1;

/// Version of files with planes at which the materials end. Readers of version 1 refuse it; they
/// would ignore the planes and continue the materials beyond them.
const VERSION_WITH_BOUNDS: u32 = 2;

/// Name of the JSON text with these planes.
const BOUNDS: &str = "bounds";

/// The point data, for display. The x index varies fastest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shown {
    /// Material number of each node.
    pub material: Vec<u16>,
    /// Half the difference between the two smallest indicators at each node, in mm.
    pub interface_distance: Vec<f32>,
}

/// The contents of a materials file.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialsFile {
    /// The indicators, with names and labels.
    pub materials: Materials,
    /// The point data for display. Empty if [`read_materials`] read the file.
    pub shown: Shown,
    /// Metadata of the stage that wrote the file.
    pub meta: Value,
    /// The history, if the file contains one.
    pub history: Option<History>,
}

/// A material in the table of the file.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Row {
    #[serde(flatten)]
    material: Material,
    /// First node of the box of the material.
    first: [usize; 3],
    /// Number of nodes of the box along each axis.
    size: [usize; 3],
    /// True if the material contains everything outside the box.
    surrounds: bool,
    /// Number of bricks of this material.
    bricks: usize,
    /// Number of coefficients of this material.
    coefficients: usize,
}

impl MaterialsFile {
    /// Writes the materials to a file.
    ///
    /// # Errors
    /// If the file cannot be written.
    ///
    /// # Panics
    /// If the point data for display does not have one value per node.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_atomically(path, |file| self.encode(file))
    }

    /// Writes the bytes of the file.
    ///
    /// # Errors
    /// If `file` returns an error.
    ///
    /// # Panics
    /// If the point data for display does not have one value per node.
    pub fn encode(&self, file: &mut dyn Write) -> io::Result<()> {
        let (materials, shown) = (&self.materials, &self.shown);
        let geometry = materials.geometry();
        let lengths = [shown.material.len(), shown.interface_distance.len()];
        assert_eq!(lengths, [geometry.voxel_count(); 2], "one number a node");
        let rows: Vec<Row> = materials
            .table()
            .iter()
            .zip(materials.indicators())
            .map(|(material, own)| {
                let (first, size) = own.extent();
                let (bricks, coefficients) = (own.bricks().len(), own.coefficients().len());
                Row { material: material.clone(), first, size, surrounds: own.surrounds(), bricks, coefficients }
            })
            .collect();
        let mut texts = vec![
            ("geometry", ascii_json(geometry)),
            ("meta", ascii_json(&self.meta)),
            ("materials", ascii_json(&rows)),
        ];
        let bounds = materials.bounds();
        if !bounds.is_empty() {
            texts.push((BOUNDS, ascii_json(&bounds)));
        }
        let indicators = materials.indicators();
        let bricks = indicators.iter().flat_map(|own| own.bricks().iter().copied()).collect();
        let arrays = vec![
            ("brick_fill", Payload::Values(Voxels::U16(materials.fill().to_vec()))),
            ("indicator_bricks", Payload::Values(Voxels::U32(bricks))),
            ("indicator_coefficients", Payload::F32Pieces(indicators.iter().map(Indicator::coefficients).collect())),
        ];
        let numbers = if rows.len() <= usize::from(u8::MAX) + 1 {
            Voxels::U8(shown.material.iter().map(|&number| number as u8).collect())
        } else {
            Voxels::U16(shown.material.clone())
        };
        let mut document = Document::new("ImageData");
        vti::open_image(&mut document, geometry);
        let version = if bounds.is_empty() { VERSION } else { VERSION_WITH_BOUNDS };
        document.identity_with(KIND, version, &texts, arrays, self.history.as_ref());
        document.open("Piece", &[("Extent", vti::piece_extent(geometry))]);
        document.open("PointData", &[("Scalars", "material".to_owned())]);
        document.array("material", 1, Payload::Values(numbers));
        document.array("interface_distance", 1, Payload::F32(&shown.interface_distance));
        document.write(file)
    }
}

/// Returns the kind that a VTK image file states, such as `distfield` or `materials`. Returns
/// `None` if it states none.
///
/// # Errors
/// If the file cannot be read as a VTK image.
pub fn kind_of(path: &Path) -> Result<Option<String>> {
    let file = VtkFile::open(path)?;
    Ok(file.text(file.data_set("ImageData")?, "isoparticles_kind")?)
}

/// Returns whether a file contains the indicators of several materials. Returns false if the file
/// cannot be read as a VTK image.
pub fn is_materials(path: &Path) -> bool {
    kind_of(path).is_ok_and(|kind| kind.as_deref() == Some(KIND))
}

/// Reads materials. The point data for display is ignored.
///
/// # Errors
/// If the file has the wrong kind or version, is damaged, or does not fit in memory.
pub fn read_materials(path: &Path) -> Result<MaterialsFile> {
    decode(path, &VtkFile::open(path)?)
}

/// Reads materials like [`read_materials`], and the point data for display.
///
/// # Errors
/// If the file has the wrong kind or version, is damaged, or does not fit in memory.
pub fn read_materials_with_shown(path: &Path) -> Result<MaterialsFile> {
    let file = VtkFile::open(path)?;
    let mut read = decode(path, &file)?;
    let nodes = read.materials.geometry().voxel_count();
    let points = file.piece("ImageData")?.child("PointData");
    let values = |name: &str| -> Result<Voxels> {
        let array = points.and_then(|arrays| arrays.array(name));
        Ok(file.numbers(array.ok_or_else(|| damaged(path, &format!("has no point array '{name}'")))?, nodes)?)
    };
    read.shown = Shown {
        material: match values("material")? {
            Voxels::U8(numbers) => numbers.into_iter().map(u16::from).collect(),
            Voxels::U16(numbers) => numbers,
            _ => return Err(damaged(path, "the array 'material' has the wrong type")),
        },
        interface_distance: match values("interface_distance")? {
            Voxels::F32(distances) => distances,
            _ => return Err(damaged(path, "the array 'interface_distance' has the wrong type")),
        },
    };
    Ok(read)
}

fn decode(path: &Path, file: &VtkFile) -> Result<MaterialsFile> {
    let image = file.data_set("ImageData")?;
    let found = file.text(image, "isoparticles_kind")?;
    if found.as_deref() != Some(KIND) {
        let what = found.map_or("is not a file of this program".to_owned(), |found| format!("is a {found} file"));
        return Err(Error::of_file(
            path,
            what,
            "this stage needs the indicators of many materials",
            "use the file that distfield writes with MATERIALS (--material)",
        ));
    }
    let array = |name: &str| -> Result<&Element> {
        let array = image.child("FieldData").and_then(|field| field.array(name));
        array.ok_or_else(|| damaged(path, &format!("has no array '{name}' in its field data")))
    };
    let version = file.all_numbers(array("isoparticles_format")?)?.to_f64();
    if ![VERSION, VERSION_WITH_BOUNDS].iter().any(|&known| version == [f64::from(known)]) {
        return Err(Error::of_file(
            path,
            format!("has format version {version:?}; this program reads versions {VERSION} and {VERSION_WITH_BOUNDS}"),
            "other versions store the data differently",
            "run distfield again",
        ));
    }
    let geometry = vti::geometry(path, file)?;
    let table = file.text(image, "materials")?.unwrap_or_default();
    let rows: Vec<Row> = serde_json::from_str(&table)
        .map_err(|error| damaged(path, &format!("its table of materials cannot be read: {error}")))?;
    let wrong_type = |name: &str| damaged(path, &format!("the array '{name}' has the wrong type"));
    let Voxels::U16(fill) = file.all_numbers(array("brick_fill")?)? else { return Err(wrong_type("brick_fill")) };
    let Voxels::U32(bricks) = file.all_numbers(array("indicator_bricks")?)? else {
        return Err(wrong_type("indicator_bricks"));
    };
    let Voxels::F32(coefficients) = file.all_numbers(array("indicator_coefficients")?)? else {
        return Err(wrong_type("indicator_coefficients"));
    };
    let bounds: Vec<Bound> = match file.text(image, BOUNDS)? {
        Some(text) => serde_json::from_str(&text)
            .map_err(|error| damaged(path, &format!("its planes cannot be read: {error}")))?,
        None => Vec::new(),
    };
    let materials = materials_of(path, rows, (&bricks, &coefficients), geometry.size)?;
    let materials = Materials::from_parts(geometry, materials, fill)
        .map_err(|error| damaged(path, &format!("its indicators are inconsistent: {error}")))?
        .with_bounds(bounds);
    let meta = file.text(image, "meta")?.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or(Value::Null);
    let history = file.text(image, "history")?.and_then(|text| serde_json::from_str(&text).ok());
    Ok(MaterialsFile { materials, shown: Shown::default(), meta, history })
}

/// Builds the indicators of all materials from the rows of the table and the concatenated bricks
/// and coefficients.
fn materials_of(
    path: &Path,
    rows: Vec<Row>,
    (mut bricks, mut coefficients): (&[u32], &[f32]),
    grid: [usize; 3],
) -> Result<Vec<(Material, Indicator)>> {
    let mut materials = Vec::with_capacity(rows.len());
    for row in rows {
        let short = || damaged(path, &format!("has too few bricks or coefficients for '{}'", row.material.name));
        let (own_bricks, more_bricks) = bricks.split_at_checked(row.bricks).ok_or_else(short)?;
        let (own, more) = coefficients.split_at_checked(row.coefficients).ok_or_else(short)?;
        (bricks, coefficients) = (more_bricks, more);
        let parts = IndicatorParts {
            first: row.first,
            size: row.size,
            surrounds: row.surrounds,
            bricks: own_bricks.to_vec(),
            coefficients: own.to_vec(),
        };
        let indicator = Indicator::from_parts(parts, grid)
            .map_err(|error| damaged(path, &format!("the indicator of '{}' is damaged: {error}", row.material.name)))?;
        materials.push((row.material, indicator));
    }
    if bricks.is_empty() && coefficients.is_empty() {
        return Ok(materials);
    }
    Err(damaged(path, "has more bricks or coefficients than its materials"))
}

fn damaged(path: &Path, what: &str) -> Error {
    Error::of_file(path, what, "the file is damaged or was written by another program", "run distfield again")
}
