//! Computes the topology of F = 0 from the spline alone: its components, their Euler
//! characteristics, and the locations where these are undecided. The result does not depend on any
//! mesh; meshes are checked against it.
//!
//! Each voxel cell is subdivided until F has one sign throughout the cell, or any two gradients in
//! the cell form an acute angle. Bounds for the whole cell (Bernstein form) prove both conditions.
//! If the sizes of adjacent cells differ by at most a factor of two, the signs of F at the cell
//! corners determine the surface up to isotopy (Plantinga and Vegter, *Isotopic approximation of
//! implicit curves and surfaces*, 2004). Components and Euler characteristics are computed from the
//! polygons of that surface.
//!
//! The topology is *undecided* at three kinds of locations:
//! - Cells that are uncertain at the finest level. They lie near critical points at which F is
//!   close to zero. In these cells, the signs at the corners determine the counts.
//! - Critical points whose neck, gap or speck is finer than [`RESOLUTION`]. The topology of F is
//!   known there, but a mesh of ordinary resolution need not reproduce it.
//! - Other components finer than [`RESOLUTION`], for example where F is nearly flat and the
//!   second-order expansion overestimates the radius.
//!
//! [`FieldTopology::groups`] returns all topologies that the undecided locations allow.

mod bernstein;
mod cells;
mod critical;
mod locate;
mod polygons;
mod signs;
mod surface;
#[cfg(test)]
mod tests;
mod undecided;
mod watch;

use crate::spline::CubicSpline;
use cells::Cells;
pub use critical::{CriticalPoint, critical_points};
use glam::DVec3;
use isoparticles_file::monitor::{Interrupted, Monitor, Silent};
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::spatial::Bounds;
use serde::Serialize;
pub(crate) use signs::Signs;
use surface::Surface;
pub use undecided::{Group, Groups, Undecided, UndecidedKind};
use watch::Watch;

/// Minimum radius, in voxels (geometric mean spacing), of necks, gaps and specks whose topology a
/// mesh must reproduce. The radius is the distance from the critical point to F = 0, according to
/// the second-order expansion of F. A neck of this radius has a circumference of 0.63 voxel, so
/// each of six edges around it is a tenth of a voxel long. Samples one voxel apart do not determine
/// smaller features.
pub const RESOLUTION: f64 = 0.1;

/// A component of F = 0. Its number is its index in the list of components. The list is ordered by
/// the first crossing of each component with a cell edge, x fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Component {
    /// Euler characteristic: 2 for a sphere, 0 for a torus. If the surface ends at the border of
    /// the volume, only the part within the volume counts.
    pub euler: i64,
    /// A position near the component, in the grid frame, mm.
    pub place: DVec3,
    /// Bounding box in the grid frame, mm, accurate to first order in the cell size.
    pub bounds: Bounds,
    /// Area in mm^2, accurate to first order in the cell size.
    pub area: f64,
    /// Enclosed volume in mm^3, negative for a cavity, accurate to first order in the cell size.
    pub volume: f64,
}

/// The components of F = 0 in the volume. Stages that only count and distinguish components use
/// this type. It has the same components as [`FieldTopology`], but is cheaper, because it contains
/// no critical points.
pub struct FieldComponents {
    cells: Cells,
    surface: Surface,
}

/// The topology of F = 0 in the volume.
pub struct FieldTopology {
    components: FieldComponents,
    undecided: Vec<Undecided>,
    groups: Groups,
    critical_points: Vec<CriticalPoint>,
}

/// Summary counts of a [`FieldTopology`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TopologySummary {
    /// Number of components. In undecided cells, the signs of F at the cell corners decide.
    pub components: usize,
    /// Minimum and maximum possible number of components.
    pub components_between: [usize; 2],
    /// Sum of the Euler characteristics of the components, with the same rule for undecided cells.
    pub euler: i64,
    /// Minimum and maximum possible sum of the Euler characteristics.
    pub euler_between: [i64; 2],
    /// The undecided locations.
    pub undecided: Vec<Undecided>,
}

impl FieldComponents {
    /// Computes the components of F = 0, where F is the spline through the samples of a volume.
    ///
    /// # Errors
    /// If the monitor interrupts the work.
    pub fn new(field: &CubicSpline, monitor: &dyn Monitor) -> Result<Self, Interrupted> {
        Self::watched(field, &Watch::new(monitor, 2 * field.geometry().size[2]))
    }

