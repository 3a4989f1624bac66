//! Who lies near whom: fixed-radius queries over points whose radii differ.
//!
//! [`NeighbourLists`] lists the neighbours of every point by a tree of boxes over the points in order of place, eight to a box: all of a query's work is on
//! lanes that follow each other in memory. [`LevelBins`] answers for places that are no points, by a grid of bins for each octave of h.
//! Either way a query looks at no more where h is graded, whatever its contrast, where the paper's one global bin edge
//! max(h) (its own stated limitation) makes the fine regions pay for the coarse ones.

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

/// Points in bins, one grid of bins for each octave of size: a point of size h goes to the level of its octave of h, whose bins are as wide as the longest reach in that
/// octave, so a query looks at no more than 27 bins a level. In a level the points are sorted
/// by bin, x fastest: the three bins of a row are one contiguous run, found by bisection from a table of rows.
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
}

/// An order of the points in which neighbours lie near each other: along a Morton curve over quarters of the smallest reaches, or of a thousandth of the extent where that is more.
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

/// Points that one lane operation works on.
const LANES: usize = 8;

/// Eight points that follow each other, filled up with points infinitely far.
#[derive(Clone, Copy)]
struct Run {
    /// Coordinates, axis by axis.
    place: [[f64; LANES]; 3],
    reach: [f64; LANES],
    number: [u32; LANES],
}

impl Run {
    const NOBODY: Self = Self { place: [[f64::INFINITY; LANES]; 3], reach: [0.0; LANES], number: [u32::MAX; LANES] };
}

/// Eight boxes that follow each other, of runs or of eights of boxes, filled up with empty ones.
#[derive(Clone, Copy)]
struct Boxes {
    low: [[f64; LANES]; 3],
    high: [[f64; LANES]; 3],
    /// The longest reach in each.
    reach: [f64; LANES],
}

/// One of [`Boxes`].
#[derive(Clone, Copy)]
struct BoundingBox {
    low: DVec3,
    high: DVec3,
    reach: f64,
}

/// Points in their order, in a tree of boxes of eight each. Queries are quick where points that follow each other are near each other.
struct Tree {
    runs: Vec<Run>,
    /// The box of each run, and of each eight of these.
    boxes: Vec<BoundingBox>,
    eights: Vec<BoundingBox>,
    /// From the boxes of runs to the eight or less that hold everything.
    levels: Vec<Vec<Boxes>>,
}

impl Tree {
    fn new(points: &[DVec3], sizes: &[f64], reach: f64) -> Self {
        let run = |(n, (points, sizes)): (usize, (&[DVec3], &[f64]))| {
            let mut run = Run::NOBODY;
            let mut all = BoundingBox { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY, reach: 0.0 };
            for (lane, (&p, &h)) in points.iter().zip(sizes).enumerate() {
                (0..3).for_each(|axis| run.place[axis][lane] = p[axis]);
                (run.reach[lane], run.number[lane]) = (reach * h, (n * LANES + lane) as u32);
                // by a little more than the reach, against rounding
                let radius = reach * h * (1.0 + WIDENING);
                all = BoundingBox { low: all.low.min(p), high: all.high.max(p), reach: all.reach.max(radius) };
            }
            (run, all)
        };
        let (runs, boxes): (Vec<Run>, Vec<BoundingBox>) =
            points.par_chunks(LANES).zip(sizes.par_chunks(LANES)).enumerate().map(run).unzip();
        let (first, eights): (Vec<Boxes>, Vec<BoundingBox>) = boxes.par_chunks(LANES).map(Boxes::of).unzip();
        let mut levels = vec![first];
        let mut below = eights.clone();
        while below.len() > 1 {
            let (level, above) = below.par_chunks(LANES).map(Boxes::of).unzip();
            levels.push(level);
            below = above;
        }
        Self { runs, boxes, eights, levels }
    }

    /// Whether runs, and eights of runs, are about as small as points on a surface in order of place have them, most of them.
    fn is_compact(&self) -> bool {
        let extent = |own: &BoundingBox| (own.high - own.low).max_element() / own.reach;
        let all = [(&self.boxes, MOST_EXTENT), (&self.eights, MOST_EXTENT_OF_EIGHT)];
        all.into_iter().all(|(boxes, most)| boxes.iter().map(extent).sum::<f64>() <= most * boxes.len() as f64)
    }

