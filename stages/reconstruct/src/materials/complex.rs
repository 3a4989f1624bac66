//! The triangulation whose tetrahedra belong to materials, with the strata of its points, and the pure criteria that find where it is not the complex of
//! the indicators (Cheng, Dey and Levine 2008; Boissonnat and Oudot 2005; Oudot, Rineau and Yvinec 2005).

use super::prepare::Prepared;
use super::segments::{Segment, Segments};
use super::topology::Simplices;
use crate::around::{boundary_facets_of, star};
use crate::labelled::{Facet, Labelled};
use crate::object::{DEFAULT_DEVIATION, deviation_ratio};
use crate::queue::{self, Reason, Simplex};
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::materials::complex::SAME_JUNCTION;
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::spline::LEAST_GRADIENT;
use std::collections::{BTreeMap, BTreeSet};

/// A segment that lacks a material round it is cut where the surface balls there are smaller than this part of it: they tell no more.
const SMALL_BALL: f64 = 0.5;

/// Distance from a circumcentre, over the circumradius, up to which a point lies within: the rest is rounding.
const WITHIN: f64 = 1.0 - 1e-9;

/// Where no indicator of the materials of a tetrahedron is known at its circumcentre, they are asked for on the way to its centroid, in so many steps.
const STEPS: i32 = 8;

/// The materials of junction points where more than four meet, by their number.
type Crowded = BTreeMap<u32, Vec<MaterialId>>;

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

/// Points on strata, and tetrahedra of materials.
pub struct Complex<'a> {
    /// The triangulation.
    pub labelled: Labelled<MaterialId>,
    /// The indicators.
    pub indicators: &'a dyn Indicators,
    /// The stratum of each point.
    pub strata: Vec<Stratum>,
    /// Target edge length h at each point, mm.
    pub sizes: Vec<f64>,
    /// Segments of junction curves.
    pub segments: Segments,
    /// Points of strata that were joined to others, nearer than `ONE_CURVE`.
    pub joined: BTreeSet<u32>,
    /// The materials of junction points where more than four meet.
    crowded: Crowded,
    /// Farthest that the centroid of a facet may lie from its sheet, mm; `None`: [`DEFAULT_DEVIATION`] of h or of a voxel.
    max_deviation: Option<f64>,
}

impl<'a> Complex<'a> {
    /// Gives the tetrahedra of a volume that ends at `upper` their materials.
    pub fn new(prepared: Prepared, indicators: &'a dyn Indicators, upper: DVec3, max_deviation: Option<f64>) -> Self {
        let Prepared { delaunay, strata, sizes, segments, .. } = prepared;
        let crowded = (0..strata.len() as u32)
            .filter(|&v| strata[v as usize].dimension() == 0)
            .filter_map(|v| {
                let near = indicators.near(delaunay.points()[v as usize]);
                let last = near.entries().get(3)?.1;
                let equal =
                    near.entries().iter().filter(|(_, value)| value - last < SAME_JUNCTION * indicators.voxel());
                let ids: Vec<MaterialId> = equal.map(|(id, _)| *id).collect();
                (ids.len() > 4).then_some((v, ids))
            })
            .collect();
        let label =
            |delaunay: &Delaunay, t: u32, centre| material_of(indicators, &strata, &crowded, delaunay, t, centre);
        let labelled = Labelled::new(delaunay, upper, label);
        Self { labelled, indicators, strata, sizes, segments, joined: BTreeSet::new(), crowded, max_deviation }
    }

    /// Gives the tetrahedra made since the last call their materials.
    pub fn decide(&mut self) {
        let Self { labelled, indicators, strata, crowded, .. } = self;
        labelled.decide(|delaunay, t, centre| material_of(*indicators, strata, crowded, delaunay, t, centre));
    }

    /// Has a segment pass through a point that lies on its curve but for `ONE_CURVE`, where its materials meet then too.
    pub fn pass(&mut self, pair: Segment, point: u32) {
        let Some(curve) = self.segments.curve(pair) else { return };
        self.segments.split(pair, point, self.labelled.points());
        self.join(point, &curve);
        for point in [point, pair[0], pair[1]] {
            self.widen_short_segments(point);
            self.labelled.reconsider(point);
        }
        self.decide();
    }

    /// Has the materials of a stratum that passes a point within `ONE_CURVE` meet there.
    fn join(&mut self, point: u32, stratum: &Stratum) {
        let own = &mut self.strata[point as usize];
        if !own.is_on(stratum) {
            self.joined.insert(point);
        }
        match own.joined(stratum) {
            Some(joined) => *own = joined,
            None => {
                let known = self.crowded.entry(point).or_insert_with(|| own.materials().to_vec());
                known.extend(stratum.materials().iter().filter(|id| !own.has(**id)));
                known.sort_unstable();
                known.dedup();
            }
        }
    }

    /// Whether all materials of a stratum are equally near at a point, but for `ONE_CURVE`.
    fn is_passed(&self, point: u32, stratum: &Stratum) -> bool {
        let reach = super::way::ONE_CURVE * self.indicators.voxel();
        let (place, ids) = (self.points()[point as usize], stratum.materials());
        ids[1..].iter().all(|&other| {
            let (value, gradient) = self.indicators.difference_gradient(ids[0], other, place);
            value.abs() < reach * gradient.length().max(LEAST_GRADIENT)
        })
    }

    /// Has the materials of a facet between two meet at each of its vertices that its sheet passes within `ONE_CURVE`; true when that makes it right.
    pub fn join_facet(&mut self, vertices: [u32; 3]) -> bool {
        let Some(facet) = self.facet_on(vertices) else { return false };
        let [inside, outside] = self.sheet(&facet);
        let sheet = Stratum::interface(inside, outside);
        for v in vertices {
            let is_there = sheet.materials().iter().all(|&id| self.meets(v, id));
            if !is_there && self.is_passed(v, &sheet) {
                self.join(v, &sheet);
            }
        }
        self.wrong_facet(&facet).is_none()
    }

