//! The stage as one call: particles on strata become one conforming complex of triangles between materials, checked.

use super::check::{CheckOptions, ComplexReport, check};
use super::complex::Complex;
use super::improve::improve;
use super::interfaces::Interfaces;
use super::nodes::Nodes;
use super::prepare::{Taken, prepare};
use super::refine::{RefineReport, Refinement};
use crate::improve::{ImproveOptions, ImproveReport};
use crate::options::Options;
use crate::queue::Reason;
use glam::DVec3;
use isoparticles_field::materials::{Indicators, Material};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use rayon::prelude::*;

/// A complex with what is known of it.
pub struct Reconstruction {
    /// The triangles between materials, grid frame.
    pub interfaces: Interfaces,
    /// Target edge length at each vertex, mm.
    pub sizes: Vec<f64>,
    /// Particles taken and not.
    pub taken: Taken,
    /// What refinement did.
    pub refined: RefineReport,
    /// What improvement did.
    pub improved: ImproveReport,
    /// What was checked.
    pub checked: ComplexReport,
}

/// Joins particles on the strata of indicators, in their grid frame, into the interfaces between the materials of a table. Without `sizing`, h at a vertex is that
/// of the nearest particle. The result is the same on any number of threads.
///
/// # Errors
/// On particles that are not on their strata or all in one plane, and when interrupted. A complex that fails a check is no error ([`ComplexReport::failed`]).
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
    let complex = Complex::new(prepared, indicators, particles.geometry.upper_corner(), options.max_deviation);
    let guarded = options.keeps_voxels.then_some(&nodes);
    let mut refinement = Refinement::new(complex, guarded);
    let facets = refinement.run(|points| {
        monitor.note(&|| format!("{points} points"));
        Ok(monitor.check()?)
    })?;
    let Refinement { complex, report: mut refined, .. } = refinement;
    let (mut interfaces, mut dimensions) = Interfaces::of(&complex, &facets);
    if let Some(left) = refined.unresolved.remove(&Reason::Vertex) {
        refined.parted = interfaces.part_sheets(indicators);
        dimensions.resize(interfaces.mesh.vertices.len(), 2);
        if left > refined.parted {
            refined.unresolved.insert(Reason::Vertex, left - refined.parted);
        }
    }
    drop(phase);

    let phase = monitor.phase("improve");
    let tree = KdTree::new(complex.points());
    let size_near = |p: DVec3| tree.nearest(p).map_or(indicators.voxel(), |(v, _)| complex.sizes[v]);
    let size = |p: DVec3| sizing.map_or_else(|| size_near(p), |h| h.at(p));
    let how = ImproveOptions {
        target: options.improve_below,
        relaxation_sweeps: options.relaxation_sweeps,
        // fewer points between junctions cost volume (nested balls in the tests: 7 % at the coarse size, more than is passed)
        thins: false,
        ..ImproveOptions::polish()
    };
    let step = || Ok(monitor.check()?);
    let improved = improve(&mut interfaces, &dimensions, indicators, guarded, &size, &how, &step)?;
    drop(phase);
    monitor.check()?;

    let phase = monitor.phase("check");
    let how = CheckOptions {
        indicators,
        table,
        nodes: &nodes,
        keeps_nodes: options.keeps_voxels,
        min_radius_ratio: options.min_radius_ratio,
        accept_forced: options.accept_forced,
        max_vertex_distance: options.max_vertex_distance,
    };
    let checked = check(&interfaces, &how);
    let sizes = interfaces.mesh.vertices.par_iter().map(|&p| size(p)).collect();
    drop(phase);
    Ok(Reconstruction { interfaces, sizes, taken, refined, improved, checked })
}
