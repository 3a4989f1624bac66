//! Voronoi cells of Tight Cocone: their vertices, poles and flatness, and the candidate facets,
//! whose dual edges intersect the cocones (Amenta and Bern 1999; Amenta, Choi, Dey and Leekha 2000;
//! Dey and Giesen 2001).

use crate::around::place_of;
use glam::DVec3;
use isoparticles_delaunay::{Delaunay, INFINITE};
use rayon::prelude::*;

/// Sine of pi/8, the angle between the tangent plane and the boundary of the cocone.
const COCONE: f64 = 0.382_683_432_365_089_8;

/// Minimum ratio of the length (distance to the nearer pole) and the width of a flat cell.
const FLATNESS_RATIO: f64 = 1.2;

/// Cosine of pi/3, the maximum angle between the normals of a flat vertex and of its cocone
/// neighbours.
const FLATNESS_COSINE: f64 = 0.5;

/// Denotes a missing tetrahedron.
pub(super) const NOBODY: u32 = u32::MAX;

/// The tetrahedra at each vertex, including ghosts, ascending.
pub(super) struct Stars {
    starts: Vec<u32>,
    tetrahedra: Vec<u32>,
}

impl Stars {
    pub(super) fn new(delaunay: &Delaunay) -> Self {
        let mut starts = vec![0u32; delaunay.points().len() + 2];
        let vertices = |t: [u32; 4]| t.into_iter().filter(|&v| v != INFINITE);
        for v in delaunay.tetrahedra().flat_map(|(_, t)| vertices(t)) {
            starts[v as usize + 2] += 1;
        }
        for v in 1..starts.len() {
            starts[v] += starts[v - 1];
        }
        // `starts[v + 1]` advances from the start to the end of star v, which is the start of star
        // v + 1
        let mut tetrahedra = vec![0; starts[starts.len() - 1] as usize];
        for (t, vertices_of_t) in delaunay.tetrahedra() {
            for v in vertices(vertices_of_t) {
                let next = &mut starts[v as usize + 1];
                tetrahedra[*next as usize] = t;
                *next += 1;
            }
        }
        starts.pop();
        Self { starts, tetrahedra }
    }

