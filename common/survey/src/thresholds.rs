//! Proposes iso values for a scan: the thresholds of Otsu (1979) and, for scans in Hounsfield
//! units, textbook values.

use crate::Inside;
use crate::survey::{Histogram, Survey};
use serde::Serialize;

/// A proposed iso value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IsoValue {
    /// The value.
    pub iso: f64,
    /// The side of the iso value on which the object lies.
    #[serde(serialize_with = "side")]
    pub inside: Inside,
    /// Reason for the proposal, in words.
    pub why: String,
}

fn side<S: serde::Serializer>(inside: &Inside, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(match inside {
        Inside::Above => "above",
        Inside::Below => "below",
    })
}

/// Upper bound of the minimum value of a scan in Hounsfield units. Air is at -1000 by definition;
/// the margin allows for noise and for voxels that are only partly air.
const AIR: f64 = -800.0;

/// Lower bound of the maximum value of a scan in Hounsfield units: the iso value of bone in
/// [`LEVELS`].
const BONE: f64 = 200.0;

/// Range of values in CT scans, rounded outwards to hundreds. Padding can be as low as -3024 (GE:
/// -2000, 3D Slicer: -3024), air is at -1024 or above, and metal reaches 3071 in 12-bit scans. The
/// minimum of a scan in Hounsfield units lies in this range.
const SCANNER_RANGE: [f64; 2] = [-3100.0, 3100.0];

/// Minimum fraction of the voxels of a scan in Hounsfield units with values in [`SCANNER_RANGE`]. A
/// few metal voxels can exceed the range. In the histograms of
/// `isoparticles-volume info VOLUME --json -`, the fraction is 0.99994 for `heart_ct` and 1 for
/// `thorax_ct`.
const LEAST_SHARE_IN_RANGE: f64 = 0.99;

/// Iso values for CT: textbook values halfway between the tissues that they separate.
const LEVELS: [(f64, Inside, &str); 4] = [
    (200.0, Inside::Above, "Hounsfield: bone, and blood with contrast agent"),
    (-300.0, Inside::Above, "Hounsfield: the body, to its skin"),
    (-500.0, Inside::Below, "Hounsfield: lungs, and all other air"),
    (700.0, Inside::Above, "Hounsfield: compact bone and teeth"),
];

/// Maximum fraction of the voxels that a bin of the histogram may contain. A fuller bin is treated
/// as padding or saturation, and Otsu's thresholds ignore it. According to
/// `isoparticles-volume info VOLUME --json -`, the fullest bin contains 0.05 to 0.10 of the voxels
/// in `heart_ct`, `trabecular_bone` and `tooth_ct`, but 0.55 in `thorax_ct`, whose background is
/// constant. The limit is about the geometric mean of 0.10 and 0.55.
const PADDING_SHARE: f64 = 0.25;

/// Returns whether the values look like Hounsfield units.
pub fn is_hounsfield(survey: &Survey) -> bool {
    let Some([low, high]) = survey.range else { return false };
    let Histogram { counts, .. } = &survey.histogram;
    let total: usize = counts.iter().sum();
    let within: usize = (0..counts.len())
        .filter(|&n| (SCANNER_RANGE[0]..=SCANNER_RANGE[1]).contains(&survey.histogram.middle(n)))
        .map(|n| counts[n])
        .sum();
    low < AIR && high > BONE && low >= SCANNER_RANGE[0] && within as f64 >= LEAST_SHARE_IN_RANGE * total as f64
}

/// Returns the iso values proposed for a scan. Omits a value that differs from an earlier one by at
/// most 1 % of the range of the scan.
pub fn iso_values(survey: &Survey) -> Vec<IsoValue> {
    let Some([low, high]) = survey.range.filter(|[low, high]| low < high) else { return Vec::new() };
    let mut found: Vec<IsoValue> = Vec::new();
    let mut add = |iso: f64, inside: Inside, why: String| {
        let is_new = found.iter().all(|other: &IsoValue| (other.iso - iso).abs() > 0.01 * (high - low));
        if low < iso && iso < high && is_new {
            found.push(IsoValue { iso, inside, why });
        }
    };
    if is_hounsfield(survey) {
        LEVELS.iter().for_each(|&(iso, inside, why)| add(iso, inside, why.to_owned()));
    }
    let (histogram, padding) = survey.histogram.without_padding();
    let but = padding.map_or_else(String::new, |value| format!(", but for the padding near {value:.6}"));
    if let Some(one) = otsu(&histogram) {
        add(histogram.round(one), Inside::Above, format!("Otsu's threshold between two classes{but}"));
    }
    if let Some(two) = otsu_two(&histogram) {
        for (iso, which) in two.into_iter().zip(["lower", "upper"]) {
            let why = format!("{which} of two Otsu thresholds{but}");
            add(histogram.round(iso), Inside::Above, why);
        }
    }
    found
}

impl Histogram {
    /// Returns the centre of a bin.
    pub fn middle(&self, bin: usize) -> f64 {
        self.low + (bin as f64 + 0.5) * self.width
    }

