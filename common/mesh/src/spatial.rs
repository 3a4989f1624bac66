//! What is near: a tree of axis-aligned boxes, for finding the few of many simplices that come near a given one, and cubic bins, for points that come and go.
//!
//! The boxes are sorted along a Morton curve and paired up level by level; nothing but the input decides the
//! shape of the tree or the order of the answers, so results are the same whatever the number of threads.

use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates.
    pub low: DVec3,
    /// Largest coordinates.
    pub high: DVec3,
}

impl Bounds {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    /// Smallest box around some points.
    #[inline]
    pub fn of(points: &[DVec3]) -> Self {
        points.iter().fold(Self::EMPTY, |b, &p| Self { low: b.low.min(p), high: b.high.max(p) })
    }

    /// Smallest box around two.
    #[inline]
    pub fn merged(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Whether two boxes have a point in common, touching included.
    #[inline]
    pub fn meets(&self, other: &Self) -> bool {
        self.low.cmple(other.high).all() && other.low.cmple(self.high).all()
    }

    /// Whether a point lies within or on the border.
    #[inline]
    pub fn holds(&self, p: DVec3) -> bool {
        self.low.cmple(p).all() && p.cmple(self.high).all()
    }

    /// Whether a point lies within, not on the border.
    #[inline]
    pub fn encloses(&self, p: DVec3) -> bool {
        self.low.cmplt(p).all() && p.cmplt(self.high).all()
    }

    /// The centre.
    #[inline]
    pub fn centre(&self) -> DVec3 {
        0.5 * (self.low + self.high)
    }
}

const LEAF: usize = 4;

/// Tree of boxes.
#[derive(Clone, Debug)]
pub struct BoxTree {
    order: Vec<u32>,
    boxes: Vec<Bounds>,
    /// `levels[0]` bounds each [`LEAF`] boxes in `order`, each further level pairs of the one before.
    levels: Vec<Vec<Bounds>>,
}

impl BoxTree {
    /// Builds the tree over some boxes.
    pub fn new(boxes: Vec<Bounds>) -> Self {
        let whole = boxes.iter().fold(Bounds::EMPTY, |a, &b| a.merged(b));
        let scale = (whole.high - whole.low).max(DVec3::splat(f64::MIN_POSITIVE)).recip() * 2_097_151.0;
        let mut keys: Vec<(u64, u32)> = boxes
            .par_iter()
            .enumerate()
            .map(|(i, b)| {
                let cell = (b.centre() - whole.low) * scale;
                (spread(cell.x as u64) | spread(cell.y as u64) << 1 | spread(cell.z as u64) << 2, i as u32)
            })
            .collect();
        keys.par_sort_unstable();
        let order: Vec<u32> = keys.into_iter().map(|(_, i)| i).collect();
        let leaves: Vec<Bounds> = order
            .par_chunks(LEAF)
            .map(|chunk| chunk.iter().fold(Bounds::EMPTY, |a, &i| a.merged(boxes[i as usize])))
            .collect();
        let mut levels = vec![leaves];
        while levels[levels.len() - 1].len() > 1 {
            let below = &levels[levels.len() - 1];
            levels.push(below.par_chunks(2).map(|pair| pair.iter().fold(Bounds::EMPTY, |a, &b| a.merged(b))).collect());
        }
        Self { order, boxes, levels }
    }

    /// Calls `found` with the number of every box that meets the given one.
    pub fn overlapping(&self, query: &Bounds, mut found: impl FnMut(u32)) {
        if self.order.is_empty() {
            return;
        }
        let mut stack = vec![(self.levels.len() - 1, 0usize)];
        while let Some((level, i)) = stack.pop() {
            if !self.levels[level][i].meets(query) {
                continue;
            }
            if level > 0 {
                let below = self.levels[level - 1].len();
                stack.extend((2 * i..(2 * i + 2).min(below)).rev().map(|child| (level - 1, child)));
                continue;
            }
            for &item in &self.order[i * LEAF..((i + 1) * LEAF).min(self.order.len())] {
                if self.boxes[item as usize].meets(query) {
                    found(item);
                }
            }
        }
    }
}

/// Values at points, in cubic bins.
#[derive(Clone, Debug)]
pub struct Bins<T> {
    side: f64,
    bins: HashMap<[i64; 3], Vec<T>>,
}

impl<T: PartialEq> Bins<T> {
    /// No values yet, in bins of a side above 0.
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

    /// Takes a value at a point away.
    pub fn remove(&mut self, p: DVec3, value: &T) {
        let bin = self.bin(p);
        self.bins.entry(bin).or_default().retain(|other| other != value);
    }

    /// The values in the bin of a point and in the 26 around it: all whose points are nearer than the side, and some others, always in the same order.
    pub fn near(&self, p: DVec3) -> impl Iterator<Item = &T> {
        let at = self.bin(p);
        let around = (0..27).map(move |n| [at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1]);
        around.filter_map(|bin| self.bins.get(&bin)).flatten()
    }
}

/// Spreads the low 21 bits to every third place.
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
    fn finds_what_a_scan_of_all_boxes_finds() {
        for count in [0usize, 1, 3, 4, 5, 300] {
            let boxes: Vec<Bounds> = (0..count as u64)
                .map(|n| {
                    let at = |s: u64| DVec3::new(uniform(s, 0, n), uniform(s, 1, n), uniform(s, 2, n));
                    let low = at(1);
                    Bounds { low, high: low + at(2) * 0.2 }
                })
                .collect();
            let tree = BoxTree::new(boxes.clone());
            for query in &boxes {
                let mut found = Vec::new();
                tree.overlapping(query, |i| found.push(i));
                found.sort_unstable();
                let expected: Vec<u32> = (0..count as u32).filter(|&i| boxes[i as usize].meets(query)).collect();
                assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn coinciding_and_flat_boxes_are_all_found() {
        let boxes = vec![Bounds { low: DVec3::ONE, high: DVec3::ONE }; 9];
        let tree = BoxTree::new(boxes.clone());
        let mut found = 0;
        tree.overlapping(&boxes[0], |_| found += 1);
        assert_eq!(found, 9);
    }
}
