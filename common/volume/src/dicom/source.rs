//! Opens DICOM files for reading. Prepends the preamble, the letters DICM and the file meta group
//! (PS3.10, section 7) if they are missing.

use dicom_dictionary_std::uids;
use std::fs::File;
use std::io::{self, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// Length in bytes of the preamble, whose contents are arbitrary.
pub(super) const PREAMBLE: usize = 128;
/// Length in bytes of the preamble and the letters DICM that follow it.
pub(super) const START: usize = PREAMBLE + 4;

/// First bytes of the file meta group: the tag (0002,0000) in little-endian order.
const FILE_GROUP: &[u8] = &[2, 0, 0, 0];
/// First bytes of a data set: the group number 0008 in little-endian order.
const FIRST_GROUP: &[u8] = &[8, 0];

/// Maximum length in bytes of the first value in a data set. UIDs, the longest identifiers in group
/// 0008, have at most 64 bytes (PS3.5, table 6.2-1).
const LARGEST_LENGTH: u8 = 64;

/// Returns the bytes to prepend to a file that begins with `start`, or `None` if it is not a DICOM
/// file. A data set without a file meta group is assumed to be little-endian, with explicit or
/// implicit VRs (value representations).
pub(super) fn missing(start: &[u8]) -> Option<Vec<u8>> {
    let preamble = || vec![0; PREAMBLE];
    if start.get(PREAMBLE..START) == Some(b"DICM") {
        return Some(Vec::new());
    }
    if start.starts_with(b"DICM") {
        return Some(preamble());
    }
    let whole = [preamble(), b"DICM".to_vec()].concat();
    if start.starts_with(FILE_GROUP) && start.get(4..6) == Some(b"UL") {
        return Some(whole);
    }
    let begins = start.starts_with(FIRST_GROUP) && start.get(3) == Some(&0);
    let syntax = match start.get(4..8).filter(|_| begins)? {
        [a, b, length, 0] if a.is_ascii_uppercase() && b.is_ascii_uppercase() && *length <= LARGEST_LENGTH => {
            uids::EXPLICIT_VR_LITTLE_ENDIAN
        }
        [length, 0, 0, 0] if *length <= LARGEST_LENGTH => uids::IMPLICIT_VR_LITTLE_ENDIAN,
        _ => return None,
    };
    Some([whole, file_group(syntax)].concat())
}

/// Returns a file meta group that contains only the transfer syntax.
fn file_group(syntax: &str) -> Vec<u8> {
    let mut name = syntax.as_bytes().to_vec();
    name.resize(name.len().next_multiple_of(2), 0);
    let mut element = b"\x02\x00\x10\x00UI".to_vec();
    element.extend((name.len() as u16).to_le_bytes());
    element.extend(name);
    let length = (element.len() as u32).to_le_bytes();
    [b"\x02\x00\x00\x00UL\x04\x00", &length[..], &element].concat()
}

/// A source from which dicom-rs can read.
pub(super) trait Source: Read + Seek {}
impl<T: Read + Seek> Source for T {}

/// A file with missing bytes prepended.
struct Prefixed {
    prefix: Cursor<Vec<u8>>,
    file: File,
}

impl Read for Prefixed {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        // fill the buffer from both parts, because dicom-rs looks for the letters DICM in one read
        let count = self.prefix.read(to)?;
        Ok(count + self.file.read(&mut to[count..])?)
    }
}

impl Seek for Prefixed {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let length = self.prefix.get_ref().len() as u64;
        let position = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::Current(change) => {
                let position = self.prefix.position() + self.file.stream_position()?;
                position.checked_add_signed(change)
            }
            SeekFrom::End(change) => (length + self.file.metadata()?.len()).checked_add_signed(change),
        };
        let position = position.ok_or(io::ErrorKind::InvalidInput)?;
        self.prefix.set_position(position.min(length));
        self.file.seek(SeekFrom::Start(position.saturating_sub(length)))?;
        Ok(position)
    }
}

/// Opens a file. Returns a reader and the total number of bytes, including those prepended.
pub(super) fn open(path: &Path) -> io::Result<(BufReader<Box<dyn Source>>, u64)> {
    let mut file = File::open(path)?;
    let mut start = Vec::new();
    Read::take(&mut file, START as u64).read_to_end(&mut start)?;
    file.seek(SeekFrom::Start(0))?;
    let prefix = missing(&start).unwrap_or_default();
    let end = prefix.len() as u64 + file.metadata()?.len();
    let source: Box<dyn Source> =
        if prefix.is_empty() { Box::new(file) } else { Box::new(Prefixed { prefix: Cursor::new(prefix), file }) };
    Ok((BufReader::new(source), end))
}
