//! Computes integrals over F = 0 from its intersections with straight lines (Cauchy-Crofton
//! formula).
//!
//! Consider lines along an axis a, with one line per area s of the perpendicular plane. A piece of
//! surface with area A and unit normal n is crossed `A |n_a| / s` times on average. The sum of
//! `s |n_a|` over the crossings with lines along all three axes therefore has the mean
//! `A (n_x^2 + n_y^2 + n_z^2) = A`. Along a line within a cell, the spline is a cubic polynomial,
//! and all its roots are found. The integral therefore includes folds and specks between the nodes,
//! which marching cubes misses. In a noisy volume, they make up a tenth of the area of F = 0.

use crate::spline::CubicSpline;
use crate::spline::bezier::{BezierPoints, ORDER};
use crate::topology::Signs;
use glam::DVec3;
use rayon::prelude::*;

/// Number of lines along each edge of a cell face: `LINES` x `LINES` lines parallel to each axis
/// pass through a cell. With 2, 3, 5 and 9, the computed area of F = 0 is 63,412, 63,250, 63,242
/// and 63,224 mm^2 for `heart_label` (`distfield --labels all`). It is 8.836, 8.775, 8.799 and
/// 8.807 mm^2 for `trabecular_bone` (measured as for `FLATNESS_MARGIN` in `topology/critical.rs`).
/// The areas with 3 and 9 agree to within 0.4 %.
const LINES: usize = 3;

/// Maximum number of bisections of a line within a cell. The shortest intervals are 2^-12 = 2.4e-4
/// of the cell. If the Bézier points of such an interval still change sign several times, an odd
/// number of changes counts as one root and an even number as none.
const HALVINGS: u32 = 12;

/// Maximum number of steps to find a root. A step is a Newton step if its result stays within the
/// bracketing interval, and otherwise a bisection. Bisection alone needs log2(1 / [`ACCURACY`]) =
/// 24 steps. On the two volumes measured for [`LINES`], the slowest root takes 25 steps.
const ROOT_STEPS: usize = 30;

/// Accuracy of a root as a fraction of a cell: about the relative precision of the coefficients,
/// which are f32 (2^-23 = 1.2e-7).
const ACCURACY: f64 = 1e-7;

/// Returns the integral of `density(point, unit normal)` over F = 0 within the volume. Points are
/// in the grid frame (mm). The result does not depend on the number of threads.
pub fn integrate(surface: &CubicSpline, density: impl Fn(DVec3, DVec3) -> f64 + Sync) -> f64 {
    let size = surface.geometry().size.map(|n| n.saturating_sub(1));
    let signs = Signs::of(surface);
    let layers: Vec<f64> = (0..size[2])
        .into_par_iter()
        .map(|k| {
            let cells = signs.changes(k, 0).into_iter().map(|n| [n % size[0], n / size[0], k]);
            let crossed = cells.filter_map(|cell| Some((cell, surface.bezier_points_round_zero(cell)?)));
            crossed.map(|(cell, points)| integrate_cell(surface, cell, &points, &density)).sum()
        })
        .collect();
    layers.iter().sum()
}

/// Returns the integral over one cell.
fn integrate_cell(
    surface: &CubicSpline,
    cell: [usize; 3],
    points: &BezierPoints,
    density: &impl Fn(DVec3, DVec3) -> f64,
) -> f64 {
    let spacing = surface.geometry().spacing;
    let corner = DVec3::from_array(cell.map(|n| n as f64));
    let offset = |n: usize| (n as f64 + 0.5) / LINES as f64;
    let mut sum = 0.0;
    for axis in 0..3 {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let between = spacing[b] * spacing[c] / (LINES * LINES) as f64;
        let turned = turn(points, axis);
        for v in (0..LINES).map(offset) {
            let plane = turned.each_ref().map(|points| blend(points, bernstein(v)));
            if have_one_sign(plane.as_flattened()) {
                continue;
            }
            for u in (0..LINES).map(offset) {
                let line = blend(&plane, bernstein(u));
                each_root(line, 0.0, 1.0, HALVINGS, &mut |t| {
                    let mut at = corner;
                    (at[axis], at[b], at[c]) = (at[axis] + t, at[b] + u, at[c] + v);
                    let point = surface.geometry().index_to_grid(at);
                    let across = turned.each_ref().map(|points| blend(points, slopes(v)));
                    let mut gradient = DVec3::ZERO;
                    gradient[axis] = sum_of(line, slopes(t));
                    gradient[b] = sum_of(blend(&plane, slopes(u)), bernstein(t));
                    gradient[c] = sum_of(blend(&across, bernstein(u)), bernstein(t));
                    let normal = (gradient / spacing).normalize_or_zero();
                    sum += between * normal[axis].abs() * density(point, normal);
                });
            }
        }
    }
    sum
}

