//! The `phantom` program: writes an analytic volume, and its exact properties, for tests, demos and
//! benchmarks.

use clap::Parser;
use glam::{DMat3, DVec3};
use isoparticles_stage::cli::check;
use isoparticles_stage::error::{Error, Result};
use isoparticles_tests::nrrd::{self, FileSpace, Voxels};
use isoparticles_tests::scene::{self, Options, Scene, Shape, Truth};
use isoparticles_tests::{torso, volume};
use isoparticles_volume::{Geometry, Space};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Write an analytic volume (NRRD) and, optionally, the exact properties of its surface (JSON).
///
/// Example: phantom torus -o torus.nrrd --size 64 --spacing 1,1,1.5 --truth torus.json
#[derive(Debug, Parser)]
#[command(name = "phantom", version)]
struct Arguments {
    /// Shape to write.
    #[arg(value_enum)]
    shape: Shape,
    /// File to write (NRRD, gzip).
    #[arg(short, long)]
    output: PathBuf,
    /// Write the exact properties of the surface (area, volume, genus, components, local feature
    /// size, iso value) to this JSON file.
    #[arg(long, value_name = "FILE.json")]
    truth: Option<PathBuf>,
    /// Number of voxels: one number for a cube, or three separated by commas [default: 64; torso
    /// 268,129,177].
    #[arg(long, value_parser = parse_size)]
    size: Option<[usize; 3]>,
    /// Voxel spacing, mm: one number, or three separated by commas [default: 1; torso 1.3].
    #[arg(long, value_parser = parse_spacing)]
    spacing: Option<[f64; 3]>,
    /// Scalar volume (smooth edges, values similar to Hounsfield units) or label map.
    #[arg(long, value_enum, default_value_t = Kind::Scalar)]
    kind: Kind,
    /// Voxel type of scalar volumes.
    #[arg(long = "type", value_enum, default_value_t = Type::Int16)]
    voxel_type: Type,
    /// Standard deviation of the Gaussian noise, in scalar units (inside and outside differ by
    /// 400).
    #[arg(long, default_value_t = 0.0, value_name = "SIGMA")]
    noise: f64,
    /// Wall thickness of `thin-shell`, mm [default: 2.5 voxels].
    #[arg(long, value_name = "MM")]
    thickness: Option<f64>,
    /// Gap of `two-balls`, mm [default: 3 voxels].
    #[arg(long, value_name = "MM")]
    gap: Option<f64>,
    /// Part of `torso`.
    #[arg(long, value_enum, default_value_t = torso::Part::All)]
    part: torso::Part,
    /// Rotate the grid about the x, then the y, then the z axis of the world: three angles in
    /// degrees, separated by commas.
    #[arg(long, value_parser = parse_three, value_name = "X,Y,Z", allow_hyphen_values = true)]
    rotate: Option<[f64; 3]>,
    /// Mirror the first grid axis in the world, so that the three axes are left-handed.
    #[arg(long)]
    left_handed: bool,
    /// World position of the first voxel's centre, mm (in LPS, even with --space RAS).
    #[arg(long, value_parser = parse_three, value_name = "X,Y,Z", allow_hyphen_values = true)]
    origin: Option<[f64; 3]>,
    /// World frame specified in the file; the origin and the directions in the file are in this
    /// frame.
    #[arg(long, value_enum, default_value_t = FileSpace::Lps)]
    space: FileSpace,
    /// Seed for the noise.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Write the voxels uncompressed instead of with gzip.
    #[arg(long)]
    raw: bool,
    /// Overwrite existing files.
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    /// Scalars with smooth edges; the iso value of the surface is 100, except for the torso (see
    /// --truth).
    Scalar,
    /// Labels: 0 outside, 1 inside; the torso has labels for four tissues.
    Label,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Type {
    /// 16-bit integers, as in a scan.
    Int16,
    /// 32-bit floating-point numbers.
    Float,
}

fn main() -> ExitCode {
    if let Some(code) = check::asked("phantom", |_: &Arguments, known| Ok(known)) {
        return code;
    }
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("phantom: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    refuse_existing(&arguments.output, arguments.force)?;
    if let Some(path) = &arguments.truth {
        refuse_existing(path, arguments.force)?;
    }
    let geometry = geometry(arguments)?;
    let default = Options::for_grid(&geometry);
    let options = Options {
        thickness: arguments.thickness.unwrap_or(default.thickness),
        gap: arguments.gap.unwrap_or(default.gap),
        part: arguments.part,
    };
    let scene = scene::build(arguments.shape, &geometry, &options);
    nrrd::write(
        &arguments.output,
        &geometry,
        arguments.space,
        &voxels(arguments, scene.as_ref(), &geometry),
        !arguments.raw,
    )?;
    if let Some(path) = &arguments.truth {
        let text = serde_json::to_string_pretty(&truth(arguments, scene.as_ref(), &geometry)).map_err(|e| {
            Error::input(
                format!("the truth cannot be written as JSON: {e}"),
                "a figure is not finite",
                "change the size",
            )
        })?;
        std::fs::write(path, text + "\n")
            .map_err(|e| Error::file(path, "write the truth", &e, "choose a folder that can be written"))?;
    }
    Ok(())
}

fn refuse_existing(path: &Path, force: bool) -> Result<()> {
    if path.exists() && !force {
        return Err(Error::input(
            format!("{}: this file exists already", path.display()),
            "an existing file is never replaced by accident",
            "choose another name or add --force",
        ));
    }
    Ok(())
}

fn voxels(arguments: &Arguments, scene: &dyn Scene, geometry: &Geometry) -> Voxels {
    if arguments.kind == Kind::Label {
        return Voxels::U8(volume::labels(scene, geometry).data);
    }
    let image = volume::scalar(scene, geometry, arguments.noise, arguments.seed);
    match arguments.voxel_type {
        Type::Float => Voxels::F32(image.data),
        // The intensities fit easily into 16 bits; `as` clamps extreme noise.
        Type::Int16 => Voxels::I16(image.data.iter().map(|v| v.round() as i16).collect()),
    }
}

/// Returns the exact properties of the scene, including the iso value or labels, which depend on
/// the kind of volume.
fn truth(arguments: &Arguments, scene: &dyn Scene, geometry: &Geometry) -> Truth {
    let mut truth = scene.truth();
    truth.centre_world = geometry.grid_to_world(DVec3::from_array(truth.centre_grid)).to_array();
    let whole_torso = arguments.shape == Shape::Torso && arguments.part == torso::Part::All;
    if arguments.kind == Kind::Label {
        truth.labels = if whole_torso { vec![1, 2, 3] } else { vec![1] };
    } else if whole_torso {
        // This iso value separates bone from everything else.
        truth.iso = Some(500.0);
        truth.inside = Some("above".into());
    } else {
        let (outside, inside) = scene.intensities();
        truth.iso = Some(0.5 * (outside + inside));
        truth.inside = Some(if inside > outside { "above".into() } else { "below".into() });
    }
    truth
}

fn geometry(arguments: &Arguments) -> Result<Geometry> {
    let is_torso = arguments.shape == Shape::Torso;
    let size = arguments.size.unwrap_or(if is_torso { torso::PAPER_SIZE } else { [64; 3] });
    let spacing = arguments.spacing.unwrap_or(if is_torso { [torso::PAPER_SPACING; 3] } else { [1.0; 3] });
    if size.iter().any(|n| *n < 8) || size.iter().product::<usize>() > 1 << 31 {
        return Err(Error::input(
            format!("--size {},{},{}", size[0], size[1], size[2]),
            "a phantom needs at least 8 voxels a side and at most 2^31 in all",
            "choose another size",
        ));
    }
    let [x, y, z] = arguments.rotate.unwrap_or([0.0; 3]).map(f64::to_radians);
    let mut directions = DMat3::from_rotation_z(z) * DMat3::from_rotation_y(y) * DMat3::from_rotation_x(x);
    if arguments.left_handed {
        directions.x_axis = -directions.x_axis;
    }
    let space = if arguments.space == FileSpace::Unnamed { Space::Unnamed } else { Space::Lps };
    let origin = DVec3::from_array(arguments.origin.unwrap_or([0.0; 3]));
    Ok(Geometry { size, spacing: DVec3::from_array(spacing), directions, origin, space })
}

fn parse_three(text: &str) -> std::result::Result<[f64; 3], String> {
    let numbers = text.split(',').map(|part| part.trim().parse::<f64>().map_err(|e| format!("{part}: {e}")));
    let numbers: Vec<f64> = numbers.collect::<std::result::Result<_, _>>()?;
    if numbers.iter().any(|n| !n.is_finite()) {
        return Err("the numbers must be finite".into());
    }
    <[f64; 3]>::try_from(numbers).map_err(|n| format!("three numbers are needed, {} given", n.len()))
}

fn parse_spacing(text: &str) -> std::result::Result<[f64; 3], String> {
    let spacing = if text.contains(',') { parse_three(text)? } else { parse_three(&format!("{text},{text},{text}"))? };
    if spacing.iter().any(|step| *step <= 0.0) {
        return Err("spacing must be positive".into());
    }
    Ok(spacing)
}

fn parse_size(text: &str) -> std::result::Result<[usize; 3], String> {
    let numbers = text.split(',').map(|part| part.trim().parse::<usize>().map_err(|e| format!("{part}: {e}")));
    let numbers: Vec<usize> = numbers.collect::<std::result::Result<_, _>>()?;
    match *numbers {
        [n] => Ok([n; 3]),
        [x, y, z] => Ok([x, y, z]),
        _ => Err(format!("one or three numbers are needed, {} given", numbers.len())),
    }
}
