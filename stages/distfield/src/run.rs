//! The `distfield` program: options, input checks, computation of F, and report.
//! [`materials::program`] handles several materials.

use crate::choose::{Object, ScaleArgs, ScaleChoice, choose_scale, extract_scaled};
use crate::crop::{CutFaces, Grid, VoxelBox, crop, room_of_spline};
use crate::input::{check_kind, check_room};
use crate::labels::{LabelOptions, from_mask, room_of_labels};
use crate::mask::Mask;
use crate::materials::{self, MaterialChoice};
use crate::scalar::{ScalarOptions, from_voxels};
use crate::scale::room_round;
use crate::unshear::{Wanted, unshear};
use crate::{Border, Inside, Keep, Redistanced};
use isoparticles_stage::cli::check::Known;
use isoparticles_stage::cli::{CommonArgs, Context, FILES, METHOD, Outcome, StageArgs};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{FieldKind, write_field};
use isoparticles_stage::meta::{self, CapPlane, DistanceMeta, Side, Source};
use isoparticles_survey::kind::KindChoice;
use isoparticles_survey::selection::{Selection, noted};
use isoparticles_volume::{Geometry, Image, LayerLabel, ReadOptions, Volume, read_volume_with};
use serde_json::{Map, Value, json};
use std::path::PathBuf;

/// Computes the signed distance field F (mm) of an object, from a volume and an iso value or labels
///
/// F is the implicit function of section 3.1 of the paper (Kim, Chen and Hansen 2012). The output
/// contains samples of the signed distance to the surface, negative inside; F is the cubic B-spline
/// that interpolates these samples. For a scalar volume, the surface is where the cubic B-spline
/// through the voxels equals the iso value. For labels, it is a smooth surface that preserves the
/// local volume and, without a scale, keeps every voxel centre on its side. The grid has the
/// spacing of the input. It covers the object (or the whole volume with --grid volume) and --margin
/// more voxels on each face.
#[derive(Clone, Debug, clap::Parser)]
#[command(
    name = "distfield",
    version,
    after_help = "Example: the tooth of a CT, integer iso values being fine\n  distfield tooth_ct.nrrd -o tooth.distfield.vti --iso 600\nExample: both lungs of a label map as one object\n  distfield lungs_label.nrrd -o lungs.distfield.vti --labels 2,3\nExample: every label of a volume as a material of its own\n  distfield brain_parcellation.nrrd -o brain.materials.vti --material all"
)]
pub struct Args {
    /// Volume to read: NRRD (.nrrd, .nhdr, .seg.nrrd), NIfTI (.nii, .nii.gz), MetaImage (.mha,
    /// .mhd), VTK image (.vti), or a folder of DICOM slices
    #[arg(value_name = "IN.nrrd", help_heading = FILES)]
    pub input: PathBuf,
    /// Series to read if the folder contains several: description, number or UID of the series
    #[arg(long, value_name = "NAME", help_heading = FILES)]
    pub series: Option<String>,
    /// VTK image file to write: the distance field F in mm, or one field per --material
    #[arg(short, long, value_name = "F.vti", help_heading = FILES)]
    pub output: PathBuf,
    /// Iso value of the surface, in the unit of the volume, between its minimum and maximum
    #[arg(
        long,
        value_name = "V",
        allow_negative_numbers = true,
        required_unless_present_any = ["labels", "material"],
        conflicts_with = "labels",
        help_heading = METHOD
    )]
    pub iso: Option<f64>,
    /// Side of the iso value that contains the object; for example, below for the lungs in a CT
    #[arg(long, value_enum, value_name = "SIDE", default_value_t = Inside::Above, help_heading = METHOD)]
    pub inside: Inside,
    /// Labels whose union is the object, separated by commas or spaces: numbers, ranges such as
    /// 2..5 (only labels that occur), all (every label except 0), or names from the file
    #[arg(long, value_name = "A,B", allow_hyphen_values = true, help_heading = METHOD)]
    pub labels: Option<Selection>,
    /// Define a material by its labels, such as lung=2+3; may be given several times. NAME alone
    /// means the label of that name in the file. all makes one material of each label except 0 that
    /// no other --material specifies. Other labels belong to the material "outside". The output
    /// contains one field for each material, including the outside
    #[arg(
        long,
        value_name = "NAME=A+B",
        allow_hyphen_values = true,
        conflicts_with_all = ["labels", "iso"],
        help_heading = METHOD
    )]
    pub material: Vec<MaterialChoice>,
    /// With --material: reassign each component of fewer voxels than this, including components of
    /// the outside, to the material that shares the most faces with it; 1 changes nothing. Changes
    /// are reported
    #[arg(long, value_name = "VOXELS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..), requires = "material", help_heading = METHOD)]
    pub smallest_island: u32,
    /// Kind of the volume. auto detects the kind from the values, and rejects labels for a scan and
    /// an iso value for a label map; give scan or labels if the detection is wrong
    #[arg(long, value_enum, value_name = "KIND", default_value_t = KindChoice::Auto, help_heading = METHOD)]
    pub kind: KindChoice,
    /// Treatment of the object at the border of the volume: cap closes the object half a voxel
    /// beyond the outermost voxel centres, with edges rounded by half a voxel; open continues the
    /// surface straight, so that it leaves the volume
    #[arg(long, value_enum, value_name = "HOW", default_value_t = Border::Cap, help_heading = METHOD)]
    pub border: Border,
    /// Extent of the grid: object is the bounding box of the object, enlarged by the voxels that F
    /// near the surface depends on; volume is the whole volume. The surface and its world
    /// coordinates are the same for both
    #[arg(long, value_enum, value_name = "WHICH", default_value_t = Grid::Object, help_heading = METHOD)]
    pub grid: Grid,
    /// Parts of the object to keep: all, only the largest, or those of at least VOLUME mm^3.
    /// Dropped parts are reported; cavities do not change
    #[arg(long, value_name = "all|largest|VOLUME", default_value_t = Keep::All, help_heading = METHOD)]
    pub keep: Keep,
    /// Number of voxels added on each face of the grid, 3 to 64, as room for F around the surface
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(3..=64), help_heading = METHOD)]
    pub margin: u16,
    /// Labels without a scale: minimum distance of the surface from every voxel centre, in units of
    /// the minimum voxel spacing, 0.01 to 0.15. The distance leaves room for the triangles, which
    /// deviate from the curved surface
    #[arg(long, value_name = "VOXELS", default_value_t = 0.05, value_parser = clearance_in_range, help_heading = METHOD)]
    pub clearance: f64,
    /// The options of the scale.
    #[command(flatten)]
    pub scale: ScaleArgs,
    /// The options of all stages.
    #[command(flatten)]
    pub common: CommonArgs,
}

