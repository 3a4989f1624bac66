//! Parses and resolves the materials given by the user: `lung=2+3` or `2+3=lung`, `heart` if the
//! file contains that name, or `all`.

use isoparticles_field::materials::{MOST_MATERIALS, Material, MaterialId};
use isoparticles_stage::error::{Error, Result};
use isoparticles_survey::selection::{Selection, listed, no_voxel};
use isoparticles_volume::{LayerLabel, Volume};
use std::collections::BTreeMap;
use std::str::FromStr;

/// Name of the material that contains all labels not assigned to another material.
pub const OUTSIDE: &str = "outside";

/// Maximum number of materials listed in an error message. Forty materials fill a screen.
const MOST_LISTED: usize = 40;

/// One `--material` option. [`resolve`] converts it to labels of a volume.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MaterialChoice {
    /// One material for each label except 0 that no other choice specifies.
    All,
    /// The label that has this name in the file.
    Named(String),
    /// A material with this name, made of these labels.
    Labels(String, Vec<Selection>),
}

impl FromStr for MaterialChoice {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let text = text.trim();
        let choice = match text.split_once('=') {
            _ if text.eq_ignore_ascii_case("all") => return Ok(Self::All),
            None => Self::Named(text.to_owned()),
            // only labels are joined, so they may also come first
            Some((labels, name)) if labels.contains('+') && !name.contains('+') => {
                return format!("{name}={labels}").parse();
            }
            Some((name, labels)) => {
                let labels: std::result::Result<Vec<Selection>, String> = labels.split('+').map(str::parse).collect();
                Self::Labels(name.trim().to_owned(), labels?)
            }
        };
        match &choice {
            Self::Named(name) | Self::Labels(name, _) if name.is_empty() => {
                Err("has no name: write NAME=LABEL, NAME=LABEL+LABEL, a name in the file, or all".into())
            }
            Self::Named(name) | Self::Labels(name, _) if name.eq_ignore_ascii_case(OUTSIDE) => {
                Err(format!("'{OUTSIDE}' is reserved for voxels without a material; choose another name"))
            }
            _ => Ok(choice),
        }
    }
}

impl std::fmt::Display for MaterialChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::Named(name) => f.write_str(name),
            Self::Labels(name, labels) => {
                let labels: Vec<String> = labels.iter().map(Selection::to_string).collect();
                write!(f, "{name}={}", labels.join("+"))
            }
        }
    }
}

/// The materials of a volume, the outside first.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// Names and labels, indexed by material number.
    pub table: Vec<Material>,
    number: BTreeMap<LayerLabel, u16>,
    /// Number of materials, without the outside, that are not added by `all`.
    pub(crate) listed: usize,
    /// Rank of each material. A voxel of several materials belongs to the one with the lowest rank.
    /// The outside has the highest rank.
    pub(crate) rank: Vec<usize>,
}

impl Chosen {
    /// Returns the material that keeps the voxels of both of two materials.
    pub fn first(&self, a: u16, b: u16) -> u16 {
        if self.rank[usize::from(b)] < self.rank[usize::from(a)] { b } else { a }
    }

    /// Returns the material number of a label, or 0 if the label belongs to no material.
    pub fn number(&self, label: LayerLabel) -> u16 {
        self.number.get(&label).copied().unwrap_or(MaterialId::OUTSIDE.0)
    }
}

/// Returns the names of the materials, the outside first. The list is empty if there are no
/// choices. Returns `None` if a choice is `all`, because its names depend on the volume.
pub fn names(choices: &[MaterialChoice]) -> Option<Vec<String>> {
    let name = |choice: &MaterialChoice| match choice {
        MaterialChoice::All => None,
        MaterialChoice::Named(name) | MaterialChoice::Labels(name, _) => Some(name.clone()),
    };
    let outside = (!choices.is_empty()).then(|| OUTSIDE.to_owned()).map(Some);
    outside.into_iter().chain(choices.iter().map(name)).collect()
}

