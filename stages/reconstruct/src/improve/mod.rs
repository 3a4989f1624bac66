//! One optimiser that lifts the worst triangles of a closed mesh on F = 0 without touching the rest.
//!
//! A change is a transaction on a patch, made of edge flips, collapses and splits and of relocations to where the smallest quality round a vertex
//! is largest, always projected back onto F = 0 (Eq. 5). The guard commits it when the quality rises, and rolls it back when a triangle is turned
//! or folded, crosses another (exact predicates), strays from F = 0 by more than the bound, or carries a grid node to the other side where
//! that is asked for. Topology cannot change. `sweep` goes over the whole mesh, `optimise` through a queue of the bad triangles, and
//! `target_length` remeshes a patch at a smaller length where F bends within h. Optionally the whole mesh is remeshed by the same moves,
//! which makes a good mesh even of marching cubes' output. The result depends on the input only, not on threads.

mod constants;
mod curves;
mod grid;
mod guard;
mod lift;
mod moves;
mod nodes;
mod optimise;
mod patch;
mod remesh;
mod ring;
mod sheets;
mod smooth;
mod surface;
mod sweep;
mod target_length;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_of_curves;
#[cfg(test)]
mod tests_of_lift;
#[cfg(test)]
mod tests_of_patches;
#[cfg(test)]
mod tests_of_smoothing;
#[cfg(test)]
mod tests_of_thinning;
mod thin;

use constants::{GOOD, ON_SURFACE};
use glam::DVec3;
use guard::{Limits, Rule, commit_or_rollback};
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::quality::{QualitySummary, summarise};
use isoparticles_stage::error::{Error, Result};
use isoparticles_volume::{Geometry, Image};
use nodes::NodeSides;
use rayon::prelude::*;
use serde::Serialize;
pub use sheets::{Freedom, Sheets};
use surface::Surface;

/// How far to go. The defaults lift what is below 0.6 and leave everything else alone.
#[derive(Clone, Copy, Debug)]
pub struct ImproveOptions<'a> {
    /// Radius ratio below which a triangle is worked on.
    pub target: f64,
    /// Passes over the worst triangles, each as long as something helps; 0 for none.
    pub rounds: usize,
    /// Rounds of global remeshing towards h before that; 0 for none.
    pub remesh_rounds: usize,
    /// Sweeps over the whole mesh: of flips towards degree six, and in the first of relaxation, then of smoothing, which raises the mean radius ratio and brings no
    /// triangle below 0.9. Where meshes are small they go on for as long as they gain. 0 for none.
    pub relaxation_sweeps: usize,
    /// Whether the first of these takes away vertices where the mesh is denser than h asks, and all of them may leave triangles farther from F = 0 where F bends within h.
    pub thins: bool,
    /// Largest distance of a triangle's centroid from F = 0 that a move may bring about, over h; twice that (at least
    /// 0.35) for the sake of a triangle below a quality of 0.7 that nothing else can help.
    pub max_deviation: f64,
    /// Range of edge lengths, over h, that a move must stay in where the edges round it are within (0.05 to 3 for such a triangle).
    pub length_range: [f64; 2],
    /// Samples of F at whose nodes the mesh must not change sides (label volumes).
    pub sides: Option<&'a Image<f32>>,
}

impl Default for ImproveOptions<'_> {
    fn default() -> Self {
        Self {
            target: 0.6,
            rounds: 3,
            remesh_rounds: 0,
            relaxation_sweeps: 0,
            thins: false,
            max_deviation: 0.15,
            length_range: [0.5, 1.6],
            sides: None,
        }
    }
}

impl ImproveOptions<'_> {
    /// For a mesh of settled particles: a few sweeps over all of it, which raise the mean as well as the minimum, then the
    /// worst triangles.
    pub fn polish() -> Self {
        Self { target: GOOD, relaxation_sweeps: 3, thins: true, ..Self::default() }
    }

    /// Remeshes the whole surface towards h: a good mesh from any closed one, marching cubes' included.
    pub fn remesh() -> Self {
        Self { remesh_rounds: 8, relaxation_sweeps: 4, ..Self::default() }
    }
}

