//! A spatial index that finds the triangles near a box while the mesh is being edited.
//!
//! The grid is hashed and has one level for each power of two of the triangle size. A strongly
//! graded mesh therefore costs no more than a uniform one. Each triangle is stored in the cell that
//! contains the centre of its bounding box.

use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// Number of levels. The coarsest level also contains all larger triangles.
const LEVELS: usize = 32;
/// Maximum number of cells along an axis in one level: 19 bits of the key.
const CELLS: f64 = (1 << 19) as f64;

/// Number of parts of the cells that are filled in parallel, and the number of triangles from which
/// a grid has these parts.
const PARTS: usize = 16;
const MANY: usize = 1 << 14;

/// The triangles in each cell.
type Cells = HashMap<u64, Vec<u32>, BuildHasherDefault<KeyHasher>>;

/// The triangles in cells by position and size.
#[derive(Clone)]
pub(super) struct TriangleGrid {
    origin: DVec3,
    finest: f64,
    population: [usize; LEVELS],
    /// One part, or [`PARTS`] parts by key.
    cells: Vec<Cells>,
    boxes: Vec<Bounds>,
}

impl TriangleGrid {
    /// Creates an empty grid for triangles in the box `whole` (mm). `finest` is the side of the
    /// cells of the finest level (mm), about the size of the small triangles.
    pub(super) fn new(whole: Bounds, finest: f64) -> Self {
        let extent = (whole.high - whole.low).max_element().max(f64::MIN_POSITIVE);
        // coarse enough that the box of all triangles never reaches the outermost cells
        let finest = finest.max(extent / (0.25 * CELLS));
        Self {
            origin: whole.low - extent,
            finest,
            population: [0; LEVELS],
            cells: vec![Cells::default()],
            boxes: Vec::new(),
        }
    }

    /// Returns an empty grid with the same cells.
    pub(super) fn emptied(&self) -> Self {
        Self { population: [0; LEVELS], cells: vec![Cells::default()], boxes: Vec::new(), ..*self }
    }

    /// Returns a grid with the same cells that contains the triangles with these boxes. A missing
    /// triangle has the box [`Bounds::EMPTY`].
    pub(super) fn filled(&self, boxes: Vec<Bounds>) -> Self {
        let mut grid = self.emptied();
        if boxes.len() < MANY {
            let all = (0..).zip(&boxes).filter(|(_, bounds)| **bounds != Bounds::EMPTY);
            all.for_each(|(t, bounds)| grid.insert(t, *bounds));
            return grid;
        }
        let home = |bounds: &Bounds| grid.home(grid.level(bounds), bounds);
        let key = |bounds: &Bounds| (*bounds != Bounds::EMPTY).then(|| home(bounds));
        let keys: Vec<Option<u64>> = boxes.par_iter().map(key).collect();
        keys.iter().flatten().for_each(|key| grid.population[level_of(*key)] += 1);
        let part = |number: usize| {
            let mut cells = Cells::default();
            for (t, key) in (0..).zip(&keys) {
                if let Some(key) = key.filter(|&key| part_of(key) == number) {
                    cells.entry(key).or_default().push(t);
                }
            }
            cells
        };
        grid.cells = (0..PARTS).into_par_iter().map(part).collect();
        grid.boxes = boxes;
        grid
    }

    /// Returns the index of the part that contains a cell.
    fn part(&self, key: u64) -> usize {
        if self.cells.len() == 1 { 0 } else { part_of(key) }
    }

    /// Inserts a triangle.
    pub(super) fn insert(&mut self, triangle: u32, bounds: Bounds) {
        let slot = triangle as usize;
        if self.boxes.len() <= slot {
            self.boxes.resize(slot + 1, Bounds::EMPTY);
        }
        self.boxes[slot] = bounds;
        let level = self.level(&bounds);
        self.population[level] += 1;
        let key = self.home(level, &bounds);
        let part = self.part(key);
        self.cells[part].entry(key).or_default().push(triangle);
    }

    /// Removes a triangle that was inserted.
    pub(super) fn remove(&mut self, triangle: u32) {
        let bounds = self.boxes[triangle as usize];
        let level = self.level(&bounds);
        let key = self.home(level, &bounds);
        let part = self.part(key);
        if let Some(cell) = self.cells[part].get_mut(&key)
            && let Some(at) = cell.iter().position(|&t| t == triangle)
        {
            cell.remove(at);
            self.population[level] -= 1;
        }
    }