/// Resolves the choices for a volume.
///
/// # Errors
/// If a label or name is not in the volume, a name is given twice, a label belongs to two
/// materials, or the number of materials is 0 or too large.
pub fn resolve(choices: &[MaterialChoice], volume: &Volume) -> Result<Chosen> {
    let present = volume.label_set()?;
    let mut named: Vec<Material> = Vec::new();
    let mut number: BTreeMap<LayerLabel, u16> = BTreeMap::new();
    for choice in choices {
        let (name, labels) = match choice {
            MaterialChoice::All => continue,
            MaterialChoice::Named(name) => (name, vec![of_name(name, volume, &present)?]),
            MaterialChoice::Labels(name, selections) => (name, of_selections(selections, volume)?),
        };
        if named.iter().any(|other| other.name == *name) {
            return Err(wrong(
                format!("--material {choice}: the name '{name}' is already used"),
                "later stages identify a material by its name",
                "give each material in MATERIALS (--material) its own name; join several labels with +",
                &named,
            ));
        }
        let id = named.len() + 1;
        let mut own: Vec<LayerLabel> = Vec::new();
        for label in labels {
            match number.insert(label, id as u16) {
                Some(other) if usize::from(other) != id => {
                    let other = &named[usize::from(other) - 1].name;
                    return Err(wrong(
                        format!("--material {choice}: label {} already belongs to the material '{other}'", label.label),
                        "each voxel belongs to one material",
                        "use each label once in MATERIALS (--material)",
                        &named,
                    ));
                }
                Some(_) => {}
                None => own.push(label),
            }
        }
        named.push(Material { name: name.clone(), labels: own });
    }
    let listed_count = named.len();
    if choices.contains(&MaterialChoice::All) {
        add_rest(volume, &present, &mut named, &mut number);
    }
    if named.is_empty() || named.len() >= MOST_MATERIALS {
        return Err(Error::input(
            format!("{} materials are selected", named.len()),
            format!("the number of materials must be from 1 to {}, without the outside", MOST_MATERIALS - 1),
            format!("set MATERIALS (--material) to some of the labels present: {}", listed(volume, &present)),
        ));
    }
    let rest = present.iter().copied().filter(|label| !number.contains_key(label)).collect();
    let outside = Material { name: OUTSIDE.to_owned(), labels: rest };
    let rank = std::iter::once(usize::MAX).chain(0..named.len()).collect();
    Ok(Chosen { table: std::iter::once(outside).chain(named).collect(), number, listed: listed_count, rank })
}

/// Adds one material for each label except 0 that belongs to no material yet.
fn add_rest(
    volume: &Volume,
    present: &[LayerLabel],
    named: &mut Vec<Material>,
    number: &mut BTreeMap<LayerLabel, u16>,
) {
    for &label in present.iter().filter(|at| at.label != 0) {
        if number.contains_key(&label) {
            continue;
        }
        let name = unused_name(label, volume, named);
        named.push(Material { name, labels: vec![label] });
        number.insert(label, u16::try_from(named.len()).unwrap_or(u16::MAX));
    }
}

/// Returns the labels of all selections.
fn of_selections(selections: &[Selection], volume: &Volume) -> Result<Vec<LayerLabel>> {
    let mut labels = Vec::new();
    for selection in selections {
        labels.extend(selection.resolve(volume)?);
    }
    Ok(labels)
}

/// Returns the label with this name in the file, if at least one voxel has the label.
fn of_name(name: &str, volume: &Volume, present: &[LayerLabel]) -> Result<LayerLabel> {
    let found = volume.segment_named(name);
    match found {
        Ok(at) if present.contains(&at) => Ok(at),
        Ok(at) => Err(no_voxel(&listed(volume, &[at]), volume, present)),
        Err(error) => Err(Error {
            what: match error {
                isoparticles_volume::Error::SegmentAmbiguous { .. } => {
                    format!("--material {name}: several segments in the file have this name")
                }
                _ => format!("--material {name}: no label in the file has this name"),
            },
            next: format!(
                "set MATERIALS={name}:LABEL (--material {name}=LABEL); labels present: {}",
                listed(volume, present)
            ),
            ..Error::from(error)
        }),
    }
}

