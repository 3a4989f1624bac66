//! The program: options, reading, the steps in order, the checks, writing.

use crate::check::{CheckReport, MIN_RADIUS_RATIO};
use crate::finish::attributes;
use crate::offending::offending;
use crate::points_alone;
use crate::prepare::PrepareReport;
use crate::reconstruct::{Method, Options, Reconstruction, reconstruct};
use crate::volumes;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::point_cloud::is_point_cloud;
use isoparticles_mesh::surface::{Simplices, Surface, check_surface_name, write_simplices, write_surface};
use isoparticles_stage::cli::check::Known;
use isoparticles_stage::cli::values::{share, significant};
use isoparticles_stage::cli::{CHECKS, CommonArgs, Context, FILES, METHOD, Outcome, StageArgs, particles_bytes};
use isoparticles_stage::error::{Error, Kind, Result};
use isoparticles_stage::field_file::{FieldKind, check_same_grid, read_field};
use isoparticles_stage::materials_file::is_materials;
use isoparticles_stage::meta::{self, Border, DistanceMeta, SurfaceMeta};
use isoparticles_stage::particle_file::{ParticleKind, read_particles};
use isoparticles_volume::Geometry;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Connects settled particles to a closed triangle mesh
///
/// The program computes the Delaunay triangulation of the particles and decides for each
/// tetrahedron whether it is inside or outside. The surface consists of the triangles between
/// inside and outside, so it is closed.
///
/// --method restricted decides by the sign of F at the circumcentre. It adds points where the
/// surface is not manifold, deviates from F = 0, or differs from F = 0 in its components.
///
/// --method tight-cocone (the method of the paper) decides by the shape of the Voronoi cells. It
/// needs no distance field, so it also meshes point clouds of other programs.
///
/// With a distance field, local moves then improve the worst triangles. At the end, the program
/// checks topology, self-intersections, distance to F = 0 and the shape of the triangles. The mesh
/// is in world coordinates (mm). Its triangles are counter-clockwise as seen from outside.
#[derive(Clone, Debug, clap::Parser)]
#[command(
    name = "reconstruct",
    version,
    after_help = "Exit code 1: the mesh was written, but a check failed. NAME.offending.vtp beside it contains the simplices behind the failed check.\nExample:\n  reconstruct tooth.particles.bin --distfield tooth.distfield.vti -o tooth.surface.vtp --report tooth.json\n  reconstruct scan.ply --method tight-cocone -o scan.surface.vtp"
)]
pub struct Args {
    /// Particles to connect, from `particles` or `seed`. --method tight-cocone also reads point
    /// clouds, with or without normals: .ply, .vtp, or .xyz (lines `x y z` or `x y z nx ny nz`)
    #[arg(value_name = "P.bin", help_heading = FILES)]
    pub particles: PathBuf,
    /// Distance field F of the particles, mm. --method restricted needs it. Without it, vertices are
    /// not projected, and triangles are neither improved nor compared with F = 0
    #[arg(long, value_name = "F.vti", help_heading = FILES)]
    pub distfield: Option<PathBuf>,
    /// Size field h on the grid of F, mm [default: the h that is stored with each particle]
    #[arg(long, value_name = "S.vti", requires = "distfield", help_heading = FILES)]
    pub sizefield: Option<PathBuf>,
    /// Surface to write: .vtp with all data, or .ply, .stl, .obj, .vtk
    #[arg(short, long, value_name = "SURFACE", help_heading = FILES)]
    pub output: PathBuf,
    /// Many materials: also write the closed surface of each material to this folder, as NAME with
    /// the extension of the output. Its normals point outward. Touching materials share vertices
    #[arg(long, value_name = "FOLDER", requires = "distfield", help_heading = FILES)]
    pub each: Option<PathBuf>,
    /// Method that connects the particles
    #[arg(long, value_enum, value_name = "METHOD", default_value_t = Method::Restricted, help_heading = METHOD)]
    pub method: Method,
    /// Maximum distance of a triangle's centroid from F = 0, mm, above 0. Points are added at
    /// triangles beyond it [default: a quarter of h or of a voxel, whichever is larger]
    #[arg(long, value_name = "MM", value_parser = positive, help_heading = METHOD)]
    pub max_deviation: Option<f64>,
    /// Maximum number of rounds that add points, 0 to 100. Each round compares the whole surface with
    /// F. The limit applies separately to grid nodes on the wrong side, and to each step of Tight
    /// Cocone that needs more points
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u16).range(0..=100), help_heading = METHOD)]
    pub max_rounds: u16,
    /// Improve triangles below this radius ratio by local moves, 0 to 1. The ratio is 2 r / R, which
    /// is 1 for an equilateral triangle. Together with --relaxation-sweeps 0, the value 0 leaves the
    /// triangulation unchanged
    #[arg(long, value_name = "RATIO", default_value_t = 0.9, value_parser = share, help_heading = METHOD)]
    pub improve_below: f64,
    /// Sweeps over the whole mesh before --improve-below applies, 0 to 20. They move vertices along
    /// F = 0 and flip edges where this improves the triangles. Meshes of a few thousand vertices get
    /// more sweeps, as long as these help
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(0..=20), help_heading = METHOD)]
    pub relaxation_sweeps: u16,
    /// Minimum radius ratio of a triangle, 0 to 1 [default: 0.3 with a distance field; none without]
    #[arg(long, value_name = "RATIO", value_parser = share, help_heading = CHECKS)]
    pub min_radius_ratio: Option<f64>,
    /// Many materials: accept triangles below --min-radius-ratio where junction curves allow no
    /// better ones. The verdict counts them
    #[arg(long, help_heading = CHECKS)]
    pub accept_forced: bool,
    /// Maximum distance of a vertex from F = 0, in voxels (geometric mean of the spacing), above 0
    #[arg(long, value_name = "VOXELS", default_value_t = 1e-4, value_parser = positive, help_heading = CHECKS)]
    pub max_vertex_distance: f64,
    /// The options that every stage has.
    #[command(flatten)]
    pub common: CommonArgs,
}

