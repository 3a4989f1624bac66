//! One object: a triangulation with tetrahedra inside and outside, and the criteria that compare
//! its surface with F (Boissonnat and Oudot 2005; Oudot, Rineau and Yvinec 2005). Each local
//! criterion is a pure function of one simplex. It returns a violation and its remedy, a point on
//! F = 0. [`Object::defects`] compares a whole set of facets with F.

use crate::around::boundary_facets_of;
use crate::defects::Defects;
use crate::prepare::{ON_SURFACE, SurfacePoints};
use crate::queue::{self, Reason, Remedy, Simplex};
use crate::restricted::{Facet, Restricted};
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::spline::{CubicSpline, LEAST_GRADIENT};
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::components::{DisjointSets, NO_COMPONENT};
use isoparticles_stage::error::Result;
use rayon::prelude::*;

/// Default maximum distance of the centroid of a facet from F = 0, in units of h or of a voxel,
/// whichever is larger. It is three times the distance of a facet of edge h on a ball of radius 2 h
/// (h^2 / 6 R).
pub(crate) const DEFAULT_DEVIATION: f64 = 0.25;

/// Minimum cosine between the normal of a facet and grad F at its centroid. Below it, the facet
/// violates the criterion of deviation and lies across F = 0.
pub(crate) const TURNED: f64 = 0.3;

impl Remedy for DVec3 {
    fn place(&self) -> [f64; 3] {
        self.to_array()
    }
}

/// A violation whose remedy is a point on F = 0.
pub type Violation = queue::Violation<DVec3>;

/// Points on F = 0, with a triangulation whose tetrahedra are inside or outside.
pub struct Object<'a> {
    /// The triangulation with its labels.
    pub restricted: Restricted<'a>,
    /// Target edge length h at each point, mm.
    pub sizes: Vec<f64>,
    /// Component of F = 0 of each point, or [`NO_COMPONENT`] if it is unknown.
    pub component_of: Vec<u32>,
    /// Topology of F.
    pub topology: &'a FieldTopology,
    /// Maximum distance of the centroid of a facet from F = 0, mm. `None`: a quarter of h, but at
    /// least a quarter of a voxel.
    max_deviation: Option<f64>,
    /// Whether the object is open at the border of the volume.
    pub open_border: bool,
}

impl<'a> Object<'a> {
    /// Labels a triangulation of points on F = 0.
    pub fn new(
        delaunay: Delaunay,
        points: &SurfacePoints,
        field: &'a CubicSpline,
        topology: &'a FieldTopology,
        max_deviation: Option<f64>,
        open_border: bool,
    ) -> Self {
        let restricted = Restricted::new(delaunay, field);
        let component_of = points.positions.par_iter().map(|&p| component_at(p, field, topology)).collect();
        Self { restricted, sizes: points.sizes.clone(), component_of, topology, max_deviation, open_border }
    }

    /// Returns the points. Inserted points are at the end.
    pub fn points(&self) -> &[DVec3] {
        self.restricted.points()
    }

    /// Inserts a point on F = 0 with its target edge length and updates the labels. `near` is a
    /// vertex close to it. Returns false if the point exists already.
    ///
    /// # Errors
    /// If the triangulation cannot insert the point.
    pub fn insert(&mut self, place: DVec3, size: f64, near: u32) -> Result<bool> {
        if self.restricted.insert(place, near)?.is_none() {
            return Ok(false);
        }
        self.sizes.push(size);
        self.component_of.push(component_at(place, self.restricted.field(), self.topology));
        self.restricted.decide_sides();
        Ok(true)
    }

    /// Returns the facets of the surface. If the border is open, facets that would close the
    /// surface there are omitted.
    pub fn facets(&self) -> Vec<Facet> {
        self.without_border_closure(self.restricted.facets())
    }

    /// Removes the facets that would close the surface at an open border.
    pub fn without_border_closure(&self, mut facets: Vec<Facet>) -> Vec<Facet> {
        if self.open_border {
            facets.retain(|f| !self.restricted.is_border_closure(f));
        }
        facets
    }

