//! Second looks: where mesh and marching cubes disagree, the spline itself is asked, on a finer sampling of the place.

use super::Refinement;
use crate::defects::Defects;
use crate::restricted::Facet;
use glam::DVec3;
use isoparticles_common::components::NO_COMPONENT;
use std::collections::{BTreeMap, HashMap, HashSet};

/// Looks, ever finer, at the places where the mesh joins two components or parts one.
const LOOKS_AT_A_PAIR: usize = 5;

/// Rounds that points in the gaps of a class in pieces have, before a closer look at the gap decides.
const PATIENCE_IN_PIECES: usize = 5;

/// Which places of the isosurface were looked at again, and how closely, so that no look is taken twice.
#[derive(Clone, Debug, Default)]
pub(super) struct Looks {
    pairs: HashMap<(u32, u32), usize>,
    missing: HashSet<u32>,
    /// Class, bits of the first vertex, number of vertices, look.
    pieces: HashSet<(u32, [u64; 3], usize, usize)>,
    rounds_in_pieces: HashMap<u32, usize>,
}

impl Refinement<'_> {
    /// Where mesh and marching cubes disagree, asks the spline itself. True when more is known of the isosurface now.
    pub(super) fn look_again(&mut self, facets: &[Facet], defects: &Defects) -> bool {
        let field = self.restricted.field();
        let mut learnt = false;
        // another surface may have lost a piece
        for &(class, pieces) in defects.rejoined.iter().filter(|_| self.is_by_sign) {
            self.isosurface.set_pieces(class, pieces);
            learnt = true;
        }
        for &class in &defects.missing {
            learnt |= self.looks.missing.insert(class) && self.isosurface.merge_if_part_of_others(field, class);
        }
        let points = self.restricted.points();
        let mut pairs: BTreeMap<(u32, u32), (f64, [DVec3; 2])> = BTreeMap::new();
        for facet in defects.bridges.iter().map(|&f| &facets[f as usize]) {
            for (k, &v) in facet.vertices.iter().enumerate() {
                let w = facet.vertices[(k + 1) % 3];
                let ends = [points[v as usize], points[w as usize]];
                let classes = [v, w].map(|u| self.isosurface.class_of(self.component_of[u as usize]));
                let length = ends[0].distance(ends[1]);
                if classes[0] < classes[1] && classes[1] != NO_COMPONENT {
                    let shortest = pairs.entry((classes[0], classes[1])).or_insert((length, ends));
                    if length < shortest.0 {
                        *shortest = (length, ends);
                    }
                }
            }
        }
        let mut doubtful = Vec::new();
        for (pair, (_, ends)) in pairs {
            let looked = self.looks.pairs.entry(pair).or_default();
            if *looked < LOOKS_AT_A_PAIR {
                learnt |= self.isosurface.merge_if_joined(field, ends, [pair.0, pair.1], *looked);
                *looked += 1;
            } else {
                doubtful.push(pair);
            }
        }
        learnt |= self.is_by_sign && self.trust_joins(facets, defects, doubtful);
        for &(class, _) in &defects.in_pieces {
            learnt |= self.look_at_pieces(class, defects);
        }
        learnt |= self.trust_critical_points(facets, defects);
        if learnt {
            for c in self.component_of.iter_mut().filter(|c| **c != NO_COMPONENT) {
                *c = self.isosurface.class_of(*c);
            }
        }
        learnt
    }

    /// The vertices of each piece of a class that fell apart, the largest piece first.
    pub(super) fn pieces(&self, class: u32, defects: &Defects) -> Vec<Vec<DVec3>> {
        let points = self.restricted.points();
        let mut pieces: BTreeMap<u32, Vec<DVec3>> = BTreeMap::new();
        for (v, &piece) in defects.piece_of_vertex.iter().enumerate() {
            if piece != NO_COMPONENT && self.component_of[v] == class {
                pieces.entry(piece).or_default().push(points[v]);
            }
        }
        let mut pieces: Vec<Vec<DVec3>> = pieces.into_values().collect();
        pieces.sort_by_key(|p| std::cmp::Reverse(p.len()));
        pieces
    }

    /// Whether the smaller pieces of a class that fell apart are components of their own after all.
    fn look_at_pieces(&mut self, class: u32, defects: &Defects) -> bool {
        let pieces = self.pieces(class, defects);
        // points in the gap come first; a closer look only where they do not close it
        let rounds = self.looks.rounds_in_pieces.entry(class).or_default();
        *rounds += 1;
        let Some(look) = rounds.checked_sub(PATIENCE_IN_PIECES) else { return false };
        let look = look.min(LOOKS_AT_A_PAIR - 1);
        let mut learnt = false;
        for k in (1..pieces.len()).rev() {
            let first = pieces[k][0].to_array().map(f64::to_bits);
            if self.looks.pieces.insert((class, first, pieces[k].len(), look)) {
                let others = pieces[..k].concat();
                learnt |= self.isosurface.part_if_separate(self.restricted.field(), class, &pieces[k], &others, look);
            }
        }
        learnt
    }
}
