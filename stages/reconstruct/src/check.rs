//! All guarantees of a finished mesh in one call: closed, manifold, outward, free of self-intersections and of
//! triangles without area, on F = 0, well shaped; with the offending simplices.

use glam::DVec3;
use isoparticles_field::spline::{CubicSpline, distance_estimate};
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::inside::nodes_on_wrong_side;
use isoparticles_mesh::intersect::self_intersections;
use isoparticles_mesh::measure::{Measure, measure_components};
use isoparticles_mesh::quality::{QualitySummary, mean, percentile, summarise, zero_area_triangles};
use isoparticles_mesh::topology::{ComponentTopology, analyse};
use isoparticles_stage::cli::values::significant;
use isoparticles_volume::Image;
use rayon::prelude::*;
use serde::Serialize;

/// Smallest radius ratio that passes, unless `--min-radius-ratio` says otherwise.
pub const MIN_RADIUS_RATIO: f64 = 0.3;

/// What a mesh is compared with, and the bars it must reach. All are optional.
#[derive(Clone, Copy, Debug, Default)]
pub struct CheckOptions<'a> {
    /// The implicit function, in the mesh's frame (the grid frame).
    pub field: Option<&'a CubicSpline>,
    /// Samples of F whose signs the mesh must respect at every node.
    pub sides: Option<&'a Image<f32>>,
    /// Smallest radius ratio allowed.
    pub min_radius_ratio: Option<f64>,
    /// Largest distance of a vertex from F = 0 allowed, in voxels.
    pub max_vertex_distance: Option<f64>,
}

/// Distances |F| / |grad F| in voxels (geometric mean spacing).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DistanceSummary {
    /// Mean.
    pub mean: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// Topology and size of one component.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ComponentReport {
    /// Counts, Euler characteristic, genus.
    #[serde(flatten)]
    pub topology: ComponentTopology,
    /// Area and signed volume; negative for the surface of a cavity.
    #[serde(flatten)]
    pub measure: Measure,
}

/// The simplices behind the counts of a [`CheckReport`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Offenders {
    /// Edges in one triangle only.
    pub open_edges: Vec<[u32; 2]>,
    /// Edges in more than two triangles.
    pub non_manifold_edges: Vec<[u32; 2]>,
    /// Edges both of whose triangles run the same way.
    pub badly_oriented_edges: Vec<[u32; 2]>,
    /// Vertices with more than one fan.
    pub non_manifold_vertices: Vec<u32>,
    /// Vertices of no triangle.
    pub unused_vertices: Vec<u32>,
    /// Triangles that repeat a vertex or another triangle.
    pub repeated_triangles: Vec<u32>,
    /// Triangles without area.
    pub zero_area_triangles: Vec<u32>,
    /// Crossing pairs of triangles.
    pub self_intersections: Vec<[u32; 2]>,
    /// Components whose triangles face into the object, by F.
    pub inward_components: Vec<u32>,
    /// Triangles whose normal points against grad F at their centroid (for information: fine detail below the edge length).
    pub turned_triangles: Vec<u32>,
    /// Grid nodes on the other side of the mesh than F has them.
    pub nodes_on_wrong_side: Vec<[usize; 3]>,
    /// Triangles below the demanded radius ratio.
    pub poor_triangles: Vec<u32>,
    /// Vertices farther from F = 0 than allowed.
    pub distant_vertices: Vec<u32>,
}

