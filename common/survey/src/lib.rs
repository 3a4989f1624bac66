//! Describes a volume: size, orientation, kind (scan or labels), values, labels, and the predicted
//! cost of a mesh. `isoparticles-volume info` prints the description. `distfield` also uses the
//! kind, to reject label options for a scan and iso values for a label map.
//!
//! [`survey`] computes statistics of the values, from which [`kind`] determines the kind.
//! [`selection`] resolves the labels that a user specifies. [`classes`] assigns the voxels to
//! objects, [`boundary`] measures their surfaces, [`mod@parts`] counts their connected parts,
//! [`extent`] computes their bounding boxes, and [`mod@cost`] predicts vertices, time and memory.
//! [`input`] defines the options for the volume to read. [`thresholds`] proposes iso values,
//! [`orientation`] names the axes, and [`text`] formats the description.

pub mod boundary;
pub mod classes;
pub mod cost;
pub mod extent;
pub mod input;
pub mod kind;
pub mod orientation;
pub mod parts;
pub mod selection;
pub mod survey;
pub mod text;
pub mod thresholds;

use boundary::{Boundary, boundaries};
use classes::{Classes, MOST_CLASSES, OUTSIDE, Rule};
use cost::{Cost, cost, default_vertices};
use extent::{WorldBox, boxes};
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::{Geometry, LayerLabel, Shear, Space, Volume, Voxels};
use kind::{Judgement, Kind, judge};
use orientation::Orientation;
use parts::{Parts, parts};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use survey::Survey;
use thresholds::{IsoValue, is_hounsfield, iso_values};

/// Side of the iso value that is inside the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Inside {
    /// Values above the iso value.
    Above,
    /// Values below the iso value.
    Below,
}

/// Number of faces sampled to predict the cost of an object. With this number, the sampling error
/// of the predicted vertex count is 2 %. With 1500, 6000, 24,000 and 200,000 faces, `make info`
/// predicts 41,000, 43,000, 43,000 and 44,000 vertices for `tooth_ct` at an iso value of 600.
const SAMPLED_FACES: usize = 6000;

/// Number of faces sampled for the label table, divided equally among the labels. It limits the
/// time to compute the table, and allows the maximum of [`LABEL_FACES`] for up to 100 labels.
const TABLE_FACES: usize = 200_000;

/// Minimum and maximum number of faces sampled per label of the table. The sampling error is
/// inversely proportional to the square root of the number: 2 % with [`SAMPLED_FACES`] (6000),
/// hence 15 % with 100 faces and 3.5 % with 2000 faces.
const LABEL_FACES: std::ops::RangeInclusive<usize> = 100..=2000;

/// Options that the user specified for a volume.
#[derive(Clone, Debug, Default)]
pub struct Wishes {
    /// Labels whose union is the object.
    pub labels: Option<Vec<LayerLabel>>,
    /// Iso value of the object, and the side on which the object lies.
    pub iso: Option<(f64, Inside)>,
    /// Kind of the volume, which overrides the automatic detection.
    pub kind: Option<Kind>,
}

