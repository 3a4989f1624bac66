//! Tetrahedra that change their material where points do not help: parts of a star, or runs round an edge, whose interfaces are nearer to each other than
//! points can tell. Where a junction curve passes twice through a point, as its two ways there are as near, one of them goes past it.

use super::complex::Complex;
use super::criteria::Violation;
use super::nodes::Nodes;
use super::refine::Refinement;
use super::segments::{Bypass, Segment, segment};
use super::topology::Simplices;
use crate::around::{parts_round, runs_round, star};
use crate::queue::{BETWEEN_STEPS, Simplex};
use isoparticles_field::materials::{MaterialId, Stratum};
use isoparticles_stage::error::Result;

/// Most tetrahedra that change their material at a time.
const MOST: usize = 12;

/// Times that all violations are gone through.
const ROUNDS: usize = 4;

impl Refinement<'_> {
    /// Lets tetrahedra where the topology or a grid node is wrong change their material if that
    /// leaves fewer such places and moves no grid node into another material. Returns how often.
    /// `step` hears the number of points and may stop it with an error.
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

    /// Returns the tetrahedra around the grid nodes that lie in another material.
    fn around_wrong_nodes(&self) -> Vec<u32> {
        let Some(nodes) = self.nodes else { return Vec::new() };
        let around = |violation: &Violation| match violation.simplex {
            Simplex::Node(node) => self.complex.labelled.locate(nodes.place(node), violation.near),
            _ => None,
        };
        self.at_nodes().iter().filter_map(around).collect()
    }

    /// Has curves that pass more than once through a point where the topology is wrong go past it, where that leaves fewer violations; returns how often. It comes
    /// last: as long as points are added, segments are made to pass through points.
    pub(super) fn bypass(&mut self) -> usize {
        let facets = self.complex.labelled.facets();
        let mut left = self.complex.wrong(&Simplices::all(&self.complex, facets));
        left.sort_unstable();
        let vertices = left.into_iter().filter_map(|(_, simplex)| match simplex {
            Simplex::Vertex(v) => Some(v),
            _ => None,
        });
        vertices.filter(|&v| bypass_at(&mut self.complex, v, self.nodes)).count()
    }
}

/// Tetrahedra that may go to another material together.
struct Change {
    tetrahedra: Vec<u32>,
    to: MaterialId,
    /// The ends of a segment that takes the place of two by way of a point, and that point.
    bypass: Option<(Segment, u32)>,
}

impl Change {
    /// Makes it; returns what undoes it, or nothing where the segments do not allow it.
    fn make(&self, complex: &mut Complex) -> Option<(Vec<MaterialId>, Option<Bypass>)> {
        let bypass = match self.bypass {
            Some((pair, point)) => Some(complex.segments.bypass(pair, point, complex.labelled.points())?),
            None => None,
        };
        let old = self.tetrahedra.iter().map(|&t| complex.material(t)).collect();
        self.tetrahedra.iter().for_each(|&t| complex.labelled.set(t, self.to));
        Some((old, bypass))
    }

    /// Takes it back.
    fn undo(&self, complex: &mut Complex, (old, bypass): (Vec<MaterialId>, Option<Bypass>)) {
        self.tetrahedra.iter().zip(old).for_each(|(&t, id)| complex.labelled.set(t, id));
        if let Some(bypass) = bypass {
            complex.segments.undo(bypass, complex.labelled.points());
        }
    }

    /// Returns by how much it reduces the number of violations; `None` if it does not.
    fn gain(&self, complex: &mut Complex, nodes: Option<&Nodes>) -> Option<usize> {
        // nothing changes but at the simplices of the tetrahedra, and at the segments
        let mut around = self.tetrahedra.clone();
        if let Some((_, point)) = self.bypass {
            around.extend(star(complex.labelled.delaunay(), point));
        }
        let count = |complex: &Complex| {
            let wrong_nodes = nodes.map_or(0, |nodes| nodes.wrong_in(complex, &self.tetrahedra));
            complex.wrong(&Simplices::of(complex, &around)).len() + wrong_nodes
        };
        let before = count(complex);
        let old = self.make(complex)?;
        let after = count(complex);
        self.undo(complex, old);
        (after < before).then(|| before - after)
    }
}

