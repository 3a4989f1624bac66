//! Stores the indicator of one material near its border as blocks of cubic B-spline coefficients.
//! The blocks lie within a box in the grid that is shared by all materials.
//!
//! [`crate::spline::BrickSpline`] has its own grid and stores each coefficient in every brick that
//! uses it, 1.7 times on average. Here each coefficient is stored once. The blocks of all materials
//! lie on one lattice, so a single index lists the materials that are known at a position.

use super::error::Error;
use crate::spline::{CubicSpline, Stencil};
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Number of cells of a brick, and of coefficients of a block, along each axis. Small bricks follow
/// the border closely: the stored layer is 14 coefficients thick on average. With the bricks of
/// [`crate::spline::BrickSpline`], which have 16 cells along each axis, it would be 37 coefficients
/// thick: 22 cells, with each coefficient stored 1.7 times.
pub const CELLS: usize = 4;

/// Number of coefficients per block.
pub const BLOCK: usize = CELLS * CELLS * CELLS;

/// Distance from the zero set, in voxels, within which an indicator is always known. A brick is
/// known unless all coefficients from `CELLS` nodes before its first node to `CELLS - 1` nodes
/// after its last node have the same sign. Cells that are up to `CELLS - 2` cells away from the
/// brick use only these coefficients.
pub const KNOWN_VOXELS: usize = 2;

/// Distance in nodes beyond which a sample is assumed not to affect a coefficient. At a distance of
/// nine nodes, a coefficient changes by sqrt(3) (2 - sqrt(3))^9 = 1.2e-5 of the change in the
/// sample.
const CARDINAL_REACH: usize = 8;

/// Maximum number of blocks along an axis that contain affected coefficients.
const CARDINAL_BLOCKS: usize = 2 * CARDINAL_REACH / CELLS + 1;

/// Returns a coefficient of the cubic spline that is one at a node and zero at all other nodes.
/// `nodes` is the distance in nodes from that node along one axis. The coefficients follow from the
/// pole of the inverse filter (Unser, Aldroubi and Eden 1993, part II).
fn cardinal_coefficient(nodes: usize) -> f64 {
    let root = 3f64.sqrt();
    root * (root - 2.0).powi(nodes as i32)
}

/// Returns the position of a node on an axis of `nodes` nodes and the positions of its mirror
/// images within [`CARDINAL_REACH`] of the axis. The samples of a spline are continued by repeated
/// mirroring at both borders of the grid.
fn mirrored(node: usize, nodes: usize) -> Vec<isize> {
    let (node, last) = (node as isize, nodes as isize - 1);
    let reach = CARDINAL_REACH as isize;
    let period = (2 * last).max(1);
    let all = (-reach / period - 1..=reach / period + 1).flat_map(|k| [node + k * period, k * period - node]);
    let mut images: Vec<isize> = all.filter(|image| (-reach..=last + reach).contains(image)).collect();
    images.sort_unstable();
    images.dedup();
    images
}

/// Returns the number of bricks along each axis of a grid of `size` nodes.
pub fn bricks_along(size: [usize; 3]) -> [usize; 3] {
    size.map(|n| n.saturating_sub(1).div_ceil(CELLS).max(1))
}

/// Returns the indices, in the grid of blocks, of the eight blocks that the cells of a brick use (x
/// fastest). Along each axis, block c contains the coefficients of nodes 4 c - 1 to 4 c + 2, so a
/// cell of brick b uses blocks b and b + 1.
fn blocks_of(brick: u32, bricks: [usize; 3]) -> [u32; 8] {
    let [bx, by, _] = bricks;
    let n = brick as usize;
    let at = [n % bx, n / bx % by, n / (bx * by)];
    std::array::from_fn(|c| {
        let [x, y, z] = [at[0] + (c & 1), at[1] + (c >> 1 & 1), at[2] + (c >> 2)];
        ((z * (by + 1) + y) * (bx + 1) + x) as u32
    })
}

