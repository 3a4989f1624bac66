//! Parses the text header of an NRRD file. [`super::grid`] and [`super::segments`] interpret the
//! fields that describe the grid and the segments; [`crate::voxel_data`] reads the voxels.

use crate::error::bad;
use crate::error::{Error, Result};
use crate::voxel_data::{Coding, DataFiles, Layout, MOST_HEADER_BYTES, numbered_names, read_line};
use crate::voxels::{Endian, ScalarType};
use std::collections::BTreeMap;
use std::io::{BufRead, Read};
use std::path::Path;

/// Maximum number of axes (`NRRD_DIM_MAX` in Teem).
const MOST_AXES: usize = 16;

/// The contents of a header.
#[derive(Clone, Debug)]
pub(super) struct Header {
    pub(super) sizes: Vec<usize>,
    pub(super) layout: Layout,
    /// Unparsed values of all fields, by lower-case field name.
    pub(super) fields: BTreeMap<String, String>,
    /// The key/value pairs.
    pub(super) pairs: BTreeMap<String, String>,
}

impl Header {
    /// Reads the header. Leaves the reader positioned after the blank line that ends the header.
    pub(super) fn read(path: &Path, reader: &mut impl BufRead) -> Result<Self> {
        let Fields { fields, pairs, list } = read_fields(path, reader)?;
        let get = |name: &str| fields.get(name).map(String::as_str);
        let need = |name: &str| {
            get(name).ok_or_else(|| {
                bad(path, format!("has no field '{name}'"), "every NRRD header needs it", "write the file again")
            })
        };
        let scalar = scalar_type(path, need("type")?)?;
        let dimension: usize = number(path, "dimension", need("dimension")?)?;
        if dimension == 0 || dimension > MOST_AXES {
            return Err(field_error(path, "dimension", need("dimension")?));
        }
        let sizes = need("sizes")?
            .split_whitespace()
            .map(|word| number(path, "sizes", word))
            .collect::<Result<Vec<usize>>>()?;
        if sizes.len() != dimension {
            return Err(bad(
                path,
                format!("has {} sizes for dimension {dimension}", sizes.len()),
                "the number of voxels is ambiguous",
                "correct the header",
            ));
        }
        let coding = match need("encoding")?.to_lowercase().as_str() {
            "raw" => Coding::Raw,
            "txt" | "text" | "ascii" => Coding::Text,
            "hex" => Coding::Hex,
            "gz" | "gzip" => Coding::Gzip,
            "bz2" | "bzip2" => Coding::Bzip2,
            other => return Err(field_error(path, "encoding", other)),
        };
        let endian = match get("endian").map(str::to_lowercase).as_deref() {
            None => None,
            Some("little") => Some(Endian::Little),
            Some("big") => Some(Endian::Big),
            Some(other) => return Err(field_error(path, "endian", other)),
        };
        let line_skip = get("line skip").map_or(Ok(0), |word| number(path, "line skip", word))?;
        let byte_skip = get("byte skip").map_or(Ok(0), |word| number(path, "byte skip", word))?;
        let files = data_files(path, get("data file"), list, &sizes)?;
        let layout = Layout { scalar, coding, endian, line_skip, byte_skip, files };
        Ok(Self { sizes, layout, fields, pairs })
    }

    /// Returns the unparsed value of a field.
    pub(super) fn field(&self, name: &str) -> Option<&str> {
        self.fields.get(name).map(String::as_str)
    }

    /// Returns the words of a field that has one word per axis.
    pub(super) fn words(&self, path: &Path, name: &str) -> Result<Option<Vec<&str>>> {
        let Some(text) = self.field(name) else { return Ok(None) };
        let words: Vec<&str> = text.split_whitespace().collect();
        if words.len() == self.sizes.len() { Ok(Some(words)) } else { Err(field_error(path, name, text)) }
    }

    /// Returns the numbers of a field that has one number per axis. Numbers may be NaN.
    pub(super) fn numbers(&self, path: &Path, name: &str) -> Result<Option<Vec<f64>>> {
        self.words(path, name)?.map(|words| words.iter().map(|word| number(path, name, word)).collect()).transpose()
    }
}

/// The parsed lines of a header.
#[derive(Default)]
struct Fields {
    /// Values by lower-case field name.
    fields: BTreeMap<String, String>,
    /// Key/value pairs (`key:=value`).
    pairs: BTreeMap<String, String>,
    /// The file names listed after `data file: LIST`.
    list: Vec<String>,
}

