//! Spatial search: a tree that finds the intersecting pairs of axis-aligned boxes, and cubic bins
//! for points that are added and removed.
//!
//! The boxes are sorted along a Morton curve. Each level of the tree groups the boxes of the level
//! below in eights, because SIMD instructions test eight boxes at once. The tree and the order of
//! the results depend only on the input, not on the number of threads.

use fearless_simd::{Level, Simd, dispatch, f64x8, prelude::*};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Axis-aligned bounding box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Minimum coordinates.
    pub low: DVec3,
    /// Maximum coordinates.
    pub high: DVec3,
}

impl Bounds {
    /// The empty box.
    pub const EMPTY: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    /// Returns the smallest box that contains the given points.
    #[inline]
    pub fn of(points: &[DVec3]) -> Self {
        points.iter().fold(Self::EMPTY, |b, &p| Self { low: b.low.min(p), high: b.high.max(p) })
    }

    /// Returns the smallest box that contains two boxes.
    #[inline]
    pub fn merged(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Returns the common part of two boxes; empty if they do not meet.
    pub fn intersection(self, other: &Self) -> Self {
        Self { low: self.low.max(other.low), high: self.high.min(other.high) }
    }

    /// Returns whether two boxes intersect. Touching boxes intersect.
    #[inline]
    pub fn meets(&self, other: &Self) -> bool {
        self.low.cmple(other.high).all() && other.low.cmple(self.high).all()
    }

    /// Returns whether a point lies in the box or on its border.
    #[inline]
    pub fn holds(&self, p: DVec3) -> bool {
        self.low.cmple(p).all() && p.cmple(self.high).all()
    }

    /// Returns whether a point lies strictly inside the box.
    #[inline]
    pub fn encloses(&self, p: DVec3) -> bool {
        self.low.cmplt(p).all() && p.cmplt(self.high).all()
    }

    /// Returns the centre of the box.
    #[inline]
    pub fn centre(&self) -> DVec3 {
        0.5 * (self.low + self.high)
    }
}

/// Number of boxes that one SIMD operation tests: eight `f64` values fill an AVX-512 register.
const LANES: usize = 8;

/// Minimum number of boxes per task. Fewer boxes are processed on one thread: sorting this many
/// keys takes 0.3 ms, and starting a second thread takes up to a tenth of that time (see
/// `buckets::TASK_ITEMS`).
const BOXES_PER_TASK: usize = 1 << 14;

/// Largest cell coordinate of the Morton curve. Three coordinates of 21 bits fit in 64 bits.
const LARGEST_CELL: f64 = ((1 << 21) - 1) as f64;

/// Eight consecutive boxes. Unused lanes contain NaN and therefore intersect nothing.
#[derive(Clone, Copy, Debug)]
struct Eight {
    /// Minimum coordinates of the boxes along each axis.
    low: [[f64; LANES]; 3],
    high: [[f64; LANES]; 3],
}

impl Eight {
    /// Groups at most eight boxes. Also returns the smallest box that contains all of them.
    fn of(boxes: impl Iterator<Item = Bounds>) -> (Self, Bounds) {
        let mut new = Self { low: [[f64::NAN; LANES]; 3], high: [[f64::NAN; LANES]; 3] };
        let mut whole = Bounds::EMPTY;
        for (lane, own) in boxes.enumerate() {
            (0..3).for_each(|axis| {
                (new.low[axis][lane], new.high[axis][lane]) = (own.low[axis], own.high[axis]);
            });
            whole = whole.merged(own);
        }
        (new, whole)
    }

    /// Returns one of the eight boxes.
    fn at(&self, lane: usize) -> Bounds {
        let place = |from: &[[f64; LANES]; 3]| DVec3::from_array([0, 1, 2].map(|axis| from[axis][lane]));
        Bounds { low: place(&self.low), high: place(&self.high) }
    }