fn clearance_in_range(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.01..=MOST_CLEARANCE).contains(&value) => Ok(value),
        _ => Err(format!("{text} is not a number from 0.01 to {MOST_CLEARANCE}")),
    }
}

/// Maximum clearance, in units of the minimum voxel spacing. The level set keeps twice this
/// distance, 0.3, and the surface of a layer one voxel thick is half a voxel from its voxel
/// centres.
const MOST_CLEARANCE: f64 = 0.15;

/// Maximum number of surfaces of F whose volumes are listed in the file and in the report.
const LISTED_SURFACES: usize = 100;

/// Limits of the distance between the zero sets of F and of its source, in voxels: mean and 99th
/// percentile. The program prints a warning above either limit.
const SHIFT_LIMITS: (f64, f64) = (0.03, 0.15);

/// Limits of the relative change of the volume: a warning is printed above the first, and a check
/// fails above the second. Layers one voxel thick change by up to 8 %, layers two voxels thick by
/// up to 3 % (test `thin_layers_and_rods_keep_their_volume`), and specks of single voxels by up to
/// 20 %.
pub(crate) const VOLUME_LIMITS: (f64, f64) = (0.05, 0.25);

/// Limits of the relative change of the volume with a scale above 0, which preserves the volume.
/// Meshes of solid organs with 1,000 vertices change by up to 2 %. A mesh whose volume changes by
/// 10 % does not represent the object: ribs and trabecular bone at a few thousand vertices change
/// by 20 to 42 %.
pub(crate) const SCALED_VOLUME_LIMITS: (f64, f64) = (0.02, 0.1);

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        &self.common
    }

    fn outputs(&self) -> Vec<PathBuf> {
        vec![self.output.clone()]
    }

    fn parameters(&self) -> Value {
        let (border, keep) = (border_name(self.border), self.keep.to_string());
        let mut parameters = match (&self.labels, self.iso) {
            _ if !self.material.is_empty() => json!({
                "material": self.material.iter().map(MaterialChoice::to_string).collect::<Vec<_>>(), "border": border,
                "margin": self.margin, "clearance": self.clearance, "smallest_island": self.smallest_island,
            }),
            (Some(labels), _) => json!({
                "labels": labels.to_string(), "border": border, "margin": self.margin, "keep": keep,
                "clearance": self.clearance,
            }),
            (None, iso) => {
                json!({
                    "iso": iso, "inside": inside_name(self.inside), "border": border, "margin": self.margin, "keep": keep,
                })
            }
        };
        if let Some(kind) = self.kind.given() {
            parameters["kind"] = json!(kind);
        }
        parameters["grid"] = json!(grid_name(self.grid));
        self.scale.add_to(&mut parameters);
        if let Some(series) = &self.series {
            parameters["series"] = json!(series);
        }
        parameters
    }

    fn check_options(&self, known: Known) -> Result<Known> {
        crate::check::check(self, known)
    }
}

