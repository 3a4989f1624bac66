//! A part of the surface as a surface of its own: what is done there, in however many commits, is one edit of the whole, or none.

use super::surface::{DEAD, Size, Surface};
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// The part and where it comes from.
pub(super) struct Excerpt<'a> {
    /// The part. Vertices on its rim are frozen, since their triangles do not close round them.
    pub(super) surface: Surface<'a>,
    /// The number in the whole of each of its vertices, as long as it is not a new one.
    vertices: Vec<u32>,
    /// The same of each of its triangles.
    triangles: Vec<u32>,
}

impl<'a> Excerpt<'a> {
    /// The committed triangles of a surface that meet a box. `size` is the target edge length (mm) in the part, `lengths` the range of lengths
    /// over it.
    pub(super) fn new<'b: 'a>(whole: &Surface<'b>, region: &Bounds, size: Size<'a>, lengths: [f64; 2]) -> Self {
        let mut triangles = Vec::new();
        whole.grid.any(region, |t, _| {
            triangles.push(t);
            false
        });
        // not in the order of the grid's cells
        triangles.sort_unstable();
        let mut number = HashMap::new();
        let mut vertices = Vec::new();
        let mut mesh = TriangleMesh::default();
        for &t in &triangles {
            mesh.triangles.push(whole.triangles[t as usize].map(|v| {
                *number.entry(v).or_insert_with(|| {
                    vertices.push(v);
                    mesh.vertices.push(whole.positions[v as usize]);
                    vertices.len() as u32 - 1
                })
            }));
        }
        let mut surface = Surface::new(&mesh, whole.field, size, lengths);
        surface.sides = whole.sides.clone();
        Self { surface, vertices, triangles }
    }

    /// The committed triangles of a surface that meet a box (ascending), with their facts, for changes that stay within the box. The numbers keep
    /// their order.
    pub(super) fn within(whole: &Surface<'a>, region: &Bounds, triangles: Vec<u32>) -> Self {
        let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| whole.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut surface = whole.part(&vertices, &triangles);
        surface.grid = whole.grid.emptied();
        for t in 0..triangles.len() as u32 {
            surface.grid.insert(t, surface.bounds(t));
        }
        surface.sides = whole.sides.as_ref().map(|sides| sides.within(region));
        surface.region = Some(*region);
        Self { surface, vertices, triangles }
    }

    /// A triangle and so many rings of triangles round it, for trying moves that are then made in the whole. The numbers keep their order.
    pub(super) fn rings(whole: &Surface<'a>, triangle: u32, count: usize) -> Self {
        let (mut vertices, mut triangles) = (whole.triangles[triangle as usize].to_vec(), Vec::new());
        for _ in 0..count {
            triangles = vertices.iter().flat_map(|&v| whole.around[v as usize].iter().copied()).collect();
            triangles.sort_unstable();
            triangles.dedup();
            vertices = triangles.iter().flat_map(|&t| whole.triangles[t as usize]).collect();
            vertices.sort_unstable();
            vertices.dedup();
        }
        Self { surface: whole.part(&vertices, &triangles), vertices, triangles }
    }

    /// Excerpts round triangles of which no two share a vertex, in the order of the triangles, and the triangles whose excerpt would share one with
    /// those before.
    pub(super) fn apart(whole: &Surface<'a>, triangles: &[u32], rings: usize) -> (Vec<(u32, Self)>, Vec<u32>) {
        let parts: Vec<Self> = triangles.par_iter().map(|&t| Self::rings(whole, t, rings)).collect();
        let (mut chosen, mut others, mut taken) = (Vec::new(), Vec::new(), HashSet::<u32>::new());
        for (&t, part) in triangles.iter().zip(parts) {
            if part.vertices.iter().any(|v| taken.contains(v)) {
                others.push(t);
            } else {
                taken.extend(&part.vertices);
                chosen.push((t, part));
            }
        }
        (chosen, others)
    }

    /// The number in the part of a triangle of the whole that is in it.
    pub(super) fn local(&self, triangle: u32) -> u32 {
        self.triangles.partition_point(|&t| t < triangle) as u32
    }

    /// The numbers in the whole of its triangles, ascending.
    pub(super) fn into_triangles(self) -> Vec<u32> {
        self.triangles
    }

