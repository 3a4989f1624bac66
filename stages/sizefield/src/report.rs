//! Reports the sizing field of one object: messages, warnings, the closing table and the metadata
//! of the output file.

use crate::feature::Features;
use crate::limits::TooSmall;
use glam::DVec3;
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::cli::Context;
use isoparticles_stage::cli::values::{place, significant};
use isoparticles_stage::meta::{self, SizeMeta};
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use serde_json::{Value, json};

/// Minimum ratio of slice thickness to voxel width at which the message about noise also mentions
/// ripple from thick slices. The constant affects only this message.
const THICK_SLICES: f64 = 1.5;

/// Returns a message about the height of the noise and the fraction of the surface that is noisy.
/// Thick slices leave ripple on a clean surface, which patches cannot distinguish from noise. The
/// message mentions both noise and ripple if `spacing` (mm) indicates such slices.
pub(crate) fn noise_told(noise: &[f64], spacing: DVec3) -> Option<String> {
    let found: Vec<f64> = noise.iter().copied().filter(|&noise| noise > 0.0).collect();
    if found.is_empty() {
        return None;
    }
    let mean = (found.iter().map(|noise| noise * noise).sum::<f64>() / found.len() as f64).sqrt();
    let thickness = spacing.max_element() / spacing.min_element();
    let what = if thickness < THICK_SLICES {
        "noise".to_owned()
    } else {
        format!("noise, or ripple from slices {thickness:.1} times as thick as the voxels are wide,")
    };
    Some(format!(
        "{what} of {} mm (root mean square) on {:.1} % of the surface does not affect h",
        significant(mean),
        100.0 * found.len() as f64 / noise.len() as f64
    ))
}

/// Adds statistics of the field to the report and to the closing table. Returns the metadata of the
/// output file.
pub(crate) fn describe(
    features: &Features,
    sizing: &SizingField,
    predicted: f64,
    (largest, small): (f64, &[TooSmall]),
    context: &Context,
) -> SizeMeta {
    let mut at_surface: Vec<f64> = features.points.par_iter().map(|&p| sizing.at(p)).collect();
    let mut feature_size = features.feature_size.clone();
    let notes = [
        ("size_at_surface", percentiles(&mut at_surface)),
        ("local_feature_size", percentiles(&mut feature_size)),
        ("noise", percentiles(&mut features.noise.clone())),
        ("largest_feature_looked_for", json!(largest)),
        ("too_small", json!(small)),
    ];
    let meta = SizeMeta {
        version: meta::VERSION,
        components: features.component_area.len(),
        predicted_count: Some(predicted.round()),
        notes: notes.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
    };
    context.summary("components", features.component_area.len());
    context.summary("predicted particles", predicted.round());
    context.summary(
        "h at the surface (mm)",
        [at_surface[0], at_surface[at_surface.len() - 1]].map(significant).join(" to "),
    );
    context.report("fields", json!(meta));
    meta
}

/// Returns the minimum, percentiles and maximum by name. Sorts the values in place.
pub(crate) fn percentiles(values: &mut [f64]) -> Value {
    values.par_sort_unstable_by(f64::total_cmp);
    let at = |percent: usize| values[(values.len() - 1) * percent / 100];
    json!({ "min": at(0), "p1": at(1), "p5": at(5), "median": at(50), "p95": at(95), "max": at(100) })
}

/// Warns if a constant h is too coarse for thin parts. The message contains the minimum feature
/// size and its position.
pub(crate) fn warn_if_too_coarse(features: &Features, geometry: &Geometry, size: f64, context: &Context) {
    let coarse = features.feature_size.iter().filter(|&&lfs| size > lfs).count();
    if coarse == 0 {
        return;
    }
    let worst = (0..features.points.len())
        .min_by(|&a, &b| features.feature_size[a].total_cmp(&features.feature_size[b]))
        .unwrap_or(0);
    context.warn(format!(
        "h = {} mm is larger than the local feature size on {:.1} % of the surface (minimum {} mm, at {} mm); \
         thin parts may be lost or merged. Lower SIZE (--uniform) or raise VERTICES (--vertices); without them, h \
         follows the shape",
        significant(size),
        100.0 * coarse as f64 / features.points.len() as f64,
        significant(features.feature_size[worst]),
        place(geometry.grid_to_world(features.points[worst]).to_array()),
    ));
}

#[cfg(test)]
mod tests {
    use super::noise_told;
    use glam::DVec3;

    #[test]
    fn noise_message_names_ripple_only_for_thick_slices() {
        assert_eq!(noise_told(&[0.0; 4], DVec3::ONE), None);
        let told = noise_told(&[0.0, 0.02, 0.02, 0.0], DVec3::new(1.0, 1.0, 1.25)).expect("noise");
        assert!(told.starts_with("noise of 0.02 mm (root mean square)"), "{told}");
        assert!(told.contains("on 50.0 % of the surface"), "{told}");
        let told = noise_told(&[0.0, 0.02, 0.02, 0.0], DVec3::new(0.5, 0.5, 2.0)).expect("ripple or noise");
        assert!(
            told.starts_with("noise, or ripple from slices 4.0 times as thick as the voxels are wide, of 0.02 mm"),
            "{told}"
        );
    }
}