    /// Returns whether an edge may be in a single facet: both ends are close to an open border.
    fn may_be_open(&self, a: u32, b: u32) -> bool {
        let geometry = self.restricted.field().geometry();
        let upper = geometry.upper_corner();
        let near_border = |v: u32| {
            let p = self.points()[v as usize];
            p.min(upper - p).min_element() < self.sizes[v as usize] + geometry.mean_spacing()
        };
        self.open_border && near_border(a) && near_border(b)
    }

    /// Returns the defects of a set of facets as a whole, compared with F.
    pub fn defects(&self, facets: &[Facet]) -> Defects {
        let triangles: Vec<[u32; 3]> = facets.iter().map(|f| f.vertices).collect();
        Defects::find(&triangles, &self.component_of, self.topology, |a, b| self.may_be_open(a, b))
    }

    /// Returns the facets at a vertex.
    pub fn facets_at(&self, vertex: u32) -> Vec<Facet> {
        self.without_border_closure(self.restricted.facets_at(vertex))
    }

    /// Returns the violations at a vertex and at edges from it. The facets at the vertex must form
    /// one fan, and each edge must be in exactly two of them. `edges` selects the edges that are
    /// tested, by their other ends.
    fn at_star(&self, vertex: u32, edges: impl Fn(u32) -> bool) -> Vec<Violation> {
        let facets = self.facets_at(vertex);
        let mut ends: Vec<(u32, usize)> = Vec::with_capacity(2 * facets.len());
        for (k, facet) in facets.iter().enumerate() {
            ends.extend(facet.vertices.into_iter().filter(|&v| v != vertex).map(|v| (v, k)));
        }
        ends.sort_unstable();
        let mut fans = DisjointSets::new(facets.len());
        let (mut joined, mut found) = (0, Vec::new());
        for edge in ends.chunk_by(|a, b| a.0 == b.0) {
            let other = edge[0].0;
            if let [(_, first), (_, second)] = *edge {
                let [first, second] = [first, second].map(|k| fans.find(k as u32));
                joined += usize::from(first != second);
                fans.join(first, second);
            } else if edges(other) && !(edge.len() == 1 && self.may_be_open(vertex, other)) {
                let own: Vec<Facet> = edge.iter().map(|&(_, k)| facets[k]).collect();
                let simplex = Simplex::Edge([vertex.min(other), vertex.max(other)]);
                found.extend(self.by_largest_ball(Reason::Edge, simplex, &own));
            }
        }
        if facets.len() > joined + 1 {
            found.extend(self.by_largest_ball(Reason::Vertex, Simplex::Vertex(vertex), &facets));
        }
        found
    }

    /// Returns the violation at a facet if it joins components of F = 0, or if its deviation or
    /// normal deviation is too large.
    pub fn at_facet(&self, facet: &Facet) -> Option<Violation> {
        let reason = if self.is_bridge(facet) {
            Reason::Bridge
        } else if self.deviation_ratio(facet) > 1.0 {
            Reason::Deviation
        } else {
            return None;
        };
        self.by_largest_ball(reason, Simplex::Facet(facet.sorted()), std::slice::from_ref(facet))
    }

    /// Returns whether a facet joins components of F = 0 that no undecided place can join.
    pub fn is_bridge(&self, facet: &Facet) -> bool {
        let mut known =
            facet.vertices.into_iter().filter_map(|v| self.topology.groups().of(self.component_of[v as usize]));
        known.next().is_some_and(|first| known.any(|group| group != first))
    }

    /// Returns the current violation at a simplex, or `None` if there is none.
    pub fn at_simplex(&self, simplex: Simplex) -> Option<Violation> {
        let at = |v: u32| self.at_star(v, |_| true).into_iter().find(|found| found.simplex == simplex);
        match simplex {
            Simplex::Vertex(v) | Simplex::Edge([v, _]) => at(v),
            Simplex::Facet(vertices) => {
                let facets = self.facets_at(vertices[0]);
                facets.into_iter().find(|f| f.sorted() == vertices).and_then(|f| self.at_facet(&f))
            }
            Simplex::Node(_) | Simplex::Place(..) => None,
        }
    }