    /// The number in the whole of a triangle of the part.
    pub(super) fn global_triangle(&self, triangle: u32) -> u32 {
        self.triangles[triangle as usize]
    }

    /// The number in the whole of a vertex of the part, also of one that an edit adds to both.
    pub(super) fn global(&self, whole: &Surface, vertex: u32) -> u32 {
        let old = self.vertices.len() as u32;
        self.vertices.get(vertex as usize).copied().unwrap_or_else(|| whole.positions.len() as u32 + vertex - old)
    }

    /// Freezes the vertices whose numbers in the whole do not pass a test.
    pub(super) fn keep_free(&mut self, test: impl Fn(u32) -> bool) {
        for (frozen, &v) in self.surface.frozen.iter_mut().zip(&self.vertices) {
            *frozen |= !test(v);
        }
    }

    /// What is known of the vertices of the whole, for those of the part.
    pub(super) fn pick<T: Copy>(&self, of_whole: &[T]) -> Vec<T> {
        self.vertices.iter().map(|&v| of_whole[v as usize]).collect()
    }

    /// The grid nodes that changed sides in the part since it was taken.
    pub(super) fn turned_nodes(&self, whole: &Surface) -> Vec<usize> {
        let (Some(now), Some(before)) = (&self.surface.sides, &whole.sides) else { return Vec::new() };
        let before = self.surface.region.map_or_else(|| before.clone(), |region| before.within(&region));
        now.difference(&before)
    }

    /// What was changed in the part since it was taken.
    pub(super) fn edits(self, whole: &Surface) -> Edits {
        let part = self.surface;
        let old = self.vertices.iter().zip(&part.positions);
        let moved = old.filter(|&(&v, &p)| whole.positions[v as usize] != p).map(|(&v, &p)| (v, p)).collect();
        let mut number = self.vertices;
        let first_added = whole.positions.len() as u32;
        let mut added = Vec::new();
        for v in number.len()..part.positions.len() {
            // one that is gone again has no triangle to name it
            number.push(first_added + added.len() as u32);
            if !part.around[v].is_empty() {
                added.push(part.positions[v]);
            }
        }
        let mut edits = Edits { moved, added, retriangled: Vec::new(), new_triangles: Vec::new() };
        for (t, corners) in part.triangles.iter().enumerate() {
            let corners = if *corners == DEAD { DEAD } else { corners.map(|v| number[v as usize]) };
            match self.triangles.get(t) {
                Some(&global) if whole.triangles[global as usize] != corners => {
                    edits.retriangled.push((global, corners));
                }
                None if corners != DEAD => edits.new_triangles.push(corners),
                _ => {}
            }
        }
        edits
    }
}

/// Changes of a surface, in its own numbers.
pub(super) struct Edits {
    /// Vertices and where they go.
    moved: Vec<(u32, DVec3)>,
    /// Places of vertices that follow the last one of the surface.
    added: Vec<DVec3>,
    /// Triangles and their new corners, [`DEAD`] where they go.
    retriangled: Vec<(u32, [u32; 3])>,
    /// Corners of triangles that come.
    new_triangles: Vec<[u32; 3]>,
}

impl Edits {
    /// Puts a mesh of its own in the place of some triangles, which must be all those at their vertices.
    pub(super) fn replacing(whole: &Surface, triangles: &[u32], mesh: &TriangleMesh) -> Self {
        let first = whole.positions.len() as u32;
        Self {
            moved: Vec::new(),
            added: mesh.vertices.clone(),
            retriangled: triangles.iter().map(|&t| (t, DEAD)).collect(),
            new_triangles: mesh.triangles.iter().map(|corners| corners.map(|v| first + v)).collect(),
        }
    }

    /// Makes the changes in the surface that the part was taken from, which must be as it was then; nothing is committed.
    pub(super) fn make(self, whole: &mut Surface) {
        self.moved.into_iter().for_each(|(v, p)| whole.move_vertex(v, p));
        for p in self.added {
            whole.add_vertex(p);
        }
        self.retriangled.into_iter().for_each(|(t, corners)| whole.set_triangle(t, corners));
        for corners in self.new_triangles {
            whole.add_triangle(corners);
        }
    }
}
