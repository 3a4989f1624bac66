//! Resamples sheared volumes, for example with a gantry tilt or a NIfTI sform with shear, to
//! orthonormal axes before anything is measured.
//!
//! Space outside the volume is filled with background, which closes the object at the border of the
//! volume. With an open border, it is filled with the values of the nearest voxels.

use crate::materials::choice::{MaterialChoice, resolve};
use crate::{Border, Inside};
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::Result;
use isoparticles_volume::{LayerLabel, Shear, Volume, Voxels};

/// The object to extract, which determines how the volume is resampled.
#[derive(Clone, Copy)]
pub enum Wanted<'a> {
    /// The union of labels.
    Labels(&'a [LayerLabel]),
    /// Several materials.
    Materials(&'a [MaterialChoice]),
    /// One side of an iso value.
    Iso(f64, Inside),
}

/// Returns the volume on orthonormal axes. Warns if the volume is resampled.
///
/// # Errors
/// If the resampled volume exceeds the available memory, or if a material is not in the volume.
pub fn unshear(volume: Volume, wanted: Wanted<'_>, border: Border, context: &Context) -> Result<Volume> {
    let Some(shear) = Shear::of(&volume.geometry) else { return Ok(volume) };
    let [nx, ny, nz] = shear.geometry.size;
    let layers = match wanted {
        Wanted::Iso(..) => vec![4],
        _ => volume.layers().map(|voxels| voxels.scalar_type().bytes()).collect(),
    };
    // besides the results, memory contains the input and the output of a resampling pass over one
    // layer
    let bytes = layers.iter().sum::<usize>() + 2 * layers.iter().max().unwrap_or(&0);
    context.check_memory(
        shear.geometry.voxel_count() as f64 * bytes as f64,
        &format!("resampling the sheared volume to {nx} x {ny} x {nz} voxels"),
        "set CROP (--crop) to a region around the object, or DOWNSAMPLE (--downsample) to 2 or more",
    )?;
    let step = context.step("resample");
    let resampled = match wanted {
        Wanted::Labels(labels) => moved(&volume, &shear, border, |at| labels.contains(&at)),
        Wanted::Materials(choices) => {
            let chosen = resolve(choices, &volume)?;
            moved(&volume, &shear, border, |at| chosen.number(at) != 0)
        }
        Wanted::Iso(iso, inside) => match interpolated(&volume.voxels, &shear, iso, inside, border) {
            Some(voxels) => vec![voxels],
            None => return Ok(volume),
        },
    };
    drop(step);
    context.warn(shear.remark());
    let mut layers = resampled.into_iter();
    let first = layers.next().unwrap_or(Voxels::U8(Vec::new()));
    Ok(Volume { geometry: shear.geometry, voxels: first, more_layers: layers.collect(), ..volume })
}

/// Resamples all layers of a label map. With a closed border, space outside the volume gets the
/// lowest non-negative label for which `asked` is false.
fn moved(volume: &Volume, shear: &Shear, border: Border, asked: impl Fn(LayerLabel) -> bool) -> Vec<Voxels> {
    let layer = |(layer, voxels)| {
        let outside = (0..).find(|&label| !asked(LayerLabel { layer, label }));
        shear.move_labels(voxels, outside.filter(|_| border == Border::Cap))
    };
    volume.layers().enumerate().map(layer).collect()
}

/// Resamples a scan. Space outside the volume gets the values of the nearest voxels. With a closed
/// border, values of the object are reflected about the iso value there, so that the object ends
/// half a voxel beyond the outermost voxel centres. Returns `None` if there is no surface, which a
/// later check reports.
fn interpolated(voxels: &Voxels, shear: &Shear, iso: f64, inside: Inside, border: Border) -> Option<Voxels> {
    let (low, high) = voxels.range()?;
    let is_finite = low.is_finite() && high.is_finite() && voxels.nan_count() == 0;
    if !(is_finite && low < iso && iso < high) {
        return None;
    }
    let beyond = |value: f32| {
        let past = f64::from(value) - iso;
        let is_inside = if inside == Inside::Above { past > 0.0 } else { past < 0.0 };
        if is_inside && border == Border::Cap { (iso - past) as f32 } else { value }
    };
    Some(Voxels::F32(shear.interpolate(voxels, beyond)))
}
