//! Stores one bit for each node of a grid, in rows of whole words, so that 64 nodes can be compared
//! with their neighbours in one operation.

use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*};
use rayon::prelude::*;

/// Number of nodes per word.
pub(crate) const WORD: usize = u64::BITS as usize;

/// Number of nodes that one SIMD operation compares: sixteen floats fill a vector register of 512
/// bits.
const LANES: usize = 16;

/// The side of a level on which the marked values lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    Below,
    Above,
}

/// The bits of all nodes. Each row along x starts with a new word. Bits beyond the end of a row are
/// zero.
pub(crate) struct NodeBits {
    words: Vec<u64>,
    width: usize,
}

impl NodeBits {
    /// Marks the values that lie strictly on one side of a level. The values are stored x fastest,
    /// in rows of `nx`. NaNs are never marked.
    pub(crate) fn of(values: &[f32], nx: usize, side: Side, level: f32) -> Self {
        let width = nx.div_ceil(WORD);
        if values.is_empty() {
            return Self { words: Vec::new(), width };
        }
        let mut words = vec![0; width * values.len() / nx];
        let instructions = Level::new();
        words.par_chunks_mut(width).zip(values.par_chunks(nx)).for_each(|(words, row)| {
            dispatch!(instructions, simd => mark(simd, row, side, level, words));
        });
        Self { words, width }
    }

    /// Returns the number of words per row.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Returns the words of a row. The row at indices j and k is row `j + ny * k`.
    pub(crate) fn row(&self, row: usize) -> &[u64] {
        self.rows(row, 1)
    }

    /// Returns the words of `count` consecutive rows.
    pub(crate) fn rows(&self, first: usize, count: usize) -> &[u64] {
        &self.words[first * self.width..][..count * self.width]
    }
}

/// Sets the bits of a row in `words`, which must be zero on entry.
#[inline(always)]
fn mark<S: Simd>(simd: S, row: &[f32], side: Side, level: f32, words: &mut [u64]) {
    let (whole, rest) = row.as_chunks::<LANES>();
    for (n, values) in whole.iter().enumerate() {
        let values = f32x16::simd_from(simd, *values);
        let marked = match side {
            Side::Below => values.simd_lt(level),
            Side::Above => values.simd_gt(level),
        };
        words[n * LANES / WORD] |= marked.to_bitmask() << (n * LANES % WORD);
    }
    for (n, &value) in (whole.len() * LANES..).zip(rest) {
        let is_marked = match side {
            Side::Below => value < level,
            Side::Above => value > level,
        };
        words[n / WORD] |= u64::from(is_marked) << (n % WORD);
    }
}

/// Returns 64 bits of a row, starting `by` nodes after the first node of a word, or before it if
/// `by` is negative. The magnitude of `by` must be less than 64. Words beyond the ends of the row
/// count as all ones.
pub(crate) fn shifted(row: &[u64], word: usize, by: isize) -> u64 {
    let at = |word: Option<usize>| word.and_then(|word| row.get(word)).copied().unwrap_or(u64::MAX);
    let own = row[word];
    match by {
        0 => own,
        1.. => own >> by | at(word.checked_add(1)) << (WORD as isize - by),
        _ => own << -by | at(word.checked_sub(1)) >> (WORD as isize + by),
    }
}

/// Calls `visit` with the index of every bit that is set, in ascending order.
pub(crate) fn each_bit(mut bits: u64, mut visit: impl FnMut(usize)) {
    while bits != 0 {
        visit(bits.trailing_zeros() as usize);
        bits &= bits - 1;
    }
}

/// Returns the first `count` bits of a word, or all bits if `count` is larger.
pub(crate) fn first_bits(count: usize) -> u64 {
    if count >= WORD { u64::MAX } else { (1 << count) - 1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;

    #[test]
    fn every_node_has_its_bit_and_none_beyond_the_row() {
        for nx in [1, 15, 16, 17, 63, 64, 65, 150] {
            let value = |n: usize| match uniform(3, nx as u64, n as u64) {
                high if high > 0.9 => f32::NAN,
                other => (8.0 * other).floor() as f32,
            };
            let values: Vec<f32> = (0..5 * nx).map(value).collect();
            for (side, is_marked) in
                [(Side::Below, (|v| v < 4.0) as fn(f32) -> bool), (Side::Above, (|v| v > 4.0) as fn(f32) -> bool)]
            {
                let bits = NodeBits::of(&values, nx, side, 4.0);
                for row in 0..5 {
                    let mut found = Vec::new();
                    for (word, &own) in bits.row(row).iter().enumerate() {
                        each_bit(own, |bit| found.push(word * WORD + bit));
                    }
                    let expected: Vec<usize> = (0..nx).filter(|i| is_marked(values[row * nx + i])).collect();
                    assert_eq!(found, expected, "row {row} of {nx}");
                }
            }
        }
    }

    #[test]
    fn shifted_words_are_those_of_nodes_farther_on() {
        let row = [0x8000_0000_0000_0001, 0x5555_0000_ffff_0003, 0x0f];
        let bit = |n: isize| !(0..192).contains(&n) || row[n as usize / WORD] >> (n as usize % WORD) & 1 == 1;
        for by in -5..=5 {
            for n in 0..192 {
                let found = shifted(&row, n as usize / WORD, by) >> (n as usize % WORD) & 1 == 1;
                assert_eq!(found, bit(n + by), "{n} and {by} more");
            }
        }
        assert_eq!([first_bits(0), first_bits(3), first_bits(64), first_bits(99)], [0, 7, u64::MAX, u64::MAX]);
    }
}
