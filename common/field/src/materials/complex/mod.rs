//! Computes the discrete complex of the strata from the indicators alone: triangles of material
//! interfaces, chains of junction curves, and junction points.
//!
//! The method is marching tetrahedra for many materials (Nielson and Franke, Computing the
//! Separating Surface for Segmented Data, IEEE Visualization 1997). Each cell is cut into Kuhn's
//! six tetrahedra, whose faces match across neighbouring cells. The materials at the corners of a
//! tetrahedron determine the pieces of strata in it. An edge whose ends have different materials
//! crosses their interface once, a face with three different materials crosses their curve once,
//! and a tetrahedron with four different materials contains one junction point. The complex is
//! therefore closed for any indicators: interfaces end at curves, and curves end at points.
//! Newton's method moves the vertices of curves and points onto the true strata. Interface vertices
//! lie where the indicators, interpolated linearly between the corners, are equal; they are not
//! moved, and their error is of second order in the spacing.

mod cells;
mod chains;
mod follow;
mod lattice;
mod measure;
#[cfg(test)]
mod tests;

pub use cells::{Triangle, Vertex};
pub use chains::{Chain, End, JunctionPoint};
pub use follow::{SAME_JUNCTION, way_along, way_from, way_round};

use super::{Indicators, Materials, Stratum};
use cells::{Name, Part, part};
use isoparticles_mesh::components::DisjointSets;
use isoparticles_volume::Geometry;
use lattice::Lattice;
use rayon::prelude::*;
use serde::Serialize;

/// Counts of the curves, junction points and lattice vertices that were found, projected, merged or
/// dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Tally {
    /// Junction points found on the lattice.
    pub points: usize,
    /// Lattice junction points that Newton's method could not project.
    pub points_not_projected: usize,
    /// Lattice junction points projected to a position where a fifth indicator is smaller.
    pub points_not_clear: usize,
    /// Vertices of junction curves found on the lattice.
    pub curve_vertices: usize,
    /// Lattice curve vertices that could not be projected onto their curve.
    pub curve_vertices_not_projected: usize,
    /// Lattice curve vertices projected to a position where a fourth indicator is smaller.
    pub curve_vertices_not_clear: usize,
    /// Curve ends beyond which the curve could not be followed.
    pub curves_lost: usize,
    /// Junction points that were merged with another junction point of the same materials.
    pub points_merged: usize,
    /// Junction points that were removed because all their curves continue through them.
    pub points_passed: usize,
    /// Junction points at which not every triple of the four materials has exactly one curve end.
    pub points_irregular: usize,
    /// Closed curves that were dropped because they are shorter than half a voxel.
    pub specks: usize,
}

/// The strata of the materials of a volume, as a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Complex {
    /// Vertices on interfaces, curves and points. Interface vertices lie on lattice edges. The
    /// other vertices lie on their strata unless the tally counts them as not projected or not
    /// clear.
    pub vertices: Vec<Vertex>,
    /// The material interfaces.
    pub triangles: Vec<Triangle>,
    /// The junction curves.
    pub chains: Vec<Chain>,
    /// The junction points.
    pub points: Vec<JunctionPoint>,
    /// Counts from projecting vertices and following curves.
    pub tally: Tally,
}

impl Complex {
    /// Computes the complex of the materials of a volume. The result does not depend on the number
    /// of threads.
    pub fn new(materials: &Materials) -> Self {
        Self::of_bricks(materials, materials.geometry(), &materials.bricks_of_many())
    }

    /// Computes the complex of any indicators on a grid. `bricks` are boxes of cells that together
    /// contain all strata. Each is given by its first cell and its number of cells along each axis.
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

    /// Returns the component of each triangle, and the number of components. Triangles of one
    /// interface that share a vertex belong to the same component. Components are numbered in the
    /// order of their first triangles.
    pub fn interface_components(&self) -> (Vec<u32>, usize) {
        // a vertex on a curve or at a point counts once for each interface that contains it
        let is_shared = |v: u32| self.vertices[v as usize].stratum.dimension() < 2;
        let mut shared: Vec<(u32, Stratum)> = self
            .triangles
            .iter()
            .flat_map(|t| t.corners.into_iter().filter(|&v| is_shared(v)).map(|v| (v, t.interface)))
            .collect();
        shared.par_sort_unstable();
        shared.dedup();
        let first = self.vertices.len() as u32;
        let place = |v: u32, interface: Stratum| {
            if is_shared(v) { first + shared.partition_point(|other| *other < (v, interface)) as u32 } else { v }
        };
        let mut sets = DisjointSets::new(self.vertices.len() + shared.len());
        for triangle in &self.triangles {
            let [a, b, c] = triangle.corners.map(|v| place(v, triangle.interface));
            sets.join(a, b);
            sets.join(b, c);
        }
        let mut number = vec![u32::MAX; self.vertices.len() + shared.len()];
        let mut count = 0;
        let mut component = |triangle: &Triangle| {
            let own = &mut number[sets.find(place(triangle.corners[0], triangle.interface)) as usize];
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

/// Joins the parts and merges vertices with the same name.
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
        triangles
            .extend(part.triangles.iter().map(|t| Triangle { corners: t.corners.map(number), interface: t.interface }));
    }
    (all.into_iter().map(|(_, vertex)| vertex).collect(), triangles)
}