/// Makes the change of one of some sets of tetrahedra that leaves the fewest violations. Returns
/// false if none leaves fewer than there are.
fn relabel_one(complex: &mut Complex, sets: Vec<Vec<u32>>, nodes: Option<&Nodes>) -> bool {
    let sets = sets.into_iter().map(|tetrahedra| (tetrahedra, None)).collect();
    best_of(complex, sets, nodes).is_some_and(|change| change.make(complex).is_some())
}

/// Has a curve that passes more than once through a point go past it, where that leaves fewer violations; true when it did.
fn bypass_at(complex: &mut Complex, point: u32, nodes: Option<&Nodes>) -> bool {
    let sets = bypasses(complex, point);
    best_of(complex, sets, nodes).is_some_and(|change| change.make(complex).is_some())
}

/// Tetrahedra, and the segment that goes past a point.
type Set = (Vec<u32>, Option<(Segment, u32)>);

/// The change of some sets that leaves the fewest violations, if one leaves fewer than there are.
fn best_of(complex: &mut Complex, sets: Vec<Set>, nodes: Option<&Nodes>) -> Option<Change> {
    let mut best: Option<(usize, Change)> = None;
    for (tetrahedra, bypass) in sets {
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
            let change = Change { tetrahedra: tetrahedra.clone(), to, bypass };
            if let Some(gain) = change.gain(complex, nodes)
                && best.as_ref().is_none_or(|(most, _)| gain > *most)
            {
                best = Some((gain, change));
            }
        }
    }
    best.map(|(_, change)| change)
}

/// Where a curve passes a point more than once: two of its segments there that one past the point can take the place of, with the tetrahedra of one material round both.
fn bypasses(complex: &Complex, point: u32) -> Vec<Set> {
    let ends: Vec<(u32, Stratum)> = complex
        .segments
        .at(point)
        .filter_map(|pair| Some((if pair[0] == point { pair[1] } else { pair[0] }, complex.segments.curve(pair)?)))
        .collect();
    let delaunay = complex.labelled.delaunay();
    let star = star(delaunay, point);
    let mut found = Vec::new();
    for (n, &(b, curve)) in ends.iter().enumerate() {
        if ends.iter().filter(|(_, other)| *other == curve).count() < 3 {
            continue;
        }
        for &(a, other) in &ends[..n] {
            let is_facet = star.iter().any(|&t| [a, b].iter().all(|v| delaunay.vertices(t).contains(v)));
            if other != curve || !is_facet {
                continue;
            }
            for &id in curve.materials() {
                let is_round =
                    |&&t: &&u32| complex.material(t) == id && [a, b].iter().any(|v| delaunay.vertices(t).contains(v));
                let set: Vec<u32> = star.iter().filter(is_round).copied().collect();
                if !set.is_empty() {
                    found.push((set, Some((segment(a, b), point))));
                }
            }
        }
    }
    found
}

