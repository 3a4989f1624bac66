//! Statistics of all voxels of a volume: range, number of voxels of each value, histogram, and
//! changes of value along the axes.

use isoparticles_volume::{Geometry, Voxels};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::HashMap;

/// Maximum number of distinct integers that are counted individually: the number of 16-bit values.
/// A table of this size takes 512 KiB per task. If there are more values, only the histogram is
/// computed.
const MOST_DISTINCT: usize = 1 << 16;

/// Maximum number of bins of the histogram: one for each 8-bit value.
const MOST_BINS: usize = 256;

/// Number of voxels per task. Counting this many voxels takes much longer than merging the table of
/// the task, which has at most [`MOST_DISTINCT`] entries.
const CHUNK: usize = 1 << 20;

/// Range in which the fraction of double jumps (`double_jumps / jumps`) does not distinguish scans
/// from label maps. A lower fraction indicates a label map, and a higher one a scan. Among the
/// shared volumes, the fraction is at most 0.28 for label maps (`brain_parcellation`) and at least
/// 0.91 for scans (`thorax_ct_native_u8`). It is 0.30 to 0.83 for scans quantized to 8 to 64
/// levels. The fractions were measured with `isoparticles-volume info VOLUME --json -`.
pub const UNCLEAR: std::ops::Range<f64> = 0.29..0.75;

/// Statistics of the voxels.
#[derive(Clone, Debug, Serialize)]
pub struct Survey {
    /// Minimum and maximum of the finite values; `None` if no value is finite.
    pub range: Option<[f64; 2]>,
    /// Number of NaN and infinite values.
    pub non_finite: usize,
    /// Number of NaN values.
    pub nan: usize,
    /// Number of finite values that are not integers.
    pub fractions: usize,
    /// All values except NaN in ascending order, each with its number of voxels. `None` if a value
    /// is fractional or infinite, if all values are NaN, or if there are too many distinct values.
    #[serde(skip)]
    pub values: Option<Vec<(i64, usize)>>,
    /// Number of jumps. A jump is a triple of consecutive voxels along an axis whose last two
    /// values differ.
    pub jumps: usize,
    /// Number of double jumps. A double jump is a jump whose first two values also differ.
    pub double_jumps: usize,
    /// Number of steps. A step is a jump between two values such that no voxel has a value between
    /// them. Steps are counted only if the fraction of double jumps is in [`UNCLEAR`]; otherwise,
    /// this is 0.
    pub steps: usize,
    /// Histogram of the finite values.
    pub histogram: Histogram,
}

/// A histogram of the voxel values, with bins of equal width.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Histogram {
    /// Lower bound of the first bin.
    pub low: f64,
    /// Width of a bin; 1 for integers with a range below 256.
    pub width: f64,
    /// Number of voxels in each bin.
    pub counts: Vec<usize>,
}

impl Survey {
    /// Computes the statistics of a volume's voxels.
    pub fn of(voxels: &Voxels, geometry: &Geometry) -> Self {
        macro_rules! each {
            ($($variant:ident),*) => { match voxels { $(Voxels::$variant(values) => survey(values, geometry.size),)* } };
        }
        each!(I8, U8, I16, U16, I32, U32, I64, U64, F32, F64)
    }

    /// Returns the number of distinct values, if they were counted. NaN counts as 0, the background
    /// of label maps.
    pub fn distinct(&self) -> Option<usize> {
        let values = self.values.as_ref()?;
        let has_zero = self.nan == 0 || values.iter().any(|(value, _)| *value == 0);
        Some(values.len() + usize::from(!has_zero))
    }

    /// Returns the fraction of jumps that are double jumps. It is near 1 if every voxel differs
    /// from its neighbours, and near 0 for regions of constant value.
    pub fn double_share(&self) -> f64 {
        self.double_jumps as f64 / self.jumps.max(1) as f64
    }

