//! Checks that no element of a DICOM file extends beyond the end of the file. This check is needed
//! because dicom-rs 0.10 allocates up to 4 GiB for a value before reading it. The check uses the
//! lazy reader of dicom-rs, which locates the elements without reading their values.

use super::source::{self, PREAMBLE, START, Source};
use dicom_dictionary_std::tags;
use dicom_encoding::decode::{Decode, explicit_le::ExplicitVRLittleEndianDecoder};
use dicom_encoding::transfer_syntax::TransferSyntaxIndex;
use dicom_object::FileMetaTable;
use dicom_parser::StatefulDecode;
use dicom_parser::dataset::{LazyDataToken, lazy_read::LazyDataSetReader};
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// The result of traversing a file.
#[derive(Default)]
pub(super) struct Walk {
    /// Whether all elements can be traversed and none of them extends beyond the end of the file.
    /// Also true if the file meta group or the start of the data set cannot be parsed.
    pub(super) is_whole: bool,
    /// UID of the series, if the traversal reaches it. A truncated file usually contains it.
    pub(super) series: Option<String>,
}

/// Traverses the elements of a file.
///
/// # Errors
/// If the file cannot be read.
pub(super) fn walk(path: &Path) -> io::Result<Walk> {
    let (mut reader, end) = source::open(path)?;
    let mut walk = Walk::default();
    if !file_group_lies_within(&mut reader, end)? {
        return Ok(walk);
    }
    reader.seek(SeekFrom::Start(PREAMBLE as u64))?;
    walk.is_whole = true;
    let Ok(group) = FileMetaTable::from_reader(&mut reader) else { return Ok(walk) };
    let Some(syntax) = TransferSyntaxRegistry.get(group.transfer_syntax()) else { return Ok(walk) };
    let Ok(mut elements) = LazyDataSetReader::new_with_ts(reader, syntax) else { return Ok(walk) };
    // number of items that contain the current element
    let mut depth = 0usize;
    while let Some(token) = elements.advance() {
        // reject the file, because the full reader may accept what the lazy reader cannot parse
        let is_read = token.is_ok_and(|token| {
            let (length, position) = match &token {
                LazyDataToken::LazyValue { header, decoder } => (header.len.0, decoder.position()),
                LazyDataToken::LazyItemValue { len, decoder } => (*len, decoder.position()),
                token => {
                    match token {
                        LazyDataToken::ItemStart { .. } => depth += 1,
                        LazyDataToken::ItemEnd => depth = depth.saturating_sub(1),
                        _ => {}
                    }
                    return true;
                }
            };
            match token {
                _ if position + u64::from(length) > end => false,
                LazyDataToken::LazyValue { header, decoder }
                    if depth == 0 && header.tag == tags::SERIES_INSTANCE_UID =>
                {
                    let mut uid = Vec::new();
                    let is_read = decoder.read_to_vec(length, &mut uid).is_ok();
                    walk.series = Some(String::from_utf8_lossy(&uid).trim_matches([' ', '\0']).to_owned());
                    is_read
                }
                token => token.skip().is_ok(),
            }
        });
        if !is_read {
            walk.is_whole = false;
            break;
        }
    }
    Ok(walk)
}

/// Performs the check of [`walk`] on the file meta group. This group has the same encoding
/// in all files, and its first element contains the length of the group.
fn file_group_lies_within(reader: &mut BufReader<Box<dyn Source>>, end: u64) -> io::Result<bool> {
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

    fn lies_within(bytes: &[u8]) -> bool {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("slice.dcm");
        std::fs::write(&path, bytes).expect("written");
        walk(&path).expect("read").is_whole
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

    /// Found by fuzzing (case 1): an OB element of undefined length that is not pixel data.
    /// dicom-rs parses the contents of its items as elements, so the check must do the same.
    #[test]
    fn elements_in_items_of_bytes_lie_within_as_well() {
        let says = |length: u32| {
            let mut elements = b"\x30\x20\x10\x00OB\x00\x00\xff\xff\xff\xff\xfe\xff\x00\xe0\x0c\x00\x00\x00".to_vec();
            elements.extend(b"\x00\x00\x00\x00OB\x00\x00");
            elements.extend(length.to_le_bytes());
            elements.extend(b"\xfe\xff\xdd\xe0\x00\x00\x00\x00");
            lies_within(&dicom(b"1.2.840.10008.1.2.1\0", &elements))
        };
        assert!(!says(0xff00_0058) && says(0));
    }

    /// Found by fuzzing (case 3): the transfer syntax UID ends with several null bytes. dicom-rs
    /// ignores them, so the check must ignore them too.
    #[test]
    fn elements_are_read_as_dicom_rs_reads_them() {
        let says = |length: u32| {
            let mut elements = b"\x08\x00\x60\x00".to_vec();
            elements.extend(length.to_le_bytes());
            elements.extend([b' '; 0x4353]);
            lies_within(&dicom(b"1.2.840.10008.1.2\0\0\0", &elements))
        };
        // with explicit VRs, the first length would be parsed as VR `CS` with length 2 and accepted
        assert!(!says(0x0002_5343) && says(0x4352));
    }

    /// Found by fuzzing (case 4): an element inside an item that the lazy reader cannot parse. The
    /// full reader interprets it as an element of 2 GiB, so the file must be rejected.
    #[test]
    fn what_cannot_be_followed_does_not_lie_within() {
        assert!(!lies_within(include_bytes!("../../tests/data/found/4.dcm")));
    }

    #[test]
    fn elements_of_the_group_of_the_file_lie_within_too() {
        let says = |length: u32| {
            let mut bytes = [vec![0; 128], b"DICM".to_vec()].concat();
            bytes.extend(b"\x02\x00\x00\x00UL\x04\x00\xff\x00\x00\x00\x02\x00\x02\x00UN\x00\x00");
            bytes.extend(length.to_le_bytes());
            bytes.extend([0; 8]);
            lies_within(&bytes)
        };
        assert!(!says(9) && says(8));
    }
}
