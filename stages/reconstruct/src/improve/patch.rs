//! A copy of a part of the surface, which can be edited independently. All commits in the part
//! become one transaction of the whole surface.

use super::functions::Freedom;
use super::surface::{DEAD, Facts, Size, Surface};
use crate::interfaces::Interface;
use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;

/// A part of a surface, and the indices of its vertices and triangles in the whole, in the same
/// order.
pub(super) struct Patch<'a> {
    /// The part. The vertices on its rim are frozen, because some of their triangles are missing.
    pub(super) surface: Surface<'a>,
    /// Index in the whole of each original vertex of the part.
    vertices: Vec<u32>,
    /// Index in the whole of each original triangle of the part.
    triangles: Vec<u32>,
}

impl<'a> Patch<'a> {
    /// Creates the part of a surface (with a grid) that meets a box. Changes are possible only
    /// inside the box.
    pub(super) fn within(whole: &Surface<'a>, region: &Bounds) -> Self {
        let mut triangles = Vec::new();
        if let Some(grid) = &whole.grid {
            grid.any(region, |t, _| {
                triangles.push(t);
                false
            });
        }
        // the result must not depend on the order of the cells in the grid
        triangles.sort_unstable();
        let mut patch = Self::of(whole, region, triangles);
        patch.fill_grid(whole);
        patch
    }

    /// Fills the grid of the part if the whole has a grid. Commits are then tested for
    /// intersections.
    pub(super) fn fill_grid(&mut self, whole: &Surface) {
        if whole.grid.is_some() {
            self.surface.fill_grid();
        }
    }

    /// Creates the part that consists of given triangles (ascending), for changes inside a box. The
    /// part has no grid.
    pub(super) fn of(whole: &Surface<'a>, region: &Bounds, triangles: Vec<u32>) -> Self {
        let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| whole.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut surface = whole.part(&vertices, &triangles);
        let region = whole.region.map_or(*region, |own| own.intersection(region));
        surface.sides = whole.sides.as_ref().map(|sides| sides.within(&region));
        surface.region = Some(region);
        Self { surface, vertices, triangles }
    }

    /// Creates a copy of a whole surface with another target edge length (mm).
    pub(super) fn with_target(whole: &Surface<'a>, size: Size<'a>) -> Self {
        let mut surface = whole.clone();
        surface.size = size;
        surface.tried = 0;
        surface.target = surface.positions.par_iter().map(|&p| size(p)).collect();
        surface.facts = (0..surface.triangles.len() as u32).into_par_iter().map(|t| surface.measure(t)).collect();
        let numbers = |count: usize| (0..count as u32).collect();
        Self { vertices: numbers(surface.positions.len()), triangles: numbers(surface.triangles.len()), surface }
    }

    /// Converts the index of a triangle in the whole surface to its index in the part, which must
    /// contain the triangle.
    pub(super) fn local(&self, triangle: u32) -> u32 {
        self.triangles.partition_point(|&t| t < triangle) as u32
    }

    /// Freezes the vertices whose indices in the whole fail a test.
    pub(super) fn keep_free(&mut self, test: impl Fn(u32) -> bool) {
        for (frozen, &v) in self.surface.frozen.iter_mut().zip(&self.vertices) {
            *frozen |= !test(v);
        }
    }

    /// Returns the values of the original vertices of the part, given the values of all vertices of
    /// the whole.
    pub(super) fn pick<T: Copy>(&self, of_whole: &[T]) -> Vec<T> {
        self.vertices.iter().map(|&v| of_whole[v as usize]).collect()
    }

    /// Returns the grid nodes that have changed sides since the part was created.
    pub(super) fn turned_nodes(&self, whole: &Surface) -> Vec<usize> {
        let (Some(now), Some(before)) = (&self.surface.sides, &whole.sides) else { return Vec::new() };
        let before = self.surface.region.map_or_else(|| before.clone(), |region| before.within(&region));
        now.difference(&before)
    }