impl Args {
    /// How to reconstruct from a field that says this of itself.
    fn options(&self, told: &DistanceMeta) -> Options {
        let (keeps_voxels, open_border) = (told.keeps_voxels(), told.border == Some(Border::Open));
        Options { keeps_voxels, open_border, ..self.general_options() }
    }

    /// How to reconstruct, as far as the options alone tell.
    pub(crate) fn general_options(&self) -> Options {
        Options {
            method: self.method,
            max_deviation: self.max_deviation,
            max_rounds: usize::from(self.max_rounds),
            improve_below: self.improve_below,
            relaxation_sweeps: usize::from(self.relaxation_sweeps),
            min_radius_ratio: self.radius_ratio_bar(),
            accept_forced: self.accept_forced,
            max_vertex_distance: self.max_vertex_distance,
            ..Options::default()
        }
    }

    /// The bar for the smallest radius ratio.
    pub(crate) fn radius_ratio_bar(&self) -> Option<f64> {
        self.min_radius_ratio.or(self.distfield.as_ref().map(|_| MIN_RADIUS_RATIO))
    }
}

fn positive(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err(format!("{text} is not a number above 0")),
    }
}

impl StageArgs for Args {
    fn common(&self) -> &CommonArgs {
        &self.common
    }

    fn outputs(&self) -> Vec<PathBuf> {
        vec![self.output.clone()]
    }

    fn parameters(&self) -> Value {
        let method = match self.method {
            Method::Restricted => "restricted",
            Method::TightCocone => "tight-cocone",
        };
        json!({
            "method": method, "max_deviation": self.max_deviation, "max_rounds": self.max_rounds,
            "improve_below": self.improve_below, "relaxation_sweeps": self.relaxation_sweeps,
            "min_radius_ratio": self.radius_ratio_bar(), "accept_forced": self.accept_forced, "max_vertex_distance": self.max_vertex_distance,
        })
    }

    fn check_options(&self, known: Known) -> Result<Known> {
        check_surface_name(&self.output)?;
        match (&self.distfield, known.is_many()) {
            (Some(field), Some(true)) => crate::materials::run::check_method(self, field)?,
            (Some(field), Some(false)) => check_each(self, field)?,
            _ => {}
        }
        Ok(known)
    }
}

/// Runs the stage.
///
/// # Errors
/// On files that cannot be read or written or do not belong together, on particles that are not on F = 0, all in one
/// plane or enclose nothing, on a distance field missing or in vain, and when interrupted.
pub fn run(args: &Args, context: &Context) -> Result<Outcome> {
    check_surface_name(&args.output)?;
    check_offenders(args)?;
    let particles = args.particles.display();
    match (&args.distfield, args.method) {
        (None, Method::TightCocone) => points_alone::run(args, context),
        (None, Method::Restricted) => Err(Error::input(
            format!("{particles}: no distance field is given"),
            "--method restricted needs it to separate inside from outside",
            "pass --distfield F.vti, or use --method tight-cocone to mesh the points without a field",
        )),
        (Some(field), _) if is_point_cloud(&args.particles) => Err(Error::input(
            format!("{particles}: is a point cloud, but {} is the distance field of a volume", field.display()),
            "a point cloud has no position in the grid of the field",
            "omit --distfield and use --method tight-cocone, or pass the particles made from the field",
        )),
        (Some(field), _) if is_materials(field) => crate::materials::run::run(args, field, context),
        (Some(field), _) => {
            check_each(args, field)?;
            on_field(args, field, context)
        }
    }
}

