//! Assembles the polygons of all cells into the surface: its components with their Euler
//! characteristics and sizes, and the crossings in each cell.

use super::cells::{BASE, Cell, Cells, DEPTH, State, around, moved};
use super::polygons::{Crossing, OfCell, Polygons, Reader, crossings_in_slice};
use super::watch::{Interrupted, Watch};
use super::{Bounds, Component};
use crate::spline::CubicSpline;
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::components::DisjointSets;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The polygons of a volume.
pub(super) struct Surface {
    /// Position of each crossing in the grid frame, mm.
    pub(super) positions: Vec<DVec3>,
    /// Component of each crossing.
    pub(super) component_of: Vec<u32>,
    /// Components, in the order of their first crossings.
    pub(super) components: Vec<Component>,
    /// The cells with polygons, in order. Each is given by its position in the order of all cells,
    /// and is paired with the end of its polygons in `ends`.
    cells: Vec<(u64, u32)>,
    /// End of each polygon in `corners`.
    ends: Vec<u32>,
    /// Crossings of the polygons.
    corners: Vec<u32>,
    /// The voxels with polygons, in ascending order. Each is paired with the component of all its
    /// polygons, or [`SEVERAL`].
    voxels: Vec<(u64, u32)>,
    /// Start of each row of voxels along x in `voxels`, followed by the end of the last row.
    rows: Vec<u32>,
    /// Cells that are uncertain and not subdivided further, in ascending order.
    pub(super) undecided: Vec<Cell>,
}

/// Sentinel in place of a component number, for a voxel with several components.
const SEVERAL: u32 = u32::MAX;

impl Surface {
    /// Extracts the surface, and subdivides cells that contain several polygons. One of these
    /// polygons may be a loop around a corner of smaller neighbouring cells. Only subdivision shows
    /// whether the loop closes or joins another polygon.
    pub(super) fn new(field: &CubicSpline, cells: &mut Cells, watch: &Watch<'_>) -> Result<Self, Interrupted> {
        let (mut slices, undecided) = read_all(field, cells, watch)?;
        loop {
            let several = |own: &&OfCell| own.count() > 1 && own.cell.level < BASE;
            let several = slices.par_iter().flat_map_iter(|own| own.cells.iter().filter(several).map(|own| own.cell));
            let mut several: Vec<Cell> = several.collect();
            if several.is_empty() {
                break;
            }
            several.par_sort_unstable();
            let changed = cells.refine(field, &several);
            let beside = |&at: &[u32; 3]| around().filter_map(move |away| moved(Cell { level: 0, at }, away));
            let mut again: Vec<Cell> = changed.par_iter().flat_map_iter(beside).collect();
            let order = |cell: &Cell| [cell.at[2], cell.at[1], cell.at[0]];
            again.par_sort_unstable_by_key(order);
            again.dedup();
            slices.par_iter_mut().enumerate().for_each(|(k, own)| {
                let of_slice = again.partition_point(|cell| (cell.at[2] as usize) < k);
                let again = &again[of_slice..again.partition_point(|cell| cell.at[2] as usize <= k)];
                if again.is_empty() {
                    return;
                }
                own.cells.retain(|cell| again.binary_search_by_key(&order(&cell.cell.within(0)), order).is_err());
                let mut crossed = Vec::new();
                again.iter().for_each(|&voxel| cells.crossed_in(voxel, &mut crossed));
                read(field, cells, &crossed, own);
                own.cells.sort_unstable_by_key(|cell| cell.order);
            });
        }
        Ok(Self::of(field, cells, &slices, undecided))
    }

