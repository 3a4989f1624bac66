//! Finds the points that may interact with a position, using one grid of bins for each octave of h.
//! Also sorts points into a spatial order along a Morton curve.

use super::WIDENING;
use glam::{DVec3, IVec3};
use isoparticles_mesh::buckets::{Buckets, parts_mut};
use rayon::prelude::*;
use std::ops::Range;

/// Number of rows of bins that are sorted per parallel task. A level of the maximum extent has 2^20
/// rows, which give 4096 tasks.
const ROWS_PER_TASK: usize = 1 << 8;

/// Maximum number of bins along an axis of a level. A level has at most 2^20 rows, whose table
/// takes 4 MiB.
const MOST_BINS: f64 = 1024.0;

/// Position and size of the bins of every level.
#[derive(Clone, Debug)]
struct Grid {
    /// Lowest corner of the first bin. It is the same on every level.
    origin: DVec3,
    /// Edge length of the bins of level 0, the level of the points with the largest sizes.
    edge: f64,
    /// Largest size of a point.
    largest: f64,
    /// Number of levels. The last level also contains all points of smaller sizes.
    levels: usize,
    /// Number of bins of level 0 along each axis.
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
        // wider bins are also correct; they keep the table of rows small if all sizes are tiny
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

/// Points in bins, with one grid of bins (level) for each octave of size. The bins of a level are
/// as wide as the longest reach in its octave, so a query visits at most 27 bins per level. The
/// points of a level are sorted by bin, x fastest. A query therefore finds the points of three
/// adjacent bins of a row as one contiguous run, by binary search within the row.
#[derive(Clone, Debug)]
pub struct LevelBins {
    reach: f64,
    grid: Grid,
    levels: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    rows: [i32; 2],
    /// First entry of each row of bins (y fastest), followed by the end of the last row.
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
        let place = |&i: &u32| {
            let bin = grid.bin_of(level, points[i as usize]);
            ((bin.z * rows[0] + bin.y) as u32, bin.x as u32)
        };
        let (row_of, bin_of): (Vec<u32>, Vec<u32>) = members.par_iter().map(place).unzip();
        // group the points by row, then sort each row
        let Buckets { starts, items } = Buckets::new(&row_of, (rows[0] * rows[1]) as usize);
        drop(row_of);
        let mut entries: Vec<(u32, u32)> =
            items.into_par_iter().map(|item| (bin_of[item as usize], members[item as usize])).collect();
        drop(bin_of);
        let row_ends = |rows: &[u32]| (rows[rows.len() - 1] - rows[0]) as usize;
        let some: Vec<&[u32]> = (0..starts.len() - 1)
            .step_by(ROWS_PER_TASK)
            .map(|n| &starts[n..starts.len().min(n + ROWS_PER_TASK + 1)])
            .collect();
        let parts = parts_mut(&mut entries, some.iter().map(|rows| row_ends(rows)));
        parts.into_par_iter().zip(some).for_each(|(own, rows)| {
            for row in rows.windows(2) {
                own[(row[0] - rows[0]) as usize..(row[1] - rows[0]) as usize].sort_unstable();
            }
        });
        let (bins, points) = entries.into_par_iter().unzip();
        Self { rows, starts, bins, points }
    }

    /// Calls `visit` with every run of entries in the bins from `low` to `high`, inclusive.
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
    /// Sorts the points into bins. Two points interact if they are closer to each other than
    /// `reach` times the smaller of their sizes. Sizes must be positive and finite.
    pub fn new(points: &[DVec3], sizes: &[f64], reach: f64) -> Self {
        let grid = Grid::new(points, sizes, reach);
        let level_of: Vec<u32> = sizes.par_iter().map(|&h| grid.level_of(h) as u32).collect();
        let Buckets { starts, items } = Buckets::new(&level_of, grid.levels);
        drop(level_of);
        let members: Vec<&[u32]> = starts.windows(2).map(|own| &items[own[0] as usize..own[1] as usize]).collect();
        let levels = members.par_iter().enumerate().map(|(l, members)| Level::new(&grid, l, members, points)).collect();
        Self { reach, grid, levels }
    }

    /// Calls `visit` with every point whose distance from `centre` may be at most `reach` times the
    /// smaller of `size` and the size of the point. Some points farther away are also visited, so
    /// the caller must check the distance. The order is fixed: by level, bin and index.
    pub fn visit(&self, centre: DVec3, size: f64, mut visit: impl FnMut(u32)) {
        for (l, level) in self.levels.iter().enumerate() {
            // slightly more than the reach, to allow for rounding
            let radius = (self.reach * size * (1.0 + WIDENING)).min(self.grid.edge_of(l));
            let (low, high) = (self.grid.bin_of(l, centre - radius), self.grid.bin_of(l, centre + radius));
            level.runs(low, high, |run| level.points[run].iter().for_each(|&i| visit(i)));
        }
    }
}

/// Returns an order of the points in which consecutive points are close to each other. The order
/// follows a Morton curve whose cells are a quarter as wide as the finest bins. The finest bins are
/// about as wide as the smallest reach, or a thousandth of the extent if that is larger.
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

/// Spreads the low 21 bits of a number over every third bit of the result.
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
