//! The criteria for the topology of a complex, as functions of the materials of its tetrahedra.
//! They report only whether and how a simplex violates its criterion. The remedies (`criteria.rs`)
//! take far longer to compute.

use super::complex::Complex;
use crate::around::{boundary_facets_of, parts_round, runs_round, star};
use crate::interfaces::{Segment, segment};
use crate::labelled::Facet;
use crate::queue::{Reason, Simplex};
use isoparticles_delaunay::INFINITE;
use isoparticles_field::materials::{MaterialId, Stratum};
use rayon::prelude::*;

/// Simplices of a complex at which criteria are evaluated.
pub struct Simplices {
    /// Edges, vertices ascending, each with a tetrahedron at it; `None` for a segment that is not
    /// an edge.
    edges: Vec<(Segment, Option<u32>)>,
    vertices: Vec<u32>,
    facets: Vec<Facet>,
}

impl Simplices {
    /// Returns all simplices of the interfaces of a complex, whose facets are given, and all
    /// segments.
    pub fn all(complex: &Complex, facets: Vec<Facet>) -> Self {
        let mut edges: Vec<(Segment, Option<u32>)> = facets
            .iter()
            .flat_map(|f| (0..3).map(|k| (segment(f.vertices[k], f.vertices[(k + 1) % 3]), Some(f.tetrahedron))))
            .collect();
        edges.par_sort_unstable();
        edges.dedup_by_key(|(edge, _)| *edge);
        // segments that are in no facet
        let lost = |pair: &Segment| edges.binary_search_by_key(pair, |(edge, _)| *edge).is_err();
        let lost: Vec<Segment> = complex.segments.all().map(|(pair, _)| pair).filter(lost).collect();
        edges.extend(lost.into_iter().map(|pair| (pair, complex.at_edge(pair))));
        let mut vertices: Vec<u32> = facets.iter().flat_map(|f| f.vertices).collect();
        vertices.par_sort_unstable();
        vertices.dedup();
        Self { edges, vertices, facets }
    }

    /// Returns the vertices, edges and facets between materials of some tetrahedra, and the
    /// segments at these vertices.
    pub fn of(complex: &Complex, tetrahedra: &[u32]) -> Self {
        let delaunay = complex.labelled.delaunay();
        let mut vertices: Vec<u32> =
            tetrahedra.iter().flat_map(|&t| delaunay.vertices(t)).filter(|&v| v != INFINITE).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut edges: Vec<(Segment, Option<u32>)> = Vec::new();
        let mut facets: Vec<Facet> = Vec::new();
        for &t in tetrahedra {
            let corners = delaunay.vertices(t);
            for i in 0..4 {
                for j in 0..i {
                    edges.push((segment(corners[i], corners[j]), Some(t)));
                }
            }
            facets.extend(boundary_facets_of(delaunay, t, |t| complex.material(t)));
        }
        edges.retain(|(edge, _)| edge[1] != INFINITE);
        edges.sort_unstable();
        edges.dedup_by_key(|(edge, _)| *edge);
        let mut others: Vec<Segment> = vertices.iter().flat_map(|&v| complex.segments.at(v)).collect();
        others.sort_unstable();
        others.dedup();
        others.retain(|pair| edges.binary_search_by_key(pair, |(edge, _)| *edge).is_err());
        edges.extend(others.into_iter().map(|pair| (pair, complex.at_edge(pair))));
        facets.sort_unstable_by_key(|f| (f.tetrahedron, f.opposite));
        facets.dedup();
        Self { edges, vertices, facets }
    }

    /// Returns the results of the three functions at the simplices: first edges, then vertices,
    /// then facets.
    pub fn each<T: Send>(
        &self,
        at_edge: impl Fn(Segment, Option<u32>) -> Option<T> + Sync,
        at_vertex: impl Fn(u32) -> Option<T> + Sync,
        at_facet: impl Fn(&Facet) -> Option<T> + Sync,
    ) -> Vec<T> {
        /// Lists shorter than this are processed on one thread, because waking other threads takes
        /// longer.
        const FEW: usize = 10_000;
        let most = |count: usize| if count < FEW { count } else { 1 };
        let mut found: Vec<T> = Vec::new();
        let edges = self.edges.par_iter().with_min_len(most(self.edges.len()));
        found.par_extend(edges.filter_map(|&(edge, start)| at_edge(edge, start)));
        let vertices = self.vertices.par_iter().with_min_len(most(self.vertices.len()));
        found.par_extend(vertices.filter_map(|&v| at_vertex(v)));
        let facets = self.facets.par_iter().with_min_len(most(self.facets.len()));
        found.par_extend(facets.filter_map(&at_facet));
        found
    }
}

