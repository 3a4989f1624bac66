//! Phantom scenes. A scene is an implicit function in the grid frame, with the exact properties of
//! its surface (area, volume, genus and others).

use crate::{shapes, torso};
use glam::DVec3;
use isoparticles_volume::Geometry;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// An implicit function that is negative inside. It is a signed distance if
/// [`Truth::exact_distance`] is set.
pub trait Scene: Sync {
    /// Returns the value at a position (mm) in the grid frame.
    fn value(&self, position: DVec3) -> f64;

    /// Returns the label of a voxel centred at `position`: 0 outside and 1 inside, unless the scene
    /// has several parts.
    fn label(&self, position: DVec3) -> u8 {
        u8::from(self.value(position) < 0.0)
    }

    /// Returns the value of the edge profile at a position, for an edge of the given width (mm): 0
    /// far outside, 0.5 on the surface, 1 deep inside.
    fn profile(&self, position: DVec3, edge_width: f64) -> f64 {
        edge_profile(self.value(position), edge_width)
    }

    /// Returns the scalar values outside (profile 0) and inside (profile 1), roughly in Hounsfield
    /// units.
    fn intensities(&self) -> (f64, f64) {
        (-100.0, 300.0)
    }

    /// Returns the exact properties of the surface.
    fn truth(&self) -> Truth;
}

/// Returns the smooth edge profile of a scanner image: nearly 1 deep inside, 0.5 on the surface,
/// and nearly 0 far outside.
pub fn edge_profile(signed_distance: f64, edge_width: f64) -> f64 {
    0.5 * (1.0 - (signed_distance / edge_width).tanh())
}

/// Exact properties of a scene's surface. A property is `None` if it is known neither in closed
/// form nor by quadrature.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Name of the shape.
    pub shape: String,
    /// How the properties are obtained, in one sentence.
    pub method: String,
    /// Iso value of the surface in the scalar volume.
    pub iso: Option<f64>,
    /// Side of the iso value on which the object lies: `above` or `below`.
    pub inside: Option<String>,
    /// Labels that form the object in a label map.
    pub labels: Vec<u8>,
    /// Whether the implicit function is the exact signed distance.
    pub exact_distance: bool,
    /// Surface area, mm^2.
    pub area: Option<f64>,
    /// Enclosed volume, mm^3.
    pub volume: Option<f64>,
    /// Number of closed components of the surface.
    pub components: Option<usize>,
    /// Sum of the genera of all components.
    pub genus: Option<usize>,
    /// Minimum local feature size on the surface, mm.
    pub local_feature_size_min: Option<f64>,
    /// Maximum local feature size on the surface, mm.
    pub local_feature_size_max: Option<f64>,
    /// Centre of the object in mm in the grid frame.
    pub centre_grid: [f64; 3],
    /// Centre of the object in mm in world coordinates (LPS if the file specifies a space).
    pub centre_world: [f64; 3],
    /// Named dimensions of the shape, mm.
    pub dimensions: BTreeMap<String, f64>,
}

/// Shapes of the `phantom` program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Shape {
    /// A ball.
    Ball,
    /// An ellipsoid with three different axes.
    Ellipsoid,
    /// A torus; its local feature size is the tube radius everywhere.
    Torus,
    /// A torus with a wavy tube.
    BumpyTorus,
    /// A hollow ball with a thin wall (`--thickness`).
    ThinShell,
    /// Two balls a small distance apart (`--gap`).
    TwoBalls,
    /// A gyroid that fills the volume and is cut by all six borders.
    Gyroid,
    /// A cylinder along z, cut by the lower and upper borders.
    Cylinder,
    /// A plate one voxel thick.
    Plate,
    /// A rod one voxel wide.
    Rod,
    /// Two boxes that touch along one voxel edge (non-manifold as a set of voxels).
    TouchingBoxes,
    /// A chest with heart-like, lung-like and ribcage-like parts.
    Torso,
}

/// Adjustable properties of shapes.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Wall thickness of the thin shell, mm.
    pub thickness: f64,
    /// Gap between the two balls, mm.
    pub gap: f64,
    /// Part of the torso.
    pub part: torso::Part,
}

impl Options {
    /// Returns the defaults: a wall thickness of 2.5 mean voxel spacings, a gap of 3 mean voxel
    /// spacings, and the whole torso.
    pub fn for_grid(grid: &Geometry) -> Self {
        Self { thickness: 2.5 * grid.mean_spacing(), gap: 3.0 * grid.mean_spacing(), part: torso::Part::All }
    }
}

/// Returns the scene of a shape, sized to fill the grid except for a margin.
pub fn build(shape: Shape, grid: &Geometry, options: &Options) -> Box<dyn Scene> {
    match shape {
        Shape::Ball => Box::new(shapes::round::Ball::filling(grid)),
        Shape::Ellipsoid => Box::new(shapes::round::Ellipsoid::filling(grid)),
        Shape::Torus => Box::new(shapes::torus::Torus::filling(grid)),
        Shape::BumpyTorus => Box::new(shapes::torus::BumpyTorus::filling(grid)),
        Shape::ThinShell => Box::new(shapes::round::ThinShell::filling(grid, options.thickness)),
        Shape::TwoBalls => Box::new(shapes::round::TwoBalls::filling(grid, options.gap)),
        Shape::Gyroid => Box::new(shapes::cut::Gyroid::filling(grid)),
        Shape::Cylinder => Box::new(shapes::cut::Cylinder::filling(grid)),
        Shape::Plate => Box::new(shapes::boxes::Boxes::plate(grid)),
        Shape::Rod => Box::new(shapes::boxes::Boxes::rod(grid)),
        Shape::TouchingBoxes => Box::new(shapes::boxes::Boxes::touching(grid)),
        Shape::Torso => Box::new(torso::Torso::filling(grid, options.part)),
    }
}

/// Returns the shortest side, in mm, of the bounding box of the voxel centres. The size of most
/// shapes is proportional to this length.
pub fn shortest_extent(grid: &Geometry) -> f64 {
    grid.upper_corner().min_element()
}

/// Returns a point (mm, grid frame) near the centre of the grid. It is a fraction of a voxel away
/// from all voxel centres, corners and other symmetry points of the voxel grid.
pub fn off_lattice_centre(grid: &Geometry) -> DVec3 {
    0.5 * grid.upper_corner() + grid.index_to_grid(DVec3::new(0.137, 0.291, -0.173))
}