/// The description of a volume.
#[derive(Clone, Debug, Serialize)]
pub struct VolumeInfo {
    /// Name of the JSON format, `isoparticles-volume-info`.
    pub format: &'static str,
    /// Version of the JSON format.
    pub version: u32,
    /// Number of voxels along each axis.
    pub size: [usize; 3],
    /// Distance between voxel centres along each axis in mm.
    pub spacing: [f64; 3],
    /// Size of the volume along each axis in mm: number of voxels times spacing.
    pub extent: [f64; 3],
    /// World position of the centre of the first voxel in mm.
    pub origin: [f64; 3],
    /// World frame of `origin`.
    pub space: Space,
    /// Directions of the axes.
    pub orientation: Orientation,
    /// Type of the voxel values.
    pub scalar_type: &'static str,
    /// Number of label layers. Labels of different layers may overlap.
    pub layers: usize,
    /// Kind of the volume, whether it is certain, and the reason.
    #[serde(flatten)]
    pub judgement: Judgement,
    /// Whether the values look like Hounsfield units; false for label maps.
    pub hounsfield: bool,
    /// Statistics of the values.
    pub values: Survey,
    /// Number of distinct values; `None` if they were not counted.
    pub distinct: Option<usize>,
    /// All labels except 0; empty for a scan.
    pub labels: Vec<LabelInfo>,
    /// The pairs of labels that overlap, the largest overlap first.
    pub overlaps: Vec<Overlap>,
    /// The object that the user specified, or all candidates if the user specified none.
    pub objects: Vec<Object>,
    /// Remarks on assumptions made while reading the file, on NaN in a label map, and on shear.
    pub remarks: Vec<String>,
}

/// One label.
#[derive(Clone, Debug, Serialize)]
pub struct LabelInfo {
    /// Layer and number of the label.
    #[serde(flatten)]
    pub at: LayerLabel,
    /// Name of the label, if the file contains one.
    pub name: Option<String>,
    /// Number of voxels with this label.
    pub voxels: usize,
    /// Volume of these voxels in mm^3.
    pub volume: f64,
    /// Bounding box of these voxels in world coordinates, mm; `None` if resampling a sheared volume
    /// removed all of them.
    pub bounds: Option<WorldBox>,
    /// Connected parts of the label; `None` if the volume is too noisy to count them.
    pub parts: Option<Parts>,
    /// Predicted number of vertices of a mesh of this label alone, with default sizes.
    pub vertices: usize,
}

/// Two labels of different layers that overlap.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Overlap {
    /// Positions of the two labels in the list of labels.
    pub labels: [usize; 2],
    /// Number of voxels with both labels.
    pub voxels: usize,
}

/// An object that could be meshed.
#[derive(Clone, Debug, Serialize)]
pub struct Object {
    /// Description, in words.
    pub what: String,
    /// The `make` variables that select the object.
    pub options: String,
    /// Reason for proposing the object, in words.
    pub why: String,
    /// Number of voxels inside the object.
    pub voxels: usize,
    /// Volume of these voxels in mm^3.
    pub volume: f64,
    /// Connected parts of the object; `None` if the volume is too noisy to count them.
    pub parts: Option<Parts>,
    /// Predicted cost of a mesh; `None` if no voxel is inside.
    pub cost: Option<Cost>,
}

