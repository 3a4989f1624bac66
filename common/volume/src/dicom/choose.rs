//! Sorts the contents of DICOM files into groups, and chooses the group to read.

use super::picture::{Content, Picture, SeriesName};
use super::slice::{self, Slice};
use crate::error::bad;
use crate::error::{Error, Result};
use dicom_object::Tag;
use std::collections::BTreeMap;
use std::path::Path;

/// The contents that form one volume: a segmentation, a structure set, or the slices of one series
/// that have the same SOP class. If the frames of a series differ along a dimension such as time,
/// each part of the series is a group.
pub(super) struct Group {
    pub(super) class: String,
    pub(super) series: SeriesName,
    files: usize,
    pub(super) content: Result<Content>,
}

/// Indices along the dimensions that separate the parts of a series.
type Part = Vec<(Tag, u32)>;

/// Returns the groups of all files, sorted by the UID of the series.
pub(super) fn groups(pictures: Vec<Picture>) -> Vec<Group> {
    let mut series: BTreeMap<(String, String), Vec<Picture>> = BTreeMap::new();
    for picture in pictures {
        series.entry((picture.series.uid.clone(), picture.class.clone())).or_default().push(picture);
    }
    let mut groups = Vec::new();
    for pictures in series.into_values() {
        let (name, class) = (pictures[0].series.clone(), pictures[0].class.clone());
        let (mut parts, mut problem, mut others): (BTreeMap<Part, Vec<Slice>>, _, _) =
            (BTreeMap::new(), None, Vec::new());
        let files = pictures.len();
        for picture in pictures {
            match picture.content {
                Ok(Content::Slices(slices)) => {
                    slices.into_iter().for_each(|slice| parts.entry(slice.part.clone()).or_default().push(slice));
                }
                Ok(other) => others.push(other),
                Err(error) => problem = problem.or(Some(error)),
            }
        }
        let group =
            |content: Result<Content>, files| Group { class: class.clone(), series: name.clone(), files, content };
        groups.extend(others.into_iter().map(|content| group(Ok(content), 1)));
        if let Some(error) = problem {
            groups.push(group(Err(error), files));
            continue;
        }
        let count = parts.len();
        for (n, (part, slices)) in parts.into_iter().enumerate() {
            let mut group = group(Ok(Content::Slices(slices)), files);
            if count > 1 {
                group.series.number = format!("{}.{}", name.number, n + 1);
                group.series.description = format!("{}, {}", name.description, slice::described(&part));
            }
            groups.push(group);
        }
    }
    groups
}

/// Removes the chosen group from `groups` and returns it. `wanted` is the UID, number or
/// description of a series. If several groups match, exactly one of them must form a stack of
/// slices or, if none does, be a segmentation or a structure set.
///
/// # Errors
/// If no group matches, or if the choice is ambiguous.
pub(super) fn choose(path: &Path, groups: &mut Vec<Group>, wanted: Option<&str>) -> Result<Group> {
    let having = |among: &[usize], holds: &dyn Fn(&Group) -> bool| -> Vec<usize> {
        among.iter().copied().filter(|&n| holds(&groups[n])).collect()
    };
    let all: Vec<usize> = (0..groups.len()).collect();
    let meant = having(&all, &|group| is_meant(&group.series, wanted));
    let stacks = having(&meant, &|group| matches!(&group.content, Ok(Content::Slices(slices)) if slices.len() > 1));
    let labels =
        having(&meant, &|group| matches!(&group.content, Ok(content) if !matches!(content, Content::Slices(_))));
    let chosen = match (meant.as_slice(), stacks.as_slice(), labels.as_slice()) {
        ([one], _, _) | (_, [one], _) | (_, [], [one]) => *one,
        (_, [], []) => return Err(refuse(path, groups, wanted, meant.len())),
        (_, [], labels) => return Err(refuse(path, groups, wanted, labels.len())),
        (_, stacks, _) => return Err(refuse(path, groups, wanted, stacks.len())),
    };
    Ok(groups.remove(chosen))
}

/// Returns remarks on the groups that were left out.
pub(super) fn left_out(groups: &[Group]) -> impl Iterator<Item = String> {
    groups.iter().map(|group| format!("another series in the folder was left out: {}", described(group)))
}

fn is_meant(series: &SeriesName, wanted: Option<&str>) -> bool {
    wanted.is_none_or(|wanted| {
        series.uid == wanted || series.number == wanted || series.description.to_lowercase() == wanted.to_lowercase()
    })
}

/// Describes a group. If no volume can be made from it, the description includes the reason.
fn described(group: &Group) -> String {
    let SeriesName { uid, number, description, modality, .. } = &group.series;
    let (frames, why) = match &group.content {
        Ok(Content::Slices(slices)) if slices.len() != group.files => {
            (format!(", {} frames", slices.len()), String::new())
        }
        Ok(_) => (String::new(), String::new()),
        Err(error) => (String::new(), format!(": {error}")),
    };
    let files = if group.files == 1 { "file" } else { "files" };
    format!("'{description}' ({modality}, number {number}, {} {files}{frames}, UID {uid}){why}", group.files)
}

fn refuse(path: &Path, groups: &[Group], wanted: Option<&str>, found: usize) -> Error {
    if groups.is_empty() {
        return bad(
            path,
            "has DICOM files, but none with an image",
            "a volume is made from images",
            "use the folder that contains the slices",
        );
    }
    let listed = groups.iter().map(described).collect();
    Error::Series { path: path.to_path_buf(), wanted: wanted.map(str::to_owned), matching: found, present: listed }
}
