//! Represents the spline within one cell in Bernstein form. The coefficients of this form bound F
//! and its derivatives.
//!
//! The values of a polynomial lie within the range of its Bernstein coefficients (convex hull
//! property). Up to a constant factor, its derivatives lie within the range of the differences of
//! these coefficients. Each halving of a cell divides the distance between the coefficients and the
//! polynomial by four. Repeated subdivision therefore decides every cell in which F and its
//! gradient do not vanish at the same point.

use crate::spline::CubicSpline;
use crate::spline::bezier::{BezierPoints, ORDER, ROUNDING, is_of_one_sign, range};

/// The Bernstein coefficients of F in a cell.
#[derive(Clone)]
pub(super) struct Bernstein(BezierPoints);

impl Bernstein {
    /// Returns F in the voxel cell with the given lowest node.
    pub(super) fn of_cell(field: &CubicSpline, cell: [usize; 3]) -> Self {
        Self(field.bezier_points(cell))
    }

    /// Returns F in a voxel cell like [`Self::of_cell`], or `None` if F certainly has one sign
    /// throughout the cell.
    pub(super) fn of_crossed_cell(field: &CubicSpline, cell: [usize; 3]) -> Option<Self> {
        field.bezier_points_round_zero(cell).map(Self)
    }

    /// Returns F in the eight octants. Bit `a` of an octant's number selects the half along axis
    /// `a`.
    pub(super) fn octants(&self) -> [Self; 8] {
        let mut all = [const { Self([0.0; _]) }; 8];
        all[0].0 = self.0;
        Self::halve::<1>(&mut all[..2]);
        Self::halve::<ORDER>(&mut all[..4]);
        Self::halve::<{ ORDER * ORDER }>(&mut all);
        all
    }

    /// Subdivides cells at the middle (de Casteljau's algorithm), along the axis with the stride
    /// `STRIDE`. The first half of `all` becomes the lower halves of the cells, and the second half
    /// becomes the upper halves.
    fn halve<const STRIDE: usize>(all: &mut [Self]) {
        let (lower, upper) = all.split_at_mut(all.len() / 2);
        for (Self(lower), Self(upper)) in lower.iter_mut().zip(upper) {
            for outer in (0..lower.len()).step_by(ORDER * STRIDE) {
                for first in outer..outer + STRIDE {
                    let place = |k: usize| first + k * STRIDE;
                    let [a, b, c, d] = [0, 1, 2, 3].map(|k| lower[place(k)]);
                    let middle = (a + 3.0 * (b + c) + d) / 8.0;
                    let low = [a, (a + b) / 2.0, (a + 2.0 * b + c) / 4.0, middle];
                    let high = [middle, (b + 2.0 * c + d) / 4.0, (c + d) / 2.0, d];
                    for k in 0..ORDER {
                        (lower[place(k)], upper[place(k)]) = (low[k], high[k]);
                    }
                }
            }
        }
    }

    /// Returns bounds on the derivative of F along each axis, widened by the rounding error.
    /// Derivatives are per index step, up to a factor common to all axes.
    fn slopes(&self) -> [(f64, f64); 3] {
        let (low, high) = range(&self.0);
        let slack = low.abs().max(high.abs()) * ROUNDING;
        let slopes = [self.differences::<1>(), self.differences::<ORDER>(), self.differences::<{ ORDER * ORDER }>()];
        slopes.map(|(low, high)| (low - slack, high + slack))
    }

    /// Returns the range of the differences between neighbouring coefficients along an axis.
    fn differences<const STRIDE: usize>(&self) -> (f64, f64) {
        let mut differences = [0.0; (ORDER - 1) * ORDER * ORDER];
        let mut n = 0;
        for outer in (0..ORDER * ORDER * ORDER).step_by(ORDER * STRIDE) {
            for low in outer..outer + (ORDER - 1) * STRIDE {
                differences[n] = self.0[low + STRIDE] - self.0[low];
                n += 1;
            }
        }
        range(&differences)
    }

