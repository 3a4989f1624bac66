//! Second looks: where mesh and marching cubes disagree, the spline itself is asked, on a finer sampling of the place.

use super::Refinement;
use super::pieces::LooksAtPieces;
use crate::defects::Defects;
use crate::isosurface::Isosurface;
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_mesh::components::NO_COMPONENT;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;

/// Looks, ever finer, at the places where the mesh joins two components or parts one.
pub(super) const LOOKS: usize = 5;

/// The first of them are taken at once, before any points: they cost little, and points on a neck would be in vain. Points come between one
/// of the others and the next.
const LOOKS_AT_ONCE: usize = 3;

/// Which places of the isosurface were looked at again, and how closely, so that no look is taken twice.
#[derive(Clone, Debug)]
pub(super) struct Looks {
    pairs: HashMap<(u32, u32), usize>,
    missing: HashSet<u32>,
    pub(super) at_pieces: LooksAtPieces,
    /// Pairs whose turn it was in this comparison.
    now: HashSet<(u32, u32)>,
    /// Whether points can still be added; else all looks that are left are taken at once.
    pub(super) points_help: bool,
}

impl Default for Looks {
    fn default() -> Self {
        let (pairs, missing, at_pieces, now) = Default::default();
        Self { pairs, missing, at_pieces, now, points_help: true }
    }
}

impl Looks {
    /// To be called at the start of each comparison.
    pub(super) fn begin(&mut self) {
        self.now.clear();
        self.at_pieces.begin();
    }
}

impl Refinement<'_> {
    /// Where mesh and marching cubes disagree, asks the spline itself. True when more is known of the isosurface now.
    pub(super) fn look_again(&mut self, facets: &[Facet], defects: &Defects) -> bool {
        let mut learnt = false;
        // another surface may have lost a piece
        for &(class, pieces) in defects.rejoined.iter().filter(|_| self.is_by_sign) {
            self.isosurface.set_pieces(class, pieces);
            learnt = true;
        }
        learnt |= self.look_at_missing(defects);
        let doubtful = self.look_at_bridges(facets, defects, &mut learnt);
        learnt |= self.is_by_sign && self.trust_joins(facets, defects, doubtful);
        learnt |= self.look_at_pieces(defects);
        learnt |= self.trust_critical_points(facets, defects);
        if learnt {
            for c in self.component_of.iter_mut().filter(|c| **c != NO_COMPONENT) {
                *c = self.isosurface.class_of(*c);
            }
        }
        learnt
    }

    /// Whether classes without facets are joined to others by necks that marching cubes does not see. True when some are.
    fn look_at_missing(&mut self, defects: &Defects) -> bool {
        let field = self.restricted.field();
        let new: Vec<u32> = defects.missing.iter().copied().filter(|&class| self.looks.missing.insert(class)).collect();
        let joined: Vec<Vec<u32>> = new.par_iter().map(|&class| self.isosurface.joined_to(field, class)).collect();
        for (&class, others) in new.iter().zip(&joined) {
            others.iter().for_each(|&other| self.isosurface.merge(class, other));
        }
        joined.iter().any(|others| !others.is_empty())
    }

    /// Whether classes that the mesh joins are one, by their shortest common edges. Returns the pairs that were looked at often enough.
    fn look_at_bridges(&mut self, facets: &[Facet], defects: &Defects, learnt: &mut bool) -> Vec<(u32, u32)> {
        let points = self.restricted.points();
        let mut shortest: BTreeMap<(u32, u32), (f64, [DVec3; 2])> = BTreeMap::new();
        for facet in defects.bridges.iter().map(|&f| &facets[f as usize]) {
            for (pair, ends) in self.pairs_of(facet) {
                let ends = ends.map(|v| points[v as usize]);
                let length = ends[0].distance(ends[1]);
                let known = shortest.entry(pair).or_insert((length, ends));
                if length < known.0 {
                    *known = (length, ends);
                }
            }
        }
        let (mut looks, mut doubtful) = (Vec::new(), Vec::new());
        for (pair, (_, ends)) in shortest.into_iter().filter(|(pair, _)| self.looks.now.insert(*pair)) {
            let looked = self.looks.pairs.entry(pair).or_default();
            if *looked < LOOKS {
                let first = *looked;
                *looked = if self.looks.points_help { (first + 1).max(LOOKS_AT_ONCE) } else { LOOKS };
                looks.push((pair, ends, first..*looked));
            } else {
                doubtful.push(pair);
            }
        }
        let field = self.restricted.field();
        let are_joined = |ends, looks: Range<usize>| looks.clone().any(|look| Isosurface::joins(field, ends, look));
        let joined: Vec<bool> = looks.par_iter().map(|(_, ends, looks)| are_joined(*ends, looks.clone())).collect();
        for ((pair, ..), joined) in looks.into_iter().zip(joined) {
            if joined {
                self.isosurface.merge(pair.0, pair.1);
                *learnt = true;
            } else if !self.looks.points_help {
                // that was the last one
                doubtful.push(pair);
            }
        }
        doubtful
    }

    /// The different classes that the edges of a facet join, the smaller first, and the ends of those edges.
    fn pairs_of(&self, facet: &Facet) -> impl Iterator<Item = ((u32, u32), [u32; 2])> {
        let classes = facet.vertices.map(|v| self.isosurface.class_of(self.component_of[v as usize]));
        let edges = [0, 1, 2].map(|k| {
            let (i, j) = if classes[k] < classes[(k + 1) % 3] { (k, (k + 1) % 3) } else { ((k + 1) % 3, k) };
            ((classes[i], classes[j]), [facet.vertices[i], facet.vertices[j]])
        });
        edges.into_iter().filter(|((a, b), _)| a != b && *b != NO_COMPONENT)
    }
}
