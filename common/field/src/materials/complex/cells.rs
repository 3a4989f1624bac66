//! The pieces of the strata in a block of cells.

use super::lattice::{Lattice, Piece, TETRAHEDRA, pieces};
use crate::materials::{Indicators, MaterialId, Near, Stratum};
use glam::{DVec3, DVec4};

/// Share of a cell's diagonal that the nearest sheet is to be away from all of its corners, which are of one material, for nothing to cross it: half of it would do
/// for indicators of slope one.
const FAR: f64 = 0.75;

/// A vertex of the complex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Where it lies, grid frame, mm.
    pub position: DVec3,
    /// The materials that meet there.
    pub stratum: Stratum,
}

/// A triangle of a sheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Its corners, counter-clockwise seen from the material of the lower number.
    pub corners: [u32; 3],
    /// The two materials.
    pub sheet: Stratum,
}

/// Part of a junction curve within a tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Segment {
    pub(super) ends: [u32; 2],
    pub(super) curve: Stratum,
}

/// What a block holds; corners are numbers of its own vertices.
#[derive(Clone, Debug, Default)]
pub(super) struct Part {
    /// Names of the vertices, ascending.
    pub(super) names: Vec<u64>,
    pub(super) vertices: Vec<Vertex>,
    pub(super) triangles: Vec<Triangle>,
    pub(super) segments: Vec<Segment>,
}

/// A block of voxels' cells and what is known of the lattice's nodes in it.
struct Block<'a, I: ?Sized> {
    lattice: Lattice<'a>,
    indicators: &'a I,
    /// Its first node of the lattice, and its nodes along each axis.
    first: [usize; 3],
    size: [usize; 3],
    /// What was asked so far.
    known: Vec<Near>,
}

impl<I: Indicators + ?Sized> Block<'_, I> {
    fn place(&self, node: [usize; 3]) -> usize {
        let [i, j, k]: [usize; 3] = std::array::from_fn(|a| node[a] - self.first[a]);
        (k * self.size[1] + j) * self.size[0] + i
    }

    /// The indicators at a node.
    fn near(&mut self, node: [usize; 3]) -> &Near {
        let place = self.place(node);
        if self.known[place].entries().is_empty() {
            self.known[place] = self.indicators.near(self.lattice.position(node));
        }
        &self.known[place]
    }

    fn material(&mut self, node: [usize; 3]) -> MaterialId {
        self.near(node).first().unwrap_or(MaterialId::OUTSIDE)
    }

    /// Whether a sheet may cross the voxel's cell whose lowest node this is.
    fn may_be_crossed(&mut self, node: [usize; 3]) -> bool {
        let step = self.lattice.fineness;
        let far = FAR * self.lattice.geometry.spacing.length();
        let own = self.material(node);
        (0..8u8).any(|offset| {
            let near = self.near(at(node, offset, step));
            near.first().unwrap_or(MaterialId::OUTSIDE) != own || near.interface_distance() < far
        })
    }
}

/// The node at an offset (bits of x, y, z) of so many steps.
fn at(node: [usize; 3], offset: u8, step: usize) -> [usize; 3] {
    std::array::from_fn(|a| node[a] + step * usize::from(offset >> a & 1))
}

/// What the voxels' cells from `first` on, `count` along each axis, hold; `sheets` says whether triangles are wanted, or curves and points alone.
pub(super) fn part<I: Indicators + ?Sized>(
    lattice: Lattice<'_>,
    indicators: &I,
    first: [usize; 3],
    count: [usize; 3],
    sheets: bool,
) -> Part {
    let fineness = lattice.fineness;
    let size = count.map(|n| n * fineness + 1);
    let known = vec![Near::default(); size.iter().product()];
    let mut block = Block { lattice, indicators, first: first.map(|n| n * fineness), size, known };
    let mut found = Found { sheets, ..Found::default() };
    for k in first[2]..first[2] + count[2] {
        for j in first[1]..first[1] + count[1] {
            for i in first[0]..first[0] + count[0] {
                let lowest = [i, j, k].map(|n| n * fineness);
                if !block.may_be_crossed(lowest) {
                    continue;
                }
                for n in 0..fineness.pow(3) {
                    let within = [n % fineness, n / fineness % fineness, n / fineness.pow(2)];
                    found.cell(&mut block, std::array::from_fn(|a| lowest[a] + within[a]));
                }
            }
        }
    }
    found.into_part()
}

