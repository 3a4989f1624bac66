//! The arguments of the program.

use crate::options::{MIN_RADIUS_RATIO, Method, Options};
use isoparticles_mesh::surface::check_surface_name;
use isoparticles_stage::cli::check::Known;
use isoparticles_stage::cli::values::share;
use isoparticles_stage::cli::{CHECKS, CommonArgs, FILES, METHOD, StageArgs};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::space::SpaceChoice;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Connects settled particles to form a closed triangle mesh
///
/// The program computes the Delaunay triangulation of the particles and classifies each tetrahedron
/// as inside or outside. The surface consists of the triangles between inside and outside
/// tetrahedra, so it is closed.
///
/// --method restricted classifies by the sign of F at the circumcentre. It adds points where the
/// surface is not manifold, deviates from F = 0, or does not have the same components as F = 0.
///
/// --method tight-cocone (the method of the paper) classifies by the shape of the Voronoi cells. It
/// does not need a distance field, so it can also mesh point clouds from other programs.
///
/// With a distance field, local moves then improve the worst triangles. Finally, the program checks
/// the topology, self-intersections, the distance to F = 0 and the shape of the triangles. The mesh
/// is in world coordinates (mm). Its triangles are counter-clockwise when viewed from outside.
#[derive(Clone, Debug, clap::Parser)]
#[command(
    name = "reconstruct",
    version,
    after_help = "Exit code 1: the mesh was written, but a check failed. NAME.offending.vtp, in the same folder, contains the simplices that caused the failure.\nExample:\n  reconstruct tooth.particles.bin --distfield tooth.distfield.vti -o tooth.surface.vtp --report tooth.json\n  reconstruct scan.ply --method tight-cocone -o scan.surface.vtp\n  reconstruct --update tooth.surface.vtp --distfield tooth.distfield.vti --sizefield finer.sizefield.vti -o finer.surface.vtp"
)]
pub struct Args {
    /// Particles to connect, written by `particles` or `seed`; with --update, a finished surface.
    /// --method tight-cocone also reads point clouds, with or without normals: .ply, .vtp, or .xyz
    /// (lines `x y z` or `x y z nx ny nz`)
    #[arg(value_name = "P.bin", help_heading = FILES)]
    pub particles: PathBuf,
    /// Distance field F of the particles, mm; required by --method restricted. Without it, vertices
    /// are not projected, and triangles are neither improved nor compared with F = 0
    #[arg(long, value_name = "F.vti", help_heading = FILES)]
    pub distfield: Option<PathBuf>,
    /// Size field h on the grid of F, mm [default: the h stored with each particle]
    #[arg(long, value_name = "S.vti", requires = "distfield", help_heading = FILES)]
    pub sizefield: Option<PathBuf>,
    /// Update a finished surface instead of connecting particles: P.bin is a .vtp file that
    /// reconstruct has written. The surface changes where h of --sizefield differs from h at its
    /// vertices. Vertices more than a few edges away from there keep their positions, bit for bit
    #[arg(long, requires = "sizefield", conflicts_with_all = ["method", "space", "max_rounds"], help_heading = FILES)]
    pub update: bool,
    /// Surface file to write: .vtp with all data, or .ply, .stl, .obj or .vtk
    #[arg(short, long, value_name = "SURFACE", help_heading = FILES)]
    pub output: PathBuf,
    /// Several materials: also write the closed surface of each material to this folder, in a file
    /// named after the material, with the extension of the output. Normals point outward. Adjacent
    /// materials share vertices
    #[arg(long, value_name = "FOLDER", requires = "distfield", help_heading = FILES)]
    pub each: Option<PathBuf>,
    /// Method that connects the particles
    #[arg(long, value_enum, value_name = "METHOD", default_value_t = Method::Restricted, help_heading = METHOD)]
    pub method: Method,
    /// Maximum distance of a triangle's centroid from F = 0, mm, above 0. Points are added at
    /// triangles that exceed it [default: a quarter of h or of a voxel, whichever is larger]
    #[arg(long, value_name = "MM", value_parser = positive, help_heading = METHOD)]
    pub max_deviation: Option<f64>,
    /// Maximum number of rounds that add points, 0 to 100. Each round compares the whole surface
    /// with F. The limit applies separately to points added for grid nodes on the wrong side, and
    /// to each step of Tight Cocone that needs more points
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u16).range(0..=100), help_heading = METHOD)]
    pub max_rounds: u16,
    /// Improve triangles below this radius ratio by local moves, 0 to 1. The radius ratio is twice
    /// the inradius divided by the circumradius, which is 1 for an equilateral triangle. Together
    /// with --relaxation-sweeps 0, the value 0 leaves the triangulation unchanged
    #[arg(long, value_name = "RATIO", default_value_t = 0.9, value_parser = share, help_heading = METHOD)]
    pub improve_below: f64,
    /// Number of sweeps over the whole mesh before --improve-below applies, 0 to 20. Sweeps move
    /// vertices along F = 0 and flip edges where this improves the triangles. Meshes with a few
    /// thousand vertices receive additional sweeps as long as these help
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(0..=20), help_heading = METHOD)]
    pub relaxation_sweeps: u16,
    /// World frame of the mesh: lps (left, posterior, superior), ras (right, anterior, superior),
    /// or scanner, the frame of the file that distfield read [default: that of the particles]
    #[arg(long, value_enum, value_name = "FRAME", help_heading = METHOD)]
    pub space: Option<SpaceChoice>,
    /// Minimum radius ratio of a triangle, 0 to 1 [default: 0.3 with a distance field; none
    /// without]
    #[arg(long, value_name = "RATIO", value_parser = share, help_heading = CHECKS)]
    pub min_radius_ratio: Option<f64>,
    /// Several materials: accept triangles below --min-radius-ratio where junction curves allow no
    /// better ones. The verdict states their number
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
    /// Returns the options that do not depend on the metadata of the field.
    pub(crate) fn options(&self) -> Options {
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

    /// Returns the minimum radius ratio that passes; `None` means any.
    fn radius_ratio_bar(&self) -> Option<f64> {
        self.min_radius_ratio.or(self.distfield.as_ref().map(|_| MIN_RADIUS_RATIO))
    }

    /// Returns the names of the distance field and of the size field in messages.
    pub(crate) fn field_names(&self) -> [&Path; 2] {
        let fields = [(&self.distfield, "distance field"), (&self.sizefield, "size field")];
        fields.map(|(path, name)| path.as_deref().unwrap_or(Path::new(name)))
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
        if self.update {
            return json!({
                "update": true, "improve_below": self.improve_below, "relaxation_sweeps": self.relaxation_sweeps,
                "min_radius_ratio": self.radius_ratio_bar(), "accept_forced": self.accept_forced, "max_vertex_distance": self.max_vertex_distance,
            });
        }
        json!({
            "method": method, "max_deviation": self.max_deviation, "max_rounds": self.max_rounds,
            "improve_below": self.improve_below, "relaxation_sweeps": self.relaxation_sweeps,
            "min_radius_ratio": self.radius_ratio_bar(), "accept_forced": self.accept_forced, "max_vertex_distance": self.max_vertex_distance,
        })
    }

    fn check_options(&self, known: Known) -> Result<Known> {
        check_surface_name(&self.output)?;
        if let (Some(field), Some(is_many)) = (&self.distfield, known.is_many()) {
            check_field(self, field, is_many)?;
        }
        Ok(known)
    }
}

/// Returns an error if an option does not fit a field of one object, or of many materials.
pub(crate) fn check_field(args: &Args, field: &Path, is_many: bool) -> Result<()> {
    let field = field.display();
    if is_many && args.method == Method::TightCocone {
        return Err(Error::input(
            format!("{field}: contains the indicators of many materials"),
            "--method tight-cocone meshes only one object",
            "omit --method",
        ));
    }
    if !is_many && args.each.is_some() {
        return Err(Error::input(
            format!("{field}: is the distance field of one object"),
            "--each writes the surfaces of many materials",
            "omit --each, or pass the file that distfield --material writes",
        ));
    }
    Ok(())
}
