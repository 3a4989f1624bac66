//! The whole stage as one function: turns particles on strata into a conforming complex of the
//! interfaces between materials, improves its triangles, and checks it.

use super::complex::Complex;
use super::contract::{Which, contract};
use super::improve::improve;
use super::nodes::Nodes;
use super::pieces::{Pieces, missing, pieces};
use super::prepare::{Taken, onto, prepare};
use super::refine::{RefineReport, Refinement};
use super::simplify::simplify;
use crate::check::{CheckOptions, CheckReport, Fault, Simplices, Truth, check};
use crate::improve::{ImproveOptions, ImproveReport};
use crate::interfaces::Interfaces;
use crate::options::Options;
use crate::queue::Reason;
use glam::DVec3;
use isoparticles_field::materials::{Indicators, Material, MaterialId, Stratum};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Geometry;
use rayon::prelude::*;

/// A complex of interfaces, with the reports of all steps.
pub struct Reconstruction {
    /// The triangles between materials, in the grid frame.
    pub interfaces: Interfaces,
    /// Target edge length at each vertex, mm.
    pub sizes: Vec<f64>,
    /// How the particles were joined; `None` for an updated complex.
    pub joining: Option<Joining>,
    /// World positions of the vertices that an update has kept, by vertex.
    pub kept: Vec<(u32, DVec3)>,
    /// Report of the improvement.
    pub improved: ImproveReport,
    /// Report of the checks.
    pub checked: CheckReport,
    /// The components of each material on the grid nodes.
    pub pieces: Vec<Pieces>,
    /// Descriptions of the checks that failed.
    pub failed: Vec<String>,
}

/// Reports of the steps that join particles to a complex.
pub struct Joining {
    /// Numbers of particles and segments that were used, added or not used.
    pub taken: Taken,
    /// Report of the refinement.
    pub refined: RefineReport,
}

/// The indicators, and the material of each grid node.
pub(super) struct MaterialsTruth<'a> {
    pub(super) indicators: &'a dyn Indicators,
    pub(super) nodes: &'a Nodes,
}

impl Truth for MaterialsTruth<'_> {
    fn geometry(&self) -> &Geometry {
        self.nodes.geometry()
    }

    fn value_gradient(&self, [i, j]: [MaterialId; 2], p: DVec3) -> (f64, DVec3) {
        self.indicators.difference_gradient(i, j, p)
    }

    fn wrong_nodes(&self, interfaces: &Interfaces) -> Option<Vec<usize>> {
        Some(self.nodes.wrong_by(interfaces))
    }
}

/// Reconstructs the interfaces between the materials of a table from particles on the strata of the
/// indicators (grid frame). Without `sizing`, h at a position is that of the nearest point of the
/// refined complex. The result is the same for any number of threads.
///
/// # Errors
/// If the particles are not on their strata or lie in one plane, and if the run is interrupted. A
/// complex that fails a check is not an error ([`Reconstruction::failed`]).
pub fn reconstruct(
    (particles, strata): (&ParticleSet, &Strata),
    indicators: &dyn Indicators,
    table: &[Material],
    sizing: Option<&SizingField>,
    options: &Options,
    monitor: &dyn Monitor,
) -> Result<Reconstruction> {
    let phase = monitor.phase("project, triangulate");
    let prepared = prepare(particles, strata, indicators)?;
    let taken = prepared.report;
    let nodes = Nodes::new(&particles.geometry, indicators);
    drop(phase);
    monitor.check()?;

    let phase = monitor.phase("refine");
    let complex = Complex::new(prepared, indicators, particles.geometry.upper_corner(), options);
    let guarded = options.keeps_voxels.then_some(&nodes);
    let mut refinement = Refinement::new(complex, guarded);
    let facets = refinement.run(|points| {
        monitor.note(&|| format!("{points} points"));
        Ok(monitor.check()?)
    })?;
    let Refinement { complex, report: mut refined, .. } = refinement;
    let (mut interfaces, mut dimensions) = complex.interfaces(&facets);
    if let Some(left) = refined.unresolved.remove(&Reason::Vertex) {
        let project = |[i, j]: [MaterialId; 2], p| onto(indicators, Stratum::interface(i, j), p, indicators.voxel());
        refined.parted = interfaces.part_sheets(project);
        dimensions.resize(interfaces.mesh.vertices.len(), 2);
        if left > refined.parted {
            refined.unresolved.insert(Reason::Vertex, left - refined.parted);
        }
    }
    let tree = KdTree::new(complex.points());
    let size_near = |p: DVec3| tree.nearest(p).map_or(indicators.voxel(), |(v, _)| complex.sizes[v]);
    let size = |p: DVec3| sizing.map_or_else(|| size_near(p), |h| h.at(p));
    if !options.keeps_voxels {
        refined.contracted = contract(&mut interfaces, &mut dimensions, Which::Short, &size).len();
    }
    drop(phase);

    let phase = monitor.phase("improve");
    let how = ImproveOptions {
        target: options.improve_below,
        relaxation_sweeps: options.relaxation_sweeps,
        // Removing vertices between junctions would change volumes: by 7 % for the nested balls of
        // the tests at the coarse size, which is more than the test allows.
        thins: false,
        ..ImproveOptions::default()
    };
    let step = || Ok(monitor.check()?);
    let (mut improved, _) = improve(&mut interfaces, &dimensions, indicators, guarded, &size, &how, &step)?;
    if !options.keeps_voxels {
        refined.contracted += simplify(&mut interfaces, indicators, &size, (&how, &mut improved), &step)?;
    }
    drop(phase);
    monitor.check()?;
    let sizes = interfaces.mesh.vertices.par_iter().map(|&p| size(p)).collect();
    let (checked, pieces, failed) =
        checked(&interfaces, &MaterialsTruth { indicators, nodes: &nodes }, table, options, monitor);
    let joining = Some(Joining { taken, refined });
    Ok(Reconstruction { interfaces, sizes, joining, kept: Vec::new(), improved, checked, pieces, failed })
}

/// Checks a complex. Returns the report, the components of each material on the grid nodes, and the
/// failed checks in words.
pub(super) fn checked(
    interfaces: &Interfaces,
    truth: &MaterialsTruth,
    table: &[Material],
    options: &Options,
    monitor: &dyn Monitor,
) -> (CheckReport, Vec<Pieces>, Vec<String>) {
    let _phase = monitor.phase("check");
    let how = CheckOptions {
        truth: Some(truth),
        table,
        keeps_nodes: options.keeps_voxels,
        min_radius_ratio: options.min_radius_ratio,
        max_vertex_distance: Some(options.max_vertex_distance),
        accept_forced: options.accept_forced,
        ..CheckOptions::default()
    };
    let checked = check(interfaces, &how);
    let mut failed = checked.failed.clone();
    let real = truth.indicators.first_beyond().map_or(table.len(), MaterialId::index);
    let pieces = match checked.offenders.get(&Fault::NodesOnWrongSide) {
        Some(Simplices::Nodes(wrong)) => pieces(truth.nodes, wrong, &table[..real]),
        _ => Vec::new(),
    };
    failed.extend(missing(&pieces));
    (checked, pieces, failed)
}
