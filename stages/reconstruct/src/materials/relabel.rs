//! Tetrahedra that change their material where points do not help: parts of a star, or runs round an edge, whose interfaces are nearer to each other than
//! points can tell.

use super::complex::Complex;
use super::nodes::Nodes;
use super::refine::Refinement;
use super::topology::Simplices;
use crate::around::{parts_round, runs_round, star};
use crate::queue::{BETWEEN_STEPS, Simplex};
use isoparticles_field::materials::MaterialId;
use isoparticles_stage::error::Result;

/// Most tetrahedra that change their material at a time.
const MOST: usize = 12;

/// Times that all violations are gone through.
const ROUNDS: usize = 4;

impl Refinement<'_> {
    /// Lets tetrahedra where the topology is wrong change their material where that leaves fewer such places and takes no grid node along; returns how often. `step`
    /// hears the number of points and may stop it with an error.
    ///
    /// # Errors
    /// Those of `step`.
    pub(super) fn relabel(&mut self, mut step: impl FnMut(usize) -> Result<()>) -> Result<usize> {
        let mut count = 0;
        for _ in 0..ROUNDS {
            let facets = self.complex.labelled.facets();
            let mut left = self.complex.wrong(&Simplices::all(&self.complex, facets));
            left.sort_unstable();
            let before = count;
            for (n, (_, simplex)) in left.into_iter().enumerate() {
                if n % BETWEEN_STEPS == 0 {
                    step(self.complex.points().len())?;
                }
                if self.complex.is_wrong(simplex) {
                    count += usize::from(relabel_at(&mut self.complex, simplex, self.nodes));
                }
            }
            if count == before {
                break;
            }
        }
        Ok(count)
    }
}

/// Gives some tetrahedra at a simplex to a material beside them, if that leaves fewer violations of the topology at all vertices that they have; true when some
/// were.
fn relabel_at(complex: &mut Complex, simplex: Simplex, nodes: Option<&Nodes>) -> bool {
    let mut candidates: Vec<(Vec<u32>, MaterialId)> = Vec::new();
    for set in sets_at(complex, simplex) {
        let is_held = |&t: &u32| {
            complex.labelled.delaunay().is_ghost(t) || nodes.is_some_and(|nodes| nodes.holds_own(complex, t))
        };
        if set.len() > MOST || set.iter().any(is_held) {
            continue;
        }
        let own = complex.material(set[0]);
        let around = set.iter().flat_map(|&t| complex.labelled.delaunay().neighbours(t));
        let mut ids: Vec<MaterialId> = around.map(|n| complex.material(n)).filter(|&id| id != own).collect();
        ids.sort_unstable();
        ids.dedup();
        candidates.extend(ids.into_iter().map(|id| (set.clone(), id)));
    }
    // nothing changes but at the simplices of the set itself
    let rate = |complex: &mut Complex, (set, id): &(Vec<u32>, MaterialId)| {
        let count = |complex: &Complex| complex.wrong(&Simplices::of(complex, set)).len();
        let before = count(complex);
        let old: Vec<MaterialId> = set.iter().map(|&t| complex.material(t)).collect();
        set.iter().for_each(|&t| complex.labelled.set(t, *id));
        let after = count(complex);
        set.iter().zip(old).for_each(|(&t, id)| complex.labelled.set(t, id));
        (after < before).then(|| before - after)
    };
    let mut best: Option<(usize, usize)> = None;
    for (n, candidate) in candidates.iter().enumerate() {
        if let Some(gain) = rate(complex, candidate)
            && best.is_none_or(|(most, _)| gain > most)
        {
            best = Some((gain, n));
        }
    }
    let Some((_, n)) = best else { return false };
    let (set, id) = &candidates[n];
    set.iter().for_each(|&t| complex.labelled.set(t, *id));
    true
}

/// Sets of tetrahedra at a simplex that may change together: the runs round an edge, the parts of a star, the two of a facet.
fn sets_at(complex: &Complex, simplex: Simplex) -> Vec<Vec<u32>> {
    let delaunay = complex.labelled.delaunay();
    let side = |t: u32| complex.material(t);
    match simplex {
        Simplex::Vertex(v) => parts_round(delaunay, v, &star(delaunay, v), side),
        Simplex::Edge(edge) => match complex.at_edge(edge) {
            Some(start) => {
                let runs = runs_round(delaunay, edge, start, side);
                let single = runs.iter().flatten().map(|&t| vec![t]).collect::<Vec<_>>();
                runs.into_iter().chain(single).collect()
            }
            None => Vec::new(),
        },
        Simplex::Facet(vertices) => match complex.facet_on(vertices) {
            Some(facet) => vec![vec![facet.tetrahedron], vec![complex.labelled.across(&facet)]],
            None => Vec::new(),
        },
        Simplex::Node(_) | Simplex::Place(..) => Vec::new(),
    }
}