    /// Returns the squared distance from a point to each box. The values of unused lanes are
    /// arbitrary.
    #[inline(always)]
    fn squared_distances<S: Simd>(&self, simd: S, p: DVec3) -> f64x8<S> {
        let zero = f64x8::splat(simd, 0.0);
        let mut squares = zero;
        // a closure would not be compiled for the instruction set of the caller
        for axis in 0..3 {
            let below = f64x8::simd_from(simd, self.low[axis]) - p[axis];
            let above = f64x8::splat(simd, p[axis]) - f64x8::simd_from(simd, self.high[axis]);
            let outside = below.max(above).max(zero);
            squares += outside * outside;
        }
        squares
    }

    /// Returns a bit mask of the boxes that intersect `other`. Touching boxes intersect.
    #[inline(always)]
    fn meeting<S: Simd>(&self, simd: S, other: &Bounds) -> u64 {
        let mut meets = u64::MAX;
        for axis in 0..3 {
            let below = f64x8::simd_from(simd, self.low[axis]).simd_le(other.high[axis]);
            let above = f64x8::simd_from(simd, self.high[axis]).simd_ge(other.low[axis]);
            meets &= below.to_bitmask() & above.to_bitmask();
        }
        meets
    }
}

/// A tree of boxes in which every node has up to eight children.
#[derive(Clone, Debug)]
pub struct BoxTree {
    /// Indices of the boxes, in the order of the Morton curve.
    order: Vec<u32>,
    /// The levels of the tree, from the sorted boxes up to the root.
    levels: Vec<Vec<Eight>>,
    /// Bounding box of each group of eight boxes at the first level.
    outlines: Vec<Bounds>,
}

/// Pairs of boxes found so far, and the buffers of the search.
#[derive(Default)]
struct Found {
    pairs: Vec<[u32; 2]>,
    near: Vec<u32>,
    next: Vec<u32>,
}

impl BoxTree {
    /// Builds a tree of the given boxes.
    pub fn new(boxes: &[Bounds]) -> Self {
        let whole = boxes.iter().fold(Bounds::EMPTY, |a, &b| a.merged(b));
        let scale = (whole.high - whole.low).max(DVec3::splat(f64::MIN_POSITIVE)).recip() * LARGEST_CELL;
        let mut keys: Vec<(u64, u32)> = boxes
            .par_iter()
            .with_min_len(BOXES_PER_TASK)
            .enumerate()
            .map(|(i, b)| {
                let cell = (b.centre() - whole.low) * scale;
                (spread(cell.x as u64) | spread(cell.y as u64) << 1 | spread(cell.z as u64) << 2, i as u32)
            })
            .collect();
        if keys.len() < BOXES_PER_TASK {
            keys.sort_unstable()
        } else {
            keys.par_sort_unstable()
        }
        let order: Vec<u32> = keys.into_iter().map(|(_, i)| i).collect();
        let (first, outlines): (Vec<Eight>, Vec<Bounds>) = order
            .par_chunks(LANES)
            .with_min_len(BOXES_PER_TASK / LANES)
            .map(|chunk| Eight::of(chunk.iter().map(|&i| boxes[i as usize])))
            .unzip();
        let mut levels = vec![first];
        let mut below = outlines.clone();
        while below.len() > 1 {
            let (level, above) = below
                .par_chunks(LANES)
                .with_min_len(BOXES_PER_TASK / LANES)
                .map(|chunk| Eight::of(chunk.iter().copied()))
                .unzip();
            levels.push(level);
            below = above;
        }
        Self { order, levels, outlines }
    }

    /// Returns all pairs of boxes that intersect or touch and for which `test` returns true. The
    /// pairs are in ascending order, with the lower index first.
    pub fn pairs(&self, test: impl Fn(u32, u32) -> bool + Sync) -> Vec<[u32; 2]> {
        let of_eight = |found: &mut Found, eight: usize| {
            self.find_pairs(eight, found);
            found.pairs.iter().copied().filter(|&[a, b]| test(a, b)).collect::<Vec<_>>()
        };
        let eights = (0..self.outlines.len()).into_par_iter();
        let mut pairs: Vec<[u32; 2]> = eights.map_init(Found::default, of_eight).flatten_iter().collect();
        pairs.par_sort_unstable();
        pairs
    }