#[derive(Default)]
struct Found {
    sheets: bool,
    vertices: Vec<(u64, Vertex)>,
    triangles: Vec<([u64; 3], Stratum)>,
    segments: Vec<([u64; 2], Stratum)>,
}

impl Found {
    /// Adds what a cell of the lattice holds.
    fn cell<I: Indicators + ?Sized>(&mut self, block: &mut Block<'_, I>, cell: [usize; 3]) {
        let of: [MaterialId; 8] = std::array::from_fn(|c| block.material(at(cell, c as u8, 1)));
        let others = of.iter().filter(|&&id| id != of[0]);
        let second = others.clone().next().copied();
        if second.is_none() || (!self.sheets && others.clone().all(|&id| Some(id) == second)) {
            return;
        }
        for offsets in TETRAHEDRA {
            let materials = offsets.map(|offset| of[usize::from(offset)]);
            let corners = Corners { cell, offsets, materials };
            pieces(materials, |piece| match piece {
                Piece::Sheet { of, corners: own } if self.sheets => self.sheet(block, &corners, of, own),
                Piece::Sheet { .. } => {}
                Piece::Curve { ends } => {
                    let stratum = corners.stratum(ends[0]);
                    let ends = ends.map(|end| self.vertex(block, &corners, end).0);
                    self.segments.extend(stratum.map(|curve| (ends, curve)));
                }
            });
        }
    }

    /// Adds a vertex and returns its name and place.
    fn vertex<I: Indicators + ?Sized>(&mut self, block: &mut Block<'_, I>, corners: &Corners, own: u8) -> (u64, DVec3) {
        let (offsets, count) = corners.offsets_of(own);
        let name = block.lattice.name(corners.cell, &offsets[..count]);
        let position = corners.position(block, own);
        if let Some(stratum) = corners.stratum(own) {
            self.vertices.push((name, Vertex { position, stratum }));
        }
        (name, position)
    }

    /// Adds a piece of a sheet as one or two triangles.
    fn sheet<I: Indicators + ?Sized>(
        &mut self,
        block: &mut Block<'_, I>,
        corners: &Corners,
        of: [usize; 2],
        own: [u8; 4],
    ) {
        let sheet = Stratum::sheet(corners.materials[of[0]], corners.materials[of[1]]);
        let count = if own[3] == 0 { 3 } else { 4 };
        let middle = own.map(|corner| corners.middle(corner));
        let normal = (middle[1] - middle[0]).cross(middle[2] - middle[0]);
        let [first, second] = of.map(|corner| corners.middle(1 << corner));
        let outward = if corners.materials[of[0]] < corners.materials[of[1]] { first - second } else { second - first };
        let mut placed = [(0, DVec3::ZERO); 4];
        for (to, corner) in placed[..count].iter_mut().zip(own) {
            *to = self.vertex(block, corners, corner);
        }
        if normal.dot(outward) < 0.0 {
            placed[..count].reverse();
        }
        let [a, b, c, d] = placed;
        let mut add = |corners: [(u64, DVec3); 3]| self.triangles.push((corners.map(|corner| corner.0), sheet));
        match count {
            3 => add([a, b, c]),
            // along the shorter diagonal
            _ if a.1.distance_squared(c.1) <= b.1.distance_squared(d.1) => {
                [[a, b, c], [a, c, d]].into_iter().for_each(add)
            }
            _ => [[a, b, d], [b, c, d]].into_iter().for_each(add),
        }
    }

    fn into_part(mut self) -> Part {
        self.vertices.sort_unstable_by_key(|(name, _)| *name);
        self.vertices.dedup_by_key(|(name, _)| *name);
        let (names, vertices): (Vec<u64>, Vec<Vertex>) = self.vertices.into_iter().unzip();
        let number = |name: u64| names.partition_point(|&other| other < name) as u32;
        let triangles =
            self.triangles.into_iter().map(|(corners, sheet)| Triangle { corners: corners.map(number), sheet });
        let segments = self.segments.into_iter().map(|(ends, curve)| Segment { ends: ends.map(number), curve });
        let (triangles, segments) = (triangles.collect(), segments.collect());
        Part { names, vertices, triangles, segments }
    }
}

