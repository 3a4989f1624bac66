//! The topology of F = 0, computed from the spline alone: its components, the Euler characteristic
//! of each, and the places where these are undecided. It does not depend on any mesh; meshes are
//! checked against it.
//!
//! Each voxel cell is subdivided until F has one sign throughout a cell, or the gradients in it
//! differ by less than a right angle. Bounds for the whole cell (Bernstein form) prove either.
//! Between neighbours of similar size, the signs of F at the corners then give the surface up to
//! isotopy (Plantinga and Vegter, *Isotopic approximation of implicit curves and surfaces*, 2004).
//! Components and Euler characteristics are counted on the polygons of that surface.
//!
//! Three kinds of places are *undecided*:
//! - Cells that are uncertain at the finest level, near critical points of F with a value close to
//!   zero. The counts follow the signs at their corners.
//! - Critical points whose neck, gap or speck is finer than [`RESOLUTION`]. F is known there, but a
//!   mesh of ordinary resolution need not reproduce it.
//! - Components as fine as that whose critical point does not show it, because F is flat there.
//!
//! [`FieldTopology::groups`] gives all topologies that the undecided places allow.

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

/// Minimum radius, in voxels (geometric mean spacing), of necks, gaps and specks whose topology is
/// decided. The radius is the distance to F = 0 by the second-order expansion at the critical
/// point. Finer features say nothing about the object, and resolving them would take very short
/// mesh edges.
pub const RESOLUTION: f64 = 0.1;

/// A component of F = 0. Its number is its index in the list, which is ordered by the first
/// crossing of each component in the order of the samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Component {
    /// Euler characteristic: 2 for a sphere, 0 for a torus. If the surface ends at the border of
    /// the volume, that of the part within.
    pub euler: i64,
    /// A position next to it, grid frame, mm.
    pub place: DVec3,
    /// Bounding box, grid frame, mm; to first order in the edge of the cells.
    pub bounds: Bounds,
    /// Area, mm^2; to first order in the edge of the cells.
    pub area: f64,
    /// Enclosed volume, mm^3, negative for a cavity; to first order in the edge of the cells.
    pub volume: f64,
}

/// The components of F = 0 in the volume, without the critical points. For stages that only count
/// and distinguish components: cheaper than [`FieldTopology`], with the same components.
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

/// The counts of a [`FieldTopology`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TopologySummary {
    /// Number of components, with undecided cells resolved by the signs of F at their corners.
    pub components: usize,
    /// Minimum and maximum number of components.
    pub components_between: [usize; 2],
    /// Euler characteristic, with undecided cells resolved in the same way.
    pub euler: i64,
    /// Minimum and maximum Euler characteristic.
    pub euler_between: [i64; 2],
    /// The undecided places.
    pub undecided: Vec<Undecided>,
}

impl FieldComponents {
    /// The components of the spline through the samples of a volume.
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

    /// The components.
    pub fn all(&self) -> &[Component] {
        &self.surface.components
    }

    /// Triangles next to a component, to first order in the edge of the cells, facing outward;
    /// denser where F = 0 is bent.
    pub fn mesh(&self, component: u32) -> TriangleMesh {
        self.surface.mesh(component)
    }

    /// Positions next to F = 0 (grid frame, mm) all over a component, a few per cell; denser where
    /// F = 0 is bent.
    pub fn samples(&self, component: u32) -> Vec<DVec3> {
        let own = self.surface.component_of.iter().zip(&self.surface.positions).filter(|(c, _)| **c == component);
        own.map(|(_, &p)| p).collect()
    }

    /// The component of a point on F = 0 (grid frame, mm), given grad F there as `normal`. `None`
    /// if there is no component around it, or several and no path on F = 0 leads to one of them.
    pub fn at(&self, field: &CubicSpline, point: DVec3, normal: DVec3) -> Option<u32> {
        self.surface.component_at(field, &self.cells, point, normal)
    }
}

impl FieldTopology {
    /// The topology of the spline through the samples of a volume.
    ///
    /// # Errors
    /// If the monitor interrupts the work.
    pub fn watched(field: &CubicSpline, monitor: &dyn Monitor) -> Result<Self, Interrupted> {
        let watch = Watch::new(monitor, 3 * field.geometry().size[2]);
        // assembling the surface uses a single thread
        let (components, critical_points) =
            rayon::join(|| FieldComponents::watched(field, &watch), || critical::all(field, &watch));
        let (components, critical_points) = (components?, critical_points?);
        let FieldComponents { cells, surface } = &components;
        let undecided = undecided::places(field, cells, surface, &critical_points);
        let groups = Groups::new(&surface.components, &undecided);
        Ok(Self { components, undecided, groups, critical_points })
    }

    /// As [`Self::watched`], without a monitor.
    ///
    /// # Panics
    /// Never: work without a monitor is not interrupted.
    pub fn new(field: &CubicSpline) -> Self {
        Self::watched(field, &Silent).expect("what nobody watches is not interrupted")
    }

    /// The components.
    pub fn components(&self) -> &[Component] {
        self.components.all()
    }

    /// The topologies that the components may have: at each undecided place, a mesh may have either
    /// of two.
    pub fn groups(&self) -> &Groups {
        &self.groups
    }

    /// The places where the topology is undecided.
    pub fn undecided(&self) -> &[Undecided] {
        &self.undecided
    }

    /// The critical points of F within a few voxels of F = 0, in the order of their positions.
    pub fn critical_points(&self) -> &[CriticalPoint] {
        &self.critical_points
    }

    /// The counts.
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

    /// Positions next to F = 0 all over a component: [`FieldComponents::samples`].
    pub fn samples(&self, component: u32) -> Vec<DVec3> {
        self.components.samples(component)
    }

    /// The component of a point on F = 0: [`FieldComponents::at`].
    pub fn component_at(&self, field: &CubicSpline, point: DVec3, normal: DVec3) -> Option<u32> {
        self.components.at(field, point, normal)
    }
}
