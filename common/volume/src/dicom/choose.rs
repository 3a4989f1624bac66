//! Which series of a folder is meant.

use super::slice::{Picture, SeriesName, Slice};
use crate::error::bad;
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// The images of a series that are of one kind of DICOM object: what a stack is made of.
type Group = Vec<Picture>;

/// The slices that are meant, their kind of DICOM object, and remarks on what was passed over.
/// `wanted` names a series by its UID, its number or its description. Where several are meant, the
/// only one that is a stack of slices is taken.
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

/// Whether all images are slices, and several.
fn is_stack(group: &Group) -> bool {
    group.len() > 1 && group.iter().all(|picture| picture.slice.is_ok())
}

/// A series in words, with what keeps it from being a stack.
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
            "a volume is made of images",
            "give the folder that the slices lie in",
        );
    }
    let listed = groups.iter().map(described).collect();
    Error::Series { path: folder.to_path_buf(), wanted: wanted.map(str::to_owned), matching: found, present: listed }
}
