//! Sweeps over the whole mesh, block of space by block of space, on all threads.
//!
//! A vertex is free in a block when all triangles round it lie within; what moves and flips of free vertices touch then lies within, too, and so does
//! what the guard compares it with. So blocks know nothing of each other, and the outcome is the same on any number of threads. What lies
//! across the faces of the blocks has its turn in blocks with other faces ([`ROUNDS`]), and what is left after all (none of the
//! vertices of the torso; some where the mesh is strongly graded) in the whole mesh, on one thread.

use super::constants::{BLOCK, GOOD, VISITS};
use super::guard::{Limits, Rule};
use super::patch::Patch;
use super::smooth::smooth;
use super::surface::{DEAD, Surface};
use super::thin::thin_out;
use super::{Step, Tally, remesh};
use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use isoparticles_stage::error::Result;
use rayon::prelude::*;

/// Sides of the blocks of a round over those of the first, and where the first face lies before the mesh, over the side. The second has faces where the first has middles. Both leave what
/// lies where a face of either meets one of the other across: of that the third's faces, and the fourth's of what these leave, are as far off as can be.
const ROUNDS: [(f64, f64); 4] = [(1.0, 0.25), (1.0, 0.75), (0.5, 1.0), (0.5, 0.75)];

/// If it `thins`, takes vertices away where the mesh is denser than h asks, and lets triangles lie farther from F = 0 at a price. Flips towards degree six and relaxes every vertex, so that edges get near to h, and lets no
/// triangle's neighbourhood get worse; then flips towards degree six and smooths, for as long as that gains, but no more than so many `sweeps` in all and [`VISITS`]. `step` is called before each sweep of a block and may stop it.
///
/// # Errors
/// Those of `step`.
pub(super) fn sweep(
    surface: &mut Surface,
    limits: &Limits,
    sweeps: usize,
    thins: bool,
    step: Step,
    tally: &mut Tally,
) -> Result<()> {
    let visits = (sweeps - 1) as f64 + VISITS as f64 / surface.positions.len() as f64;
    let work = |part: &mut Surface, todo: &[bool]| {
        let mut tally = Tally::default();
        step()?;
        if thins {
            thin_out(part, limits, todo, step, &mut tally)?;
        }
        let limits = &if thins { limits.of_sweeps() } else { *limits };
        remesh::equalise_degrees(part, limits, Rule::Even, todo, &mut tally);
        remesh::relax_all(part, limits, Rule::Even, todo, &mut tally);
        let share = todo.iter().filter(|&&todo| todo).count() as f64;
        smooth_all(part, limits, todo, (visits * share) as usize, step, &mut tally)?;
        Ok::<_, isoparticles_stage::error::Error>(tally)
    };
    let mut todo = vec![true; surface.positions.len()];
    let mut tallies = Vec::new();
    // filled anew when all blocks are done
    surface.grid = None;
    let side = BLOCK * mean_edge(surface);
    for (share, before) in ROUNDS {
        let blocks = blocks(surface, &todo, share * side, before);
        let in_block = |block: &Block| {
            step()?;
            let worked = |looks_at_each: bool| {
                let mut part = Patch::of(surface, &block.region, block.triangles.clone());
                part.keep_free(|v| block.free.binary_search(&v).is_ok());
                let todo = part.pick(&todo);
                if looks_at_each {
                    part.surface.fill_grid();
                }
                Ok::<_, isoparticles_stage::error::Error>((work(&mut part.surface, &todo)?, part))
            };
            // triangles hardly ever come to cross: it is enough to look at the end, and to begin again where they do
            let (mut tally, mut part) = worked(false)?;
            if part.surface.crosses_in_all() {
                (tally, part) = worked(true)?;
            }
            Ok((part.turned_nodes(surface), part.edits(surface), tally))
        };
        let done: Vec<_> = blocks.par_iter().map(in_block).collect::<Result<_>>()?;
        for (nodes, edits, tally) in done {
            edits.commit(surface, &nodes);
            tallies.push(tally);
        }
        blocks.iter().flat_map(|block| &block.free).for_each(|&v| todo[v as usize] = false);
    }
    surface.fill_grid();
    if todo.contains(&true) {
        tallies.push(work(surface, &todo)?);
    }
    tally.relocations += tallies.iter().map(|t| t.relocations).sum::<usize>();
    tally.collapses += tallies.iter().map(|t| t.collapses).sum::<usize>();
    tally.flips += tallies.iter().map(|t| t.flips).sum::<usize>();
    Ok(())
}

