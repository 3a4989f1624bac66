//! Parses the XML of a VTK file into elements, and locates the appended data.

use super::decode::{ArrayReader, Layout};
use super::scalar_of;
use crate::error::bad;
use crate::error::{Error, Result};
use crate::voxels::{Endian, ScalarType, Voxels};
use isoparticles_file::limit::check_memory;
use quick_xml::events::{BytesStart, Event};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Maximum nesting depth, which bounds the recursion when the tree of elements is dropped. Files
/// written by VTK have six levels.
const MOST_DEPTH: usize = 32;

/// An XML element with its contents.
#[derive(Clone, Debug, Default)]
pub struct Element {
    /// Tag name.
    pub name: String,
    /// Attributes by name.
    pub attributes: BTreeMap<String, String>,
    /// Child elements in document order.
    pub children: Vec<Element>,
    /// Text directly inside the element.
    pub text: String,
}

impl Element {
    /// Returns the first child with this tag name.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|child| child.name == name)
    }

    /// Returns the value of an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.get(name).map(String::as_str)
    }

    /// Returns the first child whose `Name` attribute has this value.
    pub fn array(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|child| child.attribute("Name") == Some(name))
    }
}

/// A VTK XML file: its elements, and access to its arrays.
pub struct VtkFile {
    path: PathBuf,
    /// The `VTKFile` element.
    pub root: Element,
    layout: Layout,
    appended: Appended,
}

