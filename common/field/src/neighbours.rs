//! Who lies near whom: fixed-radius queries over points whose radii differ, by several levels of bins.
//!
//! A point of size h goes to the level of its octave of h, whose bins are as wide as the longest reach in that octave.
//! So a query looks at no more than 27 bins a level however strongly h is graded, where the paper's one global bin edge
//! max(h) (its own stated limitation) makes the fine regions pay for the coarse ones. In a level the points are sorted
//! by bin, x fastest: the three bins of a row are one contiguous run, found by bisection from a table of rows. The bins of a level are
//! half as wide as those of the level before and share their borders, so the points of a bin have one set of runs in every level.

use fearless_simd::{Level as Instructions, Simd, dispatch, f64x8, prelude::*};
use glam::{DVec3, IVec3};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::ops::Range;

/// Most bins along an axis of a level.
const MOST_BINS: f64 = 1024.0;

/// Bins are wider than reaches by this share, so that rounding puts no interaction beyond the next bin.
const WIDENING: f64 = 1e-9;

/// Where the bins of every level lie.
#[derive(Clone, Debug)]
struct Grid {
    /// Of every level's first bin.
    origin: DVec3,
    /// Edge of the bins of level 0, those of the largest points.
    edge: f64,
    /// Size of the largest point.
    largest: f64,
    /// Number of levels; the last holds all smaller points, too.
    levels: usize,
    /// Bins of level 0 along each axis.
    bins: IVec3,
}

impl Grid {
    fn new(points: &[DVec3], sizes: &[f64], reach: f64) -> Self {
        let low = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let (smallest, largest) =
            sizes.iter().fold((f64::INFINITY, 0.0f64), |(low, high), &h| (low.min(h), high.max(h)));
        if points.is_empty() {
            return Self { origin: DVec3::ZERO, edge: 1.0, largest, levels: 0, bins: IVec3::ZERO };
        }
        let extent = (high - low).max_element();
        // wider bins are right as well, and the table of rows stays small where a few points are tiny
        let edge = (reach * largest * (1.0 + WIDENING)).max(extent / MOST_BINS);
        let allowed = (edge * MOST_BINS / extent.max(edge)).log2().floor();
        let levels = (largest / smallest).log2().floor().min(allowed) as usize + 1;
        let origin = (low / edge).floor() * edge;
        Self { origin, edge, largest, levels, bins: ((high - origin) / edge).floor().as_ivec3() + 1 }
    }

    fn level_of(&self, size: f64) -> usize {
        ((self.largest / size).log2() as usize).min(self.levels - 1)
    }

    fn edge_of(&self, level: usize) -> f64 {
        self.edge / f64::powi(2.0, level as i32)
    }

    fn bin_of(&self, level: usize, point: DVec3) -> IVec3 {
        ((point - self.origin) / self.edge_of(level)).floor().as_ivec3()
    }
}

/// Points in bins, one grid of bins for each octave of size.
#[derive(Clone, Debug)]
pub struct LevelBins {
    reach: f64,
    grid: Grid,
    levels: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    rows: [i32; 2],
    /// First entry of each row of bins (y fastest), and the end.
    starts: Vec<u32>,
    /// Bin along x of each entry; entries are sorted by row, then bin, then point.
    bins: Vec<u32>,
    points: Vec<u32>,
}

impl Level {
    fn new(grid: &Grid, level: usize, members: &[u32], points: &[DVec3]) -> Self {
        if members.is_empty() {
            return Self { rows: [0, 0], starts: vec![0], bins: Vec::new(), points: Vec::new() };
        }
        let bins = grid.bins << level as i32;
        let rows = [bins.y, bins.z];
        let keyed: Vec<(u32, u32, u32)> = members
            .iter()
            .map(|&i| {
                let b = grid.bin_of(level, points[i as usize]);
                ((b.z * rows[0] + b.y) as u32, b.x as u32, i)
            })
            .collect();
        // a counting sort by row, then each row by itself
        let mut ends = vec![0u32; (rows[0] * rows[1]) as usize + 1];
        for &(row, ..) in &keyed {
            ends[row as usize + 1] += 1;
        }
        for row in 1..ends.len() {
            ends[row] += ends[row - 1];
        }
        let starts = ends.clone();
        let mut entries = vec![(0, 0); keyed.len()];
        for (row, bin, i) in keyed {
            let at = &mut ends[row as usize];
            entries[*at as usize] = (bin, i);
            *at += 1;
        }
        for row in starts.windows(2) {
            entries[row[0] as usize..row[1] as usize].sort_unstable();
        }
        let (bins, points) = entries.into_iter().unzip();
        Self { rows, starts, bins, points }
    }

