//! A surface found by other means than the sign of F at the circumcentres (Tight Cocone's), beside the one by that sign: where the
//! two differ for want of points, points are added.

use super::{Place, Refinement};
use crate::around::{boundary_facets_of, star};
use crate::defects::Defects;
use crate::object::Object;
use crate::queue::{Reason, Simplex};
use crate::restricted::{Facet, Restricted};
use glam::DVec3;
use isoparticles_delaunay::INFINITE;
use isoparticles_field::topology::CriticalPoint;
use isoparticles_mesh::components::DisjointSets;
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

/// A tetrahedron is missed where its middle lies farther from F = 0 than this part of h, and of a voxel: a thin sheet or a finger that
/// is left out, while the flat tetrahedra in which good surfaces differ lie within h^2 / 8 R of it.
const DEEP: f64 = 0.5;

/// Slopes of F, mm per mm, below this are taken for this when distances are reckoned from F.
const FLATTEST: f64 = 0.3;

impl Refinement<'_> {
    /// Takes over a surface that was found by other means, and compares it with F; returns its defects.
    pub fn compare_other(&mut self, facets: &[Facet]) -> Defects {
        let has_sides = !self.options.open_border;
        if has_sides {
            let sides = self.object.restricted.sides_of(facets);
            self.object.restricted.set_sides(sides);
        }
        let defects = self.object.defects(facets);
        let critical = if has_sides { self.wrong_sided().len() } else { 0 };
        self.tell(&defects, critical);
        self.report.parted_pinches = 0;
        defects
    }

    /// Adds points where a closed surface that was found by other means differs from that by the sign of F in topology, joins
    /// components, has critical points of F on the wrong side, or lies far from F = 0: on the facets by sign that it lacks; where there are none, at grid nodes
    /// that it has on the wrong side. Returns how many.
    ///
    /// # Errors
    /// Those of `step` and of the triangulation.
    pub fn insert_for_other(&mut self, facets: &[Facet], mut step: impl FnMut(usize) -> Result<()>) -> Result<usize> {
        let sides = self.object.restricted.sides_of(facets);
        let wrong = self.wrong_by(&sides);
        let object = &self.object;
        let wanting = |part: &Vec<u32>| {
            let own =
                part.iter().flat_map(|&t| boundary_facets_of(object.restricted.delaunay(), t, |t| sides[t as usize]));
            // the dearest test comes last
            part.iter().any(|t| wrong.contains(t) || is_deep(object, *t))
                || own.into_iter().any(|f| object.is_bridge(&f))
                || euler_change(&object.restricted, part, &sides) != 0
        };
        let parts: Vec<Vec<u32>> =
            differing_parts(&object.restricted, &sides).into_par_iter().filter(wanting).collect();
        let lacking: Vec<Facet> = parts
            .iter()
            .flatten()
            .flat_map(|&t| boundary_facets_of(object.restricted.delaunay(), t, |t| object.restricted.is_inside(t)))
            .filter(|f| sides[f.tetrahedron as usize] == sides[object.restricted.across(f) as usize])
            .collect();
        let lacking = object.without_border_closure(lacking);
        let place = |facet: &Facet| {
            let ball = object.by_ball(Reason::OtherLabels, Simplex::Facet(facet.vertices), facet)?;
            Some(Place { point: ball.remedy, radius: ball.radius, size: ball.size })
        };
        let balls: Vec<Place> = lacking.par_iter().filter_map(place).collect();
        let mended = self.mend_all(self.places(Reason::OtherLabels, &balls), &mut step)?;
        if mended > 0 {
            return Ok(mended);
        }
        let found = self.at_nodes(&self.object.without_border_closure(facets.to_vec()));
        self.mend_all(found, &mut step)
    }

    /// The tetrahedra that hold critical points of F which other `sides` have wrong and the sign of F has right.
    fn wrong_by(&self, sides: &[bool]) -> HashSet<u32> {
        let restricted = &self.object.restricted;
        let wrong = |c: &CriticalPoint| {
            let t = restricted.locate(c.position, self.near(c.position))?;
            let is_inside = c.value < 0.0;
            (restricted.is_inside(t) == is_inside && sides[t as usize] != is_inside).then_some(t)
        };
        self.critical_points().filter_map(wrong).collect()
    }
}

