//! The topology of F = 0, from the spline alone: its components, the Euler characteristic of each, and the places where neither can be
//! told. No mesh has a say in it, and once computed it does not change; meshes are judged by it.
//!
//! Each voxel cell is halved until F has one sign all over it, or the gradients in it differ by less than a right angle, by bounds that
//! hold for the whole cell (Bernstein form). Between neighbours of about one size the signs of F at the corners then tell the
//! surface but for an isotopy (Plantinga and Vegter, *Isotopic approximation of implicit curves and surfaces*, 2004). Components and
//! Euler characteristics are counted on the polygons of that surface.
//!
//! Three kinds of places are *undecided*. Cells that stay uncertain at the finest level, which is near critical points of F with a value next to
//! zero: the numbers follow the signs at their corners. And critical points whose neck, gap or speck is finer than [`RESOLUTION`]: what F has there is
//! known, but not asked of a mesh: which side of the surface such a point lies on is no topology at a mesh's resolution.
//! And components as fine whose critical point does not tell so, because F is flat there.
//! [`FieldTopology::groups`] tells what the whole may be, whatever it is at each of them.

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

/// Radius, in voxels (geometric mean spacing), of the finest necks, gaps and specks whose topology is told, where they meet F = 0 as the
/// second-order expansion at their critical point has it: finer ones say nothing of the object, and edges that short would cost a mesh
/// more than they tell.
pub const RESOLUTION: f64 = 0.1;

/// A component of F = 0. Its number is its place in the list, which goes by the lowest place of each component, in the order of the
/// samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Component {
    /// Euler characteristic: 2 for a sphere, 0 for a torus; where the surface ends at the border of the volume, of the part within.
    pub euler: i64,
    /// A place next to it, grid frame, mm.
    pub place: DVec3,
    /// A box round it, grid frame, mm; to first order in the edge of the cells.
    pub bounds: Bounds,
    /// Area, mm^2; to first order likewise.
    pub area: f64,
    /// Volume enclosed, mm^3, negative for a cavity; to first order likewise.
    pub volume: f64,
}

/// The components of F = 0 in the volume, without the critical points: what stages need that count components and tell them apart, at less
/// cost than [`FieldTopology`], whose components are the same.
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

/// The same in numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TopologySummary {
    /// Components, undecided places taken as the signs of F at their corners have them.
    pub components: usize,
    /// How many components there may be at least and at most.
    pub components_between: [usize; 2],
    /// Euler characteristic, undecided places taken likewise.
    pub euler: i64,
    /// What it may be at least and at most.
    pub euler_between: [i64; 2],
    /// The undecided places.
    pub undecided: Vec<Undecided>,
}

impl FieldComponents {
    /// Of the spline through the samples of a volume.
    ///
    /// # Errors
    /// When the monitor says so.
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

    /// Triangles next to a component, to first order in the edge of the cells, outward; denser where F = 0 is bent.
    pub fn mesh(&self, component: u32) -> TriangleMesh {
        self.surface.mesh(component)
    }

    /// Places next to F = 0 (grid frame, mm) all over a component, a few a cell; denser where F = 0 is bent.
    pub fn samples(&self, component: u32) -> Vec<DVec3> {
        let own = self.surface.component_of.iter().zip(&self.surface.positions).filter(|(c, _)| **c == component);
        own.map(|(_, &p)| p).collect()
    }

    /// The component that a point on F = 0 (grid frame, mm) belongs to, `normal` being grad F there; `None` where there is none around it, or several
    /// and no way on F = 0 to one of them.
    pub fn at(&self, field: &CubicSpline, point: DVec3, normal: DVec3) -> Option<u32> {
        self.surface.component_at(field, &self.cells, point, normal)
    }
}

impl FieldTopology {
    /// Of the spline through the samples of a volume.
    ///
    /// # Errors
    /// When the monitor says so.
    pub fn watched(field: &CubicSpline, monitor: &dyn Monitor) -> Result<Self, Interrupted> {
        let watch = Watch::new(monitor, 3 * field.geometry().size[2]);
        // putting the surface together keeps one thread busy only
        let (components, critical_points) =
            rayon::join(|| FieldComponents::watched(field, &watch), || critical::all(field, &watch));
        let (components, critical_points) = (components?, critical_points?);
        let FieldComponents { cells, surface } = &components;
        let undecided = undecided::places(field, cells, surface, &critical_points);
        let groups = Groups::new(&surface.components, &undecided);
        Ok(Self { components, undecided, groups, critical_points })
    }

    /// The same, watched by nobody.
    ///
    /// # Panics
    /// Never: what nobody watches is not interrupted.
    pub fn new(field: &CubicSpline) -> Self {
        Self::watched(field, &Silent).expect("what nobody watches is not interrupted")
    }

    /// The components.
    pub fn components(&self) -> &[Component] {
        self.components.all()
    }

    /// What the components may be up to the undecided places: at each of them a mesh may have either of two topologies.
    pub fn groups(&self) -> &Groups {
        &self.groups
    }

    /// The places where the topology cannot be told.
    pub fn undecided(&self) -> &[Undecided] {
        &self.undecided
    }

    /// The critical points of F within a few voxels of F = 0, in the order of their places.
    pub fn critical_points(&self) -> &[CriticalPoint] {
        &self.critical_points
    }

    /// All in numbers.
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

    /// Places next to F = 0 all over a component: [`FieldComponents::samples`].
    pub fn samples(&self, component: u32) -> Vec<DVec3> {
        self.components.samples(component)
    }

    /// The component that a point on F = 0 belongs to: [`FieldComponents::at`].
    pub fn component_at(&self, field: &CubicSpline, point: DVec3, normal: DVec3) -> Option<u32> {
        self.components.at(field, point, normal)
    }
}
