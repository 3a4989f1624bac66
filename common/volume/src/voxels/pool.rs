//! Reduces a grid of voxels by whole factors: each block of voxels becomes one voxel.

use super::{Number, ScalarType, Voxels};
use rayon::prelude::*;

/// How the voxels of a block are combined into one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pooling {
    /// The mean, for measured values. The result is `F64` for `F64` values and `F32` for all other
    /// types, because rounding would cause steps in the surface. A block with NaN becomes NaN.
    Mean,
    /// The most frequent value, for labels; the smallest of equally frequent values. NaN counts as
    /// 0. The type is unchanged.
    MostFrequent,
}

impl Pooling {
    /// Returns the number of bytes of a result for values of a type.
    pub fn bytes(self, scalar: ScalarType) -> usize {
        match (self, scalar) {
            (Self::MostFrequent, _) | (_, ScalarType::F64) => scalar.bytes(),
            _ => ScalarType::F32.bytes(),
        }
    }
}

/// A division of a grid into blocks. Voxels that do not fill a block are ignored.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Blocks {
    /// Size of the grid.
    pub(crate) grid: [usize; 3],
    /// Voxels of a block along each axis.
    pub(crate) factors: [usize; 3],
}

impl Blocks {
    /// Returns the number of blocks along each axis.
    pub(crate) fn count(&self) -> [usize; 3] {
        std::array::from_fn(|axis| self.grid[axis] / self.factors[axis])
    }

    /// Returns the row segments of voxels that form a row of blocks.
    fn rows<'a, T>(&self, values: &'a [T], row: usize) -> impl Iterator<Item = &'a [T]> {
        let (Self { grid: [nx, ny, _], factors: [_, fy, fz] }, [bx, by, _]) = (*self, self.count());
        let (j, k, length) = (row % by * fy, row / by * fz, bx * self.factors[0]);
        (k..k + fz)
            .flat_map(move |k| (j..j + fy).map(move |j| (k * ny + j) * nx))
            .map(move |at| &values[at..at + length])
    }

    /// Calls `fill` with the number of each row of blocks and its results.
    fn each_row<R: Send + Clone + Default>(&self, fill: impl Fn(usize, &mut [R]) + Sync) -> Vec<R> {
        let mut results = vec![R::default(); self.count().iter().product()];
        results.par_chunks_mut(self.count()[0]).enumerate().for_each(|(row, results)| fill(row, results));
        results
    }

    fn means<T: Number + Sync, R: Send + Clone + Default>(&self, values: &[T], to: impl Fn(f64) -> R + Sync) -> Vec<R> {
        let count = self.factors.iter().product::<usize>() as f64;
        self.each_row(|row, results| {
            let mut sums = vec![0.0; results.len()];
            for voxels in self.rows(values, row) {
                for (sum, part) in sums.iter_mut().zip(voxels.chunks_exact(self.factors[0])) {
                    *sum += part.iter().map(|value| value.double()).sum::<f64>();
                }
            }
            results.iter_mut().zip(sums).for_each(|(result, sum)| *result = to(sum / count));
        })
    }

    fn most_frequent<T: Number + PartialOrd + Default + Send + Sync>(&self, values: &[T]) -> Vec<T> {
        self.each_row(|row, results| {
            let rows: Vec<&[T]> = self.rows(values, row).collect();
            let mut block = Vec::with_capacity(self.factors.iter().product());
            for (b, result) in results.iter_mut().enumerate() {
                let range = b * self.factors[0]..(b + 1) * self.factors[0];
                block.clear();
                rows.iter().for_each(|row| block.extend_from_slice(&row[range.clone()]));
                *result = most_frequent(&mut block);
            }
        })
    }
}

/// Returns the most frequent value of a block, which is not empty. Reorders the block.
fn most_frequent<T: Number + PartialOrd + Default>(block: &mut [T]) -> T {
    let first = block[0];
    if block.iter().all(|value| *value == first) {
        return first;
    }
    block.iter_mut().filter(|value| value.double().is_nan()).for_each(|value| *value = T::default());
    block.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    let runs = block.chunk_by(|a, b| a == b).map(|run| (run.len(), run[0]));
    runs.reduce(|most, run| if run.0 > most.0 { run } else { most }).map_or(first, |(_, value)| value)
}

