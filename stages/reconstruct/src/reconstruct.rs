//! The stage as one call: particles on F = 0 become a watertight triangle mesh of F = 0, checked.
//!
//! Its topology is that of F, computed from F alone before there is any mesh. The particles are put onto F = 0 and triangulated (Delaunay in
//! space). Tetrahedra are labelled inside or outside: by the sign of F at their circumcentres, or by the shape of the Voronoi cells (Tight
//! Cocone). The facets between them are the surface, closed by construction. Criteria compare it with F: is it a manifold, has it the
//! components and the Euler characteristics of F, does a facet stray from F = 0 or turn away from it, does a voxel centre lie on its
//! wrong side. A queue holds what is violated, most needed first, and for each a point is added at the centre of the facet's surface ball; only what that
//! changed is looked at again, until the queue is empty or there is no room. The facets are extracted, and sheets that touch in a point are parted. The
//! worst triangles are lifted by local moves that break no criterion. At last everything a simulation counts on is checked anew, on the
//! mesh as it is and against F as it was.

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

/// A mesh with what is known of it.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// F.
    pub field: CubicSpline,
    /// The mesh, grid frame, triangles counter-clockwise seen from outside.
    pub mesh: TriangleMesh,
    /// Target edge length at each vertex, mm.
    pub sizes: Vec<f64>,
    /// Particles taken and not.
    pub prepared: PrepareReport,
    /// Points that were triangulated at first.
    pub taken: usize,
    /// What refinement did.
    pub refined: RefineReport,
    /// What Tight Cocone found, where that was the method.
    pub cocone: Option<CoconeReport>,
    /// Vertices added where sheets touch in a point.
    pub parted: usize,
    /// What improvement did.
    pub improved: ImproveReport,
    /// What was checked.
    pub checked: CheckReport,
    /// The mesh beside the topology of F.
    pub topology: TopologyReport,
    /// Checks that failed, in words.
    pub failed: Vec<String>,
    /// What deserves a warning but fails no check, in words.
    pub doubtful: Vec<String>,
}

/// Joins particles, in the grid frame of the samples `field` of F, into a mesh of F = 0. Without `sizing`, h at a vertex is that of the nearest
/// particle. The result is the same on any number of threads.
///
/// # Errors
/// On particles that are not on F = 0, all in one plane or that enclose nothing, and when interrupted. A mesh that fails a check is
/// no error ([`Reconstruction::failed`]).
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
    // the triangulation keeps one thread busy, and neither knows of the other
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
        // a distance from F = 0 that was asked for wants its points
        thins: options.max_deviation.is_none(),
        sides: options.guarded(field),
        ..ImproveOptions::polish()
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

/// F, and its samples where grid nodes are compared.
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
        let samples = self.samples?;
        let linear = |[i, j, k]: [usize; 3]| samples.geometry.linear(i, j, k);
        Some(nodes_on_wrong_side(&interfaces.mesh, samples).into_iter().map(linear).collect())
    }
}
