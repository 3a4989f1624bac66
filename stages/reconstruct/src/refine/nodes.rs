//! Points at grid nodes of a label volume that lie on the wrong side of the mesh.

use super::{Place, Refinement};
use crate::join::compact;
use crate::object::Violation;
use crate::queue::{Reason, Simplex};
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_mesh::inside::nodes_on_wrong_side;
use rayon::prelude::*;
use std::collections::HashMap;

/// A grid node on the wrong side whose nearest point of F = 0 is nearer than this part of h to a vertex has that vertex.
pub(crate) const AT_A_VERTEX: f64 = 0.15;

impl Refinement<'_> {
    /// The grid nodes on the wrong side of some facets, none where they do not count.
    fn wrong_nodes(&self, facets: &[Facet]) -> Vec<usize> {
        let Some(samples) = self.nodes else { return Vec::new() };
        let (mesh, _) = compact(self.object.points(), facets);
        nodes_on_wrong_side(&mesh, samples).into_iter().map(|[i, j, k]| samples.geometry.linear(i, j, k)).collect()
    }

    /// Place of a node, grid frame, mm.
    fn node(&self, number: usize) -> DVec3 {
        let geometry = self.object.restricted.field().geometry();
        let [nx, ny, _] = geometry.size;
        geometry.index_to_grid(DVec3::new((number % nx) as f64, (number / nx % ny) as f64, (number / nx / ny) as f64))
    }

    /// The violations at grid nodes on the wrong side.
    pub(super) fn at_nodes(&self, facets: &[Facet]) -> Vec<Violation> {
        let at = |&node: &usize| self.at_node(node, self.nearest(self.node(node)).0);
        self.wrong_nodes(facets).par_iter().filter_map(at).collect()
    }

    /// The violation at a grid node, if it is on the wrong side; `near` is a vertex not far from it.
    pub(super) fn at_node(&self, number: usize, near: u32) -> Option<Violation> {
        let node = self.node(number);
        let sample = self.nodes?.data[number];
        if sample == 0.0 || self.object.restricted.holds(node, near) == (sample < 0.0) {
            return None;
        }
        let near = self.object.restricted.nearest(node, near).0;
        let place = self.at_foot(node, near, |v| self.object.facets_at(v))?;
        let Place { point, radius, size } = place;
        Some(Violation { reason: Reason::Node, simplex: Simplex::Node(number), remedy: point, radius, size, near })
    }

    /// Where points bring the grid nodes that lie on the wrong side of facets found by other means to the right one.
    pub(super) fn at_nodes_of_other(&self, facets: &[Facet]) -> Vec<Violation> {
        let nodes = self.wrong_nodes(facets);
        if nodes.is_empty() {
            return Vec::new();
        }
        let mut facets_at: HashMap<u32, Vec<Facet>> = HashMap::new();
        for facet in facets {
            facet.vertices.into_iter().for_each(|v| facets_at.entry(v).or_default().push(*facet));
        }
        let at = |&number: &usize| {
            let node = self.node(number);
            self.at_foot(node, self.nearest(node).0, |v| facets_at.get(&v).cloned().unwrap_or_default())
        };
        let found: Vec<Place> = nodes.par_iter().filter_map(at).collect();
        self.places(Reason::Node, &found)
    }

    /// The point of F = 0 nearest to a node or, where a vertex is there already, the middle of the longest edge of the facets at it that pass the node by.
    fn at_foot(&self, node: DVec3, near: u32, facets_at: impl Fn(u32) -> Vec<Facet>) -> Option<Place> {
        let point = self.object.on_surface(node, 2.0)?;
        let (vertex, radius) = self.object.restricted.nearest(point, near);
        let size = self.object.sizes[vertex as usize];
        if radius >= AT_A_VERTEX * size {
            return Some(Place { point, radius, size });
        }
        let is_outside = self.object.restricted.field().value(node) > 0.0;
        let passes_by = |f: &Facet| {
            let [a, b, c] = f.vertices.map(|v| self.object.points()[v as usize]);
            ((node - a).dot((b - a).cross(c - a)) > 0.0) != is_outside
        };
        let splits = facets_at(vertex).into_iter().filter(passes_by).filter_map(|f| self.split(&f));
        splits.max_by(|a, b| a.radius.total_cmp(&b.radius))
    }

    /// The point of F = 0 at the middle of the longest edge of a facet.
    fn split(&self, facet: &Facet) -> Option<Place> {
        let ends = |k: usize| [k, (k + 1) % 3].map(|k| self.object.points()[facet.vertices[k] as usize]);
        let length = |k: &usize| ends(*k)[0].distance(ends(*k)[1]);
        let [a, b] = ends((0..3).max_by(|i, j| length(i).total_cmp(&length(j)))?);
        let point = self.object.on_surface(a.midpoint(b), 2.0)?;
        let radius = point.distance(a).min(point.distance(b));
        Some(Place { point, radius, size: self.object.sizes[facet.vertices[0] as usize] })
    }
}
