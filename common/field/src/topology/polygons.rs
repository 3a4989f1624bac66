//! All polygons of the surface that the cells tell of, put together: components, their Euler characteristics and sizes, and which
//! crossings each cell has.

use super::cells::{BASE, Cell, Cells, DEPTH, State, around, moved};
use super::surface::{Crossing, Polygons, Reader};
use super::{Bounds, Component};
use crate::spline::CubicSpline;
use glam::DVec3;
use isoparticles_mesh::components::DisjointSets;
use rayon::prelude::*;

/// Crossings whose places one task finds.
const CHUNK: usize = 1 << 12;

/// The polygons of a volume.
pub(super) struct Surface {
    /// Where each crossing is, grid frame, mm.
    pub(super) positions: Vec<DVec3>,
    /// Component of each.
    pub(super) component_of: Vec<u32>,
    /// The components, in the order of their first crossings.
    pub(super) components: Vec<Component>,
    /// The cells with polygons by their place in the order of all, ascending, each with the end of its crossings in the list below.
    cells: Vec<(u64, u32)>,
    /// Crossings of the polygons in each cell.
    corners: Vec<u32>,
    /// The voxels with polygons, ascending, each with the component of all of them, [`SEVERAL`] where there is more than one.
    voxels: Vec<(u64, u32)>,
    /// The cells that are neither certain nor halved, ascending.
    pub(super) undecided: Vec<Cell>,
}

/// In place of a component's number.
const SEVERAL: u32 = u32::MAX;

impl Surface {
    /// Reads the surface, and halves cells on the way that have several polygons. One of these may be a loop round a corner of smaller cells beside:
    /// whether it closes there, or opens into another of them, shows when it is halved.
    pub(super) fn new(field: &CubicSpline, cells: &mut Cells) -> Self {
        let (mut polygons, undecided) = read_all(field, cells);
        loop {
            let several = |(_, p): &&(u64, Polygons)| p.corners.len() > 1 && p.cell.level < BASE;
            let mut several: Vec<Cell> = polygons.par_iter().filter(several).map(|(_, p)| p.cell).collect();
            if several.is_empty() {
                break;
            }
            several.par_sort_unstable();
            let changed = cells.refine(field, &several);
            let beside = |&at: &[u32; 3]| around().filter_map(move |away| moved(Cell { level: 0, at }, away));
            let mut again: Vec<Cell> = changed.par_iter().flat_map_iter(beside).collect();
            again.par_sort_unstable();
            again.dedup();
            polygons.retain(|(_, p)| again.binary_search(&p.cell.within(0)).is_err());
            let read_again = |voxels: &[Cell]| {
                let mut crossed = Vec::new();
                voxels.iter().for_each(|&voxel| cells.crossed_in(voxel, &mut crossed));
                read(field, cells, &crossed)
            };
            polygons.par_extend(again.par_chunks(CHUNK).flat_map_iter(read_again));
        }
        polygons.par_sort_unstable_by_key(|&(order, _)| order);
        Self::of(field, cells, &polygons, undecided)
    }

    /// Puts polygons together, which are in the order of their cells.
    pub(super) fn of(field: &CubicSpline, cells: &Cells, all: &[(u64, Polygons)], undecided: Vec<Cell>) -> Self {
        let mut crossings: Vec<Crossing> =
            all.par_iter().flat_map_iter(|(_, p)| p.corners.iter().flatten().copied()).collect();
        crossings.par_sort_unstable();
        crossings.dedup();
        let index = |crossing: &Crossing| crossings.partition_point(|c| c < crossing) as u32;
        let positions: Vec<DVec3> = crossings
            .par_chunks(CHUNK)
            .flat_map_iter(|chunk| {
                let mut reader = Reader::new(field, cells);
                chunk.iter().map(|&crossing| reader.position(crossing)).collect::<Vec<_>>()
            })
            .collect();
        let ways: Vec<Vec<Vec<u32>>> = all
            .par_iter()
            .map(|(_, p)| p.corners.iter().map(|way| way.iter().map(index).collect()).collect())
            .collect();
        let mut sets = DisjointSets::new(crossings.len());
        for way in ways.iter().flatten() {
            way.windows(2).for_each(|pair| sets.join(pair[0], pair[1]));
        }
        let mut component_of = vec![0; crossings.len()];
        let mut count = 0;
        for crossing in 0..crossings.len() as u32 {
            let first = sets.find(crossing);
            // the first of a component has its number before the others ask for it
            component_of[crossing as usize] = if first == crossing { count } else { component_of[first as usize] };
            count += u32::from(first == crossing);
        }
        let at_border: Vec<u32> = all.iter().flat_map(|(_, p)| &p.at_border).map(index).collect();
        let components = components(&positions, &component_of, count as usize, &ways, &at_border);
        let mut corners = Vec::new();
        let mut ends = Vec::with_capacity(ways.len());
        for (&(order, _), ways) in all.iter().zip(&ways) {
            corners.extend(ways.iter().flatten());
            ends.push((order, corners.len() as u32));
        }
        let mut voxels: Vec<(u64, u32)> = Vec::new();
        let mut first = 0;
        for &(place, end) in &ends {
            let voxel = place >> (3 * DEPTH);
            for &corner in &corners[first as usize..end as usize] {
                let component = component_of[corner as usize];
                match voxels.last_mut() {
                    Some((last, only)) if *last == voxel => {
                        *only = if *only == component { component } else { SEVERAL }
                    }
                    _ => voxels.push((voxel, component)),
                }
            }
            first = end;
        }
        let mut new = Self { positions, component_of, components, cells: ends, corners, voxels, undecided };
        new.undecided.sort_unstable();
        new
    }