impl VtkFile {
    /// Opens a file and parses its XML without reading the arrays.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|error| Error::file(path, "read", error, "check the name of the file"))?;
        let (head, appended) = read_head(path, &mut BufReader::with_capacity(1 << 16, file))?;
        let root = parse(path, &head)?;
        let layout = Layout {
            endian: match root.attribute("byte_order") {
                Some("BigEndian") => Endian::Big,
                _ => Endian::Little,
            },
            wide_header: root.attribute("header_type") == Some("UInt64"),
            compressed: match root.attribute("compressor") {
                None | Some("") => false,
                Some("vtkZLibDataCompressor") => true,
                Some(other) => {
                    return Err(bad(
                        path,
                        format!("is compressed with {other}"),
                        "only zlib compression can be read",
                        "save it again with zlib compression or without compression",
                    ));
                }
            },
        };
        Ok(Self { path: path.to_path_buf(), root, layout, appended })
    }

    /// Returns the data set element, such as `ImageData`. Fails if the file contains a different
    /// data set.
    pub fn data_set(&self, kind: &str) -> Result<&Element> {
        self.root.child(kind).ok_or_else(|| {
            let found = self.root.attribute("type").unwrap_or("no known data set");
            bad(
                &self.path,
                format!("contains {found}, not {kind}"),
                "another kind of file is needed",
                "use the file that the previous stage wrote",
            )
        })
    }

    /// Returns the single piece of a data set. Fails if there is no piece or more than one.
    pub fn piece(&self, kind: &str) -> Result<&Element> {
        let data_set = self.data_set(kind)?;
        match data_set.children.iter().filter(|child| child.name == "Piece").collect::<Vec<_>>().as_slice() {
            [piece] => Ok(piece),
            pieces => Err(bad(
                &self.path,
                format!("has {} pieces", pieces.len()),
                "only files with one piece can be read",
                "save it again as one piece",
            )),
        }
    }

    /// Returns the number of components of an array.
    pub fn components(array: &Element) -> usize {
        array.attribute("NumberOfComponents").and_then(|text| text.parse().ok()).unwrap_or(1).max(1)
    }

    /// Reads an array of `count` numbers. Fails if the array has a different length.
    pub fn numbers(&self, array: &Element, count: usize) -> Result<Voxels> {
        let scalar = self.scalar(array)?;
        // on overflow, the product saturates and the memory check fails
        let expected = (count as u64).saturating_mul(scalar.bytes() as u64);
        check_memory(&self.path, expected)?;
        let wrong = |error: std::io::Error| self.array_error(array, &error);
        if array.attribute("format").unwrap_or("ascii") == "ascii" {
            let mut values = Voxels::empty(scalar);
            for word in array.text.split_ascii_whitespace() {
                if values.len() == count || !values.push_text(word) {
                    return Err(wrong(std::io::Error::other(format!("'{word}' is unexpected"))));
                }
            }
            if values.len() < count {
                return Err(wrong(std::io::Error::other(format!("{} of {count} values", values.len()))));
            }
            return Ok(values);
        }
        let mut reader = self.reader(array).map_err(wrong)?;
        if reader.length != expected {
            let text = format!("{} bytes, but {expected} are needed", reader.length);
            return Err(wrong(std::io::Error::other(text)));
        }
        let values = match self.plain_bytes(array) {
            Some(start) => Voxels::read_file(&self.path, start, scalar, self.layout.endian, count),
            None => Voxels::read_from(&mut reader, scalar, self.layout.endian, count),
        };
        values.map_err(wrong)
    }

    /// Reads an array of numbers whose length is specified in the file.
    pub fn all_numbers(&self, array: &Element) -> Result<Voxels> {
        let scalar = self.scalar(array)?;
        if array.attribute("format").unwrap_or("ascii") == "ascii" {
            return self.numbers(array, array.text.split_ascii_whitespace().count());
        }
        let length = self.reader(array).map_err(|error| self.array_error(array, &error))?.length;
        self.numbers(array, usize::try_from(length / scalar.bytes() as u64).unwrap_or(usize::MAX))
    }

    /// Returns the string in a field-data array, if the array exists. The string is stored as bytes
    /// or, in format version 1, as a VTK string.
    pub fn text(&self, data_set: &Element, name: &str) -> Result<Option<String>> {
        let Some(array) = data_set.child("FieldData").and_then(|field| field.array(name)) else { return Ok(None) };
        if !matches!(array.attribute("type"), Some("UInt8" | "String")) {
            return Ok(None);
        }
        let wrong = |error: std::io::Error| self.array_error(array, &error);
        let bytes = if array.attribute("format").unwrap_or("ascii") == "ascii" {
            let codes =
                array.text.split_ascii_whitespace().map(str::parse::<u8>).collect::<std::result::Result<_, _>>();
            codes.map_err(|error| wrong(std::io::Error::other(error)))?
        } else {
            let mut reader = self.reader(array).map_err(wrong)?;
            check_memory(&self.path, reader.length)?;
            let mut bytes = Vec::new();
            let length = reader.length;
            Read::take(&mut reader, length).read_to_end(&mut bytes).map_err(wrong)?;
            bytes
        };
        let first = bytes.split(|&byte| byte == 0).next().unwrap_or_default();
        Ok(Some(String::from_utf8_lossy(first).into_owned()))
    }

    fn scalar(&self, array: &Element) -> Result<ScalarType> {
        let name = array.attribute("type").unwrap_or("none");
        scalar_of(name).ok_or_else(|| self.array_error(array, &std::io::Error::other(format!("its type is {name}"))))
    }

    /// Returns the position of an appended array in the file, and whether the array is encoded in
    /// base64.
    fn place(&self, array: &Element) -> std::io::Result<(u64, bool)> {
        let offset = array.attribute("offset").and_then(|text| text.parse::<u64>().ok());
        let (Some((start, base64)), Some(offset)) = (self.appended, offset) else {
            return Err(std::io::Error::other("it has no data"));
        };
        let position = start.checked_add(offset).ok_or_else(|| std::io::Error::other("its offset is too large"))?;
        Ok((position, base64))
    }

    /// Returns the position of an array's numbers in the file if they are stored as raw,
    /// uncompressed appended data.
    fn plain_bytes(&self, array: &Element) -> Option<u64> {
        let (position, base64) = self.place(array).ok().filter(|_| array.attribute("format") != Some("binary"))?;
        let header = if self.layout.wide_header { 8 } else { 4 };
        position.checked_add(header).filter(|_| !base64 && !self.layout.compressed)
    }

    fn reader<'a>(&self, array: &'a Element) -> std::io::Result<ArrayReader<'a>> {
        if array.attribute("format") == Some("binary") {
            return ArrayReader::new(Box::new(array.text.as_bytes()), true, self.layout);
        }
        let (position, base64) = self.place(array)?;
        let mut reader = BufReader::with_capacity(1 << 17, File::open(&self.path)?);
        reader.seek(SeekFrom::Start(position))?;
        ArrayReader::new(Box::new(reader), base64, self.layout)
    }

    fn array_error(&self, array: &Element, error: &std::io::Error) -> Error {
        bad(
            &self.path,
            format!("the array '{}' cannot be read: {error}", array.attribute("Name").unwrap_or("")),
            "the file is damaged or truncated",
            "write it again with the stage or program that wrote it",
        )
    }
}

