//! How much of the data is kept: the options `--scale` and those that choose it, and what is told about it.

use crate::changes::{Changes, Event, Kind, SPECKS};
use crate::crop::{Grid, VoxelBox, cut_in_turn};
use crate::field::Demands;
use crate::mask::Mask;
use crate::occupancy::Occupancy;
use crate::scalar::{ScalarOptions, check_scalar, from_level};
use crate::scale::{SCALE_OVER_SIZE, Scale, edge_length, scaled};
use crate::selection::noted;
use crate::{Border, Inside, Redistanced};
use isoparticles_stage::cli::values::{not_negative, positive};
use isoparticles_stage::cli::{Context, METHOD};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::quality::Quality;
use isoparticles_volume::{Geometry, Image, LayerLabel, Volume};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// How much of the data the surface keeps.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ScaleArgs {
    /// Smooth away what is smaller than this, mm: a Gaussian of half of it, and the volume of each place kept. 0 keeps every voxel
    /// centre of labels on its side, and a scalar volume's own isosurface. What that changed is reported [default: 0]
    #[arg(long, value_name = "MM", value_parser = not_negative, help_heading = METHOD)]
    pub scale: Option<f64>,
    /// Choose the scale for a mesh of this edge length, mm: 1.6 times as long where voxel steps would show, else 0
    #[arg(long, value_name = "MM", value_parser = positive, conflicts_with = "scale", help_heading = METHOD)]
    pub scale_for_size: Option<f64>,
    /// Choose the scale for a mesh of this number of vertices
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(4..), conflicts_with_all = ["scale", "scale_for_size"],
        help_heading = METHOD)]
    pub scale_for_vertices: Option<u64>,
    /// Choose the scale for the smallest h of `sizefield --quality`: coarse is above the voxel steps, the others are not
    #[arg(long, value_enum, value_name = "HOW", conflicts_with_all = ["scale", "scale_for_size", "scale_for_vertices"], help_heading = METHOD)]
    pub quality: Option<Quality>,
    /// Keep parts and gaps that are thinner than a mesh of the scale's edge length tells apart; they want a smaller h there
    #[arg(long, help_heading = METHOD)]
    pub keep_thin: bool,
}

/// Edge lengths up to this many voxels (mean spacing) follow the steps of voxels, longer ones are spoilt by them. Mean and smallest radius ratio on `heart_label` at
/// 0.65 voxel 0.984 / 0.69 without scale and 0.984 / 0.63 with, at 1.25 voxels 0.955 / 0.55 and 0.984 / 0.71; with on `tooth_ct` at 0.8 voxel 0.988 / 0.83.
const FINE_ENOUGH: f64 = 0.75;

/// A scale and why it is that.
pub struct Choice {
    /// mm.
    pub length: f64,
    /// In words.
    pub reason: String,
}

impl Choice {
    /// That for an edge length (mm), `whose` in words, with voxels of that spacing.
    fn for_length(length: f64, whose: &str, voxel: f64) -> Self {
        let limit = format!("than {FINE_ENOUGH} of a voxel of {voxel:.4} mm");
        if length > FINE_ENOUGH * voxel {
            let reason = format!("{SCALE_OVER_SIZE} times {whose} which is longer {limit}");
            Self { length: SCALE_OVER_SIZE * length, reason }
        } else {
            Self { length: 0.0, reason: format!("{whose} is no longer {limit}") }
        }
    }
}

/// Which object of a volume is meant.
pub enum Object {
    /// The union of labels.
    Labels(Vec<LayerLabel>),
    /// One side of an iso value.
    Iso(f64, Inside),
}

impl Object {
    /// The box round it in a volume, which is given back; none where no voxel is inside.
    ///
    /// # Errors
    /// Of a scalar volume, where its voxels or the iso value leave no surface.
    pub fn locate(&self, volume: Volume) -> Result<(Volume, Option<VoxelBox>)> {
        match self {
            Self::Labels(labels) => {
                let found = VoxelBox::of_labels(&volume, |at| labels.contains(&at));
                Ok((volume, found))
            }
            Self::Iso(iso, inside) => check_scalar(volume, *iso, *inside),
        }
    }
}

