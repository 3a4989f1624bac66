//! Represents the surface as polygons, which are determined by the signs of F at the cell corners.
//! The corners of the polygons are the crossings of the surface with cell edges. Components and
//! Euler characteristics follow from the polygons, without triangles.
//!
//! Each edge is divided as finely as in the smallest cell that shares it, and each face as finely
//! as in the smaller of its two cells. All cells therefore use the same crossings, and the polygons
//! form a closed surface, except at the border of the volume.

use super::cells::{Cell, Cells, DEPTH, FINE, around};
use crate::marching_cubes::NODE_CLEARANCE;
use crate::spline::CubicSpline;
use glam::DVec3;
use std::ops::Range;
use std::sync::OnceLock;

/// Number of cached values of F; a power of two. At 16 bytes each, they take 256 KiB and fit into
/// the second-level cache.
const CACHED_VALUES: usize = 1 << 14;

/// Factor of the hash of a corner: 2^64 divided by the golden ratio (Knuth's multiplicative
/// hashing). The product has well-mixed upper bits; after a shift by [`SHIFT`], they select a slot
/// of the cache.
const SPREAD: u64 = 0x9e37_79b9_7f4a_7c15;
const SHIFT: u32 = 64 - CACHED_VALUES.trailing_zeros();

/// Bit mask of a cell and the 26 cells around it in a block of 4 x 4 x 4 cells, x fastest. The
/// lowest of these 27 cells corresponds to bit 0.
const AROUND: u64 = 0x0000_0777_0777_0777;

/// For each cell that [`around`] returns, its bit index in such a block.
const BLOCK_BIT: [u32; 27] = {
    let mut bits = [0; 27];
    let mut n = 0;
    while n < 27 {
        bits[n] = (n % 3 + n / 3 % 3 * 4 + n / 9 * 16) as u32;
        n += 1;
    }
    bits
};

/// A crossing of the surface with a cell edge, given by a number that identifies the edge. The
/// numbers increase with the lower end of the edge, x fastest.
pub(super) type Crossing = u64;

/// Returns how many crossing numbers are reserved for the edges that start in one slice of voxels.
/// The numbers of each slice start at a multiple of this count.
pub(super) fn crossings_in_slice(cells: &Cells) -> u64 {
    let [x, y, _] = corners(cells);
    x * y * FINE * 3 * (u64::from(DEPTH) + 1)
}

/// Returns the number of corners of the finest cells along each axis.
fn corners(cells: &Cells) -> [u64; 3] {
    cells.size().map(|n| n as u64 * FINE + 1)
}

/// The polygons of the surface in a set of cells.
#[derive(Default)]
pub(super) struct Polygons {
    /// The cells that contain polygons.
    pub(super) cells: Vec<OfCell>,
    /// End of each polygon in `corners`. Some polygons may no longer belong to a cell.
    ends: Vec<u32>,
    /// Crossings of each polygon, counter-clockwise when seen from outside the object.
    corners: Vec<Crossing>,
    /// First crossing of each polygon side that lies on the border of the volume.
    at_border: Vec<Crossing>,
}

/// The polygons of one cell.
pub(super) struct OfCell {
    /// Position of the cell in the order of all cells.
    pub(super) order: u64,
    pub(super) cell: Cell,
    polygons: Range<u32>,
    at_border: Range<u32>,
}

impl OfCell {
    /// Returns the number of polygons.
    pub(super) fn count(&self) -> usize {
        self.polygons.len()
    }
}

impl Polygons {
    /// Returns the crossings of each polygon of a cell.
    pub(super) fn of(&self, cell: &OfCell) -> impl Iterator<Item = &[Crossing]> {
        cell.polygons.clone().map(|n| {
            let first = if n == 0 { 0 } else { self.ends[n as usize - 1] };
            &self.corners[first as usize..self.ends[n as usize] as usize]
        })
    }

    /// Returns the first crossing of each polygon side of a cell that lies on the border of the
    /// volume.
    pub(super) fn at_border(&self, cell: &OfCell) -> &[Crossing] {
        &self.at_border[cell.at_border.start as usize..cell.at_border.end as usize]
    }
}

