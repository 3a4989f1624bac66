//! The criteria that find where a complex differs from the strata of the indicators, and the remedy
//! for each violation: a point to insert or a segment to split (Cheng, Dey and Levine 2008;
//! Boissonnat and Oudot 2005; Oudot, Rineau and Yvinec 2005).

use super::complex::Complex;
use super::topology::Simplices;
use crate::around::boundary_facets_of;
use crate::interfaces::Segment;
use crate::labelled::Facet;
use crate::object::{DEFAULT_DEVIATION, deviation_ratio};
use crate::queue::{self, Reason, Simplex};
use glam::DVec3;
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::spline::LEAST_GRADIENT;

/// The remedy for a violation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mend {
    /// Insert a point on an interface.
    Point {
        /// Position in the grid frame, mm.
        place: DVec3,
        /// The interface.
        stratum: Stratum,
    },
    /// Split a segment at a point on its curve.
    Split(Segment),
    /// No remedy is known.
    None,
}

/// A violation of a criterion.
pub type Violation = queue::Violation<Mend>;

/// The surface Delaunay ball of a facet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Centre, on an interface: the point at which the dual Voronoi edge crosses it, or the
    /// projected centroid of the facet.
    pub place: DVec3,
    /// That interface.
    pub stratum: Stratum,
    /// Distance from the centre to the nearest vertex of the facet, mm.
    pub radius: f64,
}

