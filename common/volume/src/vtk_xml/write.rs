//! Writes VTK XML documents with raw appended data.

use super::vtk_name;
use crate::voxels::{Endian, ScalarType, Voxels};
use isoparticles_file::history::History;
use std::fmt::Write as _;
use std::io::{self, Write};

/// The contents of an array.
pub enum Payload<'a> {
    /// Borrowed 32-bit floating-point numbers.
    F32(&'a [f32]),
    /// Borrowed 32-bit floating-point numbers in several parts, which are written consecutively.
    F32Pieces(Vec<&'a [f32]>),
    /// Numbers of any scalar type.
    Values(Voxels),
    /// Borrowed numbers of any scalar type.
    Voxels(&'a Voxels),
    /// A string, written as bytes, because some programs, such as meshio, cannot read VTK's string
    /// type.
    Text(String),
}

impl Payload<'_> {
    fn type_name(&self) -> &'static str {
        match self {
            Self::F32(_) | Self::F32Pieces(_) => "Float32",
            Self::Values(values) => vtk_name(values.scalar_type()),
            Self::Voxels(values) => vtk_name(values.scalar_type()),
            Self::Text(_) => vtk_name(ScalarType::U8),
        }
    }

    fn count(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::F32Pieces(pieces) => pieces.iter().map(|piece| piece.len()).sum(),
            Self::Values(values) => values.len(),
            Self::Voxels(values) => values.len(),
            Self::Text(text) => text.len(),
        }
    }

    fn bytes(&self) -> usize {
        match self {
            Self::F32(_) | Self::F32Pieces(_) => 4 * self.count(),
            Self::Values(values) => values.len() * values.scalar_type().bytes(),
            Self::Voxels(values) => values.len() * values.scalar_type().bytes(),
            Self::Text(text) => text.len(),
        }
    }

    fn write(&self, file: &mut dyn Write) -> io::Result<()> {
        file.write_all(&(self.bytes() as u64).to_le_bytes())?;
        match self {
            Self::F32(values) => write_f32(values, file),
            Self::F32Pieces(pieces) => pieces.iter().try_for_each(|piece| write_f32(piece, file)),
            Self::Values(values) => values.write_to(file, Endian::Little),
            Self::Voxels(values) => values.write_to(file, Endian::Little),
            Self::Text(text) => file.write_all(text.as_bytes()),
        }
    }
}

fn write_f32(values: &[f32], file: &mut dyn Write) -> io::Result<()> {
    // an interrupt takes effect between chunks of 1 MiB
    for chunk in values.chunks(1 << 18) {
        if cfg!(target_endian = "little") {
            file.write_all(bytemuck::cast_slice(chunk))?;
        } else {
            file.write_all(&chunk.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())?;
        }
    }
    Ok(())
}

/// A document under construction: the XML written so far, and the data to append.
pub struct Document<'a> {
    text: String,
    open: Vec<&'static str>,
    payloads: Vec<Payload<'a>>,
    offset: usize,
}

impl<'a> Document<'a> {
    /// Starts a document for a data set of type `data_set`, such as `ImageData`.
    pub fn new(data_set: &str) -> Self {
        let text = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"{data_set}\" version=\"1.0\" byte_order=\"LittleEndian\" \
             header_type=\"UInt64\">\n"
        );
        Self { text, open: Vec::new(), payloads: Vec::new(), offset: 0 }
    }

    /// Opens an element.
    pub fn open(&mut self, name: &'static str, attributes: &[(&str, String)]) {
        self.indent();
        self.text.push('<');
        self.text.push_str(name);
        for (key, value) in attributes {
            // writing to a string cannot fail
            let _ = write!(self.text, " {key}=\"{}\"", escape(value));
        }
        self.text.push_str(">\n");
        self.open.push(name);
    }

    /// Closes the innermost element.
    pub fn close(&mut self) {
        if let Some(name) = self.open.pop() {
            self.indent();
            let _ = writeln!(self.text, "</{name}>");
        }
    }

    /// Adds an array that has `components` numbers per tuple.
    pub fn array(&mut self, name: &str, components: usize, payload: Payload<'a>) {
        self.indent();
        let _ = write!(self.text, "<DataArray type=\"{}\" Name=\"{}\"", payload.type_name(), escape(name));
        if self.open.last() == Some(&"FieldData") {
            let _ = write!(self.text, " NumberOfTuples=\"{}\"", payload.count() / components.max(1));
        }
        if components > 1 {
            let _ = write!(self.text, " NumberOfComponents=\"{components}\"");
        }
        let _ = writeln!(self.text, " format=\"appended\" offset=\"{}\"/>", self.offset);
        self.offset += 8 + payload.bytes();
        self.payloads.push(payload);
    }

    /// Adds the field data that every file of this project contains: kind, format version, strings
    /// and history, if there is one.
    pub fn identity(&mut self, kind: &str, version: u32, texts: &[(&str, String)], history: Option<&History>) {
        self.identity_with(kind, version, texts, Vec::new(), history);
    }

    /// Adds the same field data as [`Document::identity`] and additional arrays.
    pub fn identity_with(
        &mut self,
        kind: &str,
        version: u32,
        texts: &[(&str, String)],
        arrays: Vec<(&str, Payload<'a>)>,
        history: Option<&History>,
    ) {
        self.open("FieldData", &[]);
        self.array("isoparticles_kind", 1, Payload::Text(kind.to_owned()));
        self.array("isoparticles_format", 1, Payload::Values(Voxels::U32(vec![version])));
        for (name, text) in texts {
            self.array(name, 1, Payload::Text(text.clone()));
        }
        for (name, payload) in arrays {
            self.array(name, 1, payload);
        }
        if let Some(history) = history {
            self.array("history", 1, Payload::Text(ascii_json(history)));
        }
        self.close();
    }

    /// Closes all open elements and writes the document.
    pub fn write(mut self, file: &mut dyn Write) -> io::Result<()> {
        while !self.open.is_empty() {
            self.close();
        }
        file.write_all(self.text.as_bytes())?;
        file.write_all(b"  <AppendedData encoding=\"raw\">\n   _")?;
        for payload in &self.payloads {
            payload.write(file)?;
        }
        file.write_all(b"\n  </AppendedData>\n</VTKFile>\n")
    }

    fn indent(&mut self) {
        for _ in 0..=self.open.len() {
            self.text.push_str("  ");
        }
    }
}

/// Serializes a value as ASCII-only JSON, which all readers of VTK strings support.
pub fn ascii_json(value: &impl serde::Serialize) -> String {
    // Serialization cannot fail: all keys are strings, and serde_json writes non-finite numbers as
    // null.
    let json = serde_json::to_string(value).unwrap_or_else(|_| "null".to_owned());
    let mut text = String::with_capacity(json.len());
    for c in json.chars() {
        if c.is_ascii() {
            text.push(c);
        } else {
            // in JSON, non-ASCII characters occur only in strings
            for unit in c.encode_utf16(&mut [0; 2]) {
                let _ = write!(text, "\\u{unit:04x}");
            }
        }
    }
    text
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
