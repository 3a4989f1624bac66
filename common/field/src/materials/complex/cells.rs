//! Marching tetrahedra in one block of grid cells: computes interface triangles and the vertices of
//! junction curves and junction points. An edge that passes through a material found at neither of
//! its ends is bisected first. Vertices with the same name in neighbouring blocks are merged later.

use super::lattice::{Lattice, LatticePoint, Piece, TETRAHEDRA, UNIT, half_way, number, pieces, rank};
use crate::materials::{Indicators, MaterialId, Near, Stratum};
use glam::{DVec3, DVec4};
use std::collections::BTreeMap;

/// Minimum sum of the interface distances at the ends of an edge, as a multiple of the edge length,
/// for which an edge between nodes of the same material is assumed to cross no interface. A factor
/// of 1 suffices for indicators of slope 1; 1.25 also covers slopes of up to 1.25. The complex of
/// the brain crop (see `follow.rs`) has 509,294 vertices with a factor of 1, and 509,297 with 1.25
/// and 2.
const CLEAR_DISTANCE: f64 = 1.25;

/// A vertex of the complex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position in the grid frame, mm.
    pub position: DVec3,
    /// The materials that meet at the vertex.
    pub stratum: Stratum,
}

/// A triangle of a material interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Vertex indices, counter-clockwise when seen from the material with the lower number.
    pub corners: [u32; 3],
    /// The two materials of the interface.
    pub interface: Stratum,
}

/// Identifies a vertex by the lattice edge, face or tetrahedron that contains it: the numbers of
/// the two, three or four corner nodes, in ascending order, padded with `u128::MAX`.
pub(super) type Name = [u128; 4];

/// The result for one block. Triangle corners are indices into the vertices of this block.
#[derive(Clone, Debug, Default)]
pub(super) struct Part {
    /// Names of the vertices, in ascending order.
    pub(super) names: Vec<Name>,
    pub(super) vertices: Vec<Vertex>,
    pub(super) triangles: Vec<Triangle>,
}

/// The sampled values at a node.
struct NodeSample {
    near: Near,
    own: MaterialId,
    position: DVec3,
}

/// A node of the lattice in a block.
#[derive(Clone, Copy)]
struct Node {
    place: LatticePoint,
    /// Index in `Block::known` of the sample at the node.
    known: usize,
    own: MaterialId,
}

/// A block of grid cells with the lattice nodes sampled so far.
struct Block<'a, I: ?Sized> {
    lattice: Lattice<'a>,
    indicators: &'a I,
    /// First grid node; `size` is the number of grid nodes along each axis.
    first: [usize; 3],
    size: [usize; 3],
    /// Samples at the grid nodes in order (`None` if not sampled yet), followed by samples at the
    /// nodes between them. `between` maps the number of a node between grid nodes to its index in
    /// `known`.
    known: Vec<Option<NodeSample>>,
    between: BTreeMap<u128, usize>,
    /// Cached results of `is_halved` for edges between grid nodes, indexed by lower node and
    /// direction.
    halved: Vec<Option<bool>>,
}

impl<'a, I: Indicators + ?Sized> Block<'a, I> {
    fn new(lattice: Lattice<'a>, indicators: &'a I, first: [usize; 3], count: [usize; 3]) -> Self {
        let size = count.map(|n| n + 1);
        let nodes = size.iter().product();
        let known = (0..nodes).map(|_| None).collect();
        Self { lattice, indicators, first, size, known, between: BTreeMap::new(), halved: vec![None; 8 * nodes] }
    }

    /// Returns the index of a grid node in `known`, or `None` for a node between grid nodes.
    fn of_grid(&self, place: LatticePoint) -> Option<usize> {
        let is_of_grid = place.iter().all(|n| n.is_multiple_of(UNIT));
        let [i, j, k]: [usize; 3] = std::array::from_fn(|a| (place[a] / UNIT) as usize - self.first[a]);
        is_of_grid.then(|| (k * self.size[1] + j) * self.size[0] + i)
    }