/// Refuses `--each` for one object.
fn check_each(args: &Args, field: &Path) -> Result<()> {
    if args.each.is_none() {
        return Ok(());
    }
    Err(Error::input(
        format!("{}: is the distance field of one object", field.display()),
        "--each writes the surfaces of many materials",
        "omit --each, or pass the file that distfield --material writes",
    ))
}

/// Reads the particles with a warning where they are not settled, and notes them as an input.
pub(crate) fn read_settled(args: &Args, context: &Context) -> Result<ParticleSet> {
    let kinds = [ParticleKind::Particles, ParticleKind::Seeds, ParticleKind::Checkpoint];
    let file = read_particles(&args.particles, &kinds)?;
    if file.kind != ParticleKind::Particles {
        let (path, kind) = (args.particles.display(), file.kind.name());
        context.warn(format!("{path}: contains {kind} instead of settled particles, so the triangles will be worse"));
    }
    context.add_input(&args.particles, Some(file.history))?;
    Ok(file.particles)
}

fn on_field(args: &Args, distfield: &Path, context: &Context) -> Result<Outcome> {
    let step = context.step("read");
    let (particles, (field, sizing)) = rayon::join(
        || read_settled(args, context),
        || {
            let sizing = || args.sizefield.as_deref().map(|path| read_field(path, FieldKind::Sizing)).transpose();
            rayon::join(|| read_field(distfield, FieldKind::Distance), sizing)
        },
    );
    let (particles, field, sizing) = (particles?, field?, sizing?);
    check_same_grid((&args.particles, &particles.geometry), (distfield, &field.image.geometry))?;
    let count = particles.positions.len();
    context.check_memory(
        particles_bytes(count as f64, field.image.geometry.voxel_count()),
        &format!("{}: {count} particles", args.particles.display()),
        "reduce their number: sizefield --min-size, --scale or --quality coarse",
    )?;
    let sizing = match (&args.sizefield, sizing) {
        (Some(path), Some(sizing)) => {
            check_same_grid((path, &sizing.image.geometry), (distfield, &field.image.geometry))?;
            context.add_inputs([(distfield, field.history.clone()), (path, sizing.history)])?;
            Some(SizingField::new(sizing.image))
        }
        _ => {
            context.add_input(distfield, field.history.clone())?;
            None
        }
    };
    let told: DistanceMeta = meta::typed(distfield, &field.meta, "distfield")?;
    drop(step);
    let options = args.options(&told);
    let made = reconstruct(&particles, &field.image, sizing.as_ref(), &options, context)
        .map_err(|error| about(&args.particles, error))?;
    context.check_interrupt()?;
    tell(&made, context);

    let surface = attributes(&made.mesh, &made.field, &made.sizes, &told.cap_planes);
    let volumes = json!(volumes::of_object(&told, made.checked.volume));
    context.report("volumes", volumes.clone());
    let notes = [("topology", json!(made.topology)), ("refine", json!(made.refined)), ("volumes", volumes)];
    let meta = SurfaceMeta {
        version: meta::VERSION,
        source: told.source,
        border: told.border,
        failed_checks: made.failed.clone(),
        components: made.topology.field.components,
        materials: Vec::new(),
        notes: notes.into_iter().map(|(name, note)| (name.to_owned(), note)).collect(),
    };
    write(args, context, &surface, &meta, offending(&made.mesh, &made.checked, made.field.geometry()), made.failed)
}

/// Where the simplices that offend failed checks are written.
fn offenders(args: &Args) -> PathBuf {
    args.output.with_extension("offending.vtp")
}

