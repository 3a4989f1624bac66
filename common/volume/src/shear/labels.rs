//! Resamples labels to the orthonormal grid.
//!
//! A new voxel lies between two old voxels of its row. If both have the same label, the new voxel
//! gets that label. If the labels differ, rounding to the nearer voxel would shift each row by up
//! to half a voxel and roughen every surface. Rounding is used only where a label is one voxel long
//! in its row. Elsewhere, the new voxels between the same two labels in a slice are sorted by a
//! score, which compares the weights of the two labels in the neighbourhood. The voxels with the
//! highest scores get the first label; linear interpolation determines their number.

use super::{Pass, Shear};
use crate::voxels::Voxels;
use rayon::prelude::*;

/// Weights along each axis for the score of a voxel: a binomial filter of five voxels. Measured on
/// masks of balls of radius 14 and 8 mm, with 1 mm voxels sheared by 30 degrees: the
/// root-mean-square error of the radius of F = 0 (`distfield --labels 1`) is 0.064 and 0.076 mm.
/// With rounding, it is 0.158 and 0.164 mm; on unsheared grids, 0.052 mm.
const VOTE: [f64; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];

/// Number of voxels that the filter covers on each side of its centre.
const FILTER_RADIUS: isize = VOTE.len() as isize / 2;

/// A new voxel that lies between two old voxels with different labels.
struct Undecided<T> {
    /// Index of the voxel in the slice.
    at: usize,
    /// The two labels, the one with the lower key first.
    pair: [T; 2],
    /// Weight of the first label minus weight of the second label in the neighbourhood.
    score: f64,
    /// Weight of the first label in linear interpolation.
    share: f64,
}

/// A voxel value that is used as a label.
trait Label: Copy + PartialEq + Send + Sync {
    /// Returns a key that is unique for labels with a magnitude of up to 2^53.
    fn key(self) -> u64;
}

macro_rules! labels {
    ($($type:ty),*) => {$(impl Label for $type {
        fn key(self) -> u64 {
            (self as f64).to_bits()
        }
    })*};
}
labels!(i8, u8, i16, u16, i32, u32, i64, u64, f32, f64);

impl Shear {
    /// Resamples labels to the orthonormal grid. Voxels outside the old volume get the label
    /// `beyond`, or the label of the nearest voxel in the row if `beyond` is `None`.
    pub fn move_labels(&self, voxels: &Voxels, beyond: Option<i64>) -> Voxels {
        macro_rules! each {
            ($($variant:ident $type:ty),*) => { match voxels { $(Voxels::$variant(values) => {
                let beyond = beyond.map(|label| label as $type);
                let moved = self.passes.iter().fold(None, |moved: Option<Vec<$type>>, pass| {
                    Some(pass.move_labels(moved.as_ref().unwrap_or(values), beyond))
                });
                Voxels::$variant(moved.unwrap_or_default())
            })* } };
        }
        each!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64)
    }
}

/// The labels before a pass.
struct OldLabels<'a, T> {
    pass: &'a Pass,
    values: &'a [T],
    beyond: Option<T>,
}

impl<T: Label> OldLabels<'_, T> {
    fn at(&self, n: isize, row: usize, k: usize) -> T {
        let last = self.pass.from[self.pass.axis] as isize - 1;
        match self.beyond {
            Some(label) if !(0..=last).contains(&n) => label,
            _ => self.values[self.pass.linear(self.pass.from, n.clamp(0, last) as usize, row, k)],
        }
    }

    /// Returns the weight of label `a` minus the weight of label `b` around a new voxel.
    fn vote(&self, [a, b]: [T; 2], n: usize, row: usize, k: usize) -> f64 {
        let side = |label: T| f64::from(u8::from(label == a)) - f64::from(u8::from(label == b));
        let mut sum = 0.0;
        for (slice, by_slice) in (k as isize - FILTER_RADIUS..).zip(VOTE) {
            for (line, by_row) in (row as isize - FILTER_RADIUS..).zip(VOTE) {
                let [slices, rows] = [self.pass.from[2], self.pass.rows()].map(|count| 0..count as isize);
                if !slices.contains(&slice) || !rows.contains(&line) {
                    continue;
                }
                let (first, part) = self.pass.shift(line, slice);
                let side = |n| side(self.at(n, line as usize, slice as usize));
                for (n, by_place) in (n as isize - FILTER_RADIUS - first..).zip(VOTE) {
                    sum += by_slice * by_row * by_place * ((1.0 - part) * side(n) + part * side(n + 1));
                }
            }
        }
        sum
    }
}

impl Pass {
    fn move_labels<T: Label>(&self, values: &[T], beyond: Option<T>) -> Vec<T> {
        let old = OldLabels { pass: self, values, beyond };
        let mut moved = vec![values[0]; self.to.iter().product()];
        moved.par_chunks_mut(self.to[0] * self.to[1]).enumerate().for_each(|(k, slice)| {
            let mut open = Vec::new();
            for row in 0..self.rows() {
                let (first, part) = self.shift(row as isize, k as isize);
                for n in 0..self.to[self.axis] {
                    let (at, place) = (n as isize - first, self.linear(self.to, n, row, 0));
                    let [a, b] = [at, at + 1].map(|n| old.at(n, row, k));
                    slice[place] = if part < 0.5 { a } else { b };
                    // round where a label is only one voxel long in its row, to preserve its length
                    let is_thin = || old.at(at - 1, row, k) != a || old.at(at + 2, row, k) != b;
                    if a.key() != b.key() && part > 0.0 && !is_thin() {
                        let (pair, share) = if a.key() < b.key() { ([a, b], 1.0 - part) } else { ([b, a], part) };
                        open.push(Undecided { at: place, pair, score: old.vote(pair, n, row, k), share });
                    }
                }
            }
            share_out(slice, open);
        });
        moved
    }
}

/// Assigns the first label of each pair to the voxels with the highest scores, and the second label
/// to the other voxels. For each pair, the number of voxels that get the first label is the rounded
/// sum of `share`.
fn share_out<T: Label>(slice: &mut [T], mut open: Vec<Undecided<T>>) {
    let key = |open: &Undecided<T>| open.pair.map(Label::key);
    open.sort_by(|a, b| key(a).cmp(&key(b)).then(b.score.total_cmp(&a.score)).then(a.at.cmp(&b.at)));
    for own in open.chunk_by(|a, b| key(a) == key(b)) {
        let count = own.iter().map(|open| open.share).sum::<f64>().round() as usize;
        for (n, open) in own.iter().enumerate() {
            slice[open.at] = open.pair[usize::from(n >= count)];
        }
    }
}