    /// Calls `visit` with every run of entries in the bins from `low` to `high`.
    #[inline]
    fn runs(&self, low: IVec3, high: IVec3, mut visit: impl FnMut(Range<usize>)) {
        if self.points.is_empty() || high.min_element() < 0 {
            return;
        }
        let (x0, x1) = (low.x.max(0) as u32, high.x as u32);
        for z in low.z.max(0)..(high.z + 1).min(self.rows[1]) {
            for y in low.y.max(0)..(high.y + 1).min(self.rows[0]) {
                let row = (z * self.rows[0] + y) as usize;
                let (start, end) = (self.starts[row] as usize, self.starts[row + 1] as usize);
                let bins = &self.bins[start..end];
                let first = bins.partition_point(|&b| b < x0);
                let count = bins[first..].iter().take_while(|&&b| b <= x1).count();
                if count > 0 {
                    visit(start + first..start + first + count);
                }
            }
        }
    }
}

impl LevelBins {
    /// Bins the points; two points interact when nearer than `reach` times the smaller of their sizes. Sizes must be
    /// positive and finite.
    pub fn new(points: &[DVec3], sizes: &[f64], reach: f64) -> Self {
        let grid = Grid::new(points, sizes, reach);
        let mut members: Vec<Vec<u32>> = vec![Vec::new(); grid.levels];
        for (i, &h) in sizes.iter().enumerate() {
            members[grid.level_of(h)].push(i as u32);
        }
        let levels = members.par_iter().enumerate().map(|(l, members)| Level::new(&grid, l, members, points)).collect();
        Self { reach, grid, levels }
    }

    /// Calls `visit` with every point that may lie within `reach * min(size, its size)` of `centre` (and a few more: the
    /// caller measures). The order is fixed: by level, bin, index.
    pub fn visit(&self, centre: DVec3, size: f64, mut visit: impl FnMut(u32)) {
        for (l, level) in self.levels.iter().enumerate() {
            // by a little more than the reach, against rounding
            let radius = (self.reach * size * (1.0 + WIDENING)).min(self.grid.edge_of(l));
            let (low, high) = (self.grid.bin_of(l, centre - radius), self.grid.bin_of(l, centre + radius));
            level.runs(low, high, |run| level.points[run].iter().for_each(|&i| visit(i)));
        }
    }

    /// Every run of entries that may interact with points of a bin: the level's number and the entries.
    fn runs_near(&self, own: usize, bin: IVec3, mut visit: impl FnMut(&Level, Range<usize>)) {
        for (l, level) in self.levels.iter().enumerate() {
            // one bin of the finer of the two levels farther, on each side
            let (low, high) = if l >= own {
                let finer = (l - own) as i32;
                ((bin << finer) - 1, (bin + 1) << finer)
            } else {
                let coarser = (own - l) as i32;
                ((bin - 1) >> coarser, (bin + 1) >> coarser)
            };
            level.runs(low, high, |run| visit(level, run));
        }
    }
}