    /// Returns the violations at the surface facets of some tetrahedra and of their neighbours
    /// across these facets, and at the edges and vertices of these facets.
    pub fn at_tetrahedra(&self, tetrahedra: &[u32]) -> Vec<Violation> {
        let of = |&t: &u32| boundary_facets_of(self.restricted.delaunay(), t, |t| self.restricted.is_inside(t));
        let mut facets: Vec<Facet> = tetrahedra.iter().flat_map(of).collect();
        facets.sort_unstable_by_key(|f| (f.tetrahedron, f.opposite));
        facets.dedup();
        let facets = self.without_border_closure(facets);
        let mut found = self.at_vertices(facets.iter().flat_map(|f| f.vertices).collect());
        found.extend(facets.iter().filter_map(|f| self.at_facet(f)));
        found
    }

    /// Returns the violations at some vertices and at the edges from them.
    pub fn at_vertices(&self, mut vertices: Vec<u32>) -> Vec<Violation> {
        vertices.sort_unstable();
        vertices.dedup();
        // edges between two of the vertices are tested once
        let edges = |v: u32| {
            let vertices = &vertices;
            move |other: u32| other > v || vertices.binary_search(&other).is_err()
        };
        vertices.iter().flat_map(|&v| self.at_star(v, edges(v))).collect()
    }

    /// Returns a violation at some facets. Its remedy is the centre of their largest surface
    /// Delaunay ball.
    fn by_largest_ball(&self, reason: Reason, simplex: Simplex, facets: &[Facet]) -> Option<Violation> {
        let balls = facets.iter().filter_map(|f| self.by_ball(reason, simplex, f));
        balls.max_by(|a, b| a.radius.total_cmp(&b.radius))
    }

    /// Returns a violation whose remedy is the centre of the surface Delaunay ball of a facet. It
    /// is the point where the dual Voronoi edge crosses F = 0, or else the centroid, projected onto
    /// F = 0. Returns `None` if neither can be projected.
    pub fn by_ball(&self, reason: Reason, simplex: Simplex, facet: &Facet) -> Option<Violation> {
        let [a, b, c] = facet.vertices.map(|v| self.points()[v as usize]);
        let crossing = self.restricted.dual_crossing(facet).and_then(|p| self.on_surface(p, 0.5));
        let remedy = crossing.or_else(|| self.on_surface((a + b + c) / 3.0, 2.0))?;
        let radius = a.distance(remedy).min(b.distance(remedy)).min(c.distance(remedy));
        Some(Violation { reason, simplex, remedy, radius, size: self.size_of(facet), near: facet.vertices[0] })
    }

    /// Returns the mean target edge length at the vertices of a facet, mm.
    fn size_of(&self, facet: &Facet) -> f64 {
        facet.vertices.map(|v| self.sizes[v as usize]).iter().sum::<f64>() / 3.0
    }

    /// Projects a position onto F = 0. Returns `None` if the move exceeds `voxels`, in voxels.
    pub fn on_surface(&self, p: DVec3, voxels: f64) -> Option<DVec3> {
        let voxel = self.restricted.field().geometry().mean_spacing();
        self.restricted.field().project(p, voxels * voxel, ON_SURFACE * voxel)
    }

    /// Returns the deviation of a facet relative to its limit. See [`deviation_ratio`].
    fn deviation_ratio(&self, facet: &Facet) -> f64 {
        let limit = self.max_deviation.unwrap_or_else(|| {
            DEFAULT_DEVIATION * self.size_of(facet).max(self.restricted.field().geometry().mean_spacing())
        });
        deviation_ratio(self.at_centroid(facet), limit)
    }

    /// Returns the first-order distance of the centroid of a facet from F = 0 in mm, and the cosine
    /// between the normal of the facet and grad F there.
    fn at_centroid(&self, facet: &Facet) -> (f64, f64) {
        let [a, b, c] = facet.vertices.map(|v| self.points()[v as usize]);
        let (value, gradient) = self.restricted.field().value_gradient((a + b + c) / 3.0);
        let slope = gradient.length().max(LEAST_GRADIENT);
        (value.abs() / slope, (b - a).cross(c - a).normalize_or_zero().dot(gradient / slope))
    }
}

