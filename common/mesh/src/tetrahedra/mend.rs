//! Replaces poor tetrahedra and their surroundings with better ones. The interfaces and the rest of
//! the mesh stay as they are, and every tetrahedron keeps its material.
//!
//! Poor tetrahedra and their neighbours form a patch, in which cavities are filled in rounds.
//! Each round chooses poor tetrahedra far from each other, the worst first, and computes a filling
//! for each in parallel. The fillings are then applied in order, so the result does not depend on
//! the number of threads. A tetrahedron without a better filling is tried again only after a
//! change next to it. Every filling reduces the total badness by a share of that of its cavity
//! (`cavity.rs`), so the rounds end.

use super::conform::{Conformity, NOBODY, conform};
use super::forced::{Side, forced_sides, largest_jacobians};
use super::patch::{Filling, Limited, Patch};
use super::target::{Goal, Targets};
use glam::DVec3;
use rayon::prelude::*;

/// Tetrahedra up to this distance from a poor one, counted in steps to tetrahedra with a common
/// vertex, belong to the patch. The first cavities need one step, and they grow by single
/// tetrahedra.
const RINGS: usize = 3;

/// Largest share of poor tetrahedra that are mended. Above it, the whole mesh is bad. Mending 0.7 %
/// of 7.3 million tetrahedra (thorax_labels at 3 mm, aim of 25 degrees) takes 3 minutes on 2 busy
/// cores.
const LARGEST_SHARE: f64 = 0.01;

/// Number of poor tetrahedra that are always mended. It takes a few seconds.
const ALWAYS: usize = 1000;

/// Tetrahedra that fill the volumes between interfaces.
#[derive(Clone, Copy)]
pub struct Filled<'a> {
    /// Positions.
    pub points: &'a [DVec3],
    /// Vertices of the tetrahedra.
    pub cells: &'a [[u32; 4]],
    /// Vertices of the triangles of the interfaces.
    pub triangles: &'a [[u32; 3]],
    /// Materials behind and in front of each triangle.
    pub between: &'a [[u32; 2]],
}

/// A mended mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Mended {
    /// Positions. Without the vertices that are no longer used, those of the old mesh come first.
    pub points: Vec<DVec3>,
    /// Vertices of the tetrahedra. Those of the old mesh come first.
    pub cells: Vec<[u32; 4]>,
    /// Their conformity with the interfaces.
    pub conformity: Conformity,
    /// The changes.
    pub changes: Changes,
}

/// Changes made by mending.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Changes {
    /// Number of tetrahedra that miss their targets, before and after.
    pub below: [usize; 2],
    /// Number of cavities that were filled.
    pub moves: usize,
    /// Number of tetrahedra that were removed and added.
    pub cells: [usize; 2],
    /// Number of vertices that were removed and added.
    pub vertices: [usize; 2],
}

/// A mesh, and its conformity with the interfaces.
struct Conforming<'a> {
    mesh: Filled<'a>,
    found: Conformity,
}

/// Mends the tetrahedra that miss the goal. The vertices of the interfaces come first in the mesh
/// and keep their indices. Returns `None` if no tetrahedron is poor, if too many are, if the mesh
/// does not fit the interfaces, if no tetrahedron gets better, or if `is_stopped` returns true.
pub fn mend(mesh: Filled<'_>, goal: &Goal, is_stopped: &(dyn Fn() -> bool + Sync)) -> Option<Mended> {
    let targets = goal.targets();
    let is_poor = |cell: &[u32; 4]| targets.score(&cell.map(|v| mesh.points[v as usize])) < 1.0;
    let poor: Vec<bool> = mesh.cells.par_iter().map(is_poor).collect();
    let count = poor.par_iter().filter(|&&poor| poor).count();
    if count == 0 || count > ALWAYS.max((LARGEST_SHARE * mesh.cells.len() as f64) as usize) {
        return None;
    }
    let whole = Conforming { mesh, found: mesh.conform() };
    if whole.found.faults() > 0 {
        return None;
    }
    let near = rings(&mesh, poor);
    let mut used: Vec<u32> = near.iter().flat_map(|&cell| mesh.cells[cell as usize]).collect();
    used.par_sort_unstable();
    used.dedup();
    let mut patch = whole.patch(&near, &used, goal);
    let before = patch.poor().len();
    let moves = improve(&mut patch, is_stopped);
    (moves > 0 && !is_stopped()).then(|| {
        let below = [before, patch.poor().len()];
        mesh.with(&patch, &near, &used, Changes { below, moves, ..Changes::default() })
    })
}

impl Conforming<'_> {
    /// Returns the tetrahedra `near` and their vertices `used` as a patch.
    fn patch(&self, near: &[u32], used: &[u32], goal: &Goal) -> Patch {
        let mut local = vec![u32::MAX; self.mesh.points.len()];
        used.iter().zip(0..).for_each(|(&v, n)| local[v as usize] = n);
        let inner = self.limited(goal).into_iter();
        let inner = inner.map(|((face, part), targets)| ((face.map(|v| local[v as usize]), part), targets));
        let inner = inner.filter(|((face, _), _)| !face.contains(&u32::MAX)).collect();
        let cell = |&cell: &u32| {
            let cell = cell as usize;
            (self.mesh.cells[cell].map(|v| local[v as usize]), self.found.parts[cell])
        };
        let cells: Vec<([u32; 4], u32)> = near.iter().map(cell).collect();
        Patch::new(used.iter().map(|&v| self.mesh.points[v as usize]).collect(), &cells, inner, goal)
    }

    /// Returns the targets on the faces that the surface limits.
    fn limited(&self, goal: &Goal) -> Limited {
        let Self { mesh, found } = self;
        let mut limited = Limited::new();
        let mut limit = |facet: usize, side: Side, targets: Targets| {
            let cell = if side == Side::Behind { found.behind[facet] } else { found.before[facet] };
            if cell != NOBODY {
                let mut face = mesh.triangles[facet];
                face.sort_unstable();
                let known = limited.entry((face, found.parts[cell as usize])).or_insert(targets);
                *known = known.least(targets);
            }
        };
        for forced in forced_sides(mesh.points, mesh.triangles, goal.aim_dihedral) {
            limit(forced.facet as usize, forced.side, goal.beside(forced.bound));
        }
        let possible = largest_jacobians(mesh.points, mesh.triangles, goal.limit_dihedral);
        for (facet, &possible) in possible.iter().enumerate().filter(|&(_, &possible)| possible < goal.limit_jacobian) {
            for side in [Side::Behind, Side::Before] {
                limit(facet, side, goal.with_jacobian(possible));
            }
        }
        limited
    }
}

