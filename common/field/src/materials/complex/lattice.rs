//! The lattice whose cells are cut into Kuhn's six tetrahedra each, and the names of its edges, faces and tetrahedra, the same from every cell that they
//! belong to.

use crate::materials::MaterialId;
use glam::DVec3;
use isoparticles_volume::Geometry;

/// Bits of a name that tell the direction of an element; those above are the number of its first node.
const DIRECTION_BITS: u32 = 9;

/// Nodes between those of a grid, `fineness` steps to a cell along each axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice<'a> {
    pub(super) geometry: &'a Geometry,
    pub(super) fineness: usize,
}

impl Lattice<'_> {
    /// Cells along each axis.
    pub(super) fn cells(&self) -> [usize; 3] {
        self.geometry.size.map(|n| n.saturating_sub(1) * self.fineness)
    }

    /// Where a node lies, grid frame, mm.
    pub(super) fn position(&self, node: [usize; 3]) -> DVec3 {
        self.geometry.index_to_grid(DVec3::from_array(node.map(|n| n as f64 / self.fineness as f64)))
    }

    /// Name of the element whose corners have these offsets (bits of x, y, z) from the lowest node of a cell; ascending, each within the next.
    pub(super) fn name(&self, cell: [usize; 3], offsets: &[u8]) -> u64 {
        let first = offsets[0];
        let [nx, ny, _] = self.cells().map(|n| n + 1);
        let [i, j, k]: [usize; 3] = std::array::from_fn(|a| cell[a] + usize::from(first >> a & 1));
        let directions = offsets[1..].iter().fold(0u64, |bits, offset| bits << 3 | u64::from(offset ^ first));
        (((k * ny + j) * nx + i) as u64) << DIRECTION_BITS | directions
    }
}

/// Offsets of the corners of Kuhn's tetrahedra (Kuhn 1960): the ways from the lowest node of a cell to the highest along three of its edges.
pub(super) const TETRAHEDRA: [[u8; 4]; 6] =
    [[0, 1, 3, 7], [0, 1, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 4, 6, 7]];

/// A piece of a stratum within a tetrahedron. Its corners are sets of the tetrahedron's corners (bits): two for a point on an edge, three for one on a face, four for
/// the one inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Piece {
    /// Part of the sheet of two materials, given by a corner of each: three or four corners (the last is zero where there are three).
    Sheet { of: [usize; 2], corners: [u8; 4] },
    /// Part of the curve of three materials.
    Curve { ends: [u8; 2] },
}

/// Tells the pieces of a tetrahedron by the materials of its corners (Nielson and Franke 1997).
pub(super) fn pieces(of: [MaterialId; 4], mut hear: impl FnMut(Piece)) {
    let bit = |corner: usize| 1u8 << corner;
    let same = |a: usize, b: usize| of[a] == of[b];
    let pair = (0..4).flat_map(|a| (a + 1..4).map(move |b| [a, b])).find(|&[a, b]| same(a, b));
    let Some([a, b]) = pair else {
        // four materials: a quarter of each sheet's boundary lies on two faces, with the point inside
        for i in 0..4 {
            for j in i + 1..4 {
                let edge = bit(i) | bit(j);
                let [k, l] = others([i, j]);
                hear(Piece::Sheet { of: [i, j], corners: [edge, edge | bit(k), 0b1111, edge | bit(l)] });
            }
        }
        (0..4).for_each(|i| hear(Piece::Curve { ends: [0b1111 ^ bit(i), 0b1111] }));
        return;
    };
    let [c, d] = others([a, b]);
    let edge = |i: usize, j: usize| bit(i) | bit(j);
    let mut corner = |alone: usize, [i, j, k]: [usize; 3]| {
        hear(Piece::Sheet { of: [alone, i], corners: [edge(alone, i), edge(alone, j), edge(alone, k), 0] });
    };
    match (same(a, c), same(a, d), same(c, d)) {
        (true, true, _) => {}
        (true, false, _) => corner(d, [a, b, c]),
        (false, true, _) => corner(c, [a, b, d]),
        (false, false, true) => {
            hear(Piece::Sheet { of: [a, c], corners: [edge(a, c), edge(a, d), edge(b, d), edge(b, c)] });
        }
        (false, false, false) => {
            let ends = [edge(a, c) | bit(d), edge(b, c) | bit(d)];
            for single in [c, d] {
                let corners = [edge(a, single), edge(b, single), ends[1], ends[0]];
                hear(Piece::Sheet { of: [a, single], corners });
            }
            hear(Piece::Sheet { of: [c, d], corners: [edge(c, d), ends[0], ends[1], 0] });
            hear(Piece::Curve { ends });
        }
    }
}

/// The two corners of a tetrahedron that are not these.
fn others([a, b]: [usize; 2]) -> [usize; 2] {
    let mut left = (0..4).filter(|&n| n != a && n != b);
    [left.next().unwrap_or(0), left.next().unwrap_or(0)]
}
