//! Meshes points without a distance field by Tight Cocone: particles, or a point cloud of another
//! program. Without F, no point is projected, and the mesh is neither improved nor compared with F.
//! The report states this.

use crate::args::Args;
use crate::check::{CheckOptions, check};
use crate::input::about;
use crate::interfaces::Interfaces;
use crate::offending::offending;
use crate::output::{Made, describe_mesh};
use crate::prepare::SurfacePoints;
use crate::tight_cocone::{CoconeReport, tight_cocone};
use glam::DVec3;
use isoparticles_field::particle_set::ParticleSet;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_mesh::point_cloud::PointCloud;
use isoparticles_mesh::quality::radius_ratios;
use isoparticles_mesh::surface::{DataArray, Surface};
use isoparticles_mesh::{TriangleMesh, components};
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::Result;
use isoparticles_stage::meta::{self, Source, SurfaceMeta};
use isoparticles_stage::space::parameter;
use isoparticles_volume::{Geometry, Space};
use serde_json::json;

/// Minimum share of points with an umbrella. Below it, a warning says that the surface is
/// uncertain.
const MANY_UMBRELLAS: f64 = 0.8;

/// Maximum share of points that are not vertices of the mesh. Above it, a warning is issued.
const MANY_UNUSED: f64 = 0.01;

/// Points to mesh, and the transform from their frame to the world.
pub(crate) struct Points {
    points: SurfacePoints,
    geometry: Geometry,
    /// Whether each point has a target edge length.
    has_sizes: bool,
}

impl Points {
    /// Returns the points of a point cloud, which are in world coordinates.
    pub(crate) fn of_cloud(cloud: PointCloud) -> Self {
        let mut geometry = Geometry::axis_aligned([1; 3], DVec3::ONE);
        geometry.space = cloud.space;
        let normals = cloud.normals.unwrap_or_default();
        Self::new(SurfacePoints { positions: cloud.positions, normals, ..SurfacePoints::default() }, geometry, false)
    }

    /// Returns the particles as points.
    pub(crate) fn of_particles(set: ParticleSet) -> Self {
        let ParticleSet { geometry, positions, normals, sizes, .. } = set;
        Self::new(SurfacePoints { positions, normals, sizes, ..SurfacePoints::default() }, geometry, true)
    }

    /// No point is dropped, because the inputs are finite.
    fn new(mut points: SurfacePoints, geometry: Geometry, has_sizes: bool) -> Self {
        points.report.particles = points.positions.len();
        Self { points, geometry, has_sizes }
    }
}

/// Meshes points without a distance field. `file` is the world frame of the volume's file, if
/// known.
///
/// # Errors
/// If the points cannot be triangulated or do not enclose a solid, if they have no anatomical frame
/// and one is chosen, or if the run is interrupted.
pub(crate) fn compute(args: &Args, points: Points, file: Option<Space>, context: &Context) -> Result<Made> {
    let Points { mut points, mut geometry, has_sizes } = points;
    if let Some(choice) = args.space {
        geometry = choice.of(geometry, file)?;
    }
    context.set_parameter("space", parameter(geometry.space));
    let step = context.step("triangulate");
    let delaunay = points.triangulate().map_err(|e| about(&args.particles, e))?;
    drop(step);
    context.check_interrupt()?;
    let step = context.step("cocone");
    let normals = (!points.normals.is_empty()).then_some(&points.normals[..]);
    let (facets, cocone) = tight_cocone(&delaunay, normals).map_err(|e| about(&args.particles, e))?;
    let (mut interfaces, used) =
        Interfaces::compact_object(&points.positions, facets.iter().map(|facet| facet.vertices));
    let parted = interfaces.separate_touching(|_, p| Some(p));
    drop(step);
    context.check_interrupt()?;

    let step = context.step("check");
    let options = CheckOptions { min_radius_ratio: args.min_radius_ratio, ..CheckOptions::default() };
    let checked = check(&interfaces, &options);
    let mesh = interfaces.mesh;
    drop(step);
    warn(&cocone, context);
    let skipped = "skipped: no distance field was given";
    for key in ["refine", "improve", "topology"] {
        context.report(key, skipped);
    }
    context.report("prepare", json!(points.report));
    context.report("cocone", json!(cocone));
    context.report("parted_vertices", parted);
    context.report("check", json!(checked));
    describe_mesh(&checked, "", context);
    let dropped = points.report.dropped();
    context.summary("particles used, not used", format!("{}, {dropped}", points.positions.len()));
    context.summary("improvement, comparison with F", skipped);

    let mut sizes: Vec<f64> = used.iter().map(|&v| points.sizes[v as usize]).collect();
    if parted > 0 {
        // vertices added by the separation come last; each gets h of the nearest original vertex
        let tree = KdTree::new(&mesh.vertices[..used.len()]);
        let near = |p: &DVec3| tree.nearest(*p).map_or(1.0, |(v, _)| sizes[v]);
        let more: Vec<f64> = mesh.vertices[used.len()..].iter().map(near).collect();
        sizes.extend(more);
    }
    let surface = attributes(&mesh, &geometry, has_sizes.then_some(sizes));
    let meta = SurfaceMeta {
        version: meta::VERSION,
        source: Some(Source::Points),
        failed_checks: checked.failed.clone(),
        components: checked.object().components.len(),
        ..SurfaceMeta::default()
    };
    let offending = offending(&mesh, &checked, &geometry, false);
    Ok(Made { surface, meta, offending })
}

/// Warns if few points have an umbrella, if many are unused, or if the given normals were not used.
pub(crate) fn warn(cocone: &CoconeReport, context: &Context) {
    let share = |part: usize| part as f64 / cocone.points.max(1) as f64;
    if share(cocone.with_umbrella) < MANY_UMBRELLAS {
        context.warn(format!(
            "only {:.0} % of the points have an umbrella: the others lie too sparsely for the detail there, are noisy, or at holes; the \
             surface is closed, but guesswork at them",
            100.0 * share(cocone.with_umbrella)
        ));
    }
    if share(cocone.unused) > MANY_UNUSED {
        context.warn(format!("{} of {} points are not vertices of the mesh", cocone.unused, cocone.points));
    }
    if cocone.normals_near_poles.is_some() && !cocone.normals_taken {
        context.warn("the given normals contradict the shape of the points and were not used");
    }
}

/// Returns the mesh in world coordinates, with data on vertices (h if known, normal, component) and
/// triangles (radius ratio).
fn attributes(mesh: &TriangleMesh, geometry: &Geometry, sizes: Option<Vec<f64>>) -> Surface {
    let (component, _) = components::of_vertices(mesh.vertices.len(), &mesh.triangles);
    let mut normals = vec![DVec3::ZERO; mesh.vertices.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = mesh.corners(t);
        triangle.iter().for_each(|&v| normals[v as usize] += (b - a).cross(c - a));
    }
    let normals: Vec<DVec3> = normals.into_iter().map(|n| geometry.normal_to_world(n)).collect();
    let mut surface = Surface::from_grid(mesh, geometry);
    surface.point_data = vec![
        DataArray::vectors("normal", &normals),
        DataArray::integers("component", component.into_iter().map(i64::from).collect()),
    ];
    if let Some(sizes) = sizes {
        surface.point_data.insert(0, DataArray::scalars("h", sizes));
    }
    surface.cell_data = vec![DataArray::scalars("radius_ratio", radius_ratios(mesh))];
    surface
}