    /// Assembles the polygons of all slices of voxels.
    pub(super) fn of(field: &CubicSpline, cells: &Cells, slices: &[Polygons], mut undecided: Vec<Cell>) -> Self {
        let crossings = Crossings::new(cells, slices);
        let positions: Vec<DVec3> = crossings
            .by_slice
            .par_iter()
            .flat_map_iter(|own| {
                let mut reader = Reader::new(field, cells);
                own.iter().map(|&crossing| reader.position(crossing)).collect::<Vec<_>>()
            })
            .collect();
        let slices: Vec<Slice> = slices.par_iter().map(|own| Slice::new(own, &crossings)).collect();
        drop(crossings);
        let mut sets = DisjointSets::new(positions.len());
        for polygon in slices.iter().flat_map(Slice::polygons) {
            polygon.windows(2).for_each(|pair| sets.join(pair[0], pair[1]));
        }
        let mut component_of = vec![0; positions.len()];
        let mut count = 0;
        for crossing in 0..positions.len() as u32 {
            let first = sets.find(crossing);
            // the first crossing of a component receives its component number before the other
            // crossings look it up
            component_of[crossing as usize] = if first == crossing { count } else { component_of[first as usize] };
            count += u32::from(first == crossing);
        }
        let components = components(&positions, &component_of, count as usize, &slices);
        let voxels: Vec<(u64, u32)> = slices.par_iter().flat_map_iter(|own| own.voxels(&component_of)).collect();
        let rows = rows(&voxels, cells.size());
        let mut new = Self {
            positions,
            component_of,
            components,
            cells: Vec::new(),
            ends: Vec::new(),
            corners: Vec::new(),
            voxels,
            rows,
            undecided: Vec::new(),
        };
        for own in slices {
            let (polygons, corners) = (new.ends.len() as u32, new.corners.len() as u32);
            new.cells.extend(own.cells.into_iter().map(|(order, end)| (order, end + polygons)));
            new.ends.extend(own.ends.into_iter().map(|end| end + corners));
            new.corners.extend(own.corners);
        }
        undecided.sort_unstable();
        new.undecided = undecided;
        new
    }

    /// Returns the polygons of a component, divided into triangles, in the order of the cells.
    pub(super) fn mesh(&self, component: u32) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        let mut number = BTreeMap::new();
        for n in 0..self.ends.len() {
            let first = if n == 0 { 0 } else { self.ends[n - 1] };
            let polygon = &self.corners[first as usize..self.ends[n] as usize];
            if self.component_of[polygon[0] as usize] != component {
                continue;
            }
            let corners: Vec<u32> = polygon
                .iter()
                .map(|&crossing| {
                    *number.entry(crossing).or_insert_with(|| {
                        mesh.vertices.push(self.positions[crossing as usize]);
                        mesh.vertices.len() as u32 - 1
                    })
                })
                .collect();
            mesh.triangles.extend((1..corners.len() - 1).map(|k| [corners[0], corners[k], corners[k + 1]]));
        }
        mesh
    }

    /// For each voxel of `row` that has polygons, returns the component of its polygons, or `None`
    /// if there are several components.
    pub(super) fn components_of_voxels(
        &self,
        cells: &Cells,
        row: impl Iterator<Item = Cell>,
    ) -> impl Iterator<Item = Option<u32>> {
        let size = cells.size().map(|n| n as u64);
        let inside =
            row.map(|voxel| voxel.at.map(u64::from)).filter(move |at| (0..3).all(|axis| at[axis] < size[axis]));
        inside.filter_map(move |[i, j, k]| {
            let row = k * size[1] + j;
            let number = row * size[0] + i;
            let [from, to] = [row, row + 1].map(|row| self.rows[row as usize] as usize);
            let found = self.voxels[from..to].binary_search_by_key(&number, |&(own, _)| own).ok()?;
            Some(Some(self.voxels[from + found].1).filter(|&component| component != SEVERAL))
        })
    }

    /// Returns the crossings of the polygons in a cell.
    pub(super) fn crossings_in(&self, cells: &Cells, cell: Cell) -> &[u32] {
        let order = order(cells, cell);
        let n = self.cells.partition_point(|&(own, _)| own < order);
        if self.cells.get(n).is_none_or(|&(own, _)| own != order) {
            return &[];
        }
        let corner = |polygon: u32| if polygon == 0 { 0 } else { self.ends[polygon as usize - 1] as usize };
        let first = if n == 0 { 0 } else { self.cells[n - 1].1 };
        &self.corners[corner(first)..corner(self.cells[n].1)]
    }
}

