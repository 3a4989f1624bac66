//! Predicts the cost of meshing an object from its voxels: vertices, processor time and memory.
//!
//! `sizefield` computes the edge length h from local feature size and curvature, and limits its
//! gradient (`sizefield --help`). This module estimates h roughly, from the mean curvature and the
//! thickness at sampled faces ([`crate::boundary`]). A factor fitted to the shared volumes accounts
//! for the gradient limit and for other effects that the estimate ignores. The comment of each
//! constant states its measurement or source.

use crate::boundary::{BALL, Boundary, SampledFace};
use crate::kind::Kind;
use isoparticles_field::spline::ROOM;
use isoparticles_volume::Geometry;
use serde::Serialize;

/// Ratio of the edge length to the radius of mean curvature. The value comes from a grid search
/// over this constant, [`EDGE_OVER_THICKNESS`], [`STAIRCASE`] and [`BALL`]. The search minimised
/// the scatter of the ratio of predicted to actual vertex count over fourteen surfaces. The
/// remaining scatter is a factor of 1.3. `stages/distfield/benches/predicted.py` lists the
/// surfaces, compares the counts and prints corrections for [`GRADATION_LABELS`] and
/// [`GRADATION_SCAN`].
const EDGE_OVER_RADIUS: f64 = 0.30;

/// Ratio of the edge length to the thickness, from the same search as [`EDGE_OVER_RADIUS`].
const EDGE_OVER_THICKNESS: f64 = 0.20;

/// Root-mean-square imbalance that the voxel staircase causes on a plane, from the same search as
/// [`EDGE_OVER_RADIUS`].
const STAIRCASE: f64 = 0.06;

/// Default minimum h of `sizefield --quality medium`, in units of the mean voxel spacing.
const SMALLEST_VOXELS: f64 = 0.75;

/// Default maximum h of `sizefield --quality medium`, in units of the diagonal of the object's
/// bounding box.
const LARGEST_DIAGONALS: f64 = 0.1;

/// Ratio of the actual vertex count to the count computed from h at the sampled faces, for label
/// maps. The ratio exceeds 1 because the gradient limit extends small values of h to nearby
/// regions. The value is the geometric mean over the surfaces in `predicted.py` except the
/// smallest.
const GRADATION_LABELS: f64 = 1.82;

/// The same ratio as [`GRADATION_LABELS`], for scans. It is larger because the surface of a scan is
/// not smoothed, and because features that lie between voxel centres have no faces to sample.
const GRADATION_SCAN: f64 = 2.22;

/// Expected maximum factor by which the predicted vertex count is too high or too low. The factor
/// is at most 1.43 for all but the smallest of the fourteen surfaces (`predicted.py`).
pub const UNCERTAINTY: f64 = 1.5;

/// Minimum number of vertices of a part with default sizes; equal to `MIN_PARTICLES` of
/// `sizefield`.
const SPECK_VERTICES: f64 = 32.0;

/// Minimum number of vertices of a part for any edge length; equal to `COMPONENT_MINIMUM` in
/// `seed`.
pub(crate) const FEWEST_VERTICES: f64 = 12.0;

/// Cost of a group of stages: a fixed amount, plus amounts per node of the padded grid, per voxel
/// face at the surface and per vertex.
struct Rates {
    stage: &'static str,
    /// Processor time in seconds: a fixed amount, and amounts per million nodes, faces and
    /// vertices.
    seconds: [f64; 4],
    /// Memory in bytes: a fixed amount, and amounts per node, face and vertex. There is one entry
    /// for each program that can have the highest peak of the group. The prediction is the maximum
    /// over the entries.
    bytes: &'static [[f64; 4]],
}