    /// Returns whether `test` returns true for any pair of boxes that intersect or touch. The first
    /// argument of `test` is the lower index.
    pub fn any_pair(&self, mut test: impl FnMut(u32, u32) -> bool) -> bool {
        let mut found = Found::default();
        (0..self.outlines.len()).any(|eight| {
            self.find_pairs(eight, &mut found);
            found.pairs.iter().any(|&[a, b]| test(a, b))
        })
    }

    /// Returns the box with the smallest value of `square`, and this value. `square` must be at
    /// least the squared distance from `p` to the box, up to rounding.
    pub fn nearest(&self, p: DVec3, square: impl Fn(u32) -> f64) -> Option<(u32, f64)> {
        dispatch!(Level::new(), simd => self.nearest_by(simd, p, square))
    }

    #[inline(always)]
    fn nearest_by<S: Simd>(&self, simd: S, p: DVec3, square: impl Fn(u32) -> f64) -> Option<(u32, f64)> {
        let mut nearest = (u32::MAX, f64::INFINITY);
        // squared distance, level and group of eight
        let mut waiting = Vec::with_capacity(LANES * self.levels.len());
        waiting.push((0.0, self.levels.len() - 1, 0));
        while let Some((least, level, group)) = waiting.pop() {
            if least > nearest.1 {
                continue;
            }
            let below = if level > 0 { self.levels[level - 1].len() } else { self.order.len() };
            let lanes = LANES.min(below.saturating_sub(group * LANES));
            let Some(eight) = self.levels[level].get(group) else { continue };
            let squares = eight.squared_distances(simd, p);
            let mut near = squares.simd_le(nearest.1).to_bitmask() & ((1 << lanes) - 1);
            let first = waiting.len();
            while near != 0 {
                let lane = near.trailing_zeros() as usize;
                near &= near - 1;
                let child = group * LANES + lane;
                if level > 0 {
                    waiting.push((squares[lane], level - 1, child));
                    continue;
                }
                if squares[lane] > nearest.1 {
                    continue;
                }
                let own = (self.order[child], square(self.order[child]));
                if own.1 < nearest.1 {
                    nearest = own;
                }
            }
            // the nearest group is visited first
            waiting[first..].sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        }
        (nearest.0 != u32::MAX).then_some(nearest)
    }

    /// Finds the pairs of intersecting boxes whose first box (in Morton order) is in group `eight`.
    fn find_pairs(&self, eight: usize, found: &mut Found) {
        dispatch!(Level::new(), simd => self.find_pairs_by(simd, eight, found));
    }

    #[inline(always)]
    fn find_pairs_by<S: Simd>(&self, simd: S, eight: usize, found: &mut Found) {
        let Found { pairs, near, next } = found;
        pairs.clear();
        near.clear();
        near.push(0);
        let (first, above) = self.levels.split_first().expect("a tree has a level");
        for level in above.iter().rev() {
            next.clear();
            for &n in &*near {
                let mut meets = level[n as usize].meeting(simd, &self.outlines[eight]);
                while meets != 0 {
                    next.push(n * LANES as u32 + meets.trailing_zeros());
                    meets &= meets - 1;
                }
            }
            std::mem::swap(near, next);
        }
        let number = |eight: usize, lane: usize| self.order[eight * LANES + lane];
        for lane in 0..LANES.min(self.order.len() - eight * LANES) {
            let own = first[eight].at(lane);
            for other in near.iter().map(|&n| n as usize).filter(|&n| n >= eight) {
                let mut meets = first[other].meeting(simd, &own);
                if other == eight {
                    // only the boxes after the current box
                    meets &= u64::MAX << 1 << lane;
                }
                while meets != 0 {
                    let (a, b) = (number(eight, lane), number(other, meets.trailing_zeros() as usize));
                    pairs.push([a.min(b), a.max(b)]);
                    meets &= meets - 1;
                }
            }
        }
    }
}

/// Values at points, stored in cubic bins.
#[derive(Clone, Debug)]
pub struct Bins<T> {
    side: f64,
    bins: HashMap<[i64; 3], Vec<T>>,
}

impl<T: PartialEq> Bins<T> {
    /// Creates empty bins with the given positive side length.
    pub fn new(side: f64) -> Self {
        Self { side, bins: HashMap::new() }
    }

