//! Reports the result of a run: grid, parts, volume and zero set of F, with limits for warnings and
//! failed checks.

use crate::Redistanced;
use crate::changes::SPECK_SHARE;
use isoparticles_stage::cli::values::significant;
use isoparticles_stage::cli::{Context, FIT_BUT_FOR};
use isoparticles_stage::meta::DistanceMeta;
use isoparticles_volume::Geometry;
use serde_json::json;

/// Maximum number of surfaces of F whose volumes are listed in the file and in the report. The
/// value only bounds the length of the list.
pub(crate) const LISTED_SURFACES: usize = 100;

/// Limits of the distance between the zero sets of F and of its source, in voxels: mean and 99th
/// percentile. Above either limit, a warning is printed. The limits are three times the bounds that
/// the tests impose on real scans and on a noisy ball (0.01 and 0.05 voxel,
/// `real_volumes_keep_their_zero_set_and_parts`).
const SHIFT_LIMITS: (f64, f64) = (0.03, 0.15);

/// Limits of the relative change in volume: a warning is printed above the first, and a check fails
/// above the second. The change is up to 8 % for layers one voxel thick, 3 % for layers two voxels
/// thick (test `thin_layers_and_rods_keep_their_volume`) and 20 % for specks of single voxels.
pub(crate) const VOLUME_LIMITS: (f64, f64) = (0.05, 0.25);

/// Limits of the relative change in volume with a scale above 0, where smoothing preserves the
/// volume. For meshes of solid organs with 1,000 vertices, the volume changes by up to 2 %. A mesh
/// whose volume changes by 10 % does not represent the object: for ribs and trabecular bone at a
/// few thousand vertices, the volume changes by 20 to 42 %.
pub(crate) const SCALED_VOLUME_LIMITS: (f64, f64) = (0.02, 0.1);

const _: () = assert!(10.0 * SPECK_SHARE < SCALED_VOLUME_LIMITS.0, "lost specks alone must not cause a warning");

/// Reports the size, in nodes, of the grids of F and of the whole volume.
pub(crate) fn tell_grid(whole: &Geometry, made: &Geometry, context: &Context) {
    let told = |[nx, ny, nz]: [usize; 3]| format!("{nx} x {ny} x {nz}");
    if whole.size == made.size {
        context.summary("grid, nodes", told(made.size));
    } else {
        let share = 100.0 * made.voxel_count() as f64 / whole.voxel_count() as f64;
        context.summary("grid, nodes", format!("{} of {} ({share:.0} %)", told(made.size), told(whole.size)));
    }
    context.report("grid", json!({ "nodes": made.size, "nodes_of_volume": whole.size }));
}

/// Returns the relative difference between the volume enclosed by F = 0 and the volume of the kept
/// voxels. Returns `None` for an isosurface without a scale, or if an open border leaves the
/// surface open.
fn volume_change(result: &Redistanced, meta: &DistanceMeta) -> Option<f64> {
    if result.volumes.is_empty() {
        return None;
    }
    let voxels = meta.volume_before? - result.dropped.volume;
    Some(result.parts_after.volume / voxels - 1.0)
}

