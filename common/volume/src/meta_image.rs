//! Reads the MetaImage format of ITK: `.mha` files, and `.mhd` files with separate data files. The
//! world frame is LPS.
//!
//! Fields are interpreted as in ITK. `TransformMatrix` contains the axis directions, one after
//! another, and `Offset` is the centre of the first voxel. `AnatomicalOrientation` is redundant,
//! and `CenterOfRotation` does not affect the grid. Both are ignored.

use crate::error::bad;
use crate::error::{Error, Result};
use crate::geometry::{Geometry, Space};
use crate::limit::{geometry_from_steps, voxel_count};
use crate::volume::Volume;
use crate::voxel_data::{Coding, DataFiles, Layout, MOST_HEADER_BYTES, numbered_names, read_line, read_voxels};
use crate::voxels::{Endian, ScalarType};
use glam::DVec3;
use isoparticles_file::limit::check_memory;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Maximum number of dimensions. The arrays of MetaIO's class `MetaObject` have ten entries.
const MOST_DIMENSIONS: usize = 10;

/// Names of the fields that can start a header. ITK always writes `ObjectType` first; other
/// programs may omit it.
const FIRST_FIELDS: [&str; 3] = ["ObjectType", "NDims", "Comment"];

/// Returns whether a file that starts with these bytes is a MetaImage.
pub(crate) fn is_meta_image(start: &[u8]) -> bool {
    FIRST_FIELDS.iter().any(|field| {
        let rest = start.strip_prefix(field.as_bytes());
        rest.is_some_and(|rest| rest.trim_ascii_start().starts_with(b"="))
    })
}

/// Reads a MetaImage volume with one number per voxel.
pub(crate) fn read_meta_image(path: &Path) -> Result<Volume> {
    let file = File::open(path).map_err(|error| Error::file(path, "read", error, "check the name of the volume"))?;
    let mut reader = BufReader::new(file);
    let header = Header::read(path, &mut reader)?;
    let (geometry, mut remarks) = header.geometry()?;
    let layout = header.layout()?;
    let count = geometry.voxel_count();
    check_memory(path, (count as u64).saturating_mul(layout.scalar.bytes() as u64))?;
    let voxels = read_voxels(path, &layout, count, reader, &mut remarks)?;
    Ok(Volume { remarks, ..Volume::new(geometry, voxels) })
}

/// Returns the data files that the header specifies.
pub(crate) fn data_files(path: &Path, reader: &mut impl BufRead) -> Result<DataFiles> {
    Header::read(path, reader)?.files()
}

/// The fields of a header.
struct Header<'a> {
    path: &'a Path,
    /// Values by field name. Field names are case-sensitive.
    fields: BTreeMap<String, String>,
    /// The lines after `ElementDataFile = LIST`.
    list: Vec<String>,
}

impl<'a> Header<'a> {
    /// Reads the header, whose last field is `ElementDataFile`. Leaves the reader positioned at the
    /// end of the header.
    fn read(path: &'a Path, reader: &mut impl BufRead) -> Result<Self> {
        let mut header = Self { path, fields: BTreeMap::new(), list: Vec::new() };
        let mut reader = Read::take(reader, MOST_HEADER_BYTES);
        while let Some(line) = read_line(path, &mut reader)? {
            let line = line.trim();
            if line.is_empty() {
                continue;
            }
            let Some((name, value)) = line.split_once('=') else {
                return Err(bad(
                    path,
                    format!("has the header line '{}'", line.chars().take(60).collect::<String>()),
                    "a header line of a MetaImage must be 'Name = value'",
                    "write the file again; it is damaged or not a MetaImage",
                ));
            };
            let (name, value) = (name.trim().to_owned(), value.trim().to_owned());
            let is_last = name == "ElementDataFile";
            header.fields.insert(name, value.clone());
            if is_last {
                if value.split_whitespace().next() == Some("LIST") {
                    while let Some(line) = read_line(path, &mut reader)? {
                        header.list.extend(Some(line.trim()).filter(|line| !line.is_empty()).map(str::to_owned));
                    }
                }
                return Ok(header);
            }
        }
        Err(bad(
            path,
            "has no field 'ElementDataFile'",
            "this field ends the header of a MetaImage and names the voxel data",
            "write the file again; it is truncated or not a MetaImage",
        ))
    }

    fn field(&self, name: &str) -> Option<&str> {
        self.fields.get(name).map(String::as_str)
    }

