//! Computes the Bézier points of F in a cell between eight neighbouring nodes.

use super::{CubicSpline, mirror};

/// Number of Bézier points of a cell along each axis.
pub(crate) const ORDER: usize = 4;

/// The Bézier points of a cell, x fastest. F lies between their minimum and maximum (convex hull
/// property). The corner points are the values of F at the corners of the cell.
pub(crate) type BezierPoints = [f64; ORDER * ORDER * ORDER];

/// Bound on the rounding error of conversions and subdivisions, relative to the largest magnitude
/// among the points. A conversion along three axes and seven levels of subdivision involve fewer
/// than 256 roundings.
pub(crate) const ROUNDING: f64 = 256.0 * f64::EPSILON;

impl CubicSpline {
    /// Returns the Bézier points of the cell with the given lowest node.
    pub(crate) fn bezier_points(&self, cell: [usize; 3]) -> BezierPoints {
        let mut points = self.coefficients_of_cell(cell);
        along::<{ ORDER * ORDER }>(&mut points);
        along::<ORDER>(&mut points);
        along::<1>(&mut points);
        points
    }

    /// Returns the Bézier points like [`Self::bezier_points`], or `None` if F certainly has the
    /// same sign throughout the closed cell. The signs are tested after the conversion along each
    /// axis. A conversion computes weighted means, so it preserves a common sign.
    pub(crate) fn bezier_points_round_zero(&self, cell: [usize; 3]) -> Option<BezierPoints> {
        let mut points = self.coefficients_of_cell(cell);
        for convert in [along::<{ ORDER * ORDER }>, along::<ORDER>, along::<1>] {
            convert(&mut points);
            if is_of_one_sign(&points) {
                return None;
            }
        }
        Some(points)
    }

    /// Returns the coefficients that determine F in a cell, mirrored at the border.
    fn coefficients_of_cell(&self, cell: [usize; 3]) -> BezierPoints {
        let [nx, ny, nz] = self.geometry.size;
        let row = |y: usize, z: usize| &self.coefficients[(z * ny + y) * nx..][..nx];
        let mut found = [0.0; ORDER * ORDER * ORDER];
        let rows = found.chunks_exact_mut(ORDER).enumerate().map(|(n, own)| (n % ORDER, n / ORDER, own));
        let is_inner = (0..3).all(|axis| cell[axis] > 0 && cell[axis] + 2 < self.geometry.size[axis]);
        if is_inner {
            let [x, y, z] = cell.map(|n| n - 1);
            for (j, k, own) in rows {
                own.iter_mut().zip(&row(y + j, z + k)[x..x + ORDER]).for_each(|(own, &c)| *own = f64::from(c));
            }
        } else {
            let at = |axis: usize, k: usize| mirror((cell[axis] + k) as isize - 1, [nx, ny, nz][axis]);
            for (j, k, own) in rows {
                let row = row(at(1, j), at(2, k));
                own.iter_mut().enumerate().for_each(|(i, own)| *own = f64::from(row[at(0, i)]));
            }
        }
        found
    }
}

/// Returns whether all points have the same sign and exceed the rounding error in magnitude.
pub(crate) fn is_of_one_sign(points: &BezierPoints) -> bool {
    let (low, high) = range(points);
    let slack = ROUNDING * low.abs().max(high.abs());
    low > slack || high < -slack
}

/// Converts coefficients of a uniform cubic B-spline to Bézier points, along the axis with the
/// stride `STRIDE`. A constant stride lets the compiler unroll the loops.
fn along<const STRIDE: usize>(points: &mut BezierPoints) {
    for outer in (0..points.len()).step_by(ORDER * STRIDE) {
        for first in outer..outer + STRIDE {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| points[first + k * STRIDE]);
            points[first] = (a + 4.0 * b + c) / 6.0;
            points[first + STRIDE] = (2.0 * b + c) / 3.0;
            points[first + 2 * STRIDE] = (b + 2.0 * c) / 3.0;
            points[first + 3 * STRIDE] = (b + 4.0 * c + d) / 6.0;
        }
    }
}

/// Returns the minimum and maximum of the values, computed in independent lanes.
pub(crate) fn range<const COUNT: usize>(values: &[f64; COUNT]) -> (f64, f64) {
    const LANES: usize = 8;
    let less = |a: f64, b: f64| if a < b { a } else { b };
    let more = |a: f64, b: f64| if a > b { a } else { b };
    let (mut low, mut high) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for lane in 0..LANES {
            low[lane] = less(chunk[lane], low[lane]);
            high[lane] = more(chunk[lane], high[lane]);
        }
    }
    let ends = |all: [f64; LANES], other: &dyn Fn(f64, f64) -> f64| all.into_iter().reduce(other).unwrap_or(0.0);
    rest.iter().fold((ends(low, &less), ends(high, &more)), |(low, high), &x| (less(x, low), more(x, high)))
}