/// Reports F: parts, volume, and the distance between the zero sets of F and of the input. Warns if
/// this distance exceeds [`SHIFT_LIMITS`].
pub(crate) fn describe(result: &Redistanced, meta: &DistanceMeta, context: &Context) {
    let (before, after) = (result.parts_before, result.parts_after);
    let dropped = &result.dropped;
    if dropped.components > 0 {
        let told = format!(
            "{} of {} mm^3 together, the largest of {}",
            dropped.components,
            significant(dropped.volume),
            significant(dropped.largest)
        );
        context.summary("components dropped", told);
    }
    if dropped.cut_off > 0 {
        let told = format!("{}: F cuts the neck to a kept part, which is thinner than a voxel", dropped.cut_off);
        context.summary("  of these", told);
    }
    context.summary("components", format!("{} -> {}", before.components, after.components));
    context.summary("cavities", format!("{} -> {}", before.cavities, after.cavities));
    match volume_change(result, meta) {
        Some(change) => {
            let (voxels, change) = (after.volume / (1.0 + change), 100.0 * change);
            let told = format!("{} -> {} ({change:+.2} %)", significant(voxels), significant(after.volume));
            context.summary("volume, mm^3", told);
        }
        None => context.summary("volume, mm^3", significant(after.volume)),
    }
    if let Some(changed) = result.changed {
        context.summary("voxel centres that changed sides", changed);
    }
    let shift = result.shift;
    context.summary(
        "shift of the zero set, voxels",
        format!("mean {:.4}, 99th percentile {:.4}, largest {:.3}", shift.mean, shift.p99, shift.max),
    );
    context.report("held_nodes", result.held_nodes);
    context.report("undecided_junctions", result.undecided);
    context.report("zero_set_fit", json!(result.fit));
    context.report("meta", json!(meta));
    if shift.mean > SHIFT_LIMITS.0 || shift.p99 > SHIFT_LIMITS.1 {
        context.warn(format!(
            "the zero set of F is {:.3} voxel from that of the input on average and {:.3} at the 99th percentile: the surface \
             folds within a voxel in many places, which no distance field on this grid can hold; smooth the input, or \
             choose another iso value",
            shift.mean, shift.p99
        ));
    }
}

/// Checks that components, cavities and the sides of voxel centres are preserved. Label surfaces
/// without a scale guarantee this, so a difference fails the check. Other surfaces can fold within
/// a voxel, where the number of parts depends on rounding. A difference then only causes a warning.
pub(crate) fn failed_checks(result: &Redistanced, meta: &DistanceMeta, context: &Context) -> Vec<String> {
    let (before, after) = (result.parts_before, result.parts_after);
    let mut failed = Vec::new();
    if (before.components, before.cavities) != (after.components, after.cavities) {
        let difference = format!(
            "components and cavities: {} and {} in the input, {} and {} in F",
            before.components, before.cavities, after.components, after.cavities
        );
        if result.changed.is_some() {
            failed.push(difference);
        } else {
            let advice = if meta.is_scaled() {
                "lower SCALE (--scale) or set DISTFIELD_OPTIONS=\"--keep-thin\""
            } else {
                "smooth the volume or choose another ISO (--iso)"
            };
            context.warn(format!(
                "{difference}: F cuts necks or closes gaps that are thinner than a voxel; if they matter, {advice}"
            ));
        }
    }
    if let Some(changed) = result.changed.filter(|&changed| changed > 0) {
        failed.push(format!("{changed} voxel centres changed sides"));
    }
    failed
}

/// Compares the change in volume with its limits. Returns the message of the failed check if the
/// change exceeds the second limit. Prints a warning if it exceeds only the first, or if
/// the user accepts a change by a scale.
pub(crate) fn check_volume(
    result: &Redistanced,
    meta: &DistanceMeta,
    accepts_losses: bool,
    context: &Context,
) -> Option<String> {
    let change = volume_change(result, meta)?;
    let (limits, reason) = if meta.is_scaled() {
        (
            SCALED_VOLUME_LIMITS,
            "too much of the object is thinner than a mesh of that scale tells apart (a finer mesh or --keep-thin keeps \
             more; --accept-losses accepts it)",
        )
    } else {
        (VOLUME_LIMITS, "much of it is one voxel thick or less, or specks (--keep drops them)")
    };
    let told = format!("the volume changed by {:+.0} %: {reason}", 100.0 * change);
    if change.abs() > limits.1 && meta.is_scaled() && accepts_losses {
        context.warn(format!("{FIT_BUT_FOR}a volume that the scale changed by {:+.0} %", 100.0 * change));
    } else if change.abs() > limits.1 {
        return Some(told);
    } else if change.abs() > limits.0 {
        context.warn(told);
    }
    None
}