    /// Returns the fraction of jumps that are steps. It is near 1 for a scan with few grey levels.
    pub fn step_share(&self) -> f64 {
        self.steps as f64 / self.jumps.max(1) as f64
    }
}

/// A voxel value.
trait Cell: Copy + Send + Sync {
    /// Returns whether two values are equal. NaN equals NaN.
    fn same(self, other: Self) -> bool;
    /// Returns the value as f64. Integers beyond 2^53 are rounded.
    fn double(self) -> f64;
    /// Returns the value as an integer, or `None` if it is not an integer or does not fit into
    /// `i64`.
    fn whole(self) -> Option<i64>;
}

macro_rules! whole_cell {
    ($($type:ty),*) => {$(impl Cell for $type {
        fn same(self, other: Self) -> bool {
            self == other
        }
        fn double(self) -> f64 {
            self as f64
        }
        fn whole(self) -> Option<i64> {
            i64::try_from(self).ok()
        }
    })*};
}
whole_cell!(i8, u8, i16, u16, i32, u32, i64, u64);

macro_rules! float_cell {
    ($($type:ty),*) => {$(impl Cell for $type {
        fn same(self, other: Self) -> bool {
            self == other || (self.is_nan() && other.is_nan())
        }
        fn double(self) -> f64 {
            self.into()
        }
        fn whole(self) -> Option<i64> {
            let value = f64::from(self);
            // f64 cannot represent every integer beyond 2^53
            (value.fract() == 0.0 && value.abs() <= 9_007_199_254_740_992.0).then_some(value as i64)
        }
    })*};
}
float_cell!(f32, f64);

/// Statistics of one slice, or of several slices combined.
#[derive(Clone, Copy)]
struct Slice {
    low: f64,
    high: f64,
    non_finite: usize,
    nan: usize,
    fractions: usize,
    jumps: usize,
    double_jumps: usize,
}

impl Slice {
    const NOTHING: Self = Self {
        low: f64::INFINITY,
        high: f64::NEG_INFINITY,
        non_finite: 0,
        nan: 0,
        fractions: 0,
        jumps: 0,
        double_jumps: 0,
    };

    fn and(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            non_finite: self.non_finite + other.non_finite,
            nan: self.nan + other.nan,
            fractions: self.fractions + other.fractions,
            jumps: self.jumps + other.jumps,
            double_jumps: self.double_jumps + other.double_jumps,
        }
    }

    fn count_values<T: Cell>(&mut self, values: &[T]) {
        for &value in values {
            let double = value.double();
            if double.is_finite() {
                self.low = self.low.min(double);
                self.high = self.high.max(double);
                self.fractions += usize::from(double.fract() != 0.0);
            } else {
                self.non_finite += 1;
                self.nan += usize::from(double.is_nan());
            }
        }
    }

    fn count_jumps<T: Cell>(&mut self, a: &[T], b: &[T], c: &[T]) {
        let (mut jumps, mut doubles) = (0u32, 0u32);
        for ((a, b), c) in a.iter().zip(b).zip(c) {
            let (first, second) = (u32::from(!a.same(*b)), u32::from(!b.same(*c)));
            jumps += second;
            doubles += first & second;
        }
        self.jumps += jumps as usize;
        self.double_jumps += doubles as usize;
    }
}

fn survey<T: Cell>(values: &[T], size: [usize; 3]) -> Survey {
    let [nx, ny, nz] = size;
    let count_slice = |k: usize| {
        let mut slice = Slice::NOTHING;
        slice.count_values(&values[k * nx * ny..][..nx * ny]);
        each_triple(values, size, k, |a, b, c| slice.count_jumps(a, b, c));
        slice
    };
    let whole = (0..nz).into_par_iter().map(count_slice).reduce(|| Slice::NOTHING, Slice::and);
    let is_unclear = UNCLEAR.contains(&(whole.double_jumps as f64 / whole.jumps.max(1) as f64));
    let range = (whole.low <= whole.high).then_some([whole.low, whole.high]);
    let is_whole = whole.fractions == 0 && whole.non_finite == whole.nan;
    let counted = range.filter(|_| is_whole).and_then(|range| count_whole(values, range));
    Survey {
        range,
        non_finite: whole.non_finite,
        nan: whole.nan,
        fractions: whole.fractions,
        jumps: whole.jumps,
        double_jumps: whole.double_jumps,
        steps: counted.as_deref().filter(|_| is_unclear).map_or(0, |counted| steps(values, size, counted)),
        histogram: range.map_or_else(Histogram::default, |range| histogram(values, range, counted.as_deref())),
        values: counted,
    }
}