/// The indicator of one material: its signed distance in mm, negative inside. It is known only
/// within a few voxels of its zero set.
#[derive(Clone, Debug, PartialEq)]
pub struct Indicator {
    /// First node of the indicator's box in the shared grid.
    first: [usize; 3],
    /// Number of nodes of the box along each axis.
    size: [usize; 3],
    /// Whether all points beyond the box are inside the material.
    surrounds: bool,
    /// Indices of the known bricks in the shared grid, in ascending order.
    bricks: Vec<u32>,
    /// Indices, among the stored blocks, of the eight blocks that each known brick uses.
    blocks: Vec<[u32; 8]>,
    /// Coefficients, block by block, in ascending order of the block indices in the grid.
    coefficients: Vec<f32>,
}

/// The fields of an [`Indicator`] that are stored in files.
#[derive(Clone, Debug, PartialEq)]
pub struct IndicatorParts {
    /// First node of the indicator's box in the shared grid.
    pub first: [usize; 3],
    /// Number of nodes of the box along each axis.
    pub size: [usize; 3],
    /// Whether all points beyond the box are inside the material.
    pub surrounds: bool,
    /// Indices of the known bricks in the shared grid (x fastest), in ascending order.
    pub bricks: Vec<u32>,
    /// Coefficients, 64 per block.
    pub coefficients: Vec<f32>,
}

impl Indicator {
    /// Creates an indicator from signed distances (mm, negative inside) at the nodes of a box. The
    /// box starts at node `first` of a grid of `size` nodes. `surrounds` is true if all points
    /// beyond the box are inside. Also returns the indices of the bricks in which the indicator is
    /// negative throughout.
    ///
    /// # Panics
    /// If the box does not lie within the grid.
    pub fn new(samples: &Image<f32>, first: [usize; 3], size: [usize; 3], surrounds: bool) -> (Self, Vec<u32>) {
        let own = samples.geometry.size;
        assert!((0..3).all(|a| first[a] + own[a] <= size[a]), "a box of the grid");
        let spline = CubicSpline::new(samples);
        let signs = BrickSigns::new(&spline, first, size);
        let bricks = bricks_along(size);
        let (mut known, mut negative) = (Vec::new(), Vec::new());
        for n in 0..bricks.iter().product::<usize>() {
            let at = [n % bricks[0], n / bricks[0] % bricks[1], n / (bricks[0] * bricks[1])];
            match signs.around(at) {
                Some((true, true)) => known.push(n as u32),
                Some((true, false)) => negative.push(n as u32),
                Some((false, _)) => {}
                None if surrounds => negative.push(n as u32),
                None => {}
            }
        }
        let places = places(&known, bricks);
        let mut coefficients = vec![0.0; places.len() * BLOCK];
        coefficients.par_chunks_mut(BLOCK).zip(&places).for_each(|(block, &place)| {
            let n = place as usize;
            let at =
                [n % (bricks[0] + 1), n / (bricks[0] + 1) % (bricks[1] + 1), n / ((bricks[0] + 1) * (bricks[1] + 1))];
            for (c, to) in block.iter_mut().enumerate() {
                let within = [c % CELLS, c / CELLS % CELLS, c / (CELLS * CELLS)];
                let node: [Option<usize>; 3] = std::array::from_fn(|a| {
                    (CELLS * at[a] + within[a]).checked_sub(1 + first[a]).filter(|&i| i < own[a])
                });
                if let [Some(i), Some(j), Some(k)] = node {
                    *to = spline.coefficients()[(k * own[1] + j) * own[0] + i];
                }
            }
        });
        let blocks = numbered(&known, &places, bricks);
        (Self { first, size: own, surrounds, bricks: known, blocks, coefficients }, negative)
    }

    /// Returns the indicator of a material without a border. It is positive everywhere, or negative
    /// everywhere if `inside` is true.
    pub fn constant(inside: bool) -> Self {
        Self {
            first: [0; 3],
            size: [0; 3],
            surrounds: inside,
            bricks: Vec::new(),
            blocks: Vec::new(),
            coefficients: Vec::new(),
        }
    }

