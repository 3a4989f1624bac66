//! The topology of F = 0, from the spline alone: its components, the Euler characteristic of each, and the places where neither can be
//! told. No mesh has a say in it, and once computed it does not change; meshes are judged by it.
//!
//! Each voxel cell is halved until F has one sign all over it, or the gradients in it differ by less than a right angle, by bounds that
//! hold for the whole cell (Bernstein form). Between neighbours of about one size the signs of F at the corners then tell the
//! surface but for an isotopy (Plantinga and Vegter, *Isotopic approximation of implicit curves and surfaces*, 2004). Components and
//! Euler characteristics are counted on the polygons of that surface. Cells that stay uncertain at the finest level, which is near
//! critical points of F with a value next to zero, and whatever is finer than [`RESOLUTION`] are *undecided*: the numbers follow the signs at their corners, and with each place
//! goes how far they may be off.

mod bernstein;
mod cells;
mod certain;
mod critical;
mod polygons;
mod surface;
#[cfg(test)]
mod tests;
mod undecided;

use crate::spatial::Bounds;
use crate::spline::CubicSpline;
use cells::{Cells, around, moved};
pub use critical::{CriticalPoint, critical_points};
use glam::DVec3;
use polygons::Surface;
use serde::Serialize;
use std::ops::RangeInclusive;
pub use undecided::Undecided;

/// Radius, in voxels (geometric mean spacing), of the finest necks, gaps and specks whose topology is told, where they meet F = 0 as the
/// second-order expansion at their critical point has it: finer ones say nothing of the object, and edges that short would cost a mesh
/// more than they tell.
pub const RESOLUTION: f64 = 0.1;

/// A component of F = 0. Its number is its place in the list, which goes by the lowest place of each component, in the order of the
/// samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Component {
    /// Number of the group that it belongs to.
    pub group: u32,
    /// Whether it is there whatever becomes of the undecided places: not all of it lies in one.
    pub is_certain: bool,
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

/// Components that undecided places may join or part, or one that none touches. Its number is its place in the list.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Its components, ascending; none where all that it may be is a speck.
    pub components: Vec<u32>,
    /// How many components it may be.
    pub component_count: RangeInclusive<usize>,
    /// Euler characteristics that it may have.
    pub euler: RangeInclusive<i64>,
    /// The undecided places, ascending.
    pub undecided: Vec<u32>,
}

/// The topology of F = 0 in the volume.
pub struct FieldTopology {
    cells: Cells,
    surface: Surface,
    groups: Vec<Group>,
    undecided: Vec<Undecided>,
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

impl FieldTopology {
    /// Of the spline through the samples of a volume.
    pub fn new(field: &CubicSpline) -> Self {
        let cells = Cells::new(field);
        let mut surface = Surface::new(field, &cells);
        let critical_points = critical_points(field, 0.0);
        let undecided = undecided::places(field, &cells, &surface, &critical_points);
        let (groups, undecided) = undecided::groups(&mut surface.components, undecided);
        Self { cells, surface, groups, undecided, critical_points }
    }

    /// The components.
    pub fn components(&self) -> &[Component] {
        &self.surface.components
    }

    /// The groups of components.
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// The group of a component; `None` of a number that is no component's.
    pub fn group_of(&self, component: u32) -> Option<u32> {
        self.components().get(component as usize).map(|c| c.group)
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
        let count =
            |end: fn(&RangeInclusive<usize>) -> usize| self.groups.iter().map(|g| end(&g.component_count)).sum();
        let euler = |end: fn(&RangeInclusive<i64>) -> i64| self.groups.iter().map(|g| end(&g.euler)).sum();
        TopologySummary {
            components: self.components().len(),
            components_between: [count(|range| *range.start()), count(|range| *range.end())],
            euler: self.components().iter().map(|c| c.euler).sum(),
            euler_between: [euler(|range| *range.start()), euler(|range| *range.end())],
            undecided: self.undecided.clone(),
        }
    }

    /// Places next to F = 0 (grid frame, mm) all over a component, a few a cell; denser where F = 0 is bent.
    pub fn samples(&self, component: u32) -> Vec<DVec3> {
        let own = self.surface.component_of.iter().zip(&self.surface.positions).filter(|(c, _)| **c == component);
        own.map(|(_, &p)| p).collect()
    }

    /// The component that a point on F = 0 (grid frame, mm) belongs to, `normal` being grad F there; `None` where there is none in its voxel
    /// cell or those around it.
    pub fn component_at(&self, field: &CubicSpline, point: DVec3, normal: DVec3) -> Option<u32> {
        let spacing = field.geometry().spacing;
        let finest = self.cells.finest_at(field, point);
        let (own, _) = self.cells.find(finest)?;
        let crossings = self.surface.crossings_in(&self.cells, own);
        let component = |&crossing: &u32| self.surface.component_of[crossing as usize];
        let first = crossings.first().map(component);
        if first.is_some() && crossings.iter().all(|crossing| Some(component(crossing)) == first) {
            return first;
        }
        // several, or a bulge of the surface that reaches no corner of the cell: the nearest that faces the same way
        let mut best: Option<(bool, f64, u32)> = None;
        let mut compare = |crossing: &u32| {
            let place = self.surface.positions[*crossing as usize];
            let distance = (place / spacing).distance_squared(point / spacing);
            if best.is_none_or(|(turned, far, _)| !turned && distance >= far) {
                return;
            }
            let turned = field.value_gradient(place).1.dot(normal) <= 0.0;
            if best.is_none_or(|(worse, far, _)| (turned, distance) < (worse, far)) {
                best = Some((turned, distance, component(crossing)));
            }
        };
        if crossings.is_empty() {
            let mut near = Vec::new();
            around()
                .filter_map(|away| moved(own.within(0), away))
                .for_each(|voxel| self.cells.crossed_in(voxel, &mut near));
            near.iter().for_each(|(cell, _)| {
                self.surface.crossings_in(&self.cells, *cell).iter().for_each(&mut compare);
            });
        } else {
            crossings.iter().for_each(compare);
        }
        best.map(|(_, _, component)| component)
    }
}