/// Visits all triples of consecutive voxels along an axis whose last voxel is in slice `k`. `visit`
/// receives the rows of the first, second and third voxels.
fn each_triple<T>(values: &[T], [nx, ny, _]: [usize; 3], k: usize, mut visit: impl FnMut(&[T], &[T], &[T])) {
    let row = |j: usize, k: usize| &values[(k * ny + j) * nx..][..nx];
    for j in 0..ny {
        let own = row(j, k);
        if nx > 2 {
            visit(own, &own[1..], &own[2..]);
        }
        if j > 1 {
            visit(row(j - 2, k), row(j - 1, k), own);
        }
        if k > 1 {
            visit(row(j, k - 2), row(j, k - 1), own);
        }
    }
}

/// Counts the triples whose second and third values are consecutive in `counted`.
fn steps<T: Cell>(values: &[T], size: [usize; 3], counted: &[(i64, usize)]) -> usize {
    let rank =
        |value: T| value.whole().and_then(|value| counted.binary_search_by_key(&value, |(value, _)| *value).ok());
    let is_step = |b: T, c: T| rank(b).zip(rank(c)).is_some_and(|(b, c)| b.abs_diff(c) == 1);
    let of_slice = |k: usize| {
        let mut count = 0;
        each_triple(values, size, k, |_, b, c| {
            count += b.iter().zip(c).filter(|(b, c)| !b.same(**c) && is_step(**b, **c)).count();
        });
        count
    };
    (0..size[2]).into_par_iter().map(of_slice).sum()
}

/// Counts the voxels of each value if all values are integers or NaN. Returns `None` if there are
/// too many distinct values.
fn count_whole<T: Cell>(values: &[T], [low, high]: [f64; 2]) -> Option<Vec<(i64, usize)>> {
    if high - low < MOST_DISTINCT as f64 {
        let first = low as i64;
        let size = (high - low) as usize + 1;
        let count = |chunk: &[T]| {
            let mut counts = vec![0usize; size];
            chunk.iter().filter_map(|value| value.whole()).for_each(|value| counts[(value - first) as usize] += 1);
            counts
        };
        let add = |mut a: Vec<usize>, b: Vec<usize>| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
            a
        };
        let counts = values.par_chunks(CHUNK).map(count).reduce(|| vec![0; size], add);
        let found = (first..).zip(counts).filter(|(_, count)| *count > 0);
        return Some(found.collect());
    }
    let few = |counts: HashMap<i64, usize>| (counts.len() <= MOST_DISTINCT).then_some(counts);
    let count = |chunk: &[T]| {
        let mut counts = HashMap::new();
        for value in chunk.iter().filter(|value| !value.double().is_nan()) {
            *counts.entry(value.whole()?).or_insert(0) += 1;
            if counts.len() > MOST_DISTINCT {
                return None;
            }
        }
        few(counts)
    };
    let add = |mut a: HashMap<i64, usize>, b: HashMap<i64, usize>| {
        b.into_iter().for_each(|(value, count)| *a.entry(value).or_insert(0) += count);
        few(a)
    };
    let counts = values.par_chunks(CHUNK).map(count).try_reduce_with(add).flatten()?;
    let mut sorted: Vec<(i64, usize)> = counts.into_iter().collect();
    sorted.sort_unstable();
    Some(sorted)
}

