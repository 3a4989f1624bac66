//! Improves the triangles of a closed mesh whose vertices lie on F = 0, and keeps its topology.
//!
//! A transaction consists of edge flips, collapses, splits and relocations, and leaves all vertices
//! on F = 0 (Eq. 5). It is kept if it passes the acceptance test (`acceptance`). `sweep` improves
//! the whole mesh, and `optimise` processes a queue of bad triangles. `target_length` remeshes a
//! patch at a smaller target length where h is too long for the curvature of F. The result does not
//! depend on the number of threads.

mod acceptance;
mod constants;
mod curves;
mod functions;
mod grid;
mod lift;
mod moves;
mod nodes;
mod optimise;
mod part;
mod patch;
mod remesh;
mod ring;
mod site;
mod smooth;
mod surface;
mod sweep;
mod target_length;
#[cfg(test)]
pub(crate) mod tests;
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

use crate::interfaces::Interfaces;
use acceptance::Limits;
use constants::GOOD;
pub use functions::{Freedom, InterfaceFunctions};
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::quality::{QualitySummary, summarise};
use isoparticles_stage::error::{Error, Result};
pub(crate) use nodes::NodeSides;
use part::Part;
use rayon::prelude::*;
use serde::Serialize;
use std::ops::AddAssign;
use surface::Surface;

/// Options of an improvement. The defaults are for a mesh of settled particles: three sweeps over
/// the whole mesh, the first with the removal of vertices, and then the optimiser for triangles of
/// quality below 0.9.
#[derive(Clone, Copy, Debug)]
pub struct ImproveOptions<'a> {
    /// Quality below which the optimiser improves a triangle; 0 disables the optimiser.
    pub target: f64,
    /// Number of sweeps over the whole mesh; 0 for none. The first removes vertices (if `thins`),
    /// flips edges towards degree six and relaxes vertices. Vertices are then smoothed until
    /// nothing moves or a budget of visits is used up. Except for the removal of vertices, no move
    /// lowers the minimum quality of its triangles below 0.9, or further if it was lower before.
    pub relaxation_sweeps: usize,
    /// Whether the first sweep removes vertices where the mesh is denser than h.
    pub thins: bool,
    /// For each vertex, whether the mesh may change there and up to three edges away. If given, all
    /// other vertices are frozen: they do not move, and their triangles keep their corners.
    pub around: Option<&'a [bool]>,
    /// Whether the lengths of the edges between vertices that may change are first adjusted to h by
    /// splits and collapses, also along junction curves.
    pub adjusts: bool,
}

impl Default for ImproveOptions<'_> {
    fn default() -> Self {
        Self { target: GOOD, relaxation_sweeps: 3, thins: true, around: None, adjusts: false }
    }
}

/// Numbers of moves made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Tally {
    /// Relocations of vertices by sweeps.
    pub relocations: usize,
    /// Edge flips of sweeps.
    pub flips: usize,
    /// Edge collapses of sweeps.
    pub collapses: usize,
    /// Single moves for bad triangles. The relocations that follow a move are not counted
    /// separately.
    pub single_moves: usize,
    /// Successes of the level that tries pairs of moves. It may also succeed with a single move.
    pub double_moves: usize,
    /// Remeshed patches around bad triangles, at a target length from the curvature of F.
    pub remeshed_patches: usize,
    /// Transactions for bad triangles, kept or rolled back.
    pub tried: usize,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.relocations += other.relocations;
        self.flips += other.flips;
        self.collapses += other.collapses;
        self.single_moves += other.single_moves;
        self.double_moves += other.double_moves;
        self.remeshed_patches += other.remeshed_patches;
        self.tried += other.tried;
    }
}

/// Result of an improvement.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ImproveReport {
    /// Quality before.
    pub before: QualitySummary,
    /// Quality after.
    pub after: QualitySummary,
    /// Numbers of moves made.
    pub moves: Tally,
    /// Number of triangles with a radius ratio below the target before.
    pub below_target_before: usize,
    /// Number of triangles with a radius ratio below the target after.
    pub below_target: usize,
    /// Number of frozen vertices: those inside an interface whose triangles do not form one closed
    /// fan and, if only a part of the mesh may change, those nearby that may not.
    pub frozen_vertices: usize,
    /// Numbers of grid nodes on the wrong side before and after; `None` if nodes are not guarded.
    pub nodes_on_wrong_side: Option<[usize; 2]>,
}