/// The corners of a tetrahedron.
struct Corners {
    /// Lowest node of its cell.
    cell: [usize; 3],
    offsets: [u8; 4],
    materials: [MaterialId; 4],
}

impl Corners {
    /// Offsets of some corners (bits), ascending, and how many.
    fn offsets_of(&self, own: u8) -> ([u8; 4], usize) {
        let (mut offsets, mut count) = ([0; 4], 0);
        for corner in (0..4).filter(|corner| own >> corner & 1 == 1) {
            offsets[count] = self.offsets[corner];
            count += 1;
        }
        (offsets, count)
    }

    /// The materials of some corners.
    fn stratum(&self, own: u8) -> Option<Stratum> {
        let (mut materials, mut count) = ([MaterialId::OUTSIDE; 4], 0);
        for corner in (0..4).filter(|corner| own >> corner & 1 == 1) {
            materials[count] = self.materials[corner];
            count += 1;
        }
        Stratum::new(&materials[..count])
    }

    /// Middle of some corners within the cell, whose edges count as one: there no piece has lost its shape, so that it tells sides.
    fn middle(&self, own: u8) -> DVec3 {
        let (offsets, count) = self.offsets_of(own);
        let corner = |offset: &u8| DVec3::from_array(std::array::from_fn(|a| f64::from(offset >> a & 1)));
        offsets[..count].iter().map(corner).sum::<DVec3>() / count.max(1) as f64
    }

    /// Where the indicators of some corners' materials, linear between the corners, are equal; the nearest place to that among the corners where it lies beyond
    /// them, and their middle where an indicator is not known.
    fn position<I: Indicators + ?Sized>(&self, block: &mut Block<'_, I>, own: u8) -> DVec3 {
        let (mut list, mut count) = ([0; 4], 0);
        for corner in (0..4).filter(|corner| own >> corner & 1 == 1) {
            list[count] = corner;
            count += 1;
        }
        let own = &list[..count];
        // of each corner the indicators of all, less the first
        let (mut places, mut rows) = ([DVec3::ZERO; 4], [[0.0; 4]; 3]);
        for (c, &corner) in own.iter().enumerate() {
            let node = at(self.cell, self.offsets[corner], 1);
            places[c] = block.lattice.position(node);
            let near = block.near(node).entries();
            let value = |corner: usize| {
                let found = near.iter().find(|(id, _)| *id == self.materials[corner]);
                found.map_or(f64::INFINITY, |(_, value)| *value)
            };
            let first = value(own[0]);
            for (row, &corner) in rows.iter_mut().zip(&own[1..]) {
                row[c] = value(corner) - first;
            }
        }
        let weights = match own.len() {
            2 => [-rows[0][1], rows[0][0], 0.0, 0.0],
            3 => {
                let [a, b] = [rows[0], rows[1]].map(|[x, y, z, _]| DVec3::new(x, y, z));
                a.cross(b).extend(0.0).to_array()
            }
            _ => normal_to(rows),
        };
        let weights = DVec4::from_array(weights);
        let sum = weights.element_sum();
        let weights = (weights / sum).max(DVec4::ZERO);
        let total = weights.element_sum();
        let is_known = sum != 0.0 && sum.is_finite() && total.is_finite() && total > 0.0;
        let share = |c: usize| if is_known { weights[c] / total } else { 1.0 / own.len() as f64 };
        (0..own.len()).map(|c| places[c] * share(c)).sum()
    }
}

/// The vector at right angles to three others: their minors.
fn normal_to(rows: [[f64; 4]; 3]) -> [f64; 4] {
    std::array::from_fn(|left| {
        let minor = rows.map(|row| {
            let mut kept = (0..4).filter(|&c| c != left).map(|c| row[c]);
            DVec3::from_array(std::array::from_fn(|_| kept.next().unwrap_or(0.0)))
        });
        let sign = if left % 2 == 0 { 1.0 } else { -1.0 };
        sign * minor[0].dot(minor[1].cross(minor[2]))
    })
}
