//! Reads and writes the fields that stages exchange as VTK image files: signed distance and target
//! edge length.
//!
//! The attributes Origin, Spacing and Direction place the grid in the world, for ParaView and
//! pyvista. The field data contains the exact geometry, the metadata of the stage, and the history.
//! Files that were edited and saved in pyvista can be read even if this field data is incomplete.

use crate::error::{Error, Result};
use crate::materials_file;
use crate::output::write_atomically;
use isoparticles_file::history::History;
use isoparticles_volume::vtk_xml::{Document, Payload, VtkFile, ascii_json};
use isoparticles_volume::{Geometry, Image, Space, vti};
use rayon::prelude::*;
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

/// Format version of the files that are written. Version 1 stored strings as VTK strings instead of
/// bytes.
const VERSION: u32 = 2;
/// Versions that can be read.
const READ_VERSIONS: [u32; 2] = [1, VERSION];

/// The type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldKind {
    /// Signed distance to the surface in mm, negative inside; written by `distfield`.
    Distance,
    /// Target edge length h in mm; written by `sizefield`.
    Sizing,
}

impl FieldKind {
    /// Returns the name of the file kind, which is the name of the stage that writes it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Distance => "distfield",
            Self::Sizing => "sizefield",
        }
    }

    /// Returns the name of the point array.
    pub fn array_name(self) -> &'static str {
        match self {
            Self::Distance => "signed_distance",
            Self::Sizing => "sizing",
        }
    }
}

/// The contents of a field file. All values must be finite. Clones share the image.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Values and geometry.
    pub image: Arc<Image<f32>>,
    /// Metadata of the stage that wrote the file; null if another program wrote it.
    pub meta: Value,
    /// The history, if the file contains one.
    pub history: Option<History>,
    /// The type of the field.
    pub kind: FieldKind,
}

impl Field {
    /// Returns the field with its grid in another anatomical frame ([`Geometry::in_space`]).
    #[must_use]
    pub fn in_space(mut self, space: Space) -> Self {
        let geometry = self.image.geometry.clone().in_space(space);
        // an image that other fields share is copied only if it changes
        if geometry != self.image.geometry {
            Arc::make_mut(&mut self.image).geometry = geometry;
        }
        self
    }

    /// Writes the field to a file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_atomically(path, |file| self.encode(file))
    }

    /// Writes the bytes of the file.
    ///
    /// # Errors
    /// If `file` returns an error.
    pub fn encode(&self, file: &mut dyn Write) -> io::Result<()> {
        let (name, geometry) = (self.kind.array_name(), &self.image.geometry);
        let mut document = Document::new("ImageData");
        vti::open_image(&mut document, geometry);
        let texts = [("geometry", ascii_json(geometry)), ("meta", ascii_json(&self.meta))];
        document.identity(self.kind.name(), VERSION, &texts, self.history.as_ref());
        document.open("Piece", &[("Extent", vti::piece_extent(geometry))]);
        document.open("PointData", &[("Scalars", name.to_owned())]);
        document.array(name, 1, Payload::F32(&self.image.data));
        document.write(file)
    }
}

/// Reads a field. Returns an error if the file is not of the expected kind, has an unknown version
/// or contains invalid values.
pub fn read_field(path: &Path, expected: FieldKind) -> Result<Field> {
    let file = VtkFile::open(path)?;
    let image = file.data_set("ImageData")?;
    let found = file.text(image, "isoparticles_kind")?;
    if found.as_deref() == Some(materials_file::KIND) {
        return Err(not_one_object(path, expected));
    }
    if let Some(found) = found.filter(|found| found != expected.name()) {
        return Err(wrong_kind(path, expected, &format!("is a {found} file")));
    }
    if let Some(array) = image.child("FieldData").and_then(|field| field.array("isoparticles_format")) {
        let version = file.all_numbers(array)?.to_f64();
        if !matches!(version[..], [version] if READ_VERSIONS.map(f64::from).contains(&version)) {
            return Err(Error::of_file(
                path,
                format!("has format version {version:?}; this program reads versions {READ_VERSIONS:?}"),
                "other versions store the data differently",
                format!("run {} again", expected.name()),
            ));
        }
    }
    let geometry = vti::geometry(path, &file)?;
    let array = file.piece("ImageData")?.child("PointData").and_then(|arrays| arrays.array(expected.array_name()));
    let array = array
        .ok_or_else(|| wrong_kind(path, expected, &format!("has no point array named '{}'", expected.array_name())))?;
    if VtkFile::components(array) != 1 {
        return Err(wrong_kind(path, expected, "has more than one value per voxel"));
    }
    let data = match file.numbers(array, geometry.voxel_count())? {
        isoparticles_volume::Voxels::F32(data) => data,
        other => other.to_f32(),
    };
    check_values(path, expected, &data)?;
    let meta = file.text(image, "meta")?.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or(Value::Null);
    let history = file.text(image, "history")?.and_then(|text| serde_json::from_str(&text).ok());
    Ok(Field { image: Arc::new(Image { geometry, data }), meta, history, kind: expected })
}