fn histogram<T: Cell>(values: &[T], [low, high]: [f64; 2], counted: Option<&[(i64, usize)]>) -> Histogram {
    let narrow = counted.is_some() && high - low < MOST_BINS as f64;
    let bins = if narrow { (high - low) as usize + 1 } else { MOST_BINS };
    // if every integer has its own bin, the bin width is 1
    let width = if narrow { 1.0 } else { ((high - low) / bins as f64).max(f64::MIN_POSITIVE) };
    let bin = |value: f64| (((value - low) / width) as usize).min(bins - 1);
    let counts = match counted {
        Some(counted) => {
            let mut counts = vec![0; bins];
            counted.iter().for_each(|&(value, count)| counts[bin(value as f64)] += count);
            counts
        }
        None => {
            let count = |chunk: &[T]| {
                let mut counts = vec![0usize; bins];
                let finite = chunk.iter().map(|value| value.double()).filter(|value| value.is_finite());
                finite.for_each(|value| counts[bin(value)] += 1);
                counts
            };
            values.par_chunks(CHUNK).map(count).reduce(
                || vec![0; bins],
                |mut a, b| {
                    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
                    a
                },
            )
        }
    };
    Histogram { low, width, counts }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn values_are_counted_whatever_their_type() {
        let geometry = Geometry::axis_aligned([4, 3, 2], DVec3::ONE);
        let numbers: Vec<i64> = (0..24).map(|n| [7, -3, 7, 1_000_000][n % 4]).collect();
        for voxels in [
            Voxels::I64(numbers.clone()),
            Voxels::I32(numbers.iter().map(|&n| n as i32).collect()),
            Voxels::F64(numbers.iter().map(|&n| n as f64).collect()),
        ] {
            let survey = Survey::of(&voxels, &geometry);
            assert_eq!(survey.range, Some([-3.0, 1e6]));
            assert_eq!(survey.values, Some(vec![(-3, 6), (7, 12), (1_000_000, 6)]));
            assert_eq!(survey.histogram.counts.iter().sum::<usize>(), 24);
            // each voxel differs from the next along x (two triples per row), but not along y and z
            assert_eq!((survey.jumps, survey.double_jumps, survey.steps), (12, 12, 0));
        }
        let narrow = Survey::of(&Voxels::I8(numbers.iter().map(|&n| n.min(9) as i8).collect()), &geometry);
        assert_eq!(narrow.histogram.counts.len(), 13);
        assert_eq!(narrow.histogram.counts[10], 12, "{:?}", narrow.histogram);
    }

    #[test]
    fn steps_go_to_the_next_value_that_occurs() {
        let counted = [(0, 3), (62, 2), (125, 2)];
        for (row, expected) in
            [([0, 0, 62, 62, 125, 125, 125], 2), ([0, 0, 125, 125, 62, 62, 62], 1), ([0, 0, 62, 125, 125, 0, 62], 3)]
        {
            assert_eq!(steps(&row, [7, 1, 1], &counted), expected, "{row:?}");
        }
    }

    #[test]
    fn what_is_no_whole_number_is_counted_but_not_listed() {
        let geometry = Geometry::axis_aligned([2, 2, 2], DVec3::ONE);
        let survey = Survey::of(&Voxels::F32(vec![0.5, 1.0, 2.0, f32::NAN, 1.0, 1.0, f32::INFINITY, 3.5]), &geometry);
        assert_eq!((survey.fractions, survey.non_finite, survey.distinct()), (2, 2, None));
        assert_eq!(survey.range, Some([0.5, 3.5]));
        assert_eq!(survey.histogram.counts.iter().sum::<usize>(), 6);
        let none = Survey::of(&Voxels::F32(vec![f32::NAN; 8]), &geometry);
        assert_eq!((none.range, none.non_finite, none.nan), (None, 8, 8));
    }
}
