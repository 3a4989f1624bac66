//! Delaunay triangulation of points in space: incremental insertion (Bowyer 1981, Watson 1981) along a Hilbert curve
//! in rounds, with exact predicates, large rounds on several threads.
//!
//! The convex hull is closed by *ghost* tetrahedra that join each hull triangle to a vertex at infinity
//! ([`INFINITE`]), so every tetrahedron has four neighbours and nothing needs a case of its own at the border. Points
//! on one sphere, in one plane or on one line, on a grid or given twice are all in order: in-sphere ties are broken by
//! a symbolic perturbation (see [`predicates`]) that depends on the index of the points alone, so the triangulation of a
//! given list of points is unique, whatever the order of insertion. Only input whose points all lie in one plane is
//! refused, because it has no tetrahedra.
//!
//! The same points give the same tetrahedra with the same numbers on any number of threads. Half a million points of a
//! surface take about as long as CGAL's triangulation does (`make bench-delaunay` puts both in one table).
//!
//! ```
//! use glam::DVec3;
//! use isoparticles_delaunay::{Delaunay, Insertion};
//!
//! let corners: Vec<DVec3> = (0..8u8).map(|n| DVec3::new(f64::from(n & 1), f64::from(n >> 1 & 1), f64::from(n >> 2))).collect();
//! let mut cube = Delaunay::new(&corners)?;
//! let volume = |d: &Delaunay| -> f64 {
//!     let at = |v: u32| d.points()[v as usize];
//!     let six = |[a, b, c, e]: [u32; 4]| (at(b) - at(a)).cross(at(c) - at(a)).dot(at(e) - at(a));
//!     d.finite_tetrahedra().map(|(_, vertices)| six(vertices) / 6.0).sum()
//! };
//! assert!((volume(&cube) - 1.0).abs() < 1e-12);
//!
//! // A further point, and the tetrahedra that its insertion made.
//! assert_eq!(cube.insert(DVec3::splat(0.5), None)?, Insertion::New(8));
//! assert!(cube.created().iter().all(|&t| cube.vertices(t).contains(&8)));
//! assert!((volume(&cube) - 1.0).abs() < 1e-12);
//! # Ok::<(), isoparticles_delaunay::Error>(())
//! ```

mod error;
mod exact;
mod insert;
mod order;
pub mod predicates;
mod regions;
#[cfg(test)]
mod tests;

pub use error::{Error, Result};

use glam::DVec3;
use insert::{Cells, Sites};
use order::Order;
use predicates::{collinear, orientation, volume};
use rayon::prelude::*;
use regions::Cutting;

/// The vertex at infinity, in the vertex list of ghost tetrahedra.
pub const INFINITE: u32 = u32::MAX;

/// In the first place of the vertex list of a tetrahedron that is no longer there.
const DEAD: u32 = u32::MAX - 1;

/// Largest coordinate: its fifth power, the degree of the in-sphere determinant, is still finite.
const LARGEST_COORDINATE: f64 = 1e50;

/// Coordinates nearer to zero than this are taken as zero, so that the exact predicates never underflow.
const SMALLEST_COORDINATE: f64 = 1e-40;

#[derive(Clone, Copy, Debug)]
struct Tetrahedron {
    vertices: [u32; 4],
    /// Across the facet opposite to the vertex at `i`: number of the neighbour times 4, plus the place that the facet has
    /// there.
    neighbours: [u32; 4],
}

/// What became of a point given to [`Delaunay::insert`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Insertion {
    /// It is a new vertex with this index.
    New(u32),
    /// There was already a vertex at this very place.
    Duplicate(u32),
}

/// Counts and bytes, for reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryUse {
    /// Bytes that the triangulation holds, spare capacity included.
    pub bytes: usize,
    /// Tetrahedra, ghosts included.
    pub tetrahedra: usize,
    /// Places kept for tetrahedra, free ones included.
    pub slots: usize,
}

/// Delaunay triangulation of a set of points, open to further points.
#[derive(Clone, Debug)]
pub struct Delaunay {
    points: Vec<DVec3>,
    /// For every point, the first one at the same place.
    first: Vec<u32>,
    vertex_count: usize,
    cells: Cells,
    /// A tetrahedron at each vertex.
    incident: Vec<u32>,
}

impl Delaunay {
    /// Triangulates points (any unit), on all cores where there are many. The same points give the same tetrahedra with the
    /// same numbers on any number of threads.
    ///
    /// # Errors
    /// Fewer than four distinct points, all points in one plane, a coordinate that is not finite or larger than 1e50,
    /// more than 2^29 tetrahedra on the way.
    pub fn new(points: &[DVec3]) -> Result<Self> {
        Self::with_cutting(points, Cutting::USUAL)
    }