/// Cost rates of the four groups of stages, measured on seven phantoms with
/// `python stages/distfield/benches/costs.py`, on two cores of an EPYC that also ran other work.
/// The predicted memory is within about a fifth of the measured memory, and the predicted time
/// within about a third of the measured time. The two exceptions are the time of `particles` on the
/// noise phantom (11.3 s measured, 4.3 s predicted, because the stage runs all its passes) and on
/// the coarse ball.
///
/// - `fields`: the two entries for memory belong to `distfield` and `sizefield`. `sizefield` needs
///   12 bytes per node for F, its coefficients and h, and 820 to 1,160 bytes per vertex on eight
///   shared volumes (`costs.py --volumes`; 551 on `heart_ct`).
/// - `triangles`: the bytes per vertex were measured on `thorax_ct_native_u8`.
/// - `tetrahedra`: the elapsed time for the torso is 11.7 s with the lungs (36,514 vertices) and
///   19.5 s with the ribs (99,084 vertices). The memory is 896 MiB for `heart` (55,626 vertices)
///   and 2,050 MiB for `ribs` (292,825 vertices; `docs/developer/performance.md`, "Real volumes").
const RATES: [Rates; 4] = [
    Rates {
        stage: "fields",
        seconds: [0.0, 0.8, 46.0, 0.0],
        bytes: &[[1.9e7, 15.5, 0.0, 0.0], [0.0, 12.0, 0.0, 950.0]],
    },
    Rates { stage: "particles", seconds: [0.0, 0.0, 0.0, 130.0], bytes: &[[1.5e7, 14.5, 0.0, 350.0]] },
    Rates { stage: "triangles", seconds: [0.0, 0.12, 0.0, 52.0], bytes: &[[1.3e7, 14.5, 0.0, 1034.0]] },
    Rates { stage: "tetrahedra", seconds: [7.0, 0.0, 0.0, 125.0], bytes: &[[6.3e8, 0.0, 0.0, 5100.0]] },
];

/// Memory of `distfield` in bytes per node of the padded grid, excluding its input. Measured on
/// 512^3 voxels, with F on the whole grid: 5.98 for labels and 5.16 for scalars
/// (`docs/developer/performance.md`, "Memory").
const DISTFIELD_BYTES: f64 = 6.0;

/// Constant edge lengths, in units of the mean spacing, for which the vertex count is predicted.
const SIZES: [f64; 4] = [1.0, 2.0, 4.0, 8.0];

/// Predicted cost of meshing an object.
#[derive(Clone, Debug, Serialize)]
pub struct Cost {
    /// Area of the object's surface in mm^2.
    pub area: f64,
    /// Number of vertices with default sizes.
    pub vertices: usize,
    /// Expected range of the vertex count: from `vertices` divided by [`UNCERTAINTY`] to `vertices`
    /// multiplied by it.
    pub vertices_range: [usize; 2],
    /// Predicted vertex counts for several constant edge lengths.
    pub uniform: Vec<Uniform>,
    /// Time and memory of the stages with default sizes.
    pub stages: Vec<StageCost>,
}

/// A constant edge length and the predicted number of vertices.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Uniform {
    /// Edge length in mm.
    pub size: f64,
    /// Number of vertices.
    pub vertices: usize,
}

/// Time and memory of a group of stages.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StageCost {
    /// Name of the group: `fields` (distfield, sizefield and seed), `particles`, `triangles`
    /// (reconstruct) or `tetrahedra` (tetmesh-check).
    pub stage: &'static str,
    /// Processor time in seconds, summed over all threads. For `tetrahedra`, which uses one thread,
    /// this is the elapsed time.
    pub seconds: f64,
    /// Peak memory in bytes.
    pub bytes: f64,
    /// Increase of the peak memory with each further vertex, in bytes.
    pub bytes_per_vertex: f64,
}

