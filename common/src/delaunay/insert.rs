//! Finding the tetrahedron of a point by a walk, and inserting the point: remove all tetrahedra whose sphere holds it,
//! and join the walls of the cavity to it.

use super::predicates::{in_sphere_perturbed, orientation};
use super::{DEAD, Delaunay, FACETS, INFINITE, Tetrahedron};
use glam::DVec3;

const UNKNOWN: u8 = 0;
const IN_CONFLICT: u8 = 1;
const KEPT: u8 = 2;

/// A neighbour that is not known yet.
const NOBODY: u32 = u32::MAX;

/// Lists that live from one insertion to the next, to spare allocations.
#[derive(Clone, Debug, Default)]
pub(super) struct Workspace {
    /// What is known about each tetrahedron during an insertion; all `UNKNOWN` between insertions.
    states: Vec<u8>,
    conflict: Vec<u32>,
    kept: Vec<u32>,
    /// Walls of the cavity: tetrahedron inside, and its facet.
    walls: Vec<(u32, u8)>,
    created: Vec<u32>,
}

impl Workspace {
    pub(super) fn created(&self) -> &[u32] {
        &self.created
    }

    pub(super) fn bytes(&self) -> usize {
        let words = self.conflict.capacity() + self.kept.capacity() + self.created.capacity();
        self.states.capacity() + words * size_of::<u32>() + self.walls.capacity() * size_of::<(u32, u8)>()
    }
}

fn place_of(list: &[u32; 4], what: u32) -> usize {
    // three comparisons: the caller knows that it is there
    if list[0] == what {
        0
    } else if list[1] == what {
        1
    } else if list[2] == what {
        2
    } else {
        debug_assert_eq!(list[3], what);
        3
    }
}

impl Delaunay {
    /// The first tetrahedron and its four ghosts.
    pub(super) fn start(&mut self, simplex: [u32; 4]) {
        self.tetrahedra.push(Tetrahedron { vertices: simplex, neighbours: [1, 2, 3, 4] });
        for (i, facet) in FACETS.iter().enumerate() {
            // seen from beyond the facet it turns counter-clockwise: swapped, and infinity in the first place,
            // the ghost has the orientation of a finite tetrahedron
            let [p, q, r] = *facet;
            let ghost = |k: usize| k as u32 + 1;
            self.tetrahedra.push(Tetrahedron {
                vertices: [INFINITE, simplex[p], simplex[r], simplex[q]],
                neighbours: [0, ghost(p), ghost(r), ghost(q)],
            });
            debug_assert_eq!(ghost(i) as usize, self.tetrahedra.len() - 1);
        }
        self.work.states.resize(self.tetrahedra.len(), UNKNOWN);
        self.last = 0;
    }

    pub(super) fn note_incident(&mut self, t: u32) {
        let vertices = self.tetrahedra[t as usize].vertices;
        if vertices[0] != DEAD && !self.incident.is_empty() {
            for v in vertices.into_iter().filter(|&v| v != INFINITE) {
                self.incident[v as usize] = t;
            }
        }
    }

    fn corners(&self, vertices: [u32; 4]) -> [DVec3; 4] {
        vertices.map(|v| self.points[v as usize])
    }

