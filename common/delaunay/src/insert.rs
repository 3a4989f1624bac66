//! Point location by walking, and point insertion as in Bowyer (1981) and Watson (1981). An
//! insertion removes all tetrahedra whose circumsphere contains the point, and connects the faces
//! of the resulting cavity ("walls") to the point.
//!
//! A [`Cells`] is a whole triangulation or one region of it (see [`super::regions`]). In a region,
//! an operation fails with [`Beyond`] if it would cross a cut, a boundary between regions.

use super::predicates::{in_sphere_perturbed, orientation};
use super::{DEAD, FACETS, INFINITE, Tetrahedron};
use crate::error::{Error, Result};
use glam::DVec3;

const UNKNOWN: u8 = 0;
const IN_CONFLICT: u8 = 1;
const KEPT: u8 = 2;

/// Smallest neighbour entry that marks a cut. The neighbour across a cut belongs to another region.
/// The marker of the outermost cut has the largest value. At most `Cutting::depth` (3) cuts are
/// nested, so 256 markers are more than enough.
const ELSEWHERE: u32 = u32::MAX - 255;

/// A cut, identified by its depth (0 for the outermost cut). As an error, it means that the
/// operation needs tetrahedra beyond this cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Beyond(pub(super) u32);

impl Beyond {
    /// Returns the marker stored in place of a neighbour across this cut.
    pub(super) fn neighbour(self) -> u32 {
        u32::MAX - self.0
    }

    /// Returns an error if a neighbour entry is the marker of a cut.
    #[inline]
    pub(super) fn check(neighbour: u32) -> std::result::Result<(), Self> {
        if neighbour < ELSEWHERE { Ok(()) } else { Err(Self(u32::MAX - neighbour)) }
    }
}

type Reached<T> = std::result::Result<T, Beyond>;

/// Sentinel for the entry facet of the first tetrahedron of a walk, where the walk starts.
const NOWHERE: usize = 4;

/// Maximum number of tetrahedra before an insertion. Indices have 30 bits, because neighbour
/// entries use two bits for the facet. This leaves 2^29 indices for the new tetrahedra of one
/// cavity.
const MOST_TETRAHEDRA: usize = 1 << 29;

/// Maximum number of walls for which a table of all vertex pairs is used to find the shared edges.
/// 252 walls have 252 / 2 + 2 = 128 vertices, and a table of 128^2 entries of 4 bytes (64 KiB) fits
/// in the second-level cache. For larger cavities, the edges are sorted.
const WALLS_FOR_A_TABLE: usize = 252;

/// A facet between a tetrahedron in conflict and a tetrahedron that is kept.
#[derive(Clone, Copy, Debug)]
struct Wall {
    /// The facet in the kept tetrahedron: tetrahedron * 4 + facet index.
    outside: u32,
    /// Vertices in counter-clockwise order as seen from the kept tetrahedron.
    vertices: [u32; 3],
}

/// Buffers that are reused between insertions to avoid allocations.
#[derive(Clone, Debug, Default)]
pub(super) struct Workspace {
    /// State of each tetrahedron during an insertion. All states are `UNKNOWN` between insertions.
    states: Vec<u8>,
    conflict: Vec<u32>,
    kept: Vec<u32>,
    walls: Vec<Wall>,
    created: Vec<u32>,
    /// `numbered` plus the local index of each cavity vertex, stored at index v + 1 for vertex v
    /// and at index 0 for the vertex at infinity. Smaller values are left over from earlier
    /// insertions.
    numbers: Vec<u32>,
    numbered: u32,
    /// For each directed edge (an ordered pair of local indices), the facet that contains it.
    table: Vec<u32>,
    /// The edges with their facets, to be sorted. This list replaces the table for large cavities.
    edges: Vec<(u32, u32, u32)>,
}

impl Workspace {
    pub(super) fn created(&self) -> &[u32] {
        &self.created
    }

    pub(super) fn bytes(&self) -> usize {
        let words = self.conflict.capacity()
            + self.kept.capacity()
            + self.created.capacity()
            + self.numbers.capacity()
            + self.table.capacity();
        self.states.capacity()
            + words * size_of::<u32>()
            + self.walls.capacity() * size_of::<Wall>()
            + self.edges.capacity() * size_of::<(u32, u32, u32)>()
    }