fn read_fields(path: &Path, reader: &mut impl BufRead) -> Result<Fields> {
    let mut reader = Read::take(reader, MOST_HEADER_BYTES);
    let magic = read_line(path, &mut reader)?.unwrap_or_default();
    match magic.strip_prefix("NRRD000").map(str::parse::<u8>) {
        Some(Ok(1..=5)) => {}
        _ => {
            return Err(bad(
                path,
                format!("starts with '{}'", magic.chars().take(20).collect::<String>()),
                "NRRD files of versions 1 to 5 can be read; they start with NRRD0001 to NRRD0005",
                "write or download the file again",
            ));
        }
    }
    let Fields { mut fields, mut pairs, mut list } = Fields::default();
    let mut in_list = false;
    while let Some(line) = read_line(path, &mut reader)? {
        if in_list {
            if !line.is_empty() {
                list.push(line);
            }
            continue;
        }
        if line.is_empty() {
            break;
        }
        if line.starts_with('#') {
            continue;
        }
        if let Some((key, value)) = line.split_once(":=").filter(|(key, _)| !key.contains(": ")) {
            pairs.insert(key.to_owned(), value.to_owned());
            continue;
        }
        let Some((name, value)) = line.split_once(':') else {
            return Err(bad(
                path,
                format!("has the header line '{}'", line.chars().take(60).collect::<String>()),
                "a header line must be 'field: value', 'key:=value' or '# comment'",
                "write the file again; its header is damaged, or lacks the blank line at its end",
            ));
        };
        let name = canonical_name(&name.trim().to_lowercase()).to_owned();
        let value = value.trim().to_owned();
        in_list = name == "data file" && value.split_whitespace().next() == Some("LIST");
        if fields.contains_key(&name) {
            return Err(bad(
                path,
                format!("has the field '{name}' twice"),
                "the value is ambiguous",
                "delete one of the two lines",
            ));
        }
        fields.insert(name, value);
    }
    Ok(Fields { fields, pairs, list })
}

/// Maps alternative spellings of field names to the standard spelling.
fn canonical_name(name: &str) -> &str {
    match name {
        "datafile" => "data file",
        "lineskip" => "line skip",
        "byteskip" => "byte skip",
        "axismins" => "axis mins",
        "axismaxs" => "axis maxs",
        "centerings" => "centers",
        other => other,
    }
}

/// Parses one number of a field.
pub(super) fn number<T: std::str::FromStr>(path: &Path, field: &str, word: &str) -> Result<T> {
    word.parse().map_err(|_| field_error(path, field, word))
}

/// Creates an error about the value of a field.
pub(super) fn field_error(path: &Path, field: &str, value: &str) -> Error {
    let shown: String = value.chars().take(80).collect();
    bad(
        path,
        format!("has '{field}: {shown}' in its header"),
        "this value is invalid",
        "correct the header, or write the file again with another program",
    )
}

fn scalar_type(path: &Path, name: &str) -> Result<ScalarType> {
    Ok(match name.to_lowercase().split_whitespace().collect::<Vec<_>>().join(" ").as_str() {
        "signed char" | "int8" | "int8_t" => ScalarType::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => ScalarType::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => ScalarType::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => ScalarType::U16,
        "int" | "signed int" | "int32" | "int32_t" => ScalarType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => ScalarType::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => ScalarType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => ScalarType::U64,
        "float" => ScalarType::F32,
        "double" => ScalarType::F64,
        other => return Err(field_error(path, "type", other)),
    })
}

