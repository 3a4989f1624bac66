//! Chooses the scale of the smoothing (given by `--scale`, or derived from an edge length, a vertex
//! count or a quality), smooths the object, and reports the changes.
//!
//! The scale is twice the standard deviation of the Gaussian, in mm. Scale 0 means no smoothing.

use crate::changes::{Changes, Event, Kind, SPECK_SHARE};
use crate::crop::{Grid, cut_in_turn};
use crate::field::Demands;
use crate::mask::Mask;
use crate::occupancy::Occupancy;
use crate::scalar::{ScalarOptions, check_scalar, from_level};
use crate::scale::{SCALE_OVER_SIZE, Scale, edge_length, scaled};
use crate::{Border, Inside, Keep, Redistanced};
use isoparticles_stage::cli::values::{not_negative, positive, significant};
use isoparticles_stage::cli::{CHECKS, Context, METHOD};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::material_sizes::GivenSize;
use isoparticles_stage::quality::Quality;
use isoparticles_survey::selection::noted;
use isoparticles_volume::{Geometry, Image, LayerLabel, Volume, VoxelBox};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// Options that set how much detail of the data the surface keeps.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ScaleArgs {
    /// Smooth away details smaller than this length, mm. The smoothing is Gaussian with a standard
    /// deviation of half this length, and preserves the local volume. With 0, every voxel centre of
    /// a label map stays on its side of the surface, and a scalar volume keeps its isosurface.
    /// Changes to the object are reported [default: 0]
    #[arg(long, value_name = "MM", value_parser = not_negative, help_heading = METHOD)]
    pub scale: Option<f64>,
    /// Choose the scale for a mesh with this edge length, mm: 1.6 times the edge length (for
    /// labels, at least 2.7 voxels) if the edge length exceeds 0.75 voxel, because voxel steps
    /// would be visible; otherwise 0
    #[arg(long, value_name = "MM", value_parser = positive, conflicts_with = "scale", help_heading = METHOD)]
    pub scale_for_size: Option<f64>,
    /// Choose the scale for a mesh with this number of vertices
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(4..), conflicts_with_all = ["scale", "scale_for_size"],
        help_heading = METHOD)]
    pub scale_for_vertices: Option<u64>,
    /// Choose the scale for the minimum h that `sizefield --quality` sets: `coarse` (1.5 voxels)
    /// gives a scale above 0; `medium` and `fine` give 0
    #[arg(long, value_enum, value_name = "HOW", conflicts_with_all = ["scale", "scale_for_size", "scale_for_vertices"], help_heading = METHOD)]
    pub quality: Option<Quality>,
    /// Several materials only: edge length of the mesh on all interfaces of a material, mm, as for
    /// `sizefield --size`; may be repeated. The scale of these interfaces is 1.6 times this length.
    /// Other interfaces have the scale of the options above, or 2.7 voxels. If every edge length is
    /// at most 0.75 voxel, there is no scale. Edge lengths of pairs (NAME/NAME=H) do not affect the
    /// scale
    #[arg(long, value_name = "NAME=H|NAME/NAME=H", conflicts_with = "scale", requires = "material", help_heading = METHOD)]
    pub size: Vec<GivenSize>,
    /// Keep parts and gaps that are too thin for a mesh with the edge length of the scale; these
    /// parts and gaps require a smaller h
    #[arg(long, help_heading = METHOD)]
    pub keep_thin: bool,
    /// With a scale: accept objects and materials whose volume changes by more than 10 %. The
    /// verdict lists them
    #[arg(long, help_heading = CHECKS)]
    pub accept_losses: bool,
}

/// Maximum edge length, in units of the mean voxel spacing, of a mesh that needs no scale. Longer
/// edges show voxel steps. Mean / minimum radius ratio on `heart_label`: at 0.65 voxel, 0.984 /
/// 0.69 without a scale and 0.984 / 0.63 with a scale; at 1.25 voxels, 0.955 / 0.55 without and
/// 0.984 / 0.71 with a scale. On `tooth_ct` with a scale, at 0.8 voxel: 0.988 / 0.83.
pub(crate) const FINE_ENOUGH: f64 = 0.75;

