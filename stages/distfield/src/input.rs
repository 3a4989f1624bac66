//! Checks and crops the input. Rejects labels for a scan, an iso value for a label map, and a field
//! that exceeds the available memory.

use crate::args::Args;
use crate::crop::{Grid, crop, on_coarse_nodes};
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::{Error, Result};
use isoparticles_survey::cost::distfield_bytes;
use isoparticles_survey::kind::{Kind, KindChoice, judge};
use isoparticles_survey::survey::Survey;
use isoparticles_volume::{CutFaces, Volume, VoxelBox};

/// Rejects labels for a scan and an iso value for a label map, unless `--kind` is given. Warns if
/// the kind is uncertain or the labels contain NaN voxels. Also warns if an iso value is given for
/// a mask, because voxel centres next to the surface can change sides.
///
/// # Errors
/// If the kind of the volume is certain and does not match the option.
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
    let (input, reason) = (args.input.path.display(), &judged.reason);
    let materials = args.material.first().map(|choice| format!("--material {choice}"));
    let labels = args.labels.as_ref().map(|labels| format!("--labels {labels}")).or(materials);
    match (labels, args.iso, judged.kind) {
        (Some(labels), _, Kind::Scan) if judged.certain => Err(Error::input(
            format!("{labels}: the volume is a scan, not a label map: {reason}"),
            "in a label map, the voxels of one label form connected parts; in a scan, the voxels of one value are \
             scattered",
            format!(
                "set ISO (--iso); isoparticles-volume info {input} proposes values. If the volume is a label map, set \
                 DISTFIELD_OPTIONS=\"--kind labels\""
            ),
        )),
        (Some(_), _, Kind::Scan) => {
            context.warn(format!("{input}: may be a scan, not a label map: {reason}; for a scan, set ISO (--iso)"));
            Ok(())
        }
        (None, Some(_), Kind::Labels) if survey.distinct() == Some(2) => {
            context.warn(format!(
                "{input}: is a mask of two values; LABELS (--labels) keeps every voxel centre on its side, ISO \
                 (--iso) does not"
            ));
            Ok(())
        }
        (None, Some(iso), Kind::Labels) if judged.certain => Err(Error::input(
            format!("--iso {iso}: the volume is a label map, not a scan: {reason}"),
            "labels cannot be interpolated: between labels 0 and 3, an isosurface would pass through 1 and 2",
            format!(
                "set LABELS (--labels) to all, a range such as 2..5, or names; isoparticles-volume info {input} \
                 lists the labels. If the volume is a scan, set DISTFIELD_OPTIONS=\"--kind scan\""
            ),
        )),
        (None, Some(_), Kind::Labels) if survey.distinct() != Some(1) => {
            context.warn(format!(
                "{input}: may be a label map, not a scan: {reason}; for a label map, set LABELS (--labels)"
            ));
            Ok(())
        }
        _ => Ok(()),
    }
}

/// Rejects a grid of `voxels` plus the margin if the field needs more memory than is available.
///
/// # Errors
/// If there is not enough memory. The message contains the required amount.
pub fn check_room(args: &Args, voxels: [usize; 3], context: &Context) -> Result<()> {
    let [nx, ny, nz] = voxels.map(|n| n + 2 * usize::from(args.margin));
    // the memory of the volume itself is already in use
    let needed = distfield_bytes(nx * ny * nz);
    context.check_memory(
        needed,
        &format!("a field of {nx} x {ny} x {nz} nodes"),
        "set CROP (--crop) to a region around the object, or DOWNSAMPLE (--downsample) to 2 or more",
    )
}

/// Crops the volume to the grid that `--grid` selects. Returns the faces where the volume was cut.
///
/// # Errors
/// If F needs more memory than is available.
pub(crate) fn take_out(
    args: &Args,
    volume: &mut Volume,
    found: Option<VoxelBox>,
    room: [usize; 3],
    context: &Context,
) -> Result<CutFaces> {
    let size = volume.geometry.size;
    let kept = found.filter(|_| args.grid == Grid::Object).map(|object| on_coarse_nodes(object.with_room(room, size)));
    check_room(args, kept.map_or(size, |kept| kept.size()), context)?;
    Ok(kept.map_or_else(CutFaces::default, |kept| crop(volume, kept)))
}
