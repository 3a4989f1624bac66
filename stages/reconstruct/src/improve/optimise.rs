//! Improves the worst triangles: one queue, ordered by quality and effort.
//!
//! A triangle below the target quality enters the queue in one of [`BANDS`] bands of quality, at
//! the first level of the [`schedule`]. A failure raises its level: from single moves to pairs of
//! moves, and then to patch remeshing with an increasing radius. A success returns the changed
//! triangles and their neighbours to the first level. Each level of each band has one budget
//! ([`Budget`]).
//!
//! Worse bands come first. The first band contains the triangles nearest to grid nodes on the wrong
//! side. Triangles with disjoint surroundings are processed in parallel. The result does not depend
//! on the number of threads.

use super::acceptance::Limits;
use super::constants::{AIM, BATCH, FIT, POOR, REACHES, RINGS, WASTED_WORK_LIMIT, WORTH_OF_UNFIT};
use super::lift::{lift, lift_by_two};
use super::patch::{Edits, Patch};
use super::surface::Surface;
use super::target_length::remesh;
use super::{Step, Tally};
use isoparticles_mesh::spatial::Bounds;
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// An operation on a triangle and its surroundings.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Operation {
    /// A flip, collapse, split or relocation.
    Move,
    /// Two moves in a row.
    Pair,
    /// Remeshes a patch at a smaller target length. The reach is the radius of the patch in units
    /// of its edge length.
    Remesh { reach: f64 },
}

/// A level of effort.
#[derive(Clone, Copy, Debug)]
struct Level {
    operation: Operation,
    limits: Limits,
    /// The level applies to triangles below this quality.
    bar: f64,
}

/// Number of levels.
const LEVELS: usize = 5;

/// Number of bands of quality: triangles at grid nodes on the wrong side, and triangles below
/// [`FIT`], [`AIM`] and the target. A band cannot use up the budget of another band.
const BANDS: usize = 4;

/// Returns the levels of effort, in ascending order. No level applies to triangles of quality
/// `target` or higher.
fn schedule(target: f64) -> [Level; LEVELS] {
    let [small, large] = REACHES.map(|reach| Operation::Remesh { reach });
    let levels = [
        (Operation::Move, Limits::STRICT, target),
        (Operation::Move, Limits::LOOSE, FIT),
        (Operation::Pair, Limits::LOOSE, target),
        (small, Limits::LOOSE, AIM),
        (large, Limits::LOOSE, AIM),
    ];
    levels.map(|(operation, limits, bar)| Level { operation, limits, bar: bar.min(target) })
}

impl Level {
    /// Returns whether the level applies to a triangle of this quality (0 at a grid node on the
    /// wrong side). Vertices on junction curves cannot leave the curves. A triangle between curves
    /// therefore gets single moves only. A triangle next to a curve gets single moves and patches;
    /// below [`POOR`], it gets all operations. Grid nodes on the wrong side override both
    /// restrictions. On all tissues of `thorax_labels` at 5,000 vertices, all operations on all
    /// triangles take 20 s instead of 13 s and raise the minimum radius ratio from 0.610 to 0.614;
    /// at 20,000 vertices, 18 s instead of 15 s, and from 0.611 to 0.694.
    fn applies(&self, surface: &Surface, triangle: u32, quality: f64) -> bool {
        if quality >= self.bar || surface.is_frozen(triangle) {
            return false;
        }
        match self.operation {
            Operation::Move => true,
            _ if quality > 0.0 && surface.is_between_curves(triangle) => false,
            Operation::Pair => quality < POOR || !surface.is_held(triangle),
            Operation::Remesh { .. } => true,
        }
    }

    /// Returns the box that contains all changes of the operation on a triangle.
    fn region(&self, surface: &Surface, triangle: u32) -> Bounds {
        match self.operation {
            Operation::Move | Operation::Pair => surface.rings(triangle, RINGS).bounds(surface),
            Operation::Remesh { reach } => super::target_length::region(surface, triangle, reach),
        }
    }

    /// Tries the operation on a copy of the region. Returns the work in transactions and, if the
    /// operation succeeds, the grid nodes that change sides and the edits of the mesh.
    fn attempt(&self, surface: &Surface, (triangle, region): (u32, Bounds)) -> (usize, Option<(Vec<usize>, Edits)>) {
        let mut patch = Patch::within(surface, &region);
        let local = patch.local(triangle);
        let part = &mut patch.surface;
        let is_better = match self.operation {
            Operation::Move => lift(part, local, &self.limits, self.bar),
            Operation::Pair => lift_by_two(part, local, &self.limits, self.bar),
            Operation::Remesh { reach } => remesh(part, local, reach, self.bar),
        };
        (patch.surface.tried, is_better.then(|| (patch.turned_nodes(surface), patch.edits(surface))))
    }
}

