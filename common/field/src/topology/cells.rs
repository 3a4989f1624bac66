//! An octree over the voxel cells of the volume. Cells are subdivided into octants (`halves` in the
//! code) until the shape of F = 0 in them is certain or the finest level is reached.

use super::bernstein::Bernstein;
use super::signs::Signs;
use super::watch::{Interrupted, Watch};
use crate::spline::CubicSpline;
use glam::DVec3;
use isoparticles_mesh::buckets::starts_of;
use rayon::prelude::*;

/// Level to which voxel cells are subdivided while F = 0 in them is uncertain. Where F is close to
/// its second-order expansion at a critical point, cells with an edge length below r / sqrt 3
/// resolve a neck, gap or speck of radius r. Cells of a sixteenth of a voxel resolve all features
/// with a radius of at least 0.108 voxel, almost down to `RESOLUTION` (0.1).
pub(super) const BASE: u8 = 4;

/// Finest level. Its cells resolve features with a radius above sqrt 3 / 128 = 0.014 voxel, a
/// seventh of `RESOLUTION`.
pub(super) const DEPTH: u8 = 7;

/// Maximum number of uncertain cells in a voxel for which these cells are subdivided beyond
/// [`BASE`]. If F = 0 touches itself at a point, the number of uncertain cells is the same at every
/// level. At [`BASE`], 9,237 cells are uncertain at 662 such points of a noisy scan, 14 per point.
/// The limit allows four points in a voxel. If F = 0 touches itself along a curve, the number
/// doubles with each level, and over a surface it quadruples; subdivision does not help there.
const MOST_UNCERTAIN: usize = 64;

/// Number of finest cells along the edge of a voxel.
pub(super) const FINE: u64 = 1 << DEPTH;

/// State of F in a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// F has one sign throughout the cell.
    Clear,
    /// If F = 0 crosses the cell, it is a graph in the cell.
    Graph,
    /// Neither clear nor a graph, and not subdivided further.
    Undecided,
    /// Subdivided. The number is the index of the octants.
    Halved(u32),
}

/// A [`State`], packed into half of its memory.
#[derive(Clone, Copy)]
struct Packed(u32);

/// States of leaf cells, indexed by their packed value.
const PLAIN: [State; 3] = [State::Clear, State::Graph, State::Undecided];

impl Packed {
    /// Returns the index of the octants if the cell is subdivided.
    fn halves(self) -> Option<usize> {
        (self.0 as usize).checked_sub(PLAIN.len())
    }

    /// Adds `before` to the index of the octants of a subdivided cell.
    fn count_on(&mut self, before: u32) {
        self.0 += if self.halves().is_some() { before } else { 0 };
    }
}

impl From<State> for Packed {
    fn from(state: State) -> Self {
        match state {
            State::Clear => Self(0),
            State::Graph => Self(1),
            State::Undecided => Self(2),
            State::Halved(n) => Self(n + PLAIN.len() as u32),
        }
    }
}

impl From<Packed> for State {
    fn from(packed: Packed) -> Self {
        packed.halves().map_or_else(|| PLAIN[packed.0 as usize], |n| Self::Halved(n as u32))
    }
}

/// A cell. Its edge length is `1 / 2^level` of the edge length of a voxel cell. `at` is its
/// position along each axis in units of its edge length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Cell {
    pub(super) level: u8,
    pub(super) at: [u32; 3],
}

impl Cell {
    /// Returns one of the octants of the cell.
    pub(super) fn half(self, octant: usize) -> Self {
        let bit = |axis: usize| (octant >> axis & 1) as u32;
        Self { level: self.level + 1, at: [0, 1, 2].map(|axis| 2 * self.at[axis] + bit(axis)) }
    }

    /// Returns the ancestor of this cell at the given lower level.
    pub(super) fn within(self, level: u8) -> Self {
        Self { level, at: self.at.map(|n| n >> (self.level - level)) }
    }

    /// Returns the octant number of the cell within its parent cell.
    fn octant(self) -> usize {
        (0..3).map(|axis| (self.at[axis] as usize & 1) << axis).sum()
    }

    /// Returns the edge length of the cell in edge lengths of the finest cells.
    pub(super) fn edge(self) -> u64 {
        FINE >> self.level
    }

    /// Returns the lowest corner of the cell in edge lengths of the finest cells.
    pub(super) fn corner(self) -> [u64; 3] {
        self.at.map(|n| u64::from(n) * self.edge())
    }
}

/// The cells of a volume.
pub(super) struct Cells {
    /// Number of voxel cells along each axis.
    size: [usize; 3],
    /// State of each voxel cell, slice by slice, x fastest.
    voxels: Vec<Vec<Packed>>,
    /// States of the octants of subdivided cells.
    halves: Vec<[Packed; 8]>,
}

