//! Finds the critical points of F near F = 0. At these points, necks, gaps, handles and specks of
//! the isosurface appear or vanish as the iso value changes.
//!
//! By Morse theory, the topology of F = 0 is determined by the critical points of F and the side of
//! F = 0 on which each of them lies. A mesh near F = 0 has the correct handles if every critical
//! point is on the correct side of the mesh. Boissonnat, Cohen-Steiner and Vegter (2004) use this
//! criterion to mesh implicit surfaces. A critical point on the wrong side shows where the mesh
//! lacks points.

use super::bernstein::Bernstein;
use super::signs::Signs;
use super::watch::{Interrupted, Watch};
use crate::spline::CubicSpline;
use fearless_simd::{Level, dispatch};
use glam::{DMat3, DVec3};
use isoparticles_file::monitor::Silent;
use rayon::prelude::*;
use std::cmp::Ordering;

/// Maximum number of Newton steps towards a critical point. With 15, 30 and 60 steps, the same 1183
/// critical points are found (measured as for [`FLATNESS_MARGIN`]).
const NEWTON_STEPS: usize = 30;

/// Maximum ratio, in voxels, of the gradient length to the norm of the Hessian at the middle of a
/// cell in which a search starts. The cell corners are sqrt(3) / 2 = 0.87 voxel from the middle.
/// The remainder is a margin for the variation of the Hessian within the cell. With 1, 2 and 4, the
/// search finds 1169, 1183 and 1188 critical points (`cargo run --release -p isoparticles-field
/// --example topology -- F.vti`, with F of `trabecular_bone` at iso value 80, nodes 70 to 129 along
/// each axis). The undecided locations are the same in all three cases.
const FLATNESS_MARGIN: f64 = 2.0;

/// Starting points of the searches in a cell, as fractions of the cell edges: the middle, and one
/// point per octant, to find several critical points in one cell.
const STARTS: [DVec3; 9] = [
    DVec3::splat(0.5),
    DVec3::new(0.2, 0.2, 0.2),
    DVec3::new(0.8, 0.2, 0.2),
    DVec3::new(0.2, 0.8, 0.2),
    DVec3::new(0.8, 0.8, 0.2),
    DVec3::new(0.2, 0.2, 0.8),
    DVec3::new(0.8, 0.2, 0.8),
    DVec3::new(0.2, 0.8, 0.8),
    DVec3::new(0.8, 0.8, 0.8),
];

/// Maximum distance along each axis, in voxels, that a search for a critical point may move from
/// its start. A search that moves farther is abandoned, because a search from a closer cell usually
/// finds the point. With limits of 0.5, 1 and 2 voxels, 1115, 1183 and 1228 critical points are
/// found, and 6, 7 and 7 locations are undecided (measured as for [`FLATNESS_MARGIN`]).
const SEARCH_RADIUS: f64 = 1.0;

/// Distance, in voxels, below which two critical points are treated as one. Searches converge to
/// 1e-9 voxel, and distinct critical points are much farther apart: with 1e-4, 1e-3 and 1e-2, the
/// same 1183 points are found (measured as for [`FLATNESS_MARGIN`]).
const MERGE_DISTANCE: f64 = 1e-3;

/// A critical point of F.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CriticalPoint {
    /// Position in the grid frame, mm.
    pub position: DVec3,
    /// F at the critical point, mm.
    pub value: f64,
    /// For each eigenvector of the Hessian, the vector (mm) in its direction from the critical
    /// point to F = 0, according to the second-order expansion. The vector is zero if F = 0 is not
    /// reached in that direction.
    pub ways: [DVec3; 3],
    /// Length of the shortest non-zero vector in `ways`, in mm. It approximates the radius of the
    /// neck, gap or speck.
    pub radius: f64,
}

/// Returns the critical points of F within a few voxels of F = 0 whose neck, gap or speck has a
/// radius of at least `smallest` (mm).
pub fn critical_points(field: &CubicSpline, smallest: f64) -> Vec<CriticalPoint> {
    let watch = Watch::new(&Silent, 0);
    let mut found = all(field, &watch).unwrap_or_default();
    found.retain(|c| c.radius >= smallest);
    found
}

