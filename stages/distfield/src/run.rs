//! The `distfield` program: reads the volume, computes F and writes the file. [`compute()`] does
//! not access files, so it can be called as a library. [`materials`] computes several materials.

pub use crate::args::Args;
use crate::args::BorderChoice;
use crate::check::check;
use crate::choose::{Object, ScaleChoice, choose_scale, extract_scaled, inside_name};
use crate::crop::room_of_spline;
use crate::faces::touched_faces;
use crate::input::take_out;
use crate::labels::{LabelOptions, from_mask, room_of_labels};
use crate::mask::Mask;
use crate::reduce::reduce;
use crate::report::{LISTED_SURFACES, check_volume, describe, failed_checks, tell_grid};
use crate::scalar::{ScalarOptions, from_voxels};
use crate::scale::room_round;
use crate::unshear::{Wanted, unshear};
use crate::{Redistanced, materials};
use isoparticles_stage::cli::check::Known;
use isoparticles_stage::cli::{CommonArgs, Context, Outcome, StageArgs};
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, FieldKind};
use isoparticles_stage::meta::{self, CapPlane, DistanceMeta, Source};
use isoparticles_stage::space;
use isoparticles_survey::selection::noted;
use isoparticles_volume::{CutFaces, Geometry, Image, LayerLabel, Volume};
use serde_json::{Map, Value, json};
use std::path::PathBuf;
use std::sync::Arc;

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        &self.common
    }

    fn outputs(&self) -> Vec<PathBuf> {
        vec![self.output.clone()]
    }

    fn parameters(&self) -> Value {
        self.to_parameters()
    }

    fn check_options(&self, known: Known) -> Result<Known> {
        check(self, known)
    }
}

/// Runs the stage.
///
/// # Errors
/// If the input does not contain the selected surface, if there is not enough memory, if a file
/// cannot be read or written, or if the run is interrupted.
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    let volume = args.input.load(context)?;
    let made = compute(args, volume, context)?;
    let step = context.step("write");
    made.distance.write(&args.output)?;
    drop(step);
    Ok(Outcome::from_failed_checks(made.failed))
}

/// The result of the stage.
#[derive(Debug)]
pub struct Made {
    /// The distance field, or the indicators of several materials, with its history.
    pub distance: DistanceField,
    /// The checks that failed, in words.
    pub failed: Vec<String>,
}

/// Computes F, or the indicators of several materials, from a whole volume, which is first cropped
/// and downsampled. Messages contain the path in `args`.
///
/// # Errors
/// If the volume does not contain the selected surface, if there is not enough memory, or if the
/// run is interrupted.
pub fn compute(args: &Args, volume: Volume, context: &Context) -> Result<Made> {
    if args.border == BorderChoice::Open && !args.cut.is_empty() {
        return Err(Error::input(
            "--cut cannot be combined with --border open (BORDER=open)",
            "an object that ends at planes must also be closed at the border of the volume",
            "use BORDER=flat or BORDER=cap (--border flat or cap), or leave out --cut",
        ));
    }
    for remark in &volume.remarks {
        context.warn(remark);
    }
    let mut volume = reduce(args, volume, context)?;
    let about_file = |error: Error| Error { what: format!("{}: {}", args.input.name(), error.what), ..error };
    volume.geometry = args.space.of(volume.geometry, Some(volume.file_space)).map_err(about_file)?;
    context.set_parameter("space", space::parameter(volume.geometry.space));
    context.set_parameter(space::FILE_SPACE, space::parameter(volume.file_space));
    let labels = args.labels.as_ref().map(|labels| labels.resolve(&volume)).transpose().map_err(about_file)?;
    if !args.material.is_empty() {
        let volume =
            unshear(volume, Wanted::Materials(&args.material), args.border.of_fields(), context).map_err(about_file)?;
        let (file, failed) = materials::compute(args, volume, context).map_err(about_file)?;
        return Ok(Made { distance: DistanceField::Materials(Arc::new(file)), failed });
    }
    let object = object(args, labels)?;
    let (result, meta) = make(args, volume, &object, context).map_err(about_file)?;
    describe(&result, &meta, context);
    let mut failed = failed_checks(&result, &meta, context);
    failed.extend(check_volume(&result, &meta, args.scale.accept_losses, context));
    if args.border == BorderChoice::Flat || !args.cut.is_empty() {
        let file = materials::object_with_planes(args, result.field, &object, meta, context).map_err(about_file)?;
        return Ok(Made { distance: DistanceField::Materials(Arc::new(file)), failed });
    }
    let (image, meta, history) = (Arc::new(result.field), json!(meta), Some(context.history()));
    Ok(Made { distance: DistanceField::Object(Field { image, meta, history, kind: FieldKind::Distance }), failed })
}

/// Returns the object that the options select. `labels` contains the resolved labels of `--labels`.
fn object(args: &Args, labels: Option<Vec<LayerLabel>>) -> Result<Object> {
    match (labels, args.iso) {
        (Some(labels), _) => Ok(Object::Labels(labels)),
        (None, Some(iso)) => Ok(Object::Iso(iso, args.inside)),
        (None, None) => Err(Error::input(
            "neither --iso nor --labels was given",
            "they say which surface is meant",
            "give --iso for a scalar volume or --labels for a label map",
        )),
    }
}

