//! Reads the elements of a DICOM file. dicom-rs 0.10 allocates up to 4 GiB for a value before
//! reading it. The lazy reader of dicom-rs therefore locates each value, and its length is compared
//! with the length of the file.

use super::source::{self, PREAMBLE, START, Source};
use dicom_core::value::{DataSetSequence, PixelFragmentSequence};
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::tags;
use dicom_encoding::decode::{Decode, explicit_le::ExplicitVRLittleEndianDecoder};
use dicom_encoding::transfer_syntax::TransferSyntaxIndex;
use dicom_object::{FileMetaTable, InMemDicomObject};
use dicom_parser::StatefulDecode;
use dicom_parser::dataset::{LazyDataToken, lazy_read::LazyDataSetReader};
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Maximum nesting depth of sequences. Structured reports have the deepest nesting in DICOM, about
/// ten sequences. Without a limit, a small file could overflow the stack.
const MAX_DEPTH: usize = 64;

/// Reasons why a file cannot be read.
const BEYOND: &str = "an element extends beyond the end of the file";
const CUT: &str = "the file ends within a sequence";

/// The elements of a DICOM file.
pub(super) struct Elements {
    pub(super) object: InMemDicomObject,
    /// UID of the SOP class and UID of the transfer syntax, from the file meta group. Empty if the
    /// group does not contain them.
    pub(super) class: String,
    pub(super) syntax: String,
    /// Why the file cannot be read completely. `object` then contains the top-level elements
    /// before the damage. A truncated file usually contains the UID of its series.
    pub(super) damage: Option<String>,
}

/// Reads all elements of a file. Without `with_pixels`, the pixel data is checked but not stored.
///
/// # Errors
/// If the file cannot be opened, or its file meta group cannot be read. Later errors are damage.
pub(super) fn read(path: &Path, with_pixels: bool) -> io::Result<Elements> {
    let (mut reader, end) = source::open(path)?;
    let mut elements =
        Elements { object: InMemDicomObject::new_empty(), class: String::new(), syntax: String::new(), damage: None };
    if !meta_group_fits(&mut reader, end)? {
        elements.damage = Some(BEYOND.to_owned());
        return Ok(elements);
    }
    reader.seek(SeekFrom::Start(PREAMBLE as u64))?;
    elements.damage = elements.fill(reader, end, with_pixels).err();
    Ok(elements)
}

impl Elements {
    /// Reads the file meta group and the data set. Fails with the reason.
    fn fill(&mut self, mut reader: BufReader<Box<dyn Source>>, end: u64, with_pixels: bool) -> Result<(), String> {
        let group = FileMetaTable::from_reader(&mut reader).map_err(|error| reason(&error))?;
        let trimmed = |uid: &str| uid.trim_end_matches(['\0', ' ']).to_owned();
        self.class = trimmed(group.media_storage_sop_class_uid());
        self.syntax = trimmed(group.transfer_syntax());
        let syntax = TransferSyntaxRegistry.get(&self.syntax).filter(|syntax| !syntax.is_unsupported());
        let syntax = syntax.ok_or_else(|| format!("its transfer syntax {} is not supported", self.syntax))?;
        let reader = LazyDataSetReader::new_with_ts(reader, syntax).map_err(|error| reason(&error))?;
        DataSet { reader, end, with_pixels }.object(&mut self.object, 0)
    }
}

/// A reader of the remaining elements of a data set.
struct DataSet<S: StatefulDecode> {
    reader: LazyDataSetReader<S>,
    /// Length of the file in bytes.
    end: u64,
    with_pixels: bool,
}

impl<S: StatefulDecode> DataSet<S> {
    /// Returns the next token, or `None` at the end of the file.
    fn next(&mut self) -> Result<Option<LazyDataToken<&mut S>>, String> {
        self.reader.advance().transpose().map_err(|error| reason(&error))
    }