/// Returns all critical points of F within a few voxels of F = 0.
pub(super) fn all(field: &CubicSpline, watch: &Watch<'_>) -> Result<Vec<CriticalPoint>, Interrupted> {
    let geometry = field.geometry();
    let size = geometry.size;
    let voxel = geometry.mean_spacing();
    let cells = [0, 1, 2].map(|axis| size[axis].saturating_sub(1));
    let (signs, instructions) = (Signs::of(field), Level::new());
    let in_slice = |k: usize| {
        watch.slice()?;
        let near = signs.changes(k, 1);
        let mut flat = Vec::new();
        dispatch!(instructions, _simd => {
            for cell in near.into_iter().map(|n| [n % cells[0], n / cells[0], k]) {
                let index = DVec3::from_array(cell.map(|n| n as f64 + 0.5));
                if may_be_flat(field, geometry.index_to_grid(index), voxel) {
                    flat.push(cell);
                }
            }
        });
        flat.retain(|&cell| Bernstein::of_cell(field, cell).may_be_critical());
        let starts =
            flat.into_iter().flat_map(|cell| STARTS.map(|offset| DVec3::from_array(cell.map(|n| n as f64)) + offset));
        Ok(starts
            .filter_map(|index| newton(field, geometry.index_to_grid(index), SEARCH_RADIUS * voxel))
            .collect::<Vec<_>>())
    };
    let places = (0..cells[2]).into_par_iter().map(in_slice).collect::<Result<Vec<_>, _>>()?;
    let mut places = places.concat();
    let mut apart = Vec::new();
    keep_apart(&mut places, MERGE_DISTANCE * voxel, 0, 0, &mut apart);
    apart.par_sort_by(|a, b| a.to_array().partial_cmp(&b.to_array()).unwrap_or(Ordering::Equal));
    Ok(apart.into_par_iter().filter_map(|p| describe(field, p)).collect())
}

/// Adds points to `apart`. Of points closer to each other than `limit`, only the first is added.
/// The points are divided into groups at gaps of at least `limit` along an axis. `uncut` is the
/// number of axes tried since the last division. All three axes are tried, because points in a
/// plane, such as a mirror plane of a symmetric object, cannot be divided along its normal.
fn keep_apart(points: &mut [DVec3], limit: f64, axis: usize, uncut: usize, apart: &mut Vec<DVec3>) {
    if points.len() == 1 || uncut == 3 {
        points.sort_unstable_by(|a, b| a.to_array().partial_cmp(&b.to_array()).unwrap_or(Ordering::Equal));
        let first = apart.len();
        for &p in &*points {
            if apart[first..].iter().all(|other| other.distance(p) >= limit) {
                apart.push(p);
            }
        }
        return;
    }
    points.sort_unstable_by(|a, b| a[axis].total_cmp(&b[axis]));
    let count = points.len();
    for group in points.chunk_by_mut(|a, b| b[axis] - a[axis] < limit) {
        let uncut = if group.len() < count { 0 } else { uncut + 1 };
        keep_apart(group, limit, (axis + 1) % 3, uncut, apart);
    }
}

/// Returns whether the gradient may vanish in the cell around a point. The test uses the Hessian at
/// the point, with a margin for the variation of the Hessian within the cell.
#[inline(always)]
fn may_be_flat(field: &CubicSpline, p: DVec3, voxel: f64) -> bool {
    let jet = field.jet(p);
    let hessian = jet.hessian.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
    jet.gradient.length() < FLATNESS_MARGIN * hessian * voxel
}

/// Returns the critical point that Newton's iteration finds within a box of half-width `reach` (mm)
/// around `start`.
fn newton(field: &CubicSpline, start: DVec3, reach: f64) -> Option<DVec3> {
    let upper = field.geometry().upper_corner();
    let mut p = start;
    for _ in 0..NEWTON_STEPS {
        let jet = field.jet(p);
        let step = jet.hessian.inverse() * jet.gradient;
        if !step.is_finite() {
            return None;
        }
        p -= step;
        let inside = p.cmpge(DVec3::ZERO).all() && p.cmple(upper).all();
        if !inside || (p - start).abs().max_element() > reach {
            return None;
        }
        if step.length() < 1e-9 * reach {
            return Some(p);
        }
    }
    None
}

/// Describes F = 0 around a critical point with the second-order expansion of F. Returns `None` if
/// the expansion does not reach F = 0 in any direction.
fn describe(field: &CubicSpline, position: DVec3) -> Option<CriticalPoint> {
    let jet = field.jet(position);
    let mut radius = f64::INFINITY;
    let ways = eigen(jet.hessian).map(|(curvature, direction)| {
        // F + curvature s^2 / 2 = 0
        let squared = -2.0 * jet.value / curvature;
        if squared > 0.0 {
            radius = radius.min(squared.sqrt());
            direction * squared.sqrt()
        } else {
            DVec3::ZERO
        }
    });
    radius.is_finite().then_some(CriticalPoint { position, value: jet.value, ways, radius })
}

