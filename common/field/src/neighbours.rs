//! Who lies near whom: fixed-radius queries over points whose radii differ, by several levels of bins.
//!
//! A point of size h goes to the level of its octave of h, whose bins are as wide as the longest reach in that octave.
//! So a query looks at no more than 27 bins a level however strongly h is graded, where the paper's one global bin edge
//! max(h) (its own stated limitation) makes the fine regions pay for the coarse ones. In a level the points are sorted
//! by bin, x fastest: the three bins of a row are one contiguous run, found by bisection from a table of rows.

use glam::DVec3;
use rayon::prelude::*;

/// Most bins along an axis of a level.
const MOST_BINS: f64 = 1024.0;

/// Points in bins, one grid of bins for each octave of size.
#[derive(Clone, Debug)]
pub struct LevelBins {
    reach: f64,
    origin: DVec3,
    levels: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    edge: f64,
    rows: [usize; 2],
    /// First entry of each row of bins (y fastest), and the end.
    starts: Vec<u32>,
    /// (bin along x, point), sorted by row, then bin, then point.
    entries: Vec<(u32, u32)>,
}

impl LevelBins {
    /// Bins the points; two points interact when nearer than `reach` times the smaller of their sizes. Sizes must be
    /// positive and finite.
    pub fn new(points: &[DVec3], sizes: &[f64], reach: f64) -> Self {
        let smallest = sizes.iter().copied().fold(f64::INFINITY, f64::min);
        let origin = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let upper = points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let level_of = |h: f64| (h / smallest).log2().floor().max(0.0) as usize;
        let count = sizes.iter().map(|&h| level_of(h) + 1).max().unwrap_or(0);
        let mut members: Vec<Vec<u32>> = vec![Vec::new(); count];
        for (i, &h) in sizes.iter().enumerate() {
            members[level_of(h)].push(i as u32);
        }
        let levels = members
            .into_par_iter()
            .enumerate()
            .map(|(l, members)| {
                let largest = members.iter().map(|&i| sizes[i as usize]).fold(0.0, f64::max);
                let edge =
                    if members.is_empty() { reach * smallest * f64::powi(2.0, l as i32 + 1) } else { reach * largest };
                // wider bins are right as well, and the table of rows stays small where a few points are tiny
                let edge = edge.max((upper - origin).max_element() / MOST_BINS);
                let bins = ((upper - origin) / edge).floor();
                let rows = if members.is_empty() { [0, 0] } else { [bins.y as usize + 1, bins.z as usize + 1] };
                let mut keyed: Vec<(u64, u32)> = members
                    .iter()
                    .map(|&i| {
                        let b = ((points[i as usize] - origin) / edge).floor();
                        let row = (b.z as usize).min(rows[1] - 1) * rows[0] + (b.y as usize).min(rows[0] - 1);
                        ((row as u64) << 32 | b.x as u64, i)
                    })
                    .collect();
                keyed.par_sort_unstable();
                let mut starts = vec![0u32; rows[0] * rows[1] + 1];
                for &(key, _) in &keyed {
                    starts[(key >> 32) as usize + 1] += 1;
                }
                for r in 1..starts.len() {
                    starts[r] += starts[r - 1];
                }
                let entries = keyed.iter().map(|&(key, i)| (key as u32, i)).collect();
                Level { edge, rows, starts, entries }
            })
            .collect();
        Self { reach, origin, levels }
    }

    /// Calls `visit` with every point that may lie within `reach * min(size, its size)` of `centre` (and a few more: the
    /// caller measures). The order is fixed: by level, bin, index.
    pub fn visit(&self, centre: DVec3, size: f64, mut visit: impl FnMut(u32)) {
        let relative = centre - self.origin;
        for level in &self.levels {
            if level.entries.is_empty() {
                continue;
            }
            let radius = (self.reach * size).min(level.edge);
            let low = ((relative - radius) / level.edge).floor();
            let high = ((relative + radius) / level.edge).floor();
            if high.min_element() < 0.0 {
                continue;
            }
            let clamp = |low: f64, high: f64, n: usize| (low.max(0.0) as usize, (high as usize + 1).min(n));
            let (y0, y1) = clamp(low.y, high.y, level.rows[0]);
            let (z0, z1) = clamp(low.z, high.z, level.rows[1]);
            let (x0, x1) = (low.x.max(0.0) as u32, high.x as u32);
            for z in z0..z1 {
                for y in y0..y1 {
                    let row = z * level.rows[0] + y;
                    let entries = &level.entries[level.starts[row] as usize..level.starts[row + 1] as usize];
                    let first = entries.partition_point(|e| e.0 < x0);
                    for &(x, i) in &entries[first..] {
                        if x > x1 {
                            break;
                        }
                        visit(i);
                    }
                }
            }
        }
    }
}

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
                let (mut counts, mut members) = (Vec::with_capacity(CHUNK), Vec::with_capacity(CHUNK * 32));
                for i in range {
                    let before = members.len();
                    let (p, h) = (points[i], sizes[i]);
                    bins.visit(p, h, |j| {
                        let at = j as usize;
                        let radius = reach * h.min(sizes[at]);
                        if at != i && p.distance_squared(points[at]) < radius * radius && accept(i, at) {
                            members.push(j);
                        }
                    });
                    counts.push((members.len() - before) as u32);
                }
                (counts, members)
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

    /// Splits the points into classes in which no two are neighbours (greedy colouring in index order, the smallest
    /// free colour). Members of one class can be moved at the same time without one seeing the other move, whatever
    /// the contrast of h: the particle-wise form of the paper's rule (section 4) that no overlapping neighbourhoods run
    /// together.
    pub fn independent_classes(&self) -> Vec<Vec<u32>> {
        let mut colour = vec![u32::MAX; self.len()];
        let mut classes: Vec<Vec<u32>> = Vec::new();
        let mut taken: Vec<u32> = Vec::new();
        for i in 0..self.len() {
            // taken[c] == i + 1 marks colour c as used by a neighbour of i
            for &j in self.of(i) {
                let c = colour[j as usize];
                if c != u32::MAX {
                    taken[c as usize] = i as u32 + 1;
                }
            }
            let free = taken.iter().position(|&mark| mark != i as u32 + 1).unwrap_or_else(|| {
                taken.push(0);
                classes.push(Vec::new());
                classes.len() - 1
            });
            colour[i] = free as u32;
            classes[free].push(i as u32);
        }
        classes
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
    fn no_two_neighbours_share_a_class() {
        let (points, sizes) = scene(1500, 9.0);
        let lists = NeighbourLists::new(&points, &sizes, 2.0, |_, _| true);
        let classes = lists.independent_classes();
        assert_eq!(classes.iter().map(Vec::len).sum::<usize>(), points.len());
        for class in &classes {
            for &i in class {
                assert!(lists.of(i as usize).iter().all(|j| !class.contains(j)));
            }
        }
    }
}
