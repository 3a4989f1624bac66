//! The program: options, checks of the input, the run, the report.

use crate::choose::{Choice as ScaleChoice, Object, ScaleArgs, choose_scale, extract_scaled};
use crate::crop::{CutFaces, Grid, VoxelBox, crop, room_of_spline};
use crate::input::{check_kind, check_room};
use crate::labels::{LabelOptions, from_mask, room_of_labels};
use crate::mask::Mask;
use crate::materials::{self, Choice};
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

/// A volume and an iso value, or labels, become the signed distance field F
///
/// F is the implicit function of section 3.1 of the paper (Kim, Chen and Hansen 2012): samples of
/// the signed distance to the surface in mm, negative inside, read as the cubic B-spline that
/// interpolates them. For a scalar volume the surface is that of the cubic B-spline through the
/// voxels at the iso value; for labels it is a smooth one that leaves every voxel centre on its
/// side and keeps the volume of each place. The grid is that of the input, of which --grid object
/// keeps the box of the object, with --margin more voxels on each face.
#[derive(Clone, Debug, clap::Parser)]
#[command(
    name = "distfield",
    version,
    after_help = "Example: the tooth of a CT, integer iso values being fine\n  distfield tooth_ct.nrrd -o tooth.distfield.vti --iso 600\nExample: both lungs of a label map as one object\n  distfield lungs_label.nrrd -o lungs.distfield.vti --labels 2,3\nExample: every label of a volume as a material of its own\n  distfield brain_parcellation.nrrd -o brain.materials.vti --material all"
)]
pub struct Args {
    /// Volume to read: NRRD (.nrrd, .nhdr, .seg.nrrd), NIfTI (.nii, .nii.gz), MetaImage (.mha, .mhd), VTK image (.vti), or a folder of
    /// DICOM slices
    #[arg(value_name = "IN.nrrd", help_heading = FILES)]
    pub input: PathBuf,
    /// Series to read of a folder with several: its description, number or UID
    #[arg(long, value_name = "NAME", help_heading = FILES)]
    pub series: Option<String>,
    /// Distance field to write, a VTK image file; lengths in mm
    #[arg(short, long, value_name = "F.vti", help_heading = FILES)]
    pub output: PathBuf,
    /// Iso value of a scalar volume, in its own unit; between its smallest and largest value
    #[arg(
        long,
        value_name = "V",
        allow_negative_numbers = true,
        required_unless_present_any = ["labels", "material"],
        conflicts_with = "labels",
        help_heading = METHOD
    )]
    pub iso: Option<f64>,
    /// Side of the iso value that the object is on: lungs in a CT are the low side, --inside below
    #[arg(long, value_enum, value_name = "SIDE", default_value_t = Inside::Above, help_heading = METHOD)]
    pub inside: Inside,
    /// Labels whose union is the object, separated by commas or blanks: whole numbers, ranges such as 2..5 (those of them that occur),
    /// all (but 0), or the names that the file gives its labels
    #[arg(long, value_name = "A,B", allow_hyphen_values = true, help_heading = METHOD)]
    pub labels: Option<Selection>,
    /// A material of its own, made of these labels; once for each material. NAME alone where the file has that name, all for one material of each label but 0
    /// that no other names. What has no name is the material outside. The output holds a field for each
    #[arg(
        long,
        value_name = "NAME=A+B",
        allow_hyphen_values = true,
        conflicts_with_all = ["labels", "iso"],
        help_heading = METHOD
    )]
    pub material: Vec<Choice>,
    /// Materials: give components of fewer voxels than this, of the outside as well, to the material that they share the most faces with. They are told by material
    #[arg(long, value_name = "VOXELS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..), requires = "material", help_heading = METHOD)]
    pub smallest_island: u32,
    /// What the values are: scan or labels, where auto is mistaken. Labels of a scan and an iso value of labels are refused
    #[arg(long, value_enum, value_name = "KIND", default_value_t = KindChoice::Auto, help_heading = METHOD)]
    pub kind: KindChoice,
    /// What happens where the object meets the border of the volume: cap closes it half a voxel beyond the outermost voxel
    /// centres, with edges rounded by half a voxel; open lets the surface run on straight and leave the volume
    #[arg(long, value_enum, value_name = "HOW", default_value_t = Border::Cap, help_heading = METHOD)]
    pub border: Border,
    /// Grid of the field: object is the box of the object with the room round it that the field near its surface depends on; volume is the whole
    /// volume. The surface and its place in the world are the same
    #[arg(long, value_enum, value_name = "WHICH", default_value_t = Grid::Object, help_heading = METHOD)]
    pub grid: Grid,
    /// Parts of the object to keep: all, the largest alone, or those of at least this volume in mm^3. What is dropped is told;
    /// cavities stay as they are
    #[arg(long, value_name = "all|largest|VOLUME", default_value_t = Keep::All, help_heading = METHOD)]
    pub keep: Keep,
    /// Voxels added on each face of the grid, 3 to 64: room for the surface's neighbourhood
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(3..=64), help_heading = METHOD)]
    pub margin: u16,
    /// Labels: least distance of the surface from every voxel centre, in voxels (smallest spacing),
    /// 0.01 to 0.15; room for the chords of the triangles to come
    #[arg(long, value_name = "VOXELS", default_value_t = 0.05, value_parser = clearance_in_range, help_heading = METHOD)]
    pub clearance: f64,
    /// How much of the data is kept.
    #[command(flatten)]
    pub scale: ScaleArgs,
    /// The options that every stage has.
    #[command(flatten)]
    pub common: CommonArgs,
}