/// Whether the middle of a tetrahedron lies far from F = 0.
fn is_deep(object: &Object, t: u32) -> bool {
    let vertices = object.restricted.delaunay().vertices(t);
    if vertices.contains(&INFINITE) {
        return false;
    }
    let middle = vertices.map(|v| object.points()[v as usize]).into_iter().sum::<DVec3>() / 4.0;
    let size = vertices.map(|v| object.sizes[v as usize]).into_iter().sum::<f64>() / 4.0;
    let field = object.restricted.field();
    let (value, gradient) = field.value_gradient(middle);
    let limit = DEEP * size.max(field.geometry().mean_spacing());
    // near critical points |F| over its slope has no bound
    value.abs() > limit * gradient.length().max(FLATTEST)
}

/// By how much the Euler characteristic of the surface changes when the tetrahedra of a part take their other sides.
fn euler_change(restricted: &Restricted, part: &[u32], sides: &[bool]) -> i64 {
    let delaunay = restricted.delaunay();
    let own: HashSet<Face> = part.iter().flat_map(|&t| simplices(&delaunay.vertices(t))).collect();
    let vertices: BTreeSet<u32> = part.iter().flat_map(|&t| delaunay.vertices(t)).filter(|&v| v != INFINITE).collect();
    let around: BTreeSet<u32> = vertices.into_iter().flat_map(|v| star(delaunay, v)).collect();
    let euler = |is_inside: &dyn Fn(u32) -> bool| {
        let mut surface: HashSet<Face> = HashSet::new();
        for &t in &around {
            let facets = boundary_facets_of(delaunay, t, is_inside);
            surface.extend(facets.iter().flat_map(|f| simplices(&f.vertices)).filter(|s| own.contains(s)));
        }
        surface.iter().map(|s| if is_edge(s) { -1 } else { 1 }).sum::<i64>()
    };
    euler(&|t| sides[t as usize]) - euler(&|t| restricted.is_inside(t))
}

/// A vertex, edge or triangle: its vertices ascending, [`INFINITE`] in the places that are left.
type Face = [u32; 3];

fn is_edge(simplex: &Face) -> bool {
    simplex[1] != INFINITE && simplex[2] == INFINITE
}

/// The finite vertices, edges and triangles of a triangle or tetrahedron.
fn simplices(vertices: &[u32]) -> impl Iterator<Item = Face> + use<> {
    let mut finite: Vec<u32> = vertices.iter().copied().filter(|&v| v != INFINITE).collect();
    finite.sort_unstable();
    (1u32..1 << finite.len()).filter(|chosen| chosen.count_ones() <= 3).map(move |chosen| {
        let mut simplex = [INFINITE; 3];
        let members = (0..finite.len()).filter(|k| chosen >> k & 1 == 1);
        members.zip(&mut simplex).for_each(|(k, place)| *place = finite[k]);
        simplex
    })
}

