//! The criteria that find where a complex differs from the complex of the indicators, and the points
//! that remedy it (Cheng, Dey and Levine 2008; Boissonnat and Oudot 2005; Oudot, Rineau and Yvinec
//! 2005).

use super::complex::Complex;
use super::segments::Segment;
use super::topology::Simplices;
use crate::around::boundary_facets_of;
use crate::labelled::Facet;
use crate::object::{DEFAULT_DEVIATION, deviation_ratio};
use crate::queue::{self, Reason, Simplex};
use glam::DVec3;
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::spline::LEAST_GRADIENT;

/// A segment that lacks a material round it is cut where the surface balls there are smaller than this part of it: they tell no more.
const SMALL_BALL: f64 = 0.5;

/// Distance from a circumcentre, over the circumradius, up to which a point lies within: the rest is rounding.
const WITHIN: f64 = 1.0 - 1e-9;

/// What mends a violation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mend {
    /// A point on a sheet.
    Point {
        /// Where, grid frame, mm.
        place: DVec3,
        /// Its sheet.
        stratum: Stratum,
    },
    /// The middle of a segment.
    Split(Segment),
    /// None is known.
    None,
}

/// A violation of a criterion.
pub type Violation = queue::Violation<Mend>;

/// The centre of the surface ball of a facet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Where the Voronoi edge crosses an interface, on its sheet.
    pub place: DVec3,
    /// That sheet.
    pub stratum: Stratum,
    /// Distance from the nearest vertex of the facet, mm.
    pub radius: f64,
}