/// Flips and smooths next to the vertices to do, and again next to what has moved, until nothing moves or there were more than so many `visits`.
fn smooth_all(
    part: &mut Surface,
    limits: &Limits,
    todo: &[bool],
    mut visits: usize,
    step: Step,
    tally: &mut Tally,
) -> Result<()> {
    let rule = Rule::Mean { floor: GOOD };
    let mut open = todo.to_vec();
    loop {
        let count = open.iter().filter(|&&open| open).count();
        if count == 0 || count > visits {
            return Ok(());
        }
        visits -= count;
        step()?;
        remesh::equalise_degrees(part, limits, rule, &open, tally);
        let mut next = vec![false; open.len()];
        for v in (0..open.len() as u32).filter(|&v| open[v as usize]) {
            if smooth(part, v, limits, rule) {
                tally.relocations += 1;
                next[v as usize] = true;
                part.link(v).for_each(|(u, _)| next[u as usize] = true);
            }
        }
        open = next;
    }
}

/// A block with what is in it.
struct Block {
    region: Bounds,
    /// The vertices that are free there, ascending.
    free: Vec<u32>,
    /// The triangles whose boxes meet it, ascending.
    triangles: Vec<u32>,
}

/// The blocks that have anything to do, in order; the first face lies `before` sides before the mesh. A vertex that has been done may be free again.
fn blocks(surface: &Surface, todo: &[bool], side: f64, before: f64) -> Vec<Block> {
    let whole = Bounds::of(&surface.positions);
    let origin = whole.low - before * side;
    let cell = |p: DVec3| ((p - origin) / side).as_u64vec3().to_array();
    let [nx, ny, _] = cell(whole.high).map(|n| n + 1);
    let number = |[x, y, z]: [u64; 3]| x + nx * (y + ny * z);
    let region = |[x, y, z]: [u64; 3]| {
        let corner = |offset: u64| origin + DVec3::from_array([x, y, z].map(|n| (n + offset) as f64)) * side;
        Bounds { low: corner(0), high: corner(1) }
    };
    let home = |v: u32| {
        let p = surface.positions[v as usize];
        let region = region(cell(p));
        let is_used = !surface.frozen[v as usize] && !surface.around[v as usize].is_empty();
        let is_free = is_used && surface.link(v).all(|(u, _)| region.encloses(surface.positions[u as usize]));
        (is_free && region.encloses(p)).then(|| (number(cell(p)), v))
    };
    let homes = |t: u32| {
        let bounds = surface.bounds(t);
        let (low, high) = (cell(bounds.low), cell(bounds.high));
        let rows = (low[2]..=high[2]).flat_map(move |z| (low[1]..=high[1]).map(move |y| (y, z)));
        rows.flat_map(move |(y, z)| (low[0]..=high[0]).map(move |x| (number([x, y, z]), t)))
    };
    let numbers = |count: usize| (0..count as u32).into_par_iter();
    let mut vertices: Vec<(u64, u32)> = numbers(surface.positions.len()).filter_map(home).collect();
    vertices.par_sort_unstable();
    let has_work = |own: &&[(u64, u32)]| own.iter().any(|&(_, v)| todo[v as usize]);
    let with_work: Vec<&[(u64, u32)]> = vertices.chunk_by(|a, b| a.0 == b.0).filter(has_work).collect();
    let is_in_one = |(number, _): &(u64, u32)| with_work.binary_search_by_key(number, |own| own[0].0).is_ok();
    let alive = numbers(surface.triangles.len()).filter(|&t| surface.is_alive(t));
    let mut triangles: Vec<(u64, u32)> = alive.flat_map_iter(|t| homes(t).filter(is_in_one)).collect();
    triangles.par_sort_unstable();
    let block = |own: &[(u64, u32)]| {
        let (number, first) = own[0];
        let from = triangles.partition_point(|&(n, _)| n < number);
        let meeting = triangles[from..].iter().take_while(|&&(n, _)| n == number);
        Block {
            region: region(cell(surface.positions[first as usize])),
            free: own.iter().map(|&(_, v)| v).collect(),
            triangles: meeting.map(|&(_, t)| t).collect(),
        }
    };
    with_work.into_iter().map(block).collect()
}