/// Figures of a mesh; serialises to the JSON of the reports (without the lists of offenders).
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CheckReport {
    /// False when a coordinate is not finite or an index names no vertex; nothing else was looked at then.
    pub well_formed: bool,
    /// Vertices.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Edges in one triangle only.
    pub open_edges: usize,
    /// Edges in more than two triangles.
    pub non_manifold_edges: usize,
    /// Edges both of whose triangles run the same way.
    pub badly_oriented_edges: usize,
    /// Vertices with more than one fan.
    pub non_manifold_vertices: usize,
    /// Vertices of no triangle.
    pub unused_vertices: usize,
    /// Triangles that repeat a vertex or another triangle.
    pub repeated_triangles: usize,
    /// Triangles without area.
    pub zero_area_triangles: usize,
    /// Crossing pairs of triangles.
    pub self_intersections: usize,
    /// Components whose triangles face into the object, by F; `None` without F.
    pub inward_components: Option<usize>,
    /// Triangles turned against grad F at their centroid; `None` without F.
    pub turned_triangles: Option<usize>,
    /// Grid nodes on the wrong side; `None` when no samples were given.
    pub nodes_on_wrong_side: Option<usize>,
    /// Each component.
    pub components: Vec<ComponentReport>,
    /// Euler characteristic of the whole.
    pub euler: i64,
    /// Area, mm^2.
    pub area: f64,
    /// Volume, mm^3.
    pub volume: f64,
    /// Distance of the vertices from F = 0; `None` without F.
    pub vertex_distance: Option<DistanceSummary>,
    /// Distance of the triangles' centroids from F = 0; `None` without F.
    pub centroid_distance: Option<DistanceSummary>,
    /// Shapes of the triangles.
    pub quality: QualitySummary,
    /// The bar for the smallest radius ratio.
    pub min_radius_ratio_allowed: Option<f64>,
    /// The bar for the distance of a vertex, in voxels.
    pub max_vertex_distance_allowed: Option<f64>,
    /// The offending simplices.
    #[serde(skip)]
    pub offenders: Offenders,
}

/// Checks a mesh against everything in `options`.
pub fn check(mesh: &TriangleMesh, options: &CheckOptions) -> CheckReport {
    let mut report = CheckReport {
        well_formed: mesh.is_well_formed(),
        vertices: mesh.vertices.len(),
        triangles: mesh.triangles.len(),
        min_radius_ratio_allowed: options.min_radius_ratio,
        max_vertex_distance_allowed: options.max_vertex_distance,
        ..CheckReport::default()
    };
    if !report.well_formed {
        return report;
    }
    let topology = analyse(mesh);
    let measures = measure_components(mesh, &topology.component_of_triangle, topology.components.len());
    report.area = measures.iter().map(|m| m.area).sum();
    report.volume = measures.iter().map(|m| m.volume).sum();
    report.components = topology
        .components
        .iter()
        .zip(&measures)
        .map(|(&topology, &measure)| ComponentReport { topology, measure })
        .collect();
    report.euler = topology.euler;
    report.quality = summarise(mesh);

    let offenders = &mut report.offenders;
    offenders.zero_area_triangles = zero_area_triangles(mesh);
    offenders.self_intersections = self_intersections(mesh);
    offenders.repeated_triangles = topology.collapsed_triangles;
    offenders.repeated_triangles.extend(topology.duplicate_triangles);
    if let Some(field) = options.field {
        let (vertices, centroids) = distances(mesh, field);
        report.vertex_distance = Some(DistanceSummary::of(&vertices));
        report.centroid_distance = Some(DistanceSummary::of(&centroids.iter().map(|c| c.0).collect::<Vec<_>>()));
        let mut flux = vec![0.0; report.components.len()];
        for (t, (&component, (_, agreement))) in topology.component_of_triangle.iter().zip(&centroids).enumerate() {
            flux[component as usize] += agreement;
            if *agreement < 0.0 {
                offenders.turned_triangles.push(t as u32);
            }
        }
        offenders.inward_components = (0..flux.len() as u32).filter(|&c| flux[c as usize] <= 0.0).collect();
        report.inward_components = Some(offenders.inward_components.len());
        report.turned_triangles = Some(offenders.turned_triangles.len());
        if let Some(limit) = options.max_vertex_distance {
            // written so that a distance that is not a number offends as well
            let near = |v: &u32| vertices[*v as usize] <= limit;
            offenders.distant_vertices = (0..vertices.len() as u32).filter(|v| !near(v)).collect();
        }
    }
    if let Some(image) = options.sides {
        offenders.nodes_on_wrong_side = nodes_on_wrong_side(mesh, image);
        report.nodes_on_wrong_side = Some(offenders.nodes_on_wrong_side.len());
    }
    if let Some(limit) = options.min_radius_ratio {
        let ratios = isoparticles_mesh::quality::radius_ratios(mesh);
        offenders.poor_triangles = (0..ratios.len() as u32).filter(|&t| ratios[t as usize] < limit).collect();
    }
    offenders.open_edges = topology.open_edges;
    offenders.non_manifold_edges = topology.non_manifold_edges;
    offenders.badly_oriented_edges = topology.badly_oriented_edges;
    offenders.non_manifold_vertices = topology.non_manifold_vertices;
    offenders.unused_vertices = topology.unused_vertices;
    report.open_edges = offenders.open_edges.len();
    report.non_manifold_edges = offenders.non_manifold_edges.len();
    report.badly_oriented_edges = offenders.badly_oriented_edges.len();
    report.non_manifold_vertices = offenders.non_manifold_vertices.len();
    report.unused_vertices = offenders.unused_vertices.len();
    report.repeated_triangles = offenders.repeated_triangles.len();
    report.zero_area_triangles = offenders.zero_area_triangles.len();
    report.self_intersections = offenders.self_intersections.len();
    report
}

