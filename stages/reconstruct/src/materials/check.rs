//! All guarantees of a complex in one call: conforming, closed round each material, free of self-intersections, on its sheets, junction curves and components
//! present, grid nodes in their materials.

use super::improve::walls;
use super::interfaces::Interfaces;
use super::nodes::Nodes;
use super::pieces::{Pieces, pieces};
use super::segments::{Segment, segment};
use super::way::ONE_CURVE;
use crate::check::DistanceSummary;
use glam::DVec3;
use isoparticles_field::materials::complex::SAME_JUNCTION;
use isoparticles_field::materials::{Indicators, Material, MaterialId, Stratum};
use isoparticles_field::spline::distance_estimate;
use isoparticles_mesh::intersect::self_intersections;
use isoparticles_mesh::measure::measure;
use isoparticles_mesh::quality::{QualitySummary, radius_ratios, summarise, zero_area_triangles};
use isoparticles_mesh::topology::analyse;
use isoparticles_stage::cli::values::{place, significant};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// What removes triangles that the junction curves force below the demanded radius ratio.
const REMEDY: &str = "a scale (SCALE, or SIZE or VERTICES without SCALE=0) or smaller edges (SIZE, MIN_SIZE, more VERTICES) remove them, \
                      --accept-forced (ACCEPT_FORCED=yes) accepts them";

/// What a complex is compared with, and the bars it must reach.
pub struct CheckOptions<'a> {
    /// The indicators, in the mesh's frame (the grid frame).
    pub indicators: &'a dyn Indicators,
    /// Names of the materials, by their numbers.
    pub table: &'a [Material],
    /// The material of each grid node.
    pub nodes: &'a Nodes,
    /// Whether nodes that changed their material are a failure.
    pub keeps_nodes: bool,
    /// Smallest radius ratio allowed.
    pub min_radius_ratio: Option<f64>,
    /// Whether triangles below it pass where the junction curves force them below it.
    pub accept_forced: bool,
    /// Farthest that a vertex may lie from each of its sheets, voxels. One at which more than four materials meet, which hardly any data let meet in a point, may lie
    /// [`SAME_JUNCTION`] off, and one through which a curve passes that is one with another, `ONE_CURVE`.
    pub max_vertex_distance: f64,
}

/// What is known of a material.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MaterialReport {
    /// Its name.
    pub name: String,
    /// Volume, mm^3; of the outside minus that of all others.
    pub volume: f64,
    /// Area of its surface, mm^2.
    pub area: f64,
    /// Closed surfaces that it has: one for each component, and one for each cavity.
    pub surfaces: usize,
    /// Its grid nodes in components.
    #[serde(flatten)]
    pub pieces: Pieces,
}

/// What is known of the triangles between two materials.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PairReport {
    /// Names of the materials inside and outside.
    pub between: [String; 2],
    /// Area, mm^2.
    pub area: f64,
    /// Shapes.
    pub quality: QualitySummary,
}

/// The simplices behind the counts of a [`ComplexReport`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Offenders {
    /// Edges in one triangle only, or in another number than the materials round them tell.
    pub edges: Vec<[u32; 2]>,
    /// Edges of more than two triangles that are no segments of junction curves.
    pub spurious: Vec<[u32; 2]>,
    /// Segments that are no edges of a triangle between each two of their three materials (of three or four of their four, where curves are one).
    pub missing_segments: Vec<Segment>,
    /// Edges at which the surface of a material is open, touches itself or changes its orientation.
    pub not_closed: Vec<[u32; 2]>,
    /// Vertices at which the surface of a material touches itself.
    pub pinched: Vec<u32>,
    /// Triangles without area.
    pub zero_area: Vec<u32>,
    /// Crossing pairs of triangles.
    pub crossing: Vec<[u32; 2]>,
    /// Triangles below the demanded radius ratio, without those that the junction curves force.
    pub poor: Vec<u32>,
    /// Triangles below the demanded radius ratio that the junction curves force; none where these
    /// are accepted.
    pub forced: Vec<u32>,
    /// Vertices too far from a sheet of theirs.
    pub distant: Vec<u32>,
    /// Grid nodes, by their numbers, in another material.
    pub nodes: Vec<usize>,
}

