//! Finds the material of each tetrahedron between interfaces, and whether the tetrahedra and the
//! interfaces fit together. Only connectivity is used. Tetrahedra are connected through faces that
//! are not triangles of an interface, and each triangle states the materials on its two sides.

use super::FACES;
use super::faces::Matching;
use crate::complex::OUTSIDE;
use crate::components::SharedSets;
use rayon::prelude::*;

/// Stands for a tetrahedron that does not exist.
pub const NOBODY: u32 = u32::MAX;

/// Conformity of tetrahedra and interfaces.
#[derive(Clone, Debug, PartialEq)]
pub struct Conformity {
    /// Material of each tetrahedron, or [`OUTSIDE`] if the triangles state none or several.
    pub regions: Vec<u32>,
    /// Part of each tetrahedron. A part is connected through faces and does not cross a triangle.
    /// Parts are numbered in the order of their first tetrahedra.
    pub parts: Vec<u32>,
    /// Tetrahedron behind each triangle, or [`NOBODY`]. The triangle is counter-clockwise as seen
    /// from the other side.
    pub behind: Vec<u32>,
    /// Tetrahedron in front of each triangle, or [`NOBODY`].
    pub before: Vec<u32>,
    /// Number of triangles that are not a face of a tetrahedron of the right material on each side.
    pub missing: usize,
    /// Number of faces of only one tetrahedron that are not triangles of an interface.
    pub added: usize,
    /// Number of faces of more than two tetrahedra.
    pub crowded: usize,
    /// Number of tetrahedra without a material.
    pub undecided: usize,
}

impl Conformity {
    /// Returns the number of faults: 0 if the tetrahedra fill the regions between the interfaces.
    pub fn faults(&self) -> usize {
        self.missing + self.added + self.crowded + self.undecided
    }
}

/// Faces found by one task.
#[derive(Default)]
struct Found {
    added: usize,
    crowded: usize,
    /// Triangle, tetrahedron, and whether the tetrahedron is behind the triangle.
    sides: Vec<(usize, u32, bool)>,
}

/// Finds the material of each tetrahedron. The tetrahedra must be positive, no triangle may occur
/// twice, and all vertex indices must be below `vertex_count`. `between` contains the materials
/// behind and in front of each triangle.
pub fn conform(vertex_count: usize, cells: &[[u32; 4]], triangles: &[[u32; 3]], between: &[[u32; 2]]) -> Conformity {
    let sets = SharedSets::new(cells.len());
    let matching = Matching { vertex_count, cells, triangles };
    let found = matching.visit(|found: &mut Found, group| {
        found.crowded += usize::from(group.faces.len() > 2);
        match group.triangles {
            [] => {
                found.added += usize::from(group.faces.len() == 1);
                group.join(&sets);
            }
            entries => found.sides.extend(entries.iter().flat_map(|&entry| {
                let t = matching.triangle(entry);
                let side = move |(cell, face): (usize, usize)| {
                    let is_behind = same_orientation(triangles[t], FACES[face].map(|i| cells[cell][i]));
                    (t, cell as u32, is_behind)
                };
                group.cells().map(side)
            })),
        }
    });
    let (parts, count) = sets.numbers(|_| true);
    let mut beside = vec![[NOBODY; 2]; triangles.len()];
    let mut material = vec![None; count];
    for &(t, cell, is_behind) in found.iter().flat_map(|found| &found.sides) {
        let side = usize::from(!is_behind);
        beside[t][side] = cell;
        let known = &mut material[parts[cell as usize] as usize];
        let stated = between[t][side];
        *known = Some(if known.is_none_or(|other| other == stated) { stated } else { OUTSIDE });
    }
    let regions: Vec<u32> = parts.par_iter().map(|&part| material[part as usize].unwrap_or(OUTSIDE)).collect();
    // outside, there must be no tetrahedron
    let region = |cell: u32| if cell == NOBODY { OUTSIDE } else { regions[cell as usize] };
    let fits = |(cells, wanted): (&[u32; 2], &[u32; 2])| {
        cells
            .iter()
            .zip(wanted)
            .all(|(&cell, &wanted)| region(cell) == wanted && (cell == NOBODY) == (wanted == OUTSIDE))
    };
    Conformity {
        missing: beside.iter().zip(between).filter(|&side| !fits(side)).count(),
        added: found.iter().map(|found| found.added).sum(),
        crowded: found.iter().map(|found| found.crowded).sum(),
        undecided: regions.par_iter().filter(|&&region| region == OUTSIDE).count(),
        behind: beside.iter().map(|cells| cells[0]).collect(),
        before: beside.iter().map(|cells| cells[1]).collect(),
        regions,
        parts,
    }
}

/// Returns whether two lists of the same three vertices have the same cyclic order.
fn same_orientation(first: [u32; 3], second: [u32; 3]) -> bool {
    (0..3).any(|k| second[k] == first[0] && second[(k + 1) % 3] == first[1])
}
