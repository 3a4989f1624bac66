//! A part of the surface as a surface of its own: what is done there, in however many commits, is one transaction of the whole, or none.

use super::surface::{DEAD, Facts, Size, Surface};
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
        surface.tried = 0;
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
        let old = self.vertices.iter().zip(part.positions.iter().zip(&part.target));
        let is_moved = |&(&v, (&p, _)): &(&u32, (&DVec3, &f64))| whole.positions[v as usize] != p;
        let moved = old.filter(is_moved).map(|(&v, (&p, &target))| (v, p, target)).collect();
        let mut number = self.vertices;
        let first_added = whole.positions.len() as u32;
        let mut added = Vec::new();
        for v in number.len()..part.positions.len() {
            // one that is gone again has no triangle to name it
            number.push(first_added + added.len() as u32);
            if !part.around[v].is_empty() {
                added.push((part.positions[v], part.target[v]));
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
                None if corners != DEAD => edits.new_triangles.push((corners, part.sheet[t], facts)),
                None => {}
            }
        }
        edits
    }
}

/// Changes of a surface, in its own numbers.
pub(super) struct Edits {
    /// The number of the first added vertex: of vertices in the surface when the changes were found.
    first_added: u32,
    /// Vertices, where they go, and the target length there as the part has it.
    moved: Vec<(u32, DVec3, f64)>,
    /// Places and target lengths of vertices that follow the last one of the surface.
    added: Vec<(DVec3, f64)>,
    /// Triangles and their new corners, [`DEAD`] where they go.
    retriangled: Vec<(u32, [u32; 3])>,
    /// Corners, sheets and facts of triangles that come.
    new_triangles: Vec<([u32; 3], u32, Facts)>,
    /// Facts of the other triangles that the part has changed.
    facts: Vec<(u32, Facts)>,
}

impl Edits {
    /// Makes the changes in the surface that the part was taken from, which must be as it was then where the part was; nothing is committed.
    pub(super) fn make(self, whole: &mut Surface) {
        let size = whole.size;
        self.make_with(whole, |p, _| size(p));
    }

    /// The same, with the target length at a place by that of the part.
    fn make_with(self, whole: &mut Surface, target: impl Fn(DVec3, f64) -> f64) {
        let shift = whole.positions.len() as u32 - self.first_added;
        let number = |v: u32| if v >= self.first_added && v != u32::MAX { v + shift } else { v };
        self.moved.into_iter().for_each(|(v, p, own)| whole.move_vertex_of(v, p, target(p, own)));
        for (p, own) in self.added {
            whole.add_vertex_of(p, target(p, own));
        }
        self.retriangled.into_iter().for_each(|(t, corners)| whole.set_triangle(t, corners.map(number)));
        for (corners, sheet, _) in self.new_triangles {
            whole.add_triangle(corners.map(number), sheet);
        }
    }

    /// The triangles of the surface that change, without new ones.
    pub(super) fn touched(&self) -> Vec<u32> {
        self.facts.iter().map(|&(t, _)| t).collect()
    }

    /// Makes and commits changes that were committed in the part, of the same target lengths; the triangles touched. `nodes` are the grid nodes that they carry to the other side.
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