/// Moves made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Tally {
    /// Vertices brought onto F = 0 at the start.
    pub projections: usize,
    /// Vertices relaxed and smoothed.
    pub relocations: usize,
    /// Edges flipped by the global passes.
    pub flips: usize,
    /// Edges collapsed by the global passes and by the first sweep.
    pub collapses: usize,
    /// Edges split by the global passes.
    pub splits: usize,
    /// Single moves on behalf of a bad triangle, with the relocations after them.
    pub single_moves: usize,
    /// Pairs of moves in a row, likewise.
    pub double_moves: usize,
    /// Patches round triangles below the limits that were remeshed to follow the curvature of F.
    pub remeshed_patches: usize,
    /// Transactions on behalf of bad triangles, kept or taken back.
    pub tried: usize,
}

/// What came of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ImproveReport {
    /// Shapes before.
    pub before: QualitySummary,
    /// Shapes after.
    pub after: QualitySummary,
    /// Moves made.
    pub moves: Tally,
    /// Triangles below the target before.
    pub below_target_before: usize,
    /// Triangles still below the target.
    pub below_target: usize,
    /// Vertices left alone because their triangles do not form one closed fan.
    pub frozen_vertices: usize,
    /// Vertices that could not be brought onto F = 0 (none when they all lay there before).
    pub off_surface: usize,
    /// Grid nodes on the wrong side before and after; `None` when they were not guarded.
    pub nodes_on_wrong_side: Option<[usize; 2]>,
}

/// What long loops call every so often; an error stops them.
pub type Step<'a> = &'a (dyn Fn() -> Result<()> + Sync);

/// Improves a mesh in the grid frame. `size` is the target edge length h (mm) at a position.
///
/// # Errors
/// When the mesh has a coordinate that is not finite or an index that names no vertex, or `size` is not positive on it; and those of `step`, which
/// leave the mesh as it was.
pub fn improve(
    mesh: &mut TriangleMesh,
    field: &CubicSpline,
    size: &(dyn Fn(DVec3) -> f64 + Sync),
    options: &ImproveOptions,
    step: Step,
) -> Result<ImproveReport> {
    improve_holding(mesh, &[], field, size, options, step)
}

/// The same, where some vertices stay as they are.
///
/// # Errors
/// Those of [`improve`].
pub fn improve_holding(
    mesh: &mut TriangleMesh,
    held: &[u32],
    field: &CubicSpline,
    size: &(dyn Fn(DVec3) -> f64 + Sync),
    options: &ImproveOptions,
    step: Step,
) -> Result<ImproveReport> {
    let (of_triangle, mut freedom) = (vec![0; mesh.triangles.len()], vec![Freedom::Sheet; mesh.vertices.len()]);
    held.iter().for_each(|&v| freedom[v as usize] = Freedom::None);
    improve_sheets(
        mesh,
        &mut SheetsOf { field, of_triangle, freedom, wrong_nodes: None, numbers: Vec::new() },
        size,
        options,
        step,
    )
}

/// The sheets of a mesh.
pub struct SheetsOf<'a> {
    /// The functions that they are the zero sets of.
    pub field: &'a dyn Sheets,
    /// The sheet of each triangle.
    pub of_triangle: Vec<u32>,
    /// How each vertex may move.
    pub freedom: Vec<Freedom>,
    /// The grid and the numbers of its nodes on the wrong side, where all nodes are guarded.
    pub wrong_nodes: Option<(&'a Geometry, Vec<usize>)>,
    /// Afterwards the number that each vertex has in the improved mesh, `u32::MAX` where it is gone.
    pub numbers: Vec<u32>,
}

