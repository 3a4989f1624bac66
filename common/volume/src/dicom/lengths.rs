//! Whether the elements of a DICOM file lie within it: dicom-rs 0.10 takes the memory for an element before it reads it, up to 4 GiB.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

/// Bytes before the first element: the preamble and the letters DICM.
const START: i64 = 132;
/// A length that is not given: the element ends with a delimiter.
const UNDEFINED: u32 = u32::MAX;
/// Kinds of values whose length has two bytes. That of all others has four, behind two that are reserved; dicom-rs takes kinds that it does
/// not know in the same way.
const SHORT: [&[u8; 2]; 21] = [
    b"AE", b"AS", b"AT", b"CS", b"DA", b"DS", b"DT", b"FD", b"FL", b"IS", b"LO", b"LT", b"PN", b"SH", b"SL", b"SS",
    b"ST", b"TM", b"UI", b"UL", b"US",
];

/// Known kinds of values whose length has four bytes, but sequences and the unknown (UN). Where their length is not given, dicom-rs looks for
/// items in them, and for elements in those.
const LONG: [&[u8; 2]; 11] = [b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SV", b"UC", b"UR", b"UT", b"UV"];

/// How the elements behind the file's own group are written, by the transfer syntax.
#[derive(Clone, Copy, PartialEq)]
struct Form {
    is_explicit: bool,
    is_big: bool,
}

impl Form {
    fn of(syntax: &[u8]) -> Self {
        match syntax.trim_ascii_end().strip_suffix(b"\0").unwrap_or(syntax) {
            b"1.2.840.10008.1.2" => Self { is_explicit: false, is_big: false },
            b"1.2.840.10008.1.2.2" => Self { is_explicit: true, is_big: true },
            _ => Self { is_explicit: true, is_big: false },
        }
    }

    fn short(self, bytes: [u8; 2]) -> u16 {
        if self.is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }

    fn long(self, bytes: [u8; 4]) -> u32 {
        if self.is_big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }
}

/// Whether no element promises more bytes than the file has. What ends early or is damaged in another way is left to dicom-rs.
///
/// # Errors
/// When the file cannot be read.
pub(super) fn lie_within(path: &Path) -> io::Result<bool> {
    let file = File::open(path)?;
    let mut left = (file.metadata()?.len() as i64 - START).max(0);
    let mut reader = BufReader::new(file);
    reader.seek_relative(START)?;
    let mut form = Form { is_explicit: true, is_big: false };
    let mut syntax = Vec::new();
    let mut in_file_group = true;
    let mut in_pixels = false;
    loop {
        let mut head = [0; 8];
        if left < 8 {
            return Ok(true);
        }
        reader.read_exact(&mut head)?;
        left -= 8;
        let [a, b, c, d, e, f, g, h] = head;
        if in_file_group && [a, b] != [2, 0] {
            (in_file_group, form) = (false, Form::of(&syntax));
        }
        let tag = (form.short([a, b]), form.short([c, d]));
        let kind = [e, f];
        let is_delimiter = tag.0 == 0xfffe;
        let length = if is_delimiter || !form.is_explicit {
            form.long([e, f, g, h])
        } else if SHORT.contains(&&kind) {
            form.short([g, h]).into()
        } else {
            let mut length = [0; 4];
            if left < 4 {
                return Ok(true);
            }
            reader.read_exact(&mut length)?;
            left -= 4;
            form.long(length)
        };
        let is_pixels = tag == (0x7fe0, 0x0010);
        in_pixels |= is_pixels;
        if length == UNDEFINED {
            // what is in an element of unknown kind is written in another form
            let is_known = &kind == b"SQ" || LONG.contains(&&kind);
            if form.is_explicit && !is_delimiter && !is_pixels && !is_known {
                return Ok(true);
            }
            continue;
        }
        let length = i64::from(length);
        if length > left {
            return Ok(false);
        }
        if tag == (2, 0x10) {
            syntax = vec![0; length as usize];
            reader.read_exact(&mut syntax)?;
            left -= length;
            continue;
        }
        // the elements in an item and in a sequence come next; the pieces of encoded pixels hold none
        let is_sequence = match form.is_explicit {
            true => &kind == b"SQ",
            false => reader.fill_buf()?.starts_with(&[0xfe, 0xff, 0x00, 0xe0]),
        };
        if !in_pixels && (is_delimiter || is_sequence) {
            continue;
        }
        reader.seek_relative(length)?;
        left -= length;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fuzzing, 1: bytes of no given length under another tag than that of pixels, in whose items dicom-rs reads elements.
    #[test]
    fn elements_in_items_of_bytes_lie_within_as_well() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("slice.dcm");
        let says = |length: u32| {
            let mut bytes = [vec![0; 128], b"DICM".to_vec()].concat();
            bytes.extend(b"\x02\x00\x10\x00UI\x14\x001.2.840.10008.1.2.1\x00");
            bytes.extend(b"\x30\x20\x10\x00OB\x00\x00\xff\xff\xff\xff\xfe\xff\x00\xe0\x0c\x00\x00\x00");
            bytes.extend(b"\x00\x00\x00\x00\xfe\xff\x00\xe0");
            bytes.extend(length.to_le_bytes());
            bytes.extend([0; 8]);
            std::fs::write(&path, &bytes).expect("written");
            lie_within(&path).expect("read")
        };
        assert!(!says(0xff00_0058) && says(8));
    }
}