fn clearance_in_range(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.01..=MOST_CLEARANCE).contains(&value) => Ok(value),
        _ => Err(format!("{text} is not a number from 0.01 to {MOST_CLEARANCE}")),
    }
}

/// Largest clearance, in voxels: the level set aims at twice that, and a layer of one voxel has
/// half a voxel.
const MOST_CLEARANCE: f64 = 0.15;

/// Surfaces of F whose volumes the file and the report list.
const LISTED_SURFACES: usize = 100;

/// Shift of the zero set (voxels; mean and 99th percentile) above which the user is warned.
const SHIFT_LIMITS: (f64, f64) = (0.03, 0.15);

/// Change of the volume, as a share, above which the user is warned, and above which that is a
/// failed check. Layers of one voxel change by up to 8 %, of two by 3 % (test
/// `thin_layers_and_rods_keep_their_volume`), specks of single voxels by up to 20 %.
pub(crate) const VOLUME_LIMITS: (f64, f64) = (0.05, 0.25);

/// The same for a scale, which is made to keep the volume: meshes of solid organs with 1,000
/// vertices change by up to 2 %; what changes by 10 % (ribs and trabecular bone at a few thousand
/// vertices: 20 to 42 %) is no mesh of the object.
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
                "material": self.material.iter().map(Choice::to_string).collect::<Vec<_>>(), "border": border,
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
/// On input that holds no such surface, on files that cannot be read or written, and when interrupted.
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

/// What the next stages are told, with the notes that are for people.
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

/// F and what to note about it.
type Extracted = (Redistanced, Value);

/// Voxels round the object that the field near its surface depends on.
fn room(margin: usize, geometry: &Geometry, object: &Object, scale: Option<&ScaleChoice>) -> [usize; 3] {
    match (scale, object) {
        (Some(scale), Object::Labels(_)) => room_round(0.5 * scale.length / geometry.spacing),
        (None, Object::Labels(_)) => room_of_labels(margin),
        // a voxel next to those inside has a share as well
        (Some(scale), Object::Iso(..)) => room_round(0.5 * scale.length / geometry.spacing).map(|room| room + 1),
        (None, Object::Iso(..)) => room_of_spline(),
    }
}

/// Leaves of the volume what `--grid` asks for, if there is room for its field; tells the faces at which it was cut.
///
/// # Errors
/// When the field takes more memory than there is.
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

/// Says how many nodes there are, and how many the whole volume would have.
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

/// The planes at which the border of the volume, whose grid is `whole`, cut the object, in the grid frame of the field: axis (0 to 2), side, position in mm.
fn cap_planes(field: &Image<f32>, whole: &Geometry) -> Vec<CapPlane> {
    let size = field.geometry.size;
    // of the first voxel of the volume, by the place of both grids in the world
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

/// How much larger the volume within F = 0 is than that of the labels' voxels that were kept, as a
/// share; none where an open border leaves the surface open.
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

/// Labels are made such that these hold. A scalar volume may fold within a voxel, where the count
/// of parts is a matter of rounding: there a difference is a warning.
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
