//! Bit sets over the nodes of a grid, and rank queries on them.
//!
//! [`Bits`] stores one bit per node (x fastest) and finds the nodes near the surface of the set and
//! its ambiguous faces. [`Numbering`] counts the nodes of a set before a given node, so that values
//! at the nodes of the set fit in a compact array.

use rayon::prelude::*;
use std::ops::Range;

/// Number of nodes per parallel task: a multiple of 64, so that each task owns whole words. A task
/// writes 2 KiB.
const CHUNK: usize = 1 << 14;

/// A set of nodes.
#[derive(Clone, Debug)]
pub struct Bits {
    words: Vec<u64>,
}

impl Bits {
    /// Returns the set of nodes n < `count` for which `holds(n)` is true.
    pub fn of(count: usize, holds: impl Fn(usize) -> bool + Sync) -> Self {
        let mut words = vec![0u64; count.div_ceil(64)];
        words.par_chunks_mut(CHUNK / 64).enumerate().for_each(|(chunk, words)| {
            for (w, word) in words.iter_mut().enumerate() {
                let first = chunk * CHUNK + 64 * w;
                for n in first..(first + 64).min(count) {
                    *word |= u64::from(holds(n)) << (n % 64);
                }
            }
        });
        Self { words }
    }

    /// Returns an empty set over the first `count` nodes.
    pub fn none(count: usize) -> Self {
        Self { words: vec![0; count.div_ceil(64)] }
    }

    /// Returns whether a node is in the set.
    #[inline(always)]
    pub fn holds(&self, node: usize) -> bool {
        self.words[node / 64] >> (node % 64) & 1 == 1
    }

    /// Adds the nodes of a range.
    pub fn insert(&mut self, range: Range<usize>) {
        let mut first = range.start;
        while first < range.end {
            let length = (64 - first % 64).min(range.end - first);
            self.words[first / 64] |= u64::MAX >> (64 - length) << (first % 64);
            first += length;
        }
    }

    /// Adds the nodes of another set over the same nodes.
    pub fn add(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(word, other)| *word |= other);
    }

    /// Returns the union of four copies of the set, each shifted up by one of the `numbers`.
    /// Shifted nodes must not lie beyond the grid.
    pub fn moved(&self, numbers: [usize; 4]) -> Self {
        // words before the start of the set are empty
        let before = |word: usize, back: usize| word.checked_sub(back).map_or(0, |word| self.words[word]);
        let mut words = vec![0; self.words.len()];
        words.par_chunks_mut(CHUNK / 64).enumerate().for_each(|(chunk, words)| {
            for (w, to) in (chunk * CHUNK / 64..).zip(words) {
                for number in numbers {
                    let (back, up) = (number / 64, number % 64);
                    *to |= before(w, back) << up;
                    *to |= before(w, back + 1).checked_shr(64 - up as u32).unwrap_or(0);
                }
            }
        });
        Self { words }
    }

    /// Returns the 64 bits that start at node `first`. Words before and after the stored words have
    /// the value `beyond`.
    fn word(&self, first: isize, beyond: u64) -> u64 {
        let (at, up) = (first.div_euclid(64), first.rem_euclid(64) as u32);
        let word = |at: isize| usize::try_from(at).ok().and_then(|at| self.words.get(at)).copied().unwrap_or(beyond);
        word(at) >> up | word(at + 1).checked_shl(64 - up).unwrap_or(0)
    }

    /// Returns the nodes whose neighbourhood of 27 nodes (including the node itself) is mixed: at
    /// least one node is in the set and at least one is not. The arguments are the strides along x,
    /// y and z.
    ///
    /// Rows are treated as contiguous: the end of a row is adjacent to the start of the next row.
    /// Bits after the last node may also be set.
    pub fn near_the_rest(&self, [along, row, slice]: [usize; 3]) -> Self {
        let signed = |step: usize, n: isize| step as isize * n;
        let steps: Vec<isize> =
            (0..27).map(|n| signed(along, n % 3 - 1) + signed(row, n / 3 % 3 - 1) + signed(slice, n / 9 - 1)).collect();
        let near = |w: usize| {
            let first = 64 * w as isize;
            let any = steps.iter().fold(0, |any, step| any | self.word(first + step, 0));
            any & !steps.iter().fold(u64::MAX, |all, step| all & self.word(first + step, u64::MAX))
        };
        Self { words: (0..self.words.len()).into_par_iter().map(near).collect() }
    }

    /// Visits the nodes of a range that are the first corner of an ambiguous face: the two nodes
    /// one step away are on the other side, and the diagonally opposite node is on the same side.
    /// The steps are the strides along two axes. The caller must exclude faces that wrap into the
    /// next row or slice.
    pub fn each_alternating(&self, range: Range<usize>, [one, other]: [usize; 2], mut visit: impl FnMut(usize)) {
        for first in range.clone().step_by(64) {
            let [own, a, b, both] = [0, one, other, one + other].map(|step| self.word((first + step) as isize, 0));
            let mut found = (own ^ a) & (own ^ b) & !(own ^ both);
            while found != 0 {
                let node = first + found.trailing_zeros() as usize;
                if node >= range.end {
                    break;
                }
                visit(node);
                found &= found - 1;
            }
        }
    }

    /// Returns the number of nodes in the set.
    pub fn count(&self) -> usize {
        ones(&self.words)
    }
}

