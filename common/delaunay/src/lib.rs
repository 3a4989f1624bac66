#![doc = include_str!("../README.md")]
//!
//! # Ghost tetrahedra
//!
//! *Ghost* tetrahedra connect each hull triangle to a vertex at infinity ([`INFINITE`]), so every
//! tetrahedron has four neighbours and the boundary needs no special cases. A symbolic perturbation
//! (see [`predicates`]) breaks ties of the in-sphere test. It depends only on the point indices, so
//! the triangulation does not depend on the insertion order.

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

/// Index of the vertex at infinity, which belongs to every ghost tetrahedron.
pub const INFINITE: u32 = u32::MAX;

/// First vertex of every removed tetrahedron, as a marker.
const DEAD: u32 = u32::MAX - 1;

/// Maximum absolute value of a coordinate. The in-sphere determinant is a polynomial of degree 5,
/// so its terms are at most of the order of 1e250. The largest double is 1.8e308.
const LARGEST_COORDINATE: f64 = 1e50;

/// Minimum absolute value of a nonzero coordinate. Smaller values are set to zero, so that the
/// exact predicates never underflow. Nonzero differences between coordinates are at least 2^-53
/// times this constant. Products of five differences are at least 1.7e-280, above the smallest
/// normal double, 2.2e-308.
const SMALLEST_COORDINATE: f64 = 1e-40;

#[derive(Clone, Copy, Debug)]
struct Tetrahedron {
    vertices: [u32; 4],
    /// Entry i describes the neighbour across the facet opposite vertex i: the index of the
    /// neighbour times 4, plus the index of the facet in the neighbour.
    neighbours: [u32; 4],
}

/// Result of [`Delaunay::insert`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Insertion {
    /// The point was inserted as a new vertex with this index.
    New(u32),
    /// A vertex with this index already has exactly these coordinates.
    Duplicate(u32),
}

/// Memory use and number of tetrahedra of a triangulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryUse {
    /// Bytes allocated by the triangulation, including spare capacity.
    pub bytes: usize,
    /// Number of tetrahedra, including ghosts.
    pub tetrahedra: usize,
    /// Number of tetrahedron slots, including the slots of removed tetrahedra.
    pub slots: usize,
}

/// Delaunay triangulation of a set of points. Further points can be inserted later.
#[derive(Clone, Debug)]
pub struct Delaunay {
    points: Vec<DVec3>,
    /// For every point, the index of the first point with the same coordinates.
    first: Vec<u32>,
    vertex_count: usize,
    cells: Cells,
    /// For every vertex, one tetrahedron that contains it. The value is `u32::MAX` for duplicates.
    incident: Vec<u32>,
}

impl Delaunay {
    /// Triangulates points (in any unit), using all cores for large sets. The same points give the
    /// same tetrahedra with the same indices on any number of threads.
    ///
    /// # Errors
    /// If there are fewer than four distinct points, if all points lie in one plane, if a
    /// coordinate is not finite or exceeds 1e50 in absolute value, or if there are too many points
    /// or tetrahedra ([`Error::TooManyPoints`], [`Error::TooManyTetrahedra`]).
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
        // Store the points in insertion order for locality. The caller's indices are restored at
        // the end.
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

    /// Returns all points, including duplicates. The points passed to [`Delaunay::new`] precede
    /// those inserted later.
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// Returns the number of distinct points.
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// Returns the first point with the same coordinates as `point`, or `None` if `point` itself is
    /// the first. Duplicates do not belong to any tetrahedron.
    pub fn duplicate_of(&self, point: u32) -> Option<u32> {
        let first = self.first[point as usize];
        (first != point).then_some(first)
    }

    /// Returns one more than the largest tetrahedron index. Smaller indices may be unused.
    pub fn slot_count(&self) -> usize {
        self.cells.tetrahedra.len()
    }

    /// Returns whether a tetrahedron has not been removed.
    pub fn is_alive(&self, tetrahedron: u32) -> bool {
        self.cells.tetrahedra[tetrahedron as usize].vertices[0] != DEAD
    }

    /// Returns whether a tetrahedron connects a hull triangle to infinity.
    pub fn is_ghost(&self, tetrahedron: u32) -> bool {
        self.cells.tetrahedra[tetrahedron as usize].vertices.contains(&INFINITE)
    }