/// Refuses when the file of offending simplices, which is replaced or removed, is one of the inputs.
pub(crate) fn check_offenders(args: &Args) -> Result<()> {
    let path = offenders(args);
    let Ok(place) = path.canonicalize() else { return Ok(()) };
    let mut inputs = [Some(&args.particles), args.distfield.as_ref(), args.sizefield.as_ref()].into_iter().flatten();
    match inputs.find(|input| input.canonicalize().is_ok_and(|input| input == place)) {
        None => Ok(()),
        Some(input) => Err(Error::input(
            format!(
                "{}: this input has the name of the file for the offending simplices of {}",
                input.display(),
                args.output.display()
            ),
            "that file is replaced if a check fails, and removed if all checks pass",
            "rename the output or the input",
        )),
    }
}

/// Writes the surface, and beside it what offends the failed checks.
pub(crate) fn write(
    args: &Args,
    context: &Context,
    surface: &Surface,
    meta: &SurfaceMeta,
    offending: Option<Simplices>,
    failed: Vec<String>,
) -> Result<Outcome> {
    let step = context.step("write");
    write_surface(&args.output, surface, &json!(meta), &context.history())?;
    let offenders = offenders(args);
    match offending {
        Some(simplices) if !failed.is_empty() => {
            write_simplices(&offenders, &simplices, &context.history())?;
            context.info(format!("the offending simplices are in {}", offenders.display()));
        }
        // one left by an earlier run would mislead
        _ => remove_stale(&offenders, context),
    }
    drop(step);
    Ok(Outcome::from_failed_checks(failed))
}

/// Reads a size field that lies on the grid of a distance field, one of the inputs.
pub(crate) fn read_sizing(path: &Path, distance: (&Path, &Geometry), context: &Context) -> Result<SizingField> {
    let field = read_field(path, FieldKind::Sizing)?;
    check_same_grid((path, &field.image.geometry), distance)?;
    context.add_input(path, field.history)?;
    Ok(SizingField::new(field.image))
}

/// An error about a file, unless the run was interrupted.
pub(crate) fn about(path: &Path, error: Error) -> Error {
    if error.kind == Kind::Interrupted {
        return error;
    }
    Error { what: format!("{}: {}", path.display(), error.what), ..error }
}

fn remove_stale(path: &Path, context: &Context) {
    if path.exists()
        && let Err(error) = std::fs::remove_file(path)
    {
        context.warn(format!("{}: cannot remove this file of an earlier run: {error}", path.display()));
    }
}

/// Puts what was made into the report and the closing table, and warns of what is doubtful.
fn tell(made: &Reconstruction, context: &Context) {
    let Reconstruction { checked, topology, refined, .. } = made;
    context.report("prepare", json!(made.prepared));
    context.report("refine", json!(refined));
    context.report("cocone", json!(made.cocone));
    context.report("parted_vertices", made.parted);
    context.report("improve", json!(made.improved));
    context.report("check", json!(checked));
    context.report("border_edges", made.border_edges);
    context.report("topology", json!(topology));
    if let Some(cocone) = &made.cocone {
        points_alone::warn(cocone, context);
    }
    made.doubtful.iter().for_each(|doubt| context.warn(doubt));
    describe_mesh(checked, &topology.expected(), (&made.prepared, made.taken), context);
    context.summary("points added", format!("{} in {} rounds", refined.points(), refined.rounds));
    if let (Some(v), Some(c)) = (checked.vertex_distance, checked.centroid_distance) {
        context.summary(
            "distance from F = 0, voxels",
            format!(
                "vertices at most {}; centroids mean {}, maximum {}",
                significant(v.max),
                significant(c.mean),
                significant(c.max)
            ),
        );
    }
    if let Some(nodes) = checked.nodes_on_wrong_side {
        context.summary("voxel centres on the wrong side", nodes);
    }
}

/// What the closing table says of any mesh.
pub(crate) fn describe_mesh(
    checked: &CheckReport,
    expected: &str,
    (prepared, taken): (&PrepareReport, usize),
    context: &Context,
) {
    let quality = &checked.quality;
    context.summary("vertices, triangles", format!("{}, {}", checked.vertices, checked.triangles));
    context.summary("components", format!("{}{expected}", checked.components.len()));
    context.summary("Euler characteristic", checked.euler);
    let dropped = prepared.invalid + prepared.not_projected + prepared.crowded;
    context.summary("particles used, not used", format!("{taken}, {dropped}"));
    context.summary(
        "radius ratio",
        format!("mean {:.4}, minimum {:.4}", quality.radius_ratio_mean, quality.radius_ratio_min),
    );
    context.summary("angles, degrees", format!("{:.1} to {:.1}", quality.angle_min, quality.angle_max));
    let (area, volume) = (significant(checked.area), significant(checked.volume));
    context.summary("area, mm^2; volume, mm^3", format!("{area}; {volume}"));
}
