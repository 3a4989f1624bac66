//! Keeps every grid node on the side of the mesh where F has it (label volumes: no voxel may change sides).
//!
//! What a move takes away and what it puts there bound a closed region; the nodes in it change sides. They are found as in
//! [`isoparticles_mesh::inside`], by exact parity along grid lines.

use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::inside::{Crossing, crossings, nodes_on_wrong_side};
use isoparticles_mesh::spatial::Bounds;
use isoparticles_volume::Image;
use std::collections::HashSet;

/// The nodes, their sides, and those on the wrong one.
#[derive(Clone)]
pub(super) struct NodeSides<'a> {
    image: &'a Image<f32>,
    wrong: HashSet<usize>,
}

impl<'a> NodeSides<'a> {
    /// Finds the nodes that a mesh has on the wrong side to begin with.
    pub(super) fn new(mesh: &TriangleMesh, image: &'a Image<f32>) -> Self {
        let geometry = &image.geometry;
        let wrong = nodes_on_wrong_side(mesh, image).into_iter().map(|[i, j, k]| geometry.linear(i, j, k)).collect();
        Self { image, wrong }
    }

    /// Number of nodes on the wrong side.
    pub(super) fn wrong_count(&self) -> usize {
        self.wrong.len()
    }

    /// Nodes that change sides when some triangles give way to others with the same rim.
    pub(super) fn changed(&self, before: &[[DVec3; 3]], after: &[[DVec3; 3]]) -> Vec<usize> {
        let geometry = &self.image.geometry;
        let mut toggles: Vec<Crossing> = Vec::new();
        for &corners in before.iter().chain(after) {
            crossings(corners, geometry, |crossing| toggles.push(crossing));
        }
        toggles.sort_unstable();
        let mut changed = Vec::new();
        for pair in toggles.chunks(2) {
            if let [from, to] = pair
                && from.row == to.row
            {
                let start = from.row * geometry.size[0];
                changed.extend((start + from.first..start + to.first).filter(|&n| self.image.data[n] != 0.0));
            }
        }
        changed
    }

    /// Whether none of the nodes is on its right side now, so that the change can only mend.
    pub(super) fn are_wrong(&self, nodes: &[usize]) -> bool {
        nodes.iter().all(|n| self.wrong.contains(n))
    }

    /// The same for what happens in a box alone (grid frame, mm).
    pub(super) fn within(&self, region: &Bounds) -> Self {
        let [nx, ny, _] = self.image.geometry.size;
        let position = |n: usize| {
            let index = DVec3::new((n % nx) as f64, (n / nx % ny) as f64, (n / nx / ny) as f64);
            self.image.geometry.index_to_grid(index)
        };
        let wrong = self.wrong.iter().copied().filter(|&n| region.holds(position(n))).collect();
        Self { image: self.image, wrong }
    }

    /// Nodes that are on the wrong side here or there, but not in both.
    pub(super) fn difference(&self, other: &Self) -> Vec<usize> {
        self.wrong.symmetric_difference(&other.wrong).copied().collect()
    }

    /// Takes note that nodes changed sides.
    pub(super) fn turn(&mut self, nodes: &[usize]) {
        for node in nodes {
            if !self.wrong.remove(node) {
                self.wrong.insert(*node);
            }
        }
    }
}