    fn with_cutting(points: &[DVec3], cutting: Cutting) -> Result<Self> {
        let points = points.iter().map(|&p| admissible(p)).collect::<Result<Vec<_>>>()?;
        if points.len() >= DEAD as usize {
            return Err(Error::TooManyPoints(points.len()));
        }
        let Order { order, rounds, first } = order::insertion_order(&points);
        let seeds = first_simplex(&points, &order)?;
        // the points in the order of insertion, for locality; named by the caller's indices again at the end
        let sorted: Vec<DVec3> = order.iter().map(|&i| points[i as usize]).collect();
        let mut cells = regions::triangulate(Sites { points: &sorted, named: &order }, &rounds, seeds, cutting)?;
        drop(sorted);
        cells.tetrahedra.par_iter_mut().filter(|t| t.vertices[0] != DEAD).for_each(|t| {
            for v in t.vertices.iter_mut().filter(|v| **v != INFINITE) {
                *v = order[*v as usize];
            }
        });
        let incident = vec![u32::MAX; points.len()];
        let mut built = Self { points, first, vertex_count: order.len(), cells, incident };
        for t in 0..built.cells.tetrahedra.len() as u32 {
            built.note_incident(t);
        }
        Ok(built)
    }

    /// The points, those given twice included; indices are those of the input, then of the insertions.
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// Distinct points.
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// The first point at the same place as this one, when that is another one; such a point is in no tetrahedron.
    pub fn duplicate_of(&self, point: u32) -> Option<u32> {
        let first = self.first[point as usize];
        (first != point).then_some(first)
    }

    /// One more than the largest tetrahedron number in use; numbers below it may be free.
    pub fn slot_count(&self) -> usize {
        self.cells.tetrahedra.len()
    }

    /// Whether a number names a tetrahedron (it does not when that one was removed).
    pub fn is_alive(&self, tetrahedron: u32) -> bool {
        self.cells.tetrahedra[tetrahedron as usize].vertices[0] != DEAD
    }

    /// Whether a tetrahedron joins a hull triangle to infinity.
    pub fn is_ghost(&self, tetrahedron: u32) -> bool {
        self.cells.tetrahedra[tetrahedron as usize].vertices.contains(&INFINITE)
    }