    /// The runs with points that may be within reach of those of a box, ascending, into the first of two lists; the second is for boxes on the way.
    #[inline(always)]
    fn near<S: Simd>(&self, simd: S, of: &BoundingBox, found: &mut Vec<u32>, next: &mut Vec<u32>) {
        found.clear();
        found.push(0);
        for level in self.levels.iter().rev() {
            next.clear();
            for &n in &*found {
                let mut meets = level[n as usize].meet(simd, of);
                while meets != 0 {
                    next.push(n * LANES as u32 + meets.trailing_zeros());
                    meets &= meets - 1;
                }
            }
            std::mem::swap(found, next);
        }
    }
}

impl Boxes {
    /// Some boxes, and the one around them.
    fn of(boxes: &[BoundingBox]) -> (Self, BoundingBox) {
        let mut new =
            Self { low: [[f64::INFINITY; LANES]; 3], high: [[f64::NEG_INFINITY; LANES]; 3], reach: [0.0; LANES] };
        let mut all = BoundingBox { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY, reach: 0.0 };
        for (lane, own) in boxes.iter().enumerate() {
            (0..3).for_each(|axis| (new.low[axis][lane], new.high[axis][lane]) = (own.low[axis], own.high[axis]));
            new.reach[lane] = own.reach;
            all = BoundingBox {
                low: all.low.min(own.low),
                high: all.high.max(own.high),
                reach: all.reach.max(own.reach),
            };
        }
        (new, all)
    }

    /// Bits of the boxes no farther from another along any axis than the smaller of the two reaches.
    #[inline(always)]
    fn meet<S: Simd>(&self, simd: S, other: &BoundingBox) -> u64 {
        meet(simd, [&self.low, &self.high], &self.reach, other)
    }
}

/// Bits of the boxes (lowest and highest corners) no farther from another along any axis than the smaller of the two reaches.
#[inline(always)]
fn meet<S: Simd>(simd: S, [low, high]: [&[[f64; LANES]; 3]; 2], reach: &[f64; LANES], other: &BoundingBox) -> u64 {
    let reach = f64x8::simd_from(simd, *reach).min(other.reach);
    let mut meets = u64::MAX;
    for axis in 0..3 {
        let below = (f64x8::simd_from(simd, low[axis]) - reach).simd_le(other.high[axis]);
        let above = (f64x8::simd_from(simd, high[axis]) + reach).simd_ge(other.low[axis]);
        meets &= below.to_bitmask() & above.to_bitmask();
    }
    meets
}

/// The points that those of a run may interact with.
#[derive(Default)]
struct Candidates {
    runs: Vec<Run>,
    /// Runs of the tree, and boxes on the way to them.
    near: [Vec<u32>; 2],
    /// Numbers of the points near another, with room for eight more.
    found: Vec<u32>,
}

impl Candidates {
    /// Collects the points within reach of a run's box, ascending.
    #[inline(always)]
    fn collect<S: Simd>(&mut self, simd: S, tree: &Tree, run: usize) {
        let own = &tree.boxes[run];
        let [near, next] = &mut self.near;
        tree.near(simd, own, near, next);
        self.runs.clear();
        self.runs.resize(near.len(), Run::NOBODY);
        let mut count = 0;
        for &n in &*near {
            let from = &tree.runs[n as usize];
            let mut meets = meet(simd, [&from.place; 2], &from.reach, own);
            while meets != 0 {
                let lane = meets.trailing_zeros() as usize;
                let (to, at) = (&mut self.runs[count / LANES], count % LANES);
                (0..3).for_each(|axis| to.place[axis][at] = from.place[axis][lane]);
                (to.reach[at], to.number[at]) = (from.reach[lane], from.number[lane]);
                count += 1;
                meets &= meets - 1;
            }
        }
        self.runs.truncate(count.div_ceil(LANES));
        self.found.resize(self.found.len().max(count + LANES), 0);
    }

