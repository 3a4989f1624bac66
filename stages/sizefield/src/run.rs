//! The `sizefield` program: parses the options, reads the surface, derives defaults from the data,
//! computes h, fills in the report and writes the file. [`compute()`] reads only the files of
//! `--refine`, so it can be called as a library.

use crate::feature::{Bumps, Features, Purpose};
use crate::limits::{check_count, check_size, too_small, too_small_told};
use crate::region::{Refinement, SizedNode};
use crate::report::{describe, noise_told, warn_if_too_coarse};
use crate::vertices::{predicted_for, scaled_to_vertices, size_for_vertices};
use crate::{MIN_PARTICLES, Parameters, lowered, size_field, uniform_field, wanted_sizes};
use clap::Parser;
use glam::DVec3;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldComponents;
use isoparticles_stage::cli::check::Known;
use isoparticles_stage::cli::values::{not_negative, positive, significant};
use isoparticles_stage::cli::{CommonArgs, Context, FILES, METHOD, Outcome, StageArgs};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::field_file::{Field, FieldKind};
use isoparticles_stage::ground::Ground;
use isoparticles_stage::material_sizes::{Given, GivenSize};
use isoparticles_stage::meta::{self, DistanceMeta, SizeMeta, Source};
use isoparticles_stage::quality::Quality;
use isoparticles_volume::{Geometry, Image};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Default parameters for a quality level.
pub(crate) struct Defaults {
    pub(crate) epsilon: f64,
    pub(crate) delta: f64,
    /// Minimum h in units of the mean voxel spacing.
    pub(crate) min_size_voxels: f64,
    /// Maximum h in units of the diagonal of the object's bounding box.
    pub(crate) max_size_diagonals: f64,
    /// Maximum deviation in units of the mean voxel spacing. `distfield` keeps the surface of
    /// labels 0.1 voxel away from voxel centres, so triangles that deviate by at most 0.1 voxel do
    /// not cross voxel centres.
    pub(crate) deviation_voxels: f64,
}

impl Defaults {
    pub(crate) fn of(quality: Quality) -> Self {
        let medium = Self {
            epsilon: 0.5,
            delta: 0.4,
            min_size_voxels: quality.smallest_size_voxels(),
            max_size_diagonals: 0.1,
            deviation_voxels: 0.1,
        };
        match quality {
            // the deviation is proportional to h squared
            Quality::Coarse => Self { epsilon: 1.0, max_size_diagonals: 0.2, deviation_voxels: 0.4, ..medium },
            Quality::Medium => medium,
            Quality::Fine => {
                Self { epsilon: 0.25, delta: 0.3, max_size_diagonals: 0.05, deviation_voxels: 0.04, ..medium }
            }
        }
    }
}

/// Maximum radius of medial balls in units of the diagonal of the volume. With the defaults of
/// every quality level, feature sizes above 0.2 times the object's diagonal (`maximum h / epsilon`)
/// do not change h.
const LARGEST_FEATURE_DIAGONALS: f64 = 0.25;