    /// Assembles an indicator for a grid of `size` nodes from its stored parts.
    ///
    /// # Errors
    /// If the parts do not match each other or the grid, or if a coefficient is not finite.
    pub fn from_parts(parts: IndicatorParts, size: [usize; 3]) -> Result<Self, Error> {
        let bricks = bricks_along(size);
        let count = bricks.iter().product::<usize>();
        let fits = (0..3).all(|a| parts.first[a].checked_add(parts.size[a]).is_some_and(|end| end <= size[a]));
        if !fits {
            return Err(Error::Box { first: parts.first, size: parts.size, grid: size });
        }
        if !parts.bricks.is_sorted_by(|a, b| a < b) || parts.bricks.last().is_some_and(|&last| last as usize >= count) {
            return Err(Error::Bricks { count });
        }
        let places = places(&parts.bricks, bricks);
        if Some(parts.coefficients.len()) != places.len().checked_mul(BLOCK) {
            return Err(Error::Coefficients { found: parts.coefficients.len(), expected: places.len() * BLOCK });
        }
        if let Some(bad) = parts.coefficients.iter().find(|c| !c.is_finite()) {
            return Err(Error::NotFinite { value: *bad });
        }
        let blocks = numbered(&parts.bricks, &places, bricks);
        let IndicatorParts { first, size, surrounds, bricks, coefficients } = parts;
        Ok(Self { first, size, surrounds, bricks, blocks, coefficients })
    }

    /// Returns the first node of the box in the shared grid, and the number of nodes of the box
    /// along each axis.
    pub fn extent(&self) -> ([usize; 3], [usize; 3]) {
        (self.first, self.size)
    }

    /// Returns whether all points beyond the box are inside the material.
    pub fn surrounds(&self) -> bool {
        self.surrounds
    }

    /// Returns the indices of the known bricks in the shared grid (x fastest), in ascending order.
    pub fn bricks(&self) -> &[u32] {
        &self.bricks
    }

    /// Returns the indices, among the stored blocks, of the eight blocks that each known brick
    /// uses, x fastest. Along each axis, block c of the grid contains the coefficients of nodes
    /// 4 c - 1 to 4 c + 2.
    pub fn blocks(&self) -> &[[u32; 8]] {
        &self.blocks
    }

    /// Returns the coefficients, 64 per block.
    pub fn coefficients(&self) -> &[f32] {
        &self.coefficients
    }

    /// Returns whether all coefficients that a cell uses lie in the box. The shared grid has `size`
    /// nodes.
    #[inline(always)]
    pub fn is_within(&self, cell: [usize; 3], size: [usize; 3]) -> bool {
        (0..3).all(|a| {
            let (first, end) = (self.first[a], self.first[a] + self.size[a]);
            (cell[a] > first || first == 0) && cell[a] >= first && (cell[a] + 2 < end || end == size[a])
        })
    }

    /// Adds changes (mm) to the samples at the given nodes. The shared grid has `size` nodes. The
    /// spline interpolates the new samples and all other, unchanged samples. It changes only within
    /// a few voxels of these nodes. Coefficients beyond the box, or in bricks that are not known,
    /// are not updated.
    pub fn add_at_nodes(&mut self, changes: &[([usize; 3], f64)], size: [usize; 3]) {
        let along = bricks_along(size).map(|n| n + 1);
        let places = places(&self.bricks, bricks_along(size));
        // block c contains nodes 4 c - 1 to 4 c + 2
        let first_block = |node: usize| (node + 1).saturating_sub(CARDINAL_REACH) / CELLS;
        for &(node, change) in changes {
            let first = node.map(first_block);
            let weights: [[f64; CARDINAL_BLOCKS * CELLS]; 3] = std::array::from_fn(|a| {
                let own = self.first[a] + 1..self.first[a] + self.size[a] + 1;
                let images = mirrored(node[a], size[a]);
                std::array::from_fn(|n| {
                    let at = first[a] * CELLS + n;
                    let distances = images.iter().map(|image| (at as isize - 1).abs_diff(*image));
                    let of_images = distances.filter(|&d| d <= CARDINAL_REACH).map(cardinal_coefficient);
                    if own.contains(&at) { of_images.sum() } else { 0.0 }
                })
            });
            for block in 0..CARDINAL_BLOCKS.pow(3) {
                let at = [
                    block % CARDINAL_BLOCKS,
                    block / CARDINAL_BLOCKS % CARDINAL_BLOCKS,
                    block / CARDINAL_BLOCKS.pow(2),
                ];
                let [x, y, z] = std::array::from_fn(|a| first[a] + at[a]);
                if x >= along[0] || y >= along[1] || z >= along[2] {
                    continue;
                }
                let Ok(number) = places.binary_search(&(((z * along[1] + y) * along[0] + x) as u32)) else { continue };
                for (c, to) in self.coefficients[number * BLOCK..][..BLOCK].iter_mut().enumerate() {
                    let within = [c % CELLS, c / CELLS % CELLS, c / (CELLS * CELLS)];
                    let weight: f64 = (0..3).map(|a| weights[a][at[a] * CELLS + within[a]]).product();
                    *to += (change * weight) as f32;
                }
            }
        }
    }

