//! The options of a reconstruction.

/// Default minimum radius ratio of the check (`--min-radius-ratio`).
pub(crate) const MIN_RADIUS_RATIO: f64 = 0.3;

/// Method that connects the particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// Delaunay triangulation restricted by the sign of F, refined until it has the topology of the
    /// isosurface
    Restricted,
    /// Tight Cocone (Dey and Goswami 2003): uses only the points and the shape of their Voronoi
    /// cells; with a distance field, points are added where there are too few
    TightCocone,
}

/// Options of a reconstruction. The defaults are those of the program.
#[derive(Clone, Debug)]
pub struct Options {
    /// Method that connects the particles.
    pub method: Method,
    /// Maximum distance of the centroid of a facet from F = 0, mm. Points are added at facets
    /// beyond it. `None`: a quarter of h or of a voxel, whichever is larger.
    pub max_deviation: Option<f64>,
    /// Maximum number of rounds that add points, in each run of the refinement. Grid nodes on the
    /// wrong side have a separate budget of as many rounds.
    pub max_rounds: usize,
    /// Target radius ratio: local moves improve the triangles below it. With 0 and no sweeps, the
    /// triangulation stays unchanged.
    pub improve_below: f64,
    /// Number of sweeps over the whole mesh before the local moves.
    pub relaxation_sweeps: usize,
    /// Whether every voxel centre must stay on its side (label maps at scale 0). Ignored with an
    /// open border.
    pub keeps_voxels: bool,
    /// Whether the surface is open at the border of the volume.
    pub open_border: bool,
    /// Minimum radius ratio that passes; `None` means any.
    pub min_radius_ratio: Option<f64>,
    /// Whether triangles below the minimum radius ratio pass if junction curves force them.
    pub accept_forced: bool,
    /// Maximum distance of a vertex from F = 0, in voxels (geometric mean spacing).
    pub max_vertex_distance: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::Restricted,
            max_deviation: None,
            max_rounds: 40,
            improve_below: 0.9,
            relaxation_sweeps: 3,
            keeps_voxels: false,
            open_border: false,
            min_radius_ratio: Some(MIN_RADIUS_RATIO),
            accept_forced: false,
            max_vertex_distance: 1e-4,
        }
    }
}
