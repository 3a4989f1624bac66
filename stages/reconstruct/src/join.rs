//! From triangulated points on F = 0 to a mesh: the facets by either method.

use crate::pinched::part_sheets;
use crate::prepare::{ON_SURFACE, SurfacePoints};
use crate::reconstruct::{Method, Options};
use crate::refine::{RefineOptions, RefineReport, Refinement};
use crate::restricted::Facet;
use crate::tight_cocone::{CoconeReport, tight_cocone};
use glam::DVec3;
use isoparticles_delaunay::Delaunay;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::inside::nodes_on_wrong_side;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Rounds of Tight Cocone on more points, each of which takes as long as the first: one or two on clean volumes, four to six on noise.
pub(crate) const COCONE_ROUNDS: usize = 12;

/// The same while the points enclose nothing, and each round doubles them or more.
const COCONE_ROUNDS_IN_VAIN: usize = 2;

/// A mesh joined from particles, before improvement.
pub(crate) struct Joined {
    /// The mesh, grid frame.
    pub(crate) mesh: TriangleMesh,
    /// All points of the triangulation, and the target edge length at each.
    pub(crate) sizes: (Vec<DVec3>, Vec<f64>),
    /// What the refinement did, or would have had to do.
    pub(crate) report: RefineReport,
    /// What Tight Cocone found, where that was the method.
    pub(crate) cocone: Option<CoconeReport>,
    /// Vertices added where sheets touch in a point.
    pub(crate) parted: usize,
}

/// Joins triangulated points on F = 0 by the method asked for.
///
/// # Errors
/// When the points enclose nothing, and when interrupted.
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
    let mut refinement = Refinement::of(delaunay, points, spline, topology, limits);
    let work = Work { max_rounds: options.max_rounds, nodes: options.guarded(samples), monitor };
    let phase = monitor.phase("refine");
    let mut facets = work.refine(&mut refinement)?;
    drop(phase);
    let mut cocone = None;
    if options.method == Method::TightCocone {
        let _phase = monitor.phase("cocone");
        let (by_cocones, report) = work.cocones(&mut refinement)?;
        (facets, cocone) = (by_cocones, Some(report));
    }
    let (mut mesh, used) = compact(refinement.restricted.points(), &facets);
    let pinched: Vec<(u32, Vec<u32>)> = refinement.defects(&facets).vertices;
    let mut parted = 0;
    if !pinched.is_empty() {
        let number = |v: u32| used.binary_search(&v).expect("a vertex of a facet is in the mesh") as u32;
        let pinched: Vec<_> = pinched.into_iter().map(|(v, around)| (number(v), around)).collect();
        let voxel = spline.geometry().mean_spacing();
        parted = part_sheets(&mut mesh, &pinched, |p| spline.project(p, voxel, ON_SURFACE * voxel));
    }
    Ok(Joined {
        mesh,
        sizes: (refinement.restricted.points().to_vec(), refinement.sizes.clone()),
        report: refinement.report.clone(),
        cocone,
        parted,
    })
}

/// How far the refinement goes, and who watches.
struct Work<'a> {
    max_rounds: usize,
    /// Samples of F whose nodes must lie on their side, if any.
    nodes: Option<&'a Image<f32>>,
    monitor: &'a dyn Monitor,
}

impl Work<'_> {
    /// Adds points until the restricted surface is that of F, and no grid node of a label volume lies on its wrong side.
    fn refine(&self, refinement: &mut Refinement) -> Result<Vec<Facet>> {
        let hear = |round: usize, count: usize| {
            self.monitor.note(&|| format!("round {round}: {count} points"));
            Ok(self.monitor.check()?)
        };
        let mut facets = refinement.run(hear)?;
        // the nodes have rounds of their own: a stubborn handle elsewhere must not use them up
        refinement.allow_rounds(self.max_rounds);
        let end = refinement.report.rounds + self.max_rounds;
        while refinement.report.rounds < end && self.add_at_nodes(refinement, &facets)? > 0 {
            facets = refinement.run(hear)?;
        }
        Ok(facets)
    }

    /// Adds points at the grid nodes that lie on the wrong side of the facets; returns how many.
    fn add_at_nodes(&self, refinement: &mut Refinement, facets: &[Facet]) -> Result<usize> {
        let Some(samples) = self.nodes else { return Ok(0) };
        let (mesh, _) = compact(refinement.restricted.points(), facets);
        let nodes = nodes_on_wrong_side(&mesh, samples);
        self.monitor.note(&|| format!("{} grid nodes on the wrong side", nodes.len()));
        if nodes.is_empty() { Ok(0) } else { refinement.insert_near_nodes(&nodes, facets) }
    }

    /// Tight Cocone of the points that are there by now, and of those added where it lacks what the surface by the sign of F has, or
    /// leaves grid nodes on the wrong side.
    fn cocones(&self, refinement: &mut Refinement) -> Result<(Vec<Facet>, CoconeReport)> {
        for round in 0.. {
            let found = cocone_of(refinement);
            self.monitor.check()?;
            let limit = if found.is_ok() { COCONE_ROUNDS } else { COCONE_ROUNDS_IN_VAIN };
            let may_go_on = round < self.max_rounds.min(limit);
            // points that enclose nothing have no surface
            let closed = found.as_ref().map_or(&[][..], |(facets, _)| facets);
            let mut added = if may_go_on { refinement.insert_for_other(closed)? } else { 0 };
            let facets = refinement.without_border_closure(closed.to_vec());
            if may_go_on && added == 0 {
                added = self.add_at_nodes(refinement, &facets)?;
            }
            self.monitor.note(&|| format!("Tight Cocone, round {round}: {added} points added"));
            if added == 0 {
                let (_, report) = found?;
                refinement.compare_other(&facets);
                return Ok((facets, report));
            }
            // the surface by the sign of F stays right, so that it can be compared with
            refinement.allow_rounds(self.max_rounds);
            self.refine(refinement)?;
        }
        unreachable!("the rounds end")
    }
}

/// Tight Cocone of all points of a refinement, with grad F for normals.
pub(crate) fn cocone_of(refinement: &Refinement) -> Result<(Vec<Facet>, CoconeReport)> {
    let (delaunay, field) = (refinement.restricted.delaunay(), refinement.restricted.field());
    let normals: Vec<DVec3> = delaunay.points().par_iter().map(|&p| field.value_gradient(p).1).collect();
    tight_cocone(delaunay, Some(&normals))
}

/// The mesh of the facets with the vertices that they use, and the point behind each vertex.
pub(crate) fn compact(points: &[DVec3], facets: &[Facet]) -> (TriangleMesh, Vec<u32>) {
    let mut number = vec![u32::MAX; points.len()];
    facets.iter().flat_map(|f| f.vertices).for_each(|v| number[v as usize] = 0);
    let used: Vec<u32> = (0..points.len() as u32).filter(|&v| number[v as usize] == 0).collect();
    for (n, &v) in used.iter().enumerate() {
        number[v as usize] = n as u32;
    }
    let mesh = TriangleMesh {
        vertices: used.iter().map(|&v| points[v as usize]).collect(),
        triangles: facets.iter().map(|f| f.vertices.map(|v| number[v as usize])).collect(),
    };
    (mesh, used)
}
