//! Classes of the isosurface whose facets fall apart: points in the gaps, then closer looks at them.

use super::Refinement;
use super::insert::{Candidate, Reason};
use super::looks::LOOKS;
use crate::defects::Defects;
use crate::isosurface::{Isosurface, bounds};
use glam::DVec3;
use isoparticles_mesh::components::NO_COMPONENT;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{HashMap, HashSet};
use std::ops::Range;

/// Rounds that points in the gaps of a class in pieces have, before a closer look at the gap decides.
const PATIENCE: usize = 5;

/// The vertices of a piece are asked for the nearest vertex of another by leaps of so many, then all the others: the first few tell nearly how
/// near that is, and the rest need not look farther.
const LEAP: usize = 64;

/// Which pieces were looked at, and how closely, so that no look is taken twice.
#[derive(Clone, Debug, Default)]
pub(super) struct LooksAtPieces {
    /// Class, first vertex, number of vertices, look.
    taken: HashSet<(u32, u32, usize, usize)>,
    /// Class, first vertex and number of vertices of pieces that a look showed to be separate.
    separate: HashSet<(u32, u32, usize)>,
    rounds: HashMap<u32, usize>,
    /// Classes whose turn it was in this comparison.
    now: HashSet<u32>,
}

impl LooksAtPieces {
    /// To be called at the start of each comparison.
    pub(super) fn begin(&mut self) {
        self.now.clear();
    }

    /// How closely to look at the pieces of a class; nowhere while points come first, or where that was done in this comparison. All looks that
    /// are left where points are of no more use.
    fn turn_of(&mut self, class: u32, points_help: bool) -> Range<usize> {
        if !self.now.insert(class) {
            return 0..0;
        }
        let rounds = self.rounds.entry(class).or_default();
        let first = rounds.saturating_sub(PATIENCE - 1).min(LOOKS - 1);
        *rounds += 1;
        match points_help {
            true if *rounds < PATIENCE => 0..0,
            true => first..first + 1,
            false => {
                *rounds = PATIENCE + LOOKS;
                first..LOOKS
            }
        }
    }
}

/// The pieces of a class that fell apart.
pub(super) struct Pieces {
    class: u32,
    /// Vertices of each, the largest piece first.
    vertices: Vec<Vec<u32>>,
    /// Which of them a component of the facets is.
    rank: HashMap<u32, usize>,
}

impl Pieces {
    /// The class of the isosurface.
    pub(super) fn class(&self) -> u32 {
        self.class
    }

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
    /// The pieces of all classes that fell apart.
    pub(super) fn pieces(&self, defects: &Defects) -> Vec<Pieces> {
        let fell_apart: HashSet<u32> = defects.in_pieces.iter().map(|(class, _)| *class).collect();
        if fell_apart.is_empty() {
            return Vec::new();
        }
        let mut group_of: HashMap<(u32, u32), usize> = HashMap::new();
        let mut groups: Vec<((u32, u32), Vec<u32>)> = Vec::new();
        for (v, (&class, &piece)) in (0..).zip(self.component_of.iter().zip(&defects.piece_of_vertex)) {
            if piece != NO_COMPONENT && fell_apart.contains(&class) {
                let group = *group_of.entry((class, piece)).or_insert_with(|| {
                    groups.push(((class, piece), Vec::new()));
                    groups.len() - 1
                });
                groups[group].1.push(v);
            }
        }
        groups.sort_unstable_by_key(|((class, piece), vertices)| (*class, Reverse(vertices.len()), *piece));
        let by_class = groups.chunk_by(|a, b| a.0.0 == b.0.0).map(|pieces| Pieces {
            class: pieces[0].0.0,
            rank: pieces.iter().enumerate().map(|(k, ((_, piece), _))| (*piece, k)).collect(),
            vertices: pieces.iter().map(|(_, vertices)| vertices.clone()).collect(),
        });
        by_class.collect()
    }

    /// The vertices, one of piece `k` and one of a larger piece, that are nearest to each other.
    pub(super) fn gap(&self, pieces: &Pieces, k: usize, defects: &Defects) -> Option<[u32; 2]> {
        let own = &pieces.vertices[k];
        let is_larger = |v: u32| self.is_of_larger(pieces, k, defects, v);
        let mut best: Option<([u32; 2], f64)> = None;
        for &v in (0..LEAP).flat_map(|start| own[start.min(own.len())..].iter().step_by(LEAP)) {
            let radius = best.map_or(f64::INFINITY, |(_, distance)| distance);
            let nearest = self.nearest.accepted(self.restricted.points()[v as usize], radius, is_larger);
            best = nearest.map(|(w, distance)| ([v, w], distance)).or(best);
        }
        best.map(|(ends, _)| ends)
    }