/// Position of the appended data in the file, and whether the data is encoded in base64. `None` if
/// the file has no appended data.
type Appended = Option<(u64, bool)>;

/// Reads the XML up to the appended data. Returns the XML, and the position and encoding of the
/// data.
fn read_head(path: &Path, reader: &mut impl BufRead) -> Result<(Vec<u8>, Appended)> {
    const TAG: &[u8] = b"<AppendedData";
    // Length in bytes above which the XML is assumed to contain the array values. Parsing it then
    // creates a second copy of the values. With appended data, the XML has about 100 bytes per
    // array.
    const SHORT_XML: usize = 64 << 20;
    let mut head = Vec::new();
    let mut searched = 0usize;
    loop {
        let chunk = reader
            .fill_buf()
            .map_err(|error| Error::file(path, "read", error, "check the disk that holds the file"))?;
        if chunk.is_empty() {
            return Ok((head, None));
        }
        if head.len() < SHORT_XML && head.len() + chunk.len() >= SHORT_XML {
            let length = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
            check_memory(path, 2 * length)?;
        }
        let taken = chunk.len();
        head.extend_from_slice(chunk);
        reader.consume(taken);
        let found = head[searched..].windows(TAG.len()).position(|window| window == TAG).map(|at| searched + at);
        let Some(start) = found else {
            searched = head.len().saturating_sub(TAG.len() - 1);
            continue;
        };
        searched = start;
        // the tag may continue in the next chunk
        let Some(underscore) = head[start..].iter().position(|&byte| byte == b'_') else { continue };
        let tag = String::from_utf8_lossy(&head[start..start + underscore]).into_owned();
        let base64 = !tag.contains("\"raw\"") && !tag.contains("'raw'");
        let data = (start + underscore + 1) as u64;
        head.truncate(start);
        return Ok((head, Some((data, base64))));
    }
}

/// Builds the tree of elements. Elements that are still open at the end are closed, because the XML
/// is truncated at the appended data.
fn parse(path: &Path, head: &[u8]) -> Result<Element> {
    let damaged = |what: String| {
        bad(
            path,
            what,
            "it is not a VTK XML file, or is damaged",
            "write it again with the stage or program that wrote it",
        )
    };
    let text = String::from_utf8_lossy(head);
    let mut reader = quick_xml::Reader::from_str(&text);
    let mut open: Vec<Element> = vec![Element::default()];
    loop {
        match reader.read_event() {
            Ok(Event::Start(start)) => {
                if open.len() > MOST_DEPTH {
                    return Err(damaged(format!("nests more than {MOST_DEPTH} elements")));
                }
                open.push(element(&start).map_err(damaged)?);
            }
            Ok(Event::Empty(start)) => {
                let empty = element(&start).map_err(damaged)?;
                attach(&mut open, empty);
            }
            Ok(Event::End(_)) => {
                if open.len() > 1
                    && let Some(last) = open.pop()
                {
                    attach(&mut open, last);
                }
            }
            Ok(Event::Text(text)) => {
                if let Some(last) = open.last_mut() {
                    last.text.push_str(&text);
                }
            }
            Ok(Event::Eof) => break,
            Ok(_) => {}
            Err(error) => return Err(damaged(format!("is not well-formed XML: {error}"))),
        }
    }
    while open.len() > 1 {
        if let Some(last) = open.pop() {
            attach(&mut open, last);
        }
    }
    let root = open.pop().unwrap_or_default();
    root.children
        .into_iter()
        .find(|child| child.name == "VTKFile")
        .ok_or_else(|| damaged("has no element VTKFile".to_owned()))
}

fn attach(open: &mut [Element], element: Element) {
    if let Some(parent) = open.last_mut() {
        parent.children.push(element);
    }
}

fn element(start: &BytesStart<'_>) -> std::result::Result<Element, String> {
    let mut attributes = BTreeMap::new();
    for attribute in start.attributes() {
        let attribute = attribute.map_err(|error| format!("has a damaged attribute: {error}"))?;
        let key = attribute.key.as_ref().to_owned();
        let value = quick_xml::escape::unescape(&attribute.value)
            .map_err(|error| format!("has a damaged attribute: {error}"))?;
        attributes.insert(key, value.into_owned());
    }
    let name = start.name().as_ref().to_owned();
    Ok(Element { name, attributes, ..Element::default() })
}
