//! The report of a check: counts and simplices by kind of fault, and measurements of regions,
//! interfaces and junction curves.

use crate::interfaces::Segment;
use isoparticles_mesh::measure::Measure;
use isoparticles_mesh::quality::{QualitySummary, mean, percentile};
use isoparticles_mesh::topology::ComponentTopology;
use isoparticles_stage::cli::values::place;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// Kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// Edges of only one triangle in the surface of a region.
    OpenEdges,
    /// Edges of only one triangle where the volume ends, if the surface may be open there. This is
    /// no failure.
    BorderEdges,
    /// Edges of more than two triangles in the surface of a region.
    NonManifoldEdges,
    /// Edges with two triangles of opposite orientation in the surface of a region.
    BadlyOrientedEdges,
    /// Vertices with more than one fan of triangles in the surface of a region.
    NonManifoldVertices,
    /// Vertices without triangles.
    UnusedVertices,
    /// Triangles with a repeated vertex, or equal to another triangle.
    RepeatedTriangles,
    /// Triangles without area.
    ZeroAreaTriangles,
    /// Pairs of intersecting triangles.
    SelfIntersections,
    /// Components whose normals point against the gradient.
    InwardComponents,
    /// Edges of several interfaces that are on no junction curve.
    SpuriousJunctionEdges,
    /// Segments of junction curves without triangles of their materials.
    MissingSegments,
    /// Grid nodes in another material.
    NodesOnWrongSide,
    /// Triangles below the minimum radius ratio, without the forced ones.
    PoorTriangles,
    /// Triangles below the minimum radius ratio that the junction curves force, if not accepted.
    ForcedTriangles,
    /// Vertices too far from an interface.
    DistantVertices,
    /// Triangles whose normal points against the gradient at the centroid. This is no failure: it
    /// shows detail finer than the edges.
    TurnedTriangles,
}

impl Fault {
    /// Returns the number of the fault in the file of offending simplices, 0 if it has none there,
    /// and its name in messages.
    pub(crate) fn described(self) -> (i64, &'static str) {
        match self {
            Self::OpenEdges => (1, "open edges (edges of only one triangle)"),
            Self::NonManifoldEdges => (2, "non-manifold edges (edges of more than two triangles)"),
            Self::BadlyOrientedEdges => (3, "edges between triangles of opposite orientation"),
            Self::NonManifoldVertices => (4, "non-manifold vertices (vertices with more than one fan of triangles)"),
            Self::DistantVertices => (5, "vertices with a deviation"),
            Self::NodesOnWrongSide => (6, "voxel centres on the wrong side of the mesh"),
            Self::RepeatedTriangles => (7, "triangles with a repeated vertex, or equal to another triangle"),
            Self::ZeroAreaTriangles => (8, "triangles of zero area"),
            Self::SelfIntersections => (9, "pairs of intersecting triangles"),
            Self::PoorTriangles => (10, "triangles with a radius ratio"),
            Self::TurnedTriangles => (11, "triangles with normals against the gradient"),
            Self::MissingSegments => (12, "segments of junction curves that are not edges between their materials"),
            Self::ForcedTriangles => (13, "poor triangles forced by the junction curves"),
            Self::SpuriousJunctionEdges => (14, "edges of more than two triangles away from junction curves"),
            Self::UnusedVertices => (0, "unused vertices"),
            Self::InwardComponents => (0, "components with inward normals"),
            Self::BorderEdges => (0, "open edges at the border of the volume"),
        }
    }
}

/// The simplices of a fault, ascending.
#[derive(Clone, Debug, PartialEq)]
pub enum Simplices {
    /// Vertices of the mesh.
    Vertices(Vec<u32>),
    /// Pairs of vertices. Vertices that are not in the mesh have the number `u32::MAX`.
    Edges(Vec<Segment>),
    /// Triangles of the mesh.
    Triangles(Vec<u32>),
    /// Pairs of triangles of the mesh.
    TrianglePairs(Vec<[u32; 2]>),
    /// Grid nodes, x fastest.
    Nodes(Vec<usize>),
    /// A number of components.
    Components(usize),
}

impl Simplices {
    /// Returns the number of simplices.
    pub fn count(&self) -> usize {
        match self {
            Self::Vertices(list) | Self::Triangles(list) => list.len(),
            Self::Edges(list) | Self::TrianglePairs(list) => list.len(),
            Self::Nodes(list) => list.len(),
            Self::Components(count) => *count,
        }
    }
}