    /// Reads elements into `object` up to the end of the item that contains them, or of the file.
    fn object(&mut self, object: &mut InMemDicomObject, depth: usize) -> Result<(), String> {
        let (end, with_pixels) = (self.end, self.with_pixels);
        while let Some(token) = self.next()? {
            match token {
                LazyDataToken::ElementHeader(_) => {}
                LazyDataToken::LazyValue { header, decoder } => {
                    within(end, decoder, header.len.0)?;
                    if header.tag == tags::PIXEL_DATA && !with_pixels {
                        decoder.skip_bytes(header.len.0).map_err(|error| reason(&error))?;
                    } else {
                        let value = decoder.read_value_preserved(&header).map_err(|error| reason(&error))?;
                        object.put(DataElement::new(header.tag, header.vr, value));
                    }
                }
                LazyDataToken::SequenceStart { .. } if depth == MAX_DEPTH => {
                    return Err(format!("more than {MAX_DEPTH} sequences are nested"));
                }
                LazyDataToken::SequenceStart { tag, .. } => {
                    let items = self.items(depth + 1)?;
                    object.put(DataElement::new(tag, VR::SQ, DataSetSequence::from(items)));
                }
                LazyDataToken::PixelSequenceStart => {
                    let fragments = self.fragments()?;
                    object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, fragments));
                }
                _ if depth > 0 => return Ok(()),
                _ => return Err("an item ends that has no start".to_owned()),
            }
        }
        if depth > 0 { Err(CUT.to_owned()) } else { Ok(()) }
    }

    /// Reads the items of a sequence.
    fn items(&mut self, depth: usize) -> Result<Vec<InMemDicomObject>, String> {
        let mut items = Vec::new();
        while let Some(LazyDataToken::ItemStart { .. }) = self.next()? {
            let mut item = InMemDicomObject::new_empty();
            self.object(&mut item, depth)?;
            items.push(item);
        }
        Ok(items)
    }

    /// Reads compressed pixel data. The first item contains the offset table (PS3.5, section A.4).
    fn fragments(&mut self) -> Result<PixelFragmentSequence<Vec<u8>>, String> {
        let (end, with_pixels) = (self.end, self.with_pixels);
        let mut items = Vec::new();
        loop {
            match self.next()? {
                Some(LazyDataToken::ItemStart { .. }) => items.push(Vec::new()),
                Some(LazyDataToken::LazyItemValue { len, decoder }) => {
                    within(end, decoder, len)?;
                    match items.last_mut().filter(|_| with_pixels) {
                        Some(item) => decoder.read_to_vec(len, item),
                        None => decoder.skip_bytes(len),
                    }
                    .map_err(|error| reason(&error))?;
                }
                Some(LazyDataToken::ItemEnd) => {}
                _ => break,
            }
        }
        let fragments = items.split_off(items.len().min(1));
        let offsets = items.iter().flat_map(|table| table.as_chunks().0).map(|&bytes| u32::from_le_bytes(bytes));
        Ok(PixelFragmentSequence::new(offsets.collect::<Vec<_>>(), fragments))
    }
}

/// Checks that a value of `length` bytes at the position of `decoder` ends within the file.
fn within(end: u64, decoder: &impl StatefulDecode, length: u32) -> Result<(), String> {
    if decoder.position() + u64::from(length) > end { Err(BEYOND.to_owned()) } else { Ok(()) }
}

/// Joins the messages of an error and all its causes.
fn reason(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}