/// An order of the points in which neighbours lie near each other, and the points of a bin of [`LevelBins`] side by side: along a Morton curve
/// over quarters of the smallest bins.
pub fn space_order(points: &[DVec3], sizes: &[f64], reach: f64) -> Vec<u32> {
    let grid = Grid::new(points, sizes, reach);
    let mut keyed: Vec<(u64, u32)> = points
        .par_iter()
        .enumerate()
        .map(|(i, &p)| {
            let [x, y, z] = grid.bin_of(grid.levels + 1, p).to_array().map(|bin| spread(bin as u64));
            (x | y << 1 | z << 2, i as u32)
        })
        .collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// Spreads the low 21 bits of a number to every third bit.
fn spread(x: u64) -> u64 {
    let mut x = x & 0x1f_ffff;
    for (shift, mask) in [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ] {
        x = (x | x << shift) & mask;
    }
    x
}

/// The points that those of one bin may interact with, eight to a lane operation.
#[derive(Default)]
struct Candidates {
    /// The bin: level and place.
    of: Option<(usize, IVec3)>,
    points: Vec<u32>,
    /// Coordinates and squared reaches, filled up to eight with points infinitely far.
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    squared: Vec<f64>,
}

impl Candidates {
    /// Collects those of a bin unless they are there.
    fn collect(&mut self, bins: &LevelBins, of: (usize, IVec3), points: &[DVec3], sizes: &[f64]) {
        if self.of == Some(of) {
            return;
        }
        self.of = Some(of);
        self.points.clear();
        for lanes in [&mut self.x, &mut self.y, &mut self.z, &mut self.squared] {
            lanes.clear();
        }
        bins.runs_near(of.0, of.1, |level, run| self.points.extend_from_slice(&level.points[run]));
        for &i in &self.points {
            let (p, radius) = (points[i as usize], bins.reach * sizes[i as usize]);
            self.x.push(p.x);
            self.y.push(p.y);
            self.z.push(p.z);
            self.squared.push(radius * radius);
        }
        let count = self.points.len().next_multiple_of(8);
        self.points.resize(count, u32::MAX);
        for lanes in [&mut self.x, &mut self.y, &mut self.z, &mut self.squared] {
            lanes.resize(count, f64::INFINITY);
        }
    }

    /// Calls `visit` with every candidate nearer to `p` than the smaller of the two reaches, the point itself included.
    #[inline(always)]
    fn near<S: Simd>(&self, simd: S, p: DVec3, radius: f64, mut visit: impl FnMut(u32)) {
        for at in (0..self.points.len()).step_by(8) {
            let along = |lanes: &[f64], p: f64| f64x8::from_slice(simd, &lanes[at..at + 8]) - p;
            let (x, y, z) = (along(&self.x, p.x), along(&self.y, p.y), along(&self.z, p.z));
            let reach = f64x8::from_slice(simd, &self.squared[at..at + 8]).min(radius * radius);
            let mut near = (x * x + y * y + z * z).simd_lt(reach).to_bitmask();
            while near != 0 {
                visit(self.points[at + near.trailing_zeros() as usize]);
                near &= near - 1;
            }
        }
    }
}

/// Points of a block of [`NeighbourLists::independent_blocks`]: what a pass reads of so many and those around them stays in the first caches of a
/// core, and a few thousand points make enough blocks for all cores.
pub const BLOCK: usize = 128;

/// Neighbours of every point, as rows of one contiguous array.
#[derive(Clone, Debug, Default)]
pub struct NeighbourLists {
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl NeighbourLists {
    /// Lists, for each point i, the others j nearer than `reach * min(h_i, h_j)` that `accept(i, j)` lets pass.
    pub fn new(points: &[DVec3], sizes: &[f64], reach: f64, accept: impl Fn(usize, usize) -> bool + Sync) -> Self {
        let bins = LevelBins::new(points, sizes, reach);
        const CHUNK: usize = 2048;
        let chunks: Vec<(Vec<u32>, Vec<u32>)> = (0..points.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let range = chunk * CHUNK..points.len().min((chunk + 1) * CHUNK);
                dispatch!(Instructions::new(), simd => lists_of(simd, range, &bins, points, sizes, &accept))
            })
            .collect();
        let mut starts = Vec::with_capacity(points.len() + 1);
        let mut members = Vec::with_capacity(chunks.iter().map(|c| c.1.len()).sum());
        starts.push(0);
        for (counts, part) in chunks {
            for count in counts {
                starts.push(starts[starts.len() - 1] + count);
            }
            members.extend(part);
        }
        Self { starts, members }
    }

    /// Neighbours of point i.
    pub fn of(&self, i: usize) -> &[u32] {
        &self.members[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Mean number of neighbours.
    pub fn mean_count(&self) -> f64 {
        self.members.len() as f64 / self.len().max(1) as f64
    }

    /// Cuts the points into blocks of [`BLOCK`] consecutive ones, and the blocks into classes: no point of a block has a neighbour in another block
    /// of its class (greedy colouring, the smallest free colour). So the blocks of one class can be worked on at the same time, the points of
    /// a block one after the other, without one seeing the other move, whatever the contrast of h: the paper's rule (section 4) that no overlapping
    /// neighbourhoods run together. The points should be in order of place ([`space_order`]).
    pub fn independent_blocks(&self) -> Vec<Vec<u32>> {
        let blocks = self.len().div_ceil(BLOCK);
        let seen: Vec<Vec<u32>> = (0..blocks)
            .into_par_iter()
            .map(|block| {
                let members =
                    self.starts[block * BLOCK] as usize..self.starts[self.len().min((block + 1) * BLOCK)] as usize;
                let (mut seen, mut last) = (Vec::new(), block as u32);
                for j in &self.members[members] {
                    let other = j / BLOCK as u32;
                    // the blocks after this one have no colour yet
                    if other != last && (other as usize) < block {
                        seen.push(other);
                    }
                    last = other;
                }
                seen.sort_unstable();
                seen.dedup();
                seen
            })
            .collect();
        let mut colour = Vec::with_capacity(blocks);
        let mut classes: Vec<Vec<u32>> = Vec::new();
        for (block, seen) in seen.iter().enumerate() {
            let taken: BTreeSet<usize> = seen.iter().map(|&other| colour[other as usize]).collect();
            let free = (0..classes.len()).find(|c| !taken.contains(c)).unwrap_or(classes.len());
            if free == classes.len() {
                classes.push(Vec::new());
            }
            classes[free].push(block as u32);
            colour.push(free);
        }
        classes
    }
}

/// Lengths of the lists of some points, and the lists.
#[inline(always)]
fn lists_of<S: Simd>(
    simd: S,
    range: Range<usize>,
    bins: &LevelBins,
    points: &[DVec3],
    sizes: &[f64],
    accept: &impl Fn(usize, usize) -> bool,
) -> (Vec<u32>, Vec<u32>) {
    let (mut counts, mut members) = (Vec::with_capacity(range.len()), Vec::with_capacity(range.len() * 20));
    let mut candidates = Candidates::default();
    for i in range {
        let before = members.len();
        let (p, h) = (points[i], sizes[i]);
        let level = bins.grid.level_of(h);
        candidates.collect(bins, (level, bins.grid.bin_of(level, p)), points, sizes);
        candidates.near(simd, p, bins.reach * h, |j| {
            if j as usize != i && accept(i, j as usize) {
                members.push(j);
            }
        });
        counts.push((members.len() - before) as u32);
    }
    (counts, members)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;

    fn scene(count: u64, contrast: f64) -> (Vec<DVec3>, Vec<f64>) {
        let points = (0..count).map(|n| DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n))).collect();
        let sizes = (0..count).map(|n| 0.02 * contrast.powf(uniform(1, 3, n))).collect();
        (points, sizes)
    }

    #[test]
    fn lists_equal_brute_force_at_any_contrast() {
        for (count, contrast) in
            [(0, 1.0), (1, 1.0), (2, 1.0), (500, 1.0), (500, 3.0), (800, 27.0), (800, 1e-4), (800, 1e4)]
        {
            let (points, sizes) = scene(count, contrast);
            let reach = 1.9;
            let lists = NeighbourLists::new(&points, &sizes, reach, |i, j| (i + j) % 7 != 0);
            assert_eq!(lists.len(), points.len());
            for i in 0..points.len() {
                let want: Vec<u32> = (0..points.len())
                    .filter(|&j| {
                        j != i && (i + j) % 7 != 0 && points[i].distance(points[j]) < reach * sizes[i].min(sizes[j])
                    })
                    .map(|j| j as u32)
                    .collect();
                let mut got = lists.of(i).to_vec();
                got.sort_unstable();
                assert_eq!(got, want, "point {i} of {count} at contrast {contrast}");
            }
        }
    }

    #[test]
    fn no_two_neighbours_are_in_two_blocks_of_a_class() {
        for (count, contrast) in [(0, 1.0), (1, 1.0), (BLOCK as u64, 1.0), (5000, 1.0), (5000, 9.0)] {
            let (points, sizes) = scene(count, contrast);
            let order = space_order(&points, &sizes, 2.0);
            let mut once = order.clone();
            once.sort_unstable();
            assert!(once.iter().copied().eq(0..count as u32));
            let points: Vec<DVec3> = order.iter().map(|&i| points[i as usize]).collect();
            let sizes: Vec<f64> = order.iter().map(|&i| sizes[i as usize]).collect();
            let lists = NeighbourLists::new(&points, &sizes, 2.0, |_, _| true);
            let classes = lists.independent_blocks();
            assert_eq!(classes.iter().map(Vec::len).sum::<usize>(), points.len().div_ceil(BLOCK));
            println!("{} blocks in {} classes", points.len().div_ceil(BLOCK), classes.len());
            let mut class_of = vec![usize::MAX; points.len().div_ceil(BLOCK)];
            for (c, class) in classes.iter().enumerate() {
                class.iter().for_each(|&block| class_of[block as usize] = c);
            }
            for i in 0..points.len() {
                for &j in lists.of(i) {
                    let (a, b) = (i / BLOCK, j as usize / BLOCK);
                    assert!(a == b || class_of[a] != class_of[b], "{i} and {j}");
                }
            }
        }
    }
}
