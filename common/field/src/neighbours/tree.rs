//! A tree of boxes over consecutive points, with eight points per box. Queries use SIMD to find the
//! points that may be near the points of a box.

use super::WIDENING;
use fearless_simd::{Simd, f64x8, prelude::*};
use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;

/// Number of points per SIMD operation: eight doubles fill a vector register of 512 bits.
pub(super) const LANES: usize = 8;

/// Eight consecutive points. A shorter run is padded with points at infinity.
#[derive(Clone, Copy, Debug)]
struct Run {
    /// Coordinates of the points, axis by axis.
    place: [[f64; LANES]; 3],
    reach: [f64; LANES],
    number: [u32; LANES],
}

impl Run {
    const NOBODY: Self = Self { place: [[f64::INFINITY; LANES]; 3], reach: [0.0; LANES], number: [u32::MAX; LANES] };
}

/// Eight consecutive bounding boxes, either of runs or of groups of eight boxes. Missing boxes are
/// empty.
#[derive(Clone, Copy, Debug)]
struct Boxes {
    low: [[f64; LANES]; 3],
    high: [[f64; LANES]; 3],
    /// Maximum reach in each box.
    reach: [f64; LANES],
}

/// One box of [`Boxes`].
#[derive(Clone, Copy, Debug)]
struct Outline {
    bounds: Bounds,
    /// Maximum reach of the points in the box.
    reach: f64,
}

impl Outline {
    const EMPTY: Self = Self { bounds: Bounds::EMPTY, reach: 0.0 };

    fn merged(self, other: Self) -> Self {
        Self { bounds: self.bounds.merged(other.bounds), reach: self.reach.max(other.reach) }
    }

    /// Returns the length of the longest side in units of the reach.
    fn extent(&self) -> f64 {
        (self.bounds.high - self.bounds.low).max_element() / self.reach
    }
}

/// A tree of boxes over points, with eight children per box. Queries are fast if consecutive points
/// are close to each other.
#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    runs: Vec<Run>,
    /// Box of each run.
    boxes: Vec<Outline>,
    /// Whether the mean extents of runs and of groups of eight runs are at most [`MOST_EXTENT`] and
    /// [`MOST_EXTENT_OF_EIGHT`], as for points on a surface in spatial order.
    pub(super) is_compact: bool,
    /// Boxes by level, from the boxes of the runs up to a level of at most eight boxes.
    levels: Vec<Vec<Boxes>>,
}

impl Tree {
    pub(super) fn new(points: &[DVec3], sizes: &[f64], reach: f64) -> Self {
        Self::default().anew(points, sizes, reach)
    }

    /// Builds a tree like [`Self::new`]. Consumes `self` and reuses its memory.
    pub(super) fn anew(self, points: &[DVec3], sizes: &[f64], reach: f64) -> Self {
        let Self { mut runs, mut boxes, .. } = self;
        let run = |(n, (points, sizes)): (usize, (&[DVec3], &[f64]))| {
            let mut run = Run::NOBODY;
            let mut all = Outline::EMPTY;
            for (lane, (&p, &h)) in points.iter().zip(sizes).enumerate() {
                (0..3).for_each(|axis| run.place[axis][lane] = p[axis]);
                (run.reach[lane], run.number[lane]) = (reach * h, (n * LANES + lane) as u32);
                // slightly more than the reach, to allow for rounding
                all = all.merged(Outline { bounds: Bounds { low: p, high: p }, reach: reach * h * (1.0 + WIDENING) });
            }
            (run, all)
        };
        let all = points.par_chunks(LANES).zip(sizes.par_chunks(LANES)).enumerate();
        all.map(run).unzip_into_vecs(&mut runs, &mut boxes);
        let (first, eights): (Vec<Boxes>, Vec<Outline>) = boxes.par_chunks(LANES).map(Boxes::of).unzip();
        let is_small =
            |boxes: &[Outline], most: f64| boxes.iter().map(Outline::extent).sum::<f64>() <= most * boxes.len() as f64;
        let is_compact = is_small(&boxes, MOST_EXTENT) && is_small(&eights, MOST_EXTENT_OF_EIGHT);
        let mut levels = vec![first];
        let mut below = eights;
        while below.len() > 1 {
            let (level, above) = below.par_chunks(LANES).map(Boxes::of).unzip();
            levels.push(level);
            below = above;
        }
        Self { runs, boxes, is_compact, levels }
    }