/// Returns the polygons in all leaf cells, grouped by slices of voxels, and the undecided cells.
/// Does not subdivide cells.
pub(super) fn read_all(
    field: &CubicSpline,
    cells: &Cells,
    watch: &Watch<'_>,
) -> Result<(Vec<Polygons>, Vec<Cell>), Interrupted> {
    let slice = |k: u32| {
        watch.slice()?;
        let crossed = cells.crossed_in_slice(k);
        let mut polygons = Polygons::default();
        read(field, cells, &crossed, &mut polygons);
        let undecided = crossed.iter().filter(|(_, state)| *state == State::Undecided);
        Ok((polygons, undecided.map(|(cell, _)| *cell).collect::<Vec<Cell>>()))
    };
    let slices = (0..cells.size()[2] as u32).into_par_iter().map(slice).collect::<Result<Vec<_>, _>>()?;
    let (polygons, undecided): (_, Vec<Vec<Cell>>) = slices.into_iter().unzip();
    Ok((polygons, undecided.concat()))
}

/// Adds the polygons in the given cells to `all`.
fn read(field: &CubicSpline, cells: &Cells, crossed: &[(Cell, State)], all: &mut Polygons) {
    let mut reader = Reader::new(field, cells);
    crossed.iter().for_each(|(cell, _)| reader.polygons(*cell, order(cells, *cell), all));
}

/// All crossings in ascending order, grouped by the slices of voxels in which their edges start.
struct Crossings {
    /// Crossings of each slice, followed by the crossings on the upper border of the last slice.
    by_slice: Vec<Vec<Crossing>>,
    /// Number of crossings before each slice.
    before: Vec<u32>,
    /// How many crossing numbers are reserved for each slice.
    span: u64,
}

impl Crossings {
    fn new(cells: &Cells, slices: &[Polygons]) -> Self {
        let span = crossings_in_slice(cells);
        let seen: Vec<Vec<Crossing>> = slices
            .par_iter()
            .map(|own| {
                let mut seen: Vec<Crossing> =
                    own.cells.iter().flat_map(|cell| own.of(cell)).flatten().copied().collect();
                seen.sort_unstable();
                seen.dedup();
                seen
            })
            .collect();
        // a slice contributes its own crossings, and the crossings on the plane that it shares with
        // the next slice
        let by_slice: Vec<Vec<Crossing>> = (0..=seen.len())
            .into_par_iter()
            .map(|k| {
                let part = |n: usize| {
                    let seen = &seen[n];
                    let split = |slice: usize| seen.partition_point(|&crossing| crossing < slice as u64 * span);
                    &seen[split(k)..split(k + 1)]
                };
                let mut own = if k > 0 { part(k - 1).to_vec() } else { Vec::new() };
                if k < seen.len() {
                    own.extend_from_slice(part(k));
                    own.sort_unstable();
                    own.dedup();
                }
                own
            })
            .collect();
        let before = by_slice.iter().scan(0, |count, own| Some(std::mem::replace(count, *count + own.len() as u32)));
        let before = before.collect();
        Self { by_slice, before, span }
    }

    /// Returns the index of a crossing among all crossings.
    fn index(&self, crossing: Crossing) -> u32 {
        let slice = (crossing / self.span) as usize;
        self.before[slice] + self.by_slice[slice].partition_point(|&other| other < crossing) as u32
    }
}

/// The polygons of a slice of voxels. Crossings are given by their indices among all crossings.
struct Slice {
    /// Position of each cell in the order of all cells, and the end of its polygons in `ends`.
    cells: Vec<(u64, u32)>,
    /// End of each polygon in `corners`.
    ends: Vec<u32>,
    corners: Vec<u32>,
    at_border: Vec<u32>,
}

