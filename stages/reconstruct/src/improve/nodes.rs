//! Keeps every grid node on the side of the mesh where F has it (label volumes: no voxel may change sides).
//!
//! What a move takes away and what it puts there bound closed regions; the nodes in them change sides. They are found as in
//! [`isoparticles_mesh::inside`], by exact parity along grid lines: where a triangle is crossed, what lies on the one side of its sheet gives way to what lies on the other.

use super::surface::Surface;
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::inside::{Crossing, crossings, nodes_on_wrong_side};
use isoparticles_mesh::spatial::Bounds;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;
use std::collections::HashSet;

/// The nodes, their sides, and those on the wrong one.
#[derive(Clone)]
pub(super) struct NodeSides<'a> {
    geometry: &'a Geometry,
    /// Samples of F: those that are zero have no side. Empty where every node has one.
    samples: &'a [f32],
    wrong: HashSet<usize>,
}

impl<'a> NodeSides<'a> {
    /// Finds the nodes that a mesh has on the wrong side to begin with.
    pub(super) fn new(mesh: &TriangleMesh, image: &'a Image<f32>) -> Self {
        let geometry = &image.geometry;
        let wrong = nodes_on_wrong_side(mesh, image).into_iter().map(|[i, j, k]| geometry.linear(i, j, k)).collect();
        Self { geometry, samples: &image.data, wrong }
    }

    /// Every node of a grid has a side, and these have the wrong one.
    pub(super) fn of(geometry: &'a Geometry, wrong: impl IntoIterator<Item = usize>) -> Self {
        Self { geometry, samples: &[], wrong: wrong.into_iter().collect() }
    }

    /// Number of nodes on the wrong side.
    pub(super) fn wrong_count(&self) -> usize {
        self.wrong.len()
    }

    /// Nodes that change sides when some triangles give way to others with the same rim; each triangle, before and after, with what lies on its two sides.
    pub(super) fn changed(&self, triangles: impl Iterator<Item = ([DVec3; 3], [u32; 2])>) -> Vec<usize> {
        let geometry = self.geometry;
        let mut toggles: Vec<(Crossing, [u32; 2])> = Vec::new();
        for (corners, sides) in triangles {
            crossings(corners, geometry, |crossing| toggles.push((crossing, sides)));
        }
        toggles.sort_unstable();
        let mut changed = Vec::new();
        for row in toggles.chunk_by(|a, b| a.0.row == b.0.row) {
            // what a node has before or after, but not both: nothing where it stays where it is
            let mut unequal: Vec<u32> = Vec::new();
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

    /// By how many fewer nodes are on the wrong side when some change sides; `None` when a node leaves its right side and the count does not fall.
    pub(super) fn mended_by(&self, changed: &[usize]) -> Option<usize> {
        let mended = changed.iter().filter(|n| self.wrong.contains(n)).count();
        let spoilt = changed.len() - mended;
        (spoilt == 0 || mended > spoilt).then(|| mended - spoilt)
    }

    /// Places of the nodes on the wrong side (grid frame, mm), in the order of the grid.
    pub(super) fn wrong_places(&self) -> Vec<DVec3> {
        let mut wrong: Vec<usize> = self.wrong.iter().copied().collect();
        wrong.sort_unstable();
        wrong.into_iter().map(|n| self.place(n)).collect()
    }

    fn place(&self, node: usize) -> DVec3 {
        let [nx, ny, _] = self.geometry.size;
        let index = DVec3::new((node % nx) as f64, (node / nx % ny) as f64, (node / nx / ny) as f64);
        self.geometry.index_to_grid(index)
    }

    /// The same for what happens in a box alone (grid frame, mm).
    pub(super) fn within(&self, region: &Bounds) -> Self {
        let wrong = self.wrong.iter().copied().filter(|&n| region.holds(self.place(n))).collect();
        Self { wrong, ..*self }
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

impl Surface<'_> {
    /// Whether grid nodes are guarded of which some are on the wrong side.
    pub(super) fn has_wrong_nodes(&self) -> bool {
        self.sides.as_ref().is_some_and(|sides| sides.wrong_count() > 0)
    }

    /// The triangles nearest to the grid nodes on the wrong side, ascending.
    pub(super) fn triangles_at_wrong_nodes(&self) -> Vec<u32> {
        let places = self.sides.as_ref().map_or_else(Vec::new, NodeSides::wrong_places);
        let mut nearest: Vec<u32> = places.into_par_iter().filter_map(|p| self.nearest_triangle(p)).collect();
        nearest.sort_unstable();
        nearest.dedup();
        nearest
    }

    /// The triangle nearest to a point, the first of several.
    fn nearest_triangle(&self, p: DVec3) -> Option<u32> {
        let furthest = self.positions.iter().map(|q| q.distance(p)).fold(0.0, f64::max);
        let mut reach = self.field.voxel();
        loop {
            let mut best: Option<(f64, u32)> = None;
            self.grid.as_ref()?.any(&Bounds { low: p - reach, high: p + reach }, |t, _| {
                let rated = (distance_to_triangle(p, self.corners(t)), t);
                if rated.0 <= reach && best.is_none_or(|best| rated < best) {
                    best = Some(rated);
                }
                false
            });
            if best.is_some() || reach > furthest {
                return best.map(|(_, t)| t);
            }
            reach *= 2.0;
        }
    }
}

fn distance_to_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let sides = [(a, b), (b, c), (c, a)];
    if normal != DVec3::ZERO && sides.iter().all(|&(from, to)| (to - from).cross(p - from).dot(normal) >= 0.0) {
        return (p - a).dot(normal).abs();
    }
    let to_side = |(from, to): (DVec3, DVec3)| {
        let share = (p - from).dot(to - from) / (to - from).length_squared().max(f64::MIN_POSITIVE);
        p.distance(from.lerp(to, share.clamp(0.0, 1.0)))
    };
    sides.map(to_side).into_iter().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_three_sheets_move_together_each_node_is_told_by_what_is_on_its_two_sides() {
        // along a grid line: from 1 to 2 at 0.5 and from 2 to 3 at 2.5 before; from 1 to 3 at 1.5 after
        let geometry = Geometry::axis_aligned([4; 3], DVec3::ONE);
        let sides = NodeSides::of(&geometry, []);
        let wall = |x: f64| [(0.5, 0.5), (3.0, 0.5), (0.5, 3.0)].map(|(y, z)| DVec3::new(x, y, z));
        let [first, second, both] = [(wall(0.5), [1, 2]), (wall(2.5), [2, 3]), (wall(1.5), [1, 3])];
        // of three rows the first node keeps 1, the second and the third lose 2, the last keeps 3
        assert_eq!(sides.changed([first, second, both].into_iter()), [21, 22, 25, 26, 37, 38]);
        assert_eq!(sides.changed([first, first].into_iter()), [0; 0]);
    }

    #[test]
    fn nodes_may_leave_their_right_side_only_for_the_sake_of_more_others() {
        let geometry = Geometry::axis_aligned([4; 3], DVec3::ONE);
        let mut sides = NodeSides::of(&geometry, [21, 37]);
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
