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

/// Kinds of faults in a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// Edges of only one triangle in the surface of a region.
    OpenEdges,
    /// Edges of only one triangle at the border of the volume, if the surface may be open there.
    /// They do not fail the check.
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
    /// Edges of more than two triangles that are not segments of a junction curve.
    SpuriousJunctionEdges,
    /// Segments of junction curves that are not edges of at least three triangles between their
    /// materials.
    MissingSegments,
    /// Grid nodes in another material. They fail the check only if nodes must stay on their side.
    NodesOnWrongSide,
    /// Triangles below the minimum radius ratio that are not forced.
    PoorTriangles,
    /// Triangles that the junction curves force below the minimum radius ratio, unless accepted.
    ForcedTriangles,
    /// Vertices whose distance from an interface exceeds the limit.
    DistantVertices,
    /// Triangles whose normal points against the gradient at the centroid. They do not fail the
    /// check: they show detail finer than the edges.
    TurnedTriangles,
}

impl Fault {
    /// Returns the number of the fault in the file of offending simplices (0 if it is not written
    /// there), and its name in messages.
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
    /// Pairs of vertices. `u32::MAX` denotes a vertex that is not in the mesh.
    Edges(Vec<Segment>),
    /// Triangles of the mesh.
    Triangles(Vec<u32>),
    /// Pairs of triangles of the mesh.
    TrianglePairs(Vec<[u32; 2]>),
    /// Grid nodes by linear index, x fastest.
    Nodes(Vec<usize>),
    /// The number of components.
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

/// Summary of the distances |F| / |grad F| in voxels (geometric mean spacing).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DistanceSummary {
    /// Mean distance.
    pub mean: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum distance.
    pub max: f64,
}

impl DistanceSummary {
    /// Returns the summary of some distances.
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
    /// Counts of simplices, Euler characteristic and genus.
    #[serde(flatten)]
    pub topology: ComponentTopology,
    /// Area in mm^2, and signed volume in mm^3, which is negative for the surface of a cavity.
    #[serde(flatten)]
    pub measure: Measure,
}

/// Measurements of the closed surface of a region.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RegionReport {
    /// Name of the material; `object` for one object.
    pub name: String,
    /// Volume in mm^3. The volume of the outside is minus the sum of all others.
    pub volume: f64,
    /// Area, mm^2.
    pub area: f64,
    /// Euler characteristic.
    pub euler: i64,
    /// Components of the surface: one for each component of the region, and one for each cavity.
    pub components: Vec<ComponentReport>,
}

/// Measurements of the triangles between two materials.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PairReport {
    /// Names of the materials inside and outside.
    pub between: [String; 2],
    /// Area, mm^2.
    pub area: f64,
    /// Summary of the shapes of the triangles.
    pub quality: QualitySummary,
}

/// Numbers of elements on junction curves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct JunctionReport {
    /// Edges of at least three triangles.
    pub junction_edges: usize,
    /// Vertices of at least four materials.
    pub junction_points: usize,
    /// Segments of junction curves.
    pub segments: usize,
}

/// A triangle that the junction curves force below the minimum radius ratio. Either all its
/// vertices are on junction curves, or one edge is a whole curve between two junction points and is
/// shorter than half the minimum ratio times the longest edge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ForcedTriangle {
    /// Centroid in world coordinates, mm.
    pub place: [f64; 3],
    /// Radius ratio.
    pub radius_ratio: f64,
}

/// Result of a check. The JSON form omits the offending simplices.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CheckReport {
    /// Whether all coordinates are finite and all vertex indices are valid. If not, nothing else is
    /// checked.
    pub well_formed: bool,
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Number of simplices of each fault that was searched for.
    #[serde(flatten)]
    pub counts: BTreeMap<Fault, usize>,
    /// Numbers of elements on junction curves.
    #[serde(flatten)]
    pub junctions: JunctionReport,
    /// Surfaces of the regions, by ascending material. With a single interface, only the region
    /// inside.
    pub regions: Vec<RegionReport>,
    /// The interfaces.
    pub pairs: Vec<PairReport>,
    /// Summary of the distances of the vertices from their interfaces.
    pub vertex_distance: Option<DistanceSummary>,
    /// Summary of the distances of the triangle centroids from their interfaces.
    pub centroid_distance: Option<DistanceSummary>,
    /// Summary of the shapes of all triangles.
    pub quality: QualitySummary,
    /// Triangles that the junction curves force below the minimum radius ratio, worst first.
    pub poor_between_curves: Vec<ForcedTriangle>,
    /// Minimum radius ratio that passes.
    pub min_radius_ratio_allowed: Option<f64>,
    /// Offending simplices of each fault that was searched for.
    #[serde(skip)]
    pub offenders: BTreeMap<Fault, Simplices>,
    /// Failed checks in words; empty if the mesh passes.
    pub failed: Vec<String>,
}

impl CheckReport {
    /// Returns the number of simplices of a fault, 0 if it was not searched for.
    pub fn count(&self, fault: Fault) -> usize {
        self.counts.get(&fault).copied().unwrap_or_default()
    }

    /// Returns the first region, which is the surface of one object. It is empty if the mesh has no
    /// triangles.
    pub fn object(&self) -> &RegionReport {
        static EMPTY: RegionReport =
            RegionReport { name: String::new(), volume: 0.0, area: 0.0, euler: 0, components: Vec::new() };
        self.regions.first().unwrap_or(&EMPTY)
    }

    /// Returns a description of the triangles that the junction curves force below the minimum
    /// radius ratio, with the position of the worst one. Returns `None` if there are none.
    pub fn forced(&self) -> Option<String> {
        let worst = self.poor_between_curves.first()?;
        let (count, ratio, at) = (self.poor_between_curves.len(), worst.radius_ratio, place(worst.place));
        Some(format!(
            "{count} poor triangles forced by the junction curves, which meet there at small angles, turn within h, or are far shorter than \
             h (smallest radius ratio {ratio:.4} at {at} mm; `poor_between_curves` in the report lists them)"
        ))
    }
}