impl Slice {
    fn new(polygons: &Polygons, crossings: &Crossings) -> Self {
        let mut new = Self { cells: Vec::new(), ends: Vec::new(), corners: Vec::new(), at_border: Vec::new() };
        for cell in &polygons.cells {
            for polygon in polygons.of(cell) {
                new.corners.extend(polygon.iter().map(|&crossing| crossings.index(crossing)));
                new.ends.push(new.corners.len() as u32);
            }
            new.cells.push((cell.order, new.ends.len() as u32));
            new.at_border.extend(polygons.at_border(cell).iter().map(|&crossing| crossings.index(crossing)));
        }
        new
    }

    fn polygons(&self) -> impl Iterator<Item = &[u32]> {
        let firsts = std::iter::once(0).chain(self.ends.iter().copied());
        firsts.zip(&self.ends).map(|(first, &end)| &self.corners[first as usize..end as usize])
    }

    /// Returns the voxels in ascending order. Each is paired with the component of all its
    /// polygons, or [`SEVERAL`].
    fn voxels(&self, component_of: &[u32]) -> Vec<(u64, u32)> {
        let mut voxels: Vec<(u64, u32)> = Vec::new();
        let mut polygons = self.polygons();
        let mut first = 0;
        for &(place, end) in &self.cells {
            let voxel = place >> (3 * DEPTH);
            for polygon in polygons.by_ref().take((end - first) as usize) {
                let component = component_of[polygon[0] as usize];
                match voxels.last_mut() {
                    Some((last, only)) if *last == voxel => {
                        *only = if *only == component { component } else { SEVERAL }
                    }
                    _ => voxels.push((voxel, component)),
                }
            }
            first = end;
        }
        voxels
    }
}

/// Returns the start of each row along x in a sorted list of voxels, followed by the end of the
/// last row.
fn rows(voxels: &[(u64, u32)], size: [usize; 3]) -> Vec<u32> {
    let mut rows = vec![0; size[1] * size[2] + 1];
    voxels.iter().for_each(|(voxel, _)| rows[*voxel as usize / size[0] + 1] += 1);
    (1..rows.len()).for_each(|row| rows[row] += rows[row - 1]);
    rows
}

/// Returns the position of a leaf cell in the order of all leaf cells. They are ordered by voxel, x
/// fastest, and within a voxel by octants.
fn order(cells: &Cells, cell: Cell) -> u64 {
    let [nx, ny, _] = cells.size().map(|n| n as u64);
    let voxel = cell.within(0).at.map(u64::from);
    let corner = cell.corner();
    let within = (0..u32::from(DEPTH)).flat_map(|bit| (0..3).map(move |axis| (bit, axis)));
    let within = within.map(|(bit, axis)| (corner[axis as usize] >> bit & 1) << (3 * bit + axis)).sum::<u64>();
    ((voxel[2] * ny + voxel[1]) * nx + voxel[0]) << (3 * DEPTH) | within
}

fn components(positions: &[DVec3], component_of: &[u32], count: usize, slices: &[Slice]) -> Vec<Component> {
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
    let size = |way: &[u32]| {
        let place = components[component_of[way[0] as usize] as usize].place;
        let corner = |k: usize| positions[way[k] as usize] - place;
        let fan = (1..way.len() - 1).map(|k| [corner(0), corner(k), corner(k + 1)]);
        let area: DVec3 = fan.clone().map(|[a, b, c]| 0.5 * (b - a).cross(c - a)).sum();
        let volume: f64 = fan.map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
        (area.length(), volume)
    };
    let sizes: Vec<Vec<(f64, f64)>> = slices.par_iter().map(|own| own.polygons().map(size).collect()).collect();
    for (own, sizes) in slices.iter().zip(sizes) {
        for (way, (area, volume)) in own.polygons().zip(sizes) {
            let component = component_of[way[0] as usize] as usize;
            sides[component] += way.len() as i64;
            components[component].euler += 1;
            components[component].area += area;
            components[component].volume += volume;
        }
        // a side belongs to two polygons; a side on the border belongs to one, so it is counted
        // again
        own.at_border.iter().for_each(|&crossing| sides[component_of[crossing as usize] as usize] += 1);
    }
    components.iter_mut().zip(sides).for_each(|(own, sides)| own.euler -= sides / 2);
    components
}