impl Complex<'_> {
    /// Returns the violations of the topology at some simplices.
    pub fn wrong(&self, simplices: &Simplices) -> Vec<(Reason, Simplex)> {
        let at_edge = |edge: Segment, start: Option<u32>| Some((self.wrong_edge(edge, start)?, Simplex::Edge(edge)));
        let at_vertex = |v: u32| Some((self.wrong_vertex(v)?, Simplex::Vertex(v)));
        simplices.each(at_edge, at_vertex, |f| Some((self.wrong_facet(f)?, Simplex::Facet(f.sorted()))))
    }

    /// Returns whether the topology is wrong at a simplex.
    pub fn is_wrong(&self, simplex: Simplex) -> bool {
        let reason = match simplex {
            Simplex::Vertex(v) => self.wrong_vertex(v),
            Simplex::Edge(edge) => self.wrong_edge(edge, self.at_edge(edge)),
            Simplex::Facet(vertices) => self.facet_on(vertices).and_then(|f| self.wrong_facet(&f)),
            Simplex::Node(_) | Simplex::Place(..) => None,
        };
        reason.is_some()
    }

    /// Returns the tetrahedra around an edge as runs of one material. `start` is a tetrahedron at
    /// the edge.
    pub(super) fn runs_round(&self, edge: Segment, start: u32) -> Vec<Vec<u32>> {
        runs_round(self.labelled.delaunay(), edge, start, |t| self.material(t))
    }

    /// Returns the violation at an edge or segment, if there is one. `start` is a tetrahedron at
    /// it; `None` if the segment is not an edge.
    fn wrong_edge(&self, edge: Segment, start: Option<u32>) -> Option<Reason> {
        match self.segments.curve(edge) {
            Some(curve) => self.wrong_segment(edge, curve, start),
            None => self.wrong_plain_edge(edge, start?),
        }
    }

    /// Returns the violation at a segment, if there is one. A segment must be an edge around which
    /// each of the regions of its curve forms one run. For four regions, three are enough, because
    /// the material between merged curves has no width. For two, at the rim of a plane, the facets
    /// must belong to two interfaces. `start` is a tetrahedron at the segment.
    pub(super) fn wrong_segment(&self, pair: Segment, curve: Stratum, start: Option<u32>) -> Option<Reason> {
        let Some(start) = start else { return Some(Reason::Segment) };
        let runs = self.runs_round(pair, start);
        let mut ids: Vec<MaterialId> = runs.iter().map(|run| self.material(run[0])).collect();
        ids.sort_unstable();
        let expected = self.region_count(&curve).min(3);
        let is_on_curve = |&id: &MaterialId| curve.materials().iter().any(|&own| self.indicators.region(own) == id);
        let is_right = ids.len() >= expected
            && ids.iter().all(is_on_curve)
            && ids.is_sorted_by(|a, b| a < b)
            && (expected > 2 || self.joins_interfaces(pair, &runs));
        (!is_right).then_some(Reason::Ring)
    }

    /// Returns whether the facets at an edge belong to several interfaces.
    fn joins_interfaces(&self, edge: Segment, runs: &[Vec<u32>]) -> bool {
        let interfaces: Vec<_> = self.facets_between(edge, runs).iter().map(|facet| self.interface(facet)).collect();
        interfaces.iter().any(|interface| *interface != interfaces[0])
    }

    /// Returns the violation at an edge that is not a segment, if there is one. The edge must be in
    /// two facets of one interface or in none. `start` is a tetrahedron at the edge.
    pub(super) fn wrong_plain_edge(&self, edge: Segment, start: u32) -> Option<Reason> {
        let runs = self.runs_round(edge, start);
        let is_on_plane = |&v: &u32| {
            let ids = self.strata[v as usize];
            ids.materials().iter().any(|&id| self.indicators.is_beyond(id))
        };
        let is_wrong = match runs.len() {
            0 | 1 => false,
            2 => edge.iter().all(is_on_plane) && self.joins_interfaces(edge, &runs),
            _ => true,
        };
        is_wrong.then_some(Reason::Edge)
    }

    /// Returns the violation at a vertex, if there is one. Around the vertex, each material must
    /// form one part, and so must its complement. Otherwise, the surface of the material touches
    /// itself there, as for a material that forms a ring between two others.
    pub(super) fn wrong_vertex(&self, vertex: u32) -> Option<Reason> {
        let delaunay = self.labelled.delaunay();
        let star = star(delaunay, vertex);
        let parts = parts_round(delaunay, vertex, &star, |t| self.material(t));
        let mut ids: Vec<MaterialId> = parts.iter().map(|part| self.material(part[0])).collect();
        ids.sort_unstable();
        let is_parted = |&id: &MaterialId| parts_round(delaunay, vertex, &star, |t| self.material(t) == id).len() > 2;
        // of two materials, each is the complement of the other
        let is_right = ids.windows(2).all(|pair| pair[0] < pair[1]) && (ids.len() < 3 || !ids.iter().any(is_parted));
        (!is_right).then_some(Reason::Vertex)
    }

    /// Returns the violation at a facet, if there is one. The two materials of the facet must meet
    /// at each of its vertices.
    pub(super) fn wrong_facet(&self, facet: &Facet) -> Option<Reason> {
        let interface = self.interface(facet);
        let is_on = |v: &u32| interface.iter().all(|&id| self.meets(*v, id));
        (!facet.vertices.iter().all(is_on)).then_some(Reason::Stratum)
    }
}

