//! The `sizefield` program: reads the surface, derives defaults from the data, computes h, fills in
//! the report and writes the file. [`compute()`] reads only the files of `--refine`, so it can be
//! called as a library.

pub use crate::args::Args;
use crate::args::Defaults;
use crate::feature::{Bumps, Features, Purpose};
use crate::limits::{check_bounds, check_count, check_size, too_small, too_small_told};
use crate::region::{SizedNode, refined_nodes};
use crate::report::{describe, noise_told, warn_if_too_coarse};
use crate::resize::resized_by;
use crate::vertices::{predicted_for, scaled_to_vertices, size_for_vertices};
use crate::{Parameters, lowered, size_field, uniform_field, wanted_sizes};
use glam::DVec3;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldComponents;
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::distance_field::DistanceField;
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, FieldKind, read_field};
use isoparticles_stage::meta::{self, DistanceMeta, SizeMeta, Source};
use isoparticles_volume::Image;
use serde_json::json;
use std::path::Path;
use std::sync::Arc;

/// Maximum radius of medial balls in units of the diagonal of the volume. With the defaults of
/// every quality level, feature sizes above 0.2 times the object's diagonal (`maximum h / epsilon`)
/// do not change h.
const LARGEST_FEATURE_DIAGONALS: f64 = 0.25;

/// Runs the stage.
///
/// # Errors
/// If a file cannot be read or written; and the errors of [`compute()`].
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    args.refuse_refined_constant()?;
    let step = context.step("read");
    let made = match &args.update {
        Some(path) => {
            let previous = read_field(path, FieldKind::Sizing)?;
            context.add_input(path, previous.history.clone())?;
            drop(step);
            update(args, &previous, context)?
        }
        None => {
            let distance = DistanceField::read(&args.input)?;
            context.add_input(&args.input, distance.history().cloned())?;
            drop(step);
            compute(args, &distance, context)?
        }
    };
    let _step = context.step("write");
    made.write(&args.output)?;
    Ok(Outcome::Passed)
}

/// Computes the sizing field of one object or of several materials. Messages call the surface by
/// the path in `args`.
///
/// # Errors
/// If there is no surface, if the options do not fit the surface, if a file of `--refine` cannot be
/// read, if there is not enough memory, or if the run is interrupted.
pub fn compute(args: &Args, distance: &DistanceField, context: &Context) -> Result<Field> {
    let (sizing, meta) = match distance {
        DistanceField::Object(field) => of_object(args, field, context)?,
        DistanceField::Materials(file) => crate::materials::compute(args, &file.materials, context)?,
    };
    context.check_interrupt()?;
    let (image, meta, history) = (sizing.into_image(), json!(meta), Some(context.history()));
    Ok(Field { image, meta, history, kind: FieldKind::Sizing })
}

/// Applies `--resize` to a previous sizing field. Without `--delta`, the delta of the previous
/// field applies.
///
/// # Errors
/// If a file of `--resize` cannot be read, or if a region lies outside the grid.
pub fn update(args: &Args, previous: &Field, context: &Context) -> Result<Field> {
    let of_previous = previous.history.as_ref().and_then(|history| history.parameters["delta"].as_f64());
    let delta = args.delta.or(of_previous).unwrap_or_else(|| args.delta());
    context.set_parameter("delta", delta);
    let sizing = resized_by(args, delta, SizingField::new(Arc::clone(&previous.image)), context)?;
    let before: SizeMeta = meta::typed(args.update.as_deref().unwrap_or(&args.input), &previous.meta, "sizefield")?;
    // notes about the shape of the object remain valid; notes about h do not
    let notes = before.notes.into_iter().filter(|(name, _)| name != "size_at_surface" && name != "too_small").collect();
    let meta = SizeMeta { version: meta::VERSION, components: before.components, predicted_count: None, notes };
    let (image, meta, history) = (sizing.into_image(), json!(meta), Some(context.history()));
    Ok(Field { image, meta, history, kind: FieldKind::Sizing })
}