    /// Returns all tetrahedra as (index, vertices). Finite tetrahedra have positive volume. A ghost
    /// contains [`INFINITE`]. If this vertex is replaced with any point beyond the hull triangle,
    /// the volume is also positive.
    pub fn tetrahedra(&self) -> impl Iterator<Item = (u32, [u32; 4])> + '_ {
        let all = self.cells.tetrahedra.iter().enumerate();
        all.filter(|(_, t)| t.vertices[0] != DEAD).map(|(i, t)| (i as u32, t.vertices))
    }

    /// Returns all tetrahedra as (index, vertices), like [`Delaunay::tetrahedra`], but as a
    /// parallel iterator.
    pub fn par_tetrahedra(&self) -> impl ParallelIterator<Item = (u32, [u32; 4])> + '_ {
        let all = self.cells.tetrahedra.par_iter().enumerate();
        all.filter(|(_, t)| t.vertices[0] != DEAD).map(|(i, t)| (i as u32, t.vertices))
    }

    /// Returns the finite tetrahedra as (index, vertices).
    pub fn finite_tetrahedra(&self) -> impl Iterator<Item = (u32, [u32; 4])> + '_ {
        self.tetrahedra().filter(|(_, vertices)| !vertices.contains(&INFINITE))
    }

    /// Returns the vertices of a tetrahedron.
    pub fn vertices(&self, tetrahedron: u32) -> [u32; 4] {
        self.cells.tetrahedra[tetrahedron as usize].vertices
    }

    /// Returns the neighbours of a tetrahedron. Neighbour i lies across the facet opposite vertex
    /// i.
    pub fn neighbours(&self, tetrahedron: u32) -> [u32; 4] {
        self.cells.tetrahedra[tetrahedron as usize].neighbours.map(|n| n >> 2)
    }

    /// Returns the facet opposite vertex i of a tetrahedron. The vertices are counter-clockwise as
    /// seen from outside the tetrahedron.
    pub fn facet(&self, tetrahedron: u32, i: usize) -> [u32; 3] {
        let v = self.vertices(tetrahedron);
        FACETS[i].map(|k| v[k])
    }

    /// Returns one tetrahedron that contains a vertex, or `None` for a duplicate.
    pub fn incident(&self, vertex: u32) -> Option<u32> {
        self.incident.get(vertex as usize).copied().filter(|&t| t != u32::MAX)
    }

    /// Returns the circumcentre of a tetrahedron, or `None` for a ghost or a removed tetrahedron,
    /// or if the centre is not finite. The result is accurate even for a thin tetrahedron, because
    /// the computation uses [`predicates::volume`] and coordinates relative to one vertex.
    pub fn circumcentre(&self, tetrahedron: u32) -> Option<DVec3> {
        let v = self.vertices(tetrahedron);
        if v.contains(&INFINITE) || v[0] == DEAD {
            return None;
        }
        circumcentre(v.map(|i| self.points[i as usize]))
    }

    /// Returns the memory use and the number of tetrahedra.
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

    /// Inserts a point. The search for its position starts at the vertex `near`, or at the last
    /// inserted point if `near` is `None`. [`Delaunay::created`] then returns the new tetrahedra.
    ///
    /// # Errors
    /// If a coordinate is not finite or exceeds 1e50 in absolute value, or if there are more than
    /// 2^29 tetrahedra.
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

    /// Stores a tetrahedron as the incident tetrahedron of each of its finite vertices.
    fn note_incident(&mut self, t: u32) {
        let vertices = self.cells.tetrahedra[t as usize].vertices;
        if vertices[0] != DEAD {
            for v in vertices.into_iter().filter(|&v| v != INFINITE) {
                self.incident[v as usize] = t;
            }
        }
    }

    /// Returns the tetrahedra that the last insertion created, including ghosts. They may reuse the
    /// indices of removed tetrahedra.
    pub fn created(&self) -> &[u32] {
        self.cells.work.created()
    }
}

/// Panic message for operations that fail at a cut between regions. A whole triangulation has no
/// cuts, so the panic cannot occur.
const WHOLE: &str = "a whole triangulation has all tetrahedra";

/// Facet opposite each vertex of a positively oriented tetrahedron. The vertices are
/// counter-clockwise as seen from outside.
const FACETS: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Computes the centre of the sphere through four points. Returns `None` if it is not finite.
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

/// Finds four points that are not coplanar. Returns their positions in the insertion order,
/// arranged so that the tetrahedron is positively oriented.
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
