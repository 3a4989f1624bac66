//! Checks a finished mesh: closed, manifold and facing outward around every region, free of
//! self-intersections and of triangles without area, near its interfaces, well shaped, and with all
//! segments of junction curves and all grid nodes in their regions.
//!
//! One object is the case of two materials, the object and the outside. [`crate::verdict`] and
//! [`crate::materials::pieces`] compare the topology of the mesh with that of F and of the
//! materials.

mod forced;
pub(crate) mod report;

use crate::interfaces::{Interfaces, Segment};
use crate::subject::Subject;
use forced::is_forced;
use glam::DVec3;
use isoparticles_field::materials::MaterialId;
use isoparticles_field::materials::complex::SAME_JUNCTION;
use isoparticles_field::spline::distance_estimate;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::intersect::self_intersections;
use isoparticles_mesh::measure::{measure, measure_components};
use isoparticles_mesh::quality::{radius_ratios, summarise, zero_area_triangles};
use isoparticles_mesh::topology::{Topology, analyse};
use isoparticles_stage::cli::values::significant;
use rayon::prelude::*;
pub use report::{
    CheckReport, ComponentReport, DistanceSummary, Fault, ForcedTriangle, JunctionReport, PairReport, RegionReport,
    Simplices,
};

/// Remedies for triangles that the junction curves force below the minimum radius ratio.
const REMEDY: &str = "a scale (SCALE, or SIZE or VERTICES without SCALE=0) or smaller edges (SIZE, MIN_SIZE, more VERTICES) remove them, \
                      --accept-forced (ACCEPT_FORCED=yes) accepts them";

/// The reference for the checks, and the limits.
#[derive(Clone, Copy, Default)]
pub struct CheckOptions<'a> {
    /// The field or the indicators, if the mesh is compared with them.
    pub subject: Option<&'a dyn Subject>,
    /// Whether grid nodes in another material fail the check.
    pub keeps_nodes: bool,
    /// Minimum radius ratio; `None` means any.
    pub min_radius_ratio: Option<f64>,
    /// Maximum distance of a vertex from each of its interfaces, in voxels. The limit is at least
    /// [`SAME_JUNCTION`] where more than four materials meet, and at least the distance of the
    /// vertex in [`Interfaces::joined`].
    pub max_vertex_distance: Option<f64>,
    /// Whether triangles below the minimum radius ratio pass if the junction curves force them.
    pub accept_forced: bool,
    /// Whether the surface may be open at the border of the volume.
    pub open_border: bool,
}

/// Checks the surface of one object, and returns the report.
pub fn check_object(mesh: &TriangleMesh, options: &CheckOptions) -> CheckReport {
    check(&Interfaces::of_object(mesh.clone()), options)
}

/// Checks interfaces, and returns the report.
pub fn check(interfaces: &Interfaces, options: &CheckOptions) -> CheckReport {
    let mesh = &interfaces.mesh;
    let mut report = CheckReport {
        well_formed: mesh.is_well_formed(),
        vertices: mesh.vertices.len(),
        triangles: mesh.triangles.len(),
        min_radius_ratio_allowed: options.min_radius_ratio,
        ..CheckReport::default()
    };
    if !report.well_formed {
        report.failed =
            vec!["a coordinate is not finite, or a triangle refers to a vertex that does not exist".to_owned()];
        return report;
    }
    if mesh.triangles.is_empty() {
        report.failed = vec!["the mesh has no triangles".to_owned()];
        return report;
    }
    report.quality = summarise(mesh);
    let pairs = interfaces.pairs_at_vertices();
    let meeting = meeting(mesh.vertices.len(), &pairs);
    let centroids = options.subject.map_or_else(Vec::new, |subject| Centroid::all(interfaces, subject));
    let checker = Checker { interfaces, options, kinds: interfaces.pairs(), meeting, centroids };
    let found = &mut report.offenders;
    found.insert(Fault::ZeroAreaTriangles, Simplices::Triangles(zero_area_triangles(mesh)));
    found.insert(Fault::SelfIntersections, Simplices::TrianglePairs(self_intersections(mesh)));
    let unused = (0..).zip(&checker.meeting).filter(|(_, count)| **count == 0).map(|(v, _)| v).collect();
    found.insert(Fault::UnusedVertices, Simplices::Vertices(unused));
    checker.check_curves(&mut report);
    checker.check_regions(&mut report);
    checker.measure_pairs(&mut report);
    if let Some(subject) = options.subject {
        checker.check_distances(subject, &pairs, &mut report);
        if let Some(wrong) = subject.wrong_nodes(interfaces) {
            report.offenders.insert(Fault::NodesOnWrongSide, Simplices::Nodes(wrong));
        }
    }
    let smallest_elsewhere = checker.check_shapes(&mut report);
    report.counts = report.offenders.iter().map(|(fault, list)| (*fault, list.count())).collect();
    report.failed = checker.failed(&report, smallest_elsewhere);
    report
}