/// Extracts the surface cell by cell.
pub(super) struct Reader<'a> {
    field: &'a CubicSpline,
    cells: &'a Cells,
    /// Number of corners of the finest cells along each axis.
    corners: [u64; 3],
    remembered: Vec<(u64, f64)>,
    /// The current cell, whose polygons are being extracted.
    present: Cell,
    /// Bit mask of the corners of the current cell that are inside the object, x fastest.
    inside: u8,
    /// Bit mask of the subdivided cells in a block of 4 x 4 x 4 cells, x fastest. The cells have
    /// the size of the current cell. The block contains the current cell and its neighbours.
    halved: u64,
    /// Lowest cell of that block. `block_level` is the level of the cells in the block.
    block: [i64; 3],
    block_level: u8,
    /// Whether neither the current cell nor any of its neighbours of the same size is subdivided.
    is_even: bool,
    /// Indices of the octants of the current cell and of its neighbours of the same size. Valid
    /// only if `is_even` is false.
    near: [Option<u32>; 27],
    /// For each level, the cell requested last, and the octant indices of this cell and of its
    /// neighbours of the same size.
    larger: Vec<Option<(Cell, [Option<u32>; 27])>>,
    /// Scratch space: sides of the polygons of a cell, and crossings around a face.
    sides: Vec<[Crossing; 2]>,
    crossings: Vec<(Crossing, bool)>,
}

impl<'a> Reader<'a> {
    pub(super) fn new(field: &'a CubicSpline, cells: &'a Cells) -> Self {
        let corners = corners(cells);
        let present = Cell { level: 0, at: [0; 3] };
        let remembered = vec![(u64::MAX, 0.0); CACHED_VALUES];
        Self {
            field,
            cells,
            corners,
            remembered,
            present,
            inside: 0,
            halved: 0,
            block: [0; 3],
            block_level: 0,
            is_even: true,
            near: [None; 27],
            larger: vec![None; usize::from(DEPTH) + 1],
            sides: Vec::new(),
            crossings: Vec::new(),
        }
    }

    /// Adds the polygons of a cell, one for each closed curve in which the surface intersects its
    /// faces.
    pub(super) fn polygons(&mut self, cell: Cell, order: u64, all: &mut Polygons) {
        self.present = cell;
        self.look_around(cell);
        self.inside = self.corners_inside(cell);
        // all corners are on one side and no edge is subdivided, so the surface crosses no edge
        if self.is_even && (self.inside == 0 || self.inside == u8::MAX) {
            return;
        }
        let first = all.ends.len() as u32;
        let first_at_border = all.at_border.len() as u32;
        match even_cells()[usize::from(self.inside)].as_ref().filter(|_| self.is_even && !self.is_at_border(cell)) {
            Some(known) => self.add_known(cell, known, all),
            None => self.add_by_faces(cell, all),
        }
        let polygons = first..all.ends.len() as u32;
        if !polygons.is_empty() {
            let at_border = first_at_border..all.at_border.len() as u32;
            all.cells.push(OfCell { order, cell, polygons, at_border });
        }
    }

    fn is_at_border(&self, cell: Cell) -> bool {
        let size = self.cells.size();
        (0..3).any(|axis| cell.at[axis] == 0 || cell.at[axis] + 1 == (size[axis] as u32) << cell.level)
    }

    /// Adds the polygons of an even cell (see `is_even`). In `known`, polygon corners are given as
    /// cell edges.
    fn add_known(&self, cell: Cell, known: &Polygons, all: &mut Polygons) {
        let low = self.number(cell.corner());
        let along = [1, self.corners[0], self.corners[0] * self.corners[1]].map(|step| step * cell.edge());
        let first = all.corners.len() as u32;
        all.corners.extend(known.corners.iter().map(|&edge| {
            let from = low + (0..3).map(|axis| (edge >> axis & 1) * along[axis]).sum::<u64>();
            crossing(from, edge >> 3, cell.level)
        }));
        all.ends.extend(known.ends.iter().map(|end| first + end));
    }

