//! Parses and resolves labels given by the user: `1,2`, `2..5`, `all`, or names from the file.

use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::{LayerLabel, Volume};
use std::str::FromStr;

/// Maximum number of labels listed in an error message or a description. Forty labels fill a
/// screen. If there are more, a description lists the largest ones.
pub(crate) const MOST_LISTED: usize = 40;

/// A selection of labels, as specified by the user. [`Selection::resolve`] finds the labels in a
/// volume.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    text: String,
}

impl FromStr for Selection {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if text.trim().trim_matches(',').is_empty() {
            return Err("names no label: give numbers, ranges such as 2..5, names, or all".into());
        }
        Ok(Self { text: text.trim().to_owned() })
    }
}

impl std::fmt::Display for Selection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

/// One part of a selection.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Item {
    All,
    Number(i64),
    Range(i64, i64),
    Name(String),
}

/// Returns the labels as JSON for the output file: plain numbers if the volume has one layer, and
/// pairs of layer and label otherwise.
#[must_use]
pub fn noted(labels: &[LayerLabel], volume: &Volume) -> serde_json::Value {
    if volume.layer_count() == 1 { labels.iter().map(|at| at.label).collect() } else { serde_json::json!(labels) }
}

impl Selection {
    /// Returns the selected labels in the order of the selection, without duplicates.
    ///
    /// # Errors
    /// If no voxel has the given label, range or name, or if a voxel value is not a valid label.
    pub fn resolve(&self, volume: &Volume) -> Result<Vec<LayerLabel>> {
        let present = volume.label_set()?;
        let mut chosen: Vec<LayerLabel> = Vec::new();
        let mut missing = Vec::new();
        for item in self.items(volume) {
            let found: Vec<LayerLabel> = match &item {
                Item::All => present.iter().copied().filter(|at| at.label != 0).collect(),
                Item::Range(first, last) => {
                    present.iter().copied().filter(|at| (*first..=*last).contains(&at.label)).collect()
                }
                Item::Number(label) => match volume.label_numbered(*label)? {
                    at if present.contains(&at) => vec![at],
                    _ => Vec::new(),
                },
                Item::Name(name) => {
                    let at = named(name, volume, &present)?;
                    present.iter().copied().filter(|other| *other == at).collect()
                }
            };
            if found.is_empty() {
                missing.push(item);
            }
            let new: Vec<LayerLabel> = found.into_iter().filter(|at| !chosen.contains(at)).collect();
            chosen.extend(new);
        }
        if missing.is_empty() { Ok(chosen) } else { Err(missing_error(&missing, volume, &present)) }
    }

    /// Splits the selection at commas. A piece that is not a name in the file is also split at
    /// spaces if all its words are numbers, ranges, `all` or names in the file.
    fn items(&self, volume: &Volume) -> Vec<Item> {
        let is_name = |text: &str| {
            let lower = text.to_lowercase();
            volume.segments.iter().any(|segment| segment.name.to_lowercase() == lower)
        };
        let mut items = Vec::new();
        for piece in self.text.split(',').map(str::trim).filter(|piece| !piece.is_empty()) {
            let words: Vec<Item> = piece.split_whitespace().map(item).collect();
            let is_plain = words.iter().all(|word| !matches!(word, Item::Name(_)));
            let are_names =
                || piece.split_whitespace().all(|word| is_name(word) || !matches!(item(word), Item::Name(_)));
            if is_name(piece) {
                items.push(Item::Name(piece.to_owned()));
            } else if is_plain || are_names() {
                items.extend(words);
            } else {
                items.push(item(piece));
            }
        }
        items
    }
}

/// Parses a word as a number, a range or `all`. Any other word is a name.
fn item(word: &str) -> Item {
    if word.eq_ignore_ascii_case("all") {
        return Item::All;
    }
    if let Ok(label) = word.parse() {
        return Item::Number(label);
    }
    let ends =
        word.split_once("..").map(|(first, last)| (first.trim().parse(), last.trim_start_matches('=').trim().parse()));
    match ends {
        Some((Ok(first), Ok(last))) => Item::Range(first, last),
        _ => Item::Name(word.to_owned()),
    }
}

fn named(name: &str, volume: &Volume, present: &[LayerLabel]) -> Result<LayerLabel> {
    let error = match volume.segment_named(name) {
        Ok(at) => return Ok(at),
        Err(error) => Error::from(error),
    };
    let nearest = volume
        .segments
        .iter()
        .map(|segment| (distance(&segment.name.to_lowercase(), &name.to_lowercase()), segment))
        .min_by_key(|(distance, _)| *distance)
        // a name that differs in more than a third of its letters is not suggested
        .filter(|(distance, segment)| 3 * distance <= segment.name.chars().count().max(name.chars().count()));
    let next = match nearest {
        Some((_, segment)) => format!("did you mean '{}'? Labels: {}", segment.name, listed(volume, present)),
        None => format!("choose among the labels: {}", listed(volume, present)),
    };
    Err(Error { next, ..error })
}

