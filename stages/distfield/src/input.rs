//! Checks of the input before any work: labels of a scan, an iso value of a label map, a field that
//! exceeds the available memory.

use crate::run::Args;
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::{Error, Result};
use isoparticles_survey::cost::distfield_bytes;
use isoparticles_survey::kind::{Kind, KindChoice, judge};
use isoparticles_survey::survey::Survey;
use isoparticles_volume::Volume;

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
                "give --iso VALUE (isoparticles-volume info {input} proposes some), or --kind labels if these are labels all the same"
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
                "give --labels (all, 2..5 and names are understood; isoparticles-volume info {input} lists them), or --kind scan if these are \
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
