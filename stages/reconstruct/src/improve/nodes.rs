//! Tracks which grid nodes lie on the wrong side of the mesh, compared with F. In a label map,
//! every voxel centre must stay on its side.
//!
//! The old and the new triangles of a move together bound closed regions, and the nodes in these
//! regions change sides. They are found by exact parity along grid lines, as in
//! [`isoparticles_mesh::inside`]. Where a grid line crosses a triangle, the material changes from
//! one side of the interface to the other.

use crate::interfaces::Interface;
use glam::DVec3;
use isoparticles_field::materials::MaterialId;
use isoparticles_mesh::inside::{Crossing, crossings};
use isoparticles_mesh::spatial::Bounds;
use isoparticles_volume::Geometry;
use std::collections::HashSet;

/// The grid nodes, and the set of those on the wrong side.
#[derive(Clone)]
pub(crate) struct NodeSides<'a> {
    geometry: &'a Geometry,
    /// Samples of F at the nodes; a node with F = 0 has no side. Empty if every node has a side.
    samples: &'a [f32],
    wrong: HashSet<usize>,
}

impl<'a> NodeSides<'a> {
    /// Creates the sides of the nodes of a grid from the nodes on the wrong side. `samples` are
    /// those of F, or empty if every node has a side.
    pub(crate) fn new(geometry: &'a Geometry, samples: &'a [f32], wrong: impl IntoIterator<Item = usize>) -> Self {
        Self { geometry, samples, wrong: wrong.into_iter().collect() }
    }

    /// Creates the sides of the nodes of an image of F, given a closed mesh.
    #[cfg(test)]
    pub(crate) fn of_object(
        mesh: &isoparticles_mesh::TriangleMesh,
        image: &'a isoparticles_volume::Image<f32>,
    ) -> Self {
        let wrong = isoparticles_mesh::inside::nodes_on_wrong_side(mesh, image);
        Self::new(&image.geometry, &image.data, wrong)
    }

    /// Returns the number of nodes on the wrong side.
    pub(super) fn wrong_count(&self) -> usize {
        self.wrong.len()
    }

    /// Returns the nodes that change sides if triangles are replaced by others with the same
    /// border. The iterator yields all old and all new triangles, each with the materials on its
    /// two sides.
    pub(super) fn changed(&self, triangles: impl Iterator<Item = ([DVec3; 3], Interface)>) -> Vec<usize> {
        let geometry = self.geometry;
        let mut toggles: Vec<(Crossing, Interface)> = Vec::new();
        for (corners, sides) in triangles {
            crossings(corners, geometry, |crossing| toggles.push((crossing, sides)));
        }
        toggles.sort_unstable();
        let mut changed = Vec::new();
        for row in toggles.chunk_by(|a, b| a.0.row == b.0.row) {
            // materials that the nodes have either before or after, but not both; empty if their
            // material is unchanged
            let mut unequal: Vec<MaterialId> = Vec::new();
            for pair in row.windows(2) {
                let [(from, sides), (to, _)] = [pair[0], pair[1]];
                for side in sides {
                    match unequal.iter().position(|&known| known == side) {
                        Some(at) => drop(unequal.swap_remove(at)),
                        None => unequal.push(side),
                    }
                }
                if !unequal.is_empty() {
                    let start = from.row * geometry.size[0];
                    let has_side = |&n: &usize| self.samples.get(n) != Some(&0.0);
                    changed.extend((start + from.first..start + to.first).filter(has_side));
                }
            }
        }
        changed
    }

    /// Returns the decrease of the number of nodes on the wrong side if some nodes change sides.
    /// Returns `None` if a node leaves its correct side and the number does not decrease.
    pub(super) fn mended_by(&self, changed: &[usize]) -> Option<usize> {
        let mended = changed.iter().filter(|n| self.wrong.contains(n)).count();
        let spoilt = changed.len() - mended;
        (spoilt == 0 || mended > spoilt).then(|| mended - spoilt)
    }

    /// Returns the positions of the nodes on the wrong side (grid frame, mm), in grid order.
    pub(super) fn wrong_places(&self) -> Vec<DVec3> {
        let mut wrong: Vec<usize> = self.wrong.iter().copied().collect();
        wrong.sort_unstable();
        wrong.into_iter().map(|n| self.place(n)).collect()
    }

    fn place(&self, node: usize) -> DVec3 {
        self.geometry.node_to_grid(node)
    }

    /// Returns a copy that contains only the wrong nodes in a box (grid frame, mm).
    pub(super) fn within(&self, region: &Bounds) -> Self {
        let wrong = self.wrong.iter().copied().filter(|&n| region.holds(self.place(n))).collect();
        Self { wrong, ..*self }
    }

    /// Returns the nodes that are on the wrong side in exactly one of the two.
    pub(super) fn difference(&self, other: &Self) -> Vec<usize> {
        self.wrong.symmetric_difference(&other.wrong).copied().collect()
    }

    /// Records that nodes changed sides.
    pub(super) fn turn(&mut self, nodes: &[usize]) {
        for node in nodes {
            if !self.wrong.remove(node) {
                self.wrong.insert(*node);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_between_three_moving_interfaces_change_sides() {
        // along a grid line: before, 1 to 2 at 0.5 and 2 to 3 at 2.5; after, 1 to 3 at 1.5
        let geometry = Geometry::axis_aligned([4; 3], DVec3::ONE);
        let sides = NodeSides::new(&geometry, &[], []);
        let wall = |x: f64| [(0.5, 0.5), (3.0, 0.5), (0.5, 3.0)].map(|(y, z)| DVec3::new(x, y, z));
        let [first, second, both] =
            [(0.5, [1, 2]), (2.5, [2, 3]), (1.5, [1, 3])].map(|(x, ids)| (wall(x), ids.map(MaterialId)));
        // in three rows, the first node keeps 1, the second and third nodes lose 2, and the last
        // keeps 3
        assert_eq!(sides.changed([first, second, both].into_iter()), [21, 22, 25, 26, 37, 38]);
        assert_eq!(sides.changed([first, first].into_iter()), [0; 0]);
    }

    #[test]
    fn nodes_leave_their_side_only_if_more_are_repaired() {
        let geometry = Geometry::axis_aligned([4; 3], DVec3::ONE);
        let mut sides = NodeSides::new(&geometry, &[], [21, 37]);
        assert_eq!(sides.wrong_places(), [DVec3::new(1.0, 1.0, 1.0), DVec3::new(1.0, 1.0, 2.0)]);
        for (changed, mended) in
            [(&[][..], Some(0)), (&[21], Some(1)), (&[5], None), (&[5, 21], None), (&[5, 21, 37], Some(1))]
        {
            assert_eq!(sides.mended_by(changed), mended, "{changed:?}");
        }
        sides.turn(&[5, 21, 37]);
        assert_eq!(sides.wrong_places(), [DVec3::new(1.0, 1.0, 0.0)]);
    }
}