impl Cells {
    /// Subdivides cells in which F = 0 is uncertain, and cells next to much smaller cells.
    /// Afterwards, no cell in which F = 0 is a graph is more than twice as large as a neighbour
    /// that F = 0 may cross. Without this balance, the surface given by the signs at the cell
    /// corners need not be isotopic to F = 0.
    pub(super) fn new(field: &CubicSpline, watch: &Watch<'_>) -> Result<Self, Interrupted> {
        let size = field.geometry().size.map(|n| n.saturating_sub(1));
        let signs = Signs::of(field);
        let states = |k| watch.slice().map(|()| states_of_slice(field, &signs, size, k));
        let mut slices = (0..size[2]).into_par_iter().map(states).collect::<Result<Vec<_>, _>>()?;
        let halves_before = starts_of(slices.iter().map(|(_, halves)| halves.len()));
        slices.par_iter_mut().zip(halves_before).for_each(|((voxels, halves), before)| {
            voxels.iter_mut().chain(halves.as_flattened_mut()).for_each(|state| state.count_on(before));
        });
        let (voxels, halves): (Vec<_>, Vec<_>) = slices.into_iter().unzip();
        let mut new = Self { size, voxels, halves: halves.concat() };
        let halved: Vec<Cell> = (0..size[2] as u32).into_par_iter().flat_map_iter(|k| new.halved_in_slice(k)).collect();
        new.balance(field, halved);
        Ok(new)
    }

    /// Returns the number of voxel cells along each axis.
    pub(super) fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Returns a cell with its state. If the cell does not exist, returns the leaf cell that
    /// contains it. Returns `None` outside the volume.
    pub(super) fn find(&self, cell: Cell) -> Option<(Cell, State)> {
        let voxel = cell.within(0).at.map(|n| n as usize);
        if (0..3).any(|axis| voxel[axis] >= self.size[axis]) {
            return None;
        }
        let mut state = self.voxels[voxel[2]][voxel[1] * self.size[0] + voxel[0]];
        let mut level = 0;
        while let Some(halves) = state.halves()
            && level < cell.level
        {
            level += 1;
            state = self.halves[halves][cell.within(level).octant()];
        }
        Some((cell.within(level), state.into()))
    }

    /// Returns the cell of the finest level that contains a point (grid frame, mm), or the closest
    /// such cell if the point is outside the volume.
    pub(super) fn finest_at(&self, field: &CubicSpline, point: DVec3) -> Cell {
        let fine = (point / field.geometry().spacing * FINE as f64).floor();
        let last = self.size.map(|n| (n as u64 * FINE) as f64 - 1.0);
        Cell { level: DEPTH, at: [0, 1, 2].map(|axis| fine[axis].min(last[axis]).max(0.0) as u32) }
    }

    /// Returns whether the cell at the offset `away` (in cell edges) from `cell` is subdivided.
    pub(super) fn is_halved(&self, cell: Cell, away: [i64; 3]) -> bool {
        self.halves(cell, away).is_some()
    }

    /// Returns the index of the octants of the cell at the offset `away` (in cell edges) from
    /// `cell`, if that cell is subdivided.
    pub(super) fn halves(&self, cell: Cell, away: [i64; 3]) -> Option<u32> {
        let cell = moved(cell, away)?;
        match self.find(cell)? {
            (found, State::Halved(halves)) if found == cell => Some(halves),
            _ => None,
        }
    }

    /// Returns the index of the octants of an octant, if the octant is subdivided.
    pub(super) fn halves_of_half(&self, halves: u32, octant: usize) -> Option<u32> {
        self.halves[halves as usize][octant].halves().map(|halves| halves as u32)
    }

    /// Returns a bit mask of the octants that are subdivided.
    pub(super) fn which_half_halved(&self, halves: u32) -> u8 {
        let bit = |(n, half): (usize, &Packed)| u8::from(half.halves().is_some()) << n;
        self.halves[halves as usize].iter().enumerate().map(bit).sum()
    }

    /// Returns whether a voxel cell or one of the 26 cells around it is subdivided.
    pub(super) fn any_halved_round(&self, voxel: Cell) -> bool {
        let near = |axis: usize| {
            let at = voxel.at[axis] as usize;
            at.saturating_sub(1)..(at + 2).min(self.size[axis])
        };
        near(2).any(|k| {
            near(1).any(|j| {
                let row = j * self.size[0];
                self.voxels[k][row + near(0).start..row + near(0).end].iter().any(|s| s.halves().is_some())
            })
        })
    }