/// Computes the sizing field of one object, and the metadata of its file.
fn of_object(args: &Args, field: &Field, context: &Context) -> Result<(SizingField, SizeMeta)> {
    args.refuse_sizes()?;
    let input = Input::new(field, context)?;
    let measured = measure(args, &input, context)?;
    let (sizing, lowered) = sized(args, &input, &measured, context)?;
    let sizing = resized_by(args, args.delta(), sizing, context)?;
    let (features, geometry) = (&measured.features, &input.field.image.geometry);
    if let Some(told) = noise_told(&features.noise, geometry.spacing) {
        context.info(told);
    }
    let small = too_small(input.components.all(), &sizing);
    if let Some(told) = too_small_told(&small, input.components.all().len()) {
        context.warn(told);
    }
    let predicted = predicted(args, &input, &measured, &sizing, context);
    let meta = describe(features, &sizing, predicted, (measured.largest, &small), context);
    if let Some((components, size)) = lowered {
        let told = format!("lowered to {} on {components} small components", significant(size));
        context.summary("  below the minimum h", told);
    }
    check_count(&args.input, predicted, geometry.voxel_count(), context)?;
    if let Some(size) = measured.one_size {
        warn_if_too_coarse(features, geometry, size, context);
    }
    Ok((sizing, meta))
}

/// The distance field of one object.
struct Input<'a> {
    field: &'a Field,
    surface: CubicSpline,
    components: FieldComponents,
}

impl<'a> Input<'a> {
    fn new(field: &'a Field, context: &Context) -> Result<Self> {
        let _step = context.step("topology");
        let surface = CubicSpline::new(&field.image);
        let components = FieldComponents::new(&surface, context)?;
        Ok(Self { field, surface, components })
    }
}

/// The measured surface.
struct Measured {
    features: Features,
    /// The constant h in mm, if the options select one.
    one_size: Option<f64>,
    /// Upper limit, in mm, on the measured feature sizes.
    largest: f64,
    /// Whether the surface is smooth at the scale of a voxel: the input is a label map, or was
    /// smoothed (`distfield --scale`).
    is_smooth: bool,
}

/// Measures the surface.
///
/// # Errors
/// If there is no surface, or if a constant h is too large for it.
fn measure(args: &Args, input: &Input<'_>, context: &Context) -> Result<Measured> {
    let step = context.step("measure features");
    let image = &input.field.image;
    let largest = LARGEST_FEATURE_DIAGONALS * image.geometry.upper_corner().length();
    let one_size = one_size(args, image, &input.surface);
    // only features smaller than a constant h matter; no sample lies inside an empty ball, so the
    // centre of a ball is closer than h to a sample only if the radius of the ball is below h
    let largest = one_size.map_or(largest, |size| largest.min(size));
    // a constant h must resolve the surface as it is, including noise
    let origin: DistanceMeta = meta::typed(&args.input, &input.field.meta, "distfield")?;
    let is_smooth = origin.source == Some(Source::Labels) || origin.is_scaled();
    let bumps = if one_size.is_some() || is_smooth { Bumps::AreShape } else { Bumps::MayBeNoise };
    let purpose = if one_size.is_some() { Purpose::OneSize } else { Purpose::Grading };
    let features = Features::new(image, &input.surface, &input.components, largest, (bumps, purpose));
    drop(step);
    if features.triangles.is_empty() {
        return Err(Error::input(
            format!("{}: has no surface, because F does not change sign", args.input.display()),
            "h is computed on the surface",
            "check ISO or LABELS (distfield --iso, --labels)",
        ));
    }
    if let Some(size) = one_size {
        let largest = features.component_area.iter().copied().fold(0.0, f64::max);
        check_size(&args.input, size, largest)?;
    }
    Ok(Measured { features, one_size, largest, is_smooth })
}

/// Returns the constant h, if the options select one.
fn one_size(args: &Args, distance: &Image<f32>, surface: &CubicSpline) -> Option<f64> {
    let for_vertices = |vertices: u64| size_for_vertices(distance, surface, vertices as f64);
    args.uniform.or_else(|| args.vertices.filter(|_| !args.is_graded()).map(for_vertices))
}

