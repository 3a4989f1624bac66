//! Determines whether a volume is a scan or a label map.
//!
//! A label map consists of regions of constant value, so the value rarely changes twice in a row
//! along an axis. In a scan, noise and blurred edges make the value differ from voxel to voxel,
//! even if large parts are saturated or padded. The number of distinct values is a weaker
//! criterion: an 8-bit scan has up to 256, and a parcellation can have more. A scan with few grey
//! levels also has regions of constant value, but neighbouring regions have consecutive levels.

use crate::survey::{Survey, UNCLEAR};
use serde::Serialize;

/// Meaning of a volume's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Measured values, which can be interpolated.
    Scan,
    /// A label map: each value is the number of a material.
    Labels,
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Scan => "scan",
            Self::Labels => "labels",
        })
    }
}

/// Possible values of the option `--kind`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum KindChoice {
    /// Detect the kind from the voxel values.
    Auto,
    /// Scan: measured values.
    Scan,
    /// Label map: each value is the number of a material.
    Labels,
}

impl KindChoice {
    /// Returns the kind that the user specified, or `None` for `auto`.
    #[must_use]
    pub fn given(self) -> Option<Kind> {
        match self {
            Self::Auto => None,
            Self::Scan => Some(Kind::Scan),
            Self::Labels => Some(Kind::Labels),
        }
    }
}

/// The kind of a volume, whether it is certain, and the reason.
#[derive(Clone, Debug, Serialize)]
pub struct Judgement {
    /// The kind: scan or labels.
    pub kind: Kind,
    /// Whether the kind is certain enough to reject options that apply only to the other kind.
    pub certain: bool,
    /// Reason for the decision, in words.
    pub reason: String,
}

/// Minimum fraction of jumps that are steps (`steps / jumps`) in a scan with few grey levels, where
/// neighbouring regions have consecutive levels. The fraction is at least 0.54 for scans quantized
/// to 8 to 128 levels, and at most 0.3 for label maps with more than 8 labels
/// (`isoparticles-volume info VOLUME --json -`).
const STEPS_ABOVE: f64 = 0.5;

/// Minimum number of distinct values for the test with [`STEPS_ABOVE`]. Label maps with fewer
/// values can pass that test: two of the three pairs of three labels are consecutive, and nested
/// layers are often numbered in order.
const FEWEST_LEVELS: usize = 8;

/// Maximum number of distinct values in a volume that is certainly a label map. The finest brain
/// atlases have a few hundred labels. A volume with more values, in regions of constant value, may
/// be a scan that was upsampled by repeating voxels.
const MOST_CERTAIN_LABELS: usize = 1000;

/// Minimum number of jumps for the kind to be certain. The fraction of double jumps among 100
/// independent jumps has a standard deviation of at most sqrt(0.25 / 100) = 0.05. The range
/// [`UNCLEAR`] is nine times as wide.
const FEWEST_JUMPS: usize = 100;

