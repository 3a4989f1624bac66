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

use crate::check::{CheckOptions, CheckReport, Truth, check};
use crate::held::one_of_each_component;
use crate::improve::{ImproveOptions, ImproveReport, improve_holding};
use crate::interfaces::Interfaces;
use crate::join::{Joined, join};
pub use crate::options::{Method, Options};
use crate::prepare::{PrepareReport, prepare};
use crate::queue::Reason;
use crate::refine::RefineReport;
use crate::tight_cocone::CoconeReport;
use crate::verdict::TopologyReport;
use glam::DVec3;
use isoparticles_field::materials::MaterialId;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_field::sizing::SizingField;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::inside::nodes_on_wrong_side;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;

/// A mesh with the results of all steps.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// The spline F.
    pub field: CubicSpline,
    /// The mesh in the grid frame. Triangles are counter-clockwise as seen from outside.
    pub mesh: TriangleMesh,
    /// Target edge length h at each vertex, mm.
    pub sizes: Vec<f64>,
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

    let phase = monitor.phase("improve");
    let tree = if sizing.is_none() { KdTree::new(&sizes.0) } else { KdTree::default() };
    let size_near = |p: DVec3| tree.nearest(p).map_or(spline.geometry().mean_spacing(), |(v, _)| sizes.1[v]);
    let size = |p: DVec3| sizing.map_or_else(|| size_near(p), |h| h.at(p));
    let how = ImproveOptions {
        target: options.improve_below,
        relaxation_sweeps: options.relaxation_sweeps,
        // an explicit deviation bound disables thinning
        thins: options.max_deviation.is_none(),
        sides: options.guarded(field),
    };
    let step = || Ok(monitor.check()?);
    let held = one_of_each_component(&mesh, &spline, &topology);
    let improved = improve_holding(&mut mesh, &held, &spline, &size, &how, &step)?;
    drop(phase);
    monitor.check()?;

    let phase = monitor.phase("check");
    let how = CheckOptions {
        truth: Some(&ObjectTruth { field: &spline, samples: (!options.open_border).then_some(field) }),
        keeps_nodes: options.keeps_voxels,
        min_radius_ratio: options.min_radius_ratio,
        max_vertex_distance: Some(options.max_vertex_distance),
        open_border: options.open_border,
        ..CheckOptions::default()
    };
    let interfaces = Interfaces::of_object(mesh);
    let checked = check(&interfaces, &how);
    let mesh = interfaces.mesh;
    let found = TopologyReport::new(&mesh, &spline, &topology);
    let (wrong, mut doubtful) = found.differences(options.open_border);
    let failed = [checked.failed.clone(), wrong].concat();
    if let Some(count) = refined.unresolved.get(&Reason::CriticalPoint) {
        doubtful.push(format!(
            "{count} critical points of F are on the wrong side of the mesh: necks, gaps or specks there are too thin for the particle spacing"
        ));
    }
    let sizes = mesh.vertices.par_iter().map(|&p| size(p)).collect();
    drop(phase);
    Ok(Reconstruction {
        field: spline,
        mesh,
        sizes,
        prepared: points.report,
        taken: points.positions.len(),
        refined,
        cocone,
        parted,
        improved,
        checked,
        topology: found,
        failed,
        doubtful,
    })
}

/// F, and its samples if grid nodes are compared with the mesh.
pub(crate) struct ObjectTruth<'a> {
    pub(crate) field: &'a CubicSpline,
    pub(crate) samples: Option<&'a Image<f32>>,
}

impl Truth for ObjectTruth<'_> {
    fn geometry(&self) -> &Geometry {
        self.field.geometry()
    }

    fn value_gradient(&self, _between: [MaterialId; 2], p: DVec3) -> (f64, DVec3) {
        self.field.value_gradient(p)
    }

    fn wrong_nodes(&self, interfaces: &Interfaces) -> Option<Vec<usize>> {
        Some(nodes_on_wrong_side(&interfaces.mesh, self.samples?))
    }
}
