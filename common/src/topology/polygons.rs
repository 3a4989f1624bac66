//! All polygons of the surface that the cells tell of, put together: components, their Euler characteristics and sizes, and which
//! crossings each cell has.

use super::cells::{Cell, Cells, DEPTH, State};
use super::surface::{Crossing, Polygons, Reader};
use super::{Bounds, Component};
use crate::components::DisjointSets;
use crate::spline::CubicSpline;
use glam::DVec3;
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
    /// The cells that are neither certain nor halved, ascending.
    pub(super) undecided: Vec<Cell>,
}

/// What the cells of a slice of voxels have.
struct Slice {
    polygons: Vec<Polygons>,
    undecided: Vec<Cell>,
}

impl Surface {
    pub(super) fn new(field: &CubicSpline, cells: &Cells) -> Self {
        let slices: Vec<Slice> = (0..cells.size()[2] as u32)
            .into_par_iter()
            .map(|k| {
                let mut reader = Reader::new(field, cells);
                let crossed = cells.crossed_in_slice(k);
                let undecided =
                    crossed.iter().filter(|(_, state)| *state == State::Undecided).map(|(c, _)| *c).collect();
                let polygons = crossed.into_iter().map(|(cell, _)| reader.polygons(cell));
                Slice { polygons: polygons.filter(|p| !p.corners.is_empty()).collect(), undecided }
            })
            .collect();
        let polygons = || slices.iter().flat_map(|slice| &slice.polygons);
        let mut crossings: Vec<Crossing> = polygons().flat_map(|p| p.corners.iter().flatten().copied()).collect();
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
        let ways: Vec<Vec<Vec<u32>>> = slices
            .par_iter()
            .flat_map_iter(|slice| &slice.polygons)
            .map(|p| p.corners.iter().map(|way| way.iter().map(index).collect()).collect())
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
        let at_border: Vec<u32> = polygons().flat_map(|p| &p.at_border).map(index).collect();
        let components = components(&positions, &component_of, count as usize, &ways, &at_border);
        let mut corners = Vec::new();
        let mut ends = Vec::with_capacity(ways.len());
        for (p, ways) in polygons().zip(&ways) {
            corners.extend(ways.iter().flatten());
            ends.push((order(cells, p.cell), corners.len() as u32));
        }
        let undecided = slices.iter().flat_map(|slice| slice.undecided.iter().copied()).collect();
        let mut new = Self { positions, component_of, components, cells: ends, corners, undecided };
        new.undecided.sort_unstable();
        new
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
    let new = Component {
        group: 0,
        is_certain: true,
        euler: 0,
        place: DVec3::ZERO,
        bounds: Bounds::EMPTY,
        area: 0.0,
        volume: 0.0,
    };
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