/// Determines the kind of a volume. `named` is the number of labels with a name in the file. A file
/// with named labels is a label map.
pub fn judge(survey: &Survey, named: usize) -> Judgement {
    let is = |kind, certain, reason: String| Judgement { kind, certain, reason };
    if named > 0 {
        return is(Kind::Labels, true, format!("the file names {named} of its values"));
    }
    if survey.fractions > 0 {
        return is(Kind::Scan, true, format!("{} voxels hold values that are not whole numbers", survey.fractions));
    }
    if survey.non_finite > survey.nan {
        return is(Kind::Scan, true, format!("{} voxels are infinite", survey.non_finite - survey.nan));
    }
    match survey.distinct() {
        Some(1) => return is(Kind::Labels, false, "every voxel has the same value".into()),
        Some(2) => return is(Kind::Labels, true, "it is a mask: its voxels have one of two values".into()),
        _ => {}
    }
    let share = survey.double_share();
    let values = match survey.distinct() {
        Some(distinct) => format!("{distinct} distinct whole numbers"),
        None => "very many distinct whole numbers".to_owned(),
    };
    let is_enough = survey.jumps >= FEWEST_JUMPS;
    let is_clear = is_enough && !UNCLEAR.contains(&share);
    let are_levels = survey.distinct().is_some_and(|distinct| distinct >= FEWEST_LEVELS);
    if share >= UNCLEAR.end {
        let reason = format!("{values}; neighbouring values change gradually, as in a scan");
        is(Kind::Scan, is_clear, reason)
    } else if share >= UNCLEAR.start && are_levels && survey.step_share() > STEPS_ABOVE {
        let steps = 100.0 * survey.step_share();
        let reason = format!("{values} in levels: {steps:.0} % of the changes between neighbours go to the next value");
        is(Kind::Scan, false, reason)
    } else {
        let reason = format!("{values} in regions of one value each, as in a label map");
        is(Kind::Labels, is_clear && survey.distinct().is_some_and(|distinct| distinct <= MOST_CERTAIN_LABELS), reason)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_field::random::uniform;
    use isoparticles_volume::{Geometry, Image, Voxels};

    const SIZE: [usize; 3] = [48, 44, 40];

    fn judged(value: impl Fn(DVec3, u64) -> i16) -> Judgement {
        let geometry = Geometry::axis_aligned(SIZE, DVec3::ONE);
        let counter = std::cell::Cell::new(0);
        let image = Image::sampled(geometry.clone(), |p| {
            counter.set(counter.get() + 1);
            value(p, counter.get())
        });
        judge(&Survey::of(&Voxels::I16(image.data), &geometry), 0)
    }

    /// Returns the distance of `p` from a point near the centre of the volume, in voxels.
    fn radius(p: DVec3) -> f64 {
        p.distance(DVec3::new(23.3, 21.6, 19.8))
    }

    /// Returns the n-th of a sequence of random numbers with mean 0 and standard deviation 1.
    fn noise(n: u64) -> f64 {
        (0..4).map(|stream| uniform(3, stream, n) - 0.5).sum::<f64>() * 3f64.sqrt()
    }

    #[test]
    fn scans_are_scans() {
        let edge = |p: DVec3| 1.0 / (1.0 + ((radius(p) - 14.0) / 0.9).exp());
        let scans: [(&str, Judgement); 6] = [
            ("noise everywhere", judged(|p, n| (400.0 * edge(p) + 20.0 * noise(n)) as i16)),
            ("smooth and saturated at 0 and 200", judged(|p, _| (200.0 * edge(p)).round() as i16)),
            ("eight bits, dark", judged(|p, n| (6.0 * edge(p) + noise(n)).round().clamp(0.0, 255.0) as i16)),
            (
                "padded with -1024 outside a cylinder",
                judged(|p, n| {
                    let is_padding = (p.x - 23.3).hypot(p.y - 21.6) > 19.0;
                    if is_padding { -1024 } else { (-900.0 + 950.0 * edge(p) + 15.0 * noise(n)) as i16 }
                }),
            ),
            ("clipped at 0, half of it", judged(|p, n| (30.0 * noise(n) + 300.0 * (edge(p) - 0.1)).max(0.0) as i16)),
            ("a ramp", judged(|p, _| (3.0 * p.x + 2.0 * p.y + p.z) as i16)),
        ];
        for (name, judgement) in scans {
            assert_eq!(judgement.kind, Kind::Scan, "{name}: {judgement:?}");
            // with about ten distinct values and most voxels clipped to 0, the kind is uncertain
            assert!(judgement.certain || name == "eight bits, dark", "{name}: {judgement:?}");
        }
    }

    #[test]
    fn a_scan_in_few_levels_is_a_scan() {
        let edge = |p: DVec3| 1.0 / (1.0 + ((radius(p) - 14.0) / 3.0).exp());
        // levels 62.5 apart, truncated to integers
        let levels = |count: f64, spread: f64| {
            judged(move |p, n| {
                let value = (edge(p) + spread * noise(n)).clamp(0.0, 1.0);
                ((value * (count - 1.0)).round() * 62.5) as i16
            })
        };
        for (count, spread) in [(33.0, 0.03), (33.0, 0.015), (16.0, 0.04), (64.0, 0.01)] {
            let judgement = levels(count, spread);
            assert_eq!(judgement.kind, Kind::Scan, "{count} levels, noise {spread}: {judgement:?}");
        }
        let nested = judged(|p, _| [0, 1, 2, 2, 3, 3, 3, 4][(radius(p) / 1.01) as usize % 8]);
        assert_eq!(nested.kind, Kind::Labels, "{nested:?}");
    }

    #[test]
    fn labels_are_labels() {
        let labels: [(&str, Judgement); 6] = [
            ("a mask of 0 and 255", judged(|p, _| if radius(p) < 14.0 { 255 } else { 0 })),
            ("a mask of noise", judged(|_, n| i16::from(noise(n) > 0.0))),
            ("shells", judged(|p, _| (radius(p) / 3.0) as i16)),
            (
                "two hundred blocks",
                judged(|p, _| {
                    let [x, y, z] = (p / 7.0).to_array().map(|n| n as i16);
                    (37 * (x + 7 * (y + 7 * z))) % 211
                }),
            ),
            (
                "one voxel thick in places",
                judged(|p, _| {
                    let sheet = p.x as i16 % 6 == 3;
                    if sheet { 9 } else { (p.y / 5.0) as i16 }
                }),
            ),
            ("with specks", judged(|p, n| if uniform(5, 0, n) < 0.01 { 17 } else { 2 * i16::from(radius(p) < 14.0) })),
        ];
        for (name, judgement) in labels {
            assert_eq!(judgement.kind, Kind::Labels, "{name}: {judgement:?}");
            // layers and specks one voxel thick can make the kind uncertain, but not wrong
            assert!(judgement.certain || name.contains("thick") || name.contains("specks"), "{name}: {judgement:?}");
        }
    }

    #[test]
    fn what_the_file_says_and_values_that_are_not_whole_decide() {
        let geometry = Geometry::axis_aligned([8, 8, 8], DVec3::ONE);
        let of = |values: Vec<f32>| Survey::of(&Voxels::F32(values), &geometry);
        let ramp = of((0..512).map(|n| n as f32).collect());
        assert_eq!(judge(&ramp, 0).kind, Kind::Scan);
        assert_eq!(judge(&ramp, 3).kind, Kind::Labels);
        let mut mask: Vec<f32> = (0..512).map(|n| f32::from(n > 200)).collect();
        assert_eq!(judge(&of(mask.clone()), 0).kind, Kind::Labels);
        // a blurred mask has fractional values
        mask[200] = 0.25;
        assert_eq!(judge(&of(mask), 0).kind, Kind::Scan);
        assert!(!judge(&of(vec![7.0; 512]), 0).certain);
    }

    #[test]
    fn nan_is_background_of_labels_and_padding_of_scans() {
        let geometry = Geometry::axis_aligned(SIZE, DVec3::ONE);
        let with = |value: fn(f64, u64) -> f32| {
            let counter = std::cell::Cell::new(0);
            let image = Image::sampled(geometry.clone(), |p| {
                counter.set(counter.get() + 1);
                value(radius(p), counter.get())
            });
            judge(&Survey::of(&Voxels::F32(image.data), &geometry), 0)
        };
        let mask = with(|r, _| if r < 14.0 { 1.0 } else { f32::NAN });
        assert!(mask.kind == Kind::Labels && mask.certain && mask.reason.contains("mask"), "{mask:?}");
        let labels = with(|r, _| {
            if r < 9.0 {
                1.0
            } else if r < 14.0 {
                2.0
            } else {
                f32::NAN
            }
        });
        assert!(labels.kind == Kind::Labels && labels.certain, "{labels:?}");
        let scan = with(|r, n| if r < 14.0 { (900.0 + 20.0 * noise(n)).round() as f32 } else { f32::NAN });
        assert!(scan.kind == Kind::Scan && scan.certain, "{scan:?}");
        assert_eq!(with(|r, _| if r < 14.0 { 1.0 } else { f32::INFINITY }).kind, Kind::Scan);
    }

    /// Interpolating a label map creates values between the labels. [`judge`] must not be certain
    /// that the result is a scan.
    #[test]
    fn blurred_labels_are_not_certainly_anything_else() {
        let blurred = judged(|p, _| (12.0 * (1.0 - ((radius(p) - 13.0) / 1.5).clamp(0.0, 1.0))).round() as i16);
        assert!(blurred.kind == Kind::Labels || !blurred.certain, "{blurred:?}");
    }
}