/// Returns the number of set bits.
fn ones(words: &[u64]) -> usize {
    words.iter().map(|word| word.count_ones() as usize).sum()
}

/// Number of words per stored count of a [`Numbering`]. These words fill one cache line of 64
/// bytes. The counts add an eighth to the memory of the words.
const BLOCK: usize = 8;

/// Assigns consecutive indices to the nodes of a set, in ascending order.
pub struct Numbering {
    bits: Bits,
    /// Number of nodes of the set before each block of [`BLOCK`] words.
    before: Vec<usize>,
    /// Number of nodes in the set.
    pub count: usize,
}

impl Numbering {
    /// Numbers the nodes in `bits`.
    pub fn new(bits: Bits) -> Self {
        let mut count = 0;
        let mut before = Vec::with_capacity(bits.words.len().div_ceil(BLOCK));
        for block in bits.words.chunks(BLOCK) {
            before.push(count);
            count += ones(block);
        }
        Self { bits, before, count }
    }

    /// Returns the number of nodes of the set before `node`. For a node of the set, this is its
    /// index.
    pub fn number(&self, node: usize) -> usize {
        let word = node / 64;
        if word == self.bits.words.len() {
            return self.count;
        }
        let below = self.bits.words[word] & ((1 << (node % 64)) - 1);
        let block = word / BLOCK;
        self.before[block] + ones(&self.bits.words[block * BLOCK..word]) + below.count_ones() as usize
    }

    /// Returns the index of a node, or `None` if the node is not in the set.
    pub fn find(&self, node: usize) -> Option<usize> {
        self.bits.holds(node).then(|| self.number(node))
    }