    /// Returns whether the gradient may vanish in the cell.
    pub(super) fn may_be_critical(&self) -> bool {
        self.slopes().iter().all(|&(low, high)| low <= 0.0 && high >= 0.0)
    }

    /// Returns whether F certainly has one sign throughout the closed cell.
    pub(super) fn is_clear(&self) -> bool {
        is_of_one_sign(&self.0)
    }

    /// Returns whether the gradients (per index) at any two positions in the cell form an acute
    /// angle: condition C1 of Plantinga and Vegter. F = 0 is then a graph in the cell, over the
    /// plane perpendicular to any of the gradients.
    pub(super) fn is_graph(&self) -> bool {
        let least = self.slopes().map(|(low, high)| {
            // the minimum product of two derivatives within the bounds
            if low > 0.0 {
                low * low
            } else if high < 0.0 {
                high * high
            } else {
                low * high
            }
        });
        least.iter().sum::<f64>() > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;
    use glam::DVec3;
    use isoparticles_volume::Geometry;
    use isoparticles_volume::Image;

    /// Returns the spline through random samples on a small grid.
    fn noise(seed: u64) -> CubicSpline {
        let geometry = Geometry::axis_aligned([5, 4, 6], DVec3::new(0.7, 1.1, 0.9));
        CubicSpline::new(&Image::sampled(geometry, |p| {
            uniform(seed, 0, (p.x * 1e3 + p.y * 1e5 + p.z * 1e7) as u64) as f32 - 0.3
        }))
    }

    #[test]
    fn corners_are_values_of_f_and_coefficients_bound_all_values() {
        let (mut clear, mut graphs) = (0, 0);
        for seed in 0..20 {
            let field = noise(seed);
            let spacing = field.geometry().spacing;
            for cell in [[0, 0, 0], [1, 2, 3], [3, 1, 2], [3, 2, 4]] {
                let whole = Bernstein::of_cell(&field, cell);
                assert_eq!(Bernstein::of_crossed_cell(&field, cell).is_none(), whole.is_clear(), "{cell:?}");
                let first = DVec3::from_array(cell.map(|n| n as f64));
                let octant = (seed % 8) as usize;
                let half = DVec3::new((octant & 1) as f64, (octant >> 1 & 1) as f64, (octant >> 2) as f64) * 0.5;
                for (own, low, edge) in
                    [(whole.clone(), first, 1.0), (whole.octants()[octant].clone(), first + half, 0.5)]
                {
                    for corner in 0..8 {
                        let bits = [corner & 1, corner >> 1 & 1, corner >> 2];
                        let p = (low + DVec3::from_array(bits.map(|b| b as f64)) * edge) * spacing;
                        let value = own.0[bits[0] * 3 + bits[1] * 12 + bits[2] * 48];
                        assert!((value - field.value(p)).abs() < 1e-12, "{cell:?} {corner}");
                    }
                    let (low_value, high_value) = range(&own.0);
                    let inner: Vec<(f64, DVec3)> = (0..60)
                        .map(|n| DVec3::new(uniform(seed, 1, n), uniform(seed, 2, n), uniform(seed, 3, n)))
                        .map(|share| field.value_gradient((low + share * edge) * spacing))
                        .collect();
                    assert!(inner.iter().all(|(f, _)| (low_value..=high_value).contains(f)));
                    if own.is_clear() {
                        clear += 1;
                        assert!(inner.iter().all(|(f, _)| f.signum() == inner[0].0.signum()));
                    }
                    if own.is_graph() {
                        graphs += 1;
                        let per_index = |k: usize| inner[k].1 * spacing;
                        assert!((0..60).all(|i| (0..60).all(|j| per_index(i).dot(per_index(j)) > 0.0)));
                    }
                }
            }
        }
        assert!(clear > 10 && graphs > 5, "{clear} and {graphs}: this shows nothing");
    }
}