    fn node(&mut self, place: LatticePoint) -> Node {
        let next = self.known.len();
        let known = match self.of_grid(place) {
            Some(known) => known,
            None => *self.between.entry(number(place)).or_insert(next),
        };
        if known == next {
            self.known.push(None);
        }
        let (lattice, indicators) = (self.lattice, self.indicators);
        let own = self.known[known].get_or_insert_with(|| {
            let position = lattice.position(place);
            let near = indicators.near(position);
            NodeSample { near, own: near.first().unwrap_or(MaterialId::OUTSIDE), position }
        });
        Node { place, known, own: own.own }
    }

    /// Returns the values sampled at a node.
    fn of(&self, node: Node) -> Option<&NodeSample> {
        self.known[node.known].as_ref()
    }

    /// Returns whether an edge must be bisected because it passes through a material found at
    /// neither end.
    fn is_halved(&mut self, a: Node, b: Node) -> bool {
        if half_way(a.place, b.place).is_none() {
            return false;
        }
        let directions = (0..3).fold(0, |bits, axis| bits | usize::from(a.place[axis] != b.place[axis]) << axis);
        let of_grid = self.of_grid(a.place).zip(self.of_grid(b.place)).map(|(a, b)| 8 * a.min(b) + directions);
        if let Some(told) = of_grid.and_then(|edge| self.halved[edge]) {
            return told;
        }
        let told = self.passes_another(a, b);
        if let Some(edge) = of_grid {
            self.halved[edge] = Some(told);
        }
        told
    }

    /// Returns whether a sample on the edge lies in a material found at neither end. The sample is
    /// taken where the indicators of the two end materials, interpolated linearly, are equal. If
    /// both ends have the same material, it is taken at the midpoint.
    fn passes_another(&self, a: Node, b: Node) -> bool {
        let (Some(from), Some(to)) = (self.of(a), self.of(b)) else { return false };
        let share = if a.own == b.own {
            let away = from.near.interface_distance() + to.near.interface_distance();
            if away > CLEAR_DISTANCE * from.position.distance(to.position) {
                return false;
            }
            0.5
        } else {
            self.equal_between([from, to], [a.own, b.own])[1]
        };
        let between = self.indicators.near(from.position + (to.position - from.position) * share);
        // on a plane, the space beyond it and the nearest material have equal indicators, so this
        // space is not a third material there
        let is_beyond = |id: MaterialId| self.indicators.is_beyond(id);
        let is_on_plane = is_beyond(a.own) != is_beyond(b.own) && self.indicators.are_separate(&[a.own, b.own]);
        let mut others = between.entries().iter().map(|(id, _)| *id).filter(|&id| !(is_on_plane && is_beyond(id)));
        others.next().is_some_and(|id| id != a.own && id != b.own)
    }

    /// Returns the indicator of the first material minus that of the second (mm) at a node.
    fn difference(&self, node: &NodeSample, [i, j]: [MaterialId; 2]) -> f64 {
        self.indicators.difference_of(&node.near, node.position, i, j)
    }

    /// Returns the interpolation weights of two nodes for the point between them where the
    /// indicators of two materials, interpolated linearly, are equal. The weights are 0.5 each if
    /// an indicator is unknown.
    fn equal_between(&self, nodes: [&NodeSample; 2], [i, j]: [MaterialId; 2]) -> [f64; 2] {
        let [from, to] = nodes.map(|node| self.difference(node, [j, i]));
        let sum = from - to;
        if sum.is_finite() && sum != 0.0 {
            let share = (from / sum).clamp(0.0, 1.0);
            [1.0 - share, share]
        } else {
            [0.5; 2]
        }
    }
}

/// Returns the vertices and triangles in a block of grid cells. The block starts at `first` and has
/// `count` cells along each axis.
pub(super) fn part<I: Indicators + ?Sized>(
    lattice: Lattice<'_>,
    indicators: &I,
    first: [usize; 3],
    count: [usize; 3],
) -> Part {
    let mut block = Block::new(lattice, indicators, first, count);
    let mut found = Found::default();
    for k in first[2]..first[2] + count[2] {
        for j in first[1]..first[1] + count[1] {
            for i in first[0]..first[0] + count[0] {
                found.cell(&mut block, [i, j, k]);
            }
        }
    }
    found.into_part()
}

/// Vertices and triangles found so far. Vertices are identified by their names.
#[derive(Default)]
struct Found {
    vertices: Vec<(Name, Vertex)>,
    triangles: Vec<([Name; 3], Stratum)>,
}