impl Complex<'_> {
    /// The facets between materials among tetrahedra round an edge, in the order of the ring; `runs` are those of [`Self::runs_round`].
    fn facets_between(&self, edge: [u32; 2], runs: &[Vec<u32>]) -> Vec<Facet> {
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

    /// The surface ball of a facet: where its Voronoi edge leaves the material inside, near the facet; else its projected centroid. Of the two the first that parts
    /// the facet once it is on its sheet, if either does: nearer to the circumcentre of a tetrahedron at it than its vertices are.
    pub fn ball(&self, facet: &Facet) -> Option<Ball> {
        let corners = facet.vertices.map(|v| self.points()[v as usize]);
        let voxel = self.indicators.voxel();
        let on_sheet = |[i, j]: [MaterialId; 2], start: DVec3, limit: f64| {
            let stratum = (i != j).then(|| Stratum::interface(i, j))?;
            Some((super::prepare::onto(self.indicators, stratum, start, limit * voxel)?, stratum))
        };
        let crossing = self.crossing(facet).and_then(|(place, sheet)| on_sheet(sheet, place, 0.5));
        let parts = |found: &(DVec3, Stratum)| self.parts(found.0, facet);
        let at_centroid = || {
            let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
            on_sheet(self.sheet(facet), centroid, 2.0)
        };
        let (place, stratum) =
            crossing.filter(parts).or_else(|| at_centroid().filter(parts)).or(crossing).or_else(at_centroid)?;
        let radius = corners.iter().map(|p| p.distance(place)).fold(f64::INFINITY, f64::min);
        Some(Ball { place, stratum, radius })
    }

    /// Whether a point would be nearer to the circumcentre of a tetrahedron at a facet than its vertices are, so that the facet would be gone. The centre of a surface
    /// ball is, but where it was brought onto its sheet it may lie beyond, and even at a vertex that was inserted for the same facet before.
    fn parts(&self, place: DVec3, facet: &Facet) -> bool {
        let delaunay = self.labelled.delaunay();
        let corner = self.points()[facet.vertices[0] as usize];
        [facet.tetrahedron, self.labelled.across(facet)].into_iter().any(|t| {
            let centre = if delaunay.is_ghost(t) { None } else { delaunay.circumcentre(t) };
            centre.is_none_or(|centre| centre.distance(place) < WITHIN * centre.distance(corner))
        })
    }

    /// Where the Voronoi edge dual to a facet leaves the material inside, next to the facet, and the two materials there.
    fn crossing(&self, facet: &Facet) -> Option<(DVec3, [MaterialId; 2])> {
        let inside = self.material(facet.tetrahedron);
        let is_inside = |p: DVec3| self.indicators.material_at(p) == inside;
        let (low, high) = self.labelled.dual_crossing(facet, is_inside, self.indicators.voxel())?;
        Some((low.midpoint(high), [inside, self.indicators.material_at(high)]))
    }

    /// The violation at some facets, mended by the largest of the surface balls that part theirs.
    fn by_largest_ball(&self, reason: Reason, simplex: Simplex, facets: &[Facet]) -> Option<Violation> {
        let first = facets.first()?;
        let balls = facets.iter().filter_map(|f| self.ball(f).map(|ball| (self.parts(ball.place, f), ball, f)));
        let largest = balls.max_by(|a, b| {
            let by_room = a.0.cmp(&b.0).then(a.1.radius.total_cmp(&b.1.radius));
            by_room.then(b.2.vertices.cmp(&a.2.vertices))
        });
        Some(match largest {
            Some((_, ball, facet)) => Violation {
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

    /// A violation that the middle of a segment mends.
    fn by_split(&self, reason: Reason, simplex: Simplex, pair: Segment) -> Violation {
        let (radius, size) = (0.5 * self.length(pair), self.size_of(&pair));
        Violation { reason, simplex, remedy: Mend::Split(pair), radius, size, near: pair[0] }
    }

    /// A segment of a curve, at which `start` is a tetrahedron, if it is an edge.
    fn at_segment(&self, pair: Segment, curve: Stratum, start: Option<u32>) -> Option<Violation> {
        let simplex = Simplex::Edge(pair);
        let reason = self.wrong_segment(pair, curve, start)?;
        let Some(start) = start else { return Some(self.by_split(reason, simplex, pair)) };
        let by_ball = self.by_largest_ball(reason, simplex, &self.facets_between(pair, &self.runs_round(pair, start)));
        let is_small = |v: &Violation| v.radius < SMALL_BALL * self.length(pair);
        Some(by_ball.filter(|v| !is_small(v)).unwrap_or_else(|| self.by_split(reason, simplex, pair)))
    }

    /// An edge that is no segment; `start` is a tetrahedron at it.
    fn at_plain_edge(&self, edge: [u32; 2], start: u32) -> Option<Violation> {
        let reason = self.wrong_plain_edge(edge, start)?;
        self.by_largest_ball(reason, Simplex::Edge(edge), &self.facets_between(edge, &self.runs_round(edge, start)))
    }

    /// An edge, segment or not; `start` is a tetrahedron at it, if there is one.
    fn at_any_edge(&self, edge: [u32; 2], start: Option<u32>) -> Option<Violation> {
        match self.segments.curve(edge) {
            Some(curve) => self.at_segment(edge, curve, start),
            None => self.at_plain_edge(edge, start?),
        }
    }

    /// A vertex.
    fn at_vertex(&self, vertex: u32) -> Option<Violation> {
        let reason = self.wrong_vertex(vertex)?;
        self.by_largest_ball(reason, Simplex::Vertex(vertex), &self.labelled.facets_at(vertex))
    }

    /// A facet must not stray from its sheet either.
    fn at_facet(&self, facet: &Facet) -> Option<Violation> {
        let strays = || (self.deviation_ratio(facet) > 1.0).then_some(Reason::Deviation);
        let reason = self.wrong_facet(facet).or_else(strays)?;
        self.by_largest_ball(reason, Simplex::Facet(facet.sorted()), std::slice::from_ref(facet))
    }

    /// How far a facet strays, in units of what is allowed.
    fn deviation_ratio(&self, facet: &Facet) -> f64 {
        let limit = self
            .max_deviation
            .unwrap_or_else(|| DEFAULT_DEVIATION * self.size_of(&facet.vertices).max(self.indicators.voxel()));
        let corners = facet.vertices.map(|v| self.points()[v as usize]);
        deviation_ratio(straying(self.indicators, self.sheet(facet), corners), limit)
    }

    /// The violation at a simplex, or what is left of it.
    pub fn at_simplex(&self, simplex: Simplex) -> Option<Violation> {
        match simplex {
            Simplex::Vertex(v) => self.at_vertex(v),
            Simplex::Edge(edge) => self.at_any_edge(edge, self.at_edge(edge)),
            Simplex::Facet(vertices) => self.facet_on(vertices).and_then(|f| self.at_facet(&f)),
            Simplex::Node(_) | Simplex::Place(..) => None,
        }
    }

    /// What is violated at some simplices.
    pub fn violations(&self, simplices: &Simplices) -> Vec<Violation> {
        simplices.each(|edge, start| self.at_any_edge(edge, start), |v| self.at_vertex(v), |f| self.at_facet(f))
    }
}

/// How far the centroid of a triangle lies from the sheet of the materials inside and outside, mm to first order, be it beyond its border; and the cosine
/// between the triangle's normal and the sheet's.
pub(super) fn straying(indicators: &dyn Indicators, sheet: [MaterialId; 2], [a, b, c]: [DVec3; 3]) -> (f64, f64) {
    let centroid = (a + b + c) / 3.0;
    let (value, gradient) = indicators.difference_gradient(sheet[0], sheet[1], centroid);
    let slope = gradient.length().max(LEAST_GRADIENT);
    let distance = (value.abs() / slope).max(-0.5 * indicators.clearance(centroid, &sheet));
    (distance, (b - a).cross(c - a).normalize_or_zero().dot(gradient / slope))
}