/// Returns the tetrahedra within [`RINGS`] of the given ones, ascending.
fn rings(mesh: &Filled<'_>, mut near: Vec<bool>) -> Vec<u32> {
    for _ in 0..RINGS {
        let mut marked = vec![false; mesh.points.len()];
        let cells = mesh.cells.iter().zip(&near).filter(|(_, near)| **near);
        cells.for_each(|(cell, _)| cell.iter().for_each(|&v| marked[v as usize] = true));
        near = mesh.cells.par_iter().map(|cell| cell.iter().any(|&v| marked[v as usize])).collect();
    }
    (0..).zip(near).filter_map(|(cell, near)| near.then_some(cell)).collect()
}

/// Fills cavities until none becomes better. Returns their number.
fn improve(patch: &mut Patch, is_stopped: &(dyn Fn() -> bool + Sync)) -> usize {
    let mut moves = 0;
    let mut is_hopeless = vec![false; patch.cells.len()];
    loop {
        let chosen = far_apart(patch, patch.poor().into_iter().filter(|&number| !is_hopeless[number as usize]));
        if chosen.is_empty() || is_stopped() {
            return moves;
        }
        let filling = |&number: &u32| if is_stopped() { None } else { patch.better_filling(number) };
        let fillings: Vec<Option<Filling>> = chosen.par_iter().with_max_len(1).map(filling).collect();
        for (number, filling) in chosen.into_iter().zip(fillings) {
            let Some(filling) = filling else {
                is_hopeless[number as usize] = true;
                continue;
            };
            // another cavity of this round may have taken some of its tetrahedra
            if patch.allows(&filling) {
                let used = patch.fill(&filling);
                moves += 1;
                is_hopeless.resize(patch.cells.len(), false);
                for &other in used.iter().flat_map(|&v| patch.star(v)) {
                    is_hopeless[other as usize] = false;
                }
            }
        }
    }
}

/// Returns the tetrahedra that share no vertex with a neighbour of an earlier one. So the cavities
/// at which the search begins are disjoint.
fn far_apart(patch: &Patch, candidates: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut is_near = vec![false; patch.points.len()];
    let mut chosen = Vec::new();
    for number in candidates {
        let vertices = patch.cells[number as usize].vertices;
        if vertices.iter().any(|&v| is_near[v as usize]) {
            continue;
        }
        for &other in vertices.iter().flat_map(|&v| patch.star(v)) {
            patch.cells[other as usize].vertices.iter().for_each(|&v| is_near[v as usize] = true);
        }
        chosen.push(number);
    }
    chosen
}

impl Filled<'_> {
    fn conform(&self) -> Conformity {
        conform(self.points.len(), self.cells, self.triangles, self.between)
    }

    /// Returns the mesh with the tetrahedra `near` replaced with those of the patch, whose first
    /// vertices are `used`.
    fn with(&self, patch: &Patch, near: &[u32], used: &[u32], changes: Changes) -> Mended {
        let mut is_kept = vec![true; self.cells.len()];
        near.iter().zip(&patch.cells).for_each(|(&cell, own)| is_kept[cell as usize] = own.exists);
        let mut cells: Vec<[u32; 4]> =
            self.cells.iter().zip(is_kept).filter_map(|(cell, kept)| kept.then_some(*cell)).collect();
        let kept = cells.len();
        let old = self.points.len();
        let global = |v: u32| used.get(v as usize).copied().unwrap_or((old - used.len()) as u32 + v);
        let new = patch.cells[near.len()..].iter().filter(|cell| cell.exists);
        cells.extend(new.map(|cell| cell.vertices.map(global)));
        let mut is_used = vec![false; old + patch.points.len() - used.len()];
        cells.iter().flatten().for_each(|&v| is_used[v as usize] = true);
        let removed = is_used[..old].iter().filter(|used| !**used).count();
        let counted = |next: &mut u32, &used: &bool| Some(std::mem::replace(next, *next + u32::from(used)));
        let number: Vec<u32> = is_used.iter().scan(0, counted).collect();
        cells.par_iter_mut().for_each(|cell| *cell = cell.map(|v| number[v as usize]));
        let all = self.points.iter().chain(&patch.points[used.len()..]);
        let points: Vec<DVec3> = all.zip(is_used).filter_map(|(point, used)| used.then_some(*point)).collect();
        let changes = Changes {
            cells: [self.cells.len() - kept, cells.len() - kept],
            vertices: [removed, points.len() + removed - old],
            ..changes
        };
        let mesh = Filled { points: &points, cells: &cells, ..*self };
        let conformity = mesh.conform();
        Mended { points, cells, conformity, changes }
    }
}
