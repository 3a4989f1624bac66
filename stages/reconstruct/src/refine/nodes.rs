//! Adds points where grid nodes of a label volume are on the wrong side of the mesh. Such a node
//! gets the nearest point of F = 0, or points on the edges of facets that have it on the wrong
//! side.

use super::{Place, Refinement};
use crate::interfaces::Interfaces;
use crate::object::Violation;
use crate::queue::Reason;
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_mesh::inside::nodes_on_wrong_side;
use rayon::prelude::*;
use std::collections::HashMap;

/// Distance in units of h between a vertex and the point of F = 0 nearest to a grid node on the
/// wrong side. Below this distance, facets at this vertex are split instead of adding the point.
pub(crate) const AT_A_VERTEX: f64 = 0.15;

impl Refinement<'_> {
    /// Returns the grid nodes on the wrong side of a closed set of facets, in the grid frame, mm.
    /// Returns no nodes if they are not tested.
    fn wrong_nodes(&self, facets: &[Facet]) -> Vec<DVec3> {
        let Some(samples) = self.nodes else { return Vec::new() };
        let triangles = facets.iter().map(|facet| facet.vertices);
        let mesh = Interfaces::compact_object(self.object.points(), triangles).0.mesh;
        let wrong = nodes_on_wrong_side(&mesh, samples);
        wrong.into_iter().map(|node| samples.geometry.node_to_grid(node)).collect()
    }

    /// Returns the points that move grid nodes to their correct side of the facets.
    pub(super) fn at_nodes(&self, facets: &[Facet]) -> Vec<Violation> {
        let nodes = self.wrong_nodes(facets);
        if nodes.is_empty() {
            return Vec::new();
        }
        let mut facets_at: HashMap<u32, Vec<&Facet>> = HashMap::new();
        for facet in facets {
            facet.vertices.into_iter().for_each(|v| facets_at.entry(v).or_default().push(facet));
        }
        let found: Vec<Place> = nodes.par_iter().flat_map_iter(|&node| self.at_node(node, &facets_at)).collect();
        self.places(Reason::Node, &found)
    }

    /// Returns the point of F = 0 nearest to a node. If a vertex is already there, returns the
    /// midpoints of the longest edges of those facets at it that have the node on the wrong side.
    fn at_node(&self, node: DVec3, facets_at: &HashMap<u32, Vec<&Facet>>) -> Vec<Place> {
        let Some(point) = self.object.on_surface(node, 2.0) else { return Vec::new() };
        let (vertex, radius) = self.nearest(point);
        let size = self.object.sizes[vertex as usize];
        if radius >= AT_A_VERTEX * size {
            return vec![Place { point, radius, size }];
        }
        let is_outside = self.object.restricted.field().value(node) > 0.0;
        let passes_by = |f: &&&Facet| {
            let [a, b, c] = f.vertices.map(|v| self.object.points()[v as usize]);
            ((node - a).dot((b - a).cross(c - a)) > 0.0) != is_outside
        };
        let facets = facets_at.get(&vertex).into_iter().flatten();
        facets.filter(passes_by).filter_map(|f| self.split(f)).collect()
    }

    /// Returns the midpoint of the longest edge of a facet, projected onto F = 0.
    fn split(&self, facet: &Facet) -> Option<Place> {
        let ends = |k: usize| [k, (k + 1) % 3].map(|k| self.object.points()[facet.vertices[k] as usize]);
        let length = |k: &usize| ends(*k)[0].distance(ends(*k)[1]);
        let [a, b] = ends((0..3).max_by(|i, j| length(i).total_cmp(&length(j)))?);
        let point = self.object.on_surface(a.midpoint(b), 2.0)?;
        let radius = point.distance(a).min(point.distance(b));
        Some(Place { point, radius, size: self.object.sizes[facet.vertices[0] as usize] })
    }
}