    /// Returns the leaf cells that F = 0 may cross in a slice of voxels, in the order of the
    /// voxels.
    pub(super) fn crossed_in_slice(&self, k: u32) -> Vec<(Cell, State)> {
        let mut found = Vec::new();
        for (j, i) in (0..self.size[1] as u32).flat_map(|j| (0..self.size[0] as u32).map(move |i| (j, i))) {
            let state = self.voxels[k as usize][j as usize * self.size[0] + i as usize].into();
            let voxel = Cell { level: 0, at: [i, j, k] };
            match state {
                State::Clear => {}
                State::Halved(_) => self.crossed_in(voxel, &mut found),
                _ => found.push((voxel, state)),
            }
        }
        found
    }

    /// Adds the leaf cells within `cell` that F = 0 may cross. If `cell` is part of a larger leaf
    /// cell that F = 0 may cross, adds that leaf cell.
    pub(super) fn crossed_in(&self, cell: Cell, found: &mut Vec<(Cell, State)>) {
        match self.find(cell) {
            Some((_, State::Halved(halves))) => self.crossed_in_halves(cell, halves, found),
            Some((own, state)) if state != State::Clear => found.push((own, state)),
            _ => {}
        }
    }

    fn crossed_in_halves(&self, cell: Cell, halves: u32, found: &mut Vec<(Cell, State)>) {
        for (octant, &half) in self.halves[halves as usize].iter().enumerate() {
            match half.into() {
                State::Clear => {}
                State::Halved(halves) => self.crossed_in_halves(cell.half(octant), halves, found),
                state => found.push((cell.half(octant), state)),
            }
        }
    }

    /// Returns the subdivided cells in a slice of voxels.
    fn halved_in_slice(&self, k: u32) -> Vec<Cell> {
        let mut found = Vec::new();
        for (n, state) in self.voxels[k as usize].iter().enumerate() {
            if let Some(halves) = state.halves() {
                let at = [n % self.size[0], n / self.size[0]].map(|n| n as u32);
                self.halved_in(Cell { level: 0, at: [at[0], at[1], k] }, halves, &mut found);
            }
        }
        found
    }

    /// Adds a subdivided cell and all subdivided cells within it.
    fn halved_in(&self, cell: Cell, halves: usize, found: &mut Vec<Cell>) {
        found.push(cell);
        for (octant, half) in self.halves[halves].iter().enumerate() {
            if let Some(halves) = half.halves() {
                self.halved_in(cell.half(octant), halves, found);
            }
        }
    }

    /// Subdivides the given cells, in which F = 0 is a graph, and further cells to restore the
    /// balance. Returns the voxels that have changed, in ascending order.
    pub(super) fn refine(&mut self, field: &CubicSpline, cells: &[Cell]) -> Vec<[u32; 3]> {
        self.halve_all(field, cells);
        let mut changed = self.balance(field, cells.to_vec());
        changed.extend_from_slice(cells);
        let mut changed: Vec<[u32; 3]> = changed.into_iter().map(|cell| cell.within(0).at).collect();
        changed.par_sort_unstable();
        changed.dedup();
        changed
    }

    /// Restores the balance around the octants of the given subdivided cells. Returns the cells
    /// that it subdivides.
    fn balance(&mut self, field: &CubicSpline, halved: Vec<Cell>) -> Vec<Cell> {
        let mut by_level: Vec<Vec<Cell>> = vec![Vec::new(); usize::from(DEPTH)];
        halved.into_iter().for_each(|cell| by_level[usize::from(cell.level)].push(cell));
        let mut all = Vec::new();
        // level 0 is skipped: the octants of voxel cells have no neighbours that are too large
        for level in (1..DEPTH).rev() {
            let mut active = std::mem::take(&mut by_level[usize::from(level)]);
            while !active.is_empty() {
                let found: Vec<(Cell, Vec<Cell>)> = active
                    .par_iter()
                    .map(|&cell| (cell, self.too_large_beside(cell)))
                    .filter(|(_, f)| !f.is_empty())
                    .collect();
                let mut large: Vec<Cell> = found.iter().flat_map(|(_, large)| large).copied().collect();
                large.par_sort_unstable();
                large.dedup();
                self.halve_all(field, &large);
                large.iter().for_each(|cell| by_level[usize::from(cell.level)].push(*cell));
                all.extend(large);
                // a neighbour that is far too large is still too large after one subdivision
                active = found.into_iter().map(|(cell, _)| cell).collect();
            }
        }
        all
    }

    /// Returns the cells around `whole` that must be subdivided. These are cells in which F = 0 is
    /// a graph. Each touches an octant of `whole` that F = 0 may cross, and is more than twice as
    /// large as this octant.
    fn too_large_beside(&self, whole: Cell) -> Vec<Cell> {
        let mut large = Vec::new();
        let Some(halves) = self.halves(whole, [0; 3]) else { return large };
        let is_crossed = |half: &Packed| matches!((*half).into(), State::Graph | State::Undecided);
        let crossed = self.halves[halves as usize].each_ref().map(is_crossed);
        for away in around().filter(|away| *away != [0; 3]) {
            let touches =
                |octant: usize| (0..3).all(|axis| away[axis] == 0 || (away[axis] == 1) == (octant >> axis & 1 == 1));
            if (0..8).any(|octant| crossed[octant] && touches(octant))
                && let Some((found, State::Graph)) = moved(whole, away).and_then(|cell| self.find(cell))
                && found.level < whole.level
            {
                large.push(found);
            }
        }
        large
    }