    /// Links the created tetrahedra across the edges of the walls. Each tetrahedron consists of a
    /// wall and the new vertex. Every edge belongs to two walls, which traverse it in opposite
    /// directions.
    fn join(&mut self, tetrahedra: &mut [Tetrahedron], vertices: usize) {
        if self.walls.len() > WALLS_FOR_A_TABLE {
            return self.join_by_sorting(tetrahedra);
        }
        // the walls form a triangulated sphere, so V = F / 2 + 2
        let side = self.walls.len() / 2 + 2;
        if self.table.len() < side * side {
            self.table.resize(side * side, 0);
        }
        if self.numbers.len() <= vertices || self.numbered > u32::MAX - 2 * side as u32 {
            self.numbers.clear();
            self.numbers.resize(vertices + vertices / 2 + 1, 0);
            self.numbered = 1;
        }
        let mut next = self.numbered;
        for (wall, &number) in self.walls.iter().zip(&self.created) {
            let mut number_of = |v: u32| {
                let place = &mut self.numbers[v.wrapping_add(1) as usize];
                if *place < self.numbered {
                    *place = next;
                    next += 1;
                }
                (*place - self.numbered) as usize
            };
            let [p, q, r] = wall.vertices;
            let (p, q, r) = (number_of(p), number_of(q), number_of(r));
            self.table[q * side + r] = number << 2 | 1;
            self.table[r * side + p] = number << 2 | 2;
            self.table[p * side + q] = number << 2 | 3;
        }
        debug_assert_eq!((next - self.numbered) as usize, side);
        for (wall, &number) in self.walls.iter().zip(&self.created) {
            let number_of = |v: u32| (self.numbers[v.wrapping_add(1) as usize] - self.numbered) as usize;
            let [p, q, r] = wall.vertices;
            let (p, q, r) = (number_of(p), number_of(q), number_of(r));
            let facets = [self.table[r * side + q], self.table[p * side + r], self.table[q * side + p]];
            tetrahedra[number as usize].neighbours[1..].copy_from_slice(&facets);
        }
        self.numbered = next;
    }

    /// Links the created tetrahedra like [`Workspace::join`], for any number of walls. Sorting
    /// makes the two entries of each edge adjacent.
    fn join_by_sorting(&mut self, tetrahedra: &mut [Tetrahedron]) {
        self.edges.clear();
        for (wall, &number) in self.walls.iter().zip(&self.created) {
            let [p, q, r] = wall.vertices;
            for (a, b, place) in [(q, r, 1), (r, p, 2), (p, q, 3)] {
                self.edges.push((a.min(b), a.max(b), number << 2 | place));
            }
        }
        self.edges.sort_unstable();
        for pair in self.edges.chunks_exact(2) {
            let (one, other) = (pair[0].2, pair[1].2);
            tetrahedra[(one >> 2) as usize].neighbours[(one & 3) as usize] = other;
            tetrahedra[(other >> 2) as usize].neighbours[(other & 3) as usize] = one;
        }
    }
}

fn place_of_infinity(vertices: &[u32; 4]) -> Option<usize> {
    vertices.iter().position(|&v| v == INFINITE)
}

/// The points of the triangulation. Vertices of tetrahedra are indices into this list.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sites<'a> {
    pub(super) points: &'a [DVec3],
    /// The caller's index of each point. Empty if the points are in the caller's order.
    pub(super) named: &'a [u32],
}

impl Sites<'_> {
    fn at(&self, v: u32) -> DVec3 {
        self.points[v as usize]
    }

    /// Returns the rank of a vertex in the symbolic perturbation: a hash of the caller's index. The
    /// hash multiplies by an odd number, so the ranks are distinct. If ranks increased along a
    /// surface or grid, cospherical points would be connected by fans of long tetrahedra.
    fn rank(&self, v: u32) -> u32 {
        let index = if self.named.is_empty() { v } else { self.named[v as usize] };
        index.wrapping_mul(0x9e37_79b9)
    }

    /// Returns whether the perturbed circumsphere of a tetrahedron contains vertex `v` at `point`.
    #[inline]
    fn sphere_holds(&self, vertices: &[u32; 4], v: u32, point: DVec3) -> bool {
        let [a, b, c, d] = *vertices;
        let corners = [self.at(a), self.at(b), self.at(c), self.at(d), point];
        in_sphere_perturbed(&corners, || [a, b, c, d, v].map(|u| self.rank(u)))
    }
}

/// The linked tetrahedra of a whole triangulation or of one region of it. In a region, some facets
/// lie on a cut, and operations that would cross a cut fail.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    pub(super) tetrahedra: Vec<Tetrahedron>,
    /// Indices of removed tetrahedra, available for reuse.
    pub(super) free: Vec<u32>,
    /// Tetrahedron where the next walk starts.
    pub(super) last: u32,
    pub(super) work: Workspace,
}