    /// The candidates nearer to `p` than the smaller of the two reaches, the point itself included, ascending.
    ///
    /// Each lane is written whether it is near or not, and the next one over it where it is not: a branch for each would be a guess, wrong every other time.
    #[inline(always)]
    fn near<S: Simd>(&mut self, simd: S, p: DVec3, radius: f64) -> &[u32] {
        let mut count = 0;
        for run in &self.runs {
            let along = |axis: usize| f64x8::simd_from(simd, run.place[axis]) - p[axis];
            let (x, y, z) = (along(0), along(1), along(2));
            let reach = f64x8::simd_from(simd, run.reach).min(radius);
            let near = (x * x + y * y + z * z).simd_lt(reach * reach).to_bitmask();
            let room = self.found[count..].first_chunk_mut::<LANES>().expect("room for eight more than all candidates");
            let mut written = 0;
            for (lane, &number) in run.number.iter().enumerate() {
                room[written % LANES] = number;
                written += near as usize >> lane & 1;
            }
            count += written;
        }
        &self.found[..count]
    }
}

/// Points whose runs extend on average farther than so many reaches are put in order first; those of particles in order of place extend 1.7 to 2.1.
const MOST_EXTENT: f64 = 4.0;

/// The same of eight runs, whose area is that of eight.
const MOST_EXTENT_OF_EIGHT: f64 = 12.0;

/// Points of a block of [`NeighbourLists::independent_blocks`]: what a pass reads of so many and those around them stays in the first caches of a
/// core, and a few thousand points make enough blocks for all cores.
pub const BLOCK: usize = 128;

/// Points whose lists are made and kept together: some for each core, and a multiple of [`BLOCK`] and of [`LANES`].
const CHUNK: usize = 16 * BLOCK;

/// Neighbours of every point.
#[derive(Clone, Debug, Default)]
pub struct NeighbourLists {
    count: usize,
    /// The lists of [`CHUNK`] points each.
    chunks: Vec<Lists>,
}