/// Callback of long loops, which call it regularly. An error stops the work.
pub type Step<'a> = &'a (dyn Fn() -> Result<()> + Sync);

/// What the improvement of a mesh keeps.
pub(crate) struct Constraints<'a> {
    /// Implicit functions of the interfaces.
    pub(crate) functions: &'a dyn InterfaceFunctions,
    /// How each vertex may move.
    pub(crate) freedom: Vec<Freedom>,
    /// The grid nodes that must not leave their sides; `None` if no node is guarded.
    pub(crate) sides: Option<NodeSides<'a>>,
}

/// Improves a mesh (grid frame) of interfaces that may meet in junction curves. Edges that are not
/// in exactly two triangles are edges of junction curves. Vertices stay on their interfaces and
/// curves. If a vertex of a curve is removed, an edge joins its two neighbours on the curve. `size`
/// is the target edge length h (mm) at a position. Only `mesh` and `between` of the interfaces are
/// read and changed. Also returns the index of each vertex in the improved mesh, `u32::MAX` if it
/// was removed.
///
/// # Errors
/// If a coordinate of the mesh is not finite, a triangle contains an invalid vertex index, or
/// `size` is not positive and finite at a vertex; and the errors of `step`. The mesh is then
/// unchanged.
pub(crate) fn improve(
    interfaces: &mut Interfaces,
    constraints: Constraints,
    size: &(dyn Fn(DVec3) -> f64 + Sync),
    options: &ImproveOptions,
    step: Step,
) -> Result<(ImproveReport, Vec<u32>)> {
    let mesh = &interfaces.mesh;
    check_inputs(mesh, size)?;
    let below = |mesh: &TriangleMesh| {
        isoparticles_mesh::quality::radius_ratios(mesh).iter().filter(|&&q| q < options.target).count()
    };
    let mut report =
        ImproveReport { before: summarise(mesh), below_target_before: below(mesh), ..ImproveReport::default() };
    let part = options.around.map(|around| Part::near(mesh, around));
    let Constraints { functions, freedom, sides } = constraints;
    let mut surface = match &part {
        Some(part) => part.surface(interfaces, &freedom, functions, size),
        None => Surface::of_interfaces(mesh, interfaces.between.clone(), freedom, functions, size),
    };
    report.frozen_vertices = surface.frozen.iter().filter(|&&frozen| frozen).count();
    let wrong_before = sides.as_ref().map(NodeSides::wrong_count);
    surface.sides = sides.map(|sides| match surface.region {
        Some(region) => sides.within(&region),
        None => sides,
    });
    let wrong_inside = surface.sides.as_ref().map(NodeSides::wrong_count);

    let limits = Limits::STRICT;
    let tally = &mut report.moves;
    if options.adjusts {
        surface.fill_grid();
        remesh::adjust(&mut surface, &limits, step, tally)?;
    }
    // sweeps remove the grid and fill it at their end
    if options.relaxation_sweeps == 0 {
        surface.fill_grid();
    } else {
        sweep::sweep(&mut surface, &limits, options.relaxation_sweeps, options.thins, step, tally)?;
    }
    if options.target > 0.0 {
        optimise::optimise(&mut surface, options.target, step, tally)?;
    }

    let counts = wrong_before.zip(wrong_inside).zip(surface.sides.as_ref().map(NodeSides::wrong_count));
    report.nodes_on_wrong_side = counts.map(|((all, inside), after)| [all, all - inside + after]);
    let Interfaces { mesh, between, .. } = interfaces;
    let numbers;
    (*mesh, *between, numbers) = match part {
        Some(part) => part.put_back(surface, std::mem::take(mesh), std::mem::take(between)),
        None => surface.into_parts(),
    };
    report.after = summarise(mesh);
    report.below_target = below(mesh);
    Ok((report, numbers))
}

/// Returns an error if the mesh is not well-formed, or if h is not positive and finite at a vertex.
fn check_inputs(mesh: &TriangleMesh, size: &(dyn Fn(DVec3) -> f64 + Sync)) -> Result<()> {
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
    Ok(())
}
