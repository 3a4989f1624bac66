//! Three-dimensional Delaunay triangulation by incremental insertion (Bowyer 1981, Watson 1981)
//! with exact predicates. Points are inserted in rounds along a Hilbert curve; large rounds run on
//! several threads.
//!
//! *Ghost* tetrahedra connect each hull triangle to a vertex at infinity ([`INFINITE`]), so every
//! tetrahedron has four neighbours and the boundary needs no special cases. Cospherical, coplanar
//! and collinear points, grids and duplicates are all allowed. A symbolic perturbation (see
//! [`predicates`]) breaks in-sphere ties. It depends only on the point indices, so the
//! triangulation of a given point list is unique for any insertion order. Only input whose points
//! all lie in one plane is refused, because it has no tetrahedra.
//!
//! The same points give the same tetrahedra with the same numbers on any number of threads. For
//! half a million surface points the speed is about that of CGAL (`make bench-delaunay` compares
//! both).
//!
//! ```
//! use glam::DVec3;
//! use isoparticles_delaunay::{Delaunay, Insertion};
//!
//! let corners: Vec<DVec3> = (0..8u8)
//!     .map(|n| DVec3::new(f64::from(n & 1), f64::from(n >> 1 & 1), f64::from(n >> 2)))
//!     .collect();
//! let mut cube = Delaunay::new(&corners)?;
//! let volume = |d: &Delaunay| -> f64 {
//!     let at = |v: u32| d.points()[v as usize];
//!     let six = |[a, b, c, e]: [u32; 4]| (at(b) - at(a)).cross(at(c) - at(a)).dot(at(e) - at(a));
//!     d.finite_tetrahedra().map(|(_, vertices)| six(vertices) / 6.0).sum()
//! };
//! assert!((volume(&cube) - 1.0).abs() < 1e-12);
//!
//! // Insert another point, and look at the tetrahedra that it created.
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

/// First vertex of a removed tetrahedron.
const DEAD: u32 = u32::MAX - 1;

/// Largest coordinate: its fifth power, the degree of the in-sphere determinant, is still finite.
const LARGEST_COORDINATE: f64 = 1e50;

/// Coordinates closer to zero than this are set to zero, so that the exact predicates never
/// underflow.
const SMALLEST_COORDINATE: f64 = 1e-40;

#[derive(Clone, Copy, Debug)]
struct Tetrahedron {
    vertices: [u32; 4],
    /// Entry i describes the neighbour across the facet opposite vertex i: its number times 4, plus
    /// the place of the facet in the neighbour.
    neighbours: [u32; 4],
}

/// Result of [`Delaunay::insert`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Insertion {
    /// The point is a new vertex with this index.
    New(u32),
    /// A vertex with this index already has exactly these coordinates.
    Duplicate(u32),
}

/// Tetrahedron counts and memory use, for reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryUse {
    /// Bytes allocated by the triangulation, including spare capacity.
    pub bytes: usize,
    /// Number of tetrahedra, including ghosts.
    pub tetrahedra: usize,
    /// Number of tetrahedron slots, including free ones.
    pub slots: usize,
}

/// Delaunay triangulation of a set of points. More points can be inserted.
#[derive(Clone, Debug)]
pub struct Delaunay {
    points: Vec<DVec3>,
    /// For every point, the first point with the same coordinates.
    first: Vec<u32>,
    vertex_count: usize,
    cells: Cells,
    /// One tetrahedron at each vertex; `u32::MAX` for duplicates.
    incident: Vec<u32>,
}

impl Delaunay {
    /// Triangulates points (any unit), using all cores for large sets. The same points give the
    /// same tetrahedra with the same numbers on any number of threads.
    ///
    /// # Errors
    /// If there are fewer than four distinct points or all points lie in one plane. If a coordinate
    /// is not finite or exceeds 1e50. If more than 2^29 tetrahedra are needed on the way.
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

