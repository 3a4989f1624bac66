//! Reads the segments of a 3D Slicer segmentation (`.seg.nrrd`). Each segment is described by
//! key/value pairs such as `Segment0_Name`, `Segment0_LabelValue` and `Segment0_Layer`.

use super::header::{Header, field_error};
use crate::error::Result;
use crate::error::bad;
use crate::segments::{LayerLabel, Segment};
use std::path::Path;

/// Returns whether the header contains segments.
pub(super) fn is_segmentation(header: &Header) -> bool {
    header.pairs.keys().any(|key| number_of(key).is_some())
}

/// Returns the segment number in a key such as `Segment12_Name`.
fn number_of(key: &str) -> Option<u64> {
    key.strip_prefix("Segment")?.strip_suffix("_Name")?.parse().ok()
}

/// Returns the segments of a file with `layers` layers, sorted by segment number. Files from
/// versions of 3D Slicer before 4.11 contain neither label values nor layer numbers; each of their
/// segments has label 1 in a layer of its own.
pub(super) fn segments(path: &Path, header: &Header, layers: usize) -> Result<Vec<Segment>> {
    let mut numbers: Vec<u64> = header.pairs.keys().filter_map(|key| number_of(key)).collect();
    numbers.sort_unstable();
    let mut segments = Vec::new();
    for (position, number) in numbers.into_iter().enumerate() {
        let value = |key: &str| {
            let key = format!("Segment{number}_{key}");
            header.pairs.get(&key).map(|text| (key, text.trim()))
        };
        let label = match value("LabelValue") {
            Some((key, text)) => text.parse().map_err(|_| field_error(path, &key, text))?,
            None => 1,
        };
        let layer = match value("Layer") {
            Some((key, text)) => text.parse().map_err(|_| field_error(path, &key, text))?,
            None if layers == 1 => 0,
            None => position,
        };
        let name = value("Name").map_or("", |(_, name)| name).to_owned();
        if layer >= layers {
            return Err(bad(
                path,
                format!("puts the segment '{name}' into layer {layer} of {layers}"),
                "this layer does not exist",
                "write the segmentation again",
            ));
        }
        segments.push(Segment { name, at: LayerLabel { layer, label } });
    }
    Ok(segments)
}