/// Returns the eigenvalues and unit eigenvectors of a symmetric matrix, computed by Jacobi
/// rotations.
fn eigen(matrix: DMat3) -> [(f64, DVec3); 3] {
    let mut a = matrix.to_cols_array_2d();
    let mut v = DMat3::IDENTITY.to_cols_array_2d();
    for _ in 0..32 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let angle = 0.5 * (2.0 * a[p][q]).atan2(a[q][q] - a[p][p]);
            let (s, c) = angle.sin_cos();
            for row in &mut a {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
            (a[p], a[q]) = (
                std::array::from_fn(|k| c * a[p][k] - s * a[q][k]),
                std::array::from_fn(|k| s * a[p][k] + c * a[q][k]),
            );
            (v[p], v[q]) = (
                std::array::from_fn(|k| c * v[p][k] - s * v[q][k]),
                std::array::from_fn(|k| s * v[p][k] + c * v[q][k]),
            );
        }
    }
    [0, 1, 2].map(|k| (a[k][k], DVec3::from_array(v[k])))
}

#[cfg(test)]
mod tests {
    use super::super::tests::{self as scenes, Scene};
    use super::*;

    #[test]
    fn the_neck_of_a_quadric_is_where_it_is() {
        // splines reproduce quadratic functions, and the effect of the grid border has decayed in
        // the middle of the grid, so the computed neck must have the exact radii
        let (centre, radii) = (DVec3::new(11.37, 12.21, 11.84), [0.2, 0.3]);
        let turn = DMat3::from_rotation_z(0.4);
        let scene = Scene::new([24; 3], DVec3::ONE, |p| {
            let q = turn * (p - centre);
            0.05 * (-0.7 * q.x * q.x + (q.y / radii[0]).powi(2) + (q.z / radii[1]).powi(2) - 1.0)
        });
        let found = critical_points(&scene.field, 0.0);
        let neck = found.iter().find(|c| c.position.distance(centre) < 0.01).expect("the neck");
        assert!((neck.value + 0.05).abs() < 1e-5, "{neck:?}");
        assert!((neck.radius - radii[0]).abs() < 1e-3, "{neck:?}");
        let mut lengths = neck.ways.map(DVec3::length);
        lengths.sort_by(f64::total_cmp);
        assert!(lengths[0] == 0.0 && (lengths[2] - radii[1]).abs() < 1e-3, "{neck:?}");
        let along_y = neck.ways.iter().find(|w| (w.length() - radii[0]).abs() < 1e-3).expect("a way");
        assert!((turn * *along_y).normalize().y.abs() > 0.9999, "{along_y}");
        // the vectors end on F = 0
        for way in neck.ways.iter().filter(|w| **w != DVec3::ZERO) {
            assert!(scene.field.value(neck.position + *way).abs() < 1e-3, "{way}");
        }
        assert!(critical_points(&scene.field, 0.25).iter().all(|c| c.position.distance(centre) > 0.01));
    }

    #[test]
    fn points_on_a_mirror_plane_are_found_once() {
        // four balls around an axis, with mirror planes through samples and along diagonals
        let scene = Scene::new([33; 3], DVec3::ONE, |p| {
            let balls = [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];
            let away = |(x, y)| p.distance(DVec3::new(16.0 + 6.0 * x, 16.0 + 6.0 * y, 16.0)) - 5.0;
            balls.into_iter().map(away).fold(f64::INFINITY, f64::min)
        });
        let found = critical_points(&scene.field, 0.0);
        assert!(found.iter().filter(|c| (c.position.x - 16.0).abs() < 1e-6).count() >= 3, "{found:?}");
        for (n, c) in found.iter().enumerate() {
            let is_same = |other: &CriticalPoint| other.position.distance(c.position) < MERGE_DISTANCE;
            assert!(!found[..n].iter().any(is_same), "{c:?} is there twice");
        }
        // the same points in another order, each with slightly shifted copies, must give the same
        // number of points
        let points: Vec<DVec3> = found.iter().map(|c| c.position).collect();
        let beside = |p: &DVec3| [*p, *p + DVec3::new(1e-9, -1e-9, 2e-9), *p - DVec3::splat(1e-9)];
        let mut many: Vec<DVec3> = points.iter().rev().flat_map(beside).collect();
        let mut apart = Vec::new();
        keep_apart(&mut many, MERGE_DISTANCE, 0, 0, &mut apart);
        assert_eq!(apart.len(), points.len());
    }

    #[test]
    fn a_wall_between_balls_has_its_saddle_in_the_middle() {
        let scene = scenes::two_balls();
        let middle = DVec3::new(15.6, 11.6, 11.6);
        let found = critical_points(&scene.field, 0.0);
        let saddle = found.iter().find(|c| c.position.distance(middle) < 0.3).expect("the saddle in the gap");
        assert!((0.5..1.2).contains(&saddle.value) && saddle.radius > 0.3, "{saddle:?}");
    }
}