/// A poor triangle that the junction curves force. Its corners all lie on them, as two that meet at a small angle, or one that turns within h, leave no better one; or
/// one of its sides is the whole of a curve between two junction points, far shorter than h.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ForcedTriangle {
    /// Its centroid, world, mm.
    pub place: [f64; 3],
    /// Its radius ratio.
    pub radius_ratio: f64,
}

/// Figures of a complex; serialises to the JSON of the reports (without the lists of offenders).
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ComplexReport {
    /// Vertices.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Edges in one triangle only, or in another number than the materials round them tell.
    pub bad_edges: usize,
    /// Edges of three triangles and more: those of junction curves.
    pub junction_edges: usize,
    /// Of these, none of a known junction curve.
    pub spurious_junction_edges: usize,
    /// Segments of junction curves.
    pub segments: usize,
    /// Of these, not in the mesh.
    pub missing_segments: usize,
    /// Vertices where four materials meet or more.
    pub junction_points: usize,
    /// Edges at which the surface of a material is open, touches itself or changes its orientation.
    pub material_edges_not_closed: usize,
    /// Vertices at which the surface of a material touches itself.
    pub material_vertices_pinched: usize,
    /// Triangles without area.
    pub zero_area_triangles: usize,
    /// Crossing pairs of triangles.
    pub self_intersections: usize,
    /// Grid nodes in another material.
    pub nodes_changed: usize,
    /// Components of materials, of more than [`super::pieces::SMALL`] nodes, none of whose nodes lies in the mesh in their material.
    pub missing_components: usize,
    /// The same of smaller ones, which is no failure.
    pub missing_specks: usize,
    /// Distance of the vertices from each of their sheets, voxels.
    pub vertex_distance: DistanceSummary,
    /// Distance of the triangles' centroids from their sheets, voxels.
    pub centroid_distance: DistanceSummary,
    /// Shapes of all triangles.
    pub quality: QualitySummary,
    /// Triangles below the demanded radius ratio that the junction curves force, the worst first.
    pub poor_between_curves: Vec<ForcedTriangle>,
    /// The smallest radius ratio of the others.
    pub smallest_elsewhere: f64,
    /// Each material that has triangles.
    pub materials: Vec<MaterialReport>,
    /// Each pair that touches.
    pub pairs: Vec<PairReport>,
    /// The offending simplices.
    #[serde(skip)]
    pub offenders: Offenders,
    /// The checks that failed, in words.
    pub failed: Vec<String>,
}

impl ComplexReport {
    /// The triangles that the junction curves force below the demanded radius ratio, in words, with
    /// the place of the worst.
    pub fn forced(&self) -> Option<String> {
        let worst = self.poor_between_curves.first()?;
        let (count, ratio, at) = (self.poor_between_curves.len(), worst.radius_ratio, place(worst.place));
        Some(format!(
            "{count} poor triangles forced by the junction curves, which meet there at small angles, turn within h, or are far shorter than \
             h (smallest radius ratio {ratio:.4} at {at} mm; `poor_between_curves` in the report lists them)"
        ))
    }
}