    /// Finds the runs with points that may be within reach of the points of a box, and stores them
    /// in `found` in ascending order. `next` is scratch space.
    #[inline(always)]
    fn near<S: Simd>(&self, simd: S, of: &Outline, found: &mut Vec<u32>, next: &mut Vec<u32>) {
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
    /// Packs up to eight boxes. Also returns their bounding box.
    fn of(boxes: &[Outline]) -> (Self, Outline) {
        let mut new =
            Self { low: [[f64::INFINITY; LANES]; 3], high: [[f64::NEG_INFINITY; LANES]; 3], reach: [0.0; LANES] };
        for (lane, own) in boxes.iter().enumerate() {
            let Bounds { low, high } = own.bounds;
            (0..3).for_each(|axis| (new.low[axis][lane], new.high[axis][lane]) = (low[axis], high[axis]));
            new.reach[lane] = own.reach;
        }
        (new, boxes.iter().copied().fold(Outline::EMPTY, Outline::merged))
    }

    /// Returns a bit mask of the boxes whose distance from `other` along every axis is at most the
    /// smaller of the two reaches.
    #[inline(always)]
    fn meet<S: Simd>(&self, simd: S, other: &Outline) -> u64 {
        meet(simd, [&self.low, &self.high], &self.reach, other)
    }
}

/// Returns a bit mask of the boxes whose distance from `other` along every axis is at most the
/// smaller of the two reaches. The boxes are given by their lowest and highest corners.
#[inline(always)]
fn meet<S: Simd>(simd: S, [low, high]: [&[[f64; LANES]; 3]; 2], reach: &[f64; LANES], other: &Outline) -> u64 {
    let reach = f64x8::simd_from(simd, *reach).min(other.reach);
    let mut meets = u64::MAX;
    for axis in 0..3 {
        let below = (f64x8::simd_from(simd, low[axis]) - reach).simd_le(other.bounds.high[axis]);
        let above = (f64x8::simd_from(simd, high[axis]) + reach).simd_ge(other.bounds.low[axis]);
        meets &= below.to_bitmask() & above.to_bitmask();
    }
    meets
}

/// The points that may interact with the points of a run.
#[derive(Default)]
pub(super) struct Candidates {
    runs: Vec<Run>,
    /// Runs of the tree that may be near, and scratch space for the search.
    near: [Vec<u32>; 2],
    /// Indices of the points near the query point, with room for eight more.
    found: Vec<u32>,
}

impl Candidates {
    /// Collects the points within reach of the box of a run, in ascending order.
    #[inline(always)]
    pub(super) fn collect<S: Simd>(&mut self, simd: S, tree: &Tree, run: usize) {
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

    /// Returns the candidates closer to `p` than the smaller of the two reaches, including `p`
    /// itself, in ascending order.
    ///
    /// The index of every candidate is written to the list. If the candidate is not near, the next
    /// index overwrites its index. A branch per candidate would be mispredicted half of the time.
    #[inline(always)]
    pub(super) fn near<S: Simd>(&mut self, simd: S, p: DVec3, radius: f64) -> &[u32] {
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

/// Maximum mean extent of runs, in units of the reach. For particles in spatial order, the mean
/// extent is 1.7 to 2.1 reaches, about half of the limit. Above the limit, the points are first
/// sorted into spatial order.
const MOST_EXTENT: f64 = 4.0;

/// Maximum mean extent of groups of eight runs, in units of the reach. On a surface, the area of
/// eight runs is eight times the area of one run, so their extent is sqrt(8) times as large:
/// 4 sqrt(8) = 11.3, rounded up.
const MOST_EXTENT_OF_EIGHT: f64 = 12.0;
