//! Reads label names from the extensions of a NIfTI header. The names are stored in a label table
//! in the format of Connectome Workbench, which TotalSegmentator also writes.
//!
//! An extension consists of its length in bytes (32 bits), a code (32 bits) and a string. The code
//! is ignored, because the two programs use different codes. The table is XML: `<Label Key="5"
//! ...>liver</Label>`.

use crate::segments::{LayerLabel, Segment};
use crate::voxels::Endian;
use quick_xml::events::Event;

/// Size in bytes of the length and code of an extension, 4 bytes each.
const HEAD_BYTES: usize = 8;

/// Returns the label names in all extensions. `bytes` are the bytes between the header and the
/// voxels; the first byte is nonzero if there are extensions. Adds a remark for a table that cannot
/// be parsed.
pub(super) fn names(bytes: &[u8], endian: Endian, remarks: &mut Vec<String>) -> Vec<Segment> {
    let mut segments = Vec::new();
    let Some((flag, mut rest)) = bytes.split_at_checked(4) else { return segments };
    if flag[0] == 0 {
        return segments;
    }
    while let Some(head) = rest.first_chunk::<4>() {
        let length = match endian {
            Endian::Little => u32::from_le_bytes(*head),
            Endian::Big => u32::from_be_bytes(*head),
        } as usize;
        let Some(extension) = rest.get(HEAD_BYTES..length) else { break };
        rest = &rest[length..];
        let text = String::from_utf8_lossy(extension);
        if text.contains("<LabelTable") {
            match table(text.trim_end_matches('\0')) {
                Ok(found) => segments.extend(found),
                Err(why) => remarks.push(format!("the label names in the header extension cannot be read: {why}")),
            }
        }
    }
    segments
}

/// Returns the labels of a table that have both a number and a name.
fn table(text: &str) -> Result<Vec<Segment>, String> {
    let mut reader = quick_xml::Reader::from_str(text);
    let (mut segments, mut open): (Vec<Segment>, Option<(Option<i64>, String)>) = (Vec::new(), None);
    loop {
        match reader.read_event().map_err(|error| error.to_string())? {
            Event::Start(start) if start.name().as_ref() == "Label" => {
                let key = start.try_get_attribute("Key").map_err(|error| error.to_string())?;
                open = Some((key.and_then(|key| key.value.trim().parse().ok()), String::new()));
            }
            Event::Text(piece) => open.iter_mut().for_each(|(_, name)| name.push_str(&piece)),
            Event::CData(piece) => open.iter_mut().for_each(|(_, name)| name.push_str(&piece)),
            Event::End(end) if end.name().as_ref() == "Label" => {
                if let Some((Some(label), name)) = open.take()
                    && !name.trim().is_empty()
                {
                    segments.push(Segment { name: name.trim().to_owned(), at: LayerLabel { layer: 0, label } });
                }
            }
            Event::Eof => return Ok(segments),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &str = r#"<?xml version="1.0" encoding="UTF-8"?> <CaretExtension> <VolumeInformation Index="0"> <LabelTable>
        <Label Key="1" Red="0.2" Green="0.1" Blue="0.9" Alpha="1"><![CDATA[kidney <left>]]></Label>
        <Label Red="1">no number</Label><Label Key="2"> liver
        </Label><Label Key="3"></Label></LabelTable></VolumeInformation></CaretExtension>"#;

    fn extension(text: &str, endian: Endian) -> Vec<u8> {
        let length = (HEAD_BYTES + text.len()).next_multiple_of(16) as u32;
        let numbers = [length, 30].map(|n| if endian == Endian::Big { n.to_be_bytes() } else { n.to_le_bytes() });
        let mut bytes = [numbers.concat(), text.as_bytes().to_vec()].concat();
        bytes.resize(length as usize, 0);
        bytes
    }

    #[test]
    fn names_stand_in_any_extension() {
        for endian in [Endian::Little, Endian::Big] {
            let mut remarks = Vec::new();
            let bytes = [vec![1, 0, 0, 0], extension("made by hand", endian), extension(TABLE, endian)].concat();
            let found = names(&bytes, endian, &mut remarks);
            let told: Vec<_> = found.iter().map(|own| (own.name.as_str(), own.at.label)).collect();
            assert_eq!(told, [("kidney <left>", 1), ("liver", 2)]);
            assert!(remarks.is_empty());
            let silent = [vec![0; 4], extension(TABLE, endian)].concat();
            assert!(names(&silent, endian, &mut remarks).is_empty());
            // truncate the extensions at every position
            (0..bytes.len()).for_each(|end| assert!(names(&bytes[..end], endian, &mut remarks).is_empty(), "{end}"));
        }
    }

    #[test]
    fn a_damaged_table_is_told() {
        let mut remarks = Vec::new();
        let damaged = TABLE.replace("</LabelTable>", "</Label></Table>");
        let bytes = [vec![1, 0, 0, 0], extension(&damaged, Endian::Little)].concat();
        assert!(names(&bytes, Endian::Little, &mut remarks).is_empty());
        assert_eq!(remarks.len(), 1, "{remarks:?}");
        // extensions shorter than their own length and code, or longer than the data, are ignored
        for length in [0u32, 7, 4_000_000_000] {
            let bytes = [&[1, 0, 0, 0][..], &length.to_le_bytes(), &[0; 12]].concat();
            assert!(names(&bytes, Endian::Little, &mut remarks).is_empty());
        }
    }
}