/// Returns the name of a label in the file, or `label_N`. If another material has that name, the
/// label number is appended.
fn unused_name(at: LayerLabel, volume: &Volume, named: &[Material]) -> String {
    let is_free = |name: &str| name != OUTSIDE && named.iter().all(|other| other.name != name);
    let number = if volume.layer_count() > 1 { format!("{}_{}", at.layer, at.label) } else { at.label.to_string() };
    let own = volume.name_of(at).map(str::trim).filter(|name| !name.is_empty());
    let first = own.map_or_else(|| format!("label_{number}"), str::to_owned);
    let candidates = (0..).map(|n| match n {
        0 => first.clone(),
        1 => format!("{first}_{number}"),
        n => format!("{first}_{number}_{n}"),
    });
    candidates.into_iter().find(|name| is_free(name)).unwrap_or_default()
}

fn wrong(what: String, why: &str, next: &str, named: &[Material]) -> Error {
    let told: Vec<String> = named
        .iter()
        .take(MOST_LISTED)
        .map(|material| {
            let labels: Vec<String> = material.labels.iter().map(|at| at.label.to_string()).collect();
            format!("{}={}", material.name, labels.join("+"))
        })
        .collect();
    Error::input(what, why, format!("{next}; materials so far: {}", told.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_volume::{Geometry, Segment, Voxels};

    fn volume() -> Volume {
        let segment = |name: &str, label| Segment { name: name.to_owned(), at: LayerLabel { layer: 0, label } };
        Volume {
            segments: vec![segment("left lung", 2), segment("heart", 3), segment("heart", 5), segment("lost", 9)],
            ..Volume::new(Geometry::axis_aligned([2, 2, 2], DVec3::ONE), Voxels::I16(vec![0, 1, 2, 3, 5, 5, -4, 7]))
        }
    }

    fn table(choices: &[&str]) -> Result<Vec<(String, Vec<i64>)>> {
        let choices: Vec<MaterialChoice> = choices.iter().map(|text| text.parse().expect(text)).collect();
        let chosen = resolve(&choices, &volume())?;
        let labels = |material: &Material| material.labels.iter().map(|at| at.label).collect();
        Ok(chosen.table.iter().map(|material| (material.name.clone(), labels(material))).collect())
    }

    fn row(name: &str, labels: &[i64]) -> (String, Vec<i64>) {
        (name.to_owned(), labels.to_vec())
    }

    #[test]
    fn names_labels_and_all() {
        let found = table(&["lungs=1+2", "wall = 5..7"]).expect("two");
        assert_eq!(found, [row("outside", &[-4, 0, 3]), row("lungs", &[1, 2]), row("wall", &[5, 7])]);
        assert_eq!(table(&["left lung"]).expect("by name")[1], row("left lung", &[2]));
        let found = table(&["all"]).expect("each label");
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["outside", "label_-4", "label_1", "left lung", "heart", "heart_5", "label_7"]);
        assert_eq!(found[0].1, [0]);
        let found = table(&["all", "rest=1+2+3"]).expect("the others");
        assert_eq!(found[1..3], [row("rest", &[1, 2, 3]), row("label_-4", &[-4])]);
    }

    #[test]
    fn errors_name_what_the_volume_contains() {
        for (choices, what, next) in [
            (&["a=8"][..], "no voxel has the label 8", "2 'left lung'"),
            (&["a=1", "a=2"], "the name 'a' is already used", "a=1"),
            (&["a=1", "b=2+1"], "label 1 already belongs to the material 'a'", "a=1"),
            (&["spleen"], "no label in the file has this name", "2 'left lung'"),
            (&["lost"], "no voxel has the label 9 'lost'", "2 'left lung'"),
            (&["a=left lnug"], "no segment is called 'left lnug'", "did you mean 'left lung'?"),
        ] {
            let error = table(choices).expect_err(choices[0]);
            assert!(error.what.contains(what) && error.next.contains(next), "{choices:?}: {error}");
        }
        for text in ["", "=3", "outside=3", "a=", "a=1++2"] {
            assert!(text.parse::<MaterialChoice>().is_err(), "{text}");
        }
        for text in ["a= 1 + 2", "1 + 2=a"] {
            assert_eq!(text.parse::<MaterialChoice>().expect("a choice").to_string(), "a=1+2");
        }
    }
}
