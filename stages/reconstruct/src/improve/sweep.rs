//! Sweeps over the whole mesh: all threads improve spatial blocks in parallel.
//!
//! A vertex is free in a block if all its triangles lie inside. Moves and flips of free vertices
//! then touch only triangles inside the block, and the acceptance test compares them only with
//! triangles that meet the block. Blocks are therefore independent, and the result does not depend
//! on the number of threads. The vertices at the faces between blocks follow in blocks with other
//! faces ([`ROUNDS`]). The remaining vertices (none of the torso; some if the mesh is strongly
//! graded) follow in the whole mesh, on one thread.

use super::acceptance::{Goal, Limits};
use super::constants::{BLOCK, GOOD, PRICE_OF_DEVIATION, VISITS};
use super::patch::{Edits, Patch};
use super::smooth::smooth;
use super::surface::{DEAD, Surface};
use super::thin::thin_out;
use super::{Step, Tally, remesh};
use glam::DVec3;
use isoparticles_mesh::spatial::Bounds;
use isoparticles_stage::error::Result;
use rayon::prelude::*;

/// For each round: side of the blocks in units of the side in the first round, and distance of the
/// first face from the box of the mesh, in sides of the round. The faces of the second round lie
/// midway between those of the first. Vertices that are not free in either round lie where a face
/// of one crosses a face of the other. The faces of the third round are as far as possible from
/// these vertices. Those of the fourth are as far as possible from the vertices that are then left.
const ROUNDS: [(f64, f64); 4] = [(1.0, 0.25), (1.0, 0.75), (0.5, 1.0), (0.5, 0.75)];

/// The goal of all moves of a sweep, except for the removal of vertices.
const GOAL: Goal = Goal::Mean { floor: GOOD, price: PRICE_OF_DEVIATION };

/// Removes vertices where the mesh is denser than h (if `thins`), flips edges to bring the degrees
/// of vertices closer to six, and relaxes each vertex once. Then flips and smooths until nothing
/// moves or a budget is used up: `sweeps` - 1 visits per vertex plus [`VISITS`] for the whole mesh.
/// Each pass in a block calls `step` first, which can stop the work.
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
    let mut todo: Vec<bool> = surface.frozen.iter().map(|frozen| !frozen).collect();
    let count = todo.iter().filter(|&&todo| todo).count();
    let visits = (sweeps - 1) as f64 + VISITS as f64 / count as f64;
    let work = |part: &mut Surface, todo: &[bool]| -> Result<Tally> {
        let mut tally = Tally::default();
        step()?;
        if thins {
            thin_out(part, todo, step, &mut tally)?;
        }
        remesh::equalise_degrees(part, limits, GOAL, todo, &mut tally);
        remesh::relax_all(part, limits, GOAL, todo, &mut tally);
        let share = todo.iter().filter(|&&todo| todo).count() as f64;
        smooth_all(part, limits, todo, (visits * share) as usize, step, &mut tally)?;
        Ok(tally)
    };
    let mut tallies = Vec::new();
    // the grid is filled again after the last round
    surface.grid = None;
    let side = BLOCK * mean_edge(surface);
    for (share, before) in ROUNDS {
        let blocks = blocks(surface, &todo, share * side, before);
        let in_block = |block: &Block| improved(surface, block, &todo, &work);
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
    tallies.into_iter().for_each(|own| *tally += own);
    Ok(())
}

/// Works on a copy of a block, at the vertices in `todo`. Returns the grid nodes that change sides,
/// the edits of the surface, and the numbers of moves.
fn improved(
    surface: &Surface,
    block: &Block,
    todo: &[bool],
    work: &impl Fn(&mut Surface, &[bool]) -> Result<Tally>,
) -> Result<(Vec<usize>, Edits, Tally)> {
    let worked = |tests_each: bool| -> Result<(Tally, Patch)> {
        let mut part = Patch::of(surface, &block.region, block.triangles.clone());
        part.keep_free(|v| block.free.binary_search(&v).is_ok());
        let todo = part.pick(todo);
        if tests_each {
            part.surface.fill_grid();
        }
        Ok((work(&mut part.surface, &todo)?, part))
    };
    // intersections are rare: test once at the end, and if there are any, repeat the block with a
    // test of each transaction
    let (mut tally, mut part) = worked(false)?;
    if part.surface.crosses_in_all() {
        (tally, part) = worked(true)?;
    }
    Ok((part.turned_nodes(surface), part.edits(surface), tally))
}

