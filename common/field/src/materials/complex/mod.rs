//! The discrete complex of the strata: triangles of sheets, chains of junction curves, junction points; from the indicators alone.
//!
//! Marching tetrahedra of many materials (Nielson and Franke, Computing the Separating Surface for Segmented Data, IEEE Visualization 1997): each cell of a
//! lattice is cut into Kuhn's six tetrahedra, which fit those of the cells beside it. The materials at the corners of a tetrahedron decide: an edge
//! between two is crossed by their sheet once, a face between three by their curve, a tetrahedron of four holds a point. So the complex is
//! closed, with curves as the borders of sheets and points as the ends of curves, whatever the indicators are. Where curves and points lie, the indicators
//! tell by Newton's method; the vertices of sheets stay where the linear functions between the corners are equal, second order in the spacing.

mod cells;
mod chains;
mod follow;
mod lattice;
mod measure;
#[cfg(test)]
mod tests;

pub use cells::{Triangle, Vertex};
pub use chains::{COINCIDENT, Chain, End, Junction};
pub use follow::{way_along, way_from, way_round, ways_along};

use super::{Indicators, Materials, Stratum};
use cells::{Name, Part, part};
use isoparticles_mesh::components::DisjointSets;
use isoparticles_volume::Geometry;
use lattice::Lattice;
use rayon::prelude::*;
use serde::Serialize;

/// What became of the vertices on the way from the lattice to the strata.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Tally {
    /// Junction points of the lattice.
    pub points: usize,
    /// Those of which Newton's method found none near.
    pub points_not_projected: usize,
    /// Those where a fifth material is nearer.
    pub points_not_clear: usize,
    /// Vertices of junction curves.
    pub curve_vertices: usize,
    /// Those of which no curve was found near.
    pub curve_vertices_not_projected: usize,
    /// Those where a fourth material is nearer.
    pub curve_vertices_not_clear: usize,
    /// Ends of curves that could not be followed on.
    pub curves_lost: usize,
    /// Junction points that were merged with another one of the same materials.
    pub points_merged: usize,
    /// Junction points that vanished, since the curves that were left at them pass through.
    pub points_passed: usize,
    /// Junction points where not just one curve of each three of their materials ends.
    pub points_irregular: usize,
    /// Closed curves that were left out, since they are far shorter than a voxel or not met anywhere.
    pub specks: usize,
}

/// The strata of the materials of a volume, as a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Complex {
    /// Places on sheets, curves and points; those of sheets are on the lattice's edges, the others on the strata.
    pub vertices: Vec<Vertex>,
    /// The sheets.
    pub triangles: Vec<Triangle>,
    /// The junction curves.
    pub chains: Vec<Chain>,
    /// The junction points.
    pub points: Vec<Junction>,
    /// What became of them on the way.
    pub tally: Tally,
}

impl Complex {
    /// Of the indicators of a volume. The same on any number of threads.
    pub fn new(materials: &Materials) -> Self {
        Self::of_bricks(materials, materials.geometry(), &materials.bricks_of_many())
    }

    /// The same of indicators on a grid, within some boxes of its cells (first cell, and cells along each axis) that hold all strata.
    pub fn of_bricks<I: Indicators + ?Sized>(
        indicators: &I,
        geometry: &Geometry,
        bricks: &[([usize; 3], [usize; 3])],
    ) -> Self {
        let lattice = Lattice { geometry };
        let parts: Vec<Part> =
            bricks.par_iter().map(|&(first, count)| part(lattice, indicators, first, count)).collect();
        let (vertices, triangles) = joined(parts);
        let mut complex = Self { vertices, triangles, ..Self::default() };
        chains::trace(&mut complex, indicators, geometry.upper_corner());
        complex
    }

    /// The component of each triangle: of those of one sheet, joined by vertices; numbered in the order of their first triangles. And how many there are.
    pub fn sheet_components(&self) -> (Vec<u32>, usize) {
        // a vertex of a curve or a point stands once for each sheet at it
        let is_shared = |v: u32| self.vertices[v as usize].stratum.dimension() < 2;
        let mut shared: Vec<(u32, Stratum)> = self
            .triangles
            .iter()
            .flat_map(|t| t.corners.into_iter().filter(|&v| is_shared(v)).map(|v| (v, t.sheet)))
            .collect();
        shared.par_sort_unstable();
        shared.dedup();
        let first = self.vertices.len() as u32;
        let place = |v: u32, sheet: Stratum| {
            if is_shared(v) { first + shared.partition_point(|other| *other < (v, sheet)) as u32 } else { v }
        };
        let mut sets = DisjointSets::new(self.vertices.len() + shared.len());
        for triangle in &self.triangles {
            let [a, b, c] = triangle.corners.map(|v| place(v, triangle.sheet));
            sets.join(a, b);
            sets.join(b, c);
        }
        let mut number = vec![u32::MAX; self.vertices.len() + shared.len()];
        let mut count = 0;
        let mut component = |triangle: &Triangle| {
            let own = &mut number[sets.find(place(triangle.corners[0], triangle.sheet)) as usize];
            if *own == u32::MAX {
                *own = count;
                count += 1;
            }
            *own
        };
        let of_triangles = self.triangles.iter().map(&mut component).collect();
        (of_triangles, count as usize)
    }
}

/// The parts as one, each vertex once.
fn joined(parts: Vec<Part>) -> (Vec<Vertex>, Vec<Triangle>) {
    let named = parts.iter().flat_map(|part| part.names.iter().copied().zip(part.vertices.iter().copied()));
    let mut all: Vec<(Name, Vertex)> = named.collect();
    all.par_sort_unstable_by_key(|(name, _)| *name);
    all.dedup_by_key(|(name, _)| *name);
    let numbered = |part: &Part| -> Vec<u32> {
        part.names.iter().map(|name| all.partition_point(|(other, _)| other < name) as u32).collect()
    };
    let numbers: Vec<Vec<u32>> = parts.par_iter().map(numbered).collect();
    let mut triangles = Vec::new();
    for (part, numbers) in parts.iter().zip(&numbers) {
        let number = |own: u32| numbers[own as usize];
        triangles.extend(part.triangles.iter().map(|t| Triangle { corners: t.corners.map(number), sheet: t.sheet }));
    }
    (all.into_iter().map(|(_, vertex)| vertex).collect(), triangles)
}
