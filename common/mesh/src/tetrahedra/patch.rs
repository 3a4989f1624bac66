//! Part of a mesh of tetrahedra that changes by replacing cavities with stars.
//!
//! A cavity is a set of tetrahedra of one part (see [`super::conform`]). The star of a point
//! consists of the tetrahedra between the point and the faces of the cavity. If they are all
//! positive, they fill the cavity exactly. Faces between parts bound every cavity, so they stay.

use super::FACES;
use super::target::{Goal, Targets};
use glam::DVec3;
use std::collections::HashMap;

/// A tetrahedron.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub(super) vertices: [u32; 4],
    pub(super) part: u32,
    pub(super) score: f64,
    /// False after the tetrahedron was replaced.
    pub(super) exists: bool,
}

/// A face of a cavity, counter-clockwise as seen from outside.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    pub(super) vertices: [u32; 3],
    /// The tetrahedron inside.
    pub(super) cell: u32,
}

/// The point of a star.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Apex {
    /// A vertex of the cavity.
    Vertex(u32),
    /// A new vertex.
    New(DVec3),
}

/// A star that can replace a cavity.
#[derive(Clone, Debug)]
pub(super) struct Filling {
    pub(super) cavity: Vec<u32>,
    pub(super) apex: Apex,
    /// The faces of the cavity that do not contain the apex, and the score of the tetrahedron on
    /// each.
    pub(super) faces: Vec<([u32; 3], f64)>,
}

/// Targets on faces (vertices ascending) that the surface limits, by part.
pub(super) type Limited = HashMap<([u32; 3], u32), Targets>;

/// A changing set of tetrahedra.
pub(super) struct Patch {
    pub(super) points: Vec<DVec3>,
    pub(super) cells: Vec<Cell>,
    /// The tetrahedra at each vertex.
    stars: Vec<Vec<u32>>,
    limited: Limited,
    /// For each vertex, whether it belongs to a face in `limited`.
    is_limited: Vec<bool>,
    targets: Targets,
}

impl Patch {
    pub(super) fn new(points: Vec<DVec3>, cells: &[([u32; 4], u32)], limited: Limited, goal: &Goal) -> Self {
        let mut is_limited = vec![false; points.len()];
        limited.keys().for_each(|(face, _)| face.iter().for_each(|&v| is_limited[v as usize] = true));
        let stars = vec![Vec::new(); points.len()];
        let mut patch = Self { points, cells: Vec::new(), stars, limited, is_limited, targets: goal.targets() };
        for &(vertices, part) in cells {
            let score = patch.targets(vertices, part).score(&patch.positions(vertices));
            patch.add(Cell { vertices, part, score, exists: true });
        }
        patch
    }

    fn add(&mut self, cell: Cell) {
        let number = self.cells.len() as u32;
        cell.vertices.iter().for_each(|&v| self.stars[v as usize].push(number));
        self.cells.push(cell);
    }

    pub(super) fn positions<const N: usize>(&self, vertices: [u32; N]) -> [DVec3; N] {
        vertices.map(|v| self.points[v as usize])
    }

    /// Returns the targets of a tetrahedron.
    pub(super) fn targets(&self, vertices: [u32; 4], part: u32) -> Targets {
        let faces = FACES.map(|face| face.map(|k| vertices[k]));
        faces.into_iter().fold(self.targets, |targets, face| self.with_face(targets, face, part))
    }

    /// Returns the targets of a tetrahedron on a face, whose fourth vertex is new.
    pub(super) fn targets_on(&self, face: [u32; 3], part: u32) -> Targets {
        self.with_face(self.targets, face, part)
    }

    fn with_face(&self, targets: Targets, face: [u32; 3], part: u32) -> Targets {
        if !face.iter().all(|&v| self.is_limited.get(v as usize) == Some(&true)) {
            return targets;
        }
        self.limited.get(&(ascending(face), part)).map_or(targets, |&limited| targets.least(limited))
    }

    /// Returns the tetrahedra that miss their targets, the worst first.
    pub(super) fn poor(&self) -> Vec<u32> {
        let is_poor = |number: &u32| {
            let cell = &self.cells[*number as usize];
            cell.exists && cell.score < 1.0
        };
        let mut poor: Vec<u32> = (0..self.cells.len() as u32).filter(is_poor).collect();
        let score = |number: u32| self.cells[number as usize].score;
        poor.sort_by(|&a, &b| score(a).total_cmp(&score(b)));
        poor
    }

    /// Returns the tetrahedra at a vertex.
    pub(super) fn star(&self, vertex: u32) -> &[u32] {
        &self.stars[vertex as usize]
    }

    /// Returns the tetrahedra of one part that contain all the given vertices, ascending.
    pub(super) fn around(&self, vertices: &[u32], part: u32) -> Vec<u32> {
        let contains = |&number: &u32| {
            let cell = &self.cells[number as usize];
            cell.part == part && vertices.iter().all(|v| cell.vertices.contains(v))
        };
        let mut found: Vec<u32> = self.star(vertices[0]).iter().copied().filter(contains).collect();
        found.sort_unstable();
        found
    }

    /// Returns the tetrahedron of the same part behind a face of a cavity.
    pub(super) fn across(&self, face: &Face) -> Option<u32> {
        let part = self.cells[face.cell as usize].part;
        self.around(&face.vertices, part).into_iter().find(|&number| number != face.cell)
    }

    /// Returns the faces of a cavity, in the order of their vertices.
    pub(super) fn faces(&self, cavity: &[u32]) -> Vec<Face> {
        let of_cell = |&cell: &u32| {
            let vertices = self.cells[cell as usize].vertices;
            FACES.map(|face| face.map(|k| vertices[k])).map(|vertices| (ascending(vertices), Face { vertices, cell }))
        };
        let mut all: Vec<([u32; 3], Face)> = cavity.iter().flat_map(of_cell).collect();
        all.sort_unstable_by_key(|(key, face)| (*key, face.cell));
        let groups = all.chunk_by(|a, b| a.0 == b.0);
        groups.filter_map(|group| if let [(_, face)] = group { Some(*face) } else { None }).collect()
    }

    /// Returns whether all tetrahedra of the cavity exist.
    pub(super) fn allows(&self, filling: &Filling) -> bool {
        filling.cavity.iter().all(|&number| self.cells[number as usize].exists)
    }

    /// Replaces a cavity with a star. Returns the vertices of the star.
    pub(super) fn fill(&mut self, filling: &Filling) -> Vec<u32> {
        let part = self.cells[filling.cavity[0] as usize].part;
        let apex = match filling.apex {
            Apex::Vertex(vertex) => vertex,
            Apex::New(place) => {
                self.points.push(place);
                self.stars.push(Vec::new());
                self.points.len() as u32 - 1
            }
        };
        for &number in &filling.cavity {
            let cell = &mut self.cells[number as usize];
            cell.exists = false;
            cell.vertices.iter().for_each(|&v| self.stars[v as usize].retain(|&other| other != number));
        }
        let mut used = vec![apex];
        for &([a, b, c], score) in &filling.faces {
            used.extend([a, b, c]);
            self.add(Cell { vertices: [a, c, b, apex], part, score, exists: true });
        }
        used.sort_unstable();
        used.dedup();
        used
    }
}

fn ascending(mut face: [u32; 3]) -> [u32; 3] {
    face.sort_unstable();
    face
}