/// Flips edges and smooths vertices: first at the vertices in `todo`, then at the moved vertices
/// and their neighbours. Ends when nothing moves or the next pass would exceed the budget of
/// `visits`.
fn smooth_all(
    part: &mut Surface,
    limits: &Limits,
    todo: &[bool],
    mut visits: usize,
    step: Step,
    tally: &mut Tally,
) -> Result<()> {
    let mut open = todo.to_vec();
    loop {
        let count = open.iter().filter(|&&open| open).count();
        if count == 0 || count > visits {
            return Ok(());
        }
        visits -= count;
        step()?;
        remesh::equalise_degrees(part, limits, GOAL, &open, tally);
        let mut next = vec![false; open.len()];
        for v in (0..open.len() as u32).filter(|&v| open[v as usize]) {
            if smooth(part, v, limits, GOAL) {
                tally.relocations += 1;
                next[v as usize] = true;
                part.link(v).for_each(|(u, _)| next[u as usize] = true);
            }
        }
        open = next;
    }
}

/// A block and its contents.
struct Block {
    region: Bounds,
    /// The vertices that are free in the block, ascending.
    free: Vec<u32>,
    /// The triangles whose bounding boxes meet the block, ascending.
    triangles: Vec<u32>,
}

/// Returns the blocks of side `side` (mm) with free vertices in `todo`, in grid order. The first
/// face lies `before` sides outside the box of the mesh. Vertices that are not in `todo` may also
/// be free.
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

/// Returns the mean edge length of the triangles, or 1 if there are none.
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
    use crate::check::{CheckOptions, check_object};
    use crate::improve::acceptance::commit_or_rollback;
    use crate::improve::moves;
    use crate::improve::nodes::NodeSides;
    use crate::improve::tests::{ball, sampled};
    use crate::subject::Object;
    use isoparticles_field::random::uniform;
    use isoparticles_field::spline::CubicSpline;
    use isoparticles_field::topology::FieldTopology;
    use isoparticles_mesh::quality::{radius_ratios, summarise};
    use isoparticles_mesh::{TriangleMesh, shapes};

    const CENTRE: DVec3 = DVec3::splat(8.2);
    const RADIUS: f64 = 6.0;
    const LIMITS: Limits = Limits { lengths: [0.3, 2.0], ..Limits::STRICT };

    /// Returns F of a ball, a mesh of 20,480 triangles with perturbed vertices and some flipped
    /// edges, and its mean edge length before the perturbation (mm).
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
                commit_or_rollback(&mut surface, &LIMITS, Goal::Keep { floor: 0.0 });
            }
        }
        let mesh = surface.into_mesh();
        (field, mesh, h)
    }

    #[test]
    fn sweeps_visit_all_vertices_on_any_number_of_threads() {
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
        let options = CheckOptions {
            subject: Some(&Object { field: &field, topology: &FieldTopology::new(&field), samples: None }),
            max_vertex_distance: Some(1e-4),
            ..CheckOptions::default()
        };
        assert_eq!(check_object(&made, &options).failed, Vec::<String>::new());
    }

    #[test]
    fn blocks_report_the_grid_nodes_that_change_sides() {
        let (field, mesh, h) = rough_ball();
        // the grid is so fine that facets cut off some of its nodes
        let image = sampled([166; 3], DVec3::splat(0.1), ball(CENTRE, RADIUS));
        let size = |_: DVec3| h;
        let mut surface = Surface::new(&mesh, &field, &size);
        surface.sides = Some(NodeSides::of_object(&mesh, &image));
        let before = NodeSides::of_object(&mesh, &image);
        sweep(&mut surface, &LIMITS, 3, false, &|| Ok(()), &mut Tally::default()).expect("nothing stops it");
        let after = surface.sides.take().expect("they are still guarded");
        assert_eq!(after.difference(&NodeSides::of_object(&surface.into_mesh(), &image)), [0; 0]);
        assert!(after.wrong_count() < before.wrong_count() - 5, "{} of {}", after.wrong_count(), before.wrong_count());
        assert_eq!(
            before.wrong_count() - after.wrong_count(),
            after.difference(&before).len(),
            "one left its right side"
        );
    }

    #[test]
    fn blocks_are_disjoint_and_omit_few_vertices() {
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
    fn changes_stay_strictly_inside_the_region() {
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
            assert_eq!(commit_or_rollback(&mut surface, &LIMITS, Goal::Keep { floor: 0.0 }).is_some(), is_kept);
            assert_eq!(surface.positions[v as usize] == to, is_kept);
        }
    }

    #[test]
    fn intersections_made_in_a_block_are_found_at_its_end() {
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
