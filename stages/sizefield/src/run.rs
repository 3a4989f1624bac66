//! The program around [`crate::size_field`]: options, files, defaults from the data, report.

use crate::feature::Features;
use crate::region::Region;
use crate::{Parameters, size_field, uniform_field, wanted_sizes};
use clap::Parser;
use glam::DVec3;
use isoparticles_common::cli::values::{not_negative, positive};
use isoparticles_common::cli::{CommonArgs, Context, FILES, METHOD, Outcome, StageArgs};
use isoparticles_common::error::{Error, Result};
use isoparticles_common::io::field::{Field, FieldKind, read_field, write_field};
use isoparticles_common::sizing::SizingField;
use isoparticles_common::spline::CubicSpline;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Default smallest h over the mean voxel spacing: finer triangles than this say nothing about the data.
const MIN_SIZE_VOXELS: f64 = 0.75;
/// Default deviation over the mean voxel spacing: also the distance that distfield keeps between the surface of labels and
/// the voxel centres, each of which the triangles must pass on its own side.
const DEVIATION_VOXELS: f64 = 0.1;
/// Default largest h over the diagonal of the object's bounding box.
const MAX_SIZE_DIAGONALS: f64 = 0.1;
/// Medial balls are looked for up to this radius, over the diagonal of the volume; larger features ask for no other h.
const LARGEST_FEATURE_DIAGONALS: f64 = 0.25;
/// Fewest particles that a component is given room for.
const MIN_PARTICLES: f64 = 32.0;

/// Target edge length h (mm) over the grid of a distance field, from local feature size and curvature
#[derive(Debug, Parser)]
#[command(
    name = "sizefield",
    version,
    after_help = "Example:\n  sizefield heart.distfield.vti -o heart.sizefield.vti --epsilon 0.4 --delta 0.3 \\\n      --refine ball:10,-20,35,8=0.5\n\n\
        Paper: h of section 3.1; epsilon and delta as in Table 4."
)]
pub struct Args {
    /// Distance field, made by distfield
    #[arg(value_name = "F.vti", help_heading = FILES)]
    input: PathBuf,
    /// Sizing field to write; a plain image of h in mm that may be edited and used in its place
    #[arg(short, long, value_name = "S.vti", help_heading = FILES)]
    output: PathBuf,
    /// Edge length over local feature size, above 0 (the paper's epsilon); smaller is finer
    #[arg(long, value_name = "RATIO", default_value_t = 0.5, value_parser = positive, help_heading = METHOD)]
    epsilon: f64,
    /// Largest change of h per mm of distance, above 0 (the paper's delta); smaller grades more gently
    #[arg(long, value_name = "SLOPE", default_value_t = 0.4, value_parser = positive, help_heading = METHOD)]
    delta: f64,
    /// Smallest h, in mm [default: 0.75 of the mean voxel spacing]
    #[arg(long, value_name = "MM", value_parser = positive, help_heading = METHOD)]
    min_size: Option<f64>,
    /// Largest h at the surface, in mm [default: a tenth of the diagonal of the object's bounding box]
    #[arg(long, value_name = "MM", value_parser = positive, help_heading = METHOD)]
    max_size: Option<f64>,
    /// Bound h so that curvature puts no triangle's centre farther than this from the surface, in mm; 0 for no bound
    /// [default: 0.1 of the mean voxel spacing]
    #[arg(long, value_name = "MM", value_parser = not_negative, help_heading = METHOD)]
    max_deviation: Option<f64>,
    /// The same h everywhere, in mm, in place of all of the above
    #[arg(long, value_name = "MM", value_parser = positive, help_heading = METHOD,
        conflicts_with_all = ["epsilon", "delta", "min_size", "max_size", "max_deviation"])]
    uniform: Option<f64>,
    /// Make h no larger than H within RADIUS of a place (world coordinates, mm); h grows from there by delta; may be given
    /// several times, and goes below --min-size
    #[arg(long, value_name = "ball:X,Y,Z,RADIUS=H", help_heading = METHOD, conflicts_with = "uniform")]
    refine: Vec<Region>,
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
        match self.uniform {
            Some(size) => json!({ "uniform": size }),
            None => json!({ "epsilon": self.epsilon, "delta": self.delta, "refine": self.refine }),
        }
    }
}

/// Makes the sizing field.
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    let step = context.step("read");
    let field = read_field(&args.input, FieldKind::Distance)?;
    context.add_input(&args.input, field.history.clone())?;
    let surface = CubicSpline::new(&field.image);
    drop(step);
    context.check_interrupt()?;
    let step = context.step("measure features");
    let features =
        Features::new(&field.image, &surface, LARGEST_FEATURE_DIAGONALS * field.image.geometry.upper_corner().length());
    drop(step);
    if features.triangles.is_empty() {
        return Err(Error::input(
            format!("{}: has no surface, because F does not change its sign", args.input.display()),
            "there is nothing to size",
            "look at the iso value or the labels that distfield was given",
        ));
    }
    for region in &args.refine {
        if region.nodes(&field.image.geometry).next().is_none() {
            return Err(Error::input(
                format!(
                    "--refine: the ball of radius {} mm round {} lies outside the volume",
                    region.radius, region.centre
                ),
                "it would refine nothing",
                "give its centre in world coordinates, as the meshes have them (LPS, mm)",
            ));
        }
    }
    context.check_interrupt()?;
    let step = context.step("size and grade");
    let sizing = match args.uniform {
        Some(size) => uniform_field(&field.image, size),
        None => {
            let parameters = resolve(args, &field, &features, context)?;
            size_field(&field.image, &features, &parameters)
        }
    };
    drop(step);
    let meta = describe(&features, &sizing, context);
    if let Some(size) = args.uniform {
        warn_if_too_coarse(&features, size, context);
    }
    context.check_interrupt()?;
    let _step = context.step("write");
    write_field(&args.output, FieldKind::Sizing, sizing.image(), &meta, &context.history())?;
    Ok(Outcome::Passed)
}