/// Describes a volume. Predicts the cost of the object in `wishes`, or of all candidates if
/// `wishes` specifies no object.
///
/// # Errors
/// If the run is interrupted, or if a label map contains a value other than an integer or NaN.
pub fn examine(volume: &Volume, wishes: &Wishes, monitor: &dyn Monitor) -> Result<VolumeInfo> {
    let geometry = &volume.geometry;
    let shear = Shear::of(geometry);
    let step = monitor.phase("survey");
    let values = Survey::of(&volume.voxels, geometry);
    let mut judgement = judge(&values, volume.segments.len());
    if let Some(kind) = wishes.kind {
        judgement = Judgement { kind, certain: true, reason: format!("--kind {kind} was given") };
    }
    drop(step);
    monitor.check()?;
    let step = monitor.phase("labels");
    let labels = if judgement.kind == Kind::Labels { label_table(volume, shear.as_ref())? } else { Vec::new() };
    drop(step);
    let nan_remark = volume.nan_remark().filter(|_| judgement.kind == Kind::Labels);
    let mut objects = Vec::new();
    for (what, options, why, layers) in candidates(volume, wishes, &values, judgement.kind, &labels) {
        monitor.check()?;
        let _step = monitor.phase("objects");
        let classes = Classes::new(geometry, layers, 1);
        let moved = shear.as_ref().map(|shear| moved(&classes, shear));
        let classes = unsheared(classes, shear.as_ref().zip(moved.as_ref()));
        let geometry = classes.geometry;
        let voxels = classes.counts()[1];
        let parts = parts(&classes).map(|parts| parts[0]);
        let boundary = boundaries(&classes, SAMPLED_FACES).remove(0);
        let is_something = boundary.faces.iter().sum::<usize>() > 0;
        let count = parts.map(|parts| parts.count);
        let cost = is_something.then(|| cost(&boundary, count, geometry, judgement.kind));
        objects.push(Object { what, options, why, voxels, volume: volume_of(voxels, geometry), parts, cost });
    }
    Ok(VolumeInfo {
        format: "isoparticles-volume-info",
        version: 1,
        size: geometry.size,
        spacing: geometry.spacing.to_array(),
        extent: [0, 1, 2].map(|a| geometry.size[a] as f64 * geometry.spacing[a]),
        origin: geometry.origin.to_array(),
        space: geometry.space,
        orientation: Orientation::of(geometry),
        scalar_type: volume.voxels.type_name(),
        layers: volume.layer_count(),
        hounsfield: judgement.kind == Kind::Scan && is_hounsfield(&values),
        judgement,
        distinct: values.distinct(),
        values,
        overlaps: overlaps(volume, &labels),
        labels,
        objects,
        remarks: volume.remarks.iter().cloned().chain(nan_remark).chain(shear.iter().map(Shear::remark)).collect(),
    })
}

/// Returns the classes of a sheared volume, resampled to the orthonormal grid of `shear`. Grid
/// points outside the volume are [`OUTSIDE`].
fn moved(classes: &Classes<'_>, shear: &Shear) -> Voxels {
    let [nx, ny, _] = classes.geometry.size;
    let mut numbers = vec![OUTSIDE; classes.geometry.voxel_count()];
    numbers.par_chunks_mut(nx).enumerate().for_each(|(row, own)| classes.copy_row(row % ny, row / ny, own));
    shear.move_labels(&Voxels::U16(numbers), Some(OUTSIDE.into()))
}

/// Returns `classes` unchanged if the volume is not sheared. Otherwise, returns the classes that
/// [`moved`] resampled to an orthonormal grid, on which areas and volumes can be measured.
fn unsheared<'a>(classes: Classes<'a>, moved: Option<(&'a Shear, &'a Voxels)>) -> Classes<'a> {
    let Some((shear, voxels)) = moved else { return classes };
    let numbers: Vec<i64> = (1..=classes.count as i64).collect();
    Classes::new(&shear.geometry, vec![(voxels, Rule::each_of(&numbers))], classes.count)
}

fn volume_of(voxels: usize, geometry: &Geometry) -> f64 {
    voxels as f64 * geometry.spacing.element_product()
}

/// Describes all labels except 0, layer by layer, with at most [`MOST_CLASSES`] labels per layer.
fn label_table(volume: &Volume, shear: Option<&Shear>) -> Result<Vec<LabelInfo>> {
    let mut table = Vec::new();
    for (layer, voxels) in volume.layers().enumerate() {
        let mut present = voxels.label_set()?;
        present.retain(|label| *label != 0);
        present.truncate(MOST_CLASSES);
        let sample = (TABLE_FACES / present.len().max(1)).clamp(*LABEL_FACES.start(), *LABEL_FACES.end());
        let classes = Classes::new(&volume.geometry, vec![(voxels, Rule::each_of(&present))], present.len());
        let moved = shear.map(|shear| moved(&classes, shear));
        let classes = unsheared(classes, shear.zip(moved.as_ref()));
        let geometry = classes.geometry;
        let (counts, bounds) = (classes.counts(), boxes(&classes));
        let parts = parts(&classes);
        let surfaces: Vec<Boundary> = boundaries(&classes, sample);
        for (n, &label) in present.iter().enumerate() {
            let at = LayerLabel { layer, label };
            table.push(LabelInfo {
                at,
                name: volume.name_of(at).map(str::to_owned),
                voxels: counts[n + 1],
                volume: volume_of(counts[n + 1], geometry),
                bounds: bounds[n],
                parts: parts.as_ref().map(|parts| parts[n]),
                vertices: cost::two_digits(default_vertices(&surfaces[n], geometry, Kind::Labels)) as usize,
            });
        }
    }
    Ok(table)
}