    /// Adds the polygons of a cell, constructed face by face.
    fn add_by_faces(&mut self, cell: Cell, all: &mut Polygons) {
        if !self.is_even {
            self.near = self.halves_round(cell);
        }
        let mut sides = std::mem::take(&mut self.sides);
        sides.clear();
        for (axis, far) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
            let mut at = cell.at;
            at[axis] += far;
            let first = sides.len();
            self.face(Cell { level: cell.level, at }, axis, &mut sides);
            if far == 0 {
                sides[first..].iter_mut().for_each(|side| side.reverse());
            }
            let last = (self.cells.size()[axis] as u32) << cell.level;
            if at[axis] == 0 || at[axis] == last {
                all.at_border.extend(sides[first..].iter().map(|side| side[0]));
            }
        }
        add_closed_ways(&mut sides, all);
        self.sides = sides;
    }

    /// Determines which of the cells around `cell`, including itself, are subdivided.
    fn look_around(&mut self, cell: Cell) {
        if cell.level == 0 {
            self.block = cell.at.map(|n| i64::from(n) - 1);
            self.halved = 0;
            if self.cells.any_halved_round(cell) {
                for (n, away) in around().enumerate() {
                    self.halved |= u64::from(self.cells.is_halved(cell, away)) << BLOCK_BIT[n];
                }
            }
            self.block_level = 0;
            self.is_even = self.halved == 0;
            return;
        }
        let whole = cell.within(cell.level - 1);
        let block = whole.at.map(|n| 2 * i64::from(n) - 1);
        // all octants of a cell share one block
        if self.block != block || self.block_level != cell.level {
            self.halved = 0;
            for (n, halves) in self.halves_round(whole).into_iter().enumerate() {
                let Some(halves) = halves else { continue };
                let mut rest = self.cells.which_half_halved(halves);
                while rest != 0 {
                    let octant = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    // position 0 is one cell below the block; the block contains only those octants
                    // of the neighbours that touch `whole`
                    let place = [n % 3, n / 3 % 3, n / 9].map(|way| 2 * way);
                    let place = [0, 1, 2].map(|axis| place[axis] + (octant >> axis & 1));
                    if place.iter().all(|place| (1..=4).contains(place)) {
                        self.halved |= 1 << (place[0] - 1 + 4 * (place[1] - 1) + 16 * (place[2] - 1));
                    }
                }
            }
            self.block = block;
        }
        self.block_level = cell.level;
        let low = [0, 1, 2].map(|axis| (i64::from(cell.at[axis]) - block[axis] - 1) as u32);
        self.is_even = self.halved & (AROUND << (low[0] + 4 * low[1] + 16 * low[2])) == 0;
    }

    /// Returns the indices of the octants of a cell and of its neighbours of the same size, in the
    /// order of [`around`]. The index is `None` for a cell that is not subdivided.
    fn halves_round(&mut self, cell: Cell) -> [Option<u32>; 27] {
        let level = usize::from(cell.level);
        if let Some((known, halves)) = self.larger[level]
            && known == cell
        {
            return halves;
        }
        let mut halves = [None; 27];
        if level == 0 {
            halves.iter_mut().zip(around()).for_each(|(own, away)| *own = self.cells.halves(cell, away));
        } else {
            let whole = cell.within(cell.level - 1);
            let larger = self.halves_round(whole);
            for (own, away) in halves.iter_mut().zip(around()) {
                let at = [0, 1, 2].map(|axis| i64::from(cell.at[axis]) + away[axis]);
                let octant = (0..3).map(|axis| (at[axis] as usize & 1) << axis).sum();
                let within = larger[number_around(whole, at.map(|n| n >> 1))];
                *own = within.and_then(|halves| self.cells.halves_of_half(halves, octant));
            }
        }
        self.larger[level] = Some((cell, halves));
        halves
    }

    fn corners_inside(&mut self, cell: Cell) -> u8 {
        let low = cell.corner();
        let is_inside = |n: u64| {
            let far = [n & 1, n >> 1 & 1, n >> 2];
            self.value([0, 1, 2].map(|axis| low[axis] + far[axis] * cell.edge())) < 0.0
        };
        (0..8).map(is_inside).enumerate().map(|(n, is_inside)| u8::from(is_inside) << n).sum()
    }

    /// Adds the polygon sides on a cell face perpendicular to `axis`. Seen from below along that
    /// axis, the object is on the left of each side. `face` is the cell above the face.
    fn face(&mut self, face: Cell, axis: usize, sides: &mut Vec<[Crossing; 2]>) {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut before = [0; 3];
        before[axis] = -1;
        if self.is_halved(face, [0; 3]) || self.is_halved(face, before) {
            for quarter in 0..4 {
                self.face(face.half((quarter & 1) << u | (quarter >> 1) << v), axis, sides);
            }
            return;
        }
        // crossings in order along the boundary of the face; the flag is true where the boundary
        // enters the object
        let mut crossings = std::mem::take(&mut self.crossings);
        crossings.clear();
        let shifted = |axis: usize| {
            let mut at = face.at;
            at[axis] += 1;
            Cell { level: face.level, at }
        };
        self.edge(face, u, true, &mut crossings);
        self.edge(shifted(u), v, true, &mut crossings);
        self.edge(shifted(v), u, false, &mut crossings);
        self.edge(face, v, false, &mut crossings);
        let count = crossings.len();
        // if the crossings can be joined in several ways, the sign at the middle of the face
        // decides
        let cuts_off_object = count > 2 && {
            let mut middle = face.corner().map(|n| n as f64);
            middle[u] += face.edge() as f64 / 2.0;
            middle[v] += face.edge() as f64 / 2.0;
            self.field.value(self.place(DVec3::from_array(middle))) >= 0.0
        };
        let first = usize::from(crossings.first().is_some_and(|(_, enters)| *enters != cuts_off_object));
        for n in (first..count).step_by(2) {
            let ends = [crossings[n].0, crossings[(n + 1) % count].0];
            sides.push(if cuts_off_object { ends } else { [ends[1], ends[0]] });
        }
        self.crossings = crossings;
    }

    /// Adds the crossings on one edge of a cell, in forward or backward order. The edge runs along
    /// `axis` from the lowest corner of the cell `edge`.
    fn edge(&mut self, edge: Cell, axis: usize, forward: bool, crossings: &mut Vec<(Crossing, bool)>) {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let is_own = edge.level == self.present.level;
        let is_halved = |n: i64| {
            let mut away = [0; 3];
            (away[u], away[v]) = (-(n & 1), -(n >> 1));
            self.is_halved(edge, away)
        };
        let is_halved = if is_own { self.is_own_edge_halved(edge, [u, v]) } else { (0..4).any(is_halved) };
        if is_halved {
            let halves = [edge.half(0), edge.half(1 << axis)];
            let [first, second] = if forward { halves } else { [halves[1], halves[0]] };
            self.edge(first, axis, forward, crossings);
            self.edge(second, axis, forward, crossings);
            return;
        }
        let [from, to] = if is_own {
            let first: u32 = (0..3).map(|k| (edge.at[k] - self.present.at[k]) << k).sum();
            [first, first + (1 << axis)].map(|corner| self.inside >> corner & 1 == 1)
        } else {
            self.ends(edge, axis).map(|end| self.value(end) < 0.0)
        };
        if from != to {
            crossings.push((crossing(self.number(edge.corner()), axis as u64, edge.level), to == forward));
        }
    }

    /// Returns whether one of the four cells that share an edge of the current cell is subdivided.
    /// `across` contains the two axes perpendicular to the edge.
    fn is_own_edge_halved(&self, edge: Cell, across: [usize; 2]) -> bool {
        let bit = self.bit(edge.at.map(i64::from));
        let [u, v] = across.map(|axis| 1 << (2 * axis));
        !self.is_even && self.halved & (1 << bit | 1 << (bit - u) | 1 << (bit - v) | 1 << (bit - u - v)) != 0
    }

    fn is_halved(&self, cell: Cell, away: [i64; 3]) -> bool {
        if self.is_even || cell.level == DEPTH {
            return false;
        }
        // the cell has the size of the current cell or is part of a cell of that size
        let finer = cell.level - self.present.level;
        let bit = self.bit([0, 1, 2].map(|k| (i64::from(cell.at[k]) + away[k]) >> finer));
        if self.halved >> bit & 1 == 0 {
            return false;
        }
        let at = [0, 1, 2].map(|k| i64::from(cell.at[k]) + away[k]);
        let mut halves = self.near[number_around(self.present, at.map(|n| n >> finer))];
        for level in (0..finer).rev() {
            let octant = (0..3).map(|axis| (at[axis] as usize >> level & 1) << axis).sum();
            halves = halves.and_then(|halves| self.cells.halves_of_half(halves, octant));
        }
        halves.is_some()
    }

    /// Returns the bit index of a cell in the block. The cell has the size of the current cell and
    /// is at position `at`.
    fn bit(&self, at: [i64; 3]) -> u32 {
        (0..3).map(|axis| ((at[axis] - self.block[axis]) as u32) << (2 * axis)).sum()
    }

    fn ends(&self, edge: Cell, axis: usize) -> [[u64; 3]; 2] {
        let from = edge.corner();
        let mut to = from;
        to[axis] += edge.edge();
        [from, to]
    }

    fn number(&self, corner: [u64; 3]) -> u64 {
        (corner[2] * self.corners[1] + corner[1]) * self.corners[0] + corner[0]
    }

    fn place(&self, fine: DVec3) -> DVec3 {
        self.field.geometry().index_to_grid(fine / FINE as f64)
    }

    /// Returns F at a corner, from the cache if possible. The value depends only on the corner, so
    /// all cells agree on its sign.
    fn value(&mut self, corner: [u64; 3]) -> f64 {
        let number = self.number(corner);
        let slot = (number.wrapping_mul(SPREAD) >> SHIFT) as usize;
        if self.remembered[slot].0 != number {
            let value = self.field.value(self.place(DVec3::from_array(corner.map(|n| n as f64))));
            self.remembered[slot] = (number, value);
        }
        self.remembered[slot].1
    }

    /// Returns the position (grid frame, mm) where F = 0 crosses an edge, to first order.
    pub(super) fn position(&mut self, crossing: Crossing) -> DVec3 {
        let levels = u64::from(DEPTH) + 1;
        let (level, axis, number) =
            ((crossing % levels) as u8, (crossing / levels % 3) as usize, crossing / levels / 3);
        let corner = [
            number % self.corners[0],
            number / self.corners[0] % self.corners[1],
            number / self.corners[0] / self.corners[1],
        ];
        let edge = Cell { level, at: corner.map(|n| (n / (FINE >> level)) as u32) };
        let ends = self.ends(edge, axis);
        let [a, b] = ends.map(|end| self.value(end));
        let share = (a / (a - b)).clamp(NODE_CLEARANCE, 1.0 - NODE_CLEARANCE);
        let [from, to] = ends.map(|end| DVec3::from_array(end.map(|n| n as f64)));
        self.place(from.lerp(to, share))
    }
}