/// Checks interfaces against everything in `options`.
pub fn check(interfaces: &Interfaces, options: &CheckOptions) -> ComplexReport {
    let mesh = &interfaces.mesh;
    let mut report =
        ComplexReport { vertices: mesh.vertices.len(), triangles: mesh.triangles.len(), ..ComplexReport::default() };
    if !mesh.is_well_formed() || mesh.triangles.is_empty() {
        report.failed.push("the mesh has no triangles, or a coordinate is not finite".to_owned());
        return report;
    }
    report.quality = summarise(mesh);
    let meeting: Vec<usize> = interfaces.materials_at_vertices().iter().map(Vec::len).collect();
    report.junction_points = meeting.iter().filter(|&&count| count > 3).count();
    let mut offenders = Offenders { zero_area: zero_area_triangles(mesh), ..Offenders::default() };
    offenders.crossing = self_intersections(mesh);
    look_at_edges(interfaces, &mut report, &mut offenders);
    look_at_materials(interfaces, options, &mut report, &mut offenders);
    look_at_distances(interfaces, options, &meeting, &mut report, &mut offenders);
    look_at_nodes(interfaces, options, &mut report, &mut offenders);
    let name = |id: MaterialId| options.table.get(id.index()).map_or_else(|| id.0.to_string(), |m| m.name.clone());
    report.pairs = interfaces
        .pairs()
        .into_iter()
        .map(|pair| {
            let part = interfaces.part(|between| between == pair);
            PairReport { between: pair.map(name), area: measure(&part).area, quality: summarise(&part) }
        })
        .collect();
    if let Some(limit) = options.min_radius_ratio {
        let ratios = radius_ratios(mesh);
        let poor = (0..ratios.len() as u32).filter(|&t| ratios[t as usize] < limit);
        let is_forced = |t: &u32| is_forced(interfaces, &meeting, limit, *t);
        let (between_curves, poor) = poor.partition::<Vec<u32>, _>(is_forced);
        offenders.poor = poor;
        let geometry = options.nodes.geometry();
        let told = |&t: &u32| {
            let place = geometry.grid_to_world(mesh.corners(t as usize).into_iter().sum::<DVec3>() / 3.0);
            ForcedTriangle { place: place.to_array(), radius_ratio: ratios[t as usize] }
        };
        report.poor_between_curves = between_curves.iter().map(told).collect();
        report.poor_between_curves.sort_by(|a, b| a.radius_ratio.total_cmp(&b.radius_ratio));
        let left = (0..ratios.len()).filter(|&t| between_curves.binary_search(&(t as u32)).is_err());
        report.smallest_elsewhere = left.map(|t| ratios[t]).fold(1.0, f64::min);
        if !options.accept_forced {
            offenders.forced = between_curves;
        }
    }
    report.bad_edges = offenders.edges.len();
    report.spurious_junction_edges = offenders.spurious.len();
    report.segments = interfaces.segments.len();
    report.missing_segments = offenders.missing_segments.len();
    report.material_edges_not_closed = offenders.not_closed.len();
    report.material_vertices_pinched = offenders.pinched.len();
    report.zero_area_triangles = offenders.zero_area.len();
    report.self_intersections = offenders.crossing.len();
    report.failed = failed(&report, &offenders, options);
    report.offenders = offenders;
    report
}

/// Whether the junction curves force a triangle to have a radius ratio below a limit; `meeting` counts the materials at each vertex.
fn is_forced(interfaces: &Interfaces, meeting: &[usize], limit: f64, triangle: u32) -> bool {
    let corners = interfaces.mesh.triangles[triangle as usize];
    let places = interfaces.mesh.corners(triangle as usize);
    let sides = [[0, 1], [1, 2], [2, 0]];
    let length = |[a, b]: [usize; 2]| places[a].distance(places[b]);
    let longest = sides.into_iter().map(length).fold(0.0, f64::max);
    let is_short_curve = |side: [usize; 2]| {
        let [a, b] = side.map(|k| corners[k]);
        let is_whole = [a, b].iter().all(|&v| meeting[v as usize] > 3);
        let is_segment = || interfaces.segments.binary_search_by_key(&segment(a, b), |(pair, _)| *pair).is_ok();
        // 2r/R of a triangle with one side of length a and two of length b is at most 2a/b
        is_whole && 2.0 * length(side) < limit * longest && is_segment()
    };
    corners.iter().all(|&v| meeting[v as usize] > 2) || sides.into_iter().any(is_short_curve)
}

/// Whether the triangles round an edge are those of a ring of materials, as many as there are, in which each comes once.
fn is_ring(pairs: &[[MaterialId; 2]]) -> bool {
    let mut times: BTreeMap<MaterialId, usize> = BTreeMap::new();
    pairs.iter().flatten().for_each(|&id| *times.entry(id).or_default() += 1);
    times.values().all(|&n| n == 2) && (pairs.len() == 2 || times.len() == pairs.len())
}

