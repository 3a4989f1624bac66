//! Command-line options of the `distfield` program.

use crate::choose::{ScaleArgs, inside_name};
use crate::crop::Grid;
use crate::materials::overlaps::Overlap;
use crate::materials::{Cut, MaterialChoice};
use crate::{Border, Inside, Keep};
use isoparticles_stage::cli::{CommonArgs, FILES, METHOD};
use isoparticles_stage::meta;
use isoparticles_stage::space::SpaceChoice;
use isoparticles_survey::input::InputArgs;
use isoparticles_survey::kind::KindChoice;
use isoparticles_survey::selection::Selection;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Computes the signed distance field F (mm) of an object, given by a volume and an iso value or
/// labels
///
/// F is the implicit function of section 3.1 of the paper (Kim, Chen and Hansen 2012). The output
/// contains samples of the signed distance to the surface, negative inside; F is the cubic B-spline
/// that interpolates these samples. For a scalar volume, the surface is the set of points at which
/// the cubic B-spline through the voxels equals the iso value. For labels, it is a smooth surface
/// that preserves the local volume and, without a scale, keeps every voxel centre on its side. The
/// grid has the spacing of the input. It covers the object (with --grid volume, the whole volume)
/// and --margin additional voxels on each face.
#[derive(Clone, Debug, clap::Parser)]
#[command(
    name = "distfield",
    version,
    after_help = "Example: the tooth in a CT scan (the iso value may be an integer)\n  distfield tooth_ct.nrrd -o tooth.distfield.vti --iso 600\nExample: both lungs of a label map as one object\n  distfield lungs_label.nrrd -o lungs.distfield.vti --labels 2,3\nExample: every label of a volume as a separate material\n  distfield brain_parcellation.nrrd -o brain.materials.vti --material all"
)]
pub struct Args {
    /// The options for the volume to read.
    #[command(flatten)]
    pub input: InputArgs,
    /// VTK image file to write: the distance field F (mm) or, with --material, one field for each
    /// material
    #[arg(short, long, value_name = "F.vti", help_heading = FILES)]
    pub output: PathBuf,
    /// Iso value of the surface, in the unit of the voxel values, between their minimum and maximum
    #[arg(
        long,
        value_name = "V",
        allow_negative_numbers = true,
        required_unless_present_any = ["labels", "material"],
        conflicts_with = "labels",
        help_heading = METHOD
    )]
    pub iso: Option<f64>,
    /// Side of the iso value on which the object lies; for example, below for the lungs in a CT
    /// scan
    #[arg(long, value_enum, value_name = "SIDE", default_value_t = Inside::Above, help_heading = METHOD)]
    pub inside: Inside,
    /// Labels whose union is the object, separated by commas or spaces: numbers, ranges such as
    /// 2..5 (only labels that occur), all (every label except 0), or names from the file
    #[arg(long, value_name = "A,B", allow_hyphen_values = true, help_heading = METHOD)]
    pub labels: Option<Selection>,
    /// Define a material by its labels, such as lung=2+3; may be repeated. NAME alone selects the
    /// label of that name in the file, or the mask of that name in the folder. The word all defines
    /// one material for each label except 0 that no other --material contains. The remaining labels
    /// form the material "outside". The output contains one field for each material, including the
    /// outside
    #[arg(
        long,
        value_name = "NAME=A+B",
        allow_hyphen_values = true,
        conflicts_with_all = ["labels", "iso"],
        help_heading = METHOD
    )]
    pub material: Vec<MaterialChoice>,
    /// With --material: rule for the voxels of several materials, which segments and masks can
    /// share; listed prefers the material listed first, then the smallest of those that all adds;
    /// smaller prefers the smallest. Reassignments are reported
    #[arg(long, value_enum, value_name = "WHICH", default_value_t = Overlap::Listed, requires = "material", help_heading = METHOD)]
    pub overlap: Overlap,
    /// With --material: reassign each connected component with fewer voxels than this, including
    /// components of the outside, to the material with which it shares the most voxel faces; 1
    /// changes nothing. Reassignments are reported
    #[arg(long, value_name = "VOXELS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..), requires = "material", help_heading = METHOD)]
    pub smallest_island: u32,
    /// Kind of volume. auto detects the kind from the voxel values, and rejects labels for a scan
    /// and an iso value for a label map; use scan or labels if the detection is wrong
    #[arg(long, value_enum, value_name = "KIND", default_value_t = KindChoice::Auto, help_heading = METHOD)]
    pub kind: KindChoice,
    /// Treatment of the object at the border of the volume: cap closes the object half a voxel
    /// beyond the outermost voxel centres, with rims rounded by half a voxel; flat closes it there
    /// by planes with sharp rims, and names the faces in the planes; open extends the surface
    /// straight out of the volume
    #[arg(long, value_enum, value_name = "HOW", default_value_t = BorderChoice::Cap, help_heading = METHOD)]
    pub border: BorderChoice,
    /// Cut the object, or all materials, by a plane through X,Y,Z (mm, world frame of the output),
    /// and remove the side to which the normal NX,NY,NZ points. The caps in the plane have sharp
    /// rims and are named after it; may be repeated
    #[arg(long, value_name = "plane:X,Y,Z,NX,NY,NZ[=NAME]", allow_hyphen_values = true, help_heading = METHOD)]
    pub cut: Vec<Cut>,
    /// Extent of the grid: object is the bounding box of the object, enlarged by the voxels on
    /// which F depends near the surface; volume is the whole volume. The surface and its world
    /// coordinates are the same for both
    #[arg(long, value_enum, value_name = "WHICH", default_value_t = Grid::Object, help_heading = METHOD)]
    pub grid: Grid,
    /// Connected parts of the object to keep: all, only the largest, or those with a volume of at
    /// least VOLUME mm^3. Removed parts are reported; cavities are unaffected
    #[arg(long, value_name = "all|largest|VOLUME", default_value_t = Keep::All, help_heading = METHOD)]
    pub keep: Keep,
    /// Number of additional voxels on each face of the grid, 3 to 64, as room for F around the
    /// surface
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(3..=64), help_heading = METHOD)]
    pub margin: u16,
    /// Labels without a scale: minimum distance between the surface and every voxel centre, in
    /// units of the minimum voxel spacing, 0.01 to 0.15. The distance leaves room for the deviation
    /// of the triangles from the curved surface
    #[arg(long, value_name = "VOXELS", default_value_t = 0.05, value_parser = clearance_in_range, help_heading = METHOD)]
    pub clearance: f64,
    /// World frame of the output, which later stages keep: lps (left, posterior, superior), ras
    /// (right, anterior, superior), or scanner, the frame of the input file: RAS for NIfTI,
    /// FreeSurfer and RAS NRRD, LPS for DICOM and MetaImage. A volume without an anatomical space
    /// keeps its coordinates
    #[arg(long, value_enum, value_name = "FRAME", default_value_t = SpaceChoice::Lps, help_heading = METHOD)]
    pub space: SpaceChoice,
    /// The options of the scale.
    #[command(flatten)]
    pub scale: ScaleArgs,
    /// The options of all stages.
    #[command(flatten)]
    pub common: CommonArgs,
}

