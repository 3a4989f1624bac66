//! Checks of the input before any work: labels of a scan, an iso value of a label map, a field that
//! exceeds the available memory. Also runs `--info`, which prints a survey and computes no field.

use crate::info::cost::distfield_bytes;
use crate::info::kind::{Kind, judge};
use crate::info::survey::Survey;
use crate::info::{Wishes, examine};
use crate::run::Args;
use isoparticles_stage::cli::{Context, Outcome};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::output::write_atomically;
use isoparticles_volume::{LayerLabel, Volume};
use std::io::Write;
use std::path::Path;

/// Values of `--kind`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum KindChoice {
    /// Judge by the values.
    Auto,
    /// A scan: measured values.
    Scan,
    /// A label map: numbers of materials.
    Labels,
}

impl KindChoice {
    /// The kind, or `None` if it is to be judged.
    pub fn given(self) -> Option<Kind> {
        match self {
            Self::Auto => None,
            Self::Scan => Some(Kind::Scan),
            Self::Labels => Some(Kind::Labels),
        }
    }
}

/// Refuses labels of a scan and an iso value of a label map, unless `--kind` is given. Warns where
/// the kind is uncertain, and for an iso value of a mask, where voxel centres next to the surface
/// can change side. For labels it also warns of NaN voxels.
///
/// # Errors
/// When the kind of the volume is certain and does not match the option.
pub fn check_kind(args: &Args, volume: &Volume, context: &Context) -> Result<()> {
    if args.iso.is_none() {
        volume.nan_remark().iter().for_each(|remark| context.warn(remark));
    }
    if args.kind != KindChoice::Auto {
        return Ok(());
    }
    let step = context.step("judge the kind");
    let survey = Survey::of(&volume.voxels, &volume.geometry);
    let judged = judge(&survey, volume.segments.len());
    drop(step);
    let (input, reason) = (args.input.display(), &judged.reason);
    let materials = args.material.first().map(|choice| format!("--material {choice}"));
    let labels = args.labels.as_ref().map(|labels| format!("--labels {labels}")).or(materials);
    match (labels, args.iso, judged.kind) {
        (Some(labels), _, Kind::Scan) if judged.certain => Err(Error::input(
            format!("{labels}: the volume is a scan, not a label map: {reason}"),
            "a label is a number that stands for a material; in a scan the voxels of one value are specks here and there",
            format!(
                "give --iso VALUE (distfield {input} --info proposes some), or --kind labels if these are labels all the same"
            ),
        )),
        (Some(_), _, Kind::Scan) => {
            context.warn(format!("{input}: may be a scan and not a label map: {reason}; --iso is for scans"));
            Ok(())
        }
        (None, Some(_), Kind::Labels) if survey.distinct() == Some(2) => {
            context.warn(format!(
                "{input}: is a mask of two values; --labels keeps every voxel centre on its side, which --iso does not"
            ));
            Ok(())
        }
        (None, Some(iso), Kind::Labels) if judged.certain => Err(Error::input(
            format!("--iso {iso}: the volume is a label map, not a scan: {reason}"),
            "labels are numbers of materials, with nothing in between: from 0 to 3 the surface would cross 1 and 2 as well",
            format!(
                "give --labels (all, 2..5 and names are understood; distfield {input} --info lists them), or --kind scan if these are \
                 measured values all the same"
            ),
        )),
        (None, Some(_), Kind::Labels) if survey.distinct() != Some(1) => {
            context.warn(format!("{input}: may be a label map and not a scan: {reason}; --labels is for label maps"));
            Ok(())
        }
        _ => Ok(()),
    }
}

/// Refuses a field on `voxels` plus the margin if it needs more memory than is available.
///
/// # Errors
/// When the memory does not suffice; the message has the figure.
pub fn check_room(args: &Args, voxels: [usize; 3], context: &Context) -> Result<()> {
    let [nx, ny, nz] = voxels.map(|n| n + 2 * usize::from(args.margin));
    // the memory of the volume itself is already in use
    let needed = distfield_bytes(nx * ny * nz);
    context.check_memory(
        needed,
        &format!("a field of {nx} x {ny} x {nz} nodes"),
        "crop the volume to the object, or resample it",
    )
}

/// Prints the survey of the volume, as text or as JSON.
///
/// # Errors
/// When the JSON file or stdout cannot be written, and when the run is interrupted.
pub fn tell(args: &Args, volume: &Volume, labels: Option<Vec<LayerLabel>>, context: &Context) -> Result<Outcome> {
    let wishes = Wishes { labels, iso: args.iso.map(|iso| (iso, args.inside)), kind: args.kind.given() };
    let info = examine(volume, &wishes, context)?;
    let json = || {
        serde_json::to_string_pretty(&info).map_err(|error| {
            Error::input(
                format!("what was found cannot be put into JSON: {error}"),
                "--json asks for it",
                "report this bug",
            )
        })
    };
    let print = |text: &str| {
        std::io::stdout()
            .write_all(text.as_bytes())
            .or_else(|error| if error.kind() == std::io::ErrorKind::BrokenPipe { Ok(()) } else { Err(error) })
            .map_err(|error| Error::file(Path::new("stdout"), "write", &error, "check where stdout goes"))
    };
    match args.json.as_deref() {
        Some(path) if path == Path::new("-") => print(&format!("{}\n", json()?))?,
        path => {
            if let Some(path) = path {
                let text = json()?;
                write_atomically(path, |file| writeln!(file, "{text}"))?;
            }
            print(&info.text(&args.input.display().to_string()))?;
        }
    }
    Ok(Outcome::Passed)
}
