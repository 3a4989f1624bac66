//! Which component of F = 0 a point on it belongs to: that of a crossing which a way on F = 0 leads to.
//!
//! The polygons are F = 0 but for an isotopy, so that in a cell with several sheets nearby F = 0 may bulge into cells whose polygons are another
//! sheet's. Where all polygons around are of one component, so is the point; elsewhere the way there is walked.

use super::cells::{Cell, Cells, around, moved};
use super::surface::Surface;
use crate::spline::CubicSpline;
use glam::DVec3;

/// A step of a walk, in edges of the cell that it starts in: F = 0 is a graph in cells that are certain, and turns by less than a right angle in
/// as much as a whole one.
const STEP: f64 = 0.25;

/// Least cosine between the normals at both ends of a step; one that turns more is halved,
const AGREEMENT: f64 = 0.8;

/// so many times at most.
const HALVINGS: usize = 6;

/// Steps of a walk: four times what the way through three cells takes.
const STEPS: usize = 48;

/// Nothing but what is nearly straight above a point is left to walk to where the tangential part of the way is less than this part.
const STEEP: f64 = 0.2;

/// Walks to crossings of each component near a point.
const WALKS: usize = 4;

/// How exactly points lie on F = 0, in edges of a cell.
const TOLERANCE: f64 = 1e-6;

impl Surface {
    /// The component that a point on F = 0 (grid frame, mm) belongs to, `normal` being grad F there; `None` where none of the crossings around it
    /// can be reached and they are of several components, or there are none.
    pub(super) fn component_at(&self, field: &CubicSpline, cells: &Cells, point: DVec3, normal: DVec3) -> Option<u32> {
        let (own, _) = cells.find(cells.finest_at(field, point))?;
        if let Some(only) = self.only_component_round(cells, own.within(0)) {
            return only;
        }
        let mut near: Vec<u32> = self.crossings_round(cells, own);
        if near.is_empty() {
            near = self.crossings_round(cells, own.within(0));
        }
        let spacing = field.geometry().spacing;
        let distance = |n: u32| (self.positions[n as usize] / spacing).distance_squared(point / spacing);
        let mut near: Vec<(f64, u32)> = near.into_iter().map(|n| (distance(n), n)).collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut tried: Vec<(u32, usize)> = Vec::new();
        for (_, crossing) in near {
            let component = self.component_of[crossing as usize];
            let at = tried.iter().position(|(c, _)| *c == component).unwrap_or_else(|| {
                tried.push((component, 0));
                tried.len() - 1
            });
            if tried[at].1 < WALKS {
                tried[at].1 += 1;
                if is_joined(field, cells, point, normal, self.positions[crossing as usize]) {
                    return Some(component);
                }
            }
        }
        match tried[..] {
            [(only, _)] => Some(only),
            _ => None,
        }
    }

    /// The one component, if any, that has all crossings in a voxel cell and those around it; `None` where there are several.
    fn only_component_round(&self, cells: &Cells, voxel: Cell) -> Option<Option<u32>> {
        let mut only = None;
        for (j, k) in (-1..=1).flat_map(|k| (-1..=1).map(move |j| (j, k))) {
            let row = [-1, 0, 1].into_iter().filter_map(|i| moved(voxel, [i, j, k]));
            for component in self.components_of_voxels(cells, row) {
                if *only.get_or_insert(component?) != component? {
                    return None;
                }
            }
        }
        Some(only)
    }

    /// The crossings of the polygons in a cell and in those of its size around it, ascending.
    pub(super) fn crossings_round(&self, cells: &Cells, cell: Cell) -> Vec<u32> {
        let mut near = Vec::new();
        around().filter_map(|away| moved(cell, away)).for_each(|cell| cells.crossed_in(cell, &mut near));
        let mut crossings: Vec<u32> =
            near.into_iter().flat_map(|(cell, _)| self.crossings_in(cells, cell)).copied().collect();
        crossings.sort_unstable();
        crossings.dedup();
        crossings
    }
}

/// Whether a way on F = 0, as straight as that goes, leads from a point on it to a crossing.
fn is_joined(field: &CubicSpline, cells: &Cells, point: DVec3, normal: DVec3, crossing: DVec3) -> bool {
    let spacing = field.geometry().spacing.min_element();
    let edge_at = |p: DVec3| {
        let cell = cells.find(cells.finest_at(field, p)).map_or(0, |(cell, _)| cell.level);
        spacing / f64::from(1u32 << cell)
    };
    // the crossing is where it is to first order
    let edge = edge_at(crossing);
    let Some((to, end_normal)) = field.project_with_gradient(crossing, edge, TOLERANCE * edge) else { return false };
    let end_normal = end_normal.normalize_or_zero();
    let (mut at, mut normal) = (point, normal.normalize_or_zero());
    for _ in 0..STEPS {
        let way = to - at;
        let along = way - normal * way.dot(normal);
        let edge = edge_at(at);
        let is_next =
            way.length() < STEP * edge && normal.dot(end_normal) > AGREEMENT && along.length() > 0.5 * way.length();
        if is_next || way.length() < TOLERANCE.sqrt() * edge {
            return true;
        }
        if along.length() < STEEP * way.length() {
            return false;
        }
        let mut step = along.clamp_length_max(STEP * edge);
        let mut next = None;
        for _ in 0..HALVINGS {
            next = field
                .project_with_gradient(at + step, 0.5 * step.length(), TOLERANCE * edge)
                .map(|(p, gradient)| (p, gradient.normalize_or_zero()))
                .filter(|(_, turned)| turned.dot(normal) > AGREEMENT);
            if next.is_some() {
                break;
            }
            step *= 0.5;
        }
        let Some((p, turned)) = next else { return false };
        (at, normal) = (p, turned);
    }
    false
}
