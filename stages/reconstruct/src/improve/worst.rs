//! Works the worst triangles off: for each, the elementary moves on its edges and vertices, alone or two in a row, followed
//! by a settling of the vertices round them; the move that helps most and passes the guard is kept.

use super::excerpt::Excerpt;
use super::guard::{Limits, Rule, commit_if_welcome, scores};
use super::moves::{collapse, flip, projected, settle, split};
use super::surface::{DEAD, Surface, edges_of};
use super::{Step, Tally};
use isoparticles_stage::error::Result;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

/// Double plans, the most promising first, whose neighbourhood is settled before they are judged.
const PLANS_SETTLED: usize = 60;
/// Plans, the best first, that are put before the guard.
const PLANS_TRIED: usize = 40;

/// Rings of triangles that two moves in a row, and the settling after them, stay within.
const RINGS: usize = 7;

/// Triangles that a pass tries double plans on, worst first: some tens of milliseconds each. Where there are more of them,
/// the surface has too much detail below h for local moves to mend.
const DOUBLE_BUDGET: usize = 1500;

/// Triangles, worst first, that are worked on side by side where their surroundings do not meet.
const BATCH: usize = 32;

/// How hard to try.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Effort {
    /// Single moves.
    Single,
    /// Single moves, and the vertices round them settle.
    Settled,
    /// Two moves in a row, and the vertices round them settle.
    Double,
}

/// An elementary move.
#[derive(Clone, Copy, Debug)]
pub(super) enum Move {
    Settle(u32),
    Flip(u32, u32),
    /// Keeps the first; the new place is this share of the way to the second.
    Collapse(u32, u32, f64),
    Split(u32, u32),
}

impl Move {
    /// The same move of vertices with other numbers.
    pub(super) fn renumbered(self, number: impl Fn(u32) -> u32) -> Self {
        match self {
            Self::Settle(v) => Self::Settle(number(v)),
            Self::Flip(a, b) => Self::Flip(number(a), number(b)),
            Self::Collapse(keep, gone, share) => Self::Collapse(number(keep), number(gone), share),
            Self::Split(a, b) => Self::Split(number(a), number(b)),
        }
    }
}

/// Remembers what was tried in vain, lest it be tried again before anything has changed there.
#[derive(Default)]
pub(super) struct Failures {
    /// For each triangle: number of commits at the time, and the effort.
    at: HashMap<u32, (u32, Effort)>,
}

impl Failures {
    fn holds(&self, surface: &Surface, triangle: u32, effort: Effort) -> bool {
        self.at
            .get(&triangle)
            .is_some_and(|&(commits, tried)| tried >= effort && surface.is_unchanged_since(triangle, commits))
    }
}

/// What is asked of the triangles, and how hard to try.
#[derive(Clone, Copy)]
pub(super) struct Aim<'a> {
    /// What the moves must respect.
    pub(super) limits: &'a Limits,
    /// Radius ratio below which a triangle is worked on.
    pub(super) bar: f64,
    pub(super) effort: Effort,
}

/// Tries every triangle below the bar (of `among`, or of all), worst first, and again whatever falls short next to a success. `step` is called before
/// each batch and may stop it.
///
/// # Errors
/// Those of `step`.
pub(super) fn lift(
    surface: &mut Surface,
    among: Option<&[u32]>,
    aim: Aim,
    failures: &mut Failures,
    step: Step,
    tally: &mut Tally,
) -> Result<()> {
    let Aim { bar, effort, .. } = aim;
    let entry = |t: u32| {
        let quality = surface.facts[t as usize].quality;
        (quality < bar).then(|| Reverse((quality.to_bits(), t)))
    };
    let mut queue: BinaryHeap<_> = match among {
        Some(triangles) => triangles.iter().filter_map(|&t| entry(t)).collect(),
        None => (0..surface.facts.len() as u32).filter_map(entry).collect(),
    };
    // every success shrinks the shortfall by a fixed least amount; this is for the pathological rest
    let mut budget = 50 * queue.len() + 100;
    if effort == Effort::Double {
        budget = budget.min(DOUBLE_BUDGET);
    }
    // as many excerpts as may well be apart
    let mut width = BATCH;
    loop {
        let mut batch = Vec::new();
        while batch.len() < width.min(budget)
            && let Some(Reverse((bits, t))) = queue.pop()
        {
            let is_current = surface.facts[t as usize].quality.to_bits() == bits && surface.is_alive(t);
            if is_current && !batch.contains(&t) && !failures.holds(surface, t, effort) {
                batch.push(t);
            }
        }
        if batch.is_empty() {
            return Ok(());
        }
        step()?;
        let (parts, others) = Excerpt::apart(surface, &batch, RINGS);
        budget -= parts.len();
        width = (2 * parts.len()).clamp(2, BATCH);
        let plans: Vec<Vec<Rated>> = parts.par_iter().map(|(t, part)| plans(part, *t, bar, effort)).collect();
        let mut again = others;
        for ((t, part), plans) in parts.iter().zip(plans) {
            match make_first_welcome(surface, part, plans, aim, tally) {
                Some(touched) => again.extend(touched),
                None => {
                    failures.at.insert(*t, (surface.commits(), effort));
                }
            }
        }
        for t in again {
            let quality = surface.facts[t as usize].quality;
            if quality < bar {
                queue.push(Reverse((quality.to_bits(), t)));
            }
        }
    }
}

/// A plan and the shortfall that it saves before anything has settled (negative when it costs some at first).
type Rated = (f64, Vec<Move>);