/// Distances |F| / |grad F| in voxels (geometric mean spacing).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DistanceSummary {
    /// Mean.
    pub mean: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
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

/// Topology and size of one component of the surface of a region.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ComponentReport {
    /// Counts, Euler characteristic, genus.
    #[serde(flatten)]
    pub topology: ComponentTopology,
    /// Area, and signed volume, which is negative for the surface of a cavity.
    #[serde(flatten)]
    pub measure: Measure,
}

/// The closed surface of a region.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RegionReport {
    /// Name of the material; `object` for one object.
    pub name: String,
    /// Volume, mm^3. The volume of the outside is minus that of all other regions.
    pub volume: f64,
    /// Area, mm^2.
    pub area: f64,
    /// Euler characteristic.
    pub euler: i64,
    /// The components of the surface: one for each component of the region, and one for each
    /// cavity.
    pub components: Vec<ComponentReport>,
}

/// The triangles between two materials.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PairReport {
    /// Names of the materials inside and outside.
    pub between: [String; 2],
    /// Area, mm^2.
    pub area: f64,
    /// Shapes.
    pub quality: QualitySummary,
}

/// Numbers of elements on junction curves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct JunctionReport {
    /// Edges of three triangles or more.
    pub junction_edges: usize,
    /// Vertices at which four materials or more meet.
    pub junction_points: usize,
    /// Segments of junction curves.
    pub segments: usize,
}

/// A poor triangle that the junction curves force: its corners all lie on them, or one of its sides
/// is the whole of a curve between two junction points that is far shorter than h.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ForcedTriangle {
    /// Its centroid in world coordinates, mm.
    pub place: [f64; 3],
    /// Its radius ratio.
    pub radius_ratio: f64,
}

/// Result of a check. Serialises to the JSON of the reports, without the offending simplices.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CheckReport {
    /// False if a coordinate is not finite or an index names no vertex; nothing else is checked
    /// then.
    pub well_formed: bool,
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Number of simplices by fault, for each fault that was looked for.
    #[serde(flatten)]
    pub counts: BTreeMap<Fault, usize>,
    /// Numbers of elements on junction curves.
    #[serde(flatten)]
    pub junctions: JunctionReport,
    /// The regions, ascending by material; for one interface, only the region inside.
    pub regions: Vec<RegionReport>,
    /// The interfaces.
    pub pairs: Vec<PairReport>,
    /// Distances of the vertices from their interfaces.
    pub vertex_distance: Option<DistanceSummary>,
    /// Distances of the centroids of the triangles from their interfaces.
    pub centroid_distance: Option<DistanceSummary>,
    /// Shapes of all triangles.
    pub quality: QualitySummary,
    /// Triangles that the junction curves force below the minimum radius ratio, worst first.
    pub poor_between_curves: Vec<ForcedTriangle>,
    /// The limit for the minimum radius ratio.
    pub min_radius_ratio_allowed: Option<f64>,
    /// The offending simplices.
    #[serde(skip)]
    pub offenders: BTreeMap<Fault, Simplices>,
    /// The checks that failed, in words; empty if the mesh passes.
    pub failed: Vec<String>,
}

impl CheckReport {
    /// Returns the number of simplices of a fault, 0 if it was not looked for.
    pub fn count(&self, fault: Fault) -> usize {
        self.counts.get(&fault).copied().unwrap_or_default()
    }

    /// Returns the surface of one object; an empty one if the mesh has no triangles.
    pub fn object(&self) -> RegionReport {
        self.regions.first().cloned().unwrap_or_default()
    }

    /// Describes the triangles that the junction curves force below the minimum radius ratio, with
    /// the position of the worst.
    pub fn forced(&self) -> Option<String> {
        let worst = self.poor_between_curves.first()?;
        let (count, ratio, at) = (self.poor_between_curves.len(), worst.radius_ratio, place(worst.place));
        Some(format!(
            "{count} poor triangles forced by the junction curves, which meet there at small angles, turn within h, or are far shorter than \
             h (smallest radius ratio {ratio:.4} at {at} mm; `poor_between_curves` in the report lists them)"
        ))
    }
}