impl ScaleArgs {
    /// What of them belongs to the parameters of a run; nothing of a run without any.
    pub fn add_to(&self, parameters: &mut Value) {
        let given = [
            ("scale", self.scale.map(Value::from)),
            ("scale_for_size", self.scale_for_size.map(Value::from)),
            ("scale_for_vertices", self.scale_for_vertices.map(Value::from)),
            ("quality", self.quality.map(|quality| Value::from(quality.name()))),
            ("keep_thin", self.keep_thin.then_some(Value::Bool(true))),
        ];
        for (name, value) in given {
            if let Some(value) = value {
                parameters[name] = value;
            }
        }
    }

    /// Whether any scale above 0 may come of them.
    pub(crate) fn is_given(&self) -> bool {
        let chosen = self.scale_for_size.is_some() || self.scale_for_vertices.is_some() || self.quality.is_some();
        self.scale.is_some_and(|scale| scale > 0.0) || chosen
    }

    /// The scale that an edge length, a quality or the user asks for; none where it takes the object's area to tell.
    pub(crate) fn choose_by_length(&self, geometry: &Geometry) -> Option<Choice> {
        let voxel = geometry.mean_spacing();
        if let Some(size) = self.scale_for_size {
            return Some(Choice::for_length(size, &format!("the edge length asked for, {size} mm,"), voxel));
        }
        if let Some(quality) = self.quality {
            let smallest = quality.smallest_size_voxels() * voxel;
            let whose = format!("the smallest h of quality {}, {smallest:.4} mm,", quality.name());
            return Some(Choice::for_length(smallest, &whose, voxel));
        }
        let given = Choice { length: self.scale.unwrap_or(0.0), reason: "given".into() };
        self.scale_for_vertices.is_none().then_some(given)
    }

    /// The scale for a number of vertices, given how to find their edge length (mm): of how many, and whether thin parts are kept. `volume` is that of what is meshed, mm^3.
    ///
    /// # Errors
    /// Where the edge length cannot be found, and when nothing is left.
    pub(crate) fn choose_by_area(
        &self,
        geometry: &Geometry,
        volume: f64,
        edge_length: impl FnOnce(f64, bool) -> Result<Option<f64>>,
    ) -> Result<Choice> {
        let vertices = self.scale_for_vertices.unwrap_or(0);
        let length = edge_length(vertices as f64, self.keep_thin)?
            .ok_or_else(|| nothing_left(&format!("a mesh of {vertices} vertices"), volume))?;
        let whose = format!("the edge length of {vertices} vertices, {length:.4} mm,");
        Ok(Choice::for_length(length, &whose, geometry.mean_spacing()))
    }
}

/// What to say where a scale leaves nothing of an object of that volume, mm^3.
fn nothing_left(by: &str, volume: f64) -> Error {
    // of a ball of that volume
    let area = (36.0 * PI * volume * volume).cbrt();
    let size = (2.0 * area / (3f64.sqrt() * 100.0)).sqrt();
    Error::input(
        format!("{by}: nothing is left of the object of {volume:.4} mm^3"),
        "parts smaller than the scale are smoothed away, and all are",
        format!("ask for edges of {size:.3} mm, which give about 100 vertices, or shorter ones; or give --keep-thin"),
    )
}

/// The scale that the options ask for, told to the user; none where every voxel centre, or the isosurface itself, is kept. The volume is given back.
///
/// # Errors
/// Where the check of scalars fails, and when nothing is left.
pub fn choose_scale(
    args: &ScaleArgs,
    volume: Volume,
    object: &Object,
    border: Border,
    context: &Context,
) -> Result<(Volume, Option<Choice>)> {
    if !args.is_given() {
        return Ok((volume, None));
    }
    let (volume, choice) = match args.choose_by_length(&volume.geometry) {
        Some(choice) => (volume, choice),
        None => {
            let _step = context.step("choose the scale");
            let occupancy = occupancy(&volume, object);
            let found = |vertices, keep_thin| edge_length(&occupancy, border, vertices, keep_thin);
            let choice = args.choose_by_area(&volume.geometry, occupancy.volume(), found)?;
            (volume, choice)
        }
    };
    let Choice { length, reason } = &choice;
    context.summary("scale, mm", format!("{length:.4} ({reason})"));
    context.set_parameter("scale", *length);
    context.set_parameter("scale_reason", reason.clone());
    Ok((volume, (choice.length > 0.0).then_some(choice)))
}