/// Returns whether none or all of the numbers are negative.
fn have_one_sign(points: &[f64]) -> bool {
    let negative = points.iter().filter(|&&point| point < 0.0).count();
    negative == 0 || negative == points.len()
}

/// Returns the Bézier points of a cell with permuted axes. The three indices run along `axis + 1`,
/// `axis + 2` and `axis` (modulo 3).
fn turn(points: &BezierPoints, axis: usize) -> [[[f64; ORDER]; ORDER]; ORDER] {
    let stride = |axis: usize| ORDER.pow(axis as u32 % 3);
    let [t, u, v] = [axis, axis + 1, axis + 2].map(stride);
    std::array::from_fn(|i| std::array::from_fn(|j| std::array::from_fn(|k| points[u * i + v * j + t * k])))
}

/// Returns the weighted sum of four rows of points.
#[inline]
fn blend([a, b, c, d]: &[[f64; 4]; 4], weights: [f64; 4]) -> [f64; 4] {
    std::array::from_fn(|n| weights[0] * a[n] + weights[1] * b[n] + weights[2] * c[n] + weights[3] * d[n])
}

/// Returns the four cubic Bernstein polynomials at t.
fn bernstein(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t]
}

/// Returns the derivatives of the four cubic Bernstein polynomials at t.
fn slopes(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [-3.0 * s * s, 3.0 * s * (s - 2.0 * t), 3.0 * t * (2.0 * s - t), 3.0 * t * t]
}

/// Returns the weighted sum of four numbers.
#[inline]
fn sum_of(points: [f64; 4], weights: [f64; 4]) -> f64 {
    weights[0] * points[0] + weights[1] * points[1] + weights[2] * points[2] + weights[3] * points[3]
}

/// Calls `found` with every root of a cubic between `low` and `high`. The cubic is given by its
/// Bézier points on this interval. Bisects the interval until the points change sign at most once.
fn each_root(points: [f64; 4], low: f64, high: f64, halvings: u32, found: &mut impl FnMut(f64)) {
    let changes = points.windows(2).filter(|pair| (pair[0] < 0.0) != (pair[1] < 0.0)).count();
    if changes == 1 || (halvings == 0 && changes % 2 == 1) {
        found(low + (high - low) * single_root(points));
    } else if changes > 0 && halvings > 0 {
        let [left, right] = halves(points);
        let middle = 0.5 * (low + high);
        each_root(left, low, middle, halvings - 1, found);
        each_root(right, middle, high, halvings - 1, found);
    }
}

/// Subdivides the Bézier points at the middle (de Casteljau's algorithm).
fn halves([a, b, c, d]: [f64; 4]) -> [[f64; 4]; 2] {
    let (ab, bc, cd) = (0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + d));
    let (abc, bcd) = (0.5 * (ab + bc), 0.5 * (bc + cd));
    let middle = 0.5 * (abc + bcd);
    [[a, ab, abc, middle], [middle, bcd, cd, d]]
}