    /// Calls `visit(node, index)` for the nodes of the set in a range, in ascending order.
    pub fn each(&self, range: Range<usize>, mut visit: impl FnMut(usize, usize)) {
        if range.is_empty() {
            return;
        }
        let mut number = self.number(range.start);
        for w in range.start / 64..=(range.end - 1) / 64 {
            let mut word = self.bits.words[w];
            if w == range.start / 64 {
                word &= u64::MAX << (range.start % 64);
            }
            while word != 0 {
                let node = 64 * w + word.trailing_zeros() as usize;
                if node >= range.end {
                    break;
                }
                visit(node, number);
                number += 1;
                word &= word - 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_added() {
        let mut bits = Bits::of(300, |n| n % 3 == 0);
        let mut truth: Vec<bool> = (0..300).map(|n| n % 3 == 0).collect();
        for range in [0..0, 5..9, 60..200, 63..64, 64..130, 290..300] {
            truth[range.clone()].fill(true);
            bits.insert(range);
            assert!((0..300).all(|n| bits.holds(n) == truth[n]));
            assert_eq!(bits.count(), truth.iter().filter(|is_in| **is_in).count());
        }
    }

    #[test]
    fn neighbours_and_alternating_faces_match_a_direct_search() {
        let size = [13usize, 12, 11];
        let steps = [1, size[0], size[0] * size[1]];
        let count = steps[2] * size[2];
        // the outer two layers are empty, so no neighbourhood wraps into the next row
        let is_inner = |n: usize| (0..3).all(|a| (2..size[a] - 2).contains(&(n / steps[a] % size[a])));
        let bits = Bits::of(count, |n| is_inner(n) && isoparticles_field::random::uniform(5, 0, n as u64) < 0.5);
        let near = bits.near_the_rest(steps);
        let is_well_in = |n: usize| (0..3).all(|a| (1..size[a] - 1).contains(&(n / steps[a] % size[a])));
        for n in (0..count).filter(|&n| is_well_in(n)) {
            let around =
                (0..27).map(|m| n + m % 3 + m / 3 % 3 * steps[1] + m / 9 * steps[2] - steps.iter().sum::<usize>());
            let held = around.filter(|&m| bits.holds(m)).count();
            assert_eq!(near.holds(n), (1..27).contains(&held), "{n}");
        }
        for (u, v) in [(0, 1), (1, 2), (2, 0)] {
            let mut found = Vec::new();
            bits.each_alternating(70..count, [steps[u], steps[v]], |n| found.push(n));
            let side = |n: usize| n < count && bits.holds(n);
            let alternates = |&n: &usize| {
                let own = side(n);
                side(n + steps[u]) != own && side(n + steps[v]) != own && side(n + steps[u] + steps[v]) == own
            };
            assert_eq!(found, (70..count).filter(alternates).collect::<Vec<_>>());
            assert!(found.len() > 5);
        }
    }

    #[test]
    fn a_set_is_moved_up_by_several_numbers_at_once() {
        let (held, count) = (2 * CHUNK, 3 * CHUNK + 1000);
        let holds = |n: usize| n < held && (n % 11 == 3 || n % CHUNK < 70);
        let bits = Bits::of(count, holds);
        for numbers in [[0, 1, 2, 3], [0, 63, 64, 65], [0, 130, 260, 390], [1, 128, CHUNK - 1, CHUNK + 65]] {
            let moved = bits.moved(numbers);
            for n in 0..count {
                let is_there = numbers.iter().any(|&number| n.checked_sub(number).is_some_and(holds));
                assert_eq!(moved.holds(n), is_there, "{n} by {numbers:?}");
            }
        }
    }

    #[test]
    fn nodes_are_numbered_in_order() {
        let holds = |n: usize| n % 7 == 3 || (60..70).contains(&n);
        let numbering = Numbering::new(Bits::of(1000, holds));
        let nodes: Vec<usize> = (0..1000).filter(|&n| holds(n)).collect();
        assert_eq!(numbering.count, nodes.len());
        for (number, &node) in nodes.iter().enumerate() {
            assert_eq!((numbering.number(node), numbering.find(node)), (number, Some(number)));
            assert_eq!(numbering.find(node + 1).is_some(), holds(node + 1));
        }
        for range in [0..1000, 61..64, 64..64, 5..700, 999..1000] {
            let mut found = Vec::new();
            numbering.each(range.clone(), |node, number| found.push((node, number)));
            let truth: Vec<_> = nodes.iter().copied().enumerate().filter(|(_, n)| range.contains(n)).collect();
            assert_eq!(found, truth.into_iter().map(|(number, node)| (node, number)).collect::<Vec<_>>());
        }
    }
}