/// Returns the sets of tetrahedra of one material that contain a given one: itself, and those around
/// one of its edges or vertices.
fn sets_with(complex: &Complex, tetrahedron: u32) -> Vec<Vec<u32>> {
    let vertices = complex.labelled.delaunay().vertices(tetrahedron);
    let edges = (0..4).flat_map(|i| (0..i).map(move |j| [i, j])).map(|ends| ends.map(|k| vertices[k]));
    let around_edges = edges.flat_map(|edge| complex.runs_round(edge, tetrahedron));
    let around_vertices = vertices.into_iter().flat_map(|v| sets_at(complex, Simplex::Vertex(v)));
    let all = around_edges.chain(around_vertices).filter(|set| set.contains(&tetrahedron));
    std::iter::once(vec![tetrahedron]).chain(all).collect()
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

#[cfg(test)]
mod tests {
    use super::super::complex::Complex;
    use super::super::prepare::{Prepared, Taken};
    use super::super::scenes::stratum;
    use super::super::segments::{Segments, segment};
    use super::bypass_at;
    use crate::queue::Simplex;
    use glam::DVec3;
    use isoparticles_delaunay::Delaunay;
    use isoparticles_field::materials::{Analytic, ball, half_space, maximum, minimum, negative};

    #[test]
    fn a_curve_that_passes_twice_through_a_point_passes_it_once_after() {
        // below a plane 1, above it 2 in two opposite quadrants, a hair apart, and 3 in the others: the curve of all three has two ways past the origin
        const HAIR: f64 = 0.01;
        let quadrant = |side: f64| {
            let plane = |axis: DVec3| half_space(axis * side * HAIR, axis * -side);
            maximum(plane(DVec3::X), plane(DVec3::Y))
        };
        let quadrants = || minimum(quadrant(1.0), quadrant(-1.0));
        let inside = || ball(DVec3::ZERO, 5.0);
        let above = || half_space(DVec3::ZERO, -DVec3::Z);
        let upper = |part| maximum(maximum(inside(), above()), part);
        let lower = maximum(inside(), half_space(DVec3::ZERO, DVec3::Z));
        let functions = vec![negative(inside()), lower, upper(quadrants()), upper(negative(quadrants()))];
        let indicators = Analytic::new(functions, 1.0);
        let at = DVec3::new;
        let on = |ids: &[u16], places: &[DVec3]| places.iter().map(|&p| (p, stratum(ids))).collect::<Vec<_>>();
        let axes = [at(1.0, 0.0, 0.0), at(0.0, 1.02, 0.0), at(-1.01, 0.0, 0.0), at(0.0, -1.03, 0.0)];
        let [same, other] = [[at(0.9, 0.91, 0.0), at(-0.9, -0.93, 0.0)], [at(-0.9, 0.94, 0.0), at(0.92, -0.9, 0.0)]];
        let mut vertices = on(&[1, 2, 3], &[DVec3::ZERO]);
        // a second layer keeps the ends of the triangulation away
        for scale in [1.0, 2.6] {
            vertices.extend(on(&[1, 2, 3], &axes.map(|p| scale * p)));
            vertices.extend(on(&[1, 2], &same.map(|p| scale * p)));
            if scale > 1.0 {
                vertices.extend(on(&[1, 3], &other.map(|p| scale * p)));
            }
            for height in [1.0, 2.2] {
                vertices.extend(on(&[2, 3], &axes.map(|p| 0.97 * scale * p + height * DVec3::Z)));
                let low = |p: DVec3| 0.95 * scale * p - height * DVec3::Z;
                vertices.extend(on(&[0, 1], &[same.map(low), other.map(low), [low(DVec3::ZERO); 2]].concat()));
            }
        }
        let points: Vec<DVec3> = vertices.iter().map(|(p, _)| *p).collect();
        let curve = stratum(&[1, 2, 3]);
        let ends = (1..5).flat_map(|end| [segment(0, end), segment(end, end + 24)]);
        let segments = Segments::new(ends.map(|pair| (pair, curve)), &points);
        let prepared = Prepared {
            delaunay: Delaunay::new(&points).expect("points in space"),
            sizes: vec![1.0; points.len()],
            strata: vertices.into_iter().map(|(_, own)| own).collect(),
            segments,
            report: Taken::default(),
        };
        let mut complex = Complex::new(prepared, &indicators, DVec3::splat(5.0), None);
        assert!(complex.is_wrong(Simplex::Vertex(0)), "2 in two parts");
        assert!(bypass_at(&mut complex, 0, None));
        assert!(!complex.is_wrong(Simplex::Vertex(0)));
        let at_point: Vec<_> = complex.segments.at(0).collect();
        assert!(at_point.len() == 2 && complex.segments.count() == 7, "{at_point:?}");
        // those of the second layer end the curve
        for (pair, _) in complex.segments.all().filter(|(pair, _)| pair[1] < 5) {
            assert!(!complex.is_wrong(Simplex::Edge(pair)), "{pair:?}");
        }
    }
}