/// Computes the target edge length h (mm) on the grid of a distance field from the local feature
/// size and the curvature
#[derive(Debug, Parser)]
#[command(
    name = "sizefield",
    version,
    after_help = "Example:\n  sizefield heart.distfield.vti -o heart.sizefield.vti --epsilon 0.4 --delta 0.3 \\\n      --refine ball:10,-20,35,8=0.5\nExample: an edge length of at most 0.4 mm inside a mask\n  sizefield heart.distfield.vti -o heart.sizefield.vti --refine mask:valve.nrrd=0.4\n\n\
        Paper: h as in section 3.1; epsilon and delta as in Table 4."
)]
pub struct Args {
    /// Distance field, or indicators of several materials, written by distfield
    #[arg(value_name = "F.vti", help_heading = FILES)]
    pub(crate) input: PathBuf,
    /// Size field to write: an image of h (mm), which may be edited or replaced with another image
    #[arg(short, long, value_name = "S.vti", help_heading = FILES)]
    pub(crate) output: PathBuf,
    /// Set the defaults of the next five options. medium matches the resolution of the data; in
    /// comparison, coarse gives about a quarter as many triangles and fine about three times as
    /// many [default: medium]
    #[arg(long, value_enum, value_name = "HOW", help_heading = METHOD)]
    pub(crate) quality: Option<Quality>,
    /// Ratio of edge length to local feature size, above 0 (the paper's epsilon); smaller values
    /// give a finer mesh [default: 0.5; coarse 1, fine 0.25]
    #[arg(long, value_name = "RATIO", value_parser = positive, help_heading = METHOD)]
    pub(crate) epsilon: Option<f64>,
    /// Maximum change of h per mm of distance, above 0 (the paper's delta); smaller values give a
    /// more gradual size transition [default: 0.4; fine 0.3]
    #[arg(long, value_name = "SLOPE", value_parser = positive, help_heading = METHOD)]
    pub(crate) delta: Option<f64>,
    /// Minimum h, mm [default: 0.75 times the mean voxel spacing; coarse 1.5, fine 0.5]
    #[arg(long, value_name = "MM", value_parser = positive, help_heading = METHOD)]
    pub(crate) min_size: Option<f64>,
    /// Maximum h at the surface, mm [default: 0.1 times the diagonal of the object's bounding box;
    /// coarse 0.2, fine 0.05]
    #[arg(long, value_name = "MM", value_parser = positive, help_heading = METHOD)]
    pub(crate) max_size: Option<f64>,
    /// Limit h so that the centre of a triangle is at most this far from the curved surface, mm; 0
    /// for no limit [default: 0.1 times the mean voxel spacing; coarse 0.4, fine 0.04]
    #[arg(long, value_name = "MM", value_parser = not_negative, help_heading = METHOD)]
    pub(crate) max_deviation: Option<f64>,
    /// Multiply the h that results from the options above by this factor, above 0, before grading;
    /// 2 gives about a quarter as many triangles
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = positive, help_heading = METHOD)]
    pub(crate) scale: f64,
    /// Several materials only: set h (mm) on all interfaces of a material, or on the interface of
    /// two materials, instead of deriving it from the shape; may be repeated. If several sizes
    /// apply, the size of a pair takes precedence over sizes of materials, and a smaller size over
    /// a larger one. The result is graded by delta
    #[arg(long, value_name = "NAME=H|NAME/NAME=H", help_heading = METHOD)]
    pub(crate) size: Vec<GivenSize>,
    /// Use this h everywhere, mm, instead of the options above; with several materials, on all
    /// interfaces without a --size
    #[arg(long, value_name = "MM", value_parser = positive, help_heading = METHOD,
        conflicts_with_all = ["quality", "epsilon", "delta", "min_size", "max_size", "max_deviation", "scale"])]
    pub(crate) uniform: Option<f64>,
    /// Choose h so that the settled surface has about this number of vertices (to within 5 %), 4 or
    /// more. h is constant or, with any of the options above, the h of these options multiplied by
    /// one factor. Small parts or grading may result in more vertices
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(4..), conflicts_with_all = ["uniform", "scale", "size"], help_heading = METHOD)]
    pub(crate) vertices: Option<u64>,
    /// Limit h to H (mm) within RADIUS of a point or in the nonzero voxels of a mask volume (on any
    /// grid), or to the values of the point array `h` at the points of a .vtp or .vtu file; may be
    /// repeated. All positions and lengths are in world coordinates, mm. Outside the refined
    /// regions, h grows by at most delta per mm. The limit may be below --min-size
    #[arg(long, value_name = "ball:X,Y,Z,RADIUS=H|mask:FILE=H|points:FILE", help_heading = METHOD)]
    pub(crate) refine: Vec<Refinement>,
    #[command(flatten)]
    common: CommonArgs,
}

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        &self.common
    }

    fn outputs(&self) -> Vec<PathBuf> {
        vec![self.output.clone()]
    }

    fn parameters(&self) -> Value {
        let mut parameters = match self.uniform {
            Some(size) => json!({ "uniform": size }),
            None => json!({ "quality": self.quality().name(), "scale": self.scale, "refine": self.refine }),
        };
        if !self.size.is_empty() {
            parameters["size"] = json!(self.size);
        }
        if let Some(vertices) = self.vertices {
            parameters["vertices"] = json!(vertices);
        }
        parameters
    }

    fn check_options(&self, known: Known) -> Result<Known> {
        if let (Some(min), Some(max)) = (self.min_size, self.max_size) {
            check_bounds((min, max), "")?;
        }
        self.refuse_refined_constant()?;
        for file in self.refine.iter().filter_map(Refinement::file) {
            std::fs::metadata(file)
                .map_err(|error| Error::file(file, "read", &error, "check the file name in --refine"))?;
        }
        match &known.materials {
            Some(names) if names.is_empty() => self.refuse_sizes()?,
            Some(names) => drop(Given::new(&self.size, names)?),
            None => {}
        }
        Ok(known)
    }
}

impl Args {
    pub(crate) fn quality(&self) -> Quality {
        self.quality.unwrap_or(Quality::Medium)
    }

    /// Rejects the combination of `--uniform` and `--refine`.
    fn refuse_refined_constant(&self) -> Result<()> {
        let Some(size) = self.uniform.filter(|_| !self.refine.is_empty()) else { return Ok(()) };
        Err(Error::input(
            format!("SIZE={size} (--uniform) and --refine are both set"),
            "SIZE means one edge length everywhere",
            format!(
                "for a uniform surface that can be refined, set MIN_SIZE and MAX_SIZE (--min-size, --max-size) to \
                 {size} instead of SIZE"
            ),
        ))
    }

    /// Rejects `--size` for one object, which has no named materials.
    fn refuse_sizes(&self) -> Result<()> {
        match self.size.first() {
            None => Ok(()),
            Some(given) => Err(Error::input(
                format!("--size {given} for one object"),
                "--size needs named materials",
                "set SIZE (--uniform), or MIN_SIZE and MAX_SIZE (--min-size, --max-size); or set MATERIALS \
                 (distfield --material)",
            )),
        }
    }

