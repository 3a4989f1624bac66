//! Searches for neighbours among points with individual interaction radii.
//!
//! [`NeighbourLists`] lists the neighbours of every point. It uses a tree of boxes over the points
//! in spatial order, with eight points per box, so that queries use SIMD on contiguous memory.
//! [`LevelBins`] answers queries at arbitrary positions, with one grid of bins for each octave of
//! h. The cost of a query is almost independent of the ratio of the largest h to the smallest h.
//! The paper uses a single bin width max(h) and notes the drawback: bins in fine regions contain
//! many points that are out of reach.

mod bins;
mod elimination;
mod tree;

pub use bins::{LevelBins, space_order};
pub use elimination::eliminate;
use fearless_simd::{Level as Instructions, Simd, dispatch};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;
use tree::{Candidates, LANES, Tree};

/// Relative widening of bins and boxes, so that rounding cannot place two interacting points more
/// than one bin apart. Rounding errors of positions are below 1024 * 2^-52 = 2e-13 bin widths.
const WIDENING: f64 = 1e-9;

/// Number of points per block of [`NeighbourLists::independent_blocks`]. The points of a block and
/// their neighbours take tens of KiB, so they fit into the L1 or L2 cache of a core. A few thousand
/// points give enough blocks for all cores.
pub const BLOCK: usize = 128;

/// Number of points whose lists are created and stored together. A few thousand points give enough
/// chunks for all cores. Must be a multiple of [`BLOCK`] and of [`LANES`].
const CHUNK: usize = 4 * BLOCK;

/// Neighbours of every point.
#[derive(Clone, Debug, Default)]
pub struct NeighbourLists {
    count: usize,
    /// Lists of [`CHUNK`] points each.
    chunks: Vec<Lists>,
    /// Tree from which the lists were created. The next lists reuse its memory.
    tree: Tree,
}

