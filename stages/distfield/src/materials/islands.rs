//! Removes islands: components of a few voxels that a segmentation leaves behind. Islands are
//! merged into the surrounding materials (`--smallest-island`).

use super::grid::LabelGrid;
use isoparticles_field::materials::{Material, MaterialId};
use isoparticles_mesh::components::DisjointSets;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::Range;

/// The islands of one material.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Islands {
    /// Number of the material in the original table.
    #[serde(skip)]
    pub material: MaterialId,
    /// Name of the material.
    pub name: String,
    /// True if the material had only islands and was removed.
    #[serde(rename = "all")]
    pub is_all: bool,
    /// Number of islands.
    pub count: usize,
    /// Total number of voxels of the islands.
    pub voxels: usize,
    /// Number of voxels of the largest island.
    pub largest: usize,
    /// Centre of a voxel of the largest island, in world coordinates, mm.
    pub place: [f64; 3],
}

/// Consecutive voxels of one material in a row.
#[derive(Clone, Copy)]
struct Run {
    /// Index of the first voxel, and one more than the index of the last voxel.
    voxels: [usize; 2],
    material: u16,
}

/// Assigns every component of fewer than `least` voxels to the material that shares the most faces
/// with it; ties go to the lower material number. Components of the outside are included. Voxels of
/// a component are connected through faces.
///
/// Where islands touch each other, islands next to a larger component are removed first. A material
/// that consists only of islands is removed from the table, and the materials after it move up.
/// Returns the islands by material, in the order of the original table.
pub fn remove_islands(grid: &mut LabelGrid, table: &mut Vec<Material>, least: usize) -> Vec<Islands> {
    let mut found: BTreeMap<u16, Islands> = BTreeMap::new();
    while remove_outermost(grid, least, &mut found) {}
    let mut islands: Vec<Islands> = found.into_values().collect();
    islands.iter_mut().for_each(|own| own.name.clone_from(&table[own.material.index()].name));
    let is_left = remove_empty(grid, table);
    islands.iter_mut().for_each(|own| own.is_all = !is_left[own.material.index()]);
    islands
}

/// Removes the materials without voxels from the table; the materials after them move up. Returns
/// which materials are left.
pub fn remove_empty(grid: &mut LabelGrid, table: &mut Vec<Material>) -> Vec<bool> {
    let is_left: Vec<bool> =
        grid.extents(table.len()).iter().enumerate().map(|(id, own)| id == 0 || own.count > 0).collect();
    if is_left.contains(&false) {
        let number = |id: usize| is_left[..id].iter().filter(|&&left| left).count() as u16;
        let numbers: Vec<u16> = (0..table.len()).map(number).collect();
        grid.numbers.par_iter_mut().for_each(|own| *own = numbers[usize::from(*own)]);
        let mut kept = is_left.iter();
        table.retain(|_| kept.next() == Some(&true));
    }
    is_left
}

/// Reassigns the islands next to larger components. Returns false if there are none.
fn remove_outermost(grid: &mut LabelGrid, least: usize, found: &mut BTreeMap<u16, Islands>) -> bool {
    let (runs, start) = runs(grid);
    let [nx, ny, _] = grid.geometry.size;
    // returns only the preceding rows along y and z, so that each pair of rows is visited once
    let neighbours =
        |row: usize| [(!row.is_multiple_of(ny)).then(|| row - 1), row.checked_sub(ny)].into_iter().flatten();
    let mut sets = DisjointSets::new(runs.len());
    each_contact(&runs, &start, nx, neighbours, |a, b, _| {
        if runs[a].material == runs[b].material {
            sets.join(a as u32, b as u32);
        }
    });
    let component: Vec<u32> = (0..runs.len() as u32).map(|run| sets.find(run)).collect();
    let mut size = vec![0usize; runs.len()];
    runs.iter().zip(&component).for_each(|(run, &of)| size[of as usize] += run.voxels[1] - run.voxels[0]);
    let is_small = |run: usize| size[component[run] as usize] < least;
    // number of faces that each island shares with materials of larger components
    let mut faces: BTreeMap<u32, BTreeMap<u16, usize>> = BTreeMap::new();
    let mut share = |island: usize, other: usize, count: usize| {
        if is_small(island) && !is_small(other) {
            *faces.entry(component[island]).or_default().entry(runs[other].material).or_default() += count;
        }
    };
    let mut contact = |a: usize, b: usize, count: usize| {
        share(a, b, count);
        share(b, a, count);
    };
    each_contact(&runs, &start, nx, neighbours, &mut contact);
    for row in start.windows(2) {
        (row[0] + 1..row[1]).for_each(|next| contact(next - 1, next, 1));
    }
    // ties go to the lower material number
    let heir = |faces: &BTreeMap<u16, usize>| faces.iter().rev().max_by_key(|(_, count)| **count).map(|(&id, _)| id);
    let heirs: BTreeMap<u32, u16> = faces.iter().filter_map(|(&island, faces)| Some((island, heir(faces)?))).collect();
    for (run, of) in runs.iter().zip(&component) {
        let Some(&heir) = heirs.get(of) else { continue };
        grid.numbers[run.voxels[0]..run.voxels[1]].fill(heir);
    }
    for &island in heirs.keys() {
        let (first, size) = (runs[island as usize], size[island as usize]);
        let own = found.entry(first.material).or_insert_with(|| Islands {
            material: MaterialId(first.material),
            name: String::new(),
            is_all: false,
            count: 0,
            voxels: 0,
            largest: 0,
            place: [0.0; 3],
        });
        own.count += 1;
        own.voxels += size;
        if size > own.largest {
            own.largest = size;
            let place = grid.geometry.node_to_grid(first.voxels[0]);
            own.place = grid.geometry.grid_to_world(place).to_array();
        }
    }
    !heirs.is_empty()
}