impl Voxels {
    /// Combines the voxels of each block into one voxel.
    pub(crate) fn pool(&self, blocks: Blocks, how: Pooling) -> Self {
        match (how, self) {
            (Pooling::Mean, Self::F64(values)) => Self::F64(blocks.means(values, |mean| mean)),
            (Pooling::Mean, _) => Self::F32(each_type!(self, values => blocks.means(values, |mean| mean as f32))),
            (Pooling::MostFrequent, _) => {
                macro_rules! arms {
                    ($($variant:ident),*) => {
                        match self {
                            $(Self::$variant(values) => Self::$variant(blocks.most_frequent(values)),)*
                        }
                    };
                }
                arms!(I8, U8, I16, U16, I32, U32, I64, U64, F32, F64)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two blocks of 2 x 1 x 2 voxels. The fifth column and the second row fill no block.
    const BLOCKS: Blocks = Blocks { grid: [5, 1, 2], factors: [2, 1, 2] };

    #[test]
    fn means_are_not_rounded() {
        let pooled = |voxels: Voxels| voxels.pool(BLOCKS, Pooling::Mean);
        let values = [1, 2, -7, -7, 99, 3, 4, -7, -6, 99];
        assert_eq!(pooled(Voxels::I16(values.to_vec())), Voxels::F32(vec![2.5, -6.75]));
        assert_eq!(pooled(Voxels::F64(values.map(f64::from).to_vec())), Voxels::F64(vec![2.5, -6.75]));
        let with_nan: Vec<f32> = values.map(|value| if value == 4 { f32::NAN } else { value.into() }).to_vec();
        let Voxels::F32(means) = pooled(Voxels::F32(with_nan)) else { panic!("of another type") };
        assert!(means[0].is_nan() && means[1] == -6.75, "{means:?}");
    }

    #[test]
    fn the_most_frequent_label_wins_and_the_smaller_of_two() {
        let pooled = |voxels: Voxels| voxels.pool(BLOCKS, Pooling::MostFrequent);
        assert_eq!(pooled(Voxels::U8(vec![9, 4, 3, 0, 7, 4, 1, 0, 3, 7])), Voxels::U8(vec![4, 0]));
        let large = i64::MAX;
        let labels = vec![large, large - 1, large, large, 0, large, large - 1, 0, large - 1, 0];
        assert_eq!(pooled(Voxels::I64(labels)), Voxels::I64(vec![large - 1, large]));
        let nan = f32::NAN;
        assert_eq!(
            pooled(Voxels::F32(vec![nan, 0.0, nan, nan, 1.0, 2.0, 2.0, nan, nan, 1.0])),
            Voxels::F32(vec![0.0, 0.0])
        );
    }

    #[test]
    fn blocks_along_all_axes_equal_a_plain_loop() {
        let (grid, factors) = ([9, 8, 7], [2, 3, 2]);
        let blocks = Blocks { grid, factors };
        let values: Vec<u8> = (0..504u32).map(|n| (n * n * 7 % 31 % 4) as u8).collect();
        let [bx, by, bz] = blocks.count();
        assert_eq!([bx, by, bz], [4, 2, 3]);
        let (mut means, mut modes) = (Vec::new(), Vec::new());
        for b in 0..bx * by * bz {
            let [i, j, k] = [b % bx * 2, b / bx % by * 3, b / (bx * by) * 2];
            let block: Vec<u8> = (0..12).map(|n| values[((k + n / 6) * 8 + j + n / 2 % 3) * 9 + i + n % 2]).collect();
            means.push((block.iter().map(|&value| f64::from(value)).sum::<f64>() / 12.0) as f32);
            let count = |value: u8| block.iter().filter(|&&other| other == value).count();
            modes.push((0..4).rev().max_by_key(|&value| count(value)).expect("a value"));
        }
        let voxels = Voxels::U8(values);
        assert_eq!(voxels.pool(blocks, Pooling::Mean), Voxels::F32(means));
        assert_eq!(voxels.pool(blocks, Pooling::MostFrequent), Voxels::U8(modes));
    }
}