#[cfg(test)]
mod tests {
    use super::super::prepare::prepare;
    use super::super::scenes;
    use super::*;
    use crate::options::Options;
    use glam::DVec3;
    use std::collections::BTreeSet;

    #[test]
    fn ring_of_a_material_around_a_vertex_is_wrong() {
        let scene = scenes::sectors();
        let (particles, strata) = scene.particles(1.5, 0.7);
        let prepared = prepare(&particles, &strata, &scene.analytic).expect("on their strata");
        let mut complex = Complex::new(prepared, &scene.analytic, DVec3::splat(scene.extent), &Options::default());
        let v = (0..complex.points().len() as u32)
            .find(|&v| {
                complex.strata[v as usize].dimension() == 2
                    && complex.points()[v as usize].distance(scenes::CENTRE) < 5.0
            })
            .expect("a vertex inside a interface");
        let own = star(complex.labelled.delaunay(), v);
        let at = |complex: &Complex, u: u32| -> Vec<u32> {
            own.iter().copied().filter(|&t| complex.labelled.delaunay().vertices(t).contains(&u)).collect()
        };
        // the two neighbours in the most opposite directions
        let link: BTreeSet<u32> =
            own.iter().flat_map(|&t| complex.labelled.delaunay().vertices(t)).filter(|&u| u != v).collect();
        let way = |u: u32| (complex.points()[u as usize] - complex.points()[v as usize]).normalize();
        let pairs = link.iter().flat_map(|&a| link.iter().map(move |&b| (a, b)));
        let (a, b) = pairs.min_by(|p, q| way(p.0).dot(way(p.1)).total_cmp(&way(q.0).dot(way(q.1)))).expect("two");
        let mut colour = |ring: u16, top: u16, bottom: u16| {
            own.iter().for_each(|&t| complex.labelled.set(t, MaterialId(ring)));
            at(&complex, a).into_iter().for_each(|t| complex.labelled.set(t, MaterialId(top)));
            at(&complex, b).into_iter().for_each(|t| complex.labelled.set(t, MaterialId(bottom)));
            complex.wrong_vertex(v)
        };
        assert_eq!(colour(3, 1, 2), Some(Reason::Vertex), "a ring");
        assert_eq!(colour(3, 1, 1), Some(Reason::Vertex), "one material in two parts");
        assert_eq!(colour(3, 1, 3), None, "two, each in one part");
    }
}
