//! Voronoi cells as the cocone sees them: corners, poles, flatness, and the facets whose dual edge meets the cocones.

use crate::around::place_of;
use glam::DVec3;
use isoparticles_delaunay::{Delaunay, INFINITE};
use rayon::prelude::*;

/// Sine of the cocone's half angle, pi/8 from the tangent plane.
const COCONE: f64 = 0.382_683_432_365_089_8;

/// A flat cell is this much longer than wide.
const FLATNESS_RATIO: f64 = 1.2;

/// Cosine of the largest angle between the normals of a flat vertex and of its cocone neighbours, pi/3.
const FLATNESS_COSINE: f64 = 0.5;

/// No tetrahedron.
pub(super) const NOBODY: u32 = u32::MAX;

/// The tetrahedra at each vertex, ghosts included, ascending.
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
        // each start runs to its end while the list is filled, and that is the start of the next
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

    /// Tetrahedra at a vertex.
    pub(super) fn of(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.tetrahedra[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    /// Places in a list aligned with that of all stars.
    pub(super) fn range(&self, vertex: u32) -> std::ops::Range<usize> {
        self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize
    }

    /// Vertices, duplicates (with no star) included.
    pub(super) fn vertex_count(&self) -> usize {
        self.starts.len() - 1
    }
}

/// A Voronoi cell.
#[derive(Clone, Copy)]
struct Cell {
    /// Unit normal of the surface at the vertex, up to its sign.
    normal: DVec3,
    /// Tetrahedra whose circumcentres are the poles: the farthest on the side of the normal, and on the other.
    poles: [u32; 2],
    /// Whether the cell is long along the normal; given normals are taken at their word.
    is_long: bool,
    /// On the convex hull 1 where the normal points out of it and -1 where it points into it, else 0.
    hull_side: i8,
    /// Cosine between the estimate of the normal (outward on the hull) and the given one; 0 where none was given.
    agreement: f64,
}

/// All Voronoi cells.
pub(super) struct Cells<'a> {
    pub(super) delaunay: &'a Delaunay,
    pub(super) stars: Stars,
    /// Circumcentre of each tetrahedron; for a ghost the unit outward normal of its hull triangle.
    corners: Vec<DVec3>,
    /// Whether each tetrahedron is a ghost.
    is_ghost: Vec<bool>,
    /// Unit normal of the surface at each vertex, up to its sign unless it was given.
    pub(super) normals: Vec<DVec3>,
    /// Poles of each vertex, as tetrahedra: on the side of the normal and on the other ([`NOBODY`] where there is none).
    pub(super) poles: Vec<[u32; 2]>,
    /// Whether each vertex passed the flatness test.
    pub(super) is_flat: Vec<bool>,
    /// Share of the given normals that, as lines, lie within pi/3 of the direction to the poles; 0 where none was given.
    pub(super) normals_near_poles: f64,
    /// Share of the normals given on the convex hull that point out of it; a half, which says nothing, where none was given.
    pub(super) normals_out_of_hull: f64,
    /// For each vertex on the convex hull 1 where its normal points out of it and -1 where it points into it; 0 for all others.
    pub(super) hull_side: Vec<i8>,
    /// A bit for each facet of each tetrahedron and each vertex of the facet, at four times the place opposite to the facet and the
    /// place of the vertex: whether the dual edge meets the cocone of the vertex.
    meetings: Vec<u16>,
    /// A bit for each facet of each tetrahedron: whether it is a candidate for the surface.
    candidates: Vec<u8>,
}

const WITHIN: u8 = 0;
const ABOVE: u8 = 1;
const BELOW: u8 = 2;

impl<'a> Cells<'a> {
    /// Reckons poles, flatness and candidates. `normals` are given ones, zero where there is none; they take the place of
    /// the direction to the pole, and of the test of length.
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

    /// Direction from a point to the corner of a tetrahedron, and whether that is at infinity.
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
                // at a sharp edge a triangle of the hull may face away from the normal; outside is where most of them face
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

    /// Largest distance from a vertex to where its cell's edges cross its tangent plane.
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

    /// Two bits for each place of a tetrahedron: its corner seen from that vertex, above, below or within the cocone.
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

    /// Above and below a cocone are convex cones, so a Voronoi edge misses it exactly when its ends lie in one of them.
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

    /// Whether the Voronoi edge dual to the facet opposite to a place meets the cocone of the facet's vertex at another.
    fn meets(&self, t: u32, opposite: usize, place: usize) -> bool {
        self.meetings[t as usize] >> (4 * opposite + place) & 1 == 1
    }

    /// Tells `hear` the cocone neighbours of vertices that a tetrahedron's facets show, as (v, w): the cocone of w reaches into the
    /// cell of v.
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

    /// Flat are the vertices with long cells whose normals agree with those of all cocone neighbours, then those with long
    /// cells that agree with a flat one.
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

    /// Whether the facet of a tetrahedron opposite to a place is a candidate for the surface.
    pub(super) fn is_candidate(&self, t: u32, opposite: usize) -> bool {
        self.candidates[t as usize] >> opposite & 1 == 1
    }
}

/// Circumcentre of a tetrahedron, or the outward normal of a ghost's hull triangle.
fn corner(delaunay: &Delaunay, t: u32) -> DVec3 {
    let v = delaunay.vertices(t);
    if !delaunay.is_alive(t) {
        return DVec3::ZERO;
    }
    let Some(i) = v.iter().position(|&v| v == INFINITE) else {
        // beyond the numbers only for a cell that is all but flat: the middle then stands for the point at infinity
        let middle = || v.map(|v| delaunay.points()[v as usize]).into_iter().sum::<DVec3>() / 4.0;
        return delaunay.circumcentre(t).unwrap_or_else(middle);
    };
    let [a, b, c] = delaunay.facet(t, i).map(|v| delaunay.points()[v as usize]);
    (c - a).cross(b - a).normalize_or_zero()
}