/// Returns the data files that `data file` specifies: `LOCAL` (attached, the default), a file name,
/// `LIST [subdim]`, or `format min max step [subdim]`.
fn data_files(path: &Path, field: Option<&str>, list: Vec<String>, sizes: &[usize]) -> Result<DataFiles> {
    let Some(field) = field else { return Ok(DataFiles::Attached) };
    let words: Vec<&str> = field.split_whitespace().collect();
    let (names, part_dimension) = match words.as_slice() {
        ["LOCAL"] => return Ok(DataFiles::Attached),
        ["LIST"] => (list, None),
        ["LIST", dimension] => (list, Some(number(path, "data file", dimension)?)),
        [format, low, high, step, rest @ ..] if format.contains('%') && rest.len() <= 1 => {
            let range = [low, high, step].map(|word| number::<i64>(path, "data file", word));
            let [low, high, step] = range;
            let names = numbered_names(format, low?, high?, step?);
            let names = names.ok_or_else(|| field_error(path, "data file", field))?;
            (names, rest.first().map(|word| number(path, "data file", word)).transpose()?)
        }
        [] => return Err(field_error(path, "data file", field)),
        // a file name may contain spaces
        _ => return Ok(DataFiles::Named(vec![field.to_owned()])),
    };
    // without a sub-dimension, each file contains one slice along the slowest axis
    let dimension = sizes.len();
    let part_dimension: usize = part_dimension.unwrap_or(dimension - 1);
    let fits = match part_dimension {
        0 => false,
        part if part < dimension => {
            sizes[part..].iter().try_fold(1usize, |product, &n| product.checked_mul(n)) == Some(names.len())
        }
        part if part == dimension => !names.is_empty() && sizes[dimension - 1].is_multiple_of(names.len()),
        _ => false,
    };
    if fits {
        return Ok(DataFiles::Named(names));
    }
    Err(bad(
        path,
        format!("names {} data files of dimension {part_dimension} for the sizes {sizes:?}", names.len()),
        "the data files must hold the whole volume",
        "correct 'data file' in the header, or add the missing files",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Header> {
        Header::read(Path::new("test.nrrd"), &mut text.as_bytes())
    }

    const START: &str = "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 3 4\nencoding: raw\n";

    #[test]
    fn comments_keys_case_and_line_ends_do_not_matter() {
        let text = "NRRD0005\r\n# a comment: x\r\nTYPE: unsigned  char\r\nDimension: 3\r\nkey:=value: with colon\r\n\
                    sizes:2 3 4\r\nEncoding: GZip\r\n\r\ndata";
        let mut bytes = text.as_bytes();
        let header = Header::read(Path::new("test.nrrd"), &mut bytes).expect("header");
        assert_eq!((header.layout.scalar, header.layout.coding), (ScalarType::U8, Coding::Gzip));
        assert_eq!(header.sizes, [2, 3, 4]);
        assert_eq!(bytes, b"data");
        assert!(!header.fields.contains_key("key"));
    }

    #[test]
    fn data_files_are_resolved() {
        let files = |line: &str| read(&format!("{START}{line}")).map(|header| header.layout.files);
        let named = |names: &[&str]| DataFiles::Named(names.iter().map(|name| (*name).to_owned()).collect());
        assert_eq!(files("").expect("attached"), DataFiles::Attached);
        assert_eq!(files("data file: LOCAL\n").expect("attached"), DataFiles::Attached);
        assert_eq!(files("datafile: my data.raw\n").expect("one"), named(&["my data.raw"]));
        let four = ["s08.raw", "s09.raw", "s10.raw", "s11.raw"];
        assert_eq!(files("data file: s%02d.raw 8 11 1\n").expect("pattern"), named(&four));
        assert_eq!(
            files("data file: s%d.raw 6 0 -2 2\n").expect("down"),
            named(&["s6.raw", "s4.raw", "s2.raw", "s0.raw"])
        );
        assert_eq!(files("data file: LIST\na\nb\nc\nd\n").expect("list"), named(&["a", "b", "c", "d"]));
        assert_eq!(files("data file: LIST 3\na\nb\n").expect("slabs"), named(&["a", "b"]));
        assert!(files("data file: LIST\na\nb\n").is_err());
        assert!(files("data file: LIST 3\na\nb\nc\n").is_err());
        assert!(files("data file: s%d.raw 1 4 0\n").is_err());
        assert!(files("data file: s%s.raw 1 4 1\n").is_err());
        assert!(files("data file: s%d.raw 1 9000000000000000000 1\n").is_err());
    }

    #[test]
    fn every_spelling_of_every_type_is_known() {
        let spellings = [
            ("signed char|int8|int8_t", ScalarType::I8),
            ("uchar|unsigned char|uint8|uint8_t", ScalarType::U8),
            ("short|short int|signed short|signed short int|int16|int16_t", ScalarType::I16),
            ("ushort|unsigned short|unsigned short int|uint16|uint16_t", ScalarType::U16),
            ("int|signed int|int32|int32_t", ScalarType::I32),
            ("uint|unsigned int|uint32|uint32_t", ScalarType::U32),
            ("longlong|long long|long long int|signed long long|signed long long int|int64|int64_t", ScalarType::I64),
            ("ulonglong|unsigned long long|unsigned long long int|uint64|uint64_t", ScalarType::U64),
            ("float", ScalarType::F32),
            ("double", ScalarType::F64),
        ];
        for (names, scalar) in spellings {
            for name in names.split('|') {
                assert_eq!(scalar_type(Path::new("x"), name).expect(name), scalar);
            }
        }
        assert!(scalar_type(Path::new("x"), "block").is_err());
    }

    #[test]
    fn damaged_headers_are_refused() {
        for text in [
            "NRRD0009\ntype: short\n",
            "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 3\nencoding: raw\n",
            "NRRD0004\ntype: short\ndimension: 0\nsizes:\nencoding: raw\n",
            "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 -3 4\nencoding: raw\n",
            "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 3 4\nencoding: zstd\n",
            "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 3 4\nencoding: raw\nendian: middle\n",
            "NRRD0004\ntype: short\ntype: int\ndimension: 3\nsizes: 2 3 4\nencoding: raw\n",
            "NRRD0004\ntype: short\ndimension: 3\nencoding: raw\n",
            "NRRD0004\nno colon\n",
        ] {
            assert!(read(text).is_err(), "{text}");
        }
    }
}