/// The plans for a triangle that promise anything in the part round it, the best first.
fn plans(part: &Excerpt, triangle: u32, bar: f64, effort: Effort) -> Vec<Rated> {
    let corners = part.surface.triangles[part.local(triangle) as usize];
    let trial = || part.surface.clone();
    let started: Vec<Vec<Rated>> = moves_near(&[corners], &corners)
        .par_iter()
        .map_init(trial, |trial, &first| plans_from(trial, first, bar, effort))
        .collect();
    let mut plans = started.concat();
    // stable sorts keep the order of the moves among equals
    plans.sort_by(|a, b| b.0.total_cmp(&a.0));
    if effort >= Effort::Settled {
        plans.truncate(if effort == Effort::Double { PLANS_SETTLED } else { usize::MAX });
        plans.par_iter_mut().for_each_init(trial, |trial, (gain, plan)| {
            *gain = if execute(trial, plan, effort) { saved(trial, bar) } else { f64::NEG_INFINITY };
            trial.undo();
        });
        plans.sort_by(|a, b| b.0.total_cmp(&a.0));
    }
    plans.retain(|(gain, _)| *gain > 0.0);
    plans.truncate(PLANS_TRIED);
    plans
}

/// Commits the first of some plans that the guard lets pass: the triangles touched.
fn make_first_welcome(
    surface: &mut Surface,
    part: &Excerpt,
    plans: Vec<Rated>,
    aim: Aim,
    tally: &mut Tally,
) -> Option<Vec<u32>> {
    let Aim { limits, bar, effort } = aim;
    for (_, plan) in plans {
        let plan: Vec<Move> = plan.iter().map(|step| step.renumbered(|v| part.global(surface, v))).collect();
        if execute(surface, &plan, effort)
            && let Some(touched) = commit_if_welcome(surface, limits, Rule::Lift { bar })
        {
            tally.count(plan.len(), matches!(plan[0], Move::Settle(_)));
            return Some(touched);
        }
        surface.undo();
    }
    None
}

/// The plans that begin with a move.
fn plans_from(surface: &mut Surface, first: Move, bar: f64, effort: Effort) -> Vec<Rated> {
    let mut plans = Vec::new();
    let patch = rate(surface, &[first], bar, &mut plans);
    if effort == Effort::Double && !matches!(first, Move::Settle(_)) {
        for second in moves_near(&patch, &[]) {
            rate(surface, &[first, second], bar, &mut plans);
        }
    }
    plans
}

/// Shortfall that the edits since the last commit save; negative infinity when they lower the smallest radius ratio.
fn saved(surface: &Surface, bar: f64) -> f64 {
    let (before, after) = scores(surface, &surface.touched(), bar);
    if after.smallest < before.smallest { f64::NEG_INFINITY } else { before.shortfall - after.shortfall }
}

/// Moves on the edges of some triangles and on some vertices.
pub(super) fn moves_near(triangles: &[[u32; 3]], vertices: &[u32]) -> Vec<Move> {
    let mut moves: Vec<Move> = vertices.iter().map(|&v| Move::Settle(v)).collect();
    for (a, b) in edges_of(triangles) {
        moves.extend([
            Move::Flip(a, b),
            Move::Collapse(a, b, 0.5),
            Move::Collapse(a, b, 0.0),
            Move::Collapse(b, a, 0.0),
            Move::Split(a, b),
        ]);
    }
    moves
}

/// Tries a plan without settling, notes the shortfall it saves, and takes it back. The triangles it left.
fn rate(surface: &mut Surface, plan: &[Move], bar: f64, plans: &mut Vec<Rated>) -> Vec<[u32; 3]> {
    let mut patch = Vec::new();
    if execute(surface, plan, Effort::Single) {
        let touched = surface.touched();
        let (before, after) = scores(surface, &touched, bar);
        plans.push((before.shortfall - after.shortfall, plan.to_vec()));
        patch = touched.into_iter().map(|t| surface.triangles[t as usize]).filter(|t| *t != DEAD).collect();
    }
    surface.undo();
    patch
}

fn execute(surface: &mut Surface, plan: &[Move], effort: Effort) -> bool {
    let mut involved = Vec::new();
    if !plan.iter().all(|&step| perform(surface, step, &mut involved)) {
        return false;
    }
    if effort >= Effort::Settled {
        involved.retain(|&v| surface.degree(v) > 0);
        involved.sort_unstable();
        involved.dedup();
        for _ in 0..2 {
            let mut moved = false;
            for &v in &involved {
                moved |= settle(surface, v);
            }
            if !moved {
                break;
            }
        }
    }
    true
}

/// Makes a move, and names the vertices that should settle afterwards.
pub(super) fn perform(surface: &mut Surface, step: Move, involved: &mut Vec<u32>) -> bool {
    match step {
        Move::Settle(v) => {
            involved.push(v);
            involved.extend(surface.link(v).map(|(a, _)| a));
            settle(surface, v)
        }
        Move::Flip(a, b) => {
            let Some([(_, c), (_, d)]) = surface.wings(a, b) else { return false };
            involved.extend([a, b, c, d]);
            flip(surface, a, b)
        }
        Move::Collapse(keep, gone, share) => {
            if surface.degree(gone) == 0 {
                return false;
            }
            let (p, q) = (surface.positions[keep as usize], surface.positions[gone as usize]);
            let at = if share == 0.0 { Some(p) } else { projected(surface, p.lerp(q, share), p.distance(q)) };
            let done = at.is_some_and(|at| collapse(surface, keep, gone, at));
            if done {
                involved.push(keep);
                involved.extend(surface.link(keep).map(|(a, _)| a));
            }
            done
        }
        Move::Split(a, b) => {
            let Some(middle) = split(surface, a, b) else { return false };
            involved.push(middle);
            involved.extend(surface.link(middle).map(|(v, _)| v));
            true
        }
    }
}