    fn watched(field: &CubicSpline, watch: &Watch<'_>) -> Result<Self, Interrupted> {
        let mut cells = Cells::new(field, watch)?;
        let surface = Surface::new(field, &mut cells, watch)?;
        Ok(Self { cells, surface })
    }

    /// Returns the components.
    pub fn all(&self) -> &[Component] {
        &self.surface.components
    }

    /// Returns triangles that approximate a component to first order in the cell size. They face
    /// outward, and they are denser where F = 0 is curved.
    pub fn mesh(&self, component: u32) -> TriangleMesh {
        self.surface.mesh(component)
    }

    /// Returns positions near F = 0 (grid frame, mm) that cover a component, a few per cell. The
    /// positions are denser where F = 0 is curved.
    pub fn samples(&self, component: u32) -> Vec<DVec3> {
        let own = self.surface.component_of.iter().zip(&self.surface.positions).filter(|(c, _)| **c == component);
        own.map(|(_, &p)| p).collect()
    }

    /// Returns the component of a point on F = 0 (grid frame, mm). `normal` is grad F at the point.
    /// Returns `None` if no component is near the point, or if several are near and no path on
    /// F = 0 leads to one of them.
    pub fn at(&self, field: &CubicSpline, point: DVec3, normal: DVec3) -> Option<u32> {
        self.surface.component_at(field, &self.cells, point, normal)
    }
}

impl FieldTopology {
    /// Computes the topology of the spline through the samples of a volume.
    ///
    /// # Errors
    /// If the monitor interrupts the work.
    pub fn watched(field: &CubicSpline, monitor: &dyn Monitor) -> Result<Self, Interrupted> {
        let watch = Watch::new(monitor, 3 * field.geometry().size[2]);
        // these run concurrently, because the assembly of the surface uses a single thread
        let (components, critical_points) =
            rayon::join(|| FieldComponents::watched(field, &watch), || critical::all(field, &watch));
        let (components, critical_points) = (components?, critical_points?);
        let FieldComponents { cells, surface } = &components;
        let undecided = undecided::places(field, cells, surface, &critical_points);
        let groups = Groups::new(&surface.components, &undecided);
        Ok(Self { components, undecided, groups, critical_points })
    }

    /// Computes the topology like [`Self::watched`], but without a monitor.
    ///
    /// # Panics
    /// Never: without a monitor, nothing interrupts the computation.
    pub fn new(field: &CubicSpline) -> Self {
        Self::watched(field, &Silent).expect("what nobody watches is not interrupted")
    }

    /// Returns the components.
    pub fn components(&self) -> &[Component] {
        self.components.all()
    }

    /// Returns the groups of components, with the topologies that the undecided locations allow for
    /// them.
    pub fn groups(&self) -> &Groups {
        &self.groups
    }

    /// Returns the locations where the topology is undecided.
    pub fn undecided(&self) -> &[Undecided] {
        &self.undecided
    }

    /// Returns the critical points of F within a few voxels of F = 0, ordered by position.
    pub fn critical_points(&self) -> &[CriticalPoint] {
        &self.critical_points
    }

    /// Returns the summary counts.
    pub fn summary(&self) -> TopologySummary {
        let groups = || self.groups.all().iter();
        TopologySummary {
            components: self.components().len(),
            components_between: [
                groups().map(|g| g.component_count.start()).sum(),
                groups().map(|g| g.component_count.end()).sum(),
            ],
            euler: self.components().iter().map(|c| c.euler).sum(),
            euler_between: [groups().map(|g| g.euler.start()).sum(), groups().map(|g| g.euler.end()).sum()],
            undecided: self.undecided.clone(),
        }
    }

    /// Returns positions near F = 0 that cover a component. See [`FieldComponents::samples`].
    pub fn samples(&self, component: u32) -> Vec<DVec3> {
        self.components.samples(component)
    }

    /// Returns the component of a point on F = 0. See [`FieldComponents::at`].
    pub fn component_at(&self, field: &CubicSpline, point: DVec3, normal: DVec3) -> Option<u32> {
        self.components.at(field, point, normal)
    }
}