impl Complex<'_> {
    /// Returns the facets between materials at an edge, sorted by their tetrahedra. `runs` is the
    /// result of [`Self::runs_round`].
    pub(super) fn facets_between(&self, edge: [u32; 2], runs: &[Vec<u32>]) -> Vec<Facet> {
        let delaunay = self.labelled.delaunay();
        let facet = |t: u32| {
            let own = boundary_facets_of(delaunay, t, |t| self.material(t));
            own.into_iter().filter(move |f| edge.iter().all(|v| f.vertices.contains(v)))
        };
        let mut facets: Vec<Facet> =
            runs.iter().flat_map(|run| facet(run[0]).chain(facet(run[run.len() - 1]))).collect();
        facets.sort_unstable_by_key(|f| (f.tetrahedron, f.opposite));
        facets.dedup();
        facets
    }

    /// Returns the surface Delaunay ball of a facet. Its centre is the point where the dual Voronoi
    /// edge leaves the material inside, or else the centroid of the facet, each projected onto the
    /// interface. Returns `None` if neither can be projected.
    pub fn ball(&self, facet: &Facet) -> Option<Ball> {
        let corners = facet.vertices.map(|v| self.points()[v as usize]);
        let voxel = self.indicators.voxel();
        let on_interface = |[i, j]: [MaterialId; 2], start: DVec3, limit: f64| {
            let stratum = (i != j).then(|| Stratum::interface(i, j))?;
            Some((super::prepare::onto(self.indicators, stratum, start, limit * voxel)?, stratum))
        };
        let crossing = self.crossing(facet).and_then(|(place, interface)| on_interface(interface, place, 0.5));
        let at_centroid = || {
            let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
            on_interface(self.interface(facet), centroid, 2.0)
        };
        let (place, stratum) = crossing.or_else(at_centroid)?;
        let radius = corners.iter().map(|p| p.distance(place)).fold(f64::INFINITY, f64::min);
        Some(Ball { place, stratum, radius })
    }

    /// Returns the point next to a facet where the dual Voronoi edge leaves the material inside,
    /// and the two materials there.
    fn crossing(&self, facet: &Facet) -> Option<(DVec3, [MaterialId; 2])> {
        let inside = self.material(facet.tetrahedron);
        let is_inside = |p: DVec3| self.indicators.region(self.indicators.material_at(p)) == inside;
        let (low, high) = self.labelled.dual_crossing(facet, is_inside, self.indicators.voxel())?;
        Some((low.midpoint(high), [inside, self.indicators.material_at(high)]))
    }

    /// Returns a violation at some facets. Its remedy is the centre of the largest of their surface
    /// Delaunay balls.
    fn by_largest_ball(&self, reason: Reason, simplex: Simplex, facets: &[Facet]) -> Option<Violation> {
        let first = facets.first()?;
        let balls = facets.iter().filter_map(|f| Some((self.ball(f)?, f)));
        let largest = balls.max_by(|a, b| a.0.radius.total_cmp(&b.0.radius).then(b.1.vertices.cmp(&a.1.vertices)));
        Some(match largest {
            Some((ball, facet)) => Violation {
                reason,
                simplex,
                remedy: Mend::Point { place: ball.place, stratum: ball.stratum },
                radius: ball.radius,
                size: self.size_of(&facet.vertices),
                near: facet.vertices[0],
            },
            None => {
                let (size, near) = (self.size_of(&first.vertices), first.vertices[0]);
                Violation { reason, simplex, remedy: Mend::None, radius: 0.0, size, near }
            }
        })
    }

    /// Returns a violation whose remedy is to split a segment.
    fn by_split(&self, reason: Reason, simplex: Simplex, pair: Segment) -> Violation {
        let (radius, size) = (0.5 * self.length(pair), self.size_of(&pair));
        Violation { reason, simplex, remedy: Mend::Split(pair), radius, size, near: pair[0] }
    }

    /// Returns the violation at a segment, if there is one. `start` is a tetrahedron at the
    /// segment; `None` if the segment is not an edge.
    fn at_segment(&self, pair: Segment, curve: Stratum, start: Option<u32>) -> Option<Violation> {
        let simplex = Simplex::Edge(pair);
        let reason = self.wrong_segment(pair, curve, start)?;
        let Some(start) = start else { return Some(self.by_split(reason, simplex, pair)) };
        let by_ball = self.by_largest_ball(reason, simplex, &self.facets_between(pair, &self.runs_round(pair, start)));
        Some(by_ball.unwrap_or_else(|| self.by_split(reason, simplex, pair)))
    }

    /// Returns the violation at an edge that is not a segment, if there is one. `start` is a
    /// tetrahedron at the edge.
    fn at_plain_edge(&self, edge: [u32; 2], start: u32) -> Option<Violation> {
        let reason = self.wrong_plain_edge(edge, start)?;
        self.by_largest_ball(reason, Simplex::Edge(edge), &self.facets_between(edge, &self.runs_round(edge, start)))
    }

    /// Returns the violation at an edge or segment, if there is one. `start` is a tetrahedron at
    /// it; `None` if the segment is not an edge.
    fn at_any_edge(&self, edge: [u32; 2], start: Option<u32>) -> Option<Violation> {
        match self.segments.curve(edge) {
            Some(curve) => self.at_segment(edge, curve, start),
            None => self.at_plain_edge(edge, start?),
        }
    }

    /// Returns the violation at a vertex, if there is one.
    fn at_vertex(&self, vertex: u32) -> Option<Violation> {
        let reason = self.wrong_vertex(vertex)?;
        self.by_largest_ball(reason, Simplex::Vertex(vertex), &self.labelled.facets_at(vertex))
    }

    /// Returns the violation at a facet, if there is one: of its topology, its deviation or its
    /// normal deviation.
    fn at_facet(&self, facet: &Facet) -> Option<Violation> {
        let strays = || (self.deviation_ratio(facet) > 1.0).then_some(Reason::Deviation);
        let reason = self.wrong_facet(facet).or_else(strays)?;
        self.by_largest_ball(reason, Simplex::Facet(facet.sorted()), std::slice::from_ref(facet))
    }

    /// Returns the deviation of a facet from its interface relative to the limit, or a value above
    /// 1 if its normal deviation is too large.
    fn deviation_ratio(&self, facet: &Facet) -> f64 {
        let limit = self
            .max_deviation
            .unwrap_or_else(|| DEFAULT_DEVIATION * self.size_of(&facet.vertices).max(self.indicators.voxel()));
        let corners = facet.vertices.map(|v| self.points()[v as usize]);
        deviation_ratio(straying(self.indicators, self.interface(facet), corners), limit)
    }

    /// Returns the violation at a simplex, if the simplex still exists and violates a criterion.
    pub fn at_simplex(&self, simplex: Simplex) -> Option<Violation> {
        match simplex {
            Simplex::Vertex(v) => self.at_vertex(v),
            Simplex::Edge(edge) => self.at_any_edge(edge, self.at_edge(edge)),
            Simplex::Facet(vertices) => self.facet_on(vertices).and_then(|f| self.at_facet(&f)),
            Simplex::Node(_) | Simplex::Place(..) => None,
        }
    }

    /// Returns the violations at some simplices.
    pub fn violations(&self, simplices: &Simplices) -> Vec<Violation> {
        simplices.each(|edge, start| self.at_any_edge(edge, start), |v| self.at_vertex(v), |f| self.at_facet(f))
    }
}

/// Returns the first-order distance (mm) of the centroid of a triangle from the interface of the
/// materials inside and outside, and the cosine between the normals of the triangle and of the
/// interface. If a third material has a smaller indicator at the centroid, the distance is at least
/// half the difference.
pub(super) fn straying(indicators: &dyn Indicators, interface: [MaterialId; 2], [a, b, c]: [DVec3; 3]) -> (f64, f64) {
    let centroid = (a + b + c) / 3.0;
    let (value, gradient) = indicators.difference_gradient(interface[0], interface[1], centroid);
    let slope = gradient.length().max(LEAST_GRADIENT);
    let distance = (value.abs() / slope).max(-0.5 * indicators.clearance(centroid, &interface));
    (distance, (b - a).cross(c - a).normalize_or_zero().dot(gradient / slope))
}