/// Minimum scale for meshes of labels, in units of the mean voxel spacing. Smaller scales leave
/// visible voxel steps. On a ball of radius 22 voxels (`phantom ball --kind label`) with edges of
/// 0.8 voxel, the root-mean-square deviation of the triangle normals from those of the ball is 12.6
/// degrees at a scale of 1.28, 2.5 at 2.7, and 3.0 without a scale. With edges of 1.2 voxels, it is
/// 5.6 at 1.92, 2.5 at 2.7, and 2.8 without a scale.
pub(crate) const LEAST_SCALE: f64 = 2.7;

/// A scale and the reason for it.
pub struct ScaleChoice {
    /// The scale in mm; 0 means no smoothing.
    pub length: f64,
    /// The reason, as a message for the user.
    pub reason: String,
}

impl ScaleChoice {
    /// Chooses the scale for an edge length (mm). `whose` describes the edge length in the reason;
    /// `voxel` is the mean spacing (mm). Scans show no voxel steps, so [`LEAST_SCALE`] applies only
    /// to labels.
    fn for_length(length: f64, whose: &str, voxel: f64, is_labels: bool) -> Self {
        let limit = format!("{FINE_ENOUGH} times the voxel size of {} mm", significant(voxel));
        let least = if is_labels { LEAST_SCALE * voxel } else { 0.0 };
        if length > FINE_ENOUGH * voxel && SCALE_OVER_SIZE * length < least {
            let reason = format!("{LEAST_SCALE} voxels, the minimum for labels, because {whose} exceeds {limit}");
            Self { length: least, reason }
        } else if length > FINE_ENOUGH * voxel {
            let reason = format!("{SCALE_OVER_SIZE} times {whose}, which exceeds {limit}");
            Self { length: SCALE_OVER_SIZE * length, reason }
        } else {
            Self { length: 0.0, reason: format!("{whose} does not exceed {limit}") }
        }
    }
}

/// Returns the value of `--inside` for a side.
pub(crate) fn inside_name(inside: Inside) -> &'static str {
    match inside {
        Inside::Above => "above",
        Inside::Below => "below",
    }
}

/// The object to extract from a volume.
pub enum Object {
    /// The union of labels.
    Labels(Vec<LayerLabel>),
    /// One side of an iso value.
    Iso(f64, Inside),
}

impl Object {
    /// Returns the volume and the bounding box of the object's voxels. The box is `None` if no
    /// voxel is inside.
    ///
    /// # Errors
    /// If the object is defined by an iso value and the volume has no surface at this value.
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
    /// Adds the options given by the user to the parameters of a run.
    pub fn add_to(&self, parameters: &mut Value) {
        let given = [
            ("scale", self.scale.map(Value::from)),
            ("scale_for_size", self.scale_for_size.map(Value::from)),
            ("scale_for_vertices", self.scale_for_vertices.map(Value::from)),
            ("quality", self.quality.map(|quality| Value::from(quality.name()))),
            ("keep_thin", self.keep_thin.then_some(Value::Bool(true))),
            ("accept_losses", self.accept_losses.then_some(Value::Bool(true))),
        ];
        for (name, value) in given {
            if let Some(value) = value {
                parameters[name] = value;
            }
        }
        if !self.size.is_empty() {
            parameters["size"] = json!(self.size);
        }
    }

    /// Returns whether the options can result in a scale above 0.
    pub(crate) fn is_given(&self) -> bool {
        let chosen = self.scale_for_size.is_some() || self.scale_for_vertices.is_some() || self.quality.is_some();
        self.scale.is_some_and(|scale| scale > 0.0) || chosen
    }