    /// The component of all polygons in each of some voxels of a row, ascending, that have any; `None` where there are several.
    pub(super) fn components_of_voxels(
        &self,
        cells: &Cells,
        row: impl Iterator<Item = Cell>,
    ) -> impl Iterator<Item = Option<u32>> {
        let size = cells.size().map(|n| n as u64);
        let inside =
            row.map(|voxel| voxel.at.map(u64::from)).filter(move |at| (0..3).all(|axis| at[axis] < size[axis]));
        let mut rest = &self.voxels[..];
        inside.filter_map(move |[i, j, k]| {
            let number = (k * size[1] + j) * size[0] + i;
            // those of a row follow each other closely
            let near = rest.partition_point(|(own, _)| *own < number);
            rest = &rest[near..];
            let found = rest.first().filter(|(own, _)| *own == number)?;
            Some(Some(found.1).filter(|&component| component != SEVERAL))
        })
    }

    /// The crossings of the polygons in a cell.
    pub(super) fn crossings_in(&self, cells: &Cells, cell: Cell) -> &[u32] {
        let order = order(cells, cell);
        let n = self.cells.partition_point(|&(own, _)| own < order);
        if self.cells.get(n).is_none_or(|&(own, _)| own != order) {
            return &[];
        }
        let first = if n == 0 { 0 } else { self.cells[n - 1].1 };
        &self.corners[first as usize..self.cells[n].1 as usize]
    }
}

/// The polygons in all cells as they are, in the order of the cells, and the cells that are undecided.
pub(super) fn read_all(field: &CubicSpline, cells: &Cells) -> (Vec<(u64, Polygons)>, Vec<Cell>) {
    let slice = |k: u32| {
        let crossed = cells.crossed_in_slice(k);
        let undecided = crossed.iter().filter(|(_, state)| *state == State::Undecided);
        (read(field, cells, &crossed), undecided.map(|(cell, _)| *cell).collect::<Vec<Cell>>())
    };
    let slices: Vec<_> = (0..cells.size()[2] as u32).into_par_iter().map(slice).collect();
    let mut all = Vec::with_capacity(slices.iter().map(|(polygons, _)| polygons.len()).sum());
    let mut undecided = Vec::new();
    for (polygons, own) in slices {
        all.extend(polygons);
        undecided.extend(own);
    }
    (all, undecided)
}

/// The polygons in some cells, each with the place of its cell in the order of all.
fn read(field: &CubicSpline, cells: &Cells, crossed: &[(Cell, State)]) -> Vec<(u64, Polygons)> {
    let mut reader = Reader::new(field, cells);
    let polygons = crossed.iter().map(|(cell, _)| reader.polygons(*cell)).filter(|p| !p.corners.is_empty());
    polygons.map(|p| (order(cells, p.cell), p)).collect()
}

/// The place of a cell that is not halved in the order of all: by voxel, x fastest, and within it as the halves follow each other.
fn order(cells: &Cells, cell: Cell) -> u64 {
    let [nx, ny, _] = cells.size().map(|n| n as u64);
    let voxel = cell.within(0).at.map(u64::from);
    let corner = cell.corner();
    let within = (0..u32::from(DEPTH)).flat_map(|bit| (0..3).map(move |axis| (bit, axis)));
    let within = within.map(|(bit, axis)| (corner[axis as usize] >> bit & 1) << (3 * bit + axis)).sum::<u64>();
    ((voxel[2] * ny + voxel[1]) * nx + voxel[0]) << (3 * DEPTH) | within
}

fn components(
    positions: &[DVec3],
    component_of: &[u32],
    count: usize,
    ways: &[Vec<Vec<u32>>],
    at_border: &[u32],
) -> Vec<Component> {
    let new = Component { euler: 0, place: DVec3::ZERO, bounds: Bounds::EMPTY, area: 0.0, volume: 0.0 };
    let mut components = vec![new; count];
    let mut sides = vec![0i64; count];
    for (&p, &component) in positions.iter().zip(component_of) {
        let own = &mut components[component as usize];
        if own.euler == 0 {
            own.place = p;
        }
        own.euler += 1;
        own.bounds = own.bounds.merged(Bounds { low: p, high: p });
    }
    for way in ways.iter().flatten() {
        let component = component_of[way[0] as usize] as usize;
        sides[component] += way.len() as i64;
        let own = &mut components[component];
        own.euler += 1;
        let corner = |k: usize| positions[way[k] as usize] - own.place;
        let fan = (1..way.len() - 1).map(|k| [corner(0), corner(k), corner(k + 1)]);
        let area: DVec3 = fan.clone().map(|[a, b, c]| 0.5 * (b - a).cross(c - a)).sum();
        let volume: f64 = fan.map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
        own.area += area.length();
        own.volume += volume;
    }
    // a side lies in two polygons, unless it is at the border
    at_border.iter().for_each(|&crossing| sides[component_of[crossing as usize] as usize] += 1);
    components.iter_mut().zip(sides).for_each(|(own, sides)| own.euler -= sides / 2);
    components
}
