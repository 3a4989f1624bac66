//! Computes the surface of one object from triangulated points on F = 0, by the restricted Delaunay
//! triangulation or by Tight Cocone.

use crate::complete::Joining;
use crate::interfaces::Interfaces;
use crate::options::{Method, Options};
use crate::prepare::{ON_SURFACE, SurfacePoints};
use crate::queue::Reason;
use crate::refine::{RefineOptions, Refinement};
use crate::restricted::Facet;
use crate::tight_cocone::{CoconeReport, tight_cocone};
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Maximum number of rounds that add points for Tight Cocone. Each round takes as long as the
/// first. Clean volumes need one or two rounds, and noise needs four to six.
pub(crate) const COCONE_ROUNDS: usize = 12;

/// The same limit while the points enclose no solid. Each such round at least doubles their number.
const COCONE_ROUNDS_IN_VAIN: usize = 2;

/// The surface before improvement.
pub(crate) struct Joined {
    /// The surface in the grid frame.
    pub(crate) interfaces: Interfaces,
    /// All points of the triangulation, and the target edge length at each, mm.
    pub(crate) points: (Vec<DVec3>, Vec<f64>),
    pub(crate) joining: Joining,
}

/// Returns the surface of triangulated points on F = 0, by the method in `options`.
///
/// # Errors
/// If a point cannot be inserted, if Tight Cocone finds no solid, or if the run is interrupted.
pub(crate) fn join(
    delaunay: Delaunay,
    points: &SurfacePoints,
    spline: &CubicSpline,
    topology: &FieldTopology,
    samples: &Image<f32>,
    options: &Options,
    monitor: &dyn Monitor,
) -> Result<Joined> {
    let limits = RefineOptions {
        max_rounds: options.max_rounds,
        max_deviation: options.max_deviation,
        open_border: options.open_border,
    };
    let phase = monitor.phase("refine");
    let mut refinement = Refinement::of(delaunay, points, spline, topology, limits);
    if options.keeps_voxels && !options.open_border {
        refinement.keep_nodes(samples);
    }
    let mut hear = |count: usize| {
        monitor.note(&|| format!("{count} points"));
        Ok(monitor.check()?)
    };
    let (mut facets, defects) = refinement.run(&mut hear)?;
    let (mut touches, mut cocone) = (!defects.vertices.is_empty(), None);
    drop(phase);
    if options.method == Method::TightCocone {
        let _phase = monitor.phase("cocone");
        let (by_cocones, report) = cocones(&mut refinement, options.max_rounds, &mut hear)?;
        touches = !refinement.object.defects(&by_cocones).vertices.is_empty();
        (facets, cocone) = (by_cocones, Some(report));
    }
    let triangles = facets.iter().map(|facet| facet.vertices);
    let mut interfaces = Interfaces::compact_object(refinement.object.points(), triangles).0;
    let voxel = spline.geometry().mean_spacing();
    let project = |_, p| spline.project(p, voxel, ON_SURFACE * voxel);
    let mut refined = refinement.report.clone();
    refined.parted = if touches { interfaces.separate_touching(project) } else { 0 };
    let left = refined.unresolved.get(&Reason::CriticalPoint);
    let doubtful = left.map(|count| format!(
        "{count} critical points of F are on the wrong side of the mesh: necks, gaps or specks there are too thin for the particle spacing"
    ));
    let joining = Joining { prepared: points.report, refined, cocone, doubtful: doubtful.into_iter().collect() };
    Ok(Joined { interfaces, points: (refinement.object.points().to_vec(), refinement.object.sizes), joining })
}

/// Returns the surface by Tight Cocone, and its report. While this surface lacks parts of the
/// restricted surface, or grid nodes are on its wrong side, points are added and both surfaces are
/// computed again.
pub(crate) fn cocones(
    refinement: &mut Refinement,
    max_rounds: usize,
    hear: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<(Vec<Facet>, CoconeReport)> {
    for round in 0.. {
        let found = cocone_of(refinement);
        hear(refinement.object.points().len())?;
        let limit = if found.is_ok() { COCONE_ROUNDS } else { COCONE_ROUNDS_IN_VAIN };
        // points that enclose no solid have no surface, so all facets are missing
        let closed = found.as_ref().map_or(&[][..], |(facets, _)| facets);
        let may_go_on = round < max_rounds.min(limit);
        if !may_go_on || refinement.insert_for_other(closed, &mut *hear)? == 0 {
            let (facets, report) = found?;
            let facets = refinement.object.without_border_closure(facets);
            refinement.compare_other(&facets);
            return Ok((facets, report));
        }
        // keeps the restricted surface correct, as it is the reference for the next comparison
        refinement.run(&mut *hear)?;
    }
    unreachable!("the rounds end")
}

/// Returns the surface by Tight Cocone of all points of a refinement, with grad F as normals.
pub(crate) fn cocone_of(refinement: &Refinement) -> Result<(Vec<Facet>, CoconeReport)> {
    let (delaunay, field) = (refinement.object.restricted.delaunay(), refinement.object.restricted.field());
    let normals: Vec<DVec3> = delaunay.points().par_iter().map(|&p| field.value_gradient(p).1).collect();
    tight_cocone(delaunay, Some(&normals))
}
