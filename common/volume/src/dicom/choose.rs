//! Chooses the series to read from a folder of DICOM images.

use super::slice::{Picture, SeriesName, Slice};
use crate::error::bad;
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// The images of one series that have the same SOP class. A stack is built from a single group.
type Group = Vec<Picture>;

/// Returns the slices of the chosen series, their SOP class, and remarks on the series that were
/// left out. `wanted` is the UID, number or description of a series. If several groups match,
/// exactly one of them must form a stack of slices.
///
/// # Errors
/// If no group matches, if several groups match and none or more than one of them forms a stack, or
/// if an image of the chosen group is not a slice.
pub(super) fn choose(
    folder: &Path,
    pictures: Vec<Picture>,
    wanted: Option<&str>,
) -> Result<(Vec<Slice>, String, Vec<String>)> {
    let mut all: BTreeMap<(String, String), Group> = BTreeMap::new();
    for picture in pictures {
        all.entry((picture.series.uid.clone(), picture.class.clone())).or_default().push(picture);
    }
    let groups: Vec<Group> = all.into_values().collect();
    let meant: Vec<usize> = (0..groups.len()).filter(|&n| is_meant(&groups[n][0].series, wanted)).collect();
    let stacks: Vec<usize> = meant.iter().copied().filter(|&n| is_stack(&groups[n])).collect();
    let chosen = match (meant.as_slice(), stacks.as_slice()) {
        ([one], _) | (_, [one]) => *one,
        (_, []) => return Err(refuse(folder, &groups, wanted, meant.len())),
        _ => return Err(refuse(folder, &groups, wanted, stacks.len())),
    };
    let (mut slices, mut class, mut remarks) = (Vec::new(), String::new(), Vec::new());
    for (n, group) in groups.into_iter().enumerate() {
        if n == chosen {
            class = group[0].class.clone();
            slices = group.into_iter().map(|picture| picture.slice).collect::<Result<_>>()?;
        } else {
            remarks.push(format!("another series in the folder was left out: {}", described(&group)));
        }
    }
    Ok((slices, class, remarks))
}

fn is_meant(series: &SeriesName, wanted: Option<&str>) -> bool {
    wanted.is_none_or(|wanted| {
        series.uid == wanted || series.number == wanted || series.description.to_lowercase() == wanted.to_lowercase()
    })
}

/// Returns whether the group contains several images, all of which are slices.
fn is_stack(group: &Group) -> bool {
    group.len() > 1 && group.iter().all(|picture| picture.slice.is_ok())
}

/// Describes a series. If an image is not a slice, the description includes the error for the first
/// such image.
fn described(group: &Group) -> String {
    let SeriesName { uid, number, description, modality } = &group[0].series;
    let why = group.iter().find_map(|picture| picture.slice.as_ref().err());
    let why = why.map_or_else(String::new, |error| format!(": {error}"));
    format!("'{description}' ({modality}, number {number}, {} files, UID {uid}){why}", group.len())
}

fn refuse(folder: &Path, groups: &[Group], wanted: Option<&str>, found: usize) -> Error {
    if groups.is_empty() {
        return bad(
            folder,
            "has DICOM files, but none with an image",
            "a volume is made from images",
            "use the folder that contains the slices",
        );
    }
    let listed = groups.iter().map(described).collect();
    Error::Series { path: folder.to_path_buf(), wanted: wanted.map(str::to_owned), matching: found, present: listed }
}