    /// Returns the tetrahedra at a vertex.
    pub(super) fn of(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.tetrahedra[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    /// Returns the index range of a vertex in the concatenation of all stars.
    pub(super) fn range(&self, vertex: u32) -> std::ops::Range<usize> {
        self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize
    }

    /// Returns the number of vertices, including duplicates, whose stars are empty.
    pub(super) fn vertex_count(&self) -> usize {
        self.starts.len() - 1
    }
}

/// Properties of the Voronoi cell of a vertex.
#[derive(Clone, Copy)]
struct Cell {
    /// Unit normal of the surface at the vertex, up to sign.
    normal: DVec3,
    /// Tetrahedra whose circumcentres are the poles: the farthest on the side of the normal, and
    /// the farthest on the other side.
    poles: [u32; 2],
    /// Whether the cell is long along the normal. With a given normal, it only needs to have both
    /// poles.
    is_long: bool,
    /// For a vertex on the convex hull, 1 if the normal points out of it and -1 if it points into
    /// it. Otherwise 0.
    hull_side: i8,
    /// Cosine between the estimated normal (outward on the hull) and the given one; 0 if none is
    /// given.
    agreement: f64,
}

/// The Voronoi cells of all vertices, and the candidate facets.
pub(super) struct Cells<'a> {
    pub(super) delaunay: &'a Delaunay,
    pub(super) stars: Stars,
    /// Circumcentre of each tetrahedron. For a ghost, the outward unit normal of its hull triangle.
    corners: Vec<DVec3>,
    /// Whether each tetrahedron is a ghost.
    is_ghost: Vec<bool>,
    /// Unit normal of the surface at each vertex: the given one, or an estimate up to sign.
    pub(super) normals: Vec<DVec3>,
    /// Tetrahedra of the poles of each vertex, on the side of the normal and on the other side.
    /// [`NOBODY`] denotes a missing pole.
    pub(super) poles: Vec<[u32; 2]>,
    /// Whether each vertex is flat.
    pub(super) is_flat: Vec<bool>,
    /// Share of the given normals within pi/3 of the direction to the poles, up to sign; 0 if none
    /// is given.
    pub(super) normals_near_poles: f64,
    /// Share of the given normals on the convex hull that point out of it. It is 0.5, which is
    /// undecided, if none is given.
    pub(super) normals_out_of_hull: f64,
    /// For each vertex on the convex hull, 1 if its normal points out of it and -1 if it points
    /// into it. 0 for all other vertices.
    pub(super) hull_side: Vec<i8>,
    /// Bit 4 j + k of each tetrahedron: whether the edge dual to the facet opposite vertex j
    /// intersects the cocone of vertex k.
    meetings: Vec<u16>,
    /// Bit j of each tetrahedron: whether the facet opposite vertex j is a candidate.
    candidates: Vec<u8>,
}

/// Position of a circumcentre relative to the cocone of a vertex.
const WITHIN: u8 = 0;
const ABOVE: u8 = 1;
const BELOW: u8 = 2;

impl<'a> Cells<'a> {
    /// Computes poles, flat vertices and candidates. `normals` contains the given normals, zero if
    /// unknown. A given normal replaces the direction to the pole and the test of length.
    pub(super) fn new(delaunay: &'a Delaunay, normals: Option<&[DVec3]>) -> Self {
        let stars = Stars::new(delaunay);
        let slots = delaunay.slot_count() as u32;
        let (corners, is_ghost) = (0..slots)
            .into_par_iter()
            .map(|t| (corner(delaunay, t), delaunay.is_alive(t) && delaunay.is_ghost(t)))
            .unzip();
        let count = stars.vertex_count();
        let mut cells = Self {
            delaunay,
            stars,
            corners,
            is_ghost,
            normals: Vec::new(),
            poles: Vec::new(),
            is_flat: Vec::new(),
            normals_near_poles: 0.0,
            normals_out_of_hull: 0.5,
            hull_side: Vec::new(),
            meetings: Vec::new(),
            candidates: Vec::new(),
        };
        let given = |v: u32| normals.map_or(DVec3::ZERO, |normals| normals[v as usize]);
        let reckoned: Vec<Cell> = (0..count as u32).into_par_iter().map(|v| cells.cell(v, given(v))).collect();
        cells.normals = reckoned.iter().map(|cell| cell.normal).collect();
        cells.poles = reckoned.iter().map(|cell| cell.poles).collect();
        cells.hull_side = reckoned.iter().map(|cell| cell.hull_side).collect();
        let share = |part: usize, of: usize, none: f64| if of == 0 { none } else { part as f64 / of as f64 };
        let present = || reckoned.iter().filter(|cell| cell.agreement != 0.0);
        let near_poles = present().filter(|cell| cell.agreement.abs() >= FLATNESS_COSINE).count();
        cells.normals_near_poles = share(near_poles, present().count(), 0.0);
        let hull = || present().filter(|cell| cell.hull_side != 0);
        cells.normals_out_of_hull = share(hull().filter(|cell| cell.hull_side > 0).count(), hull().count(), 0.5);
        let zones: Vec<u8> = (0..slots).into_par_iter().map(|t| cells.zones_of(t)).collect();
        cells.meetings = (0..slots).into_par_iter().map(|t| cells.meetings_of(t, &zones)).collect();
        cells.is_flat = cells.find_flat(reckoned.iter().map(|cell| cell.is_long).collect());
        cells.candidates = (0..slots).into_par_iter().map(|t| cells.candidates_of(t)).collect();
        cells
    }

    /// Returns the vector from a position to the circumcentre of a tetrahedron and `false`. For a
    /// ghost, returns the unit direction to infinity and `true`.
    fn towards(&self, t: u32, from: DVec3) -> (DVec3, bool) {
        let corner = self.corners[t as usize];
        if self.is_ghost[t as usize] { (corner, true) } else { (corner - from, false) }
    }