/// Runs the stage.
///
/// # Errors
/// If the input has no such surface, there is not enough memory, a file cannot be read or written,
/// or the run is interrupted.
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    let step = context.step("read");
    let volume = read_volume_with(&args.input, &ReadOptions { series: args.series.as_deref() })?;
    context.add_input(&args.input, None)?;
    drop(step);
    for remark in &volume.remarks {
        context.warn(remark);
    }
    let about_file = |error: Error| Error { what: format!("{}: {}", args.input.display(), error.what), ..error };
    check_kind(args, &volume, context).map_err(about_file)?;
    let labels = args.labels.as_ref().map(|labels| labels.resolve(&volume)).transpose().map_err(about_file)?;
    if !args.material.is_empty() {
        let volume = unshear(volume, Wanted::Materials(&args.material), args.border, context).map_err(about_file)?;
        return materials::program::run(args, volume, &args.output, context).map_err(about_file);
    }
    let object = match (labels, args.iso) {
        (Some(labels), _) => Object::Labels(labels),
        (None, Some(iso)) => Object::Iso(iso, args.inside),
        (None, None) => {
            return Err(Error::input(
                "neither --iso nor --labels was given",
                "they say which surface is meant",
                "give --iso for a scalar volume or --labels for a label map",
            ));
        }
    };
    let wanted = match &object {
        Object::Labels(labels) => Wanted::Labels(labels),
        Object::Iso(iso, inside) => Wanted::Iso(*iso, *inside),
    };
    let volume = unshear(volume, wanted, args.border, context).map_err(about_file)?;
    let margin = usize::from(args.margin);
    let (volume, found) = object.locate(volume).map_err(about_file)?;
    let (mut volume, scale) = choose_scale(&args.scale, volume, &object, args.border, context).map_err(about_file)?;
    let whole = volume.geometry.clone();
    let cut = take_out(args, &mut volume, found, room(margin, &whole, &object, scale.as_ref()), context)
        .map_err(about_file)?;
    let options = ScalarOptions { inside: args.inside, border: args.border, margin, cut, keep: args.keep };
    let (result, mut meta) = match (scale, &object) {
        (Some(scale), _) => extract_scaled(scale, args.scale.keep_thin, volume, &object, (args.grid, options), context),
        (None, Object::Labels(labels)) => extract_labels(args, volume, labels, cut, context),
        (None, Object::Iso(iso, _)) => extract_iso(volume, *iso, &options, context),
    }
    .map_err(about_file)?;
    let cap_planes = match args.border {
        Border::Cap => cap_planes(&result.field, &whole),
        Border::Open => Vec::new(),
    };
    tell_grid(&whole.padded(margin), &result.field.geometry, context);
    meta["margin"] = json!(margin);
    meta["dropped"] = json!(result.dropped);
    meta["components_before"] = json!(result.parts_before.components);
    meta["cavities_before"] = json!(result.parts_before.cavities);
    meta["components"] = json!(result.parts_after.components);
    meta["cavities"] = json!(result.parts_after.cavities);
    meta["volume"] = json!(result.parts_after.volume);
    meta["volumes"] = json!(result.volumes.iter().take(LISTED_SURFACES).collect::<Vec<_>>());
    meta["zero_set_shift"] = json!(result.shift);
    let meta = distance_meta(&object, args.border, cap_planes, meta);
    describe(&result, &meta, context);

    let step = context.step("write");
    write_field(&args.output, FieldKind::Distance, &result.field, &meta, &context.history())?;
    drop(step);
    let mut failed = failed_checks(&result, context);
    if let Some(change) = volume_change(&result, &meta) {
        let is_scaled = meta.is_scaled();
        let (limits, reason) = if is_scaled {
            (
                SCALED_VOLUME_LIMITS,
                "too much of the object is thinner than a mesh of that scale tells apart (a finer mesh or --keep-thin keeps more)",
            )
        } else {
            (VOLUME_LIMITS, "much of it is one voxel thin, or specks (--keep drops them)")
        };
        let told = format!("the volume changed by {:+.0} %: {reason}", 100.0 * change);
        if change.abs() > limits.1 {
            failed.push(told);
        } else if change.abs() > limits.0 {
            context.warn(told);
        }
    }
    Ok(Outcome::from_failed_checks(failed))
}

