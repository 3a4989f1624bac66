//! The options of a reconstruction.

use crate::check::MIN_RADIUS_RATIO;
use isoparticles_volume::Image;

/// How particles are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// Delaunay triangulation restricted by the sign of F, refined until it has the topology of the isosurface
    Restricted,
    /// Tight Cocone (Dey and Goswami 2003): by the shape of the Voronoi cells, from points alone; with a distance field, from more points
    /// where these are too few
    TightCocone,
}

/// How to reconstruct; the defaults are those of the program.
#[derive(Clone, Debug)]
pub struct Options {
    /// How particles are joined.
    pub method: Method,
    /// Farthest that the centroid of a facet may lie from F = 0 before points are added there, mm; where there is none, a quarter of h or of a
    /// voxel, whichever is larger.
    pub max_deviation: Option<f64>,
    /// Most rounds of adding points at a stretch.
    pub max_rounds: usize,
    /// Radius ratio below which triangles are worked on by local moves; 0, with no sweeps, leaves the triangulation as it is.
    pub improve_below: f64,
    /// Sweeps over the whole mesh before that.
    pub relaxation_sweeps: usize,
    /// Whether voxel centres have sides that are kept (labels at scale 0).
    pub keeps_voxels: bool,
    /// Whether the surface ends where the volume does.
    pub open_border: bool,
    /// Smallest radius ratio that passes; `None`: any.
    pub min_radius_ratio: Option<f64>,
    /// Whether triangles below it pass where junction curves force them below it.
    pub accept_forced: bool,
    /// Farthest from F = 0 that a vertex may lie, voxels (geometric mean spacing).
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

impl Options {
    /// The samples of F whose nodes must stay on their side: those of labels, unless the surface ends where the volume does.
    pub(crate) fn guarded<'a>(&self, samples: &'a Image<f32>) -> Option<&'a Image<f32>> {
        (self.keeps_voxels && !self.open_border).then_some(samples)
    }
}
