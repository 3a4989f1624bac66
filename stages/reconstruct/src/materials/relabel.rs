//! Tetrahedra that change their material where points do not help: parts of a star, or runs round an edge, whose interfaces are nearer to each other than
//! points can tell.

use super::complex::{Complex, Violation};
use super::nodes::Nodes;
use super::refine::{Refinement, all_violations};
use crate::around::{parts_round, runs_round, star};
use crate::queue::Simplex;
use isoparticles_field::materials::MaterialId;

/// Most tetrahedra that change their material at a time.
const MOST: usize = 12;

/// Times that all violations are gone through.
const ROUNDS: usize = 4;

impl Refinement<'_> {
    /// Lets tetrahedra at violations of the topology change their material where that leaves fewer and takes no grid node along; returns how often.
    pub(super) fn relabel(&mut self, nodes: Option<&Nodes>) -> usize {
        let mut count = 0;
        for _ in 0..ROUNDS {
            let facets = self.complex.labelled.facets();
            let mut left: Vec<Violation> =
                all_violations(&self.complex, &facets).into_iter().filter(|v| v.reason.is_topology()).collect();
            left.sort_by_key(|v| (v.reason, v.simplex));
            let before = count;
            for violation in left {
                if self.complex.at_simplex(violation.simplex).is_some_and(|v| v.reason.is_topology()) {
                    count += usize::from(relabel_at(&mut self.complex, violation.simplex, nodes));
                }
            }
            if count == before {
                break;
            }
        }
        count
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
    let rate = |complex: &mut Complex, (set, id): &(Vec<u32>, MaterialId)| {
        let vertices: Vec<u32> = set.iter().flat_map(|&t| complex.labelled.delaunay().vertices(t)).collect();
        let mut region: Vec<u32> = vertices.iter().flat_map(|&v| star(complex.labelled.delaunay(), v)).collect();
        region.sort_unstable();
        region.dedup();
        let count =
            |complex: &Complex| complex.at_tetrahedra(&region).iter().filter(|v| v.reason.is_topology()).count();
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
