//! The whole stage for one object: turns particles on F = 0 into a checked triangle mesh.
//!
//! 1. The particles are projected onto F = 0, and their Delaunay triangulation is computed.
//! 2. The topology of F = 0 is computed from the spline alone, so that the reference does not
//!    depend on any mesh.
//! 3. Each tetrahedron is labelled as inside if F is negative at its circumcentre, and as outside
//!    otherwise.
//! 4. The facets between inside and outside form the surface, which is closed by construction.
//! 5. Local criteria cover manifold edges and vertices, deviation and normal deviation. Global
//!    criteria cover components, Euler characteristics, critical points of F and voxel centres.
//! 6. A priority queue orders the violations by kind, and each is repaired by a new point on F = 0,
//!    usually the centre of a surface Delaunay ball.
//! 7. Where points do not help, tetrahedra change sides. The refinement ends when there are no
//!    violations, no further remedies, or no rounds left in the budget.
//! 8. With `--method tight-cocone`, the shape of the Voronoi cells labels the tetrahedra instead,
//!    and points are added where this surface lacks a part of the previous one.
//! 9. The facets are extracted as a mesh, and parts of the surface that touch at a vertex are
//!    separated.
//! 10. Sweeps and local moves improve the triangles, and an acceptance test preserves the topology.
//! 11. The finished mesh is checked independently of the previous steps, and its topology is
//!     compared with that of F.

use crate::check::CheckReport;
use crate::complete::{Completed, Completion};
use crate::improve::ImproveReport;
use crate::interfaces::Interfaces;
use crate::join::{Joined, join};
pub use crate::options::{Method, Options};
use crate::prepare::{PrepareReport, prepare};
use crate::refine::RefineReport;
use crate::tight_cocone::CoconeReport;
use crate::verdict::TopologyReport;
use glam::DVec3;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Image;
use rayon::prelude::*;
use std::sync::Arc;

/// A mesh with the results of all steps.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// The spline F.
    pub field: Arc<CubicSpline>,
    /// The mesh in the grid frame. Triangles are counter-clockwise as seen from outside.
    pub mesh: TriangleMesh,
    /// Target edge length h at each vertex, mm.
    pub sizes: Vec<f64>,
    /// How the particles were joined; `None` for an updated mesh.
    pub joining: Option<Joining>,
    /// World positions of the vertices that an update has kept, by vertex.
    pub kept: Vec<(u32, DVec3)>,
    /// Report of the improvement.
    pub improved: ImproveReport,
    /// Report of the checks.
    pub checked: CheckReport,
    /// Comparison of the mesh with the topology of F.
    pub topology: TopologyReport,
    /// The checks that failed, in words.
    pub failed: Vec<String>,
    /// Warnings that do not fail a check, in words.
    pub doubtful: Vec<String>,
}

/// Reports of the steps that join particles to a surface.
#[derive(Clone, Debug)]
pub struct Joining {
    /// Numbers of particles read and dropped.
    pub prepared: PrepareReport,
    /// Number of points in the initial triangulation.
    pub taken: usize,
    /// Report of the refinement.
    pub refined: RefineReport,
    /// Report of Tight Cocone, if it is the method.
    pub cocone: Option<CoconeReport>,
    /// Number of vertices at which touching parts of the surface were separated.
    pub parted: usize,
}

/// Returns a mesh of F = 0 for particles in the grid frame of `field`, the samples of F. h at a
/// vertex is taken from `sizing`, or else from the nearest point of the triangulation. The result
/// does not depend on the number of threads.
///
/// # Errors
/// If fewer than half of the particles are near F = 0, if all are in one plane, if Tight Cocone
/// finds no solid, or if the run is interrupted. A mesh that fails a check is not an error
/// ([`Reconstruction::failed`]).
pub fn reconstruct(
    particles: &ParticleSet,
    field: &Image<f32>,
    sizing: Option<&SizingField>,
    options: &Options,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    let phase = monitor.phase("project");
    let spline = CubicSpline::new(field);
    let mut points = prepare(particles, &spline)?;
    drop(phase);
    // concurrent, because the triangulation uses a single thread and both results are independent
    let phase = monitor.phase("triangulate, topology");
    let (delaunay, topology) = rayon::join(|| points.triangulate(), || FieldTopology::watched(&spline, monitor));
    let (delaunay, topology) = (delaunay?, topology?);
    drop(phase);
    monitor.check()?;
    let Joined { interfaces: Interfaces { mut mesh, .. }, sizes, report: refined, cocone, parted } =
        join(delaunay, &points, &spline, &topology, field, options, monitor)?;

    let tree = if sizing.is_none() { KdTree::new(&sizes.0) } else { KdTree::default() };
    let size_near = |p: DVec3| tree.nearest(p).map_or(spline.geometry().mean_spacing(), |(v, _)| sizes.1[v]);
    let size = |p: DVec3| sizing.map_or_else(|| size_near(p), |h| h.at(p));
    let completion = Completion { spline: &spline, topology: &topology, samples: field, size: &size, options };
    let (improved, _) = completion.improve(&mut mesh, None, monitor)?;
    let (mesh, completed) = completion.check(mesh, Some(&refined), monitor)?;
    let sizes = mesh.vertices.par_iter().map(|&p| size(p)).collect();
    let Completed { checked, topology, failed, doubtful } = completed;
    let joining = Joining { prepared: points.report, taken: points.positions.len(), refined, cocone, parted };
    let (joining, kept) = (Some(joining), Vec::new());
    let field = Arc::new(spline);
    Ok(Reconstruction { field, mesh, sizes, joining, kept, improved, checked, topology, failed, doubtful })
}
