//! A complex: triangles between two materials each, which share vertices and edges where materials
//! meet. Material 0 is the outside. A triangle is counter-clockwise as seen from the second of its
//! two materials.
//!
//! [`Complex::open_edges`] finds edges at which a material is not closed, [`Complex::shells`] finds
//! the volumes that the triangles bound, and [`Complex::describe`] counts and measures materials
//! and interfaces.

mod describe;
mod shells;

use crate::TriangleMesh;
use rayon::prelude::*;
use std::collections::BTreeMap;

pub use describe::{Description, InterfaceSummary, MaterialSummary};
pub use shells::Shells;

/// The number of the outside.
pub const OUTSIDE: u32 = 0;

/// A triangle at an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Side {
    /// The two vertices of the edge, ascending.
    edge: [u32; 2],
    triangle: u32,
    /// Position of the first corner of the side in the triangle.
    slot: u8,
    /// Whether the triangle traverses the edge from the lower to the higher vertex.
    forward: bool,
}

/// A complex and its edges.
pub struct Complex<'a> {
    mesh: &'a TriangleMesh,
    /// The two materials of each triangle.
    between: &'a [[u32; 2]],
    /// Number of materials, including the outside.
    materials: usize,
    /// The sides of all triangles, ascending.
    sides: Vec<Side>,
}

impl<'a> Complex<'a> {
    /// Finds the edges of a complex. The mesh must be well-formed and without collapsed triangles,
    /// and all materials must be below `materials`.
    pub fn new(mesh: &'a TriangleMesh, between: &'a [[u32; 2]], materials: usize) -> Self {
        let sides_of = |(t, corners): (usize, &[u32; 3])| {
            let corners = *corners;
            (0..3).map(move |k| {
                let (from, to) = (corners[k], corners[(k + 1) % 3]);
                Side { edge: [from.min(to), from.max(to)], triangle: t as u32, slot: k as u8, forward: from < to }
            })
        };
        let mut sides: Vec<Side> = mesh.triangles.par_iter().enumerate().flat_map_iter(sides_of).collect();
        sides.par_sort_unstable();
        Self { mesh, between, materials, sides }
    }

    /// Returns the sides at each edge.
    fn edges(&self) -> impl Iterator<Item = &[Side]> {
        self.sides.chunk_by(|a, b| a.edge == b.edge)
    }

    /// Returns, for each material that is not closed, the number of edges that its triangles
    /// traverse more often in one direction than in the other.
    pub fn open_edges(&self) -> BTreeMap<u32, usize> {
        let mut open = BTreeMap::new();
        let mut balance: Vec<(u32, i32)> = Vec::new();
        for edge in self.edges() {
            balance.clear();
            for side in edge {
                let way = if side.forward { 1 } else { -1 };
                let [inside, outside] = self.between[side.triangle as usize];
                balance.extend([(inside, way), (outside, -way)]);
            }
            balance.sort_unstable();
            for own in balance.chunk_by(|a, b| a.0 == b.0) {
                if own.iter().map(|(_, way)| way).sum::<i32>() != 0 {
                    *open.entry(own[0].0).or_insert(0) += 1;
                }
            }
        }
        open
    }
}

#[cfg(test)]
mod tests;