    /// Returns the name and value of the first field in `names` that is present.
    fn first_of(&self, names: &[&'static str]) -> Option<(&'static str, &str)> {
        names.iter().find_map(|&name| self.field(name).map(|text| (name, text)))
    }

    fn error(&self, name: &str) -> Error {
        let shown: String = self.field(name).unwrap_or("").chars().take(80).collect();
        bad(
            self.path,
            format!("has '{name} = {shown}' in its header"),
            "this value is invalid",
            "correct the header, or write the file again with another program",
        )
    }

    fn need(&self, name: &str) -> Result<&str> {
        self.field(name).ok_or_else(|| {
            bad(self.path, format!("has no field '{name}'"), "every MetaImage needs it", "write the file again")
        })
    }

    /// Returns the value of a boolean field, or false if the field is missing.
    fn is(&self, name: &str) -> Result<bool> {
        match self.field(name).map(str::to_lowercase).as_deref() {
            None => Ok(false),
            Some("true" | "t" | "1" | "yes") => Ok(true),
            Some("false" | "f" | "0" | "no") => Ok(false),
            Some(_) => Err(self.error(name)),
        }
    }

    /// Returns the `count` numbers of a field.
    fn numbers<T: std::str::FromStr>(&self, name: &str, count: usize) -> Result<Vec<T>> {
        let words = self.field(name).unwrap_or("").split_whitespace();
        let numbers: Option<Vec<T>> = words.map(|word| word.parse().ok()).collect();
        numbers.filter(|numbers| numbers.len() == count).ok_or_else(|| self.error(name))
    }

    fn no_volume(&self, dimension: usize) -> Error {
        bad(
            self.path,
            format!("has {dimension} dimensions (sizes {})", self.field("DimSize").unwrap_or("unknown")),
            "a volume must have three",
            "write one 3-D volume to a separate file",
        )
    }

    fn geometry(&self) -> Result<(Geometry, Vec<String>)> {
        if let Some(kind) = self.field("ObjectType").filter(|kind| !kind.eq_ignore_ascii_case("image")) {
            return Err(bad(
                self.path,
                format!("is a MetaIO file of a {kind}"),
                "an image is needed",
                "use the volume",
            ));
        }
        let dimension: usize = self.need("NDims")?.parse().map_err(|_| self.error("NDims"))?;
        if !(3..=MOST_DIMENSIONS).contains(&dimension) {
            return Err(self.no_volume(dimension));
        }
        let sizes = self.numbers::<usize>("DimSize", dimension)?;
        // accept a time series that contains a single volume
        if sizes[3..].iter().any(|&n| n != 1) {
            return Err(self.no_volume(dimension));
        }
        let size = [sizes[0], sizes[1], sizes[2]];
        voxel_count(self.path, size)?;
        if size.contains(&1) {
            return Err(bad(
                self.path,
                format!("is a flat image of {} x {} x {} voxels", size[0], size[1], size[2]),
                "a volume must have at least two voxels along each axis",
                "use a 3-D volume",
            ));
        }
        let mut remarks = Vec::new();
        let spacing = match self.first_of(&["ElementSpacing", "ElementSize"]) {
            Some((name, _)) => DVec3::from_slice(&self.numbers::<f64>(name, dimension)?),
            None => {
                remarks.push("the header has no spacing; 1 mm is assumed".to_owned());
                DVec3::ONE
            }
        };
        let matrix = match self.first_of(&["TransformMatrix", "Rotation", "Orientation"]) {
            Some((name, _)) => self.numbers::<f64>(name, dimension * dimension)?,
            None => (0..dimension * dimension).map(|n| f64::from(n % (dimension + 1) == 0)).collect(),
        };
        let origin = match self.first_of(&["Offset", "Position", "Origin"]) {
            Some((name, _)) => DVec3::from_slice(&self.numbers::<f64>(name, dimension)?),
            None => DVec3::ZERO,
        };
        let steps = [0, 1, 2].map(|axis| DVec3::from_slice(&matrix[dimension * axis..]) * spacing[axis]);
        Ok((geometry_from_steps(self.path, size, steps, origin, Space::Lps)?, remarks))
    }

    fn layout(&self) -> Result<Layout> {
        if let Some(channels) = self.field("ElementNumberOfChannels").filter(|&channels| channels != "1") {
            return Err(bad(
                self.path,
                format!("has {channels} values per voxel (ElementNumberOfChannels)"),
                "a volume must have one value per voxel",
                "write one component to a separate file",
            ));
        }
        let scalar = scalar_type(self.need("ElementType")?).ok_or_else(|| self.error("ElementType"))?;
        let is_text = self.field("BinaryData").is_some() && !self.is("BinaryData")?;
        let coding = match (is_text, self.is("CompressedData")?) {
            (true, _) => Coding::Text,
            (false, true) => Coding::Zlib,
            (false, false) => Coding::Raw,
        };
        let order = self.first_of(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"]);
        let is_big = order.map_or(Ok(false), |(name, _)| self.is(name))?;
        // as in NRRD, -1 means that the voxels are the last bytes of the file
        let byte_skip =
            self.field("HeaderSize").map_or(Ok(0), |text| text.parse().map_err(|_| self.error("HeaderSize")))?;
        if byte_skip < -1 {
            return Err(self.error("HeaderSize"));
        }
        let endian = Some(if is_big { Endian::Big } else { Endian::Little });
        Ok(Layout { scalar, coding, endian, line_skip: 0, byte_skip, files: self.files()? })
    }

    /// Returns the number of slices, the third number in `DimSize`.
    fn slices(&self) -> Result<usize> {
        let words = self.field("DimSize").unwrap_or("").split_whitespace();
        { words }.nth(2).and_then(|word| word.parse().ok()).ok_or_else(|| self.error("DimSize"))
    }

    /// Returns the data files that `ElementDataFile` specifies: `LOCAL`, a file name, `LIST
    /// [dimension]`, or `pattern first last step`.
    fn files(&self) -> Result<DataFiles> {
        let field = self.need("ElementDataFile")?;
        let words: Vec<&str> = field.split_whitespace().collect();
        let names = match words.as_slice() {
            [] => return Err(self.error("ElementDataFile")),
            ["LOCAL" | "Local" | "local"] => return Ok(DataFiles::Attached),
            ["LIST"] | ["LIST", "2" | "3" | "2D" | "3D"] => self.list.clone(),
            ["LIST", ..] => return Err(self.error("ElementDataFile")),
            [pattern, numbers @ ..] if pattern.contains('%') && (1..=3).contains(&numbers.len()) => {
                let numbers: Option<Vec<i64>> = numbers.iter().map(|word| word.parse().ok()).collect();
                let slices = self.slices()? as i64;
                let range = match numbers.as_deref() {
                    Some([low]) => low.checked_add(slices - 1).map(|high| (*low, high, 1)),
                    Some([low, high]) => Some((*low, *high, 1)),
                    Some([low, high, step]) => Some((*low, *high, *step)),
                    _ => None,
                };
                let names = range.and_then(|(low, high, step)| numbered_names(pattern, low, high, step));
                names.ok_or_else(|| self.error("ElementDataFile"))?
            }
            // a file name may contain spaces
            _ => vec![field.to_owned()],
        };
        let slices = self.slices()?;
        if names.len() == 1 || names.len() == slices {
            return Ok(DataFiles::Named(names));
        }
        Err(bad(
            self.path,
            format!("names {} data files for {slices} slices", names.len()),
            "the data files must hold the whole volume",
            "correct 'ElementDataFile' in the header, or add the missing files",
        ))
    }
}

/// Converts a MetaIO type name to a scalar type. MetaIO's `LONG` always has 32 bits.
fn scalar_type(name: &str) -> Option<ScalarType> {
    Some(match name {
        "MET_CHAR" => ScalarType::I8,
        "MET_UCHAR" => ScalarType::U8,
        "MET_SHORT" => ScalarType::I16,
        "MET_USHORT" => ScalarType::U16,
        "MET_INT" | "MET_LONG" => ScalarType::I32,
        "MET_UINT" | "MET_ULONG" => ScalarType::U32,
        "MET_LONG_LONG" => ScalarType::I64,
        "MET_ULONG_LONG" => ScalarType::U64,
        "MET_FLOAT" => ScalarType::F32,
        "MET_DOUBLE" => ScalarType::F64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: &str = "ObjectType = Image\nNDims = 3\nDimSize = 2 3 4\n";

    fn header(text: &str) -> Result<Header<'static>> {
        Header::read(Path::new("test.mhd"), &mut text.as_bytes())
    }

    #[test]
    fn the_first_bytes_tell() {
        assert!(is_meta_image(b"ObjectType = Image\n") && is_meta_image(b"NDims=3\n"));
        assert!(!is_meta_image(b"ObjectTypes\n") && !is_meta_image(b"NRRD0004\n"));
    }

    #[test]
    fn data_files_are_resolved() {
        let files = |line: &str| {
            let header = header(&format!("{GRID}ElementType = MET_SHORT\nElementDataFile = {line}")).expect("header");
            header.layout().map(|layout| layout.files)
        };
        let named = |names: &[&str]| DataFiles::Named(names.iter().map(|name| (*name).to_owned()).collect());
        assert_eq!(files("LOCAL\n").expect("attached"), DataFiles::Attached);
        assert_eq!(files("my data.raw").expect("one"), named(&["my data.raw"]));
        assert_eq!(files("LIST\na\nb\n\nc\nd").expect("list"), named(&["a", "b", "c", "d"]));
        let four = ["s08.raw", "s09.raw", "s10.raw", "s11.raw"];
        for pattern in ["s%02d.raw 8", "s%02d.raw 8 11", "s%02d.raw 8 11 1"] {
            assert_eq!(files(pattern).expect(pattern), named(&four));
        }
        for wrong in ["", "LIST\na\nb\n", "LIST 1\na\n", "s%d.raw 1 2 1", "s%d.raw x", "s%d.raw 1 4 0", "s%s.raw 1 4 1"]
        {
            assert!(files(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_series_of_one_volume_is_a_volume() {
        let text = "ObjectType = Image\nNDims = 4\nDimSize = 2 3 4 1\nElementSpacing = 1 2 3 9\nOffset = 5 6 7 8\n\
                    TransformMatrix = 0 1 0 0 -1 0 0 0 0 0 1 0 0 0 0 1\nElementType = MET_SHORT\nElementDataFile = LOCAL\n";
        let (geometry, remarks) = header(text).and_then(|header| header.geometry()).expect("a volume");
        assert_eq!((geometry.size, geometry.spacing), ([2, 3, 4], DVec3::new(1.0, 2.0, 3.0)));
        assert_eq!((geometry.origin, geometry.directions.y_axis), (DVec3::new(5.0, 6.0, 7.0), DVec3::NEG_X));
        assert!(remarks.is_empty() && header(text).and_then(|header| header.layout()).is_ok());
        let two = text.replace("2 3 4 1", "2 3 4 2");
        let error = header(&two).and_then(|header| header.geometry()).expect_err("two volumes");
        assert!(error.to_string().contains("4 dimensions (sizes 2 3 4 2)"), "{error}");
    }

    #[test]
    fn damaged_headers_are_refused() {
        let end = "ElementType = MET_SHORT\nElementDataFile = LOCAL\n";
        for text in [
            "NDims = 3\n".to_owned(),
            format!("ObjectType = Tube\nNDims = 3\nDimSize = 2 3 4\n{end}"),
            format!("ObjectType = Image\nDimSize = 2 3 4\n{end}"),
            format!("NDims = 3\nDimSize = 2 3\n{end}"),
            format!("NDims = 3\nDimSize = 2 3 -4\n{end}"),
            format!("NDims = 3\nDimSize = 2 3 0\n{end}"),
            format!("NDims = 2\nDimSize = 2 3\n{end}"),
            format!("{GRID}ElementSpacing = 1 1\n{end}"),
            format!("{GRID}ElementSpacing = 1 nan 1\n{end}"),
            format!("{GRID}TransformMatrix = 1 0 0 1 0 0 0 0 1\n{end}"),
            format!("{GRID}Offset = 1 2 x\n{end}"),
            format!("{GRID}ElementNumberOfChannels = 3\n{end}"),
            format!("{GRID}CompressedData = maybe\n{end}"),
            format!("{GRID}HeaderSize = -2\n{end}"),
            format!("{GRID}ElementType = MET_SHORT_ARRAY\nElementDataFile = LOCAL\n"),
            format!("{GRID}no equals sign\n{end}"),
        ] {
            let result = header(&text).and_then(|header| header.geometry().and_then(|_| header.layout().map(drop)));
            let error = result.expect_err(&text);
            assert!(
                error.to_string().contains("test.mhd") && !error.reason().is_empty() && !error.remedy().is_empty(),
                "{error}"
            );
        }
    }
}