    /// All points, duplicates included: those of the input, then the inserted ones.
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// Number of distinct points.
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// The first point with the same coordinates, if that is another point. Duplicates are in no
    /// tetrahedron.
    pub fn duplicate_of(&self, point: u32) -> Option<u32> {
        let first = self.first[point as usize];
        (first != point).then_some(first)
    }

    /// One more than the largest tetrahedron number in use. Some numbers below it may be free.
    pub fn slot_count(&self) -> usize {
        self.cells.tetrahedra.len()
    }

    /// Whether a number denotes a tetrahedron; false if that one was removed.
    pub fn is_alive(&self, tetrahedron: u32) -> bool {
        self.cells.tetrahedra[tetrahedron as usize].vertices[0] != DEAD
    }

    /// Whether a tetrahedron connects a hull triangle to infinity.
    pub fn is_ghost(&self, tetrahedron: u32) -> bool {
        self.cells.tetrahedra[tetrahedron as usize].vertices.contains(&INFINITE)
    }

    /// All tetrahedra as (number, vertices). Finite ones have positive volume. Ghosts contain
    /// [`INFINITE`]; replacing it with any point beyond the hull triangle gives a positive volume,
    /// too.
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

    /// Neighbours of a tetrahedron; neighbour i lies across the facet opposite vertex i.
    pub fn neighbours(&self, tetrahedron: u32) -> [u32; 4] {
        self.cells.tetrahedra[tetrahedron as usize].neighbours.map(|n| n >> 2)
    }

    /// The facet of a tetrahedron opposite its vertex i, counter-clockwise as seen from outside the
    /// tetrahedron.
    pub fn facet(&self, tetrahedron: u32, i: usize) -> [u32; 3] {
        let v = self.vertices(tetrahedron);
        FACETS[i].map(|k| v[k])
    }

    /// One tetrahedron at a vertex; `None` for a duplicate.
    pub fn incident(&self, vertex: u32) -> Option<u32> {
        self.incident.get(vertex as usize).copied().filter(|&t| t != u32::MAX)
    }

    /// Circumcentre of a tetrahedron. Computed relative to one of its vertices and with the exact
    /// volume, so a thin tetrahedron gives a distant centre instead of a wrong one. `None` for a
    /// ghost or if the centre is not finite.
    pub fn circumcentre(&self, tetrahedron: u32) -> Option<DVec3> {
        let v = self.vertices(tetrahedron);
        if v.contains(&INFINITE) || v[0] == DEAD {
            return None;
        }
        circumcentre(v.map(|i| self.points[i as usize]))
    }

    /// Memory use and tetrahedron counts.
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

    /// Inserts a point. The search starts at the vertex `near`, or at the last insertion if it is
    /// `None`. [`Delaunay::created`] then lists the new tetrahedra.
    ///
    /// # Errors
    /// If a coordinate is not finite or exceeds 1e50, or if there are more than 2^29 tetrahedra.
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

    /// Records a tetrahedron as the incident one of each of its finite vertices.
    fn note_incident(&mut self, t: u32) {
        let vertices = self.cells.tetrahedra[t as usize].vertices;
        if vertices[0] != DEAD {
            for v in vertices.into_iter().filter(|&v| v != INFINITE) {
                self.incident[v as usize] = t;
            }
        }
    }

    /// Tetrahedra created by the last insertion, including ghosts. They may reuse the numbers of
    /// removed ones.
    pub fn created(&self) -> &[u32] {
        self.cells.work.created()
    }
}

/// Why operations on a whole triangulation never meet a cut.
const WHOLE: &str = "a whole triangulation has all tetrahedra";

/// Facet opposite each vertex of a positively oriented tetrahedron, counter-clockwise as seen from
/// outside.
const FACETS: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Centre of the sphere through four points; `None` if it is not finite.
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

/// Positions in the insertion order of four points that do not lie in one plane, positively
/// oriented.
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
