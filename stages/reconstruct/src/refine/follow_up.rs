//! Further points where the last ones left defects or made new ones, without a look at the rest of the surface: on a large one all but
//! a few places are right after a round or two.

use super::Refinement;
use super::insert::Candidate;
use crate::defects::Pinches;
use crate::restricted::Facet;
use isoparticles_delaunay::INFINITE;
use isoparticles_mesh::incidence::Incidence;
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::collections::HashMap;

/// Times that a round follows up its own points.
const FOLLOW_UPS: usize = 20;

impl Refinement<'_> {
    /// Adds points where the surface has changed since the last call and is not right, until it is, none can be added, or a round has followed
    /// up its own points often enough. Returns how often it did.
    ///
    /// # Errors
    /// Those of `step`, which hears the round and the number of points.
    pub(super) fn follow_up(&mut self, step: &mut impl FnMut(usize, usize) -> Result<()>) -> Result<usize> {
        for times in 0..FOLLOW_UPS {
            let changed = self.restricted.take_changed();
            let candidates = self.candidates_at(&changed);
            if self.insert_those(candidates)? == 0 {
                return Ok(times);
            }
            self.report.follow_ups += 1;
            step(self.report.rounds, self.restricted.points().len())?;
        }
        // what is left there is found when the whole surface is looked at
        self.restricted.take_changed();
        self.strays_are_known = false;
        Ok(FOLLOW_UPS)
    }

    /// Points at the defects that the facets at the vertices of new tetrahedra (ascending) show: edges and vertices that are not manifold, and new facets
    /// that stray.
    fn candidates_at(&self, tetrahedra: &[u32]) -> Vec<Candidate> {
        let delaunay = self.restricted.delaunay();
        let mut vertices: Vec<u32> = tetrahedra.iter().flat_map(|&t| delaunay.vertices(t)).collect();
        vertices.retain(|&v| v != INFINITE);
        vertices.sort_unstable();
        vertices.dedup();
        let mut facets: Vec<Facet> = vertices.par_iter().flat_map_iter(|&v| self.restricted.facets_at(v)).collect();
        facets.sort_unstable_by_key(|f| (f.tetrahedron, f.opposite));
        facets.dedup();
        let facets = self.without_border_closure(facets);
        let Pinches { edges, vertices: pinched } = self.pinches_at(&vertices, &facets);
        let mut candidates = self.at_pinches(&facets, &edges, &pinched);
        let is_new = |f: &&Facet| {
            let across = delaunay.neighbours(f.tetrahedron)[usize::from(f.opposite)];
            [f.tetrahedron, across].iter().any(|t| tetrahedra.binary_search(t).is_ok())
        };
        candidates.par_extend(facets.par_iter().filter(is_new).filter_map(|f| self.at_stray(f)));
        candidates
    }

    /// Where the surface is not manifold at some vertices, of which all facets are given.
    fn pinches_at(&self, vertices: &[u32], facets: &[Facet]) -> Pinches {
        // those vertices come first, so that each edge at them is one from the smaller number to the larger
        let mut names = vertices.to_vec();
        let mut number: HashMap<u32, u32> = vertices.iter().copied().zip(0..).collect();
        let mut number_of = |v: u32| {
            *number.entry(v).or_insert_with(|| {
                names.push(v);
                names.len() as u32 - 1
            })
        };
        let triangles: Vec<[u32; 3]> = facets.iter().map(|f| f.vertices.map(&mut number_of)).collect();
        let incidence = Incidence::new(&triangles, names.len());
        Pinches::at_first(vertices.len(), &incidence, |a, b| self.may_be_open(names[a as usize], names[b as usize]))
    }
}

#[cfg(test)]
mod tests {
    use crate::refine::{RefineOptions, Refinement};
    use crate::restricted::Facet;
    use crate::scenes::{self, Scene};
    use crate::tests::surface_points;
    use isoparticles_field::topology::FieldTopology;

    #[test]
    fn pinches_at_vertices_are_those_of_the_whole_surface_there() {
        // so sparse that sheets touch
        let pinches = (0..12).map(|seed| compare(&scenes::random(seed), 1.8));
        let [edges, vertices] = pinches.fold([0, 0], |[a, b], [edges, vertices]| [a + edges, b + vertices]);
        assert!(edges > 0 && vertices > 0, "{edges} edges and {vertices} vertices: this shows nothing");
    }

    /// Compares the pinches of a scene found in parts with those of the whole surface; returns at how many edges and vertices there are any.
    fn compare(scene: &Scene, spacing: f64) -> [usize; 2] {
        let mut points = surface_points(scene, spacing);
        let topology = FieldTopology::new(&scene.field);
        let refinement = Refinement::new(&mut points, &scene.field, &topology, RefineOptions::default()).unwrap();
        let facets = refinement.facets();
        let all: Vec<u32> = (0..refinement.restricted.points().len() as u32).collect();
        let whole = refinement.defects(&facets);
        let triples = |facets: &[Facet], around: &[u32]| {
            let mut triples: Vec<[u32; 3]> = around.iter().map(|&f| facets[f as usize].vertices).collect();
            triples.sort_unstable();
            triples
        };
        let sorted = |mut lists: Vec<Vec<[u32; 3]>>| {
            lists.sort_unstable();
            lists
        };
        let edges = |facets: &[Facet], edges: &[Vec<u32>]| sorted(edges.iter().map(|e| triples(facets, e)).collect());
        let fans = |facets: &[Facet], vertices: &[(u32, Vec<u32>)]| {
            sorted(vertices.iter().map(|(_, around)| triples(facets, around)).collect())
        };
        let found = refinement.pinches_at(&all, &facets);
        assert_eq!(edges(&facets, &found.edges), edges(&facets, &whole.edges));
        assert_eq!(fans(&facets, &found.vertices), fans(&facets, &whole.vertices));
        // at some of the vertices, in any numbering: their own pinches and no other
        for vertices in all.chunks(7) {
            let is_at = |f: &Facet| f.vertices.iter().any(|v| vertices.binary_search(v).is_ok());
            let mut at: Vec<Facet> = vertices.iter().flat_map(|&v| refinement.restricted.facets_at(v)).collect();
            at.sort_unstable_by_key(|f| (f.tetrahedron, f.opposite));
            at.dedup();
            assert_eq!(at, facets.iter().copied().filter(is_at).collect::<Vec<_>>());
            let found = refinement.pinches_at(vertices, &at);
            let own = whole.vertices.iter().filter(|(v, _)| vertices.binary_search(v).is_ok());
            assert_eq!(fans(&at, &found.vertices), fans(&facets, &own.cloned().collect::<Vec<_>>()));
        }
        [whole.edges.len(), whole.vertices.len()]
    }
}