impl Cells {
    /// Creates a `Cells` from tetrahedra, none of which may be marked as removed (`DEAD`).
    pub(super) fn of(tetrahedra: Vec<Tetrahedron>) -> Self {
        let states = vec![UNKNOWN; tetrahedra.len()];
        Self { tetrahedra, work: Workspace { states, ..Workspace::default() }, ..Self::default() }
    }

    /// Reserves memory for more tetrahedra.
    pub(super) fn reserve(&mut self, more: usize) {
        self.tetrahedra.reserve(more);
        self.work.states.reserve(more);
    }

    /// Appends the tetrahedra of `others`. Their indices increase by the number of slots of `self`.
    /// Reserves memory for `spare` further tetrahedra. Facets on a cut remain marked.
    pub(super) fn joined_by(mut self, mut others: Self, spare: usize) -> Self {
        let offset = self.tetrahedra.len() as u32;
        others.work = Workspace::default();
        self.tetrahedra.reserve_exact(others.tetrahedra.len() + spare);
        self.tetrahedra.extend(others.tetrahedra.iter().map(|t| Tetrahedron {
            vertices: t.vertices,
            neighbours: t.neighbours.map(|n| if n < ELSEWHERE { n + (offset << 2) } else { n }),
        }));
        self.free.extend(others.free.iter().map(|t| t + offset));
        self.work.states.resize(self.tetrahedra.len(), UNKNOWN);
        self
    }

    /// Returns whether a tetrahedron has not been removed.
    pub(super) fn is_alive(&self, t: u32) -> bool {
        self.tetrahedra[t as usize].vertices[0] != DEAD
    }

    /// Creates the first tetrahedron and its four ghosts.
    pub(super) fn start(&mut self, simplex: [u32; 4]) {
        // the ghost at facet i has index i + 1, and the facet has index 0 in the ghost
        self.tetrahedra.push(Tetrahedron { vertices: simplex, neighbours: [1, 2, 3, 4].map(|ghost| ghost << 2) });
        for (i, facet) in FACETS.iter().enumerate() {
            // Seen from outside, the facet is counter-clockwise. Swapping two vertices and putting
            // the vertex at infinity first gives the ghost the orientation of a finite tetrahedron.
            let [p, q, r] = *facet;
            let place = |of: usize, vertex: usize| {
                let [p, q, r] = FACETS[of];
                [p, r, q].iter().position(|&k| k == vertex).map_or(0, |k| k + 1)
            };
            // this ghost shares its facet opposite vertex k with the ghost at facet k; in that
            // ghost, the facet is opposite vertex i
            let ghost = |k: usize| (k as u32 + 1) << 2 | place(k, i) as u32;
            self.tetrahedra.push(Tetrahedron {
                vertices: [INFINITE, simplex[p], simplex[r], simplex[q]],
                neighbours: [i as u32, ghost(p), ghost(r), ghost(q)],
            });
        }
        self.work.states.resize(self.tetrahedra.len(), UNKNOWN);
        self.last = 0;
    }

