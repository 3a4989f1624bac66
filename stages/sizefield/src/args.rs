//! Command-line options of the `sizefield` program, and the defaults of the quality levels.

use crate::limits::check_bounds;
use crate::region::{Region, SizedNode};
use crate::{MIN_PARTICLES, Parameters};
use clap::Parser;
use isoparticles_stage::cli::check::Known;
use isoparticles_stage::cli::values::{not_negative, positive};
use isoparticles_stage::cli::{CommonArgs, FILES, METHOD, StageArgs};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::material_sizes::{Given, GivenSize};
use isoparticles_stage::quality::Quality;
use serde_json::{Value, json};
use std::path::PathBuf;

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
    pub(crate) refine: Vec<Region>,
    /// Set h to H in a region, after all other options have determined h. The forms are those of
    /// --refine; may be repeated, and the regions take effect in the given order. H may be larger
    /// than h was. Near the border of the region, h differs from h outside by at most delta per mm
    #[arg(long, value_name = "ball:X,Y,Z,RADIUS=H|mask:FILE=H|points:FILE", help_heading = METHOD)]
    pub(crate) resize: Vec<Region>,
    /// Apply --resize to this size field of F.vti instead of computing one; F.vti is not read. h
    /// keeps its value, bit for bit, except in the regions and in a rim around them where h must be
    /// lowered
    #[arg(long, value_name = "S.vti", requires = "resize", help_heading = FILES,
        conflicts_with_all = ["quality", "epsilon", "min_size", "max_size", "max_deviation", "scale", "size", "uniform", "vertices", "refine"])]
    pub(crate) update: Option<PathBuf>,
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
        if self.update.is_some() {
            parameters = json!({});
        }
        if !self.size.is_empty() {
            parameters["size"] = json!(self.size);
        }
        if !self.resize.is_empty() {
            parameters["resize"] = json!(self.resize);
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
        for file in self.refine.iter().chain(&self.resize).filter_map(Region::file) {
            std::fs::metadata(file).map_err(|error| Error::file(file, "read", &error, "check the name of the file"))?;
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

    /// Returns the bound on |grad h|.
    pub(crate) fn delta(&self) -> f64 {
        self.delta.unwrap_or(Defaults::of(self.quality()).delta)
    }

    /// Rejects the combination of `--uniform` and `--refine`.
    pub(crate) fn refuse_refined_constant(&self) -> Result<()> {
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
    pub(crate) fn refuse_sizes(&self) -> Result<()> {
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
            delta: self.delta(),
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
}