/// Improves a mesh of several sheets that meet in junction curves, whose edges are those that are not in two triangles. Vertices stay on their own sheets and curves; where
/// one of a curve goes, an edge joins its two neighbours on the curve. The sheets of the triangles are those of the new ones afterwards, and `freedom` means nothing any more.
///
/// # Errors
/// Those of [`improve`].
pub fn improve_sheets(
    mesh: &mut TriangleMesh,
    sheets: &mut SheetsOf,
    size: &(dyn Fn(DVec3) -> f64 + Sync),
    options: &ImproveOptions,
    step: Step,
) -> Result<ImproveReport> {
    if !mesh.is_well_formed() {
        return Err(Error::input(
            "the mesh has a coordinate that is not a finite number, or a triangle names a vertex that does not exist",
            "nothing can be measured on such a mesh",
            "reconstruct it again; if it comes from a file, the file is damaged",
        ));
    }
    if let Some(p) = mesh.vertices.par_iter().find_first(|&&p| !(size(p) > 0.0 && size(p).is_finite())) {
        return Err(Error::input(
            format!("the target edge length at {p} is {}", size(*p)),
            "edge lengths are measured against it",
            "give a size field that is positive everywhere on the surface",
        ));
    }
    let below = |mesh: &TriangleMesh| {
        isoparticles_mesh::quality::radius_ratios(mesh).iter().filter(|&&q| q < options.target).count()
    };
    let mut report =
        ImproveReport { before: summarise(mesh), below_target_before: below(mesh), ..ImproveReport::default() };
    let mut surface = Surface::of_sheets(mesh, sheets.of_triangle.clone(), sheets.freedom.clone(), sheets.field, size);
    surface.sides = match (options.sides, &sheets.wrong_nodes) {
        (Some(image), _) => Some(NodeSides::new(mesh, image)),
        (None, Some((geometry, wrong))) => Some(NodeSides::of(geometry, wrong.iter().copied())),
        (None, None) => None,
    };
    let wrong_before = surface.sides.as_ref().map(NodeSides::wrong_count);
    report.frozen_vertices = surface.frozen.iter().filter(|&&frozen| frozen).count();

    let limits = Limits::new(options.max_deviation, options.length_range);
    let tally = &mut report.moves;
    project_all(&mut surface, tally);
    // sweeps begin without a grid, and fill it at their end
    if surface.grid.is_none() && (options.remesh_rounds > 0 || options.relaxation_sweeps == 0) {
        surface.fill_grid();
    }
    for _ in 0..options.remesh_rounds {
        step()?;
        remesh::round(&mut surface, &limits, tally);
        project_all(&mut surface, tally);
    }
    if options.relaxation_sweeps > 0 {
        sweep::sweep(&mut surface, &limits, options.relaxation_sweeps, options.thins, step, tally)?;
    }
    if options.rounds > 0 {
        optimise::optimise(&mut surface, &limits, options.target, options.rounds, step, tally)?;
        project_all(&mut surface, tally);
    }

    report.off_surface = off_surface(&surface).len();
    report.nodes_on_wrong_side =
        wrong_before.zip(surface.sides.as_ref().map(NodeSides::wrong_count)).map(|(before, after)| [before, after]);
    (*mesh, sheets.of_triangle, sheets.numbers) = surface.into_sheets();
    report.after = summarise(mesh);
    report.below_target = below(mesh);
    Ok(report)
}

/// The vertices that do not lie on F = 0, ascending.
fn off_surface(surface: &Surface) -> Vec<u32> {
    let numbers = 0..surface.positions.len() as u32;
    numbers.into_par_iter().filter(|&v| is_off_surface(surface, v as usize)).collect()
}

fn is_off_surface(surface: &Surface, v: usize) -> bool {
    if !surface.is_free(v as u32) || surface.around[v].is_empty() {
        return false;
    }
    let (value, gradient) = surface.field.value_gradient(surface.sheet_at(v as u32), surface.positions[v]);
    let voxel = surface.field.voxel();
    value.abs() > ON_SURFACE * voxel * gradient.length()
}

/// Brings vertices that do not lie on F = 0 there, on a surface with a grid, which it gets where there are any; one that cannot get there gives way to a neighbour that does.
fn project_all(surface: &mut Surface, tally: &mut Tally) {
    let limits = &Limits::FOR_PROJECTION;
    let off = off_surface(surface);
    if !off.is_empty() && surface.grid.is_none() {
        surface.fill_grid();
    }
    for v in off {
        if surface.frozen[v as usize] || surface.degree(v) == 0 {
            continue;
        }
        let from = surface.positions[v as usize];
        let reach = surface.link(v).map(|(a, _)| surface.positions[a as usize].distance(from)).fold(0.0, f64::max);
        let neighbours: Vec<u32> = surface.link(v).map(|(a, _)| a).collect();
        let sum: DVec3 = neighbours.iter().map(|&u| surface.positions[u as usize]).sum();
        let moved = [from, sum / neighbours.len() as f64].into_iter().any(|start| {
            let to = moves::projected(surface, surface.sheet_at(v), start, reach);
            to.is_some_and(|to| {
                surface.move_vertex(v, to);
                commit_or_rollback(surface, limits, Rule::Any).is_some()
            })
        });
        if moved {
            tally.projections += 1;
            continue;
        }
        for u in neighbours {
            let at = surface.positions[u as usize];
            let keeps = !is_off_surface(surface, u as usize) && moves::collapse(surface, u, v, at);
            if keeps && commit_or_rollback(surface, limits, Rule::Keep { floor: 0.2 }).is_some() {
                tally.collapses += 1;
                break;
            }
            surface.rollback();
        }
    }
}
