//! The whole stage as one function: turns particles on strata into a conforming complex of the
//! interfaces between materials, improves its triangles, and checks it.

use super::complex::Complex;
use super::contract::{Which, contract};
use super::nodes::Nodes;
use super::prepare::{onto, prepare};
use super::refine::Refinement;
use super::simplify::simplify;
use super::subject::Materials;
use crate::complete::{Completion, size_at};
use crate::complete::{Joining, Reconstruction};
use crate::options::Options;
use crate::queue::Reason;
use crate::refine::RefineReport;
use isoparticles_field::materials::{Indicators, Material, MaterialId, Stratum};
use isoparticles_field::particle_set::{ParticleSet, Strata};
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use serde_json::json;

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
    let phase = monitor.phase("triangulate, topology");
    // concurrent, because the triangulation uses a single thread and both results are independent
    let points = || prepare(particles, strata, indicators);
    let (points, nodes) = rayon::join(points, || Nodes::new(&particles.geometry, indicators));
    let points = points?;
    let prepared = points.report;
    drop(phase);
    monitor.check()?;

    let phase = monitor.phase("refine");
    let complex = Complex::new(points, indicators, particles.geometry.upper_corner(), options);
    let mut refinement = Refinement::new(complex, options.keeps_voxels.then_some(&nodes));
    let facets = refinement.run(|points| {
        monitor.note(&|| format!("{points} points"));
        Ok(monitor.check()?)
    })?;
    let Refinement { complex, report: mut refined, .. } = refinement;
    let (mut interfaces, mut dimensions) = complex.interfaces(&facets);
    if let Some(left) = refined.unresolved.remove(&Reason::Vertex) {
        let project = |[i, j]: [MaterialId; 2], p| onto(indicators, Stratum::interface(i, j), p, indicators.voxel());
        refined.parted = interfaces.separate_touching(project);
        dimensions.resize(interfaces.mesh.vertices.len(), 2);
        if left > refined.parted {
            refined.unresolved.insert(Reason::Vertex, left - refined.parted);
        }
    }
    let size = size_at(sizing, complex.points(), &complex.sizes);
    if !options.keeps_voxels {
        refined.contracted = contract(&mut interfaces, &mut dimensions, Which::Short, &size).len();
    }
    drop(phase);

    let phase = monitor.phase("improve");
    let completion =
        Completion { subject: &Materials { indicators, nodes: &nodes, table }, size: &size, options, monitor };
    let (mut improved, _) = completion.improve(&mut interfaces, &dimensions, None, false)?;
    if !options.keeps_voxels {
        refined.contracted += simplify(&completion, &mut interfaces, &mut improved)?;
    }
    drop(phase);
    let doubtful = doubts(&refined).into_iter().collect();
    let joining = Joining { prepared, refined, cocone: None, doubtful };
    completion.check(interfaces, improved, Some(joining), Vec::new())
}

/// Describes the violations that the refinement has left, if there are any.
fn doubts(refined: &RefineReport) -> Option<String> {
    let left: Vec<String> = refined.unresolved.iter().map(|(reason, n)| format!("{n} of {}", json!(reason))).collect();
    (!left.is_empty()).then(|| format!(
        "refinement ended at its smallest radius with violations left: {}; where materials meet at small angles, or a layer ends in an edge, a smaller h helps \
         (sizefield without --uniform grades it by thickness)",
        left.join(", ")
    ))
}
