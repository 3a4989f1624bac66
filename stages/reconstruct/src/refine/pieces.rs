//! Components of F = 0 whose facets fall apart: points in the gaps.

use super::{Place, Refinement};
use crate::defects::Defects;
use crate::object::{Violation, component_at};
use crate::queue::{NEAREST_FOR_TOPOLOGY, Reason};
use glam::DVec3;
use isoparticles_mesh::components::NO_COMPONENT;
use isoparticles_mesh::kd_tree::KdTree;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{HashMap, HashSet};

/// The vertices of a piece are asked for the nearest vertex of another by leaps of so many, then all the others: the first few tell nearly how
/// near that is, and the rest need not look farther.
const LEAP: usize = 64;

/// The pieces of a group of components that fell apart.
pub(super) struct Pieces {
    group: u32,
    /// Vertices of each, the largest piece first.
    vertices: Vec<Vec<u32>>,
    /// Which of them a component of the facets is.
    rank: HashMap<u32, usize>,
}

impl Pieces {
    /// Number of pieces.
    pub(super) fn count(&self) -> usize {
        self.vertices.len()
    }

    /// The vertices of a piece, ascending; the largest piece is the first.
    pub(super) fn vertices(&self, piece: usize) -> &[u32] {
        &self.vertices[piece]
    }
}

impl Refinement<'_> {
    /// The pieces of all groups that fell apart.
    pub(super) fn pieces(&self, defects: &Defects) -> Vec<Pieces> {
        let fell_apart: HashSet<u32> = defects.in_pieces.iter().map(|found| found.group).collect();
        if fell_apart.is_empty() {
            return Vec::new();
        }
        let mut number_of: HashMap<(u32, u32), usize> = HashMap::new();
        let mut found: Vec<((u32, u32), Vec<u32>)> = Vec::new();
        for (v, (&component, &piece)) in (0..).zip(self.object.component_of.iter().zip(&defects.piece_of_vertex)) {
            let group = self.object.topology.groups().of(component).filter(|group| fell_apart.contains(group));
            if let Some(group) = group.filter(|_| piece != NO_COMPONENT) {
                let number = *number_of.entry((group, piece)).or_insert_with(|| {
                    found.push(((group, piece), Vec::new()));
                    found.len() - 1
                });
                found[number].1.push(v);
            }
        }
        found.sort_unstable_by_key(|((group, piece), vertices)| (*group, Reverse(vertices.len()), *piece));
        let by_group = found.chunk_by(|a, b| a.0.0 == b.0.0).map(|pieces| Pieces {
            group: pieces[0].0.0,
            rank: pieces.iter().enumerate().map(|(k, ((_, piece), _))| (*piece, k)).collect(),
            vertices: pieces.iter().map(|(_, vertices)| vertices.clone()).collect(),
        });
        by_group.collect()
    }

    /// The vertices, one of piece `k` and one of a larger piece, that are nearest to each other.
    fn gap(&self, tree: &KdTree, pieces: &Pieces, k: usize, defects: &Defects) -> Option<[u32; 2]> {
        let own = &pieces.vertices[k];
        let is_larger = |v: u32| self.is_of_larger(pieces, k, defects, v);
        let mut best: Option<([u32; 2], f64)> = None;
        for &v in (0..LEAP).flat_map(|start| own[start.min(own.len())..].iter().step_by(LEAP)) {
            let radius = best.map_or(f64::INFINITY, |(_, distance)| distance);
            let nearest = tree.nearest_accepted(self.object.points()[v as usize], radius, is_larger);
            best = nearest.map(|(w, distance)| ([v, w as u32], distance)).or(best);
        }
        best.map(|(ends, _)| ends)
    }

    /// Whether a point of F = 0 lies on a group of components.
    fn is_of_group(&self, point: DVec3, group: u32) -> bool {
        let component = component_at(point, self.object.restricted.field(), self.object.topology);
        self.object.topology.groups().of(component) == Some(group)
    }

    fn is_of_larger(&self, pieces: &Pieces, k: usize, defects: &Defects, v: u32) -> bool {
        let rank = || pieces.rank.get(&defects.piece_of_vertex[v as usize]);
        self.object.topology.groups().of(self.object.component_of[v as usize]) == Some(pieces.group)
            && rank().is_some_and(|&rank| rank < k)
    }

    /// Points in the gaps of groups that fell apart: between each smaller piece and the nearest vertex of the larger ones, or round there where a point in the middle did not join them.
    pub(super) fn in_gaps(&self, defects: &Defects) -> Vec<Violation> {
        let pieces = self.pieces(defects);
        if pieces.is_empty() {
            return Vec::new();
        }
        let tree = KdTree::new(self.object.points());
        let gaps = pieces.par_iter().flat_map(|p| (1..p.vertices.len()).into_par_iter().map(move |k| (p, k)));
        let between = gaps.flat_map_iter(|(pieces, k)| {
            let Some([v, w]) = self.gap(&tree, pieces, k, defects) else { return Vec::new() };
            let [p, q] = [v, w].map(|v| self.object.points()[v as usize]);
            let (middle, size) = (p.midpoint(q), p.distance(q));
            let foot = self.object.on_surface(middle, 2.0);
            let found = foot.map(|point| Place { point, radius: self.nearest(point).1, size });
            if let Some(place) = found.filter(|place| place.radius >= NEAREST_FOR_TOPOLOGY * size) {
                return vec![place];
            }
            let mut round = self.on_spheres(foot.unwrap_or(middle), self.object.sizes[v as usize], size);
            round.retain(|place| self.is_of_group(place.point, pieces.group));
            round
        });
        self.places(Reason::Component, &between.collect::<Vec<Place>>())
    }
}