    /// Takes an edge round which three or four materials come once each as a segment, if its ends lie nearer than `ONE_CURVE` to the sheets between these; true when it does.
    pub fn adopt(&mut self, edge: Segment) -> bool {
        let Some(start) = self.at_edge(edge) else { return false };
        let ids: Vec<MaterialId> = self.runs_round(edge, start).iter().map(|run| self.material(run[0])).collect();
        let Some(curve) = Stratum::new(&ids).filter(|curve| curve.dimension() < 2) else { return false };
        if !edge.iter().all(|&v| self.is_passed(v, &curve)) || !self.segments.adopt(edge, curve, self.labelled.points())
        {
            return false;
        }
        edge.into_iter().for_each(|v| self.join(v, &curve));
        true
    }

    /// Gives up the adopted segments that are no longer edges between their materials.
    pub fn give_up_adopted(&mut self) {
        for edge in self.segments.adopted() {
            let curve = self.segments.curve(edge);
            if curve.is_none_or(|curve| self.wrong_segment(edge, curve, self.at_edge(edge)).is_some()) {
                self.segments.remove(edge, self.labelled.points());
            }
        }
    }

    /// Has the segments at a point that are shorter than `ONE_CURVE` and end at one of the same four materials be of all of them: on which of their curves they lie cannot be told.
    fn widen_short_segments(&mut self, point: u32) {
        let reach = super::way::ONE_CURVE * self.indicators.voxel();
        let own = self.strata[point as usize];
        let is_of_four =
            |pair: &Segment| pair.iter().all(|&v| self.strata[v as usize] == own) && self.length(*pair) < reach;
        let short: Vec<Segment> =
            self.segments.at(point).filter(|pair| own.dimension() == 0 && is_of_four(pair)).collect();
        short.into_iter().for_each(|pair| self.segments.widen(pair, own));
    }

    /// The points, those inserted at the end.
    pub fn points(&self) -> &[DVec3] {
        self.labelled.points()
    }

    /// The material of a tetrahedron.
    pub fn material(&self, tetrahedron: u32) -> MaterialId {
        self.labelled.of(tetrahedron)
    }

    /// The sheet that a facet lies in: of the materials inside and outside.
    pub fn sheet(&self, facet: &Facet) -> [MaterialId; 2] {
        [self.material(facet.tetrahedron), self.material(self.labelled.across(facet))]
    }

    /// Whether a material meets others at the stratum of a point.
    pub fn meets(&self, point: u32, id: MaterialId) -> bool {
        meeting(&self.strata, &self.crowded, point).contains(&id)
    }

    /// Mean target edge length of some points, mm.
    fn size_of(&self, points: &[u32]) -> f64 {
        points.iter().map(|&v| self.sizes[v as usize]).sum::<f64>() / points.len() as f64
    }

    /// Length of a segment, mm.
    pub fn length(&self, [a, b]: Segment) -> f64 {
        self.points()[a as usize].distance(self.points()[b as usize])
    }

    /// A tetrahedron that has an edge, if there is one.
    pub fn at_edge(&self, [a, b]: [u32; 2]) -> Option<u32> {
        let delaunay = self.labelled.delaunay();
        star(delaunay, a).into_iter().find(|&t| delaunay.vertices(t).contains(&b))
    }

    /// The facet between two materials on three points, if there is one.
    pub fn facet_on(&self, vertices: [u32; 3]) -> Option<Facet> {
        self.labelled.facets_at(vertices[0]).into_iter().find(|f| f.sorted() == vertices)
    }

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

/// The materials that meet at a point.
fn meeting<'a>(strata: &'a [Stratum], crowded: &'a Crowded, point: u32) -> &'a [MaterialId] {
    crowded.get(&point).map_or_else(|| strata[point as usize].materials(), Vec::as_slice)
}

/// The material of a tetrahedron: of those that meet at all of its vertices the one with the smallest indicator at its circumcentre. A tetrahedron across a
/// layer has vertices on both sides of it, at which the layer's material alone meets; its circumcentre may lie far beyond the layer. Where none meets at all
/// vertices, the material at the circumcentre.
fn material_of(
    indicators: &dyn Indicators,
    strata: &[Stratum],
    crowded: &Crowded,
    delaunay: &Delaunay,
    tetrahedron: u32,
    centre: Option<DVec3>,
) -> MaterialId {
    let vertices = delaunay.vertices(tetrahedron);
    let is_common = |id: &MaterialId| vertices[1..].iter().all(|&v| meeting(strata, crowded, v).contains(id));
    let first = meeting(strata, crowded, vertices[0]);
    let common = || first.iter().copied().filter(is_common);
    if let (Some(only), None) = (common().next(), common().nth(1)) {
        return only;
    }
    let at_centre = centre.map_or(MaterialId::OUTSIDE, |p| indicators.material_at(p));
    if common().next().is_none() || common().any(|id| id == at_centre) {
        return at_centre;
    }
    let centroid = vertices.iter().map(|&v| delaunay.points()[v as usize]).sum::<DVec3>() / 4.0;
    let from = centre.unwrap_or(centroid);
    let known = |step: i32| {
        let near = indicators.near(from.lerp(centroid, f64::from(step) / f64::from(STEPS)));
        near.entries().iter().map(|(id, _)| *id).find(|id| common().any(|own| own == *id))
    };
    (0..=STEPS).find_map(known).unwrap_or(at_centre)
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
