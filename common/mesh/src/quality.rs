//! Triangle quality: the radius ratio 2r/R of the paper's Table 1, angles, areas and edge lengths,
//! and the distribution of these values over a mesh. The radius ratio is 1 for an equilateral
//! triangle and 0 for a degenerate triangle.

use super::TriangleMesh;
use crate::buckets::TASK_ITEMS;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

/// Number of bins of the radius-ratio histogram. The bins divide the range from 0 to 1 into
/// intervals of 0.02.
pub const HISTOGRAM_BINS: usize = 50;

/// Maximum area of a degenerate triangle, as a fraction of the mean area. Three collinear points
/// that are rounded to `f64` span up to 1.5e-13 of the area of an equilateral triangle at a
/// distance of 1,000 edge lengths from the origin, and up to 2.3e-12 at 10,000 (maxima over 200,000
/// random triples in NumPy).
pub const ZERO_AREA_SHARE: f64 = 1e-12;

/// Computes the radius ratio 2r/R of a triangle: `8 A^2 / (s l)`, where A is the area, s is half
/// the perimeter and l is the product of the edge lengths. Returns 0 for a degenerate triangle.
#[inline]
pub fn radius_ratio(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let lengths = [b.distance(c), c.distance(a), a.distance(b)];
    let doubled_area_squared = (b - a).cross(c - a).length_squared();
    let half_perimeter = 0.5 * (lengths[0] + lengths[1] + lengths[2]);
    let ratio = 2.0 * doubled_area_squared / (half_perimeter * lengths[0] * lengths[1] * lengths[2]);
    if ratio.is_finite() { ratio } else { 0.0 }
}

/// Computes the area of a triangle in squared units of the coordinates.
pub fn area(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

/// Computes the three interior angles in degrees, at `a`, `b` and `c`. The angles at the ends of an
/// edge of length zero are NaN.
pub fn angles(a: DVec3, b: DVec3, c: DVec3) -> [f64; 3] {
    let at = |p: DVec3, q: DVec3, r: DVec3| {
        let (u, v) = (q - p, r - p);
        if u == DVec3::ZERO || v == DVec3::ZERO { f64::NAN } else { u.cross(v).length().atan2(u.dot(v)).to_degrees() }
    };
    [at(a, b, c), at(b, c, a), at(c, a, b)]
}

/// Returns the radius ratio of every triangle, in order.
pub fn radius_ratios(mesh: &TriangleMesh) -> Vec<f64> {
    (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            radius_ratio(a, b, c)
        })
        .collect()
}

/// Returns the triangles whose area is at most [`ZERO_AREA_SHARE`] of the mean area.
pub fn zero_area_triangles(mesh: &TriangleMesh) -> Vec<u32> {
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            area(a, b, c)
        })
        .collect();
    let limit = ZERO_AREA_SHARE * mean(&areas);
    (0..areas.len() as u32).filter(|&t| areas[t as usize] <= limit).collect()
}

/// Quality statistics of the triangles of a mesh.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct QualitySummary {
    /// Number of triangles.
    pub triangles: usize,
    /// Mean radius ratio.
    pub radius_ratio_mean: f64,
    /// Minimum radius ratio.
    pub radius_ratio_min: f64,
    /// 0.1th percentile of the radius ratio.
    pub radius_ratio_p01: f64,
    /// 1st percentile of the radius ratio.
    pub radius_ratio_p1: f64,
    /// 5th percentile of the radius ratio.
    pub radius_ratio_p5: f64,
    /// Median radius ratio.
    pub radius_ratio_median: f64,
    /// Fraction of the triangles with a radius ratio below one half.
    pub share_below_half: f64,
    /// Number of triangles in each of [`HISTOGRAM_BINS`] equal bins of the radius ratio.
    pub radius_ratio_histogram: Vec<usize>,
    /// Minimum angle in degrees.
    pub angle_min: f64,
    /// Maximum angle in degrees.
    pub angle_max: f64,
    /// Minimum edge length in mm.
    pub edge_length_min: f64,
    /// Mean edge length in mm over the edges of all triangles. An inner edge is counted twice.
    pub edge_length_mean: f64,
    /// Maximum edge length in mm.
    pub edge_length_max: f64,
}

/// Minimum and maximum angle, minimum and maximum edge length, and total edge length of a group of
/// triangles.
struct Sides {
    angles: [f64; 2],
    lengths: [f64; 2],
    total: f64,
}

impl Sides {
    fn of(mesh: &TriangleMesh, triangles: &[[u32; 3]]) -> Self {
        let mut all = Self { angles: [f64::INFINITY, 0.0], lengths: [f64::INFINITY, 0.0], total: 0.0 };
        for corners in triangles {
            let [a, b, c] = corners.map(|v| mesh.vertices[v as usize]);
            for angle in angles(a, b, c) {
                all.angles = [all.angles[0].min(angle), all.angles[1].max(angle)];
            }
            for length in [a.distance(b), b.distance(c), c.distance(a)] {
                all.lengths = [all.lengths[0].min(length), all.lengths[1].max(length)];
                all.total += length;
            }
        }
        all
    }
}