/// Returns the runs of all rows, and the index of the first run of each row.
fn runs(grid: &LabelGrid) -> (Vec<Run>, Vec<usize>) {
    let (mut runs, mut start) = (Vec::new(), vec![0]);
    let mut first = 0;
    for row in grid.numbers.chunks(grid.geometry.size[0]) {
        for own in row.chunk_by(|a, b| a == b) {
            runs.push(Run { voxels: [first, first + own.len()], material: own[0] });
            first += own.len();
        }
        start.push(runs.len());
    }
    (runs, start)
}

/// Visits all pairs of runs in adjacent rows that share faces, with the number of shared faces.
fn each_contact<N: Iterator<Item = usize>>(
    runs: &[Run],
    start: &[usize],
    nx: usize,
    neighbours: impl Fn(usize) -> N,
    mut visit: impl FnMut(usize, usize, usize),
) {
    let columns = |run: usize, row: usize| runs[run].voxels.map(|voxel| voxel - row * nx);
    for row in 0..start.len() - 1 {
        let own: Range<usize> = start[row]..start[row + 1];
        for other in neighbours(row) {
            let (mut a, mut b) = (own.start, start[other]);
            while a < own.end && b < start[other + 1] {
                let ([a_first, a_end], [b_first, b_end]) = (columns(a, row), columns(b, other));
                let shared = a_end.min(b_end).saturating_sub(a_first.max(b_first));
                if shared > 0 {
                    visit(a, b, shared);
                }
                a += usize::from(a_end <= b_end);
                b += usize::from(b_end <= a_end);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Border;
    use glam::DVec3;
    use isoparticles_volume::Geometry;

    /// Builds a grid from rows of characters. Empty strings separate slices, and '.' is the
    /// outside.
    fn grid(rows: &[&str]) -> (LabelGrid, Vec<Material>) {
        let slices: Vec<&[&str]> = rows.split(|row| row.is_empty()).collect();
        let size = [slices[0][0].len(), slices[0].len(), slices.len()];
        let numbers = rows.concat().bytes().map(|c| if c == b'.' { 0 } else { u16::from(c - b'0') }).collect();
        let mut geometry = Geometry::axis_aligned(size, DVec3::new(1.0, 2.0, 3.0));
        geometry.origin = DVec3::splat(10.0);
        let table = (0..4).map(|n| Material { name: format!("m{n}"), labels: Vec::new() }).collect();
        (LabelGrid { geometry, numbers, border: Border::Cap, margin: 3 }, table)
    }

    #[test]
    fn islands_go_to_the_material_with_the_most_shared_faces() {
        // the islands are single voxels: one of material 1 in the outside, one of material 2 in
        // material 1, and three of the outside (in material 1, between materials 1 and 2, and at
        // the end of the last row)
        let (mut given, mut table) = grid(&["...1....", "111.1122", "12111.22", "1111111."]);
        let found = remove_islands(&mut given, &mut table, 3);
        let (expected, _) = grid(&["........", "11111122", "11111122", "11111111"]);
        assert_eq!(given.numbers, expected.numbers);
        let told: Vec<_> = found.iter().map(|i| (i.material.0, i.count, i.voxels, i.largest)).collect();
        assert_eq!(told, [(0, 3, 3, 1), (1, 1, 1, 1), (2, 1, 1, 1)]);
        assert_eq!(found[1].place, [13.0, 10.0, 10.0]);
    }

    #[test]
    fn nested_islands_are_removed_from_the_outside_in() {
        let (mut given, mut table) = grid(&["1111", "1111", "", "1211", "1231", "", "1111", "1111"]);
        let found = remove_islands(&mut given, &mut table, 3);
        assert!(given.numbers.iter().all(|&own| own == 1));
        let told: Vec<_> = found.iter().map(|own| (own.name.as_str(), own.voxels, own.is_all)).collect();
        assert_eq!(told, [("m2", 2, true), ("m3", 1, true)]);
        assert_eq!(table.iter().map(|own| own.name.as_str()).collect::<Vec<_>>(), ["m0", "m1"]);
        let (mut given, mut table) = grid(&["111222", "133222", "113122", "111222"]);
        let found = remove_islands(&mut given, &mut table, 2);
        let (expected, _) = grid(&["111222", "133222", "113222", "111222"]);
        assert_eq!(given.numbers, expected.numbers, "the 1 between 3 and 2 shares three faces with 2");
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].is_all, table.len()), (false, 4));
        assert!(remove_islands(&mut given, &mut table, 2).is_empty());
    }
}