/// Predicts the cost of an object from its boundary and its number of connected parts (assumed to
/// be 1 if unknown).
pub fn cost(boundary: &Boundary, parts: Option<usize>, geometry: &Geometry, kind: Kind) -> Cost {
    let area = boundary.area(geometry);
    let parts = parts.unwrap_or(1) as f64;
    let vertices = default_vertices(boundary, geometry, kind).max(SPECK_VERTICES * parts);
    let faces: usize = boundary.faces.iter().sum();
    let counts = [nodes(boundary, geometry), faces as f64, vertices];
    let total =
        |rates: &[f64; 4]| rates[0] + rates[1..].iter().zip(counts).map(|(rate, count)| rate * count).sum::<f64>();
    let stages = RATES.iter().map(|rates| {
        let [by_itself, each @ ..] = rates.seconds;
        let [node, face, vertex] = each.map(|seconds| 1e-6 * seconds);
        let bytes = rates.bytes.iter().map(total).fold(0.0, f64::max);
        let bytes_per_vertex = rates.bytes.iter().map(|rates| rates[3]).fold(0.0, f64::max);
        StageCost { stage: rates.stage, seconds: total(&[by_itself, node, face, vertex]), bytes, bytes_per_vertex }
    });
    let voxel = geometry.mean_spacing();
    let uniform = SIZES.map(|voxels| {
        let size = two_digits(voxels * voxel);
        let vertices = (area * lattice_density(size)).max(FEWEST_VERTICES * parts);
        Uniform { size, vertices: two_digits(vertices) as usize }
    });
    Cost {
        area,
        vertices: two_digits(vertices) as usize,
        vertices_range: [two_digits(vertices / UNCERTAINTY) as usize, two_digits(vertices * UNCERTAINTY) as usize],
        uniform: uniform.to_vec(),
        stages: stages.collect(),
    }
}

/// Returns the number of nodes of the grid of F. The grid is the bounding box of the object,
/// extended by [`ROOM`] voxels on each side and clipped to the volume, plus a margin of five
/// voxels.
fn nodes(boundary: &Boundary, geometry: &Geometry) -> f64 {
    let along = |axis: usize| {
        let voxels = boundary.extent()[axis] / geometry.spacing[axis] + 1.0 + 2.0 * ROOM as f64;
        voxels.min(geometry.size[axis] as f64) + 10.0
    };
    (0..3).map(along).product()
}

/// Predicts the number of vertices of a mesh with default sizes, from the h estimated at each
/// sampled face.
pub fn default_vertices(boundary: &Boundary, geometry: &Geometry, kind: Kind) -> f64 {
    let voxel = geometry.mean_spacing();
    let smallest = SMALLEST_VOXELS * voxel;
    let largest = (LARGEST_DIAGONALS * boundary.diagonal()).max(smallest);
    let gradation = match kind {
        Kind::Labels => GRADATION_LABELS,
        Kind::Scan => GRADATION_SCAN,
    };
    let count = |place: &SampledFace| {
        let SampledFace { imbalance, thickness, .. } = *place;
        let curvature = (imbalance * imbalance - STAIRCASE * STAIRCASE).max(0.0).sqrt() * 16.0 / (3.0 * BALL);
        let wanted = (EDGE_OVER_RADIUS / curvature.max(1e-9)).min(EDGE_OVER_THICKNESS * thickness);
        boundary.area_of(place, geometry) * lattice_density((wanted * voxel).clamp(smallest, largest))
    };
    gradation * boundary.sample.iter().map(count).sum::<f64>()
}

/// Returns the number of vertices per mm^2 of a lattice of equilateral triangles with edges of
/// `size` mm.
fn lattice_density(size: f64) -> f64 {
    2.0 / (3f64.sqrt() * size * size)
}

/// Rounds a value to two significant digits, the accuracy of the predictions.
pub fn two_digits(value: f64) -> f64 {
    if value <= 0.0 {
        return 0.0;
    }
    let unit = 10f64.powf(value.log10().floor() - 1.0);
    (value / unit).round() * unit
}

/// Returns the peak memory of `distfield` in bytes, excluding its input, for a padded grid of
/// `nodes` nodes.
pub fn distfield_bytes(nodes: usize) -> f64 {
    DISTFIELD_BYTES * nodes as f64
}