/// Computes the quality statistics of all triangles. All values are zero for an empty mesh.
pub fn summarise(mesh: &TriangleMesh) -> QualitySummary {
    if mesh.triangles.is_empty() {
        return QualitySummary { radius_ratio_histogram: vec![0; HISTOGRAM_BINS], ..QualitySummary::default() };
    }
    let mut ratios = radius_ratios(mesh);
    let mut summary = QualitySummary {
        triangles: ratios.len(),
        radius_ratio_mean: mean(&ratios),
        share_below_half: ratios.iter().filter(|&&r| r < 0.5).count() as f64 / ratios.len() as f64,
        radius_ratio_histogram: vec![0; HISTOGRAM_BINS],
        angle_min: f64::INFINITY,
        edge_length_min: f64::INFINITY,
        ..QualitySummary::default()
    };
    for ratio in &ratios {
        let bin = (ratio * HISTOGRAM_BINS as f64) as usize;
        summary.radius_ratio_histogram[bin.min(HISTOGRAM_BINS - 1)] += 1;
    }
    ratios.par_sort_unstable_by(f64::total_cmp);
    summary.radius_ratio_min = ratios[0];
    summary.radius_ratio_p01 = percentile(&ratios, 0.1);
    summary.radius_ratio_p1 = percentile(&ratios, 1.0);
    summary.radius_ratio_p5 = percentile(&ratios, 5.0);
    summary.radius_ratio_median = percentile(&ratios, 50.0);
    let mut total_length = 0.0;
    for part in mesh.triangles.par_chunks(TASK_ITEMS).map(|triangles| Sides::of(mesh, triangles)).collect::<Vec<_>>() {
        summary.angle_min = summary.angle_min.min(part.angles[0]);
        summary.angle_max = summary.angle_max.max(part.angles[1]);
        summary.edge_length_min = summary.edge_length_min.min(part.lengths[0]);
        summary.edge_length_max = summary.edge_length_max.max(part.lengths[1]);
        total_length += part.total;
    }
    if summary.angle_min.is_infinite() {
        summary.angle_min = 0.0;
    }
    summary.edge_length_mean = total_length / (3 * ratios.len()) as f64;
    summary
}

/// Returns the mean of the values, summed in order, or 0 if there are no values.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Returns a percentile (0 to 100) of ascending values, interpolated linearly, or 0 if there are no
/// values.
pub fn percentile(ascending: &[f64], percent: f64) -> f64 {
    if ascending.is_empty() {
        return 0.0;
    }
    let position = (percent / 100.0).clamp(0.0, 1.0) * (ascending.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(ascending.len() - 1);
    ascending[below] + (position - below as f64) * (ascending[above] - ascending[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radius_ratio_of_known_triangles() {
        let equilateral = radius_ratio(DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.75f64.sqrt(), 0.0));
        assert!((equilateral - 1.0).abs() < 1e-14);
        // 3-4-5 triangle: r = 1, R = 2.5
        let right = radius_ratio(DVec3::ZERO, DVec3::X * 3.0, DVec3::Y * 4.0);
        assert!((right - 0.8).abs() < 1e-14);
        // right isosceles triangle: 2 (sqrt 2 - 1)
        let isosceles = radius_ratio(DVec3::ZERO, DVec3::X, DVec3::Z);
        assert!((isosceles - 2.0 * (2f64.sqrt() - 1.0)).abs() < 1e-14);
        assert_eq!(radius_ratio(DVec3::ZERO, DVec3::X, DVec3::X * 2.0), 0.0);
        assert_eq!(radius_ratio(DVec3::ONE, DVec3::ONE, DVec3::ONE), 0.0);
    }

    #[test]
    fn angles_of_a_right_triangle() {
        let [a, b, c] = angles(DVec3::ZERO, DVec3::X, DVec3::Y * 3f64.sqrt());
        assert!((a - 90.0).abs() < 1e-12 && (b - 60.0).abs() < 1e-12 && (c - 30.0).abs() < 1e-12);
    }

    #[test]
    fn percentiles_are_linear_between_neighbours() {
        let values = [1.0, 2.0, 4.0, 8.0];
        assert_eq!(percentile(&values, 0.0), 1.0);
        assert_eq!(percentile(&values, 50.0), 3.0);
        assert_eq!(percentile(&values, 100.0), 8.0);
        assert_eq!(percentile(&[], 50.0), 0.0);
    }

    #[test]
    fn summary_of_two_triangles() {
        let mesh = TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X * 3.0, DVec3::Y * 4.0, DVec3::X * 6.0],
            triangles: vec![[0, 1, 2], [0, 1, 3]],
        };
        let summary = summarise(&mesh);
        assert!((summary.radius_ratio_mean - 0.4).abs() < 1e-14);
        assert_eq!(summary.radius_ratio_min, 0.0);
        assert_eq!((summary.angle_min, summary.angle_max), (0.0, 180.0));
        assert_eq!((summary.edge_length_min, summary.edge_length_max), (3.0, 6.0));
        assert_eq!(summary.share_below_half, 0.5);
        assert_eq!(summary.radius_ratio_histogram.iter().sum::<usize>(), 2);
        assert_eq!(zero_area_triangles(&mesh), vec![1]);
        assert_eq!(summarise(&TriangleMesh::default()).triangles, 0);
    }
}