impl CheckReport {
    /// The checks that failed, in words; empty when the mesh is what it should be.
    pub fn failed_checks(&self) -> Vec<String> {
        if !self.well_formed {
            return vec!["a coordinate is not finite, or a triangle refers to a vertex that does not exist".into()];
        }
        if self.triangles == 0 {
            return vec!["the mesh has no triangles".into()];
        }
        let counts = [
            (self.open_edges, "open edges (edges of only one triangle)"),
            (self.non_manifold_edges, "non-manifold edges (edges of more than two triangles)"),
            (self.badly_oriented_edges, "edges between triangles of opposite orientation"),
            (self.non_manifold_vertices, "non-manifold vertices (vertices with more than one fan of triangles)"),
            (self.unused_vertices, "unused vertices"),
            (self.repeated_triangles, "triangles with a repeated vertex, or equal to another triangle"),
            (self.zero_area_triangles, "triangles of zero area"),
            (self.self_intersections, "pairs of intersecting triangles"),
            (self.inward_components.unwrap_or(0), "components with inward normals"),
            (self.nodes_on_wrong_side.unwrap_or(0), "voxel centres on the wrong side of the mesh"),
        ];
        let mut failed: Vec<String> =
            counts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        if self.inward_components.is_none() && self.volume <= 0.0 {
            failed.push(format!("the normals point inward: the volume is {} mm^3", significant(self.volume)));
        }
        if let Some(limit) = self.min_radius_ratio_allowed
            && self.quality.radius_ratio_min < limit
        {
            let (count, smallest) = (self.offenders.poor_triangles.len(), self.quality.radius_ratio_min);
            failed.push(format!("{count} triangles with a radius ratio below {limit} (minimum {smallest:.4})"));
        }
        if let (Some(limit), Some(distance)) = (self.max_vertex_distance_allowed, self.vertex_distance)
            && !self.offenders.distant_vertices.is_empty()
        {
            let count = self.offenders.distant_vertices.len();
            failed.push(format!(
                "{count} vertices with a deviation of more than {limit} voxel from F = 0 (maximum {})",
                significant(distance.max)
            ));
        }
        failed
    }
}

impl DistanceSummary {
    /// Summarises distances.
    pub fn of(distances: &[f64]) -> Self {
        let mut ascending = distances.to_vec();
        ascending.par_sort_unstable_by(f64::total_cmp);
        Self {
            mean: mean(distances),
            p99: percentile(&ascending, 99.0),
            max: ascending.last().copied().unwrap_or_default(),
        }
    }
}

