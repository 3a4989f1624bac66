//! Labels on the orthonormal grid.
//!
//! A new voxel lies between two old ones of its row. Where these have the same label it has that
//! label. Where they differ, rounding would shift each slice by up to half a voxel and roughen
//! every surface. Instead these voxels are ranked by the labels round them. In every slice each
//! label gets the first of them, as many as linear interpolation gives it.

use super::{Pass, Shear};
use crate::voxels::Voxels;
use rayon::prelude::*;

/// Weights along each axis in the vote: a binomial of five voxels. On masks of balls of 14 and 8
/// mm, voxels of 1 mm sheared by 30 degrees, F = 0 of `distfield --labels 1` is off by 0.064 and
/// 0.076 mm (root mean square) with it, by 0.158 and 0.164 mm with rounding, and by 0.052 mm on
/// unsheared grids.
const VOTE: [f64; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];

/// Voxels that they reach on each side.
const REACH: isize = VOTE.len() as isize / 2;

/// A new voxel between two labels.
struct Open<T> {
    /// Its place in the slice.
    at: usize,
    /// The two labels, the one with the lower key first.
    pair: [T; 2],
    /// How much more of the first label lies round it.
    score: f64,
    /// Share of the first label by linear interpolation.
    share: f64,
}

/// A value of a voxel that stands for itself.
trait Label: Copy + PartialEq + Send + Sync {
    /// A number that differs where labels do (up to 2^53).
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
    /// The labels on the orthonormal grid. Outside the volume it is `beyond`, or what the nearest
    /// voxel is.
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

/// Labels before a pass.
struct Old<'a, T> {
    pass: &'a Pass,
    values: &'a [T],
    beyond: Option<T>,
}

impl<T: Label> Old<'_, T> {
    fn at(&self, n: isize, row: usize, k: usize) -> T {
        let last = self.pass.from[self.pass.axis] as isize - 1;
        match self.beyond {
            Some(label) if !(0..=last).contains(&n) => label,
            _ => self.values[self.pass.linear(self.pass.from, n.clamp(0, last) as usize, row, k)],
        }
    }

    /// How much more of label `a` than of `b` lies round a new voxel.
    fn vote(&self, [a, b]: [T; 2], n: usize, row: usize, k: usize) -> f64 {
        let side = |label: T| f64::from(u8::from(label == a)) - f64::from(u8::from(label == b));
        let mut sum = 0.0;
        for (slice, by_slice) in (k as isize - REACH..).zip(VOTE) {
            for (line, by_row) in (row as isize - REACH..).zip(VOTE) {
                let [slices, rows] = [self.pass.from[2], self.pass.rows()].map(|count| 0..count as isize);
                if !slices.contains(&slice) || !rows.contains(&line) {
                    continue;
                }
                let (first, part) = self.pass.shift(line, slice);
                let side = |n| side(self.at(n, line as usize, slice as usize));
                for (n, by_place) in (n as isize - REACH - first..).zip(VOTE) {
                    sum += by_slice * by_row * by_place * ((1.0 - part) * side(n) + part * side(n + 1));
                }
            }
        }
        sum
    }
}

impl Pass {
    fn move_labels<T: Label>(&self, values: &[T], beyond: Option<T>) -> Vec<T> {
        let old = Old { pass: self, values, beyond };
        let mut moved = vec![values[0]; self.to.iter().product()];
        moved.par_chunks_mut(self.to[0] * self.to[1]).enumerate().for_each(|(k, slice)| {
            let mut open = Vec::new();
            for row in 0..self.rows() {
                let (first, part) = self.shift(row as isize, k as isize);
                for n in 0..self.to[self.axis] {
                    let (at, place) = (n as isize - first, self.linear(self.to, n, row, 0));
                    let [a, b] = [at, at + 1].map(|n| old.at(n, row, k));
                    slice[place] = if part < 0.5 { a } else { b };
                    // a run of one voxel is rounded, so that it keeps its length
                    let is_thin = || old.at(at - 1, row, k) != a || old.at(at + 2, row, k) != b;
                    if a.key() != b.key() && part > 0.0 && !is_thin() {
                        let (pair, share) = if a.key() < b.key() { ([a, b], 1.0 - part) } else { ([b, a], part) };
                        open.push(Open { at: place, pair, score: old.vote(pair, n, row, k), share });
                    }
                }
            }
            share_out(slice, open);
        });
        moved
    }
}

/// Gives the first label of each pair the voxels with the highest scores, as many as its shares add
/// up to.
fn share_out<T: Label>(slice: &mut [T], mut open: Vec<Open<T>>) {
    let key = |open: &Open<T>| open.pair.map(Label::key);
    open.sort_by(|a, b| key(a).cmp(&key(b)).then(b.score.total_cmp(&a.score)).then(a.at.cmp(&b.at)));
    for own in open.chunk_by(|a, b| key(a) == key(b)) {
        let count = own.iter().map(|open| open.share).sum::<f64>().round() as usize;
        for (n, open) in own.iter().enumerate() {
            slice[open.at] = open.pair[usize::from(n >= count)];
        }
    }
}