/// Checks that no element of the file meta group extends beyond the end of the file. This group has
/// the same encoding in all files, and its first element contains the length of the group.
fn meta_group_fits(reader: &mut BufReader<Box<dyn Source>>, end: u64) -> io::Result<bool> {
    reader.seek(SeekFrom::Start(START as u64))?;
    let decoder = ExplicitVRLittleEndianDecoder::default();
    let mut group_end = None;
    while group_end.is_none_or(|at| reader.stream_position().is_ok_and(|position| position < at)) {
        let Ok((element, _)) = decoder.decode_header(reader) else { return Ok(true) };
        let Some(length) = element.len.get() else { return Ok(true) };
        let position = reader.stream_position()?;
        if position + u64::from(length) > end {
            return Ok(false);
        }
        if group_end.is_none() {
            let mut bytes = [0; 4];
            if length != 4 || reader.read_exact(&mut bytes).is_err() {
                return Ok(true);
            }
            group_end = Some(position + 4 + u64::from(u32::from_le_bytes(bytes)));
        } else {
            reader.seek_relative(length.into())?;
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns why a file with the given bytes cannot be read completely.
    fn damage(bytes: &[u8]) -> Option<String> {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("slice.dcm");
        std::fs::write(&path, bytes).expect("written");
        read(&path, true).expect("read").damage
    }

    fn lies_within(bytes: &[u8]) -> bool {
        damage(bytes).is_none()
    }

    /// Returns the bytes of a DICOM file: a file meta group with a transfer syntax, followed by
    /// `elements`.
    fn dicom(syntax: &[u8], elements: &[u8]) -> Vec<u8> {
        let mut bytes = [vec![0; 128], b"DICM".to_vec()].concat();
        bytes.extend(b"\x02\x00\x00\x00UL\x04\x00");
        bytes.extend((8 + syntax.len() as u32).to_le_bytes());
        bytes.extend(b"\x02\x00\x10\x00UI");
        bytes.extend((syntax.len() as u16).to_le_bytes());
        bytes.extend(syntax);
        bytes.extend(elements);
        bytes
    }

    /// Found by fuzzing (case 1): an OB element of undefined length that is not pixel data. Its
    /// items are parsed as elements.
    #[test]
    fn elements_in_items_of_ob_values_are_checked() {
        let says = |length: u32| {
            let mut elements = b"\x30\x20\x10\x00OB\x00\x00\xff\xff\xff\xff\xfe\xff\x00\xe0\x0c\x00\x00\x00".to_vec();
            elements.extend(b"\x00\x00\x00\x00OB\x00\x00");
            elements.extend(length.to_le_bytes());
            elements.extend(b"\xfe\xff\xdd\xe0\x00\x00\x00\x00");
            lies_within(&dicom(b"1.2.840.10008.1.2.1\0", &elements))
        };
        assert!(!says(0xff00_0058) && says(0));
    }

    /// Found by fuzzing (case 3): the transfer syntax UID ends with several null bytes. With
    /// explicit VRs, the first length would be parsed as VR `CS` with length 2 and accepted.
    #[test]
    fn null_bytes_at_the_end_of_the_transfer_syntax_are_ignored() {
        let says = |length: u32| {
            let mut elements = b"\x08\x00\x60\x00".to_vec();
            elements.extend(length.to_le_bytes());
            elements.extend([b' '; 0x4353]);
            lies_within(&dicom(b"1.2.840.10008.1.2\0\0\0", &elements))
        };
        assert!(!says(0x0002_5343) && says(0x4352));
    }

    /// Found by fuzzing (case 4): an element inside an item that cannot be parsed.
    #[test]
    fn a_file_with_an_element_that_cannot_be_parsed_is_damaged() {
        assert!(!lies_within(include_bytes!("../../tests/data/found/4.dcm")));
    }

    /// Found by fuzzing (case 5): dicom-rs reads only 12 bytes of a UL value of 15 bytes, and
    /// interprets the other 3 as the start of an element. That element has a length of 4 GiB.
    #[test]
    fn a_long_element_after_an_incomplete_number_is_damage() {
        let mut elements = b"\x00\x00\x00\x00\x0f\x00\x00\x00".to_vec();
        elements.extend([0; 12]);
        elements.extend(b"\x08\x00\x05\x00\xf6\xff\xff\xff");
        elements.extend([b' '; 100]);
        assert_eq!(damage(&dicom(b"1.2.840.10008.1.2\0", &elements)).as_deref(), Some(BEYOND));
    }

    #[test]
    fn sequences_are_not_nested_without_limit() {
        let nested = |count: usize| {
            let start = b"\x08\x00\x15\x11\xff\xff\xff\xff\xfe\xff\x00\xe0\xff\xff\xff\xff";
            dicom(b"1.2.840.10008.1.2\0", &start.repeat(count))
        };
        assert_eq!(damage(&nested(MAX_DEPTH)).as_deref(), Some(CUT));
        let why = damage(&nested(1_000_000)).expect("too deep");
        assert!(why.contains("sequences are nested"), "{why}");
    }

    #[test]
    fn a_long_element_of_the_meta_group_is_damage() {
        let says = |length: u32| {
            let mut bytes = [vec![0; 128], b"DICM".to_vec()].concat();
            bytes.extend(b"\x02\x00\x00\x00UL\x04\x00\xff\x00\x00\x00\x02\x00\x02\x00UN\x00\x00");
            bytes.extend(length.to_le_bytes());
            bytes.extend([0; 8]);
            damage(&bytes).as_deref() == Some(BEYOND)
        };
        assert!(says(9) && !says(8));
    }
}