fn clearance_in_range(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.01..=MOST_CLEARANCE).contains(&value) => Ok(value),
        _ => Err(format!("{text} is not a number from 0.01 to {MOST_CLEARANCE}")),
    }
}

/// Maximum clearance, in units of the minimum voxel spacing. The level set is computed with twice
/// this clearance, 0.3 (`CLEARANCE_FACTOR`). In a layer one voxel thick, this must be less than
/// 0.5, the distance from the voxel centres to the surfaces of the layer.
const MOST_CLEARANCE: f64 = 0.15;

/// Treatment of the object at the border of the volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum BorderChoice {
    /// Close the object with rounded rims.
    Cap,
    /// Close the object by planes with sharp rims.
    Flat,
    /// Extend the surface straight out of the volume.
    Open,
}

impl BorderChoice {
    /// Returns the treatment of the indicators at the border. With flat borders, they continue
    /// beyond it, and planes end the materials later.
    pub(crate) fn of_fields(self) -> Border {
        if self == Self::Cap { Border::Cap } else { Border::Open }
    }

    /// Returns the value of the option.
    fn name(self) -> &'static str {
        match self {
            Self::Cap => "cap",
            Self::Flat => "flat",
            Self::Open => "open",
        }
    }
}

impl From<BorderChoice> for meta::Border {
    fn from(choice: BorderChoice) -> Self {
        match choice {
            BorderChoice::Cap => Self::Cap,
            BorderChoice::Flat => Self::Flat,
            BorderChoice::Open => Self::Open,
        }
    }
}

impl Args {
    /// Returns the options that determine the result, for the history of the output file.
    pub(crate) fn to_parameters(&self) -> Value {
        let (border, keep) = (self.border.name(), self.keep.to_string());
        let mut parameters = match (&self.labels, self.iso) {
            _ if !self.material.is_empty() => json!({
                "material": self.material.iter().map(MaterialChoice::to_string).collect::<Vec<_>>(), "border": border,
                "margin": self.margin, "clearance": self.clearance, "smallest_island": self.smallest_island,
                "overlap": self.overlap,
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
        if !self.cut.is_empty() {
            parameters["cut"] = json!(self.cut.iter().map(Cut::to_string).collect::<Vec<_>>());
        }
        if let Some(kind) = self.kind.given() {
            parameters["kind"] = json!(kind);
        }
        parameters["grid"] = json!(grid_name(self.grid));
        self.scale.add_to(&mut parameters);
        self.input.add_to(&mut parameters);
        parameters
    }
}

/// Returns the value of `--grid` for a grid.
fn grid_name(grid: Grid) -> &'static str {
    match grid {
        Grid::Object => "object",
        Grid::Volume => "volume",
    }
}