fn missing_error(missing: &[Item], volume: &Volume, present: &[LayerLabel]) -> Error {
    let told: Vec<String> = missing
        .iter()
        .map(|item| match item {
            Item::All => "other than 0".to_owned(),
            Item::Number(label) => label.to_string(),
            Item::Range(first, last) => format!("from {first} to {last}"),
            Item::Name(name) => {
                volume.segment_named(name).map_or_else(|_| format!("'{name}'"), |at| listed(volume, &[at]))
            }
        })
        .collect();
    no_voxel(&told.join(", "), volume, present)
}

/// Returns the error for selected labels that no voxel has. `labels` is the text that names them in
/// the message.
pub fn no_voxel(labels: &str, volume: &Volume, present: &[LayerLabel]) -> Error {
    Error::input(
        format!("no voxel has the label {labels}"),
        "there would be nothing to extract for it",
        format!("choose among the labels present: {}", listed(volume, present)),
    )
}

/// Formats labels and their names as a string. Omits the background (label 0 without a name) if
/// there are other labels.
pub fn listed(volume: &Volume, present: &[LayerLabel]) -> String {
    let is_object = |at: &&LayerLabel| at.label != 0 || volume.name_of(**at).is_some();
    let objects: Vec<LayerLabel> = present.iter().filter(is_object).copied().collect();
    let present = if objects.is_empty() { present } else { &objects };
    let of = |at: &LayerLabel| {
        let layer = if volume.layer_count() > 1 { format!(" of layer {}", at.layer) } else { String::new() };
        match volume.name_of(*at) {
            Some(name) => format!("{}{layer} '{name}'", at.label),
            None => format!("{}{layer}", at.label),
        }
    };
    let mut shown: Vec<String> = present.iter().take(MOST_LISTED).map(of).collect();
    if present.len() > shown.len() {
        shown.push(format!("... ({} in all)", present.len()));
    }
    shown.join(", ")
}

/// Returns the Levenshtein distance between two words: the minimum number of insertions, deletions
/// and replacements of single characters.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_volume::{Geometry, Segment, Voxels};

    fn volume() -> Volume {
        let segment = |name: &str, label| Segment { name: name.to_owned(), at: LayerLabel { layer: 0, label } };
        Volume {
            segments: vec![segment("left lung", 2), segment("Heart", 3), segment("all", 7), segment("lost", 9)],
            ..Volume::new(Geometry::axis_aligned([2, 2, 2], DVec3::ONE), Voxels::I16(vec![0, 1, 2, 3, 5, 5, -4, 7]))
        }
    }

    fn chosen(text: &str) -> Result<Vec<i64>> {
        let selection: Selection = text.parse().expect("a selection");
        selection.resolve(&volume()).map(|found| found.into_iter().map(|at| at.label).collect())
    }

    #[test]
    fn numbers_ranges_names_and_all() {
        for (text, labels) in [
            ("1,2", vec![1, 2]),
            ("2,1,2", vec![2, 1]),
            ("2 3", vec![2, 3]),
            (" 5 , -4 ", vec![5, -4]),
            ("2..5", vec![2, 3, 5]),
            ("2..=3, 7", vec![2, 3, 7]),
            ("4..6", vec![5]),
            ("left lung", vec![2]),
            ("Left Lung, heart 1", vec![2, 3, 1]),
            ("heart", vec![3]),
            // a name in the file takes precedence
            ("all", vec![7]),
        ] {
            assert_eq!(chosen(text).expect(text), labels, "{text}");
        }
        let unnamed = Volume { segments: Vec::new(), ..volume() };
        let all = "ALL".parse::<Selection>().expect("all").resolve(&unnamed).expect("resolved");
        assert_eq!(all.iter().map(|at| at.label).collect::<Vec<_>>(), [-4, 1, 2, 3, 5, 7]);
    }

    #[test]
    fn what_is_not_there_is_told_with_what_is() {
        for (text, what, next) in [
            ("9", "no voxel has the label 9", "2 'left lung', 3 'Heart'"),
            ("heart, Lost", "no voxel has the label 9 'lost'", "2 'left lung', 3 'Heart'"),
            ("1,77", "no voxel has the label 77", "-4, 1"),
            ("8..9", "from 8 to 9", "-4, 1"),
            ("left lnug", "no segment is called 'left lnug'", "did you mean 'left lung'?"),
            ("spleen", "no segment is called 'spleen'", "choose among the labels"),
            ("1-3", "no segment is called '1-3'", "choose among the labels"),
        ] {
            let error = chosen(text).expect_err(text);
            assert!(error.what.contains(what) && error.next.contains(next), "{text}: {error}");
        }
        assert!(" , ".parse::<Selection>().is_err());
        assert_eq!(distance("kitten", "sitting"), 3);
    }
}