/// Distance of each vertex, and of each centroid with the flux of grad F / |grad F| through its triangle.
fn distances(mesh: &TriangleMesh, field: &CubicSpline) -> (Vec<f64>, Vec<(f64, f64)>) {
    let voxel = field.geometry().mean_spacing();
    let at = |p: DVec3| {
        let (value, gradient) = field.value_gradient(p);
        (distance_estimate(value, gradient).abs() / voxel, gradient.normalize_or_zero())
    };
    let vertices = mesh.vertices.par_iter().map(|&p| at(p).0).collect();
    let centroids = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            let (distance, direction) = at((a + b + c) / 3.0);
            (distance, 0.5 * (b - a).cross(c - a).dot(direction))
        })
        .collect();
    (vertices, centroids)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_mesh::shapes;
    use isoparticles_volume::Geometry;

    fn ball(radius: f64) -> (Image<f32>, TriangleMesh) {
        let geometry = Geometry::axis_aligned([24; 3], DVec3::splat(0.5));
        let mut image = Image::filled(geometry, 0.0f32);
        let centre = DVec3::splat(5.7);
        for k in 0..24 {
            for j in 0..24 {
                for i in 0..24 {
                    let p = image.geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64));
                    let at = image.geometry.linear(i, j, k);
                    image.data[at] = (p.distance(centre) - radius) as f32;
                }
            }
        }
        let mut mesh = shapes::icosphere(radius, 3);
        for p in &mut mesh.vertices {
            *p += centre;
        }
        (image, mesh)
    }

    #[test]
    fn a_good_mesh_passes_with_the_figures_of_its_sphere() {
        let (image, mesh) = ball(4.0);
        let field = CubicSpline::new(&image);
        let report = check(
            &mesh,
            &CheckOptions {
                field: Some(&field),
                sides: Some(&image),
                min_radius_ratio: Some(0.8),
                max_vertex_distance: Some(0.01),
            },
        );
        // the chords of so coarse a sphere may cut off a node or two; nothing else can fail
        let failed = report.failed_checks();
        assert!(failed.iter().all(|f| f.contains("voxel centres")), "{failed:?}");
        assert_eq!((report.euler, report.components.len(), report.turned_triangles), (2, 1, Some(0)));
        assert!(report.vertex_distance.is_some_and(|d| d.max < 0.01));
        // the sagitta of a triangle with circumradius c under a sphere of radius R is about c^2 / (2 R)
        let longest = report.quality.edge_length_max;
        let sagitta = longest * longest / 3.0 / 8.0 / 0.5;
        assert!(report.centroid_distance.is_some_and(|d| d.max < 1.1 * sagitta && d.max > 0.5 * sagitta));
        assert!(serde_json::to_string(&report).is_ok_and(|json| json.contains("\"genus\":0")));
    }

    #[test]
    fn every_fault_is_told() {
        let (image, good) = ball(4.0);
        let field = CubicSpline::new(&image);
        let options = CheckOptions {
            field: Some(&field),
            min_radius_ratio: Some(0.3),
            max_vertex_distance: Some(0.1),
            ..CheckOptions::default()
        };
        let failed = |mesh: &TriangleMesh| check(mesh, &options).failed_checks().join("; ");
        assert_eq!(failed(&good), "");

        let mut open = good.clone();
        open.triangles.pop();
        assert_eq!(failed(&open), "3 open edges (edges of only one triangle)");

        let mut inward = good.clone();
        inward.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(failed(&inward), "1 components with inward normals");
        assert!(check(&inward, &CheckOptions::default()).failed_checks()[0].contains("point inward"));

        let mut crossing = good.clone();
        crossing.vertices[0] = DVec3::splat(5.7) * 2.0 - crossing.vertices[0];
        let told = failed(&crossing);
        assert!(told.contains("intersecting") && !told.contains("edges"), "{told}");

        let mut distant = good.clone();
        distant.vertices[3] = DVec3::splat(5.7) + 1.025 * (good.vertices[3] - DVec3::splat(5.7));
        assert!(failed(&distant).contains("1 vertices with a deviation of more than 0.1 voxel"));

        let mut flat = good.clone();
        let [a, b, c] = flat.triangles[5];
        flat.vertices[c as usize] = 0.5 * (flat.vertices[a as usize] + flat.vertices[b as usize]);
        let told = failed(&flat);
        assert!(told.contains("1 triangles of zero area") && told.contains("radius ratio below 0.3"), "{told}");

        let twice = shapes::union(&[good.clone(), good.clone()]);
        assert!(failed(&twice).contains("intersecting"), "{}", failed(&twice));

        let mut broken = good;
        broken.triangles[0][0] = 1_000_000;
        assert!(failed(&broken).contains("does not exist"));
        assert_eq!(failed(&TriangleMesh::default()), "the mesh has no triangles");
    }
}