    /// Returns whether `test` holds for any triangle whose box meets `query`. It receives the
    /// triangle and its box.
    pub(super) fn any(&self, query: &Bounds, mut test: impl FnMut(u32, &Bounds) -> bool) -> bool {
        for level in (0..LEVELS).filter(|&l| self.population[l] > 0) {
            // the points of a triangle of this level are at most half a cell from the centre of its
            // box, along each axis
            let reach = if level + 1 < LEVELS { 0.5 * self.size(level) } else { f64::INFINITY };
            let low = self.cell(level, query.low - reach);
            let high = self.cell(level, query.high + reach);
            for z in low[2]..=high[2] {
                for y in low[1]..=high[1] {
                    for x in low[0]..=high[0] {
                        let key = key(level, [x, y, z]);
                        let Some(cell) = self.cells[self.part(key)].get(&key) else { continue };
                        let hit = |&t: &u32| {
                            let bounds = &self.boxes[t as usize];
                            bounds.meets(query) && test(t, bounds)
                        };
                        if cell.iter().any(hit) {
                            return true;
                        }
                    }
                }
            }
        }
        false
    }

    fn level(&self, bounds: &Bounds) -> usize {
        let extent = (bounds.high - bounds.low).max_element();
        ((extent / self.finest).log2().ceil().max(0.0) as usize).min(LEVELS - 1)
    }

    fn size(&self, level: usize) -> f64 {
        self.finest * (1u64 << level) as f64
    }

    fn cell(&self, level: usize, p: DVec3) -> [u64; 3] {
        let scaled = ((p - self.origin) / self.size(level)).clamp(DVec3::ZERO, DVec3::splat(CELLS - 1.0));
        [scaled.x as u64, scaled.y as u64, scaled.z as u64]
    }

    fn home(&self, level: usize, bounds: &Bounds) -> u64 {
        key(level, self.cell(level, bounds.centre()))
    }
}

fn key(level: usize, [x, y, z]: [u64; 3]) -> u64 {
    (level as u64) << 57 | z << 38 | y << 19 | x
}

fn level_of(key: u64) -> usize {
    (key >> 57) as usize
}

/// Returns the part of a cell in a grid of [`PARTS`] parts.
fn part_of(key: u64) -> usize {
    (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize % PARTS
}

/// Hash function of a 64-bit key. No result depends on the order of the map.
#[derive(Default)]
pub(super) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(u64::from(byte));
        }
    }

    fn write_u64(&mut self, key: u64) {
        let x = (self.0.rotate_left(5) ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = x ^ (x >> 32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;

    #[test]
    fn queries_match_a_scan_after_insertions_and_removals() {
        let boxes: Vec<Bounds> = (0..400u64)
            .map(|n| {
                let at = |s: u64| DVec3::new(uniform(s, 0, n), uniform(s, 1, n), uniform(s, 2, n));
                let low = at(1) * 10.0;
                // sizes over three orders of magnitude
                Bounds { low, high: low + at(2) * 10f64.powf(-2.0 + 3.0 * uniform(3, 0, n)) }
            })
            .collect();
        let whole = boxes.iter().fold(Bounds::EMPTY, |a, &b| a.merged(b));
        let mut one_by_one = TriangleGrid::new(whole, 0.02);
        for (t, &b) in boxes.iter().enumerate() {
            one_by_one.insert(t as u32, b);
        }
        // all boxes after the first 400 are empty
        let at_once = |count: usize| {
            let mut more = boxes.clone();
            more.resize(count, Bounds::EMPTY);
            one_by_one.filled(more)
        };
        for mut grid in [at_once(400), at_once(MANY), one_by_one.clone()] {
            for t in (0..400).step_by(3) {
                grid.remove(t);
            }
            for t in (0..400).step_by(6) {
                grid.insert(t, boxes[t as usize]);
            }
            for query in &boxes {
                let mut found = Vec::new();
                grid.any(query, |t, _| {
                    found.push(t);
                    false
                });
                found.sort_unstable();
                let is_in = |t: u32| !t.is_multiple_of(3) || t.is_multiple_of(6);
                let expected: Vec<u32> = (0..400).filter(|&t| is_in(t) && boxes[t as usize].meets(query)).collect();
                assert_eq!(found, expected);
            }
        }
    }
}