/// Returns the deviation of a facet relative to its limit; a value above 1 is a violation. The
/// arguments are the distance of the centroid (mm), the cosine between the normals of the facet and
/// of the surface there, and the maximum distance (mm).
pub(crate) fn deviation_ratio((distance, agreement): (f64, f64), limit: f64) -> f64 {
    let turned = if agreement < TURNED { 1.0 + TURNED - agreement } else { 0.0 };
    (distance / limit).max(turned)
}

/// Returns the component of F = 0 that contains a point on F = 0, or [`NO_COMPONENT`] if it cannot
/// be determined.
pub(crate) fn component_at(p: DVec3, field: &CubicSpline, topology: &FieldTopology) -> u32 {
    topology.component_at(field, p, field.value_gradient(p).1).unwrap_or(NO_COMPONENT)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refine::{RefineOptions, Refinement};
    use crate::scenes::{self, Scene};
    use crate::tests::surface_points;

    #[test]
    fn local_violations_equal_the_defects_of_the_surface() {
        // at this spacing, parts of the surface touch
        let found = (0..12).map(|seed| compare(&scenes::random(seed), 1.8));
        let [edges, vertices] = found.fold([0, 0], |[a, b], [edges, vertices]| [a + edges, b + vertices]);
        assert!(edges > 0 && vertices > 0, "{edges} edges and {vertices} vertices: this shows nothing");
    }

    /// Compares the local violations of a scene with the defects of the whole surface. Returns the
    /// number of edges and of vertices with violations.
    fn compare(scene: &Scene, spacing: f64) -> [usize; 2] {
        let mut points = surface_points(scene, spacing);
        let topology = FieldTopology::new(&scene.field);
        let refinement = Refinement::new(&mut points, &scene.field, &topology, RefineOptions::default()).unwrap();
        let object = &refinement.object;
        let facets = object.facets();
        let whole = object.defects(&facets);
        let all: Vec<u32> = (0..object.points().len() as u32).collect();
        let simplices = |found: Vec<Violation>| {
            let mut simplices: Vec<Simplex> = found.into_iter().map(|v| v.simplex).collect();
            simplices.sort_unstable();
            simplices
        };
        let found = simplices(object.at_vertices(all.clone()));
        let mut expected: Vec<Simplex> = whole.vertices.iter().map(|(v, _)| Simplex::Vertex(*v)).collect();
        let ends = |around: &Vec<u32>| crate::defects::edge_of(&facets, around).expect("facets of an edge");
        expected.extend(whole.edges.iter().map(|around| {
            let [a, b] = ends(around);
            Simplex::Edge([a.min(b), a.max(b)])
        }));
        expected.sort_unstable();
        assert_eq!(found, expected);
        assert!(found.iter().all(|&simplex| object.at_simplex(simplex).is_some_and(|v| v.simplex == simplex)));
        // the violations at a vertex are its own and those of its edges
        for &v in &all {
            let at = |simplex: &&Simplex| match simplex {
                Simplex::Edge(edge) => edge.contains(&v),
                simplex => **simplex == Simplex::Vertex(v),
            };
            assert_eq!(simplices(object.at_vertices(vec![v])), expected.iter().filter(at).copied().collect::<Vec<_>>());
        }
        let bridges = facets.iter().filter(|f| object.is_bridge(f)).count();
        assert_eq!(bridges, whole.bridges.len());
        [whole.edges.len(), whole.vertices.len()]
    }

    #[test]
    fn nearest_vertex_equals_exhaustive_search() {
        let scene = scenes::gyroid();
        let mut points = surface_points(&scene, 1.4);
        let topology = FieldTopology::new(&scene.field);
        let refinement = Refinement::new(&mut points, &scene.field, &topology, RefineOptions::default()).unwrap();
        let restricted = &refinement.object.restricted;
        let distance = |v: u32, place: DVec3| restricted.points()[v as usize].distance(place);
        let count = restricted.points().len() as u32;
        for n in 0..400u32 {
            let place = DVec3::new(f64::from(n % 7), f64::from(n / 7 % 8), f64::from(n / 56)) * 5.1;
            let nearest =
                (0..count).min_by(|a, b| distance(*a, place).total_cmp(&distance(*b, place))).expect("points");
            assert_eq!(restricted.nearest(place, 37 * n % count), (nearest, distance(nearest, place)));
        }
    }
}