    /// Returns the lower bound of a bin, rounded to the leading decimal place of the bin width.
    fn round(&self, bin: usize) -> f64 {
        let unit = 10f64.powf(self.width.log10().floor());
        ((self.low + bin as f64 * self.width) / unit).round() * unit
    }

    /// Returns the histogram without the padding bin, and the lower bound of that bin. The lower
    /// bound is `None` if there is no padding.
    fn without_padding(&self) -> (Self, Option<f64>) {
        let total: usize = self.counts.iter().sum();
        let padding = (0..self.counts.len())
            .max_by_key(|&n| self.counts[n])
            .filter(|&n| self.counts[n] as f64 > PADDING_SHARE * total as f64);
        let mut rest = self.clone();
        if let Some(bin) = padding {
            rest.counts[bin] = 0;
        }
        (rest, padding.map(|bin| self.low + bin as f64 * self.width))
    }

    /// Returns, for each bin, the number of values in all lower bins and the sum of the bin indices
    /// of these values.
    fn sums(&self) -> Vec<[f64; 2]> {
        let mut sums = vec![[0.0, 0.0]];
        for (n, &count) in self.counts.iter().enumerate() {
            let [all, sum] = sums[n];
            sums.push([all + count as f64, sum + count as f64 * n as f64]);
        }
        sums
    }
}

/// Returns the squared sum of the bin indices of the values in the bins `a..b`, divided by the
/// number of these values. Summed over all classes, this is the between-class variance up to
/// constants (Otsu 1979).
fn weight(sums: &[[f64; 2]], a: usize, b: usize) -> f64 {
    let (count, sum) = (sums[b][0] - sums[a][0], sums[b][1] - sums[a][1]);
    if count > 0.0 { sum * sum / count } else { f64::NEG_INFINITY }
}

/// Splits the histogram into two classes by Otsu's method and returns the first bin of the upper
/// class. If empty bins separate the classes, returns the middle of the gap.
fn otsu(histogram: &Histogram) -> Option<usize> {
    let sums = histogram.sums();
    let end = histogram.counts.len();
    let of = |bin: usize| weight(&sums, 0, bin) + weight(&sums, bin, end);
    best((1..end).map(|bin| (bin, of(bin))))
}

/// Splits the histogram into three classes and returns the first bins of the middle and upper
/// classes.
fn otsu_two(histogram: &Histogram) -> Option<[usize; 2]> {
    let sums = histogram.sums();
    let end = histogram.counts.len();
    let of = |a: usize, b: usize| weight(&sums, 0, a) + weight(&sums, a, b) + weight(&sums, b, end);
    let upper = |a: usize| best((a + 1..end).map(|b| (b, of(a, b))));
    let lower = best((1..end).filter_map(|a| upper(a).map(|b| (a, of(a, b)))))?;
    Some([lower, upper(lower)?])
}

/// Returns the position of the maximum value. If several positions share the maximum, as with empty
/// bins, returns the midpoint of the first and the last.
fn best(values: impl Iterator<Item = (usize, f64)>) -> Option<usize> {
    let mut found: Option<(usize, usize, f64)> = None;
    for (place, value) in values.filter(|(_, value)| value.is_finite()) {
        found = match found {
            Some((first, _, most)) if value == most => Some((first, place, most)),
            Some((first, last, most)) if value < most => Some((first, last, most)),
            _ => Some((place, place, value)),
        };
    }
    found.map(|(first, last, _)| (first + last) / 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_volume::{Geometry, Voxels};

    fn surveyed(values: Vec<i16>) -> Survey {
        let geometry = Geometry::axis_aligned([values.len() / 4, 2, 2], DVec3::ONE);
        Survey::of(&Voxels::I16(values), &geometry)
    }

    #[test]
    fn modes_are_parted_and_padding_is_left_out() {
        // padding, and peaks around 40, 120 and 200
        let values: Vec<i16> = (0..4000)
            .map(|n| if n % 2 == 0 { 0 } else { [40, 120, 200][n / 2 % 3] + (n as i16 / 6 * 7) % 11 - 5 })
            .collect();
        let found = iso_values(&surveyed(values));
        let near = |low: f64, high: f64| found.iter().any(|value| (low..high).contains(&value.iso));
        assert!(near(60.0, 100.0) && near(140.0, 180.0), "{found:?}");
        assert!(found.iter().all(|value| value.why.contains("padding near 0")), "{found:?}");
    }

    #[test]
    fn hounsfield_units_are_known_by_their_range() {
        let ct = |first: i16| (0..4000).map(|n| first + (n % 1500)).collect::<Vec<i16>>();
        let found = iso_values(&surveyed(ct(-1000)));
        assert_eq!((found[0].iso, found[2].iso, found[2].inside), (200.0, -500.0, Inside::Below), "{found:?}");
        assert!(!is_hounsfield(&surveyed(ct(0))));
        assert!(!is_hounsfield(&surveyed(ct(-9000))));
        assert!(iso_values(&surveyed(vec![7; 400])).is_empty());
    }
}