/// Returns the root in [0, 1] of a cubic whose Bézier points change sign once. Uses Newton's method
/// and falls back to bisection if a step would leave the interval that contains the root.
fn single_root([a, b, c, d]: [f64; 4]) -> f64 {
    let (c1, c2, c3) = (3.0 * (b - a), 3.0 * (a - 2.0 * b + c), d - a + 3.0 * (b - c));
    let (mut low, mut high) = (0.0, 1.0);
    let mut t = a / (a - d);
    for _ in 0..ROOT_STEPS {
        let value = a + t * (c1 + t * (c2 + t * c3));
        if (value < 0.0) == (a < 0.0) {
            low = t
        } else {
            high = t
        }
        let newton = t - value / (c1 + t * (2.0 * c2 + t * 3.0 * c3));
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - t).abs() < ACCURACY {
            return next;
        }
        t = next;
    }
    t
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;
    use isoparticles_volume::{Geometry, Image};
    use std::f64::consts::PI;

    fn spline(size: [usize; 3], spacing: DVec3, f: impl Fn(DVec3) -> f64) -> CubicSpline {
        CubicSpline::new(&Image::sampled(Geometry::axis_aligned(size, spacing), |p| f(p) as f32))
    }

    #[test]
    fn the_area_of_balls_is_theirs() {
        for n in 0..12 {
            let centre = DVec3::splat(8.0) + DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n));
            let r = 3.0 + 0.4 * n as f64;
            let surface = spline([20, 40, 20], DVec3::new(1.0, 0.5, 1.0), |p| p.distance(centre) - r);
            let area = integrate(&surface, |_, _| 1.0) / (4.0 * PI * r * r);
            // the flux of the position through the surface is three times the volume
            let flux = integrate(&surface, |p, normal| (p - centre).dot(normal)) / (4.0 * PI * r.powi(3));
            println!("radius {r}: area {area}, flux {flux}");
            assert!((area - 1.0).abs() < 0.005 && (flux - 1.0).abs() < 0.005, "radius {r}: area {area}, flux {flux}");
        }
    }

    #[test]
    fn planes_count_up_to_the_border_whatever_their_direction() {
        // the plane z = 6 + a x + b y - 0.01 over [0, 11]^2
        for (a, b) in [(0.0, 0.0), (0.3, -0.2), (0.4, 0.05), (-0.2, -0.25)] {
            let surface = spline([12; 3], DVec3::ONE, |p| p.z - 6.0 - a * p.x - b * p.y + 0.01);
            let want = 121.0 * DVec3::new(a, b, 1.0).length();
            let area = integrate(&surface, |_, _| 1.0);
            assert!((area / want - 1.0).abs() < 0.01, "{a} {b}: {area}, not {want}");
        }
        assert_eq!(integrate(&spline([12; 3], DVec3::ONE, |p| p.z + 1.0), |_, _| 1.0), 0.0);
    }

    /// Two parts of F = 0 cross the same layer of cells. All samples are positive, so marching
    /// cubes detects neither part.
    #[test]
    fn what_lies_between_the_nodes_counts() {
        let mut image = Image::filled(Geometry::axis_aligned([9, 9, 10], DVec3::ONE), 1.0f32);
        // along z, the spline is negative between the two middle nodes, although all samples are
        // positive
        for (n, value) in image.data.iter_mut().enumerate() {
            *value = [20.0, 10.0, 5.0, 2.0, 0.1, 0.1, 2.0, 5.0, 10.0, 20.0][n / 81];
        }
        assert!(crate::marching_cubes::marching_cubes(&image, 0.0).triangles.is_empty());
        let surface = CubicSpline::new(&image);
        assert!(surface.value(DVec3::new(4.3, 4.2, 4.5)) < -0.05);
        let area = integrate(&surface, |_, _| 1.0);
        assert!((area / 128.0 - 1.0).abs() < 1e-6, "{area}, not two sheets of 8 x 8");
    }

    #[test]
    fn all_roots_of_a_cubic_are_found() {
        for n in 0..300 {
            let mut roots: Vec<f64> = (0..3).map(|k| 1.4 * uniform(2, k, n) - 0.2).collect();
            roots.sort_by(f64::total_cmp);
            let apart = roots.windows(2).map(|pair| pair[1] - pair[0]).fold(1.0, f64::min);
            if apart < 1e-3 || roots.iter().any(|r| r.abs().min((r - 1.0).abs()) < 1e-6) {
                continue;
            }
            let [a, b, c] = [roots[0], roots[1], roots[2]];
            // polar form of (t - a)(t - b)(t - c)
            let blossom = |t: [f64; 3]| {
                let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
                orders.iter().map(|o| (t[o[0]] - a) * (t[o[1]] - b) * (t[o[2]] - c)).sum::<f64>() / 6.0
            };
            let points = [[0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0; 3]].map(blossom);
            let mut found = Vec::new();
            each_root(points, 0.0, 1.0, HALVINGS, &mut |t| found.push(t));
            let want: Vec<f64> = roots.into_iter().filter(|r| (0.0..1.0).contains(r)).collect();
            assert_eq!(found.len(), want.len(), "{found:?}, not {want:?}");
            assert!(found.iter().zip(&want).all(|(f, w)| (f - w).abs() < 1e-6), "{found:?}, not {want:?}");
        }
    }
}