/// Neighbour lists of consecutive points.
#[derive(Clone, Debug, Default)]
struct Lists {
    /// Start of each list, followed by the end of the last list.
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl NeighbourLists {
    /// Lists, for each point i, the other points j at a distance below `reach * min(h_i, h_j)` for
    /// which `accept(i, j)` is true. Sizes must be positive and finite. The function is fastest if
    /// the points are in spatial order ([`space_order`]).
    pub fn new(points: &[DVec3], sizes: &[f64], reach: f64, accept: impl Fn(usize, usize) -> bool + Sync) -> Self {
        Self::default().anew(points, sizes, reach, accept)
    }

    /// Creates new lists like [`Self::new`]. Consumes `self` and reuses its memory.
    #[must_use]
    pub fn anew(
        mut self,
        points: &[DVec3],
        sizes: &[f64],
        reach: f64,
        accept: impl Fn(usize, usize) -> bool + Sync,
    ) -> Self {
        let tree = std::mem::take(&mut self.tree).anew(points, sizes, reach);
        if tree.is_compact {
            let lists = self.of_tree(&tree, points, sizes, reach, accept);
            return Self { tree, ..lists };
        }
        let order = space_order(points, sizes, reach);
        let place_of = |n: &u32| points[*n as usize];
        let (points, sizes): (Vec<DVec3>, Vec<f64>) = order.iter().map(|n| (place_of(n), sizes[*n as usize])).unzip();
        let number = |n: usize| order[n] as usize;
        let tree = Tree::new(&points, &sizes, reach);
        let ordered = Self::default().of_tree(&tree, &points, &sizes, reach, |i, j| accept(number(i), number(j)));
        let mut rank = vec![0; order.len()];
        order.iter().enumerate().for_each(|(n, &i)| rank[i as usize] = n);
        self.of_chunks(order.len(), |range, lists| {
            for i in range {
                lists.members.extend(ordered.of(rank[i]).iter().map(|&j| order[j as usize]));
                lists.starts.push(lists.members.len() as u32);
            }
        })
    }

    fn of_tree(
        self,
        tree: &Tree,
        points: &[DVec3],
        sizes: &[f64],
        reach: f64,
        accept: impl Fn(usize, usize) -> bool + Sync,
    ) -> Self {
        self.of_chunks(points.len(), |range, lists| {
            dispatch!(Instructions::new(), simd => append_lists(simd, range, tree, points, sizes, reach, &accept, lists));
        })
    }

    /// Creates the lists of `count` points, chunk by chunk.
    fn of_chunks(mut self, count: usize, append: impl Fn(Range<usize>, &mut Lists) + Sync) -> Self {
        self.count = count;
        self.chunks.resize_with(count.div_ceil(CHUNK), Lists::default);
        self.chunks.par_iter_mut().enumerate().for_each(|(chunk, lists)| {
            let range = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
            lists.starts.clear();
            lists.starts.reserve(range.len() + 1);
            lists.members.clear();
            lists.members.reserve(range.len() * 20);
            lists.starts.push(0);
            append(range, lists);
        });
        self
    }

    /// Returns the neighbours of point i.
    #[inline]
    pub fn of(&self, i: usize) -> &[u32] {
        let (lists, i) = (&self.chunks[i / CHUNK], i % CHUNK);
        &lists.members[lists.starts[i] as usize..lists.starts[i + 1] as usize]
    }

    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the mean number of neighbours.
    pub fn mean_count(&self) -> f64 {
        self.chunks.iter().map(|lists| lists.members.len()).sum::<usize>() as f64 / self.count.max(1) as f64
    }

    /// Divides the points into blocks of [`BLOCK`] consecutive points, and the blocks into classes.
    /// No point has a neighbour in another block of the same class, however much h varies. The
    /// blocks of a class can therefore be processed concurrently, and the points of a block in
    /// sequence: no block reads a point that another block of the class moves. This satisfies the
    /// paper's rule (section 4) that overlapping neighbourhoods must not be processed together. The
    /// classes are computed by greedy colouring with the smallest free colour. The points should be
    /// in spatial order ([`space_order`]).
    pub fn independent_blocks(&self) -> Vec<Vec<u32>> {
        let blocks = self.len().div_ceil(BLOCK);
        let seen: Vec<Vec<u32>> = (0..blocks)
            .into_par_iter()
            .map(|block| {
                let (mut seen, mut last) = (Vec::new(), block as u32);
                let own = block * BLOCK..self.len().min((block + 1) * BLOCK);
                for j in own.flat_map(|i| self.of(i)) {
                    let other = j / BLOCK as u32;
                    // later blocks have no colour yet
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
        let mut colour: Vec<usize> = Vec::with_capacity(blocks);
        let mut classes: Vec<Vec<u32>> = Vec::new();
        // for each colour, the last block with a neighbour of that colour
        let mut seen_by: Vec<usize> = Vec::new();
        for (block, seen) in seen.iter().enumerate() {
            seen.iter().for_each(|&other| seen_by[colour[other as usize]] = block);
            let free = seen_by.iter().position(|&last| last != block).unwrap_or(classes.len());
            if free == classes.len() {
                classes.push(Vec::new());
                seen_by.push(usize::MAX);
            }
            classes[free].push(block as u32);
            colour.push(free);
        }
        classes
    }
}

/// Appends the lists of the points in `range`. The range must start at the first point of one of
/// the tree's runs of eight points.
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
                    ways[usize::from(Tree::new(&points, &sizes, reach).is_compact)] += 1;
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
    fn lists_in_the_memory_of_others_are_those_made_afresh() {
        let mut lists = NeighbourLists::default();
        for (count, contrast, is_ordered) in
            [(3000, 1.0, true), (700, 9.0, true), (1500, 1.0, false), (0, 1.0, true), (5000, 3.0, true)]
        {
            let (mut points, mut sizes) = scene(count, contrast);
            if is_ordered {
                let order = space_order(&points, &sizes, 1.9);
                points = order.iter().map(|&i| points[i as usize]).collect();
                sizes = order.iter().map(|&i| sizes[i as usize]).collect();
            }
            let fresh = NeighbourLists::new(&points, &sizes, 1.9, |_, _| true);
            lists = lists.anew(&points, &sizes, 1.9, |_, _| true);
            assert_eq!((lists.len(), lists.mean_count()), (fresh.len(), fresh.mean_count()));
            assert!((0..points.len()).all(|i| lists.of(i) == fresh.of(i)), "{count} at contrast {contrast}");
        }
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
