//! Improves and checks the mesh of one object: the last steps of a reconstruction and of an update.

use crate::check::{CheckOptions, CheckReport, Truth, check};
use crate::held::one_of_each_component;
use crate::improve::{ImproveOptions, ImproveReport, improve};
use crate::interfaces::Interfaces;
use crate::options::Options;
use crate::queue::Reason;
use crate::refine::RefineReport;
use crate::verdict::TopologyReport;
use glam::DVec3;
use isoparticles_field::materials::MaterialId;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::inside::nodes_on_wrong_side;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::{Geometry, Image};

/// Inputs of the last steps, apart from the mesh.
pub(crate) struct Completion<'a> {
    pub(crate) spline: &'a CubicSpline,
    pub(crate) topology: &'a FieldTopology,
    /// Samples of F.
    pub(crate) samples: &'a Image<f32>,
    /// Target edge length h (mm) at a position in the grid frame.
    pub(crate) size: &'a (dyn Fn(DVec3) -> f64 + Sync),
    pub(crate) options: &'a Options,
}

/// Results of the checks.
pub(crate) struct Completed {
    pub(crate) checked: CheckReport,
    /// Comparison of the mesh with the topology of F.
    pub(crate) topology: TopologyReport,
    /// The checks that failed, in words.
    pub(crate) failed: Vec<String>,
    /// Warnings that do not fail a check, in words.
    pub(crate) doubtful: Vec<String>,
}

impl Completion<'_> {
    /// Improves the triangles of a mesh in the grid frame. If `around` is given, the mesh changes
    /// only near these vertices, and the lengths of the edges there are adjusted to h. Also returns
    /// the index of each vertex in the improved mesh (`u32::MAX` if it was removed).
    pub(crate) fn improve(
        &self,
        mesh: &mut TriangleMesh,
        around: Option<&[bool]>,
        monitor: &dyn Monitor,
    ) -> Result<(ImproveReport, Vec<u32>)> {
        let _phase = monitor.phase("improve");
        let how = ImproveOptions {
            target: self.options.improve_below,
            relaxation_sweeps: self.options.relaxation_sweeps,
            // an explicit deviation bound disables thinning
            thins: self.options.max_deviation.is_none(),
            sides: self.options.guarded(self.samples),
            around,
            adjusts: around.is_some(),
        };
        let held = one_of_each_component(mesh, self.spline, self.topology);
        improve(mesh, &held, self.spline, self.size, &how, &|| Ok(monitor.check()?))
    }

    /// Checks a mesh and compares its topology with that of F. `refined` is the report of the
    /// refinement, if there was one.
    pub(crate) fn check(
        &self,
        mesh: TriangleMesh,
        refined: Option<&RefineReport>,
        monitor: &dyn Monitor,
    ) -> Result<(TriangleMesh, Completed)> {
        monitor.check()?;
        let _phase = monitor.phase("check");
        let Self { spline, options, .. } = *self;
        let how = CheckOptions {
            truth: Some(&ObjectTruth { field: spline, samples: (!options.open_border).then_some(self.samples) }),
            keeps_nodes: options.keeps_voxels,
            min_radius_ratio: options.min_radius_ratio,
            max_vertex_distance: Some(options.max_vertex_distance),
            open_border: options.open_border,
            ..CheckOptions::default()
        };
        let interfaces = Interfaces::of_object(mesh);
        let checked = check(&interfaces, &how);
        let mesh = interfaces.mesh;
        let topology = TopologyReport::new(&mesh, spline, self.topology);
        let (wrong, mut doubtful) = topology.differences(options.open_border);
        let failed = [checked.failed.clone(), wrong].concat();
        if let Some(count) = refined.and_then(|refined| refined.unresolved.get(&Reason::CriticalPoint)) {
            doubtful.push(format!(
                "{count} critical points of F are on the wrong side of the mesh: necks, gaps or specks there are too thin for the particle spacing"
            ));
        }
        Ok((mesh, Completed { checked, topology, failed, doubtful }))
    }
}

/// F, and the samples of F if the sides of the grid nodes are checked.
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