/// Fills in what the options leave to the data, and says why.
fn resolve(args: &Args, field: &Field, features: &Features, context: &Context) -> Result<Parameters> {
    let voxel = field.image.geometry.mean_spacing();
    let low = features.points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = features.points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let min_size = args.min_size.unwrap_or(MIN_SIZE_VOXELS * voxel);
    let parameters = Parameters {
        epsilon: args.epsilon,
        delta: args.delta,
        min_size,
        max_size: args.max_size.unwrap_or((MAX_SIZE_DIAGONALS * (high - low).length()).max(min_size)),
        max_deviation: match args.max_deviation.unwrap_or(DEVIATION_VOXELS * voxel) {
            0.0 => f64::MAX,
            bound => bound,
        },
        min_particles: MIN_PARTICLES,
        regions: args.refine.clone(),
    };
    if parameters.min_size > parameters.max_size {
        return Err(Error::input(
            format!("--min-size {} is above --max-size {}", parameters.min_size, parameters.max_size),
            "no edge length fulfils both",
            format!(
                "give a smallest edge length below the largest; {}",
                describe_extent(args.input.as_path(), low, high)
            ),
        ));
    }
    let chosen = |given: bool| if given { "given" } else { "from the data" };
    context.info(format!(
        "h from {:.4} mm ({}) to {:.4} mm ({}); deviation at most {:.4} mm ({})",
        parameters.min_size,
        chosen(args.min_size.is_some()),
        parameters.max_size,
        chosen(args.max_size.is_some()),
        parameters.max_deviation.min(1e9),
        chosen(args.max_deviation.is_some()),
    ));
    context.set_parameter("min_size", parameters.min_size);
    context.set_parameter("max_size", parameters.max_size);
    context.set_parameter("max_deviation", parameters.max_deviation);
    context.set_parameter("min_particles", parameters.min_particles);
    let unbound = Parameters { min_size: 0.0, ..parameters.clone() };
    let bound = wanted_sizes(features, &unbound).iter().filter(|&&h| h < parameters.min_size).count();
    if bound * 100 > features.points.len() {
        context.warn(format!(
            "local features ask for less than the smallest h on {:.1} % of the surface samples; --min-size lowers it",
            100.0 * bound as f64 / features.points.len() as f64
        ));
    }
    Ok(parameters)
}

fn describe_extent(path: &Path, low: DVec3, high: DVec3) -> String {
    let extent = high - low;
    format!("the surface in {} measures {:.3} x {:.3} x {:.3} mm", path.display(), extent.x, extent.y, extent.z)
}

/// Puts figures of the field into the report and the closing table; returns what the file carries.
fn describe(features: &Features, sizing: &SizingField, context: &Context) -> Value {
    let mut at_surface: Vec<f64> = features.points.iter().map(|&p| sizing.at(p)).collect();
    let mut feature_size = features.feature_size.clone();
    let predicted = features.predicted_count(|p| sizing.at(p));
    let meta = json!({
        "components": features.component_area.len(),
        "predicted_count": predicted.round(),
        "size_at_surface": percentiles(&mut at_surface),
        "local_feature_size": percentiles(&mut feature_size),
    });
    context.summary("components", features.component_area.len());
    context.summary("predicted particles", predicted.round());
    context
        .summary("h at the surface (mm)", format!("{:.4} to {:.4}", at_surface[0], at_surface[at_surface.len() - 1]));
    context.report("fields", meta.clone());
    meta
}

/// Minimum, percentiles and maximum by name; sorts the values.
fn percentiles(values: &mut [f64]) -> Value {
    values.sort_by(f64::total_cmp);
    let at = |percent: usize| values[(values.len() - 1) * percent / 100];
    json!({ "min": at(0), "p1": at(1), "p5": at(5), "median": at(50), "p95": at(95), "max": at(100) })
}

/// A uniform size may be too coarse for thin parts: says where the worst place is.
fn warn_if_too_coarse(features: &Features, size: f64, context: &Context) {
    let coarse = features.feature_size.iter().filter(|&&lfs| size > lfs).count();
    if coarse == 0 {
        return;
    }
    let worst = (0..features.points.len())
        .min_by(|&a, &b| features.feature_size[a].total_cmp(&features.feature_size[b]))
        .unwrap_or(0);
    context.warn(format!(
        "h = {size} mm is larger than the local feature size on {:.1} % of the surface (smallest {:.3} mm, at grid \
         position {:.2} mm); thin parts may not be caught",
        100.0 * coarse as f64 / features.points.len() as f64,
        features.feature_size[worst],
        features.points[worst],
    ));
}