impl Found {
    /// Adds the pieces of strata in one grid cell.
    fn cell<I: Indicators + ?Sized>(&mut self, block: &mut Block<'_, I>, cell: [usize; 3]) {
        let corner = |c: u8| std::array::from_fn(|a| UNIT * (cell[a] as u32 + u32::from(c >> a & 1)));
        let corners: [Node; 8] = std::array::from_fn(|c| block.node(corner(c as u8)));
        let diagonal = block.lattice.geometry.spacing.length();
        let is_far = |node: &Node| {
            let away = block.of(*node).map_or(0.0, |known| known.near.interface_distance());
            node.own == corners[0].own && 2.0 * away > CLEAR_DISTANCE * diagonal
        };
        if corners.iter().all(is_far) {
            return;
        }
        for offsets in TETRAHEDRA {
            self.tetrahedron(block, offsets.map(|offset| corners[usize::from(offset)]));
        }
    }

    /// Adds the pieces of strata in a tetrahedron. If edges must be bisected, bisects the edge with
    /// the highest [`rank`] and recurses into both halves.
    fn tetrahedron<I: Indicators + ?Sized>(&mut self, block: &mut Block<'_, I>, nodes: [Node; 4]) {
        let mut longest = None;
        for (a, b) in (0..4).flat_map(|a| (a + 1..4).map(move |b| (a, b))) {
            let rank = rank(nodes[a].place, nodes[b].place);
            if longest.is_none_or(|(other, _, _)| rank > other) && block.is_halved(nodes[a], nodes[b]) {
                longest = Some((rank, a, b));
            }
        }
        if let Some((_, a, b)) = longest
            && let Some(place) = half_way(nodes[a].place, nodes[b].place)
        {
            let middle = block.node(place);
            for end in [a, b] {
                let mut half = nodes;
                half[end] = middle;
                self.tetrahedron(block, half);
            }
            return;
        }
        let mut nodes = nodes;
        nodes.sort_unstable_by_key(|node| number(node.place));
        let corners = Corners { nodes };
        pieces(nodes.map(|node| node.own), |piece| match piece {
            Piece::Interface { of, corners: own } => self.interface(block, &corners, of, own),
            Piece::Curve { ends } => {
                for end in ends {
                    self.vertex(block, &corners, end);
                }
            }
        });
    }

    /// Adds the vertex inside the edge, face or tetrahedron whose corners are selected by the bits
    /// of `own`. Returns its name and its position (grid frame, mm).
    fn vertex<I: Indicators + ?Sized>(&mut self, block: &Block<'_, I>, corners: &Corners, own: u8) -> (Name, DVec3) {
        let (name, position) = (corners.name(own), corners.position(block, own));
        let stratum = corners.stratum(own);
        if let Some(stratum) = stratum.filter(|own| block.indicators.are_separate(own.materials())) {
            self.vertices.push((name, Vertex { position, stratum }));
        }
        (name, position)
    }

    /// Adds a piece of a material interface as one or two triangles, unless both materials belong
    /// to the same region.
    fn interface<I: Indicators + ?Sized>(
        &mut self,
        block: &Block<'_, I>,
        corners: &Corners,
        of: [usize; 2],
        own: [u8; 4],
    ) {
        let ids = of.map(|corner| corners.nodes[corner].own);
        if !block.indicators.are_separate(&ids) {
            return;
        }
        let interface = Stratum::interface(ids[0], ids[1]);
        let count = if own[3] == 0 { 3 } else { 4 };
        let middle = own.map(|corner| corners.middle(corner));
        let normal = (middle[1] - middle[0]).cross(middle[2] - middle[0]);
        let [first, second] = of.map(|corner| corners.middle(1 << corner));
        let outward = if ids[0] < ids[1] { first - second } else { second - first };
        let mut placed = [(Name::default(), DVec3::ZERO); 4];
        for (to, corner) in placed[..count].iter_mut().zip(own) {
            *to = self.vertex(block, corners, corner);
        }
        if normal.dot(outward) < 0.0 {
            placed[..count].reverse();
        }
        let [a, b, c, d] = placed;
        let mut add = |corners: [(Name, DVec3); 3]| self.triangles.push((corners.map(|corner| corner.0), interface));
        match count {
            3 => add([a, b, c]),
            // split along the shorter diagonal
            _ if a.1.distance_squared(c.1) <= b.1.distance_squared(d.1) => {
                [[a, b, c], [a, c, d]].into_iter().for_each(add);
            }
            _ => [[a, b, d], [b, c, d]].into_iter().for_each(add),
        }
    }