fn look_at_edges(interfaces: &Interfaces, report: &mut ComplexReport, offenders: &mut Offenders) {
    let segments: BTreeMap<Segment, Stratum> = interfaces.segments.iter().copied().collect();
    let mut present = 0;
    for (edge, triangles) in interfaces.edges() {
        let pairs: Vec<[MaterialId; 2]> = triangles.iter().map(|&t| interfaces.between[t as usize]).collect();
        if !is_ring(&pairs) {
            offenders.edges.push(edge);
        }
        let is_of =
            |curve: &Stratum| pairs.len() > 2 && is_ring(&pairs) && pairs.iter().flatten().all(|&id| curve.has(id));
        match segments.get(&edge) {
            Some(curve) if is_of(curve) => present += 1,
            Some(_) => offenders.missing_segments.push(edge),
            None if triangles.len() > 2 => offenders.spurious.push(edge),
            None => {}
        }
        report.junction_edges += usize::from(triangles.len() > 2);
    }
    if present + offenders.missing_segments.len() < segments.len() {
        let edges: Vec<[u32; 2]> = interfaces.edges().into_iter().map(|(edge, _)| edge).collect();
        offenders.missing_segments.extend(segments.keys().filter(|pair| edges.binary_search(pair).is_err()));
    }
}

fn look_at_materials(
    interfaces: &Interfaces,
    options: &CheckOptions,
    report: &mut ComplexReport,
    offenders: &mut Offenders,
) {
    let of_material = |id: MaterialId| {
        let (mesh, vertices, _) = interfaces.surface_of(id);
        let topology = analyse(&mesh);
        let measured = measure(&mesh);
        let name = options.table.get(id.index()).map_or_else(|| id.0.to_string(), |m| m.name.clone());
        let surfaces = topology.components.len();
        let own =
            MaterialReport { name, volume: measured.volume, area: measured.area, surfaces, pieces: Pieces::default() };
        let edges = [topology.open_edges, topology.non_manifold_edges, topology.badly_oriented_edges].concat();
        let edges: Vec<[u32; 2]> = edges.into_iter().map(|edge| edge.map(|v| vertices[v as usize])).collect();
        let pinched: Vec<u32> = topology.non_manifold_vertices.iter().map(|&v| vertices[v as usize]).collect();
        (own, edges, pinched)
    };
    let found: Vec<_> = interfaces.materials().into_par_iter().map(of_material).collect();
    for (own, edges, pinched) in found {
        report.materials.push(own);
        offenders.not_closed.extend(edges);
        offenders.pinched.extend(pinched);
    }
    offenders.not_closed.sort_unstable();
    offenders.not_closed.dedup();
    offenders.pinched.sort_unstable();
    offenders.pinched.dedup();
}

fn look_at_distances(
    interfaces: &Interfaces,
    options: &CheckOptions,
    meeting: &[usize],
    report: &mut ComplexReport,
    offenders: &mut Offenders,
) {
    let voxel = options.indicators.voxel();
    let distance = |p, [i, j]: [MaterialId; 2]| {
        let (value, gradient) = options.indicators.difference_gradient(i, j, p);
        distance_estimate(value, gradient).abs() / voxel
    };
    let mesh = &interfaces.mesh;
    let centroids: Vec<f64> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            distance((a + b + c) / 3.0, interfaces.between[t])
        })
        .collect();
    let at_corners: Vec<[f64; 3]> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| mesh.corners(t).map(|p| distance(p, interfaces.between[t])))
        .collect();
    let mut vertices = vec![0.0f64; mesh.vertices.len()];
    for (corners, distances) in mesh.triangles.iter().zip(at_corners) {
        for (&v, distance) in corners.iter().zip(distances) {
            let known = &mut vertices[v as usize];
            // one that is not a number stays
            *known = if distance.is_nan() { f64::INFINITY } else { known.max(distance) };
        }
    }
    let least = options.max_vertex_distance;
    let limit = |count: &usize| if *count > 4 { least.max(SAME_JUNCTION) } else { least };
    let mut limits: Vec<f64> = meeting.iter().map(limit).collect();
    for &v in interfaces.joined.iter().filter(|&&v| v != u32::MAX) {
        limits[v as usize] = least.max(ONE_CURVE);
    }
    offenders.distant = (0..vertices.len() as u32).filter(|&v| vertices[v as usize] > limits[v as usize]).collect();
    report.vertex_distance = DistanceSummary::of(&vertices);
    report.centroid_distance = DistanceSummary::of(&centroids);
}