/// The work at a level of a band, in transactions. The level ends when its wasted work exceeds its
/// useful work by [`WASTED_WORK_LIMIT`]. Below [`FIT`], the useful work counts [`WORTH_OF_UNFIT`]
/// times. Useful work raises the number of lifted triangles to a new maximum. The number of bad
/// triangles therefore bounds the total work.
#[derive(Clone, Copy, Default)]
struct Budget {
    useful: usize,
    wasted: usize,
    /// Number of attempts.
    attempts: usize,
    /// Number of triangles lifted out of the band or a worse one, minus the number that fell into
    /// them, plus the number of grid nodes that changed sides.
    lifted: isize,
    most_lifted: isize,
}

impl Budget {
    /// Returns the number of attempts that the remaining budget allows at the mean cost so far; at
    /// least one while any budget remains. `worth` is the wasted work that a unit of useful work
    /// allows.
    fn left(&self, limit: usize, worth: usize) -> usize {
        let left = (limit + worth * self.useful).saturating_sub(self.wasted);
        let mean_cost = (self.useful + self.wasted).div_ceil(self.attempts.max(1));
        match (left, mean_cost) {
            (0, _) => 0,
            (_, 0) => 1,
            _ => (left / mean_cost).max(1),
        }
    }

    fn enter(&mut self, work: usize, lifted: isize) {
        self.attempts += 1;
        self.lifted += lifted;
        if self.lifted > self.most_lifted {
            self.most_lifted = self.lifted;
            self.useful += work;
        } else {
            self.wasted += work;
        }
    }
}

/// A band and a level.
type Tier = (usize, usize);

/// The tier of a triangle that is not in the queue.
const DONE: Tier = (BANDS, LEVELS);

/// The triangles that remain to be improved.
struct Queue {
    levels: [Level; LEVELS],
    /// Upper bounds of the bands.
    bands: [f64; BANDS],
    budgets: [[Budget; LEVELS]; BANDS],
    /// Tiers, ranks ([`Self::rank`]) and indices of triangles, in ascending order. Some entries are
    /// no longer valid.
    heap: BinaryHeap<Reverse<(Tier, u64, u32)>>,
    /// Tier of the valid entry of each triangle, or [`DONE`].
    tier_of: Vec<Tier>,
    /// Triangles nearest to grid nodes on the wrong side, ascending.
    at_nodes: Vec<u32>,
    /// Transactions by which the wasted work may exceed the useful work: [`WASTED_WORK_LIMIT`]
    /// times the share of the vertices that may change.
    limit: usize,
}

impl Queue {
    fn new(surface: &Surface, target: f64) -> Self {
        let count = surface.triangles.len();
        let mut queue = Self {
            levels: schedule(target),
            bands: [f64::MIN_POSITIVE, FIT, AIM, target].map(|bar| bar.min(target)),
            budgets: [[Budget::default(); LEVELS]; BANDS],
            heap: BinaryHeap::new(),
            tier_of: vec![DONE; count],
            at_nodes: surface.triangles_at_wrong_nodes(),
            limit: WASTED_WORK_LIMIT * surface.frozen.iter().filter(|frozen| !**frozen).count()
                / surface.frozen.len().max(1),
        };
        (0..count as u32).for_each(|t| queue.enter(surface, t, 0));
        queue
    }

    /// Returns the number of attempts that the budget of a tier allows.
    fn left(&self, (band, level): Tier) -> usize {
        let worth = if self.bands[band] <= FIT { WORTH_OF_UNFIT } else { 1 };
        self.budgets[band][level].left(self.limit, worth)
    }

    /// Returns the bits of the quality of a triangle, or 0 at a grid node on the wrong side.
    fn rank(&self, surface: &Surface, t: u32) -> u64 {
        let is_at_node = surface.is_alive(t) && self.at_nodes.binary_search(&t).is_ok();
        // qualities are non-negative, so their bits are ordered like their values
        if is_at_node { 0 } else { surface.facts[t as usize].quality.to_bits() }
    }

    /// Enters a triangle at the first level from `least` that applies to it and has a budget left.
    /// If there is none, the triangle leaves the queue.
    fn enter(&mut self, surface: &Surface, t: u32, least: usize) {
        let rank = self.rank(surface, t);
        let quality = f64::from_bits(rank);
        let tier = self.bands.iter().position(|&bar| quality < bar).and_then(|band| {
            let is_open =
                |&level: &usize| self.left((band, level)) > 0 && self.levels[level].applies(surface, t, quality);
            Some((band, (least..LEVELS).find(is_open)?))
        });
        self.tier_of[t as usize] = tier.unwrap_or(DONE);
        self.heap.extend(tier.map(|tier| Reverse((tier, rank, t))));
    }