/// Returns an error unless two fields have the same grid. Tolerates rounding in files saved by
/// other programs.
pub fn check_same_grid(first: (&Path, &Geometry), second: (&Path, &Geometry)) -> Result<()> {
    if vti::same_grid(first.1, second.1) {
        return Ok(());
    }
    Err(Error::input(
        format!(
            "{} and {} are not on the same grid (sizes {:?} and {:?}, spacings {} and {}, origins {} and {})",
            first.0.display(),
            second.0.display(),
            first.1.size,
            second.1.size,
            first.1.spacing,
            second.1.spacing,
            first.1.origin,
            second.1.origin,
        ),
        "their voxels cannot be matched",
        "use files made from the same distance field",
    ))
}

/// Creates the error for a stage that needs a single object but was given several materials.
fn not_one_object(path: &Path, expected: FieldKind) -> Error {
    Error::of_file(
        path,
        "contains the indicators of many materials",
        format!("this stage needs the field '{}' of one object", expected.array_name()),
        "use the field of one object: LABELS=A,B (distfield --labels A,B) joins labels to one object",
    )
}

fn wrong_kind(path: &Path, expected: FieldKind, what: &str) -> Error {
    Error::of_file(
        path,
        what,
        format!("this stage needs the {} field that {} writes", expected.array_name(), expected.name()),
        format!("use that file, or run {} to make it", expected.name()),
    )
}

/// Returns an error unless all distances are finite, or all edge lengths are finite and positive.
fn check_values(path: &Path, kind: FieldKind, data: &[f32]) -> Result<()> {
    let is_bad = |value: &&f32| !value.is_finite() || (kind == FieldKind::Sizing && **value <= 0.0);
    let count: usize = data.par_chunks(1 << 16).map(|part| part.iter().filter(is_bad).count()).sum();
    if count == 0 {
        return Ok(());
    }
    let first = data.iter().find(is_bad).unwrap_or(&f32::NAN);
    let why = match kind {
        FieldKind::Distance => "distances must be finite",
        FieldKind::Sizing => "target edge lengths must be finite and greater than zero",
    };
    Err(Error::of_file(
        path,
        format!("{count} values of '{}' are invalid, such as {first}", kind.array_name()),
        why,
        format!("correct them, or run {} again", kind.name()),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};

    fn oblique() -> Geometry {
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7);
        Geometry {
            size: [4, 3, 2],
            spacing: DVec3::new(0.1, 1.0 / 3.0, 2.5),
            directions: turn * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)),
            origin: DVec3::new(-101.7, 0.1 + 0.2, 1e-7),
            space: Space::Lps,
        }
    }

    fn history() -> History {
        History {
            tool: "distfield".to_owned(),
            version: "0.1.0".to_owned(),
            command_line: "distfield Größe.nrrd <1> & \"2\"".to_owned(),
            parameters: serde_json::json!({"iso": 0.5, "seed": 1}),
            inputs: Vec::new(),
        }
    }

    fn write(path: &Path, kind: FieldKind, image: &Image<f32>, meta: &Value) {
        let field = Field { image: Arc::new(image.clone()), meta: meta.clone(), history: Some(history()), kind };
        field.write(path).expect("written");
        let hash = isoparticles_file::history::hash_written(|file| field.encode(file)).expect("no error");
        assert_eq!(hash, isoparticles_file::history::hash_file(path).expect("hashed"));
    }

    #[test]
    fn a_field_comes_back_bit_for_bit() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("case.distfield.vti");
        let geometry = oblique();
        let mut data: Vec<f32> = (0..24).map(|i| (i as f32 - 11.3) / 7.0).collect();
        data[3] = -0.0;
        data[4] = f32::MIN_POSITIVE / 4.0;
        let image = Image { geometry, data };
        let meta = serde_json::json!({"zero crossings": 12, "unit": "µm"});
        write(&path, FieldKind::Distance, &image, &meta);
        let field = read_field(&path, FieldKind::Distance).expect("read");
        assert_eq!(field.image.geometry, image.geometry);
        let bits = |data: &[f32]| data.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&field.image.data), bits(&image.data));
        assert_eq!(field.meta, meta);
        assert_eq!(field.history, Some(history()));
        let volume = isoparticles_volume::read_volume(&path).expect("also a volume");
        assert_eq!(volume.voxels, isoparticles_volume::Voxels::F32(image.data));
    }

    #[test]
    fn the_wrong_field_names_the_stage_to_run() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("case.distfield.vti");
        let mut image = Image::filled(oblique(), 1.0f32);
        write(&path, FieldKind::Distance, &image, &Value::Null);
        let error = read_field(&path, FieldKind::Sizing).expect_err("wrong kind");
        assert!(error.what.contains("distfield") && error.next.contains("sizefield"), "{error}");
        image.data[5] = 0.0;
        write(&path, FieldKind::Sizing, &image, &Value::Null);
        let error = read_field(&path, FieldKind::Sizing).expect_err("h of zero");
        assert!(error.what.contains("1 values"), "{error}");
    }

    #[test]
    fn every_truncation_is_an_error() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("case.distfield.vti");
        let image = Image::filled(oblique(), 1.0f32);
        write(&path, FieldKind::Distance, &image, &Value::Null);
        let whole = std::fs::read(&path).expect("bytes");
        let footer = b"\n  </AppendedData>\n</VTKFile>\n".len();
        for length in 0..whole.len() - footer {
            std::fs::write(&path, &whole[..length]).expect("cut");
            assert!(read_field(&path, FieldKind::Distance).is_err(), "cut to {length} bytes");
        }
    }
}