/// Computes the sizing field from the measured surface and the options. Also returns the number of
/// components on which h is below the minimum h, and the smallest such h (mm).
fn sized(
    args: &Args,
    input: &Input<'_>,
    measured: &Measured,
    context: &Context,
) -> Result<(SizingField, Option<(usize, f64)>)> {
    let image = &input.field.image;
    let refined = refined_nodes(&args.refine, &image.geometry, context)?;
    context.check_interrupt()?;
    let _step = context.step("size and grade");
    let sizing = match measured.one_size {
        Some(size) => (uniform_field(image, size), None),
        None => {
            let parameters = resolve(args, input.field, &measured.features, refined, context)?;
            let sizing = size_field(image, &measured.features, &parameters);
            match args.vertices {
                Some(vertices) => (scaled_to_vertices(sizing, &input.surface, vertices as f64), None),
                None => (sizing, lowered(&measured.features, &parameters)),
            }
        }
    };
    if let (Some(size), Some(vertices)) = (measured.one_size, args.vertices) {
        context.info(format!("h: {} mm ({vertices} vertices)", significant(size)));
        context.set_parameter("uniform", size);
    }
    Ok(sizing)
}

/// Returns the number of particles that the sizing field predicts.
fn predicted(args: &Args, input: &Input<'_>, measured: &Measured, sizing: &SizingField, context: &Context) -> f64 {
    let _step = context.step("predict the count");
    // if --vertices determines a constant h, the number of vertices determines the predicted count
    if let Some(vertices) = args.vertices.filter(|_| measured.one_size.is_some() && args.resize.is_empty()) {
        return predicted_for(vertices as f64);
    }
    // the sum over triangles misses features that lie between the samples; a smooth surface has
    // none, but --vertices requires the exact count
    if measured.is_smooth && args.vertices.is_none() {
        return sizing.count_on(&measured.features.points, &measured.features.triangles);
    }
    sizing.predicted_count(&input.surface)
}

/// Derives the parameters from the options and the data, and reports the origin of each parameter.
fn resolve(
    args: &Args,
    field: &Field,
    features: &Features,
    refined: Vec<SizedNode>,
    context: &Context,
) -> Result<Parameters> {
    let voxel = field.image.geometry.mean_spacing();
    let low = features.points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = features.points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let defaults = Defaults::of(args.quality());
    let diagonal = (high - low).length();
    let (parameters, deviation) = args.parameters_with(voxel, defaults.max_size_diagonals * diagonal, refined);
    let (min_size, max_size) = (parameters.min_size, parameters.max_size);
    check_bounds((min_size, max_size), &format!("; {}", describe_extent(args.input.as_path(), low, high)))?;
    let quality = args.quality().name();
    let of_voxel = |share: f64| format!("{share} times the voxel size of {} mm, quality {quality}", significant(voxel));
    let of_diagonal = format!(
        "{} times the object's diagonal of {} mm, quality {quality}",
        defaults.max_size_diagonals,
        significant(diagonal)
    );
    for (name, value, given, reason) in [
        ("epsilon", parameters.epsilon, args.epsilon, format!("quality {quality}")),
        ("delta", parameters.delta, args.delta, format!("quality {quality}")),
        ("minimum h, mm", min_size, args.min_size, of_voxel(defaults.min_size_voxels)),
        ("maximum h, mm", max_size, args.max_size, of_diagonal),
        ("maximum deviation, mm", deviation, args.max_deviation, of_voxel(defaults.deviation_voxels)),
    ] {
        let reason = if given.is_some() { "given" } else { &reason };
        context.info(format!("{name}: {} ({reason})", significant(value)));
    }
    context.set_parameter("epsilon", parameters.epsilon);
    context.set_parameter("delta", parameters.delta);
    context.set_parameter("min_size", parameters.min_size);
    context.set_parameter("max_size", parameters.max_size);
    context.set_parameter("max_deviation", parameters.max_deviation);
    context.set_parameter("min_particles", parameters.min_particles);
    let unbound = Parameters { min_size: 0.0, scale: 1.0, ..parameters.clone() };
    let bound = wanted_sizes(features, &unbound).iter().filter(|&&h| h < parameters.min_size).count();
    if bound * 100 > features.points.len() {
        context.warn(format!(
            "local features need an h below the minimum on {:.1} % of the surface samples; to resolve them, lower \
             MIN_SIZE (--min-size)",
            100.0 * bound as f64 / features.points.len() as f64
        ));
    }
    Ok(parameters)
}

fn describe_extent(path: &Path, low: DVec3, high: DVec3) -> String {
    let extent = high - low;
    let extent = extent.to_array().map(significant).join(" x ");
    format!("the surface in {} measures {extent} mm", path.display())
}
