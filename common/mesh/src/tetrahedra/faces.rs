//! Finds equal faces of tetrahedra, and triangles equal to them.

use super::FACES;
use crate::buckets::{Buckets, TASK_ITEMS};
use crate::components::SharedSets;
use rayon::prelude::*;

/// Number of vertices per task. A mesh has about six tetrahedra per vertex.
const TASK_VERTICES: usize = TASK_ITEMS / 4;

/// A face of a tetrahedron, or a triangle, listed at its smallest vertex.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry {
    /// The other two vertices, ascending.
    others: [u32; 2],
    /// `4 * tetrahedron + position in FACES`, or `4 * tetrahedra + triangle`.
    item: u32,
}

/// Tetrahedra and triangles with common vertices.
#[derive(Clone, Copy)]
pub(super) struct Matching<'a> {
    pub(super) vertex_count: usize,
    pub(super) cells: &'a [[u32; 4]],
    pub(super) triangles: &'a [[u32; 3]],
}

/// Equal faces and triangles: first the faces, then the triangles, both ascending.
pub(super) struct Group<'a> {
    pub(super) faces: &'a [Entry],
    pub(super) triangles: &'a [Entry],
}

impl Group<'_> {
    /// Returns the tetrahedron of each face and its position in [`FACES`].
    pub(super) fn cells(&self) -> impl Iterator<Item = (usize, usize)> {
        self.faces.iter().map(|entry| (entry.item as usize / 4, entry.item as usize % 4))
    }

    /// Merges the sets of all tetrahedra of the group.
    pub(super) fn join(&self, sets: &SharedSets) {
        self.faces.windows(2).for_each(|pair| sets.join(pair[0].item / 4, pair[1].item / 4));
    }
}

impl Matching<'_> {
    /// Calls `visit` for each group of equal faces and triangles. Each task has its own value,
    /// which `visit` changes. Returns these values, in an order that does not depend on the number
    /// of threads.
    pub(super) fn visit<T: Default + Send>(&self, visit: impl Fn(&mut T, Group<'_>) + Sync) -> Vec<T> {
        let of_cells = Buckets::new(self.cells.as_flattened(), self.vertex_count);
        let of_triangles = Buckets::new(self.triangles.as_flattened(), self.vertex_count);
        let face_count = 4 * self.cells.len() as u32;
        let tasks = (0..self.vertex_count).into_par_iter().step_by(TASK_VERTICES);
        let task = |first: usize| {
            let (mut value, mut entries) = (T::default(), Vec::new());
            for v in first as u32..(first + TASK_VERTICES).min(self.vertex_count) as u32 {
                entries.clear();
                for &corner in of_cells.of(v) {
                    let cell = self.cells[corner as usize / 4];
                    let faces = (0..).zip(FACES).map(|(k, face)| (face.map(|i| cell[i]), (corner & !3) + k));
                    entries.extend(faces.filter_map(|(face, item)| entry(v, face, item)));
                }
                for &corner in of_triangles.of(v) {
                    let triangle = corner / 3;
                    entries.extend(entry(v, self.triangles[triangle as usize], face_count + triangle));
                }
                entries.sort_unstable();
                for group in entries.chunk_by(|a, b| a.others == b.others) {
                    let (faces, triangles) = group.split_at(group.partition_point(|entry| entry.item < face_count));
                    visit(&mut value, Group { faces, triangles });
                }
            }
            value
        };
        tasks.map(task).collect()
    }

    /// Returns the number of a triangle.
    pub(super) fn triangle(&self, entry: Entry) -> usize {
        entry.item as usize - 4 * self.cells.len()
    }
}

/// Returns the entry of a face at `vertex`, if this is its smallest vertex.
fn entry(vertex: u32, face: [u32; 3], item: u32) -> Option<Entry> {
    let at = face.iter().position(|&v| v == vertex)?;
    let (one, other) = (face[(at + 1) % 3], face[(at + 2) % 3]);
    let others = [one.min(other), one.max(other)];
    (vertex < others[0]).then_some(Entry { others, item })
}

/// The boundary of a mesh of tetrahedra.
#[derive(Clone, Debug, PartialEq)]
pub struct Boundary {
    /// Faces that belong to exactly one tetrahedron, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// The tetrahedron of each triangle. Triangles are ordered by their position in [`FACES`], then
    /// by their tetrahedron.
    pub owners: Vec<u32>,
    /// Body of each tetrahedron. Tetrahedra that share a face belong to the same body. Bodies are
    /// numbered in the order of their first tetrahedra.
    pub bodies: Vec<u32>,
}

/// Finds the boundary of a mesh and its bodies. All vertex indices must be below `vertex_count`.
pub fn boundary(cells: &[[u32; 4]], vertex_count: usize) -> Boundary {
    let sets = SharedSets::new(cells.len());
    let matching = Matching { vertex_count, cells, triangles: &[] };
    let found = matching.visit(|alone: &mut Vec<(usize, u32)>, group| {
        group.join(&sets);
        if let [entry] = group.faces {
            alone.push((entry.item as usize % 4, entry.item / 4));
        }
    });
    let mut alone = found.concat();
    alone.par_sort_unstable();
    let triangle = |&(face, cell): &(usize, u32)| FACES[face].map(|i| cells[cell as usize][i]);
    Boundary {
        triangles: alone.par_iter().map(triangle).collect(),
        owners: alone.par_iter().map(|&(_, cell)| cell).collect(),
        bodies: sets.numbers(|_| true).0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boundary_of_three_tetrahedra() {
        // the first two share a face, the third only an edge
        let cells = [[0, 1, 2, 3], [4, 1, 2, 0], [1, 2, 5, 6]];
        let found = boundary(&cells, 7);
        assert_eq!(found.bodies, [0, 0, 1]);
        let expected = [
            ([4, 2, 1], 1),
            ([1, 5, 2], 2),
            ([0, 1, 3], 0),
            ([4, 1, 0], 1),
            ([1, 2, 6], 2),
            ([1, 2, 3], 0),
            ([2, 5, 6], 2),
            ([0, 3, 2], 0),
            ([4, 0, 2], 1),
            ([1, 6, 5], 2),
        ];
        let all: Vec<([u32; 3], u32)> = found.triangles.into_iter().zip(found.owners).collect();
        assert_eq!(all, expected);
        assert_eq!(boundary(&[], 0), Boundary { triangles: vec![], owners: vec![], bodies: vec![] });
    }
}
