//! A part of the surface as a surface of its own: what is done there, in however many commits, is one transaction of the whole, or none.

use super::surface::{DEAD, Size, Surface};
use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;

/// Triangles round a triangle, and their vertices, both ascending.
pub(super) struct Rings {
    pub(super) vertices: Vec<u32>,
    pub(super) triangles: Vec<u32>,
}

impl Rings {
    /// The box round them.
    pub(super) fn bounds(&self, surface: &Surface) -> Bounds {
        let positions: Vec<DVec3> = self.vertices.iter().map(|&v| surface.positions[v as usize]).collect();
        Bounds::of(&positions)
    }
}

/// The part and where it comes from. The numbers keep their order.
pub(super) struct Patch<'a> {
    /// The part. Vertices on its rim are frozen, since their triangles do not close round them.
    pub(super) surface: Surface<'a>,
    /// The number in the whole of each of its vertices, as long as it is not a new one.
    vertices: Vec<u32>,
    /// The same of each of its triangles.
    triangles: Vec<u32>,
}

impl<'a> Patch<'a> {
    /// What of a surface meets a box, for changes that stay within the box.
    pub(super) fn within(whole: &Surface<'a>, region: &Bounds) -> Self {
        let mut triangles = Vec::new();
        if let Some(grid) = &whole.grid {
            grid.any(region, |t, _| {
                triangles.push(t);
                false
            });
        }
        // not in the order of the grid's cells
        triangles.sort_unstable();
        let mut patch = Self::of(whole, region, triangles);
        patch.fill_grid(whole);
        patch
    }

    /// Gives it a grid, so that from now on nothing is committed that crosses another triangle.
    pub(super) fn fill_grid(&mut self, whole: &Surface) {
        if whole.grid.is_some() {
            self.surface.fill_grid();
        }
    }

    /// The same where the triangles (ascending) are known, without a grid.
    pub(super) fn of(whole: &Surface<'a>, region: &Bounds, triangles: Vec<u32>) -> Self {
        let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| whole.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut surface = whole.part(&vertices, &triangles);
        surface.sides = whole.sides.as_ref().map(|sides| sides.within(region));
        surface.region = Some(*region);
        Self { surface, vertices, triangles }
    }

    /// All of a surface, with another target edge length (mm).
    pub(super) fn with_target(whole: &Surface<'a>, size: Size<'a>) -> Self {
        let mut surface = whole.clone();
        surface.size = size;
        surface.target = surface.positions.par_iter().map(|&p| size(p)).collect();
        surface.facts = (0..surface.triangles.len() as u32).into_par_iter().map(|t| surface.measure(t)).collect();
        let numbers = |count: usize| (0..count as u32).collect();
        Self { vertices: numbers(surface.positions.len()), triangles: numbers(surface.triangles.len()), surface }
    }

    /// The number in the part of a triangle of the whole that is in it.
    pub(super) fn local(&self, triangle: u32) -> u32 {
        self.triangles.partition_point(|&t| t < triangle) as u32
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
        let mut edits = Edits { first_added, moved, added, retriangled: Vec::new(), new_triangles: Vec::new() };
        for (t, corners) in part.triangles.iter().enumerate() {
            let corners = if *corners == DEAD { DEAD } else { corners.map(|v| number[v as usize]) };
            match self.triangles.get(t) {
                Some(&global) if whole.triangles[global as usize] != corners => {
                    edits.retriangled.push((global, corners));
                }
                None if corners != DEAD => edits.new_triangles.push((corners, part.sheet[t])),
                _ => {}
            }
        }
        edits
    }
}

/// Changes of a surface, in its own numbers.
pub(super) struct Edits {
    /// The number of the first added vertex: of vertices in the surface when the changes were found.
    first_added: u32,
    /// Vertices and where they go.
    moved: Vec<(u32, DVec3)>,
    /// Places of vertices that follow the last one of the surface.
    added: Vec<DVec3>,
    /// Triangles and their new corners, [`DEAD`] where they go.
    retriangled: Vec<(u32, [u32; 3])>,
    /// Corners and sheets of triangles that come.
    new_triangles: Vec<([u32; 3], u32)>,
}

impl Edits {
    /// Makes the changes in the surface that the part was taken from, which must be as it was then where the part was; nothing is committed.
    pub(super) fn make(self, whole: &mut Surface) {
        let shift = whole.positions.len() as u32 - self.first_added;
        let number = |v: u32| if v >= self.first_added && v != u32::MAX { v + shift } else { v };
        self.moved.into_iter().for_each(|(v, p)| whole.move_vertex(v, p));
        for p in self.added {
            whole.add_vertex(p);
        }
        self.retriangled.into_iter().for_each(|(t, corners)| whole.set_triangle(t, corners.map(number)));
        for (corners, sheet) in self.new_triangles {
            whole.add_triangle(corners.map(number), sheet);
        }
    }

    /// Makes and commits changes that were judged in the part; the triangles touched. `nodes` are the grid nodes that they carry to the other side.
    pub(super) fn commit(self, whole: &mut Surface, nodes: &[usize]) -> Vec<u32> {
        self.make(whole);
        if let Some(sides) = &mut whole.sides {
            sides.turn(nodes);
        }
        whole.commit_as_it_is()
    }
}