/// The tetrahedra whose side differs from that by the sign of F, by parts that share no vertex.
fn differing_parts(restricted: &Restricted, sides: &[bool]) -> Vec<Vec<u32>> {
    let delaunay = restricted.delaunay();
    let differing: Vec<u32> = (0..sides.len() as u32)
        .filter(|&t| delaunay.is_alive(t) && sides[t as usize] != restricted.is_inside(t))
        .collect();
    let mut sets = DisjointSets::new(differing.len());
    let mut first: HashMap<u32, u32> = HashMap::new();
    for (k, &t) in (0..).zip(&differing) {
        for v in delaunay.vertices(t) {
            sets.join(k, *first.entry(v).or_insert(k));
        }
    }
    let mut parts: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (k, &t) in (0..).zip(&differing) {
        parts.entry(sets.find(k)).or_default().push(t);
    }
    parts.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refine::RefineOptions;
    use crate::scenes::{self, Scene};
    use crate::tests::surface_points;
    use isoparticles_field::topology::FieldTopology;

    fn refined<'a>(scene: &'a Scene, topology: &'a FieldTopology, spacing: f64) -> Refinement<'a> {
        let mut points = surface_points(scene, spacing);
        let mut new = Refinement::new(&mut points, &scene.field, topology, RefineOptions::default()).unwrap();
        new.run(|_| Ok(())).unwrap();
        new
    }

    #[test]
    fn a_lost_sheet_gets_points() {
        for (scene, spacing) in [(scenes::two_balls(), 1.4), (scenes::shell(), 1.4)] {
            let topology = FieldTopology::new(&scene.field);
            let mut refinement = refined(&scene, &topology, spacing);
            let facets = refinement.object.facets();
            assert_eq!(refinement.insert_for_other(&facets, |_| Ok(())).unwrap(), 0, "nothing differs");
            let points = refinement.object.restricted.points();
            let by_place = |f: &&Facet| {
                let p = points[f.vertices[0] as usize];
                // one of the balls, or the outer sheet of the shell
                if scene.image.geometry.size[1] == 24 { p.x < 15.6 } else { p.distance(scenes::CENTRE) > 9.25 }
            };
            let (other, lost): (Vec<Facet>, Vec<Facet>) = facets.iter().partition(by_place);
            let parts = differing_parts(&refinement.object.restricted, &refinement.object.restricted.sides_of(&other));
            let changes: Vec<i64> = parts
                .iter()
                .map(|part| {
                    euler_change(&refinement.object.restricted, part, &refinement.object.restricted.sides_of(&other))
                })
                .collect();
            assert_eq!(changes, [-2], "one sheet less");
            let inserted = refinement.insert_for_other(&other, |_| Ok(())).unwrap();
            // a point a facet, less those too near to others
            assert!(inserted > lost.len() / 4 && inserted <= lost.len(), "{inserted} of {}", lost.len());
        }
    }

    #[test]
    fn a_flat_tetrahedron_on_the_other_side_is_the_same_surface() {
        let scene = scenes::torus();
        let topology = FieldTopology::new(&scene.field);
        let refinement = refined(&scene, &topology, 1.4);
        let sides = refinement.object.restricted.sides_of(&refinement.object.facets());
        let mut turned = 0;
        for t in (0..sides.len() as u32)
            .filter(|&t| refinement.object.restricted.delaunay().is_alive(t) && !sides[t as usize])
        {
            let own = boundary_facets_of(refinement.object.restricted.delaunay(), t, |t| sides[t as usize]);
            if own.len() == 2 {
                let mut other = sides.clone();
                other[t as usize] ^= true;
                // two facets give way to the two on the other side of the tetrahedron: an edge is turned
                assert_eq!(euler_change(&refinement.object.restricted, &[t], &other), 0);
                assert!(!is_deep(&refinement.object, t));
                turned += 1;
            }
        }
        assert!(turned > 0, "no tetrahedron has two facets on the surface");
    }

    #[test]
    fn simplices_of_a_tetrahedron_and_of_a_ghost_are_counted() {
        let count = |vertices: &[u32]| {
            let all: HashSet<Face> = simplices(vertices).collect();
            let edges = all.iter().filter(|s| is_edge(s)).count();
            (all.len(), edges)
        };
        assert_eq!(count(&[7, 3, 9, 1]), (14, 6));
        assert_eq!(count(&[7, INFINITE, 9, 1]), (7, 3));
        assert_eq!(count(&[4, 2, 8]), (7, 3));
    }
}