    /// Chooses the scale from an edge length, a quality or `--scale`. Returns `None` for
    /// `--scale-for-vertices`, which needs the area of the object.
    pub(crate) fn choose_by_length(&self, geometry: &Geometry, is_labels: bool) -> Option<ScaleChoice> {
        let voxel = geometry.mean_spacing();
        if let Some(size) = self.scale_for_size {
            return Some(ScaleChoice::for_length(
                size,
                &format!("the requested edge length of {size} mm"),
                voxel,
                is_labels,
            ));
        }
        if let Some(quality) = self.quality {
            let smallest = quality.smallest_size_voxels() * voxel;
            let whose = format!("the minimum h of {} mm for quality {}", significant(smallest), quality.name());
            return Some(ScaleChoice::for_length(smallest, &whose, voxel, is_labels));
        }
        let given = ScaleChoice { length: self.scale.unwrap_or(0.0), reason: "given".into() };
        self.scale_for_vertices.is_none().then_some(given)
    }

    /// Chooses the scale for `--scale-for-vertices`. `edge_length` returns the edge length (mm) for
    /// a number of vertices; its second argument is true if thin parts are kept. `volume` is the
    /// volume of the object, mm^3.
    ///
    /// # Errors
    /// If `edge_length` fails, or if nothing is left of the object.
    pub(crate) fn choose_by_area(
        &self,
        geometry: &Geometry,
        is_labels: bool,
        volume: f64,
        edge_length: impl FnOnce(f64, bool) -> Result<Option<f64>>,
    ) -> Result<ScaleChoice> {
        let vertices = self.scale_for_vertices.unwrap_or(0);
        let length = edge_length(vertices as f64, self.keep_thin)?.ok_or_else(|| {
            let voxel = is_labels.then(|| geometry.mean_spacing());
            nothing_left(&format!("a mesh of {vertices} vertices"), volume, voxel)
        })?;
        let whose = format!("the edge length of {} mm for {vertices} vertices", significant(length));
        Ok(ScaleChoice::for_length(length, &whose, geometry.mean_spacing(), is_labels))
    }
}

/// Returns the error for a scale that leaves nothing of an object of `volume` mm^3. `voxel` is the
/// mean spacing (mm) for labels, and `None` for scans.
fn nothing_left(by: &str, volume: f64, voxel: Option<f64>) -> Error {
    // surface area of a ball of that volume
    let area = (36.0 * PI * volume * volume).cbrt();
    let size = (2.0 * area / (3f64.sqrt() * 100.0)).sqrt();
    // if this edge length gives less than the minimum scale of labels, suggest one that needs no
    // scale
    let has_scale = |voxel: &f64| SCALE_OVER_SIZE * size >= LEAST_SCALE * voxel;
    let size = voxel.filter(|voxel| !has_scale(voxel)).map_or(size, |voxel| size.min(FINE_ENOUGH * voxel));
    Error::input(
        format!("{by}: nothing is left of the object of {} mm^3", significant(volume)),
        "parts smaller than the scale are smoothed away, and every part is smaller",
        format!(
            "set SIZE (--scale-for-size) to {size:.3} mm or less, which gives about 100 vertices; or lower SCALE \
             (--scale), raise VERTICES (--scale-for-vertices), or set DISTFIELD_OPTIONS=\"--keep-thin\""
        ),
    )
}

/// Chooses the scale and reports it to the user. Returns the volume and the scale; `None` means no
/// smoothing.
///
/// # Errors
/// If `--scale-for-vertices` is given and the area cannot be computed or nothing is left of the
/// object.
pub fn choose_scale(
    args: &ScaleArgs,
    volume: Volume,
    object: &Object,
    border: Border,
    context: &Context,
) -> Result<(Volume, Option<ScaleChoice>)> {
    if !args.is_given() {
        return Ok((volume, None));
    }
    let is_labels = matches!(object, Object::Labels(_));
    let (volume, choice) = match args.choose_by_length(&volume.geometry, is_labels) {
        Some(choice) => (volume, choice),
        None => {
            let _step = context.step("choose the scale");
            let occupancy = occupancy(&volume, object);
            let found = |vertices, keep_thin| edge_length(&occupancy, border, vertices, keep_thin);
            let choice = args.choose_by_area(&volume.geometry, is_labels, occupancy.volume(), found)?;
            (volume, choice)
        }
    };
    let ScaleChoice { length, reason } = &choice;
    context.summary("scale, mm", format!("{} ({reason})", significant(*length)));
    context.set_parameter("scale", *length);
    context.set_parameter("scale_reason", reason.clone());
    Ok((volume, (choice.length > 0.0).then_some(choice)))
}