fn look_at_nodes(
    interfaces: &Interfaces,
    options: &CheckOptions,
    report: &mut ComplexReport,
    offenders: &mut Offenders,
) {
    let found = options.nodes.by_walls(&walls(interfaces));
    let truth = options.nodes.materials();
    offenders.nodes = (0..truth.len()).into_par_iter().filter(|&n| truth[n] != found[n]).collect();
    report.nodes_changed = offenders.nodes.len();
    let pieces = pieces(options.nodes, &found, options.table.len());
    for own in &mut report.materials {
        let id = options.table.iter().position(|material| material.name == own.name);
        if let Some(found) = id.and_then(|id| pieces.get(id)) {
            own.pieces = found.clone();
        }
    }
    report.missing_components = pieces.iter().map(|own| own.missing.len()).sum();
    report.missing_specks = pieces.iter().map(|own| own.missing_specks).sum();
}

fn failed(report: &ComplexReport, offenders: &Offenders, options: &CheckOptions) -> Vec<String> {
    let kept = if options.keeps_nodes { report.nodes_changed } else { 0 };
    let counts = [
        (report.bad_edges, "edges with a number of triangles that contradicts the materials around them"),
        (report.spurious_junction_edges, "edges of more than two triangles away from junction curves"),
        (report.missing_segments, "segments of junction curves that are not edges between their materials"),
        (report.material_edges_not_closed, "edges where the surface of a material is open or touches itself"),
        (report.material_vertices_pinched, "vertices where the surface of a material touches itself"),
        (report.zero_area_triangles, "triangles of zero area"),
        (report.self_intersections, "pairs of intersecting triangles"),
        (report.missing_components, "missing components of materials"),
        (kept, "voxel centres in the wrong material"),
    ];
    let mut failed: Vec<String> =
        counts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
    if let Some(limit) = options.min_radius_ratio
        && !offenders.poor.is_empty()
    {
        let (count, smallest) = (offenders.poor.len(), report.smallest_elsewhere);
        failed.push(format!("{count} triangles with a radius ratio below {limit} (minimum {smallest:.4})"));
    }
    if !options.accept_forced
        && let Some(forced) = report.forced()
    {
        failed.push(format!("{forced}: {REMEDY}"));
    }
    if !offenders.distant.is_empty() {
        let (count, limit, farthest) =
            (offenders.distant.len(), options.max_vertex_distance, report.vertex_distance.max);
        failed.push(format!(
            "{count} vertices with a deviation of more than {limit} voxel from their interface (maximum {})",
            significant(farthest)
        ));
    }
    failed
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_mesh::TriangleMesh;

    #[test]
    fn curves_force_a_triangle_between_three_of_their_places_or_on_a_whole_one_far_shorter_than_its_other_sides() {
        let at = |x: f64| DVec3::new(x, 0.0, 0.0);
        let vertices = vec![at(0.0), at(0.1), at(0.2), DVec3::Y];
        let mesh = TriangleMesh { vertices, triangles: vec![[0, 1, 3], [1, 2, 3]] };
        let curve = Stratum::new(&[0, 1, 2].map(MaterialId)).expect("three");
        let segments = vec![([0, 1], curve), ([1, 2], curve)];
        let between = vec![[MaterialId(1), MaterialId(0)]; 2];
        let interfaces = Interfaces { mesh, between, segments, joined: Vec::new() };
        let forced = |meeting: [usize; 4], limit: f64| [0, 1].map(|t| is_forced(&interfaces, &meeting, limit, t));
        assert_eq!(forced([3, 3, 3, 2], 0.3), [false, false], "a segment can be made longer");
        assert_eq!(forced([4, 4, 3, 2], 0.3), [true, false], "a whole curve cannot");
        assert_eq!(forced([4, 4, 4, 2], 0.15), [false, false], "0.1 is long enough for a ratio of 0.15");
        assert_eq!(forced([4, 4, 3, 3], 0.15), [true, true], "all corners on curves");
        let none = Interfaces { segments: Vec::new(), ..interfaces.clone() };
        assert!(!is_forced(&none, &[4, 4, 4, 2], 0.3, 0), "no curve joins the two points");
    }
}