    fn is_of_larger(&self, pieces: &Pieces, k: usize, defects: &Defects, v: u32) -> bool {
        let rank = || pieces.rank.get(&defects.piece_of_vertex[v as usize]);
        self.component_of[v as usize] == pieces.class && rank().is_some_and(|&rank| rank < k)
    }

    /// Points in the gaps of classes that fell apart: between each smaller piece and the nearest vertex of the larger ones.
    pub(super) fn in_gaps(&self, defects: &Defects) -> Vec<Candidate> {
        let pieces = self.pieces(defects);
        let gaps = pieces.par_iter().flat_map(|p| (1..p.vertices.len()).into_par_iter().map(move |k| (p, k)));
        let between = gaps.filter_map(|(pieces, k)| {
            let [v, w] = self.gap(pieces, k, defects)?;
            let [p, q] = [v, w].map(|v| self.restricted.points()[v as usize]);
            let point = self.on_surface(p.midpoint(q), 2.0)?;
            let radius = point.distance(p).min(point.distance(q));
            Some(Candidate { reason: Reason::Genus, point, radius, size: p.distance(q), near: v })
        });
        between.collect()
    }

    /// Whether the smaller pieces of classes that fell apart are components of their own after all: the first look takes in the whole piece,
    /// each further one a smaller box where it is nearest to the larger ones. True when some are.
    pub(super) fn look_at_pieces(&mut self, defects: &Defects) -> bool {
        let pieces = self.pieces(defects);
        let mut looks = Vec::new();
        for pieces in &pieces {
            let turn = self.looks.at_pieces.turn_of(pieces.class, self.looks.points_help);
            for (k, vertices) in pieces.vertices.iter().enumerate().skip(1) {
                let piece = |look: &usize| (pieces.class, vertices[0], vertices.len(), *look);
                let new: Vec<usize> =
                    turn.clone().filter(|look| self.looks.at_pieces.taken.insert(piece(look))).collect();
                looks.push((pieces, k, new));
            }
        }
        let is_separate = |(pieces, k, looks): &&(&Pieces, usize, Vec<usize>)| {
            looks.iter().any(|&look| self.is_separate(pieces, *k, look, defects))
        };
        let name = |pieces: &Pieces, k: usize| (pieces.class, pieces.vertices[k][0], pieces.vertices[k].len());
        let separate: Vec<_> = looks.par_iter().filter(is_separate).map(|(pieces, k, _)| name(pieces, *k)).collect();
        self.looks.at_pieces.separate.extend(separate);
        let mut learnt = false;
        for pieces in &pieces {
            // a piece that several looks show counts once
            let is_known = |k: &usize| self.looks.at_pieces.separate.contains(&name(pieces, *k));
            let count = 1 + (1..pieces.vertices.len()).filter(is_known).count();
            if count > self.isosurface.pieces(pieces.class) {
                self.isosurface.set_pieces(pieces.class, count);
                learnt = true;
            }
        }
        learnt
    }

    fn is_separate(&self, pieces: &Pieces, k: usize, look: usize, defects: &Defects) -> bool {
        let (field, points) = (self.restricted.field(), self.restricted.points());
        let own = pieces.vertices[k].iter().map(|&v| points[v as usize]);
        let gap = || self.gap(pieces, k, defects).map(|ends| ends.map(|v| points[v as usize]));
        let Some((low, high)) =
            (if look == 0 { bounds(&own.clone().collect::<Vec<_>>()) } else { gap().and_then(|ends| bounds(&ends)) })
        else {
            return false;
        };
        let margin = Isosurface::margin(field, look);
        let (from, to) = (low - margin, high + margin);
        let own: Vec<DVec3> = own.filter(|p| p.cmpge(from).all() && p.cmple(to).all()).collect();
        let mut others = Vec::new();
        self.nearest.each_in_box(from, to, |v, p| {
            if self.is_of_larger(pieces, k, defects, v) {
                others.push(p);
            }
        });
        Isosurface::is_separate(field, (low, high), &own, &others, look)
    }
}
