//! Point location by walking, and point insertion after Bowyer (1981) and Watson (1981). An
//! insertion removes all tetrahedra whose circumsphere contains the point, and connects the faces
//! of the resulting cavity ("walls") to the point.
//!
//! A [`Cells`] is a whole triangulation or one region of it (see [`super::regions`]). In a region,
//! an operation that would cross a cut fails with [`Beyond`].

use super::predicates::{in_sphere_perturbed, orientation};
use super::{DEAD, FACETS, INFINITE, Tetrahedron};
use crate::error::{Error, Result};
use glam::DVec3;

const UNKNOWN: u8 = 0;
const IN_CONFLICT: u8 = 1;
const KEPT: u8 = 2;

/// Values from here upwards mark a neighbour beyond a cut, which this region does not hold. The
/// outermost cut has the largest value.
const ELSEWHERE: u32 = u32::MAX - 255;

/// The depth of a cut (0 for the outermost). As an error: the operation needs tetrahedra beyond
/// this cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Beyond(pub(super) u32);

impl Beyond {
    /// The marker stored in place of a neighbour across this cut.
    pub(super) fn neighbour(self) -> u32 {
        u32::MAX - self.0
    }

    /// Fails if a neighbour entry marks a cut.
    #[inline]
    pub(super) fn check(neighbour: u32) -> std::result::Result<(), Self> {
        if neighbour < ELSEWHERE { Ok(()) } else { Err(Self(u32::MAX - neighbour)) }
    }
}

type Reached<T> = std::result::Result<T, Beyond>;

/// No facet: a walk has not entered its first tetrahedron through a facet.
const NOWHERE: usize = 4;

/// Maximum number of tetrahedra before an insertion. Indices have 30 bits, so 2^29 of them remain
/// for the new tetrahedra of one cavity.
const MOST_TETRAHEDRA: usize = 1 << 29;

/// Maximum number of walls for which shared edges are found with a table of all vertex pairs;
/// larger cavities sort the edges. 252 walls have 128 vertices, so the table takes 64 KiB.
const WALLS_FOR_A_TABLE: usize = 252;

/// A facet between the tetrahedra in conflict and the others.
#[derive(Clone, Copy, Debug)]
struct Wall {
    /// The facet as seen from outside the cavity: tetrahedron * 4 + facet place.
    outside: u32,
    /// Counter-clockwise as seen from the outer tetrahedron.
    vertices: [u32; 3],
}

/// Buffers that are reused between insertions to avoid allocations.
#[derive(Clone, Debug, Default)]
pub(super) struct Workspace {
    /// State of each tetrahedron during an insertion; all `UNKNOWN` between insertions.
    states: Vec<u8>,
    conflict: Vec<u32>,
    kept: Vec<u32>,
    walls: Vec<Wall>,
    created: Vec<u32>,
    /// Local number of each cavity vertex, plus `numbered`. Index 0 is the vertex at infinity,
    /// index v + 1 is vertex v. Smaller values are left over from earlier insertions.
    numbers: Vec<u32>,
    numbered: u32,
    /// For each ordered pair of local numbers, the facet at the edge from one to the other.
    table: Vec<u32>,
    /// The same as a sortable list, for large cavities.
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

    /// Links the created tetrahedra, each made of the new vertex and a wall, across the wall edges.
    /// Every edge belongs to two walls, which traverse it in opposite directions.
    fn join(&mut self, tetrahedra: &mut [Tetrahedron], vertices: usize) {
        if self.walls.len() > WALLS_FOR_A_TABLE {
            return self.join_by_sorting(tetrahedra);
        }
        // the walls form a triangulated sphere: V = F / 2 + 2
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

    /// As [`Workspace::join`], for any number of walls: sorting brings the two entries of each edge
    /// together.
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

/// The points of the triangulation, indexed by tetrahedron vertices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sites<'a> {
    pub(super) points: &'a [DVec3],
    /// The caller's index of each point; empty if the indices are the same.
    pub(super) named: &'a [u32],
}

impl Sites<'_> {
    fn at(&self, v: u32) -> DVec3 {
        self.points[v as usize]
    }