/// Lists of some points, in order.
#[derive(Clone, Debug)]
struct Lists {
    /// Where each begins, and the end of the last.
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl NeighbourLists {
    /// Lists, for each point i, the others j nearer than `reach * min(h_i, h_j)` that `accept(i, j)` lets pass. Sizes must be positive and finite. It is quickest where the points
    /// are in order of place ([`space_order`]).
    pub fn new(points: &[DVec3], sizes: &[f64], reach: f64, accept: impl Fn(usize, usize) -> bool + Sync) -> Self {
        let tree = Tree::new(points, sizes, reach);
        if tree.is_compact() {
            return Self::of_tree(&tree, points, sizes, reach, accept);
        }
        let order = space_order(points, sizes, reach);
        let place_of = |n: &u32| points[*n as usize];
        let (points, sizes): (Vec<DVec3>, Vec<f64>) = order.iter().map(|n| (place_of(n), sizes[*n as usize])).unzip();
        let number = |n: usize| order[n] as usize;
        let tree = Tree::new(&points, &sizes, reach);
        let ordered = Self::of_tree(&tree, &points, &sizes, reach, |i, j| accept(number(i), number(j)));
        let mut rank = vec![0; order.len()];
        order.iter().enumerate().for_each(|(n, &i)| rank[i as usize] = n);
        Self::of_chunks(order.len(), |range, lists| {
            for i in range {
                lists.members.extend(ordered.of(rank[i]).iter().map(|&j| order[j as usize]));
                lists.starts.push(lists.members.len() as u32);
            }
        })
    }

    fn of_tree(
        tree: &Tree,
        points: &[DVec3],
        sizes: &[f64],
        reach: f64,
        accept: impl Fn(usize, usize) -> bool + Sync,
    ) -> Self {
        Self::of_chunks(points.len(), |range, lists| {
            dispatch!(Instructions::new(), simd => append_lists(simd, range, tree, points, sizes, reach, &accept, lists));
        })
    }

    /// Lists of so many points, made a chunk at a time.
    fn of_chunks(count: usize, append: impl Fn(Range<usize>, &mut Lists) + Sync) -> Self {
        let lists_of = |chunk: usize| {
            let range = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
            let mut lists =
                Lists { starts: Vec::with_capacity(range.len() + 1), members: Vec::with_capacity(range.len() * 20) };
            lists.starts.push(0);
            append(range, &mut lists);
            lists
        };
        Self { count, chunks: (0..count.div_ceil(CHUNK)).into_par_iter().map(lists_of).collect() }
    }

    /// Neighbours of point i.
    #[inline]
    pub fn of(&self, i: usize) -> &[u32] {
        let (lists, i) = (&self.chunks[i / CHUNK], i % CHUNK);
        &lists.members[lists.starts[i] as usize..lists.starts[i + 1] as usize]
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Mean number of neighbours.
    pub fn mean_count(&self) -> f64 {
        self.chunks.iter().map(|lists| lists.members.len()).sum::<usize>() as f64 / self.count.max(1) as f64
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
                let (mut seen, mut last) = (Vec::new(), block as u32);
                let own = block * BLOCK..self.len().min((block + 1) * BLOCK);
                for j in own.flat_map(|i| self.of(i)) {
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

/// Appends the lists of some points that begin with a run.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "a closure's body, so that it is compiled for each instruction set")]
fn append_lists<S: Simd>(
    simd: S,
    range: Range<usize>,
    tree: &Tree,
    points: &[DVec3],
    sizes: &[f64],
    reach: f64,
    accept: &impl Fn(usize, usize) -> bool,
    lists: &mut Lists,
) {
    let mut candidates = Candidates::default();
    for run in range.clone().step_by(LANES) {
        candidates.collect(simd, tree, run / LANES);
        for i in run..range.end.min(run + LANES) {
            for &j in candidates.near(simd, points[i], reach * sizes[i]) {
                if j as usize != i && accept(i, j as usize) {
                    lists.members.push(j);
                }
            }
            lists.starts.push(lists.members.len() as u32);
        }
    }
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
        let mut ways = [0; 2];
        for (count, contrast, reach) in [
            (0, 1.0, 1.9),
            (1, 1.0, 1.9),
            (2, 1.0, 1.9),
            (500, 1.0, 1.9),
            (500, 3.0, 1.9),
            (800, 27.0, 1.9),
            (800, 1e-4, 1.9),
            (800, 1e4, 1.9),
            (501, 1.0, 8.0),
            (801, 3.0, 8.0),
            (CHUNK as u64 + 5, 1.0, 5.0),
        ] {
            let (points, sizes) = scene(count, contrast);
            let in_order = space_order(&points, &sizes, reach);
            for order in [(0..count as u32).collect(), in_order] {
                let points: Vec<DVec3> = order.iter().map(|&i| points[i as usize]).collect();
                let sizes: Vec<f64> = order.iter().map(|&i| sizes[i as usize]).collect();
                if count >= 500 {
                    ways[usize::from(Tree::new(&points, &sizes, reach).is_compact())] += 1;
                }
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
        assert!(ways.iter().all(|&count| count > 2), "{ways:?}: put in order first, and not");
    }

    #[test]
    fn places_are_told_all_points_within_reach_at_any_contrast() {
        for (count, contrast) in [(0, 1.0), (1, 1.0), (500, 1.0), (500, 3.0), (800, 27.0), (800, 1e-4), (800, 1e4)] {
            let (points, sizes) = scene(count, contrast);
            let reach = 1.9;
            let bins = LevelBins::new(&points, &sizes, reach);
            for n in 0..200 {
                let centre = DVec3::new(uniform(2, 0, n), uniform(2, 1, n), uniform(2, 2, n)) * 1.2 - 0.1;
                let size = 0.02 * contrast.powf(uniform(2, 3, n));
                let mut told = Vec::new();
                bins.visit(centre, size, |i| told.push(i));
                let near = |i: &usize| points[*i].distance(centre) < reach * size.min(sizes[*i]);
                assert!(
                    (0..points.len()).filter(near).all(|i| told.contains(&(i as u32))),
                    "{n} of {count}, {contrast}"
                );
                told.sort_unstable();
                assert!(told.windows(2).all(|pair| pair[0] < pair[1]), "one is told twice");
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
