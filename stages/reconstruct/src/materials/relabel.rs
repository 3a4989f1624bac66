//! Changes the material of tetrahedra where inserted points do not help: parts of a star and runs
//! around an edge whose interfaces are closer together than points can resolve, and tetrahedra that
//! contain grid nodes of another material.

use super::complex::Complex;
use super::criteria::Violation;
use super::nodes::Nodes;
use super::refine::Refinement;
use super::topology::Simplices;
use crate::around::{parts_round, runs_round, star};
use crate::queue::{BETWEEN_STEPS, Simplex};
use isoparticles_field::materials::MaterialId;
use isoparticles_stage::error::Result;

/// Maximum number of tetrahedra that change their material together.
const MOST: usize = 12;

/// Maximum number of passes over all violations.
const ROUNDS: usize = 4;

impl Refinement<'_> {
    /// Changes the material of tetrahedra where the topology or a grid node is wrong, if this
    /// reduces the number of violations and moves no grid node out of its material. Returns the
    /// number of changes. `step` is called with the number of points.
    ///
    /// # Errors
    /// If `step` returns an error.
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
                    let sets = sets_at(&self.complex, simplex);
                    count += usize::from(relabel_one(&mut self.complex, sets, self.nodes));
                }
            }
            for tetrahedron in self.around_wrong_nodes() {
                let sets = sets_with(&self.complex, tetrahedron);
                count += usize::from(relabel_one(&mut self.complex, sets, self.nodes));
            }
            if count == before {
                break;
            }
        }
        Ok(count)
    }

    /// Returns the tetrahedra that contain the grid nodes in another material.
    fn around_wrong_nodes(&self) -> Vec<u32> {
        let Some(nodes) = self.nodes else { return Vec::new() };
        let around = |violation: &Violation| match violation.simplex {
            Simplex::Node(node) => self.complex.labelled.locate(nodes.place(node), violation.near),
            _ => None,
        };
        self.at_nodes().iter().filter_map(around).collect()
    }
}

/// A change of the material of some tetrahedra.
struct Change {
    tetrahedra: Vec<u32>,
    to: MaterialId,
}

impl Change {
    /// Applies the change, and returns the previous materials.
    fn make(&self, complex: &mut Complex) -> Vec<MaterialId> {
        let old = self.tetrahedra.iter().map(|&t| complex.material(t)).collect();
        self.tetrahedra.iter().for_each(|&t| complex.labelled.set(t, self.to));
        old
    }

    /// Returns the number of violations that the change removes; `None` if their number does not
    /// fall.
    fn gain(&self, complex: &mut Complex, nodes: Option<&Nodes>) -> Option<usize> {
        // only the simplices of these tetrahedra change
        let count = |complex: &Complex| {
            let wrong_nodes = nodes.map_or(0, |nodes| nodes.wrong_in(complex, &self.tetrahedra));
            complex.wrong(&Simplices::of(complex, &self.tetrahedra)).len() + wrong_nodes
        };
        let before = count(complex);
        let old = self.make(complex);
        let after = count(complex);
        self.tetrahedra.iter().zip(old).for_each(|(&t, id)| complex.labelled.set(t, id));
        (after < before).then(|| before - after)
    }
}

/// Applies the change to one of the given sets of tetrahedra that removes the most violations.
/// Returns false if no change reduces their number.
fn relabel_one(complex: &mut Complex, sets: Vec<Vec<u32>>, nodes: Option<&Nodes>) -> bool {
    let mut best: Option<(usize, Change)> = None;
    for tetrahedra in sets {
        let is_held = |&t: &u32| {
            complex.labelled.delaunay().is_ghost(t) || nodes.is_some_and(|nodes| nodes.holds_own(complex, t))
        };
        if tetrahedra.len() > MOST || tetrahedra.iter().any(is_held) {
            continue;
        }
        let own = complex.material(tetrahedra[0]);
        let around = tetrahedra.iter().flat_map(|&t| complex.labelled.delaunay().neighbours(t));
        let mut ids: Vec<MaterialId> = around.map(|n| complex.material(n)).filter(|&id| id != own).collect();
        ids.sort_unstable();
        ids.dedup();
        for to in ids {
            let change = Change { tetrahedra: tetrahedra.clone(), to };
            if let Some(gain) = change.gain(complex, nodes)
                && best.as_ref().is_none_or(|(most, _)| gain > *most)
            {
                best = Some((gain, change));
            }
        }
    }
    best.is_some_and(|(_, change)| !change.make(complex).is_empty())
}

/// Returns sets of tetrahedra of one material that contain the given one: the tetrahedron itself,
/// and its runs around edges and parts of stars.
fn sets_with(complex: &Complex, tetrahedron: u32) -> Vec<Vec<u32>> {
    let vertices = complex.labelled.delaunay().vertices(tetrahedron);
    let edges = (0..4).flat_map(|i| (0..i).map(move |j| [i, j])).map(|ends| ends.map(|k| vertices[k]));
    let around_edges = edges.flat_map(|edge| complex.runs_round(edge, tetrahedron));
    let around_vertices = vertices.into_iter().flat_map(|v| sets_at(complex, Simplex::Vertex(v)));
    let all = around_edges.chain(around_vertices).filter(|set| set.contains(&tetrahedron));
    std::iter::once(vec![tetrahedron]).chain(all).collect()
}

/// Returns the sets of tetrahedra at a simplex that may change their material together: the parts
/// of the star of a vertex, the runs and the single tetrahedra around an edge, or each of the two
/// tetrahedra at a facet.
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