/// Returns the number of materials that meet at each vertex. `pairs` contains the interfaces at
/// each vertex, ascending.
fn meeting(vertices: usize, pairs: &[(u32, [MaterialId; 2])]) -> Vec<u8> {
    let mut meeting = vec![0; vertices];
    for own in pairs.chunk_by(|a, b| a.0 == b.0) {
        let mut ids: Vec<MaterialId> = own.iter().flat_map(|(_, pair)| *pair).collect();
        ids.sort_unstable();
        ids.dedup();
        meeting[own[0].0 as usize] = ids.len().min(usize::from(u8::MAX)) as u8;
    }
    meeting
}

/// A check in progress.
struct Checker<'a> {
    interfaces: &'a Interfaces,
    options: &'a CheckOptions<'a>,
    /// The pairs of materials that have an interface, ascending.
    kinds: Vec<[MaterialId; 2]>,
    /// Number of materials at each vertex.
    meeting: Vec<u8>,
    /// Measurements at the centroid of each triangle; empty without a reference.
    centroids: Vec<Centroid>,
}

/// The surface of a region with its faults.
struct Region {
    report: RegionReport,
    /// Topology of the surface, with the indices of vertices and triangles in the whole mesh.
    topology: Topology,
    /// Number of components whose normals point against the gradient.
    inward: usize,
}

/// Measurements at the centroid of a triangle.
struct Centroid {
    /// Distance from the interface, voxels.
    distance: f64,
    /// Flux of the normalised gradient through the triangle, mm^2.
    flux: f64,
}

impl Centroid {
    fn all(interfaces: &Interfaces, subject: &dyn Subject) -> Vec<Self> {
        let voxel = subject.geometry().mean_spacing();
        let of = |t: usize| {
            let [a, b, c] = interfaces.mesh.corners(t);
            let (value, gradient) = subject.functions().value_gradient(interfaces.between[t], (a + b + c) / 3.0);
            let flux = 0.5 * (b - a).cross(c - a).dot(gradient.normalize_or_zero());
            Self { distance: distance_estimate(value, gradient).abs() / voxel, flux }
        };
        (0..interfaces.between.len()).into_par_iter().map(of).collect()
    }
}

/// Returns the elements of several lists, ascending, without repetitions.
fn merged<'a, T: Copy + Ord + 'a>(lists: impl Iterator<Item = &'a Vec<T>>) -> Vec<T> {
    let mut all: Vec<T> = lists.flatten().copied().collect();
    all.sort_unstable();
    all.dedup();
    all
}