    fn cell(&self, v: u32, given: DVec3) -> Cell {
        let p = self.delaunay.points()[v as usize];
        let star = self.stars.of(v);
        let (mut farthest, mut hull) = ((0.0, DVec3::ZERO), DVec3::ZERO);
        let mut on_hull = false;
        for &t in star {
            let (direction, is_infinite) = self.towards(t, p);
            if is_infinite {
                hull += direction;
                on_hull = true;
            } else if direction.length_squared() > farthest.0 {
                farthest = (direction.length_squared(), direction);
            }
        }
        let estimate = if on_hull { hull } else { farthest.1 }.normalize_or_zero();
        let given = given.try_normalize();
        let normal = given.unwrap_or(estimate);
        let along_hull = hull.dot(normal);
        let (mut poles, mut heights) = ([NOBODY; 2], [0.0; 2]);
        for &t in star {
            let (direction, is_infinite) = self.towards(t, p);
            let along = direction.dot(normal);
            let side = usize::from(along < 0.0);
            if is_infinite && (along < 0.0) != (along_hull < 0.0) {
                // At a sharp edge, a hull triangle may face away from the normal. The sum of the
                // hull normals determines on which side the pole is at infinity.
                continue;
            }
            let height = if is_infinite { f64::MAX * (0.5 + 0.5 * along.abs()) } else { direction.length_squared() };
            if height > heights[side] {
                (poles[side], heights[side]) = (t, height);
            }
        }
        let reach = heights[0].min(heights[1]).sqrt();
        let is_long = !poles.contains(&NOBODY) && (given.is_some() || FLATNESS_RATIO * self.width(v, normal) <= reach);
        Cell {
            normal,
            poles,
            is_long,
            hull_side: if on_hull { along_hull.signum() as i8 } else { 0 },
            agreement: given.map_or(0.0, |given| estimate.dot(given)),
        }
    }

    /// Returns the maximum distance between a vertex and the intersections of the edges of its cell
    /// with its tangent plane, mm.
    fn width(&self, v: u32, normal: DVec3) -> f64 {
        let p = self.delaunay.points()[v as usize];
        let mut width = 0.0f64;
        for &t in self.stars.of(v) {
            let (from, from_infinite) = self.towards(t, p);
            let low = from.dot(normal);
            let vertices = self.delaunay.vertices(t);
            for (j, &n) in self.delaunay.neighbours(t).iter().enumerate() {
                if vertices[j] == v || n < t {
                    continue;
                }
                let (to, to_infinite) = self.towards(n, p);
                let high = to.dot(normal);
                if (low < 0.0) == (high < 0.0) {
                    continue;
                }
                let crossing = match (from_infinite, to_infinite) {
                    (false, false) => from + (to - from) * (low / (low - high)),
                    (false, true) => from - to * (low / high),
                    (true, false) => to - from * (high / low),
                    (true, true) => return f64::INFINITY,
                };
                width = width.max(crossing.length());
            }
        }
        width
    }

    /// Returns two bits for each vertex of a tetrahedron: whether the circumcentre is within, above
    /// or below the cocone of this vertex.
    fn zones_of(&self, t: u32) -> u8 {
        if !self.delaunay.is_alive(t) {
            return 0;
        }
        let zone = |v: u32| {
            if v == INFINITE {
                return WITHIN;
            }
            let (direction, _) = self.towards(t, self.delaunay.points()[v as usize]);
            let along = direction.dot(self.normals[v as usize]);
            let bound = COCONE * direction.length();
            if along > bound {
                ABOVE
            } else if along < -bound {
                BELOW
            } else {
                WITHIN
            }
        };
        let v = self.delaunay.vertices(t);
        (0..4).fold(0, |zones, i| zones | zone(v[i]) << (2 * i))
    }

    /// Returns the bits of `meetings` for a tetrahedron. The regions above and below a cocone are
    /// convex cones. A Voronoi edge therefore misses the cocone exactly if both its ends are in the
    /// same one.
    fn meetings_of(&self, t: u32, zones: &[u8]) -> u16 {
        if !self.delaunay.is_alive(t) {
            return 0;
        }
        let (vertices, neighbours) = (self.delaunay.vertices(t), self.delaunay.neighbours(t));
        let zone = |t: u32, place: usize| zones[t as usize] >> (2 * place) & 3;
        let mut meetings = 0;
        for (j, &n) in neighbours.iter().enumerate() {
            let beyond = self.delaunay.vertices(n);
            if (0..4).any(|k| k != j && vertices[k] == INFINITE) {
                continue;
            }
            for k in (0..4).filter(|&k| k != j) {
                let own = zone(t, k);
                if own == WITHIN || own != zone(n, place_of(beyond, vertices[k])) {
                    meetings |= 1 << (4 * j + k);
                }
            }
        }
        meetings
    }

