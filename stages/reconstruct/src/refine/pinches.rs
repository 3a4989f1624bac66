//! Edges and vertices in which sheets touch and that points do not part: tetrahedra there change sides.

use super::Refinement;
use crate::defects::{Defects, edge_of};
use crate::restricted::Facet;

/// Rounds, each time that one followed up its own points counted, that points have to lower the number of places that are not manifold.
const ROUNDS: usize = 20;

/// Times that tetrahedra may change sides; in the second half of them they may only join the object, lest they go to and fro.
const PARTINGS: usize = 16;

/// Whether points still help where the surface is not manifold.
#[derive(Clone, Debug)]
pub(super) struct Patience {
    fewest: usize,
    rounds: usize,
    partings: usize,
}

impl Default for Patience {
    fn default() -> Self {
        Self { fewest: usize::MAX, rounds: 0, partings: 0 }
    }
}

impl Patience {
    /// Hears the defects after a round and how often it followed up its points; true when the places that are not manifold have long not
    /// become fewer.
    pub(super) fn is_over(&mut self, defects: &Defects, follow_ups: usize) -> bool {
        let places = defects.edges.len() + defects.vertices.len();
        if places == 0 {
            (self.fewest, self.rounds) = (usize::MAX, 0);
        } else if places < self.fewest {
            (self.fewest, self.rounds) = (places, 0);
        } else {
            self.rounds += 1 + follow_ups;
        }
        self.rounds > ROUNDS
    }
}

impl Refinement<'_> {
    /// Parts the sheets that touch in edges, or else in vertices; returns at how many.
    pub(super) fn part_pinches(&mut self, facets: &[Facet], defects: &Defects) -> usize {
        if defects.is_manifold() || self.patience.partings >= PARTINGS {
            return 0;
        }
        let may_leave = 2 * self.patience.partings < PARTINGS;
        let mut parted = 0;
        for around in &defects.edges {
            if let Some(edge) = edge_of(facets, around) {
                let start = facets[around[0] as usize].tetrahedron;
                parted += usize::from(self.restricted.part_edge(edge, start, may_leave));
            }
        }
        if parted == 0 {
            let vertices = defects.vertices.iter().map(|(v, _)| *v);
            parted = vertices.filter(|&v| self.restricted.part_vertex(v, may_leave)).count();
        }
        if parted > 0 {
            let partings = self.patience.partings + 1;
            self.patience = Patience { partings, ..Patience::default() };
            self.report.parted_pinches += parted;
            self.strays_are_known = false;
        }
        parted
    }
}