impl Checker<'_> {
    fn name(&self, id: MaterialId) -> String {
        let table = self.options.subject.map_or(&[][..], |subject| subject.table());
        let name = table.get(id.index()).map(|material| material.name.clone());
        name.unwrap_or_else(|| if id == MaterialId::OUTSIDE { "outside" } else { "object" }.to_owned())
    }

    /// Compares the segments of the junction curves with the edges that belong to more than two
    /// triangles, or to triangles of different interfaces.
    fn check_curves(&self, report: &mut CheckReport) {
        let Interfaces { between, segments, .. } = self.interfaces;
        report.junctions.segments = segments.len();
        report.junctions.junction_points = self.meeting.iter().filter(|&&count| count > 3).count();
        let (mut spurious, mut is_present) = (Vec::new(), vec![false; segments.len()]);
        if self.kinds.len() > 1 || !segments.is_empty() {
            let edges = self.interfaces.edges();
            for own in edges.chunk_by(|a, b| a.0 == b.0).filter(|own| self.interfaces.is_of_curve(own)) {
                report.junctions.junction_edges += 1;
                match segments.binary_search_by_key(&own[0].0, |(pair, _)| *pair) {
                    Ok(n) => {
                        let mut ids = own.iter().flat_map(|(_, t)| between[*t as usize]);
                        is_present[n] = ids.all(|id| segments[n].1.has(id));
                    }
                    Err(_) => spurious.push(own[0].0),
                }
            }
        }
        let missing = segments.iter().zip(is_present).filter(|(_, is)| !is).map(|((pair, _), _)| *pair).collect();
        report.offenders.insert(Fault::MissingSegments, Simplices::Edges(missing));
        report.offenders.insert(Fault::SpuriousJunctionEdges, Simplices::Edges(spurious));
    }

    /// Returns whether both ends of an edge are close to the border of the volume.
    fn is_at_border(&self, edge: Segment) -> bool {
        let Some(subject) = self.options.subject else { return false };
        let [a, b] = edge.map(|v| self.interfaces.mesh.vertices[v as usize]);
        let near = 2.0 * a.distance(b) + subject.geometry().mean_spacing();
        let upper = subject.geometry().upper_corner();
        [a, b].into_iter().all(|p| p.min(upper - p).min_element() < near)
    }

    /// Checks that the surface of each region is a closed oriented manifold, and measures it.
    fn check_regions(&self, report: &mut CheckReport) {
        // with a single interface, the surface of the outside has the same triangles
        let found: Vec<Region> = match self.kinds[..] {
            [[inside, _]] => vec![self.region(inside, &self.interfaces.mesh, None)],
            _ => {
                let of_material = |id| {
                    let (mesh, vertices, triangles) = self.interfaces.surface_of(id);
                    self.region(id, &mesh, Some((vertices, triangles)))
                };
                self.interfaces.regions().into_par_iter().map(of_material).collect()
            }
        };
        let edges = |list: fn(&Region) -> &Vec<Segment>| Simplices::Edges(merged(found.iter().map(list)));
        let numbers = |list: fn(&Region) -> &Vec<u32>| merged(found.iter().map(list));
        let (border, open) = merged(found.iter().map(|own| &own.topology.open_edges))
            .into_iter()
            .partition::<Vec<Segment>, _>(|&edge| self.options.open_border && self.is_at_border(edge));
        report.offenders.extend([
            (Fault::OpenEdges, Simplices::Edges(open)),
            (Fault::BorderEdges, Simplices::Edges(border)),
            (Fault::NonManifoldEdges, edges(|own| &own.topology.non_manifold_edges)),
            (Fault::BadlyOrientedEdges, edges(|own| &own.topology.badly_oriented_edges)),
            (Fault::NonManifoldVertices, Simplices::Vertices(numbers(|own| &own.topology.non_manifold_vertices))),
            (Fault::RepeatedTriangles, Simplices::Triangles(numbers(|own| &own.topology.collapsed_triangles))),
        ]);
        if self.options.subject.is_some() {
            let count = found.iter().map(|own| own.inward).sum();
            report.offenders.insert(Fault::InwardComponents, Simplices::Components(count));
        }
        report.regions = found.into_iter().map(|own| own.report).collect();
    }

    /// Analyses the surface of a region. `numbers` are the indices of its vertices and triangles in
    /// the whole mesh, if they differ.
    fn region(&self, id: MaterialId, mesh: &TriangleMesh, numbers: Option<(Vec<u32>, Vec<u32>)>) -> Region {
        let mut topology = analyse(mesh);
        let measures = measure_components(mesh, &topology.component_of_triangle, topology.components.len());
        let components = topology.components.iter().zip(&measures);
        let report = RegionReport {
            name: self.name(id),
            volume: measures.iter().map(|own| own.volume).sum(),
            area: measures.iter().map(|own| own.area).sum(),
            euler: topology.euler,
            components: components.map(|(&topology, &measure)| ComponentReport { topology, measure }).collect(),
        };
        topology.collapsed_triangles.append(&mut topology.duplicate_triangles);
        let whole = |t: usize| numbers.as_ref().map_or(t, |(_, triangles)| triangles[t] as usize);
        // for each component: its flux, and whether the region is on the inner side of a triangle;
        // a closed interface of two regions is a component of both, and counts for one of them
        let mut fluxes = vec![(0.0, false); measures.len()];
        for (t, &component) in topology.component_of_triangle.iter().enumerate() {
            let t = whole(t);
            if let Some(centroid) = self.centroids.get(t) {
                let (flux, is_inside) = &mut fluxes[component as usize];
                *flux += centroid.flux;
                *is_inside |= self.interfaces.regions_of(t as u32)[0] == id;
            }
        }
        let inward = fluxes.into_iter().filter(|&(flux, is_inside)| is_inside && flux <= 0.0).count();
        if let Some((vertices, triangles)) = numbers {
            let Topology { open_edges, non_manifold_edges, badly_oriented_edges, .. } = &mut topology;
            for list in [open_edges, non_manifold_edges, badly_oriented_edges] {
                list.iter_mut().flatten().for_each(|v| *v = vertices[*v as usize]);
            }
            topology.non_manifold_vertices.iter_mut().for_each(|v| *v = vertices[*v as usize]);
            topology.collapsed_triangles.iter_mut().for_each(|t| *t = triangles[*t as usize]);
        }
        Region { report, topology, inward }
    }

    /// Measures the area and the shapes of the triangles of each interface.
    fn measure_pairs(&self, report: &mut CheckReport) {
        let of_pair = |pair: [MaterialId; 2]| {
            let part = self.interfaces.part(pair);
            PairReport { between: pair.map(|id| self.name(id)), area: measure(&part).area, quality: summarise(&part) }
        };
        report.pairs = self.kinds.iter().map(|&pair| of_pair(pair)).collect();
    }

    /// Measures the distances of vertices and centroids from their interfaces.
    fn check_distances(&self, subject: &dyn Subject, pairs: &[(u32, [MaterialId; 2])], report: &mut CheckReport) {
        let Interfaces { mesh, joined, .. } = self.interfaces;
        let voxel = subject.geometry().mean_spacing();
        let distance = |&(v, pair): &(u32, [MaterialId; 2])| {
            let (value, gradient) = subject.functions().value_gradient(pair, mesh.vertices[v as usize]);
            let distance = distance_estimate(value, gradient).abs() / voxel;
            if distance.is_nan() { f64::INFINITY } else { distance }
        };
        let distances: Vec<f64> = pairs.par_iter().map(distance).collect();
        let mut vertices = vec![0.0f64; mesh.vertices.len()];
        for ((v, _), distance) in pairs.iter().zip(distances) {
            let known = &mut vertices[*v as usize];
            *known = known.max(distance);
        }
        if let Some(least) = self.options.max_vertex_distance {
            let limit = |count: &u8| if *count > 4 { least.max(SAME_JUNCTION) } else { least };
            let mut limits: Vec<f64> = self.meeting.iter().map(limit).collect();
            for own in joined.iter().filter(|own| own.vertex != u32::MAX) {
                let limit = &mut limits[own.vertex as usize];
                *limit = limit.max(own.distance / voxel);
            }
            let distant = (0..).zip(vertices.iter().zip(limits)).filter(|(_, (distance, limit))| *distance > limit);
            report.offenders.insert(Fault::DistantVertices, Simplices::Vertices(distant.map(|(v, _)| v).collect()));
        }
        let turned = (0..).zip(&self.centroids).filter(|(_, centroid)| centroid.flux < 0.0).map(|(t, _)| t);
        report.offenders.insert(Fault::TurnedTriangles, Simplices::Triangles(turned.collect()));
        let centroids: Vec<f64> = self.centroids.iter().map(|centroid| centroid.distance).collect();
        report.vertex_distance = Some(DistanceSummary::of(&vertices));
        report.centroid_distance = Some(DistanceSummary::of(&centroids));
    }

    /// Finds the triangles below the minimum radius ratio, and separates those that the junction
    /// curves force. Returns the minimum radius ratio of the other ones, or 1 if there are none.
    fn check_shapes(&self, report: &mut CheckReport) -> f64 {
        let Some(limit) = self.options.min_radius_ratio else { return 1.0 };
        let mesh = &self.interfaces.mesh;
        let ratios = radius_ratios(mesh);
        let poor = (0..ratios.len() as u32).filter(|&t| ratios[t as usize] < limit);
        let (forced, poor): (Vec<u32>, Vec<u32>) =
            poor.partition(|&t| is_forced(self.interfaces, &self.meeting, limit, t));
        let world = |p: DVec3| self.options.subject.map_or(p, |subject| subject.geometry().grid_to_world(p)).to_array();
        let described = |&t: &u32| {
            let centroid = mesh.corners(t as usize).into_iter().sum::<DVec3>() / 3.0;
            ForcedTriangle { place: world(centroid), radius_ratio: ratios[t as usize] }
        };
        report.poor_between_curves = forced.iter().map(described).collect();
        report.poor_between_curves.sort_by(|a, b| a.radius_ratio.total_cmp(&b.radius_ratio));
        let smallest = poor.iter().map(|&t| ratios[t as usize]).fold(1.0, f64::min);
        report.offenders.insert(Fault::PoorTriangles, Simplices::Triangles(poor));
        if !self.options.accept_forced {
            report.offenders.insert(Fault::ForcedTriangles, Simplices::Triangles(forced));
        }
        smallest
    }

    /// Returns the failed checks in words. `smallest` is the minimum radius ratio of the triangles
    /// below the limit that are not forced.
    fn failed(&self, report: &CheckReport, smallest: f64) -> Vec<String> {
        let mut failed: Vec<String> = Vec::new();
        for (&fault, &count) in report.counts.iter().filter(|(_, count)| **count > 0) {
            let told = format!("{count} {}", fault.described().1);
            match fault {
                Fault::TurnedTriangles | Fault::BorderEdges => {}
                Fault::NodesOnWrongSide if !self.options.keeps_nodes => {}
                Fault::PoorTriangles => {
                    let limit = self.options.min_radius_ratio.unwrap_or_default();
                    failed.push(format!("{told} below {limit} (minimum {smallest:.4})"));
                }
                Fault::ForcedTriangles => failed.extend(report.forced().map(|forced| format!("{forced}: {REMEDY}"))),
                Fault::DistantVertices => {
                    let limit = self.options.max_vertex_distance.unwrap_or_default();
                    let maximum = significant(report.vertex_distance.unwrap_or_default().max);
                    failed.push(format!("{told} of more than {limit} voxel from the interface (maximum {maximum})"));
                }
                _ => failed.push(told),
            }
        }
        let volume = report.object().volume;
        if self.options.subject.is_none() && volume <= 0.0 {
            failed.push(format!("the normals point inward: the volume is {} mm^3", significant(volume)));
        }
        failed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subject::Object;
    use isoparticles_field::spline::CubicSpline;
    use isoparticles_field::topology::FieldTopology;
    use isoparticles_mesh::shapes;
    use isoparticles_volume::{Geometry, Image};

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
    fn a_good_sphere_passes_with_correct_measurements() {
        let (image, mesh) = ball(4.0);
        let field = CubicSpline::new(&image);
        let options = CheckOptions {
            subject: Some(&Object { field: &field, topology: &FieldTopology::new(&field), samples: Some(&image) }),
            min_radius_ratio: Some(0.8),
            max_vertex_distance: Some(0.01),
            ..CheckOptions::default()
        };
        let report = check_object(&mesh, &options);
        assert_eq!(report.failed, Vec::<String>::new());
        let object = report.object();
        assert_eq!((object.euler, object.components.len(), report.count(Fault::TurnedTriangles)), (2, 1, 0));
        assert!(report.vertex_distance.is_some_and(|d| d.max < 0.01));
        // a triangle with circumradius c on a sphere of radius R has a sagitta of about c^2 / (2 R)
        let longest = report.quality.edge_length_max;
        let sagitta = longest * longest / 3.0 / 8.0 / 0.5;
        assert!(report.centroid_distance.is_some_and(|d| d.max < 1.1 * sagitta && d.max > 0.5 * sagitta));
        assert!(serde_json::to_string(&report).is_ok_and(|json| json.contains("\"genus\":0")));
    }

    #[test]
    fn every_fault_is_reported() {
        let (image, good) = ball(4.0);
        let field = CubicSpline::new(&image);
        let topology = FieldTopology::new(&field);
        let options = CheckOptions {
            subject: Some(&Object { field: &field, topology: &topology, samples: None }),
            min_radius_ratio: Some(0.3),
            max_vertex_distance: Some(0.1),
            ..CheckOptions::default()
        };
        let failed = |mesh: &TriangleMesh| check_object(mesh, &options).failed.join("; ");
        assert_eq!(failed(&good), "");

        let mut open = good.clone();
        open.triangles.pop();
        assert_eq!(failed(&open), "3 open edges (edges of only one triangle)");

        let mut inward = good.clone();
        inward.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(failed(&inward), "1 components with inward normals");
        assert!(check_object(&inward, &CheckOptions::default()).failed[0].contains("point inward"));

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