    /// Walks to the tetrahedron that holds a point, or to a ghost whose hull triangle has it strictly beyond. The walk
    /// ends: in a Delaunay triangulation the tetrahedra are ordered front to back as seen from any point.
    pub(super) fn locate(&self, point: DVec3, start: u32) -> u32 {
        let mut t = start;
        let vertices = self.tetrahedra[t as usize].vertices;
        if let Some(i) = vertices.iter().position(|&v| v == INFINITE) {
            t = self.tetrahedra[t as usize].neighbours[i];
        }
        let mut from = NOBODY;
        'walk: loop {
            let Tetrahedron { vertices, neighbours } = self.tetrahedra[t as usize];
            if vertices.contains(&INFINITE) {
                return t;
            }
            let corners = self.corners(vertices);
            for i in 0..4 {
                if neighbours[i] == from {
                    continue;
                }
                let mut moved = corners;
                moved[i] = point;
                let [a, b, c, d] = moved;
                if orientation(a, b, c, d) < 0.0 {
                    from = t;
                    t = neighbours[i];
                    continue 'walk;
                }
            }
            return t;
        }
    }

    fn rank(&self, v: u32) -> u32 {
        if self.ranks.is_empty() { v } else { self.ranks[v as usize] }
    }

    /// Whether the sphere of a tetrahedron holds a vertex; for a ghost, whether its half-space does, the open hull plane
    /// belonging to it where the sphere of the finite neighbour holds the vertex.
    fn conflicts(&self, t: u32, v: u32, point: DVec3) -> bool {
        let Tetrahedron { mut vertices, neighbours } = self.tetrahedra[t as usize];
        if let Some(i) = vertices.iter().position(|&u| u == INFINITE) {
            let mut corners = [point; 4];
            for (k, corner) in corners.iter_mut().enumerate() {
                if k != i {
                    *corner = self.points[vertices[k] as usize];
                }
            }
            let [a, b, c, d] = corners;
            let side = orientation(a, b, c, d);
            if side != 0.0 {
                return side > 0.0;
            }
            vertices = self.tetrahedra[neighbours[i] as usize].vertices;
        }
        let [a, b, c, d] = self.corners(vertices);
        in_sphere_perturbed(&[a, b, c, d, point], || {
            let [a, b, c, d] = vertices.map(|u| self.rank(u));
            [a, b, c, d, self.rank(v)]
        })
    }

    /// Inserts a vertex whose point lies in a located tetrahedron and differs from all others.
    pub(super) fn insert_vertex(&mut self, v: u32, located: u32) {
        let point = self.points[v as usize];
        let mut work = std::mem::take(&mut self.work);
        self.dig(v, point, located, &mut work);
        self.fill(v, &mut work);
        for &t in &work.kept {
            work.states[t as usize] = UNKNOWN;
        }
        for &t in &work.conflict {
            work.states[t as usize] = UNKNOWN;
            self.tetrahedra[t as usize].vertices[0] = DEAD;
        }
        self.free.extend_from_slice(&work.conflict);
        self.last = work.created[0];
        for &t in &work.created {
            self.note_incident(t);
        }
        self.work = work;
    }

    /// Finds the tetrahedra in conflict with a vertex, and the walls of the cavity that they leave.
    fn dig(&self, v: u32, point: DVec3, located: u32, work: &mut Workspace) {
        work.conflict.clear();
        work.kept.clear();
        work.walls.clear();
        work.conflict.push(located);
        work.states[located as usize] = IN_CONFLICT;
        let mut next = 0;
        while next < work.conflict.len() {
            let t = work.conflict[next];
            next += 1;
            for (i, &n) in self.tetrahedra[t as usize].neighbours.iter().enumerate() {
                let state = &mut work.states[n as usize];
                if *state == UNKNOWN {
                    if self.conflicts(n, v, point) {
                        *state = IN_CONFLICT;
                        work.conflict.push(n);
                    } else {
                        *state = KEPT;
                        work.kept.push(n);
                    }
                }
                if *state == KEPT {
                    work.walls.push((t, i as u8));
                }
            }
        }
    }

    /// Joins the walls of the cavity to the vertex, and the new tetrahedra to each other.
    fn fill(&mut self, v: u32, work: &mut Workspace) {
        work.created.clear();
        for &(t, i) in &work.walls {
            let i = usize::from(i);
            let old = self.tetrahedra[t as usize];
            let outside = old.neighbours[i];
            let mut vertices = old.vertices;
            vertices[i] = v;
            let mut neighbours = [NOBODY; 4];
            neighbours[i] = outside;
            let new = Tetrahedron { vertices, neighbours };
            let number = match self.free.pop() {
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
            let beyond = &mut self.tetrahedra[outside as usize].neighbours;
            beyond[place_of(beyond, t)] = number;
            // the old tetrahedron now points at its heir, which the turns below will find
            self.tetrahedra[t as usize].neighbours[i] = number;
            work.created.push(number);
        }
        for (&(t, i), &number) in work.walls.iter().zip(&work.created) {
            let i = usize::from(i);
            for j in (0..4).filter(|&j| j != i) {
                if self.tetrahedra[number as usize].neighbours[j] != NOBODY {
                    continue;
                }
                // turn about the wall's edge that lacks the vertices at i and j, through the cavity to the next wall
                let (mut current, mut facet, mut third) = (t, j, i);
                let mut next = self.tetrahedra[current as usize].neighbours[facet];
                while work.states[next as usize] == IN_CONFLICT {
                    let ahead = &self.tetrahedra[next as usize];
                    facet = place_of(&ahead.vertices, self.tetrahedra[current as usize].vertices[third]);
                    third = place_of(&ahead.neighbours, current);
                    current = next;
                    next = ahead.neighbours[facet];
                }
                self.tetrahedra[number as usize].neighbours[j] = next;
                self.tetrahedra[next as usize].neighbours[third] = number;
            }
        }
    }
}