    /// Walks to the tetrahedron that contains a point, or to a ghost if the point lies strictly
    /// outside the hull. The walk terminates because the tetrahedra of a Delaunay triangulation
    /// have an acyclic front-to-back order as seen from any point. Returns an error if the walk
    /// crosses a cut.
    pub(super) fn locate(&self, sites: Sites<'_>, point: DVec3, start: u32) -> Reached<u32> {
        let mut t = start;
        let Tetrahedron { vertices, neighbours } = &self.tetrahedra[t as usize];
        if let Some(i) = place_of_infinity(vertices) {
            Beyond::check(neighbours[i])?;
            t = neighbours[i] >> 2;
        }
        let mut entered = NOWHERE;
        'walk: loop {
            let Tetrahedron { vertices, neighbours } = &self.tetrahedra[t as usize];
            if vertices.contains(&INFINITE) {
                return Ok(t);
            }
            let corners = vertices.map(|v| sites.at(v));
            for i in 0..4 {
                if i == entered {
                    continue;
                }
                let mut moved = corners;
                moved[i] = point;
                let [a, b, c, d] = moved;
                if orientation(a, b, c, d) < 0.0 {
                    Beyond::check(neighbours[i])?;
                    t = neighbours[i] >> 2;
                    entered = (neighbours[i] & 3) as usize;
                    continue 'walk;
                }
            }
            return Ok(t);
        }
    }

    /// Returns whether a tetrahedron is in conflict with a vertex, that is, whether the
    /// circumsphere of the tetrahedron contains the vertex. A ghost is in conflict if the vertex
    /// lies in the open half-space beyond its hull triangle. If the vertex lies in the plane of
    /// that triangle, the circumsphere of the finite neighbour decides. Returns an error if that
    /// neighbour lies beyond a cut.
    #[inline]
    fn conflicts(&self, sites: Sites<'_>, t: u32, v: u32, point: DVec3) -> Reached<bool> {
        let vertices = &self.tetrahedra[t as usize].vertices;
        if vertices.contains(&INFINITE) {
            self.ghost_conflicts(sites, t, v, point)
        } else {
            Ok(sites.sphere_holds(vertices, v, point))
        }
    }

    #[inline(never)]
    fn ghost_conflicts(&self, sites: Sites<'_>, t: u32, v: u32, point: DVec3) -> Reached<bool> {
        let Tetrahedron { vertices, neighbours } = &self.tetrahedra[t as usize];
        let [a, b, c, d] = vertices.map(|u| if u == INFINITE { point } else { sites.at(u) });
        let side = orientation(a, b, c, d);
        if side != 0.0 {
            return Ok(side > 0.0);
        }
        let finite = neighbours[place_of_infinity(vertices).unwrap_or(0)];
        Beyond::check(finite)?;
        Ok(sites.sphere_holds(&self.tetrahedra[(finite >> 2) as usize].vertices, v, point))
    }

    /// Returns an error if too few tetrahedron indices remain for another insertion.
    pub(super) fn check_room(&self) -> Result<()> {
        if self.tetrahedra.len() <= MOST_TETRAHEDRA {
            return Ok(());
        }
        Err(Error::TooManyTetrahedra(MOST_TETRAHEDRA))
    }

    /// Inserts a vertex, given the tetrahedron that contains its point. No other vertex may be at
    /// the same position. If the cavity extends beyond a cut, returns an error and changes nothing.
    pub(super) fn insert_at(&mut self, sites: Sites<'_>, v: u32, located: u32) -> Reached<()> {
        let mut work = std::mem::take(&mut self.work);
        let dug = self.dig(sites, v, located, &mut work);
        for &t in work.kept.iter().chain(&work.conflict) {
            work.states[t as usize] = UNKNOWN;
        }
        if dug.is_ok() {
            self.fill(v, sites.points.len(), &mut work);
            self.last = work.created[0];
        }
        self.work = work;
        dug
    }

    /// Finds the tetrahedra in conflict with a vertex by breadth-first search, and the walls of
    /// their cavity. Returns an error if the cavity extends beyond a cut.
    fn dig(&self, sites: Sites<'_>, v: u32, located: u32, work: &mut Workspace) -> Reached<()> {
        let point = sites.at(v);
        work.conflict.clear();
        work.kept.clear();
        work.walls.clear();
        work.conflict.push(located);
        work.states[located as usize] = IN_CONFLICT;
        let mut next = 0;
        while next < work.conflict.len() {
            let t = &self.tetrahedra[work.conflict[next] as usize];
            next += 1;
            for (facet, &outside) in FACETS.iter().zip(&t.neighbours) {
                Beyond::check(outside)?;
                let n = outside >> 2;
                let state = &mut work.states[n as usize];
                if *state == UNKNOWN {
                    if self.conflicts(sites, n, v, point)? {
                        *state = IN_CONFLICT;
                        work.conflict.push(n);
                        continue;
                    }
                    *state = KEPT;
                    work.kept.push(n);
                }
                if *state == KEPT {
                    let [p, q, r] = *facet;
                    work.walls.push(Wall { outside, vertices: [t.vertices[p], t.vertices[q], t.vertices[r]] });
                }
            }
        }
        Ok(())
    }

    /// Connects the walls of the cavity to the vertex and links the new tetrahedra to each other.
    /// Reuses the indices of the removed tetrahedra.
    fn fill(&mut self, v: u32, vertices: usize, work: &mut Workspace) {
        work.created.clear();
        let mut vacant = work.conflict.iter().copied();
        for wall in &work.walls {
            let [p, q, r] = wall.vertices;
            let new = Tetrahedron { vertices: [v, p, q, r], neighbours: [wall.outside; 4] };
            let number = match vacant.next().or_else(|| self.free.pop()) {
                Some(number) => {
                    self.tetrahedra[number as usize] = new;
                    number
                }
                None => {
                    self.tetrahedra.push(new);
                    work.states.push(UNKNOWN);
                    (self.tetrahedra.len() - 1) as u32
                }
            };
            self.tetrahedra[(wall.outside >> 2) as usize].neighbours[(wall.outside & 3) as usize] = number << 2;
            work.created.push(number);
        }
        for t in vacant {
            self.tetrahedra[t as usize].vertices[0] = DEAD;
            self.free.push(t);
        }
        work.join(&mut self.tetrahedra, vertices);
    }
}