    fn bin(&self, p: DVec3) -> [i64; 3] {
        (p / self.side).floor().to_array().map(|x| x as i64)
    }

    /// Adds a value at a point.
    pub fn add(&mut self, p: DVec3, value: T) {
        self.bins.entry(self.bin(p)).or_default().push(value);
    }

    /// Removes all values equal to `value` from the bin of a point.
    pub fn remove(&mut self, p: DVec3, value: &T) {
        let bin = self.bin(p);
        self.bins.entry(bin).or_default().retain(|other| other != value);
    }

    /// Returns the values in the bin of a point and in the 26 adjacent bins, in a fixed order.
    /// These include all values whose points are less than one side length away from `p`.
    pub fn near(&self, p: DVec3) -> impl Iterator<Item = &T> {
        let at = self.bin(p);
        let around = (0..27).map(move |n| [at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1]);
        around.filter_map(|bin| self.bins.get(&bin)).flatten()
    }
}

/// Moves the low 21 bits of x to every third bit position.
fn spread(x: u64) -> u64 {
    let mut x = x & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;

    #[test]
    fn bins_find_all_that_are_nearer_than_their_side() {
        let at = |n: u64| 4.0 * DVec3::from_array([0, 1, 2].map(|axis| uniform(3, axis, n) - 0.5));
        let mut bins = Bins::new(0.7);
        (0..400).for_each(|n| bins.add(at(n), n));
        bins.remove(at(7), &7);
        for n in 0..400 {
            let near: Vec<u64> = bins.near(at(n)).copied().filter(|&m| at(m).distance(at(n)) < 0.7).collect();
            let expected = (0..400).filter(|&m| m != 7 && at(m).distance(at(n)) < 0.7).count();
            assert_eq!(near.len(), expected);
        }
    }

    #[test]
    fn finds_the_pairs_that_a_scan_of_all_boxes_finds() {
        for count in [0usize, 1, 3, 8, 9, 64, 65, 700] {
            let at = |s: u64, n: u64| DVec3::new(uniform(s, 0, n), uniform(s, 1, n), uniform(s, 2, n));
            let box_of = |n: u64| Bounds { low: at(1, n), high: at(1, n) + at(2, n) * 0.2 };
            let boxes: Vec<Bounds> = (0..count as u64).map(box_of).collect();
            let tree = BoxTree::new(&boxes);
            let pairs = (0..count as u32).flat_map(|a| (a + 1..count as u32).map(move |b| [a, b]));
            let meet = |&[a, b]: &[u32; 2]| boxes[a as usize].meets(&boxes[b as usize]);
            let expected: Vec<[u32; 2]> = pairs.filter(meet).collect();
            assert_eq!(tree.pairs(|_, _| true), expected, "{count} boxes");
            assert_eq!(
                tree.pairs(|a, b| (a + b) % 3 == 0).len(),
                expected.iter().filter(|p| (p[0] + p[1]) % 3 == 0).count()
            );
            for pair in expected.iter().step_by(7) {
                assert!(tree.any_pair(|a, b| [a, b] == *pair), "{pair:?} of {count} boxes");
            }
            assert!(!tree.any_pair(|a, b| expected.binary_search(&[a, b]).is_err()), "a pair that does not meet");
        }
    }

    #[test]
    fn coinciding_and_flat_boxes_are_all_found() {
        let boxes = vec![Bounds { low: DVec3::ONE, high: DVec3::ONE }; 9];
        assert_eq!(BoxTree::new(&boxes).pairs(|_, _| true).len(), 36);
    }
}