/// Mean length of the sides of the triangles; 1 where there are none.
fn mean_edge(surface: &Surface) -> f64 {
    let alive = surface.triangles.iter().filter(|t| **t != DEAD);
    let (mut sum, mut count) = (0.0, 0.0);
    for &[a, b, c] in alive {
        let [p, q, r] = [a, b, c].map(|v| surface.positions[v as usize]);
        sum += p.distance(q) + q.distance(r) + r.distance(p);
        count += 3.0;
    }
    if sum > 0.0 { sum / count } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::{CheckOptions, check};
    use crate::improve::guard::commit_or_rollback;
    use crate::improve::moves;
    use crate::improve::nodes::NodeSides;
    use crate::improve::tests::{ball, sampled};
    use isoparticles_field::random::uniform;
    use isoparticles_field::spline::CubicSpline;
    use isoparticles_mesh::quality::{radius_ratios, summarise};
    use isoparticles_mesh::{TriangleMesh, shapes};

    const CENTRE: DVec3 = DVec3::splat(8.2);
    const RADIUS: f64 = 6.0;
    const LIMITS: Limits = Limits::new(0.15, [0.3, 2.0]);

    /// A sphere of 20,480 triangles with every vertex out of place and some edges flipped in vain, and its F.
    fn rough_ball() -> (CubicSpline, TriangleMesh, f64) {
        let field = CubicSpline::new(&sampled([17; 3], DVec3::ONE, ball(CENTRE, RADIUS)));
        let mut mesh = shapes::icosphere(RADIUS, 5);
        let h = summarise(&mesh).edge_length_mean;
        for (v, p) in (0..).zip(&mut mesh.vertices) {
            let shift = DVec3::new(uniform(1, 0, v), uniform(1, 1, v), uniform(1, 2, v)) - 0.5;
            *p = field.project(CENTRE + *p + 0.5 * h * shift, h, 1e-6).expect("F = 0 is near");
        }
        let size = |_: DVec3| h;
        let mut surface = Surface::new(&mesh, &field, &size);
        for (a, b) in remesh::edges(&surface).into_iter().step_by(97) {
            if moves::flip(&mut surface, a, b) {
                commit_or_rollback(&mut surface, &LIMITS, Rule::Any);
            }
        }
        let mesh = surface.into_mesh();
        (field, mesh, h)
    }

    #[test]
    fn every_vertex_has_its_turn_and_no_triangle_is_worse_for_it_on_any_number_of_threads() {
        let (field, mesh, h) = rough_ball();
        let size = |_: DVec3| h;
        let swept = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let mut surface = Surface::new(&mesh, &field, &size);
            let mut tally = Tally::default();
            pool.install(|| sweep(&mut surface, &LIMITS, 3, false, &|| Ok(()), &mut tally)).expect("nothing stops it");
            for t in 0..surface.triangles.len() as u32 {
                assert_eq!(surface.facts[t as usize], surface.measure(t), "facts of triangle {t}");
                let bounds = surface.bounds(t);
                let grid = surface.grid.as_ref().expect("the whole has a grid");
                assert!(grid.any(&bounds, |u, known| u == t && *known == bounds), "place of triangle {t}");
            }
            (surface.into_mesh(), tally)
        };
        let (made, tally) = swept(1);
        assert_eq!((made.clone(), tally), swept(3));
        assert!(tally.flips > 0 && tally.relocations > made.vertices.len(), "{tally:?}");
        let still = mesh.vertices.iter().zip(&made.vertices).filter(|(p, q)| p == q).count();
        assert!(still < mesh.vertices.len() / 100, "{still} vertices are where they were");
        let smallest = |mesh: &TriangleMesh| radius_ratios(mesh).into_iter().fold(f64::INFINITY, f64::min);
        assert!(smallest(&made) >= smallest(&mesh));
        let mean = |mesh: &TriangleMesh| summarise(mesh).radius_ratio_mean;
        assert!(mean(&made) > mean(&mesh) + 0.02, "{} from {}", mean(&made), mean(&mesh));
        let options = CheckOptions { field: Some(&field), max_vertex_distance: Some(1e-4), ..CheckOptions::default() };
        assert_eq!(check(&made, &options).failed_checks(), Vec::<String>::new());
    }

    #[test]
    fn grid_nodes_that_blocks_bring_to_their_right_side_are_known_to_the_whole() {
        let (field, mesh, h) = rough_ball();
        // so fine a grid that facets cut off some of its nodes
        let image = sampled([166; 3], DVec3::splat(0.1), ball(CENTRE, RADIUS));
        let size = |_: DVec3| h;
        let mut surface = Surface::new(&mesh, &field, &size);
        surface.sides = Some(NodeSides::new(&mesh, &image));
        let before = NodeSides::new(&mesh, &image);
        sweep(&mut surface, &LIMITS, 3, false, &|| Ok(()), &mut Tally::default()).expect("nothing stops it");
        let after = surface.sides.take().expect("they are still guarded");
        assert_eq!(after.difference(&NodeSides::new(&surface.into_mesh(), &image)), [0; 0]);
        assert!(after.wrong_count() < before.wrong_count() - 5, "{} of {}", after.wrong_count(), before.wrong_count());
        assert_eq!(
            before.wrong_count() - after.wrong_count(),
            after.difference(&before).len(),
            "one left its right side"
        );
    }

    #[test]
    fn blocks_do_not_overlap_and_leave_next_to_no_vertex_out() {
        let (field, mesh, h) = rough_ball();
        let size = |_: DVec3| h;
        let surface = Surface::new(&mesh, &field, &size);
        let side = 30.0 * mean_edge(&surface);
        let mut todo = vec![true; mesh.vertices.len()];
        let mut left = Vec::new();
        for (share, before) in ROUNDS {
            let blocks = blocks(&surface, &todo, share * side, before);
            assert!(share < 1.0 || blocks.len() > 4, "{}", blocks.len());
            assert!(blocks.iter().all(|block| block.free.iter().any(|&v| todo[v as usize])), "a block has no work");
            let mut free = vec![false; mesh.vertices.len()];
            for Block { region, free: own, .. } in &blocks {
                for &v in own {
                    assert!(!std::mem::replace(&mut free[v as usize], true), "vertex {v} is free twice");
                    let round = surface.link(v).map(|(u, _)| u).chain([v]);
                    assert!(round.map(|u| surface.positions[u as usize]).all(|p| region.encloses(p)));
                }
            }
            todo.iter_mut().zip(free).for_each(|(todo, free)| *todo &= !free);
            left.push(todo.iter().filter(|&&todo| todo).count());
        }
        assert!(left[1] < mesh.vertices.len() / 20 && left[1] > 0, "{left:?}");
        assert!(left[3] < mesh.vertices.len() / 1000, "{left:?}");
    }

    #[test]
    fn nothing_leaves_its_region() {
        let (field, mesh, h) = rough_ball();
        let size = |_: DVec3| h;
        let mut surface = Surface::new(&mesh, &field, &size);
        let (v, from) = (17, surface.positions[17]);
        let round = surface.link(v).map(|(u, _)| surface.positions[u as usize]).chain([from]).collect::<Vec<_>>();
        let to = field.project(from + 0.01 * h * DVec3::X, h, 1e-6).expect("F = 0 is near");
        let tight = Bounds::of(&round);
        let wide = Bounds { low: tight.low - h, high: tight.high + h };
        for (region, is_kept) in [(tight, false), (wide, true)] {
            surface.region = Some(region);
            surface.move_vertex(v, to);
            assert_eq!(commit_or_rollback(&mut surface, &LIMITS, Rule::Any).is_some(), is_kept);
            assert_eq!(surface.positions[v as usize] == to, is_kept);
        }
    }

    #[test]
    fn what_a_block_brings_to_cross_is_seen_at_its_end() {
        let (field, mesh, h) = rough_ball();
        let size = |_: DVec3| h;
        let whole = Surface::new(&mesh, &field, &size);
        let region = Bounds { low: CENTRE - 2.0 * RADIUS, high: CENTRE + 2.0 * RADIUS };
        for (steps, crosses) in [(0.0, false), (0.1, false), (3.0, true)] {
            let mut part = Patch::of(&whole, &region, (0..mesh.triangles.len() as u32).collect());
            let from = part.surface.positions[17];
            let aside = (from - CENTRE).any_orthonormal_vector();
            let to = field.project(from + steps * h * aside, RADIUS, 1e-6).expect("F = 0 is near");
            part.surface.move_vertex(17, to);
            part.surface.commit_as_it_is();
            assert_eq!(part.surface.crosses_in_all(), crosses, "{steps} h aside");
        }
    }

    #[test]
    fn an_error_stops_the_sweeps() {
        let (field, mesh, h) = rough_ball();
        let size = |_: DVec3| h;
        let mut surface = Surface::new(&mesh, &field, &size);
        let step = || Err(isoparticles_stage::error::Error::input("stopped", "", ""));
        assert!(sweep(&mut surface, &LIMITS, 3, false, &step, &mut Tally::default()).is_err());
    }
}