    /// Returns the memory usage in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.bricks.as_slice())
            + size_of_val(self.blocks.as_slice())
            + size_of_val(self.coefficients.as_slice())
    }

    /// Returns the 64 coefficients, x fastest, that a stencil uses in a known brick. `brick` is the
    /// index of the brick among the known bricks. Returns `None` if the stencil extends beyond the
    /// box. The shared grid has `size` nodes.
    #[inline(always)]
    pub(super) fn gather(&self, brick: u32, stencil: &Stencil, size: [usize; 3]) -> Option<[f32; 64]> {
        let cell = stencil.cell();
        if !self.is_within(cell, size) {
            return None;
        }
        let blocks = &self.blocks[brick as usize];
        let [x, y, z] = std::array::from_fn(|axis| {
            let start = cell[axis] / CELLS * CELLS;
            stencil.indices()[axis].map(|n| n + 1 - start)
        });
        // rows that are not mirrored at the border of the grid are contiguous across two blocks
        Some(match x {
            [0, 1, 2, 3] => self.rows::<0>(blocks, y, z),
            [1, 2, 3, 4] => self.rows::<1>(blocks, y, z),
            [2, 3, 4, 5] => self.rows::<2>(blocks, y, z),
            [3, 4, 5, 6] => self.rows::<3>(blocks, y, z),
            _ => self.scattered(blocks, [x, y, z]),
        })
    }

    /// Returns the 64 coefficients at four consecutive x indices, starting at `FIRST`, and at the
    /// given y and z indices. Along each axis, indices 0 to 7 cover two adjacent blocks.
    #[inline(always)]
    fn rows<const FIRST: usize>(&self, blocks: &[u32; 8], y: [usize; 4], z: [usize; 4]) -> [f32; 64] {
        let mut gathered = [0.0; 64];
        for (c, k) in z.into_iter().enumerate() {
            for (b, j) in y.into_iter().enumerate() {
                let pair = 4 * (k / CELLS) + 2 * (j / CELLS);
                let inner = (k % CELLS * CELLS + j % CELLS) * CELLS;
                let four = |block: u32| {
                    let row = &self.coefficients[block as usize * BLOCK + inner..][..CELLS];
                    [row[0], row[1], row[2], row[3]]
                };
                let (low, high) = (four(blocks[pair]), four(blocks[pair + 1]));
                let row = &mut gathered[16 * c + 4 * b..][..4];
                for (n, to) in row.iter_mut().enumerate() {
                    let at = n + FIRST;
                    *to = if at < CELLS { low[at] } else { high[at - CELLS] };
                }
            }
        }
        gathered
    }

    /// Returns the 64 coefficients at the given indices. Along each axis, indices 0 to 7 cover two
    /// adjacent blocks.
    fn scattered(&self, blocks: &[u32; 8], places: [[usize; 4]; 3]) -> [f32; 64] {
        let [x, y, z] = places.map(|along| along.map(|n| (n / CELLS, n % CELLS)));
        let mut gathered = [0.0; 64];
        for (c, (kb, k)) in z.into_iter().enumerate() {
            for (b, (jb, j)) in y.into_iter().enumerate() {
                let row = &mut gathered[16 * c + 4 * b..][..4];
                let inner = (k * CELLS + j) * CELLS;
                for (to, (ib, i)) in row.iter_mut().zip(x) {
                    *to = self.coefficients[blocks[4 * kb + 2 * jb + ib] as usize * BLOCK + inner + i];
                }
            }
        }
        gathered
    }
}