    fn into_part(mut self) -> Part {
        self.vertices.sort_unstable_by_key(|(name, _)| *name);
        self.vertices.dedup_by_key(|(name, _)| *name);
        let (names, vertices): (Vec<Name>, Vec<Vertex>) = self.vertices.into_iter().unzip();
        let number = |name: Name| names.partition_point(|&other| other < name) as u32;
        let triangles =
            self.triangles.into_iter().map(|(corners, interface)| Triangle { corners: corners.map(number), interface });
        Part { triangles: triangles.collect(), names, vertices }
    }
}

/// The corners of a tetrahedron, sorted by node number. All tetrahedra that share an edge or a face
/// therefore compute the same results for it.
struct Corners {
    nodes: [Node; 4],
}

impl Corners {
    /// Returns the corners selected by the bits of `own`, and their count.
    fn chosen(&self, own: u8) -> ([Node; 4], usize) {
        let (mut chosen, mut count) = (self.nodes, 0);
        for corner in (0..4).filter(|corner| own >> corner & 1 == 1) {
            chosen[count] = self.nodes[corner];
            count += 1;
        }
        (chosen, count)
    }

    fn name(&self, own: u8) -> Name {
        let (chosen, count) = self.chosen(own);
        std::array::from_fn(|n| if n < count { number(chosen[n].place) } else { u128::MAX })
    }

    /// Returns the materials of the selected corners.
    fn stratum(&self, own: u8) -> Option<Stratum> {
        let (chosen, count) = self.chosen(own);
        Stratum::new(&chosen.map(|node| node.own)[..count])
    }

    /// Returns the mean of the selected corners in lattice steps. A piece with its corners at these
    /// means is never degenerate, so the means determine its orientation.
    fn middle(&self, own: u8) -> DVec3 {
        let (chosen, count) = self.chosen(own);
        let corner = |node: &Node| DVec3::from_array(node.place.map(f64::from));
        chosen[..count].iter().map(corner).sum::<DVec3>() / count.max(1) as f64
    }

    /// Returns the position (grid frame, mm) where the indicators of the selected corners'
    /// materials, interpolated linearly between the corners, are equal. Negative weights are set to
    /// zero, which keeps the position between the corners. If an indicator is unknown, returns the
    /// mean of the corners.
    fn position<I: Indicators + ?Sized>(&self, block: &Block<'_, I>, own: u8) -> DVec3 {
        let (chosen, count) = self.chosen(own);
        let (Some(a), Some(b), Some(c), Some(d)) =
            (block.of(chosen[0]), block.of(chosen[1]), block.of(chosen[2]), block.of(chosen[3]))
        else {
            return DVec3::ZERO;
        };
        let known = [a, b, c, d];
        if count == 2 {
            let [first, second] = block.equal_between([a, b], [chosen[0].own, chosen[1].own]);
            return a.position * first + b.position * second;
        }
        // row m contains, for each corner, the indicator of corner m + 1's material minus the
        // indicator of corner 0's material
        let mut rows = [[0.0; 4]; 3];
        for (c, known) in known[..count].iter().enumerate() {
            for (row, node) in rows.iter_mut().zip(&chosen[1..count]) {
                row[c] = block.difference(known, [node.own, chosen[0].own]);
            }
        }
        let weights = if count == 3 {
            let [a, b] = [rows[0], rows[1]].map(|[x, y, z, _]| DVec3::new(x, y, z));
            a.cross(b).extend(0.0)
        } else {
            DVec4::from_array(normal_to(rows))
        };
        let sum = weights.element_sum();
        let weights = (weights / sum).max(DVec4::ZERO);
        let total = weights.element_sum();
        let is_known = sum != 0.0 && sum.is_finite() && total.is_finite() && total > 0.0;
        let share = |c: usize| if is_known { weights[c] / total } else { 1.0 / count as f64 };
        (0..count).map(|c| known[c].position * share(c)).sum()
    }
}

/// Returns a four-dimensional vector that is perpendicular to the three rows, computed from their
/// 3 x 3 minors.
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