    /// Rank in the symbolic perturbation: a hash of the caller's index (an odd factor keeps the
    /// ranks distinct). Ranks that increase along a surface or grid would turn cospherical points
    /// into fans of long cells.
    fn rank(&self, v: u32) -> u32 {
        let index = if self.named.is_empty() { v } else { self.named[v as usize] };
        index.wrapping_mul(0x9e37_79b9)
    }

    /// Whether the perturbed circumsphere of a tetrahedron contains vertex `v` at `point`.
    #[inline]
    fn sphere_holds(&self, vertices: &[u32; 4], v: u32, point: DVec3) -> bool {
        let [a, b, c, d] = *vertices;
        let corners = [self.at(a), self.at(b), self.at(c), self.at(d), point];
        in_sphere_perturbed(&corners, || [a, b, c, d, v].map(|u| self.rank(u)))
    }
}

/// Tetrahedra connected across their facets: a whole triangulation, or one region of it. In a
/// region, some facets lie on a cut, and operations that would cross them fail.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    pub(super) tetrahedra: Vec<Tetrahedron>,
    /// Numbers of removed tetrahedra, to be reused.
    pub(super) free: Vec<u32>,
    /// Where the next walk starts.
    pub(super) last: u32,
    pub(super) work: Workspace,
}

impl Cells {
    /// The given tetrahedra, none of which is dead.
    pub(super) fn of(tetrahedra: Vec<Tetrahedron>) -> Self {
        let states = vec![UNKNOWN; tetrahedra.len()];
        Self { tetrahedra, work: Workspace { states, ..Workspace::default() }, ..Self::default() }
    }

    /// Reserves memory for more tetrahedra.
    pub(super) fn reserve(&mut self, more: usize) {
        self.tetrahedra.reserve(more);
        self.work.states.reserve(more);
    }

    /// Appends the tetrahedra of `others`, with their numbers offset by the length of `self`.
    /// Reserves memory for `spare` more. Facets on a cut stay marked.
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

    /// Whether a number denotes a live tetrahedron.
    pub(super) fn is_alive(&self, t: u32) -> bool {
        self.tetrahedra[t as usize].vertices[0] != DEAD
    }

    /// Creates the first tetrahedron and its four ghosts.
    pub(super) fn start(&mut self, simplex: [u32; 4]) {
        // the ghost at facet i has number i + 1, and the facet has place 0 there
        self.tetrahedra.push(Tetrahedron { vertices: simplex, neighbours: [1, 2, 3, 4].map(|ghost| ghost << 2) });
        for (i, facet) in FACETS.iter().enumerate() {
            // Seen from outside, the facet is counter-clockwise. Swapping two vertices and putting
            // infinity first gives the ghost the orientation of a finite tetrahedron.
            let [p, q, r] = *facet;
            let place = |of: usize, vertex: usize| {
                let [p, q, r] = FACETS[of];
                [p, r, q].iter().position(|&k| k == vertex).map_or(0, |k| k + 1)
            };
            // this ghost meets the ghost at facet k in the facet opposite vertex k; there, it is
            // opposite i
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
    /// outside the hull. The walk terminates, because the tetrahedra of a Delaunay triangulation
    /// are ordered front to back as seen from any point. Fails if the walk crosses a cut.
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

    /// Whether a tetrahedron is in conflict with a vertex: its circumsphere contains the vertex.
    /// For a ghost, the open half-space beyond its hull triangle replaces the sphere. A vertex in
    /// the plane of that triangle is tested against the sphere of the finite neighbour. Fails if
    /// that neighbour lies beyond a cut.
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

    /// Fails if too few tetrahedron numbers remain for another insertion.
    pub(super) fn check_room(&self) -> Result<()> {
        if self.tetrahedra.len() <= MOST_TETRAHEDRA {
            return Ok(());
        }
        Err(Error::TooManyTetrahedra(MOST_TETRAHEDRA))
    }

    /// Inserts a vertex whose point differs from all others, given the tetrahedron that contains
    /// it. Fails and changes nothing if the cavity extends beyond a cut.
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
    /// their cavity. Fails if the cavity extends beyond a cut.
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
    /// Reuses the numbers of the removed tetrahedra.
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
