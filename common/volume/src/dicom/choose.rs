//! Which series of a folder is meant.

use super::slice::{SeriesName, Slice};
use isoparticles_file::error::{Error, Result};
use isoparticles_file::limit::bad;
use std::collections::BTreeMap;
use std::path::Path;

/// The slices of the series that `wanted` names by its UID, its number or its description, or those of the only series; and how many other
/// series there are.
pub(super) fn choose(folder: &Path, slices: Vec<Slice>, wanted: Option<&str>) -> Result<(Vec<Slice>, usize)> {
    let mut all: BTreeMap<String, Vec<Slice>> = BTreeMap::new();
    for slice in slices {
        all.entry(slice.series.uid.clone()).or_default().push(slice);
    }
    let found: Vec<&String> =
        all.iter().filter(|(_, slices)| is_meant(&slices[0].series, wanted)).map(|(uid, _)| uid).collect();
    let uid = match found.as_slice() {
        [uid] => (*uid).clone(),
        found => return Err(refuse(folder, &all, wanted, found.len())),
    };
    let others = all.len() - 1;
    Ok((all.remove(&uid).unwrap_or_default(), others))
}

fn is_meant(series: &SeriesName, wanted: Option<&str>) -> bool {
    wanted.is_none_or(|wanted| {
        series.uid == wanted || series.number == wanted || series.description.to_lowercase() == wanted.to_lowercase()
    })
}

fn refuse(folder: &Path, all: &BTreeMap<String, Vec<Slice>>, wanted: Option<&str>, found: usize) -> Error {
    if all.is_empty() {
        return bad(
            folder,
            "has DICOM files, but none with an image",
            "a volume is made of images",
            "give the folder that the slices lie in",
        );
    }
    let listed: Vec<String> = all
        .values()
        .map(|slices| {
            let SeriesName { uid, number, description, modality } = &slices[0].series;
            format!("'{description}' ({modality}, number {number}, {} slices, UID {uid})", slices.len())
        })
        .collect();
    let what = match wanted {
        None => format!("holds {found} series"),
        Some(wanted) if found == 0 => format!("holds no series '{wanted}'"),
        Some(wanted) => format!("holds {found} series '{wanted}'"),
    };
    bad(
        folder,
        what,
        "a volume is made from the slices of one series",
        format!("choose one with --series (its description, number or UID): {}", listed.join("; ")),
    )
}