    /// Removes the next triangles from the queue: the worst ones of one tier, with disjoint
    /// regions. Returns the tier, and the triangles with their regions.
    fn pop(&mut self, surface: &Surface) -> Option<(Tier, Vec<(u32, Bounds)>)> {
        let mut batch = Vec::new();
        let mut tier = DONE;
        while let Some(&Reverse((next, rank, t))) = self.heap.peek() {
            let left = self.left(next);
            if !batch.is_empty() && (next != tier || batch.len() >= left.min(BATCH)) {
                break;
            }
            self.heap.pop();
            let is_valid = surface.is_alive(t) && self.tier_of[t as usize] == next && self.rank(surface, t) == rank;
            if is_valid && left == 0 {
                self.enter(surface, t, next.1 + 1);
            } else if is_valid && !batch.contains(&t) {
                tier = next;
                batch.push(t);
            }
        }
        let level = self.levels.get(tier.1)?;
        let regions: Vec<Bounds> = batch.par_iter().map(|&t| level.region(surface, t)).collect();
        let mut chosen = Vec::<(u32, Bounds)>::new();
        for (t, region) in batch.into_iter().zip(regions) {
            if chosen.iter().any(|(_, other)| other.meets(&region)) {
                self.enter(surface, t, tier.1);
            } else {
                chosen.push((t, region));
            }
        }
        Some((tier, chosen))
    }

    /// Enters changed triangles and their neighbours at the first level.
    fn reset(&mut self, surface: &Surface, touched: &[u32]) {
        self.tier_of.resize(surface.triangles.len(), DONE);
        let alive = touched.iter().filter(|&&t| surface.is_alive(t));
        let corners = alive.flat_map(|&t| surface.triangles[t as usize]);
        let mut open: Vec<u32> = corners.flat_map(|v| surface.around[v as usize].iter().copied()).collect();
        if touched.iter().any(|t| self.at_nodes.binary_search(t).is_ok()) {
            self.at_nodes = surface.triangles_at_wrong_nodes();
            open.extend(&self.at_nodes);
        }
        open.sort_unstable();
        open.dedup();
        open.into_iter().for_each(|t| self.enter(surface, t, 0));
    }
}

/// Improves the triangles whose quality is below `target`. Each batch calls `step` first, which can
/// stop the work.
///
/// # Errors
/// Those of `step`.
pub(super) fn optimise(surface: &mut Surface, target: f64, step: Step, tally: &mut Tally) -> Result<()> {
    let mut queue = Queue::new(surface, target);
    while let Some(((band, n), batch)) = queue.pop(surface) {
        step()?;
        let (level, bar) = (queue.levels[n], queue.bands[band]);
        let done: Vec<_> = batch.par_iter().map(|&site| level.attempt(surface, site)).collect();
        for ((t, _), (work, outcome)) in batch.into_iter().zip(done) {
            tally.tried += work;
            let Some((nodes, edits)) = outcome else {
                queue.budgets[band][n].enter(work, 0);
                queue.enter(surface, t, n + 1);
                continue;
            };
            let mended = surface.sides.as_ref().and_then(|sides| sides.mended_by(&nodes)).unwrap_or_default();
            let before = count_below(surface, &edits.touched(), bar) + mended;
            let touched = edits.commit(surface, &nodes);
            queue.budgets[band][n].enter(work, before as isize - count_below(surface, &touched, bar) as isize);
            queue.reset(surface, &touched);
            match level.operation {
                Operation::Move => tally.single_moves += 1,
                Operation::Pair => tally.double_moves += 1,
                Operation::Remesh { .. } => tally.remeshed_patches += 1,
            }
        }
    }
    Ok(())
}

/// Returns the number of given triangles that are below a quality.
fn count_below(surface: &Surface, triangles: &[u32], quality: f64) -> usize {
    triangles.iter().filter(|&&t| surface.facts[t as usize].quality < quality).count()
}

#[cfg(test)]
mod tests {
    use super::super::functions::Freedom;
    use super::super::tests::{ball, sampled};
    use super::*;
    use glam::DVec3;
    use isoparticles_field::materials::MaterialId;
    use isoparticles_field::spline::CubicSpline;
    use isoparticles_mesh::TriangleMesh;

    #[test]
    fn between_curves_only_single_moves_apply() {
        let vertices = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].to_vec();
        let mesh = TriangleMesh { vertices, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] };
        let field = CubicSpline::new(&sampled([5; 3], DVec3::ONE, ball(DVec3::ZERO, 1.0)));
        // triangle 0 has no free corner, and all its corners lie on another interface, too
        let freedom = vec![Freedom::Point, Freedom::Curve, Freedom::None, Freedom::Interface];
        let surface = Surface::of_interfaces(
            &mesh,
            [1, 2, 2, 2].map(|id| [MaterialId(id), MaterialId(0)]).to_vec(),
            freedom,
            &field,
            &|_| 1.0,
        );
        let tried = |operation: Operation, triangle: u32, quality: f64| {
            let level = Level { operation, limits: Limits::STRICT, bar: 1.0 };
            level.applies(&surface, triangle, quality)
        };
        let all = [Operation::Move, Operation::Remesh { reach: REACHES[0] }, Operation::Pair];
        assert_eq!(all.map(|operation| tried(operation, 0, 0.1)), [true, false, false]);
        assert_eq!(all.map(|operation| tried(operation, 1, 0.9 * POOR)), [true; 3]);
        assert_eq!(all.map(|operation| tried(operation, 1, 1.1 * POOR)), [true, true, false]);
        assert_eq!(all.map(|operation| tried(operation, 0, 0.0)), [true; 3], "a grid node on the wrong side");
    }
}