/// Computes F of an object, and the metadata of the file.
fn make(args: &Args, volume: Volume, object: &Object, context: &Context) -> Result<(Redistanced, DistanceMeta)> {
    let wanted = match object {
        Object::Labels(labels) => Wanted::Labels(labels),
        Object::Iso(iso, inside) => Wanted::Iso(*iso, *inside),
    };
    let volume = unshear(volume, wanted, args.border.of_fields(), context)?;
    let margin = usize::from(args.margin);
    let (volume, found) = object.locate(volume)?;
    let (mut volume, scale) = choose_scale(&args.scale, volume, object, args.border.of_fields(), context)?;
    let whole = volume.geometry.clone();
    let cut = take_out(args, &mut volume, found, room(margin, &whole, object, scale.as_ref()), context)?;
    let options = ScalarOptions { inside: args.inside, border: args.border.of_fields(), margin, cut, keep: args.keep };
    let (result, mut notes) = match (scale, object) {
        (Some(scale), _) => extract_scaled(scale, args.scale.keep_thin, volume, object, (args.grid, options), context),
        (None, Object::Labels(labels)) => extract_labels(args, volume, labels, cut, context),
        (None, Object::Iso(iso, _)) => extract_iso(volume, *iso, &options, context),
    }?;
    let cap_planes = match args.border {
        BorderChoice::Open => Vec::new(),
        BorderChoice::Cap | BorderChoice::Flat => {
            touched_faces(&result.field.geometry, &whole, |[i, j, k]| result.field.at(i, j, k) < 0.0)
        }
    };
    tell_grid(&whole.padded(margin), &result.field.geometry, context);
    notes["margin"] = json!(margin);
    notes["dropped"] = json!(result.dropped);
    notes["components_before"] = json!(result.parts_before.components);
    notes["cavities_before"] = json!(result.parts_before.cavities);
    notes["components"] = json!(result.parts_after.components);
    notes["cavities"] = json!(result.parts_after.cavities);
    notes["volume"] = json!(result.parts_after.volume);
    notes["volumes"] = json!(result.volumes.iter().take(LISTED_SURFACES).collect::<Vec<_>>());
    notes["zero_set_shift"] = json!(result.shift);
    let meta = distance_meta(object, args.border, cap_planes, notes);
    Ok((result, meta))
}

/// Builds the metadata of the file: the fields that later stages read, and the remaining `notes`.
fn distance_meta(object: &Object, border: BorderChoice, cap_planes: Vec<CapPlane>, notes: Value) -> DistanceMeta {
    let mut notes = match notes {
        Value::Object(notes) => notes,
        _ => Map::new(),
    };
    notes.remove("source");
    let mut number = |key: &str| notes.remove(key).and_then(|value| value.as_f64());
    DistanceMeta {
        version: meta::VERSION,
        source: Some(match object {
            Object::Labels(_) => Source::Labels,
            Object::Iso(..) => Source::Scalar,
        }),
        border: Some(border.into()),
        cap_planes,
        scale: number("scale"),
        volume_before: number("volume_before"),
        notes,
    }
}

/// F and the notes for its metadata.
type Extracted = (Redistanced, Value);

/// Returns the number of voxels around the object that F near the surface depends on.
fn room(margin: usize, geometry: &Geometry, object: &Object, scale: Option<&ScaleChoice>) -> [usize; 3] {
    match (scale, object) {
        (Some(scale), Object::Labels(_)) => room_round(0.5 * scale.length / geometry.spacing),
        (None, Object::Labels(_)) => room_of_labels(margin),
        // the neighbours of inside voxels can be partly inside
        (Some(scale), Object::Iso(..)) => room_round(0.5 * scale.length / geometry.spacing).map(|room| room + 1),
        (None, Object::Iso(..)) => room_of_spline(),
    }
}

fn extract_iso(volume: Volume, iso: f64, options: &ScalarOptions, context: &Context) -> Result<Extracted> {
    let result = from_voxels(volume.voxels, volume.geometry, iso, options, context)?;
    let meta = json!({ "source": "scalar", "iso": iso, "inside": inside_name(options.inside) });
    Ok((result, meta))
}

fn extract_labels(
    args: &Args,
    volume: Volume,
    labels: &[LayerLabel],
    cut: CutFaces,
    context: &Context,
) -> Result<Extracted> {
    let told = noted(labels, &volume);
    context.set_parameter("labels", told.clone());
    let image = Image { data: volume.label_mask(labels), geometry: volume.geometry };
    drop((volume.voxels, volume.more_layers));
    let mask = Mask::from(&image);
    drop(image);
    let volume_before = mask.inside.count() as f64 * mask.geometry.spacing.element_product();
    let options = LabelOptions {
        border: args.border.of_fields(),
        margin: usize::from(args.margin),
        cut,
        clearance: args.clearance,
        keep: args.keep,
    };
    let result = from_mask(mask, &options, context)?;
    let meta = json!({
        "source": "labels", "labels": told, "clearance": args.clearance, "volume_before": volume_before,
        "voxels_changed": result.changed,
    });
    Ok((result, meta))
}