/// Returns the pairs of labels that overlap.
fn overlaps(volume: &Volume, labels: &[LabelInfo]) -> Vec<Overlap> {
    if volume.layer_count() == 1 {
        return Vec::new();
    }
    let numbers: BTreeMap<LayerLabel, u16> = labels.iter().map(|label| label.at).zip(1..).collect();
    let mut pairs: BTreeMap<[usize; 2], usize> = BTreeMap::new();
    for (set, count) in volume.combinations(|at| numbers.get(&at).copied().unwrap_or(0)) {
        let set: Vec<usize> = set.into_iter().map(|number| usize::from(number) - 1).collect();
        for (n, &b) in set.iter().enumerate() {
            set[..n].iter().for_each(|&a| *pairs.entry([a, b]).or_default() += count);
        }
    }
    let mut overlaps: Vec<Overlap> = pairs.into_iter().map(|(labels, voxels)| Overlap { labels, voxels }).collect();
    overlaps.sort_by_key(|overlap| std::cmp::Reverse(overlap.voxels));
    overlaps
}

/// An object that could be meshed: its description, the `make` variables that select it, the reason
/// for proposing it, and its layers with their rules.
type Candidate<'a> = (String, String, String, Vec<(&'a Voxels, Rule)>);

/// Returns the object in `wishes`. If `wishes` specifies none, returns one object for each proposed
/// iso value of a scan, or the union of all labels except 0 of a label map.
fn candidates<'a>(
    volume: &'a Volume,
    wishes: &Wishes,
    values: &Survey,
    kind: Kind,
    labels: &[LabelInfo],
) -> Vec<Candidate<'a>> {
    let of_labels = |chosen: &[LayerLabel], what: String, options: String, why: &str| {
        let rule = |layer: usize| {
            let own: Vec<i64> = chosen.iter().filter(|at| at.layer == layer).map(|at| at.label).collect();
            (!own.is_empty()).then(|| Rule::any_of(&own))
        };
        let layers = volume.layers().enumerate().filter_map(|(n, voxels)| Some((voxels, rule(n)?)));
        (what, options, why.to_owned(), layers.collect())
    };
    let of_iso = |IsoValue { iso, inside, why }: IsoValue| {
        let (what, options, rule) = match inside {
            Inside::Above => (format!("above {iso}"), format!("ISO={iso}"), Rule::Above(iso)),
            Inside::Below => (format!("below {iso}"), format!("ISO={iso} INSIDE=below"), Rule::Below(iso)),
        };
        (what, options, why, vec![(&volume.voxels, rule)])
    };
    match (&wishes.labels, wishes.iso, kind) {
        (Some(chosen), _, _) => {
            let list = chosen.iter().map(|at| at.label.to_string()).collect::<Vec<_>>().join(",");
            vec![of_labels(chosen, format!("labels {list}"), format!("LABELS={list}"), "given")]
        }
        (None, Some((iso, inside)), _) => vec![of_iso(IsoValue { iso, inside, why: "given".into() })],
        (None, None, Kind::Scan) => iso_values(values).into_iter().map(of_iso).collect(),
        (None, None, Kind::Labels) if labels.is_empty() => Vec::new(),
        (None, None, Kind::Labels) => {
            let all: Vec<LayerLabel> = labels.iter().map(|label| label.at).collect();
            vec![of_labels(&all, "all labels but 0 together".into(), "LABELS=all".into(), "one object of them all")]
        }
    }
}