    /// All tetrahedra, ghosts included (they have [`INFINITE`] among their vertices), as (number, vertices). Finite ones
    /// have positive volume; a ghost would have it with any point beyond its hull triangle in the place of infinity.
    pub fn tetrahedra(&self) -> impl Iterator<Item = (u32, [u32; 4])> + '_ {
        let all = self.cells.tetrahedra.iter().enumerate();
        all.filter(|(_, t)| t.vertices[0] != DEAD).map(|(i, t)| (i as u32, t.vertices))
    }

    /// The same as a parallel iterator.
    pub fn par_tetrahedra(&self) -> impl ParallelIterator<Item = (u32, [u32; 4])> + '_ {
        let all = self.cells.tetrahedra.par_iter().enumerate();
        all.filter(|(_, t)| t.vertices[0] != DEAD).map(|(i, t)| (i as u32, t.vertices))
    }

    /// The finite tetrahedra, as (number, vertices).
    pub fn finite_tetrahedra(&self) -> impl Iterator<Item = (u32, [u32; 4])> + '_ {
        self.tetrahedra().filter(|(_, vertices)| !vertices.contains(&INFINITE))
    }

    /// Vertices of a tetrahedron.
    pub fn vertices(&self, tetrahedron: u32) -> [u32; 4] {
        self.cells.tetrahedra[tetrahedron as usize].vertices
    }

    /// Neighbours of a tetrahedron; the one at `i` lies across the facet opposite to the vertex at `i`.
    pub fn neighbours(&self, tetrahedron: u32) -> [u32; 4] {
        self.cells.tetrahedra[tetrahedron as usize].neighbours.map(|n| n >> 2)
    }

    /// The facet of a tetrahedron opposite to its vertex at `i`, counter-clockwise seen from outside the tetrahedron.
    pub fn facet(&self, tetrahedron: u32, i: usize) -> [u32; 3] {
        let v = self.vertices(tetrahedron);
        FACETS[i].map(|k| v[k])
    }

    /// Some tetrahedron at a vertex; `None` for a duplicate.
    pub fn incident(&self, vertex: u32) -> Option<u32> {
        self.incident.get(vertex as usize).copied().filter(|&t| t != u32::MAX)
    }

    /// Centre of the sphere through a tetrahedron, reckoned relative to one of its vertices and with the exact volume, so
    /// that a thin tetrahedron gives a far point rather than a wrong one; `None` for a ghost or beyond the numbers.
    pub fn circumcentre(&self, tetrahedron: u32) -> Option<DVec3> {
        let v = self.vertices(tetrahedron);
        if v.contains(&INFINITE) || v[0] == DEAD {
            return None;
        }
        circumcentre(v.map(|i| self.points[i as usize]))
    }

    /// Bytes held, and tetrahedra.
    pub fn memory(&self) -> MemoryUse {
        let words = self.first.capacity() + self.cells.free.capacity() + self.incident.capacity();
        MemoryUse {
            bytes: self.points.capacity() * size_of::<DVec3>()
                + self.cells.tetrahedra.capacity() * size_of::<Tetrahedron>()
                + words * size_of::<u32>()
                + self.cells.work.bytes(),
            tetrahedra: self.cells.tetrahedra.len() - self.cells.free.len(),
            slots: self.cells.tetrahedra.len(),
        }
    }

    /// Adds a point. `near` names a vertex to start looking from; without it, the last insertion is taken.
    /// The tetrahedra made are then in [`Delaunay::created`].
    ///
    /// # Errors
    /// A coordinate that is not finite or larger than 1e50; more than 2^29 tetrahedra.
    pub fn insert(&mut self, point: DVec3, near: Option<u32>) -> Result<Insertion> {
        let point = admissible(point)?;
        self.cells.check_room()?;
        let start = near.and_then(|v| self.incident(v)).unwrap_or(self.cells.last);
        let sites = Sites { points: &self.points, named: &[] };
        let at = self.cells.locate(sites, point, start).expect(WHOLE);
        let twin = self.vertices(at).into_iter().find(|&v| v != INFINITE && self.points[v as usize] == point);
        if let Some(v) = twin {
            return Ok(Insertion::Duplicate(v));
        }
        let v = self.points.len() as u32;
        self.points.push(point);
        self.first.push(v);
        self.incident.push(u32::MAX);
        self.vertex_count += 1;
        self.cells.insert_at(Sites { points: &self.points, named: &[] }, v, at).expect(WHOLE);
        for k in 0..self.created().len() {
            self.note_incident(self.created()[k]);
        }
        Ok(Insertion::New(v))
    }

    fn note_incident(&mut self, t: u32) {
        let vertices = self.cells.tetrahedra[t as usize].vertices;
        if vertices[0] != DEAD {
            for v in vertices.into_iter().filter(|&v| v != INFINITE) {
                self.incident[v as usize] = t;
            }
        }
    }

    /// Tetrahedra made by the last insertion, ghosts included; they may bear the numbers of removed ones.
    pub fn created(&self) -> &[u32] {
        self.cells.work.created()
    }
}

/// Why nothing lies beyond a cut.
const WHOLE: &str = "a whole triangulation has all tetrahedra";

/// Facet opposite to each vertex of a positive tetrahedron, counter-clockwise seen from outside.
const FACETS: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Centre of the sphere through four points; `None` when it is not finite.
pub fn circumcentre([a, b, c, d]: [DVec3; 4]) -> Option<DVec3> {
    let (u, v, w) = (b - a, c - a, d - a);
    let volume = volume(a, b, c, d);
    let numerator = v.cross(w) * u.length_squared() + w.cross(u) * v.length_squared() + u.cross(v) * w.length_squared();
    let centre = a + numerator / (2.0 * volume);
    centre.is_finite().then_some(centre)
}

fn admissible(p: DVec3) -> Result<DVec3> {
    if !p.is_finite() || p.abs().max_element() > LARGEST_COORDINATE {
        return Err(Error::Coordinate(p));
    }
    // also turns -0 into 0
    Ok(DVec3::from_array(p.to_array().map(|x| if x.abs() < SMALLEST_COORDINATE { 0.0 } else { x })))
}

/// Places in the order of four points that do not lie in one plane.
fn first_simplex(points: &[DVec3], order: &[u32]) -> Result<[u32; 4]> {
    let at = |place: usize| points[order[place] as usize];
    if order.len() < 4 {
        return Err(Error::TooFew(order.len()));
    }
    let third = (2..order.len()).find(|&i| !collinear(at(0), at(1), at(i)));
    let third = third.ok_or(Error::Collinear(points.len()))?;
    let fourth = (2..order.len()).find(|&i| orientation(at(0), at(1), at(third), at(i)) != 0.0);
    let fourth = fourth.ok_or(Error::Coplanar(points.len()))?;
    let simplex = [0, 1, third as u32, fourth as u32];
    Ok(if orientation(at(0), at(1), at(third), at(fourth)) > 0.0 {
        simplex
    } else {
        [simplex[1], simplex[0], simplex[2], simplex[3]]
    })
}