/// Smooths the object and computes F. Also returns notes for the output file.
///
/// # Errors
/// If nothing is left of the object, or if the run is interrupted.
pub fn extract_scaled(
    ScaleChoice { length, reason }: ScaleChoice,
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
            json!({ "source": "scalar", "iso": iso, "inside": inside_name(*inside) })
        }
    };
    let voxel = matches!(object, Object::Labels(_)).then(|| volume.geometry.mean_spacing());
    drop(volume);
    let volume_before = occupancy.volume();
    let smoothed = scaled(occupancy, Scale { length, keep_thin }, options.keep, grid)?.ok_or_else(|| {
        nothing_left(&format!("a scale of {} mm ({reason})", significant(length)), volume_before, voxel)
    })?;
    drop(step);
    report_changes(&smoothed.changes, length, options.keep, context);
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

/// Maximum number of events of each kind listed on the terminal.
const MOST_NAMED: usize = 3;

/// Reports the changes in a summary and a message for each kind of event. Except for lost parts,
/// the events include those of parts that `keep` drops later.
fn report_changes(changes: &Changes, length: f64, keep: Keep, context: &Context) {
    let depth = changes.depth;
    context.summary(
        "voxel centres that changed sides",
        format!(
            "{}; depth: mean {} mm, 99th percentile {} mm, maximum {} mm",
            changes.voxels_changed,
            significant(depth.mean),
            significant(depth.p99),
            significant(depth.max)
        ),
    );
    let ([before, after], [euler_before, euler_after]) = (changes.components, changes.euler);
    context.summary("components of the data", format!("{before} -> {after}"));
    context.summary("Euler characteristic of the data (solid)", format!("{euler_before} -> {euler_after}"));
    for (&kind, &count) in &changes.counts {
        let events: Vec<&Event> = changes.events.iter().filter(|event| event.kind == kind).take(MOST_NAMED).collect();
        let named: Vec<String> = events.iter().map(|event| event_told(event)).collect();
        let more = if count > named.len() { format!(", and {} more", count - named.len()) } else { String::new() };
        let what = match kind {
            Kind::Broken => "parts are split",
            Kind::Gone => "parts are lost",
            Kind::Joined => "parts are merged",
            Kind::Shortened => "thin ends are lost",
            Kind::Filled => "narrow gaps are filled",
        };
        let (volume, named) = (changes.volumes.get(&kind).copied().unwrap_or(0.0), named.join("; "));
        let of_all = if keep == Keep::All || kind == Kind::Gone { "" } else { " of all parts, before --keep" };
        let said = format!(
            "at a scale of {} mm, {what} ({count}{of_all}, {} mm^3 in total): {named}{more}",
            significant(length),
            significant(volume)
        );
        if kind == Kind::Gone && changes.lost() < SPECK_SHARE * changes.volume_before {
            context.info(said);
        } else {
            context.warn(format!(
                "{said}; to prevent this, lower SCALE (--scale) or set DISTFIELD_OPTIONS=\"--keep-thin\""
            ));
        }
    }
}

fn event_told(event: &Event) -> String {
    let [x, y, z] = event.place;
    let pieces = match event.kind {
        Kind::Broken => format!(" in {} pieces", event.pieces),
        Kind::Joined => format!(" from {} parts", event.pieces),
        _ => String::new(),
    };
    format!("{} mm^3{pieces} at ({x:.1}, {y:.1}, {z:.1}) mm", significant(event.volume))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_of_labels_show_no_voxel_steps() {
        let of = |size: f64, is_labels: bool| ScaleChoice::for_length(size, "h", 2.0, is_labels).length;
        assert_eq!([1.5, 1.6, 3.4].map(|size| of(size, true)), [0.0, 5.4, 5.44]);
        assert_eq!([1.5, 1.6, 3.4].map(|size| of(size, false)), [0.0, 1.6 * 1.6, 5.44]);
    }
}