/// F of the smoothed object, and what to note about it.
///
/// # Errors
/// When nothing is left, and when the run is interrupted.
pub fn extract_scaled(
    Choice { length, reason }: Choice,
    keep_thin: bool,
    volume: Volume,
    object: &Object,
    (grid, options): (Grid, ScalarOptions),
    context: &Context,
) -> Result<(Redistanced, Value)> {
    let step = context.step("scale");
    let occupancy = occupancy(&volume, object);
    let mut meta = match object {
        Object::Labels(labels) => {
            let told = noted(labels, &volume);
            context.set_parameter("labels", told.clone());
            json!({ "source": "labels", "labels": told })
        }
        Object::Iso(iso, inside) => {
            json!({ "source": "scalar", "iso": iso, "inside": crate::run::inside_name(*inside) })
        }
    };
    drop(volume);
    let volume_before = occupancy.volume();
    let smoothed = scaled(occupancy, Scale { length, keep_thin }, grid)?
        .ok_or_else(|| nothing_left(&format!("a scale of {length:.4} mm ({reason})"), volume_before))?;
    drop(step);
    tell(&smoothed.changes, length, context);
    meta["scale"] = json!(length);
    meta["scale_reason"] = json!(reason);
    meta["keep_thin"] = json!(keep_thin);
    meta["volume_before"] = json!(smoothed.changes.volume_before);
    meta["scale_changes"] = json!(smoothed.changes);
    let options = ScalarOptions { inside: Inside::Above, cut: cut_in_turn(options.cut, smoothed.cut), ..options };
    let result = from_level(smoothed.level, 0, 0.0, &options, &Demands::default(), context)?;
    Ok((result, meta))
}

fn occupancy(volume: &Volume, object: &Object) -> Occupancy {
    match object {
        Object::Labels(labels) => {
            let image = Image { data: volume.label_mask(labels), geometry: volume.geometry.clone() };
            Occupancy::of_mask(&Mask::from(&image))
        }
        Object::Iso(iso, inside) => Occupancy::of_scalar(&volume.voxels, &volume.geometry, *iso, *inside),
    }
}

/// Events of a kind that are named on the terminal.
const NAMED: usize = 3;

/// Says what the scale changed.
fn tell(changes: &Changes, length: f64, context: &Context) {
    let depth = changes.depth;
    context.summary(
        "voxel centres that changed side",
        format!(
            "{}, {:.3} mm deep on average, 99 % within {:.3} mm, the deepest {:.3} mm",
            changes.voxels_changed, depth.mean, depth.p99, depth.max
        ),
    );
    let ([before, after], [euler_before, euler_after]) = (changes.components, changes.euler);
    context.summary("components of the data", format!("{before} -> {after}"));
    context.summary("Euler characteristic of the data (solid)", format!("{euler_before} -> {euler_after}"));
    for (&kind, &count) in &changes.counts {
        let events: Vec<&Event> = changes.events.iter().filter(|event| event.kind == kind).take(NAMED).collect();
        let named: Vec<String> = events.iter().map(|event| event_told(event)).collect();
        let more = if count > named.len() { format!(", and {} more", count - named.len()) } else { String::new() };
        let what = match kind {
            Kind::Broken => "parts come in pieces",
            Kind::Gone => "parts are gone",
            Kind::Joined => "parts are joined to others",
            Kind::Shortened => "thin ends are gone",
            Kind::Filled => "narrow gaps are filled",
        };
        let (volume, named) = (changes.volumes.get(&kind).copied().unwrap_or(0.0), named.join("; "));
        let said = format!("at a scale of {length:.4} mm {what} ({count}, {volume:.4} mm^3 together): {named}{more}");
        if kind == Kind::Gone && changes.lost() < SPECKS * changes.volume_before {
            context.info(said);
        } else {
            context.warn(format!("{said}; a smaller --scale or --keep-thin keeps more"));
        }
    }
}

fn event_told(event: &Event) -> String {
    let [x, y, z] = event.place;
    let pieces = match event.kind {
        Kind::Broken => format!(" in {} pieces", event.pieces),
        Kind::Joined => format!(" of {} parts", event.pieces),
        _ => String::new(),
    };
    format!("{:.4} mm^3{pieces} round ({x:.1}, {y:.1}, {z:.1})", event.volume)
}