    /// Returns whether the edge dual to the facet opposite vertex `opposite` (local index)
    /// intersects the cocone of vertex `place` of this facet.
    fn meets(&self, t: u32, opposite: usize, place: usize) -> bool {
        self.meetings[t as usize] >> (4 * opposite + place) & 1 == 1
    }

    /// Calls `hear` with the cocone neighbours found at the facets of a tetrahedron: pairs (v, w)
    /// for which the cocone of w intersects the cell of v.
    fn cocone_neighbours(&self, t: u32, mut hear: impl FnMut(u32, u32)) {
        if self.meetings[t as usize] == 0 {
            return;
        }
        let vertices = self.delaunay.vertices(t);
        for j in 0..4 {
            for k in (0..4).filter(|&k| k != j && self.meets(t, j, k)) {
                for i in (0..4).filter(|&i| i != j && i != k) {
                    hear(vertices[i], vertices[k]);
                }
            }
        }
    }

    fn agree(&self, v: u32, w: u32) -> bool {
        self.normals[v as usize].dot(self.normals[w as usize]).abs() >= FLATNESS_COSINE
    }

    /// Returns whether each vertex is flat. A vertex with a long cell is flat if its normal agrees
    /// with those of all its cocone neighbours. Further vertices with long cells become flat if
    /// their normals agree with that of a flat cocone neighbour.
    fn find_flat(&self, is_long: Vec<bool>) -> Vec<bool> {
        let apart: Vec<u32> = (0..self.corners.len() as u32)
            .into_par_iter()
            .flat_map_iter(|t| {
                let mut found = Vec::new();
                self.cocone_neighbours(t, |v, w| {
                    if is_long[v as usize] && !self.agree(v, w) {
                        found.push(v);
                    }
                });
                found
            })
            .collect();
        let mut is_flat = is_long;
        let mut left = apart;
        left.sort_unstable();
        left.dedup();
        left.iter().for_each(|&v| is_flat[v as usize] = false);
        loop {
            let joins = |v: u32| {
                let mut joins = false;
                for &t in self.stars.of(v) {
                    self.cocone_neighbours(t, |u, w| joins |= u == v && is_flat[w as usize] && self.agree(v, w));
                }
                joins
            };
            let (grown, rest): (Vec<u32>, Vec<u32>) = left.par_iter().partition(|&&v| joins(v));
            if grown.is_empty() {
                return is_flat;
            }
            grown.iter().for_each(|&v| is_flat[v as usize] = true);
            left = rest;
        }
    }

    fn candidates_of(&self, t: u32) -> u8 {
        if self.meetings[t as usize] == 0 {
            return 0;
        }
        let v = self.delaunay.vertices(t);
        let is_candidate = |j: usize| {
            let flat = || (0..4).filter(|&k| k != j && v[k] != INFINITE && self.is_flat[v[k] as usize]);
            flat().all(|k| self.meets(t, j, k)) && flat().next().is_some()
        };
        (0..4).fold(0, |bits, j| bits | u8::from(is_candidate(j)) << j)
    }

    /// Returns whether the facet of a tetrahedron opposite the vertex with local index `opposite`
    /// is a candidate.
    pub(super) fn is_candidate(&self, t: u32, opposite: usize) -> bool {
        self.candidates[t as usize] >> opposite & 1 == 1
    }
}

/// Returns the circumcentre of a tetrahedron, or the outward unit normal of the hull triangle of a
/// ghost.
fn corner(delaunay: &Delaunay, t: u32) -> DVec3 {
    let v = delaunay.vertices(t);
    if !delaunay.is_alive(t) {
        return DVec3::ZERO;
    }
    let Some(i) = v.iter().position(|&v| v == INFINITE) else {
        // Only an almost flat tetrahedron has no finite circumcentre. Its centroid replaces the
        // point at infinity.
        let middle = || v.map(|v| delaunay.points()[v as usize]).into_iter().sum::<DVec3>() / 4.0;
        return delaunay.circumcentre(t).unwrap_or_else(middle);
    };
    let [a, b, c] = delaunay.facet(t, i).map(|v| delaunay.points()[v as usize]);
    (c - a).cross(b - a).normalize_or_zero()
}