/// Builds the metadata of the file: fields for later stages, and `notes` for people.
fn distance_meta(object: &Object, border: Border, cap_planes: Vec<CapPlane>, notes: Value) -> DistanceMeta {
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
        border: Some(match border {
            Border::Cap => meta::Border::Cap,
            Border::Open => meta::Border::Open,
        }),
        cap_planes,
        scale: number("scale"),
        volume_before: number("volume_before"),
        notes,
    }
}

/// F and the notes for its metadata.
type Extracted = (Redistanced, Value);

/// Returns the number of voxels to keep around the object because F near the surface depends on
/// them.
fn room(margin: usize, geometry: &Geometry, object: &Object, scale: Option<&ScaleChoice>) -> [usize; 3] {
    match (scale, object) {
        (Some(scale), Object::Labels(_)) => room_round(0.5 * scale.length / geometry.spacing),
        (None, Object::Labels(_)) => room_of_labels(margin),
        // voxels next to inside voxels are partly occupied, too
        (Some(scale), Object::Iso(..)) => room_round(0.5 * scale.length / geometry.spacing).map(|room| room + 1),
        (None, Object::Iso(..)) => room_of_spline(),
    }
}

/// Crops the volume to the grid that `--grid` selects. Returns the faces where the volume was cut.
///
/// # Errors
/// If F needs more memory than is available.
pub(crate) fn take_out(
    args: &Args,
    volume: &mut Volume,
    found: Option<VoxelBox>,
    room: [usize; 3],
    context: &Context,
) -> Result<CutFaces> {
    let size = volume.geometry.size;
    let kept = found.filter(|_| args.grid == Grid::Object).map(|object| object.with_room(room, size).on_coarse_nodes());
    check_room(args, kept.map_or(size, |kept| kept.size()), context)?;
    Ok(kept.map_or_else(CutFaces::default, |kept| crop(volume, kept)))
}

