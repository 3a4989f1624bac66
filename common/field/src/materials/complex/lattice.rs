//! The tetrahedral lattice between the nodes of a grid. The materials at the corners of a
//! tetrahedron determine the pieces of strata in it.

use crate::materials::MaterialId;
use glam::DVec3;
use isoparticles_volume::Geometry;

/// Number of lattice steps between neighbouring grid nodes. Edges are bisected at most three times,
/// down to one step along each axis.
pub(super) const UNIT: u32 = 8;

/// A lattice position in steps.
pub(super) type LatticePoint = [u32; 3];

/// The lattice of a grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice<'a> {
    pub(super) geometry: &'a Geometry,
}

impl Lattice<'_> {
    /// Returns a lattice position in the grid frame in mm.
    pub(super) fn position(&self, place: LatticePoint) -> DVec3 {
        self.geometry.index_to_grid(DVec3::from_array(place.map(f64::from)) / f64::from(UNIT))
    }
}

/// Encodes a lattice position as one number. The numbers are ordered by z, then y, then x.
pub(super) fn number(place: LatticePoint) -> u128 {
    let [x, y, z] = place.map(u128::from);
    z << 64 | y << 32 | x
}

/// Returns the midpoint of two lattice positions if its coordinates are whole numbers of steps.
pub(super) fn half_way(a: LatticePoint, b: LatticePoint) -> Option<LatticePoint> {
    let is_even = (0..3).all(|axis| a[axis].abs_diff(b[axis]).is_multiple_of(2));
    is_even.then(|| std::array::from_fn(|axis| a[axis].midpoint(b[axis])))
}

/// Returns the rank of an edge. Edges with the highest rank are bisected first. The rank is the
/// squared length in steps, followed by the numbers of the ends. No two edges have the same rank,
/// so tetrahedra that share a face divide it in the same way.
pub(super) fn rank(a: LatticePoint, b: LatticePoint) -> (u32, [u128; 2]) {
    let squared = (0..3).map(|axis| a[axis].abs_diff(b[axis]).pow(2)).sum();
    let (a, b) = (number(a), number(b));
    (squared, [a.min(b), a.max(b)])
}

/// Corner offsets (bits of x, y, z) of Kuhn's tetrahedra. The corners of each tetrahedron form a
/// path along three cell edges from the lowest node of the cell to the highest. The faces of the
/// tetrahedra match across neighbouring cells.
pub(super) const TETRAHEDRA: [[u8; 4]; 6] =
    [[0, 1, 3, 7], [0, 1, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 4, 6, 7]];

/// A piece of a stratum within a tetrahedron. Each corner of the piece is given by a set of
/// tetrahedron corners (as bits): two for a point on an edge, three for a point on a face, four for
/// a point inside the tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Piece {
    /// Part of the interface of two materials. `of` contains one tetrahedron corner of each
    /// material. The piece has three or four corners; the last is zero if there are three.
    Interface { of: [usize; 2], corners: [u8; 4] },
    /// Part of the junction curve of three materials.
    Curve { ends: [u8; 2] },
}

/// Calls `hear` with each piece of a stratum in a tetrahedron whose corners have the materials `of`
/// (Nielson and Franke 1997).
pub(super) fn pieces(of: [MaterialId; 4], mut hear: impl FnMut(Piece)) {
    let bit = |corner: usize| 1u8 << corner;
    let same = |a: usize, b: usize| of[a] == of[b];
    let pair = (0..4).flat_map(|a| (a + 1..4).map(move |b| [a, b])).find(|&[a, b]| same(a, b));
    let Some([a, b]) = pair else {
        // four materials: each interface is a quadrilateral with corners on an edge, on two faces,
        // and at the point inside
        for i in 0..4 {
            for j in i + 1..4 {
                let edge = bit(i) | bit(j);
                let [k, l] = others([i, j]);
                hear(Piece::Interface { of: [i, j], corners: [edge, edge | bit(k), 0b1111, edge | bit(l)] });
            }
        }
        (0..4).for_each(|i| hear(Piece::Curve { ends: [0b1111 ^ bit(i), 0b1111] }));
        return;
    };
    let [c, d] = others([a, b]);
    let edge = |i: usize, j: usize| bit(i) | bit(j);
    let mut corner = |alone: usize, [i, j, k]: [usize; 3]| {
        hear(Piece::Interface { of: [alone, i], corners: [edge(alone, i), edge(alone, j), edge(alone, k), 0] });
    };
    match (same(a, c), same(a, d), same(c, d)) {
        (true, true, _) => {}
        (true, false, _) => corner(d, [a, b, c]),
        (false, true, _) => corner(c, [a, b, d]),
        (false, false, true) => {
            hear(Piece::Interface { of: [a, c], corners: [edge(a, c), edge(a, d), edge(b, d), edge(b, c)] });
        }
        (false, false, false) => {
            let ends = [edge(a, c) | bit(d), edge(b, c) | bit(d)];
            for single in [c, d] {
                let corners = [edge(a, single), edge(b, single), ends[1], ends[0]];
                hear(Piece::Interface { of: [a, single], corners });
            }
            hear(Piece::Interface { of: [c, d], corners: [edge(c, d), ends[0], ends[1], 0] });
            hear(Piece::Curve { ends });
        }
    }
}

/// Returns the other two corners of a tetrahedron.
fn others([a, b]: [usize; 2]) -> [usize; 2] {
    let mut left = (0..4).filter(|&n| n != a && n != b);
    [left.next().unwrap_or(0), left.next().unwrap_or(0)]
}
