//! Points at grid nodes of a label volume that lie on the wrong side of the mesh.

use super::Refinement;
use super::insert::{Candidate, Reason};
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_stage::error::Result;

/// A grid node on the wrong side whose nearest point of F = 0 is nearer than this part of h to a vertex has that vertex.
const AT_A_VERTEX: f64 = 0.15;

impl Refinement<'_> {
    /// Brings grid nodes that lie on the wrong side of the mesh to the right one: inserts the point of F = 0 nearest to
    /// each or, where a vertex is there already, refines the facet at it that passes the node by. Returns how many.
    ///
    /// # Errors
    /// None as a rule; those of the triangulation.
    pub fn insert_near_nodes(&mut self, nodes: &[[usize; 3]], facets: &[Facet]) -> Result<usize> {
        let geometry = self.restricted.field().geometry();
        let mut at_vertex: Vec<(u32, DVec3)> = Vec::new();
        let mut candidates = Vec::new();
        for node in nodes {
            let node = geometry.index_to_grid(DVec3::from_array(node.map(|n| n as f64)));
            let Some(point) = self.on_surface(node, 2.0) else { continue };
            let Some((near, radius)) = self.nearest.to(point) else { continue };
            let size = self.sizes[near as usize];
            if radius < AT_A_VERTEX * size {
                at_vertex.push((near, node));
            } else {
                candidates.push(Candidate { reason: Reason::Node, point, radius, size, near });
            }
        }
        at_vertex.sort_by_key(|(v, _)| *v);
        let points = self.restricted.points();
        for facet in facets {
            let [a, b, c] = facet.vertices.map(|v| points[v as usize]);
            let normal = (b - a).cross(c - a);
            for v in facet.vertices {
                let start = at_vertex.partition_point(|(u, _)| *u < v);
                let nodes = at_vertex[start..].iter().take_while(|(u, _)| *u == v);
                for (_, node) in nodes {
                    let outside = self.restricted.field().value(*node) > 0.0;
                    if ((*node - a).dot(normal) > 0.0) != outside {
                        candidates.extend(self.split(facet));
                    }
                }
            }
        }
        self.insert_all(candidates)
    }

    /// The point of F = 0 at the middle of the longest edge of a facet.
    fn split(&self, facet: &Facet) -> Option<Candidate> {
        let ends = |k: usize| [k, (k + 1) % 3].map(|k| self.restricted.points()[facet.vertices[k] as usize]);
        let length = |k: &usize| ends(*k)[0].distance(ends(*k)[1]);
        let [a, b] = ends((0..3).max_by(|i, j| length(i).total_cmp(&length(j)))?);
        let point = self.on_surface(a.midpoint(b), 2.0)?;
        let size = self.sizes[facet.vertices[0] as usize];
        let radius = point.distance(a).min(point.distance(b));
        Some(Candidate { reason: Reason::Node, point, radius, size, near: facet.vertices[0] })
    }
}