/// Reports the number of grid nodes of F and of the whole volume.
pub(crate) fn tell_grid(whole: &Geometry, made: &Geometry, context: &Context) {
    let told = |[nx, ny, nz]: [usize; 3]| format!("{nx} x {ny} x {nz}");
    if whole.size == made.size {
        context.summary("grid, nodes", told(made.size));
    } else {
        let share = 100.0 * made.voxel_count() as f64 / whole.voxel_count() as f64;
        context.summary("grid, nodes", format!("{} of {} ({share:.0} %)", told(made.size), told(whole.size)));
    }
    context.report("grid", json!({ "nodes": made.size, "nodes_of_volume": whole.size }));
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
        border: args.border,
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

/// Returns the planes that close the object at the border of the volume, in the grid frame of F:
/// axis (0 to 2), side, and position in mm. `whole` is the grid of the volume.
fn cap_planes(field: &Image<f32>, whole: &Geometry) -> Vec<CapPlane> {
    let size = field.geometry.size;
    // index of the volume's first voxel in the grid of F, from the world positions of both grids
    let first = field.geometry.grid_to_index(field.geometry.world_to_grid(whole.origin)).round();
    let mut planes = Vec::new();
    for axis in 0..3 {
        let low = first[axis] as isize;
        for (side, layer) in [(Side::Low, low), (Side::High, low + whole.size[axis] as isize - 1)] {
            let Some(layer) = usize::try_from(layer).ok().filter(|&layer| layer < size[axis]) else { continue };
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let is_inside = |a: usize, b: usize| {
                let mut index = [0; 3];
                (index[axis], index[u], index[v]) = (layer, a, b);
                field.at(index[0], index[1], index[2]) < 0.0
            };
            if (0..size[v]).any(|b| (0..size[u]).any(|a| is_inside(a, b))) {
                let beyond = if side == Side::Low { -0.5 } else { 0.5 };
                let position = (layer as f64 + beyond) * field.geometry.spacing[axis];
                planes.push(CapPlane { axis, side, position });
            }
        }
    }
    planes
}

/// Returns the relative difference between the volume enclosed by F = 0 and the volume of the kept
/// voxels. Returns `None` for an isosurface without a scale, or if an open border leaves the
/// surface open.
fn volume_change(result: &Redistanced, meta: &DistanceMeta) -> Option<f64> {
    if result.volumes.is_empty() {
        return None;
    }
    let voxels = meta.volume_before? - result.dropped.volume;
    Some(result.parts_after.volume / voxels - 1.0)
}

fn describe(result: &Redistanced, meta: &DistanceMeta, context: &Context) {
    let (before, after) = (result.parts_before, result.parts_after);
    let dropped = &result.dropped;
    if dropped.components > 0 {
        let told = format!(
            "{} of {:.6e} mm^3 together, the largest of {:.6e}",
            dropped.components, dropped.volume, dropped.largest
        );
        context.summary("components dropped", told);
    }
    context.summary("components", format!("{} -> {}", before.components, after.components));
    context.summary("cavities", format!("{} -> {}", before.cavities, after.cavities));
    match volume_change(result, meta) {
        Some(change) => {
            let (voxels, change) = (after.volume / (1.0 + change), 100.0 * change);
            context.summary("volume, mm^3", format!("{voxels:.6e} -> {:.6e} ({change:+.2} %)", after.volume));
        }
        None => context.summary("volume, mm^3", format!("{:.6e}", after.volume)),
    }
    if let Some(changed) = result.changed {
        context.summary("voxel centres that changed side", changed);
    }
    let shift = result.shift;
    context.summary(
        "shift of the zero set, voxels",
        format!("mean {:.4}, 99th percentile {:.4}, largest {:.3}", shift.mean, shift.p99, shift.max),
    );
    context.report("held_nodes", result.held_nodes);
    context.report("undecided_junctions", result.undecided);
    context.report("zero_set_fit", json!(result.fit));
    context.report("meta", json!(meta));
    if shift.mean > SHIFT_LIMITS.0 || shift.p99 > SHIFT_LIMITS.1 {
        context.warn(format!(
            "the zero set of F is {:.3} voxel from that of the input on average and {:.3} at the 99th percentile: the surface \
             folds within a voxel in many places, which no distance field on this grid can hold; smooth the input, or \
             choose another iso value",
            shift.mean, shift.p99
        ));
    }
}

/// Checks that components, cavities and the sides of voxel centres are preserved. Label surfaces
/// guarantee this, so a difference is a failed check. An isosurface can fold within a voxel, where
/// the number of parts depends on rounding; a difference is then only a warning.
fn failed_checks(result: &Redistanced, context: &Context) -> Vec<String> {
    let (before, after) = (result.parts_before, result.parts_after);
    let mut failed = Vec::new();
    if (before.components, before.cavities) != (after.components, after.cavities) {
        let difference = format!(
            "components and cavities: {} and {} in the input, {} and {} in F",
            before.components, before.cavities, after.components, after.cavities
        );
        if result.changed.is_some() {
            failed.push(difference);
        } else {
            context.warn(difference);
        }
    }
    if let Some(changed) = result.changed.filter(|&changed| changed > 0) {
        failed.push(format!("{changed} voxel centres changed side"));
    }
    failed
}

fn grid_name(grid: Grid) -> &'static str {
    match grid {
        Grid::Object => "object",
        Grid::Volume => "volume",
    }
}

fn border_name(border: Border) -> &'static str {
    match border {
        Border::Cap => "cap",
        Border::Open => "open",
    }
}

pub(crate) fn inside_name(inside: Inside) -> &'static str {
    match inside {
        Inside::Above => "above",
        Inside::Below => "below",
    }
}