    /// Subdivides cells in which F = 0 is a graph.
    fn halve_all(&mut self, field: &CubicSpline, cells: &[Cell]) {
        let halves: Vec<[State; 8]> = cells.par_iter().map(|&cell| halves_of_graph(field, cell)).collect();
        cells.iter().zip(halves).for_each(|(&cell, halves)| self.halve(cell, halves));
    }

    fn halve(&mut self, cell: Cell, halves: [State; 8]) {
        let new = Packed::from(State::Halved(self.halves.len() as u32));
        self.halves.push(halves.map(Packed::from));
        if cell.level == 0 {
            let [i, j, k] = cell.at.map(|n| n as usize);
            self.voxels[k][j * self.size[0] + i] = new;
        } else if let Some((_, State::Halved(n))) = self.find(cell.within(cell.level - 1)) {
            self.halves[n as usize][cell.octant()] = new;
        }
    }
}

/// Returns the cell at the offset `away` (in cell edges) from `cell`. Returns `None` if a
/// coordinate is negative.
pub(super) fn moved(cell: Cell, away: [i64; 3]) -> Option<Cell> {
    let mut at = [0; 3];
    for axis in 0..3 {
        at[axis] = u32::try_from(i64::from(cell.at[axis]) + away[axis]).ok()?;
    }
    Some(Cell { at, ..cell })
}

/// Returns the offsets (in cell edges) of a cell itself and of the 26 cells around it.
pub(super) fn around() -> impl Iterator<Item = [i64; 3]> {
    (0..27).map(|n| [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1])
}

fn halves_of_graph(field: &CubicSpline, cell: Cell) -> [State; 8] {
    let mut own = Bernstein::of_cell(field, cell.within(0).at.map(|n| n as usize));
    for level in 1..=cell.level {
        own = own.octants()[cell.within(level).octant()].clone();
    }
    // a part of a graph is a graph
    own.octants().each_ref().map(|half| if half.is_clear() { State::Clear } else { State::Graph })
}

/// Returns the states of the voxel cells of a slice, and the states of the octants of subdivided
/// cells.
fn states_of_slice(field: &CubicSpline, signs: &Signs, size: [usize; 3], k: usize) -> (Vec<Packed>, Vec<[Packed; 8]>) {
    let mut halving = Halving::default();
    let mut states = vec![Packed::from(State::Clear); size[0] * size[1]];
    for n in signs.changes(k, 0) {
        if let Some(whole) = Bernstein::of_crossed_cell(field, [n % size[0], n / size[0], k]) {
            states[n] = halving.voxel(&whole).into();
        }
    }
    (states, halving.halves.into_iter().map(|own| own.map(Packed::from)).collect())
}

/// Subdivides voxel cells one after another.
#[derive(Default)]
struct Halving {
    halves: Vec<[State; 8]>,
    /// Uncertain cells of the finest level reached in the current voxel: index of the octants,
    /// octant number, and F in the cell.
    uncertain: Vec<(usize, usize, Bernstein)>,
}

impl Halving {
    /// Returns the state of a voxel cell, given F in the cell.
    fn voxel(&mut self, whole: &Bernstein) -> State {
        let state = self.state(whole, 0);
        for level in BASE + 1..=DEPTH {
            if self.uncertain.len() > MOST_UNCERTAIN {
                break;
            }
            for (number, octant, own) in std::mem::take(&mut self.uncertain) {
                self.halves[number][octant] = self.halved(&own, level);
            }
        }
        self.uncertain.clear();
        state
    }

    fn state(&mut self, own: &Bernstein, level: u8) -> State {
        if own.is_clear() {
            State::Clear
        } else if own.is_graph() {
            State::Graph
        } else if level >= BASE {
            State::Undecided
        } else {
            self.halved(own, level + 1)
        }
    }

    /// Subdivides a cell into octants of the given level and returns its state.
    fn halved(&mut self, own: &Bernstein, level: u8) -> State {
        let number = self.halves.len();
        self.halves.push([State::Clear; 8]);
        for (octant, half) in own.octants().iter().enumerate() {
            let state = self.state(half, level);
            self.halves[number][octant] = state;
            if state == State::Undecided {
                self.uncertain.push((number, octant, half.clone()));
            }
        }
        State::Halved(number as u32)
    }
}
