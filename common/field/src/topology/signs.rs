//! Uses the signs of the spline coefficients to find the cells that F = 0 may cross. This test is
//! cheaper than the bounds in Bernstein form, so it is applied first.

use crate::node_bits::{NodeBits, Side, WORD, each_bit, first_bits, shifted};
use crate::spline::CubicSpline;
use std::ops::Range;

/// The signs of the coefficients of a spline.
pub(crate) struct Signs {
    size: [usize; 3],
    positive: NodeBits,
    negative: NodeBits,
}

impl Signs {
    pub(crate) fn of(field: &CubicSpline) -> Self {
        let size = field.geometry().size;
        let of = |side| NodeBits::of(field.coefficients(), size[0], side, 0.0);
        Self { size, positive: of(Side::Above), negative: of(Side::Below) }
    }

    /// Returns the voxel cells of a slice whose coefficients do not all have the same sign. The
    /// cells are given by their indices in the slice (x fastest), in ascending order. Here, the
    /// coefficients of a cell are all those that determine F in the cell and in the cells up to
    /// `around` cells away. F is a weighted mean of these coefficients (convex hull property). If
    /// they have the same sign, F therefore has this sign.
    pub(crate) fn changes(&self, k: usize, around: usize) -> Vec<usize> {
        let [nx, ny, nz] = self.size;
        let width = self.positive.width();
        // at the border, the mirror images of coefficients beyond the grid are already included
        let reach = |cell: usize, n: usize| cell.saturating_sub(1 + around)..(cell + 3 + around).min(n);
        let over_slices = |bits: &NodeBits| all_of(reach(k, nz), |slice| bits.rows(slice * ny, ny));
        let over_slices = [&self.positive, &self.negative].map(over_slices);
        let shifts = -(1 + around as isize)..=2 + around as isize;
        let mut changes = Vec::new();
        for j in 0..ny.saturating_sub(1) {
            let over_rows = over_slices.each_ref().map(|words| {
                let mut row = all_of(reach(j, ny), |row| &words[row * width..][..width]);
                // bits beyond the last node are set, so that they do not affect the AND
                row[width - 1] |= !first_bits(nx - (width - 1) * WORD);
                row
            });
            for word in 0..width {
                let over_all =
                    |row: &Vec<u64>| shifts.clone().fold(u64::MAX, |all, shift| all & shifted(row, word, shift));
                let [positive, negative] = over_rows.each_ref().map(over_all);
                each_bit(!(positive | negative) & first_bits(nx - 1 - word * WORD), |bit| {
                    changes.push(j * (nx - 1) + word * WORD + bit);
                });
            }
        }
        changes
    }
}

/// Returns the bitwise AND of the runs of words that `words` returns. The result is empty if there
/// are no runs.
fn all_of<'w>(mut runs: Range<usize>, words: impl Fn(usize) -> &'w [u64]) -> Vec<u64> {
    let mut all = runs.next().map_or_else(Vec::new, |run| words(run).to_vec());
    runs.for_each(|run| all.iter_mut().zip(words(run)).for_each(|(all, own)| *all &= own));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;
    use glam::DVec3;
    use isoparticles_volume::Geometry;

    #[test]
    fn changes_are_those_that_a_look_at_all_coefficients_finds() {
        for size in [[70, 5, 6], [64, 4, 5], [9, 7, 5], [2, 2, 2], [131, 6, 3]] {
            let geometry = Geometry::axis_aligned(size, DVec3::ONE);
            let coefficient = |n: usize| {
                let random = uniform(5, 0, n as u64);
                if random > 0.97 { 0.0 } else { (0.93 - random) as f32 }
            };
            let coefficients: Vec<f32> = (0..geometry.voxel_count()).map(coefficient).collect();
            let field = CubicSpline::from_coefficients(geometry.clone(), coefficients.clone());
            let signs = Signs::of(&field);
            for (k, around) in (0..size[2] - 1).flat_map(|k| (0..3).map(move |around| (k, around))) {
                let is_changed = |n: &usize| {
                    let cell = [n % (size[0] - 1), n / (size[0] - 1), k];
                    let read =
                        |axis: usize| cell[axis].saturating_sub(1 + around)..(cell[axis] + 3 + around).min(size[axis]);
                    let read: Vec<f32> = read(2)
                        .flat_map(|z| read(1).flat_map(move |y| read(0).map(move |x| [x, y, z])))
                        .map(|[x, y, z]| coefficients[geometry.linear(x, y, z)])
                        .collect();
                    !(read.iter().all(|&c| c > 0.0) || read.iter().all(|&c| c < 0.0))
                };
                let expected: Vec<usize> = (0..(size[0] - 1) * (size[1] - 1)).filter(is_changed).collect();
                assert_eq!(signs.changes(k, around), expected, "{size:?}, slice {k}, {around} around");
            }
        }
    }
}
