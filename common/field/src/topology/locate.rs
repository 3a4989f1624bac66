//! Finds the component of F = 0 that contains a given point on F = 0. If necessary, walks on F = 0
//! from the point to a crossing, a point of known component at which F = 0 crosses a cell edge.
//!
//! The polygons represent F = 0 only up to isotopy. Where several parts of the surface are close
//! together, F = 0 may bulge into cells whose polygons belong to another part. If all polygons
//! around a point belong to one component, the point also belongs to it. Otherwise a walk on F = 0
//! decides.

use super::cells::{Cell, Cells, around, moved};
use super::surface::Surface;
use crate::spline::CubicSpline;
use glam::DVec3;

// Walks are rarely needed and short. In a test with 43,565 points on two fields, no point changes
// its component if any constant below except the tolerance is halved or doubled (or if
// `LEAST_COSINE` is 0.6 or 0.9). No successful walk takes more than 4 steps, and no step is
// shortened. The points are every seventh crossing (`FieldTopology::samples`), displaced by up to
// half a voxel along each axis and projected onto the surface. The two fields are `trabecular_bone`
// (see `FLATNESS_MARGIN` in `critical.rs`) and a noisy region of `tooth_ct` (iso value 404, nodes 5
// to 22 along x and y, 20 to 37 along z).

/// Maximum length of a step of a walk, in edge lengths of the cell in which the step starts. In a
/// cell where F = 0 is a graph, the normal of F = 0 turns by less than 90 degrees. Over a quarter
/// of the edge length, at constant curvature, the normal turns by less than 23 degrees;
/// [`LEAST_COSINE`] allows 37 degrees.
const LONGEST_STEP: f64 = 0.25;

/// Minimum cosine of the angle between the normals at both ends of a step (37 degrees). The chord
/// of such a step deviates from F = 0 by at most a twelfth of its length. A step with a smaller
/// cosine is halved.
const LEAST_COSINE: f64 = 0.8;

/// Number of attempts to take a step. Each further attempt halves the step. The shortest step is
/// 2^-5 / 4 = 1/128 of an edge; in a voxel cell, this is the edge length of the finest cells.
const STEP_ATTEMPTS: usize = 6;

/// Maximum number of steps of a walk: four times the 12 steps of a straight path through three
/// cells. A longer walk fails.
const MOST_STEPS: usize = 48;

/// Tolerance of projections onto F = 0, in edge lengths of the cell at the position. A walk also
/// succeeds if it comes within the square root of this tolerance (0.001 edge lengths) of its
/// target.
const TOLERANCE: f64 = 1e-6;

impl Surface {
    /// Returns the component of a point on F = 0 (grid frame, mm). `normal` is grad F at the point.
    /// Returns `None` if there are no crossings near the point, or if they belong to several
    /// components and no walk reaches a crossing.
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
        let joined = near.iter().find(|&&(_, n)| is_joined(field, cells, point, normal, self.positions[n as usize]));
        if let Some(&(_, crossing)) = joined {
            return Some(self.component_of[crossing as usize]);
        }
        let mut components = near.iter().map(|&(_, crossing)| self.component_of[crossing as usize]);
        let first = components.next()?;
        components.all(|other| other == first).then_some(first)
    }

    /// Returns the component of all crossings in a voxel cell and the 26 cells around it. Returns
    /// `Some(None)` if there are no crossings, and `None` if there are several components.
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

    /// Returns the crossings of the polygons in a cell and its neighbours of the same size, in
    /// ascending order.
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

/// Returns whether a walk on F = 0, as straight as possible, leads from a point on F = 0 to a
/// crossing.
fn is_joined(field: &CubicSpline, cells: &Cells, point: DVec3, normal: DVec3, crossing: DVec3) -> bool {
    let spacing = field.geometry().spacing.min_element();
    let edge_at = |p: DVec3| {
        let cell = cells.find(cells.finest_at(field, p)).map_or(0, |(cell, _)| cell.level);
        spacing / f64::from(1u32 << cell)
    };
    // the crossing lies on F = 0 only to first order
    let edge = edge_at(crossing);
    let Some((to, end_normal)) = field.project_with_gradient(crossing, edge, TOLERANCE * edge) else { return false };
    let end_normal = end_normal.normalize_or_zero();
    let (mut at, mut normal) = (point, normal.normalize_or_zero());
    for _ in 0..MOST_STEPS {
        let way = to - at;
        let along = way - normal * way.dot(normal);
        let edge = edge_at(at);
        let is_next = way.length() < LONGEST_STEP * edge
            && normal.dot(end_normal) > LEAST_COSINE
            && along.length() > 0.5 * way.length();
        if is_next || way.length() < TOLERANCE.sqrt() * edge {
            return true;
        }
        let mut step = along.clamp_length_max(LONGEST_STEP * edge);
        let mut next = None;
        for _ in 0..STEP_ATTEMPTS {
            next = field
                .project_with_gradient(at + step, 0.5 * step.length(), TOLERANCE * edge)
                .map(|(p, gradient)| (p, gradient.normalize_or_zero()))
                .filter(|(_, turned)| turned.dot(normal) > LEAST_COSINE);
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