    /// Returns the parameters and the maximum deviation (mm). Uses the defaults of the quality
    /// level for options that are not given, and `largest` (mm) as the default maximum h.
    pub(crate) fn parameters_with(&self, voxel: f64, largest: f64, refined: Vec<SizedNode>) -> (Parameters, f64) {
        let defaults = Defaults::of(self.quality());
        let min_size = self.min_size.unwrap_or(defaults.min_size_voxels * voxel);
        let deviation = self.max_deviation.unwrap_or(defaults.deviation_voxels * voxel);
        let parameters = Parameters {
            epsilon: self.epsilon.unwrap_or(defaults.epsilon),
            delta: self.delta.unwrap_or(defaults.delta),
            min_size,
            max_size: self.max_size.unwrap_or(largest.max(min_size)),
            max_deviation: if deviation > 0.0 { deviation } else { f64::MAX },
            min_particles: MIN_PARTICLES,
            scale: self.scale,
            refined,
        };
        (parameters, deviation)
    }

    /// Returns whether any option is given that makes h vary over the surface.
    pub(crate) fn is_graded(&self) -> bool {
        let lengths = [self.epsilon, self.delta, self.min_size, self.max_size, self.max_deviation];
        self.quality.is_some() || lengths.iter().any(Option::is_some) || !self.refine.is_empty()
    }

    /// Returns the constant h, if the options select one.
    fn one_size(&self, distance: &Image<f32>, surface: &CubicSpline) -> Option<f64> {
        let for_vertices = |vertices: u64| size_for_vertices(distance, surface, vertices as f64);
        self.uniform.or_else(|| self.vertices.filter(|_| !self.is_graded()).map(for_vertices))
    }
}

/// Runs the stage.
///
/// # Errors
/// If a file cannot be read or written; and the errors of [`compute()`].
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    args.refuse_refined_constant()?;
    let step = context.step("read");
    let ground = Ground::read(&args.input)?;
    context.add_input(&args.input, ground.history().cloned())?;
    drop(step);
    let made = compute(args, &ground, context)?;
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
pub fn compute(args: &Args, ground: &Ground, context: &Context) -> Result<Field> {
    let (sizing, meta) = match ground {
        Ground::Object(field) => of_object(args, field, context)?,
        Ground::Materials(file) => crate::materials::compute(args, &file.materials, context)?,
    };
    context.check_interrupt()?;
    let (image, meta, history) = (sizing.into_image(), json!(meta), Some(context.history()));
    Ok(Field { image, meta, history, kind: FieldKind::Sizing })
}

/// Computes the sizing field of one object, and the metadata of its file.
fn of_object(args: &Args, field: &Field, context: &Context) -> Result<(SizingField, SizeMeta)> {
    args.refuse_sizes()?;
    let input = Input::new(field, context)?;
    let measured = measure(args, &input, context)?;
    let (sizing, lowered) = sized(args, &input, &measured, context)?;
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
    check_count(&args.input, meta.predicted_count, geometry.voxel_count(), context)?;
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
    let one_size = args.one_size(image, &input.surface);
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

/// Computes the sizing field from the measured surface and the options. Also returns the number of
/// components on which h is below the minimum h, and the smallest such h (mm).
fn sized(
    args: &Args,
    input: &Input<'_>,
    measured: &Measured,
    context: &Context,
) -> Result<(SizingField, Option<(usize, f64)>)> {
    let image = &input.field.image;
    let refined = refined_nodes(args, &image.geometry, context)?;
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
    if let Some(vertices) = args.vertices.filter(|_| measured.one_size.is_some()) {
        return predicted_for(vertices as f64);
    }
    // the sum over triangles misses features that lie between the samples; a smooth surface has
    // none, but --vertices requires the exact count
    if measured.is_smooth && args.vertices.is_none() {
        return sizing.count_on(&measured.features.points, &measured.features.triangles);
    }
    sizing.predicted_count(&input.surface)
}

/// Returns the nodes of all `--refine` options, and adds their files to the inputs.
pub(crate) fn refined_nodes(args: &Args, geometry: &Geometry, context: &Context) -> Result<Vec<SizedNode>> {
    let mut refined = Vec::new();
    for refinement in &args.refine {
        let nodes = refinement.nodes(geometry)?;
        if let Some(file) = refinement.file() {
            context.add_input(file, None)?;
            context.info(format!("--refine {}: {} grid nodes", file.display(), nodes.len()));
        }
        refined.extend(nodes);
    }
    Ok(refined)
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

/// Rejects a minimum edge length above the maximum (mm); `more` is appended to the advice.
pub(crate) fn check_bounds((min, max): (f64, f64), more: &str) -> Result<()> {
    if min <= max {
        return Ok(());
    }
    Err(Error::input(
        format!("--min-size {min} is above --max-size {max}"),
        "no edge length satisfies both",
        format!("set MIN_SIZE (--min-size) below MAX_SIZE (--max-size){more}"),
    ))
}

fn describe_extent(path: &Path, low: DVec3, high: DVec3) -> String {
    let extent = high - low;
    let extent = extent.to_array().map(significant).join(" x ");
    format!("the surface in {} measures {extent} mm", path.display())
}
