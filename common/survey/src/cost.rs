//! What a mesh of an object would cost: vertices, time and memory, from the voxels alone.
//!
//! The size field asks for edges by local feature size and curvature, graded (`sizefield --help`). From a sampled face the mean curvature and
//! the thickness are known roughly ([`crate::boundary`]), so that h there is as well; what gradation and the other features of
//! the surface add is a factor that was fitted to the shared volumes. Every constant here is a measurement, its command beside it.

use crate::boundary::{BALL, Boundary, Place};
use crate::kind::Kind;
use isoparticles_field::spline::ROOM;
use isoparticles_volume::Geometry;
use serde::Serialize;

/// Edge length over the radius of mean curvature, and over the thickness. Of a grid of values for these two, [`STAIRCASE`] and the radius [`BALL`], those
/// that leave the least scatter (a factor of 1.3) between predicted and made vertices of the fourteen surfaces that `docs/developer/performance.md` lists;
/// `stages/distfield/benches/predicted.py` compares, and tells the factors of gradation.
const EDGE_OVER_RADIUS: f64 = 0.30;
const EDGE_OVER_THICKNESS: f64 = 0.20;

/// Imbalance of the ball that the staircase of voxels leaves on a plane surface, root mean square; from the same search.
const STAIRCASE: f64 = 0.06;

/// Bounds of h by default: of the mean voxel spacing, and of the object's diagonal (`sizefield --quality medium`).
const SMALLEST_VOXELS: f64 = 0.75;
const LARGEST_DIAGONALS: f64 = 0.1;

/// Vertices for each that the edge length at the sampled faces asks for: gradation, which spreads small h to its surroundings. Scans have more, because
/// their surface is not smoothed and crosses cells between the voxels, too.
const GRADATION_LABELS: f64 = 1.82;
const GRADATION_SCAN: f64 = 2.22;

/// How far off a prediction may be: a factor of this, either way. All but the smallest of the fourteen surfaces lie within it, by 1.43 at most.
pub const UNCERTAINTY: f64 = 1.5;

/// Fewest particles that a part is given (`sizefield`): so many vertices a speck has at least.
const SPECK_VERTICES: f64 = 32.0;

/// Fewest particles that a part is seeded with, whatever the size (`seed`).
const FEWEST_VERTICES: f64 = 12.0;

/// What stages take: by itself, and for each node of the padded grid, face between voxels and vertex.
struct Rates {
    stage: &'static str,
    /// Processor seconds: by itself, then for a million of each.
    seconds: [f64; 4],
    /// Bytes at once, of each program that may need the most.
    bytes: &'static [[f64; 4]],
}

/// `python stages/distfield/benches/costs.py`, seven phantoms on two cores of an EPYC, shared with much other work. Memory is met within a fifth; time within a
/// third, but for the particles of noise (11.3 s where these rates give 4.3: they run all passes) and those of a coarse ball. The fields take most in distfield, by
/// nodes, or in sizefield, by vertices: 12 bytes a node for F, its coefficients and h, and 820 to 1,160 a vertex on eight shared volumes (`costs.py --volumes`;
/// 551 on `heart_ct`). `triangles`: bytes a vertex of
/// `thorax_ct_native_u8`. `tetrahedra`: seconds elapsed of the torso's lungs and ribs, 11.7 for 36,514 vertices and 19.5 for 99,084, and 896 and 2,050 MiB
/// for 55,626 and 292,825 vertices of `heart` and `ribs` (all three of `docs/developer/performance.md`).
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

/// Bytes a node that distfield takes above its input's own: 5.98 for labels, 5.16 for scalars of 512^3 (`docs/developer/performance.md`, memory of distfield).
const DISTFIELD_BYTES: f64 = 6.0;

/// Edge lengths besides the default that are told, in mean voxels.
const SIZES: [f64; 4] = [1.0, 2.0, 4.0, 8.0];

/// What a mesh of an object would cost.
#[derive(Clone, Debug, Serialize)]
pub struct Cost {
    /// Area of the object's surface, mm^2.
    pub area: f64,
    /// Vertices with the default sizes.
    pub vertices: usize,
    /// Between what they will be, as far as is known.
    pub vertices_range: [usize; 2],
    /// Vertices with one edge length everywhere.
    pub uniform: Vec<Uniform>,
    /// What the stages take with the default sizes.
    pub stages: Vec<StageCost>,
}

/// One edge length everywhere.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Uniform {
    /// The edge length, mm.
    pub size: f64,
    /// Vertices.
    pub vertices: usize,
}

/// Time and memory of some stages.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StageCost {
    /// The stages: `fields` are distfield, sizefield and seed, `triangles` reconstruct, `tetrahedra` tetmesh-check.
    pub stage: &'static str,
    /// Processor time, seconds, which the stages share among all threads; of `tetrahedra`, which use one, elapsed.
    pub seconds: f64,
    /// Most memory at once, bytes.
    pub bytes: f64,
}

/// The cost of an object of some parts with this boundary.
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
        StageCost { stage: rates.stage, seconds: total(&[by_itself, node, face, vertex]), bytes }
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

/// Nodes of the grid of the object's box, with its room and five more on each face, and no more than those of the volume.
fn nodes(boundary: &Boundary, geometry: &Geometry) -> f64 {
    let along = |axis: usize| {
        let voxels = boundary.extent()[axis] / geometry.spacing[axis] + 1.0 + 2.0 * ROOM as f64;
        voxels.min(geometry.size[axis] as f64) + 10.0
    };
    (0..3).map(along).product()
}

/// Vertices with the default sizes.
pub fn default_vertices(boundary: &Boundary, geometry: &Geometry, kind: Kind) -> f64 {
    let voxel = geometry.mean_spacing();
    let smallest = SMALLEST_VOXELS * voxel;
    let largest = (LARGEST_DIAGONALS * boundary.diagonal()).max(smallest);
    let gradation = match kind {
        Kind::Labels => GRADATION_LABELS,
        Kind::Scan => GRADATION_SCAN,
    };
    let count = |place: &Place| {
        let Place { imbalance, thickness, .. } = *place;
        let curvature = (imbalance * imbalance - STAIRCASE * STAIRCASE).max(0.0).sqrt() * 16.0 / (3.0 * BALL);
        let wanted = (EDGE_OVER_RADIUS / curvature.max(1e-9)).min(EDGE_OVER_THICKNESS * thickness);
        boundary.area_of(place, geometry) * lattice_density((wanted * voxel).clamp(smallest, largest))
    };
    gradation * boundary.sample.iter().map(count).sum::<f64>()
}

/// Vertices for each mm^2 of a lattice of equilateral triangles of edge h.
fn lattice_density(size: f64) -> f64 {
    2.0 / (3f64.sqrt() * size * size)
}

/// Rounded to two significant digits: more are not known.
pub fn two_digits(value: f64) -> f64 {
    if value <= 0.0 {
        return 0.0;
    }
    let unit = 10f64.powf(value.log10().floor() - 1.0);
    (value / unit).round() * unit
}

/// Bytes that distfield holds at once beside its input, for a padded grid of so many nodes.
pub fn distfield_bytes(nodes: usize) -> f64 {
    DISTFIELD_BYTES * nodes as f64
}