    /// Returns the changes since the part was created.
    pub(super) fn edits(self, whole: &Surface) -> Edits {
        let part = self.surface;
        let old = self.vertices.iter().zip(part.positions.iter().zip(&part.target));
        let is_moved = |&(&v, (&p, _)): &(&u32, (&DVec3, &f64))| whole.positions[v as usize] != p;
        let moved = old.filter(is_moved).map(|(&v, (&p, &target))| (v, p, target)).collect();
        let mut number = self.vertices;
        let first_added = whole.positions.len() as u32;
        let mut added = Vec::new();
        for v in number.len()..part.positions.len() {
            // an added vertex without triangles has been removed again
            number.push(first_added + added.len() as u32);
            if !part.around[v].is_empty() {
                added.push((part.positions[v], part.target[v], part.freedom[v]));
            }
        }
        let (retriangled, new_triangles, facts) = Default::default();
        let mut edits = Edits { first_added, moved, added, retriangled, new_triangles, facts };
        for (t, corners) in part.triangles.iter().enumerate() {
            let corners = if *corners == DEAD { DEAD } else { corners.map(|v| number[v as usize]) };
            let facts = part.facts[t];
            match self.triangles.get(t) {
                Some(&global) => {
                    if whole.triangles[global as usize] != corners {
                        edits.retriangled.push((global, corners));
                    }
                    if part.has_changed(t as u32) {
                        edits.facts.push((global, facts));
                    }
                }
                None if corners != DEAD => edits.new_triangles.push((corners, part.pair[t], facts)),
                None => {}
            }
        }
        edits
    }
}

/// Changes of a surface, in indices of the whole surface.
pub(super) struct Edits {
    /// Index of the first added vertex: the number of vertices of the whole when these edits were
    /// created.
    first_added: u32,
    /// Moved vertices, their new positions, and their target lengths in the part.
    moved: Vec<(u32, DVec3, f64)>,
    /// Positions, target lengths and freedoms of the added vertices.
    added: Vec<(DVec3, f64, Freedom)>,
    /// Changed triangles and their new corners, [`DEAD`] if removed.
    retriangled: Vec<(u32, [u32; 3])>,
    /// Corners, interfaces and facts of the added triangles.
    new_triangles: Vec<([u32; 3], Interface, Facts)>,
    /// Original triangles that changed in the part, and their facts.
    facts: Vec<(u32, Facts)>,
}

impl Edits {
    /// Makes the changes in the whole surface without a commit. Since the part was created, its
    /// region of the whole must not have changed.
    pub(super) fn make(self, whole: &mut Surface) {
        let size = whole.size;
        self.make_with(whole, |p, _| size(p));
    }

    /// Makes the changes. `target` returns the target length at a position, given the position and
    /// its target length in the part.
    fn make_with(self, whole: &mut Surface, target: impl Fn(DVec3, f64) -> f64) {
        let shift = whole.positions.len() as u32 - self.first_added;
        let number = |v: u32| if v >= self.first_added && v != u32::MAX { v + shift } else { v };
        self.moved.into_iter().for_each(|(v, p, own)| whole.move_vertex_of(v, p, target(p, own)));
        for (p, own, freedom) in self.added {
            let v = whole.add_vertex_of(p, target(p, own));
            whole.freedom[v as usize] = freedom;
        }
        self.retriangled.into_iter().for_each(|(t, corners)| whole.set_triangle(t, corners.map(number)));
        for (corners, pair, _) in self.new_triangles {
            whole.add_triangle(corners.map(number), pair);
        }
    }

    /// Returns the changed triangles of the whole, without the added ones.
    pub(super) fn touched(&self) -> Vec<u32> {
        self.facts.iter().map(|&(t, _)| t).collect()
    }

    /// Makes and commits the changes, with the target lengths of the part, which must have
    /// committed them. `nodes` are the grid nodes that change sides. Returns the touched triangles.
    pub(super) fn commit(mut self, whole: &mut Surface, nodes: &[usize]) -> Vec<u32> {
        let first_new = whole.triangles.len() as u32;
        let new = (first_new..).zip(&self.new_triangles).map(|(t, &(_, _, facts))| (t, facts));
        let (touched, facts): (Vec<u32>, Vec<Facts>) = std::mem::take(&mut self.facts).into_iter().chain(new).unzip();
        self.make_with(whole, |_, own| own);
        debug_assert!(
            whole.touched().iter().all(|t| touched.binary_search(t).is_ok()),
            "the part had not committed all"
        );
        if let Some(sides) = &mut whole.sides {
            sides.turn(nodes);
        }
        whole.commit(&touched, &facts);
        touched
    }
}
