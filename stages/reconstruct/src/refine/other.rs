//! Compares the surface of Tight Cocone, or of any labels other than the sign of F at the
//! circumcentres, with the restricted surface of the same triangulation. Points are added where the
//! two differ because the sampling is too sparse.

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

/// A tetrahedron with another label is deep if its centroid is farther from F = 0 than this
/// fraction of h and of a voxel. Deep tetrahedra indicate a missing thin layer or finger. The flat
/// tetrahedra in which correct surfaces differ lie within h^2 / 8 R of F = 0.
const DEEP: f64 = 0.5;

/// Minimum slope of F, in mm per mm, in estimates of the distance from F = 0. Smaller slopes are
/// replaced by it.
const FLATTEST: f64 = 0.3;

impl Refinement<'_> {
    /// Compares another surface with F, updates the report and returns the defects of the surface.
    /// With a closed border, its labels replace the current ones.
    pub fn compare_other(&mut self, facets: &[Facet]) -> Defects {
        let has_sides = !self.options.open_border;
        if has_sides {
            let sides = self.object.restricted.sides_of(facets);
            self.object.restricted.set_sides(sides);
        }
        let defects = self.object.defects(facets);
        let critical = if has_sides { self.wrong_sided().len() } else { 0 };
        self.tell(&defects, critical);
        self.report.relabelled = 0;
        defects
    }

    /// Adds points where a closed surface from other labels differs from the restricted surface.
    /// The difference is one of topology, a facet that joins components, a critical point of F on
    /// the wrong side, or a tetrahedron far from F = 0. The points are on restricted facets that
    /// the other surface lacks. If none is inserted, points are added for grid nodes on its wrong
    /// side. Returns the number of points.
    ///
    /// # Errors
    /// If `step` returns an error, or if the triangulation cannot insert a point.
    pub fn insert_for_other(&mut self, facets: &[Facet], mut step: impl FnMut(usize) -> Result<()>) -> Result<usize> {
        let sides = self.object.restricted.sides_of(facets);
        let wrong = self.wrong_by(&sides);
        let object = &self.object;
        let wanting = |part: &Vec<u32>| {
            let own =
                part.iter().flat_map(|&t| boundary_facets_of(object.restricted.delaunay(), t, |t| sides[t as usize]));
            // the most expensive test is last
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

    /// Returns the tetrahedra that contain a critical point of F on the wrong side by `sides` and
    /// on the correct side by the sign of F.
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

/// Returns whether the centroid of a tetrahedron is far from F = 0 ([`DEEP`]).
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
    // |F| / |grad F| is unbounded near critical points
    value.abs() > limit * gradient.length().max(FLATTEST)
}

/// Returns the change of the Euler characteristic of the surface if the tetrahedra of `part` take
/// their labels from `sides`.
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

/// A vertex, edge or triangle: its vertices in ascending order, padded with [`INFINITE`].
type Face = [u32; 3];

fn is_edge(simplex: &Face) -> bool {
    simplex[1] != INFINITE && simplex[2] == INFINITE
}

/// Returns the finite vertices, edges and triangles of a triangle or tetrahedron.
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

/// Returns the tetrahedra whose label in `sides` differs from their current label. They are divided
/// into parts that share no vertex.
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
    fn missing_parts_of_the_surface_get_points() {
        for (scene, spacing) in [(scenes::two_balls(), 1.4), (scenes::shell(), 1.4)] {
            let topology = FieldTopology::new(&scene.field);
            let mut refinement = refined(&scene, &topology, spacing);
            let facets = refinement.object.facets();
            assert_eq!(refinement.insert_for_other(&facets, |_| Ok(())).unwrap(), 0, "nothing differs");
            let points = refinement.object.restricted.points();
            let by_place = |f: &&Facet| {
                let p = points[f.vertices[0] as usize];
                // one of the balls, or the outer surface of the shell
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
            assert_eq!(changes, [-2], "one interface less");
            let inserted = refinement.insert_for_other(&other, |_| Ok(())).unwrap();
            // one point per missing facet, except those too close to other points
            assert!(inserted > lost.len() / 4 && inserted <= lost.len(), "{inserted} of {}", lost.len());
        }
    }

    #[test]
    fn a_flat_tetrahedron_may_be_on_either_side() {
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
                // the other two facets of the tetrahedron replace its two facets on the surface: an
                // edge flip
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