/// Returns the blocks that the given bricks use, as indices in the grid of blocks, in ascending
/// order.
fn places(known: &[u32], bricks: [usize; 3]) -> Vec<u32> {
    let mut places: Vec<u32> = known.iter().flat_map(|&brick| blocks_of(brick, bricks)).collect();
    places.sort_unstable();
    places.dedup();
    places
}

/// Returns the indices in `places` of the blocks that each brick uses.
fn numbered(known: &[u32], places: &[u32], bricks: [usize; 3]) -> Vec<[u32; 8]> {
    let number = |place: u32| places.partition_point(|&other| other < place) as u32;
    known.iter().map(|&brick| blocks_of(brick, bricks).map(number)).collect()
}

/// Signs of the coefficients in cubes of the shared grid. A cube has [`CELLS`] nodes along each
/// axis.
struct BrickSigns {
    /// First cube that overlaps the box, and number of cubes that overlap the box, along each axis.
    first: [usize; 3],
    count: [usize; 3],
    /// For each cube: whether any coefficient is at most zero, and whether any is at least zero.
    signs: Vec<(bool, bool)>,
    /// First and last node of the box.
    low: [usize; 3],
    high: [usize; 3],
    bricks: [usize; 3],
}

impl BrickSigns {
    fn new(spline: &CubicSpline, low: [usize; 3], size: [usize; 3]) -> Self {
        let own = spline.geometry().size;
        let high: [usize; 3] = std::array::from_fn(|a| low[a] + own[a] - 1);
        let first = low.map(|n| n / CELLS);
        let count: [usize; 3] = std::array::from_fn(|a| high[a] / CELLS + 1 - first[a]);
        let signs = (0..count.iter().product::<usize>()).into_par_iter().map(|n| {
            let at = [n % count[0], n / count[0] % count[1], n / (count[0] * count[1])];
            let span = |a: usize| {
                let start = (first[a] + at[a]) * CELLS;
                start.max(low[a]) - low[a]..(start + CELLS).min(high[a] + 1) - low[a]
            };
            let mut found = (false, false);
            for k in span(2) {
                for j in span(1) {
                    let row = &spline.coefficients()[(k * own[1] + j) * own[0]..][..own[0]];
                    for &c in &row[span(0)] {
                        found = (found.0 || c <= 0.0, found.1 || c >= 0.0);
                    }
                }
            }
            found
        });
        Self { first, count, signs: signs.collect(), low, high, bricks: bricks_along(size) }
    }

    /// Returns whether any coefficient in the cube of a brick or in an adjacent cube is at most
    /// zero, and whether any is at least zero. Returns `None` if no cell of the brick lies in the
    /// box.
    fn around(&self, brick: [usize; 3]) -> Option<(bool, bool)> {
        let has_cell = (0..3).all(|a| {
            let (start, end) = (brick[a] * CELLS, (brick[a] + 1) * CELLS);
            // a grid with one node along the axis has a single brick there, without cells
            start <= self.high[a].saturating_sub(1) && (end > self.low[a] || self.bricks[a] == 1)
        });
        if !has_cell {
            return None;
        }
        let span = |a: usize| {
            let last = self.first[a] + self.count[a] - 1;
            brick[a].saturating_sub(1).clamp(self.first[a], last)..=(brick[a] + 1).clamp(self.first[a], last)
        };
        let mut found = (false, false);
        for k in span(2) {
            for j in span(1) {
                for i in span(0) {
                    let at = [i - self.first[0], j - self.first[1], k - self.first[2]];
                    let (a, b) = self.signs[(at[2] * self.count[1] + at[1]) * self.count[0] + at[0]];
                    found = (found.0 || a, found.1 || b);
                }
            }
        }
        Some(found)
    }
}