/// Returns the index of a cell in the order of [`around`]. The cell is at position `at`; it is
/// `cell` itself or one of its neighbours of the same size.
fn number_around(cell: Cell, at: [i64; 3]) -> usize {
    let way = |axis: usize| (at[axis] - i64::from(cell.at[axis]) + 1) as usize;
    (way(2) * 3 + way(1)) * 3 + way(0)
}

/// Returns the number of the crossing on a cell edge of the given level. The edge starts at the
/// corner with the number `corner` and runs along `axis`.
fn crossing(corner: u64, axis: u64, level: u8) -> Crossing {
    (corner * 3 + axis) * (u64::from(DEPTH) + 1) + u64::from(level)
}

/// Returns the polygons of a cell without subdivided edges, indexed by the bit mask of its inside
/// corners. An entry is `None` if a face has four crossings, which can be joined in two ways. Each
/// crossing is given by its cell edge: three bits for the lower end, x first, followed by the axis.
fn even_cells() -> &'static [Option<Polygons>; 256] {
    static EVEN: OnceLock<[Option<Polygons>; 256]> = OnceLock::new();
    EVEN.get_or_init(|| std::array::from_fn(even_cell))
}

fn even_cell(inside: usize) -> Option<Polygons> {
    let mut sides: Vec<[Crossing; 2]> = Vec::new();
    for (axis, far) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = far << axis;
        // the edges in the same order and direction as in `Reader::face`
        let edges = [(corner, u, true), (corner | 1 << u, v, true), (corner | 1 << v, u, false), (corner, v, false)];
        let mut crossings = edges.into_iter().filter_map(|(corner, axis, is_forward)| {
            let [from, to] = [corner, corner | 1 << axis].map(|corner| inside >> corner & 1 == 1);
            (from != to).then_some(((corner | axis << 3) as Crossing, to == is_forward))
        });
        let (first, second) = (crossings.next(), crossings.next());
        if crossings.next().is_some() {
            return None;
        }
        if let (Some((first, enters)), Some((second, _))) = (first, second) {
            let side = if enters { [first, second] } else { [second, first] };
            sides.push(if far == 0 { [side[1], side[0]] } else { side });
        }
    }
    let mut polygons = Polygons::default();
    add_closed_ways(&mut sides, &mut polygons);
    Some(polygons)
}

/// Joins the sides into closed polygons and adds them. Each crossing is the start of one side and
/// the end of another.
fn add_closed_ways(sides: &mut Vec<[Crossing; 2]>, all: &mut Polygons) {
    while let Some([start, mut end]) = sides.pop() {
        all.corners.push(start);
        while let Some(next) = sides.iter().position(|side| side[0] == end) {
            all.corners.push(end);
            end = sides.swap_remove(next)[1];
        }
        all.ends.push(all.corners.len() as u32);
    }
}
