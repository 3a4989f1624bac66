//! The inter-particle energy: Eq. 1, 2 and 4 of Kim, Chen and Hansen 2012 (after Meyer, Georgel and
//! Whitaker 2005).
//!
//! The scaled distance of a pair is d. With x = d pi/2 and c = cot x, the pair energy is
//! `c + x - pi/2`. Its first derivative with respect to d is `-(pi/2) c^2` (Eq. 4, with
//! 1 - 1/sin^2 = -cot^2). Its second derivative is `(pi^2/2) c (1 + c^2)`. All three are computed
//! from a single tangent. The paper prints the factor 2 cos(pi/2) = 0 in Eq. 2; the correct factor
//! is 2 cos(pi/6) = sqrt(3). With this factor, the second ring of the hexagonal lattice of spacing
//! h lies exactly at the cut-off d = 1.

use fearless_simd::{Simd, f64x8, prelude::*};
use glam::{DMat3, DVec3};
use std::f64::consts::{FRAC_2_PI, FRAC_PI_2, PI};

/// Interaction radius in units of the target edge length (Eq. 2): 2 cos(pi/6) = sqrt(3).
pub const SUPPORT: f64 = 1.732_050_807_568_877_2;

/// Minimum scaled distance. Closer particles are treated as if they were this far apart. Energy and
/// derivatives then remain finite even in single precision: the second derivative is at most about
/// 4 / (pi d^3) = 1.3e18.
pub const LEAST_SCALED_DISTANCE: f64 = 1e-6;

/// Ideal energy as printed in section 3.3 of the paper. It is six times the ideal *distance* 0.577,
/// not six times the energy (Eq. 1) at that distance.
pub const PRINTED_IDEAL_ENERGY: f64 = 3.462;

/// Returns the energy of a particle with six neighbours at distance h, as in the hexagonal lattice
/// of spacing h: 6 E(1/sqrt(3)) = 0.7108.
pub fn ideal_energy() -> f64 {
    6.0 * pair_energy(1.0 / SUPPORT)
}

/// Returns the energy (Eq. 1) of a particle in a hexagonal lattice, summed over all rings within
/// the cut-off. `spacing` is in units of h. The energy is 0.7108 at spacing 1 ([`ideal_energy`]).
pub fn lattice_energy(spacing: f64) -> f64 {
    // the lattice consists of six rotations of the points a u + b v with a > 0 and b >= 0; u and v
    // are lattice vectors at 60 degrees, so a point is `sqrt(a^2 + a b + b^2)` spacings from the
    // origin
    let last = (SUPPORT / spacing).ceil() as u32;
    let place =
        |a: u32, b: u32| pair_energy(scaled_distance(f64::from(a * a + a * b + b * b).sqrt() * spacing, 1.0, 1.0));
    6.0 * (1..=last).flat_map(|a| (0..=last).map(move |b| (a, b))).map(|(a, b)| place(a, b)).sum::<f64>()
}

/// Minimum result of [`lattice_spacing`], in units of h: a tenth of the minimum spacing that
/// `particles` accepts (0.5).
const SMALLEST_LATTICE_SPACING: f64 = 0.05;

/// Returns the spacing, in units of h, of the hexagonal lattice whose particles have the given
/// energy: 1 for [`ideal_energy`], 0.657 for [`PRINTED_IDEAL_ENERGY`]. The result is limited to the
/// range from 0.05 to [`SUPPORT`].
pub fn lattice_spacing(energy: f64) -> f64 {
    // exactly 1 for the ideal energy; bisection would return 1 only to within rounding
    if energy == ideal_energy() {
        return 1.0;
    }
    let (mut low, mut high) = (SMALLEST_LATTICE_SPACING, SUPPORT);
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return low;
        }
        if lattice_energy(middle) > energy { low = middle } else { high = middle }
    }
}

/// Returns the dimensionless scaled distance between two particles (Eq. 2): their distance divided
/// by [`SUPPORT`] times the smaller of their target edge lengths.
pub fn scaled_distance(distance: f64, size_i: f64, size_j: f64) -> f64 {
    distance / (SUPPORT * size_i.min(size_j))
}

/// Returns the pair energy at scaled distance d (Eq. 1). It is infinite at d = 0 and zero for
/// d >= 1.
pub fn pair_energy(d: f64) -> f64 {
    if d >= 1.0 {
        return 0.0;
    }
    let x = d * FRAC_PI_2;
    1.0 / x.tan() + x - FRAC_PI_2
}

/// Returns the pair energy and its first and second derivatives with respect to the scaled distance
/// (Eq. 1 and 4).
pub fn pair_energy_derivatives(d: f64) -> (f64, f64, f64) {
    if d >= 1.0 {
        return (0.0, 0.0, 0.0);
    }
    let x = d * FRAC_PI_2;
    let c = 1.0 / x.tan();
    (c + x - FRAC_PI_2, -FRAC_PI_2 * c * c, 0.5 * PI * PI * c * (1.0 + c * c))
}

/// Returns the energy, gradient (per mm) and Hessian (per mm squared) of one pair with respect to
/// the position of the first particle. Both sizes are held fixed. `offset` is p_i - p_j in mm.
///
/// The eigenvalues of the Hessian are the second derivative (along the pair) and the first
/// derivative divided by the distance (perpendicular to it).
pub fn pair_jet(offset: DVec3, size_i: f64, size_j: f64) -> (f64, DVec3, DMat3) {
    let reach = SUPPORT * size_i.min(size_j);
    // the lower limit keeps energy and derivatives finite; the gradient is zero at offset zero
    let distance = offset.length().max(LEAST_SCALED_DISTANCE * reach);
    if distance >= reach {
        return (0.0, DVec3::ZERO, DMat3::ZERO);
    }
    let (energy, first, second) = pair_energy_derivatives(distance / reach);
    let u = offset / distance;
    let along = second / (reach * reach);
    let across = first / (reach * distance);
    let outer = DMat3::from_cols(u * u.x, u * u.y, u * u.z);
    (energy, u * (first / reach), outer * (along - across) + DMat3::from_diagonal(DVec3::splat(across)))
}

/// Returns the derivative of a pair's energy with respect to the size of the first particle (per
/// mm). The derivative is zero if the second particle is smaller.
///
/// Eq. 3 holds the sizes fixed, but h changes when a particle moves. Without this term, the energy
/// test of `particles` rejects more than half of the steps where h varies.
pub fn pair_size_derivative(distance: f64, size_i: f64, size_j: f64) -> f64 {
    let d = scaled_distance(distance, size_i, size_j);
    if size_i > size_j || d >= 1.0 { 0.0 } else { -pair_energy_derivatives(d).1 * d / size_i }
}

/// Evaluates Eq. 1 and 4 for eight pairs at once, with a polynomial instead of the tangent.
///
/// With s = d^2, x cot x is an even function of x that vanishes at s = 1, so
/// `cot x = (1 - s) Q(s) / x`. The nearest pole of Q is at s = 4, so each additional degree of a
/// polynomial fit on [0, 1] gains more than one digit of accuracy. The polynomial of degree 10 is
/// within 4e-13 of Q; it was fitted to `x cot x / (1 - s)` at Chebyshev points with 40-digit
/// arithmetic.
///
/// The tests check that the error of the energy E is below 4e-13 (1 + E), and that the relative
/// error is below 8e-13 for the first derivative and below 1.2e-12 for the second, which is cubic
/// in the cotangent. Multiplications and additions are not fused, so every instruction set gives
/// the same bits.
#[derive(Clone, Copy, Debug)]
pub struct Pairs<S: Simd> {
    /// Scaled distance d (Eq. 2), at least [`LEAST_SCALED_DISTANCE`] and at most one. At d = 1 the
    /// energy and both derivatives are exactly zero.
    pub scaled: f64x8<S>,
    /// 1 / d.
    pub reciprocal: f64x8<S>,
    cotangent: f64x8<S>,
}

/// Coefficients of Q(s) in [`Pairs`], lowest degree first.
const COTANGENT: [f64; 11] = [
    1.000_000_000_000_348_4,
    0.177_532_966_491_658_26,
    0.042_242_565_713_562_37,
    0.010_450_539_899_922_473,
    0.002_606_645_289_519_327_7,
    0.000_649_307_573_296_813_2,
    0.000_168_016_919_214_456_34,
    3.132_806_900_649_637e-5,
    2.064_152_164_622_130_3e-5,
    -4.384_031_548_544_181e-6,
    2.922_689_078_988_322e-6,
];

impl<S: Simd> Pairs<S> {
    /// Creates the pairs with the given squared scaled distances.
    #[inline(always)]
    pub fn new(squared: f64x8<S>) -> Self {
        let s = squared.max(LEAST_SCALED_DISTANCE * LEAST_SCALED_DISTANCE).min(1.0);
        let t = s * s;
        // two independent chains for even and odd powers halve the latency
        let [mut even, mut odd] = [COTANGENT[10], COTANGENT[9]].map(|c| f64x8::splat(s.token(), c));
        for power in [8, 6, 4, 2] {
            even = even * t + COTANGENT[power];
            odd = odd * t + COTANGENT[power - 1];
        }
        let q = even * t + COTANGENT[0] + odd * s;
        let scaled = s.sqrt();
        let reciprocal = f64x8::splat(s.token(), 1.0) / scaled;
        let cotangent = (f64x8::splat(s.token(), FRAC_2_PI) - s * FRAC_2_PI) * q * reciprocal;
        Self { scaled, reciprocal, cotangent }
    }

    /// Returns the energy E (Eq. 1).
    #[inline(always)]
    pub fn energy(&self) -> f64x8<S> {
        self.cotangent + (self.scaled - 1.0) * FRAC_PI_2
    }

    /// Returns the first and second derivatives with respect to d (Eq. 4).
    #[inline(always)]
    pub fn derivatives(&self) -> (f64x8<S>, f64x8<S>) {
        let square = self.cotangent * self.cotangent;
        (square * -FRAC_PI_2, self.cotangent * (square + 1.0) * (0.5 * PI * PI))
    }
}

/// Returns the sum of eight lanes, added in the same order on every instruction set.
#[inline(always)]
pub fn sum<S: Simd>(lanes: f64x8<S>) -> f64 {
    let [a, b, c, d, e, f, g, h] = *lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;
    use fearless_simd::{Level, dispatch};

    /// Returns the energy of a particle in an infinite hexagonal lattice, summed over all rings.
    /// `spacing` is in units of h.
    fn energy_by_rows(spacing: f64) -> f64 {
        let mut sum = 0.0;
        for i in -8i32..=8 {
            for j in -8i32..=8 {
                if (i, j) != (0, 0) {
                    let (x, y) = (f64::from(i) + 0.5 * f64::from(j), 0.75f64.sqrt() * f64::from(j));
                    sum += pair_energy(scaled_distance(spacing * x.hypot(y), 1.0, 1.0));
                }
            }
        }
        sum
    }

    #[test]
    fn ideal_energy_is_that_of_the_hexagonal_lattice() {
        assert!((ideal_energy() - 0.7108).abs() < 1e-4, "{}", ideal_energy());
        for (spacing, energy) in [(0.6, 4.60), (0.657, 3.462), (0.8, 1.76), (0.9, 1.12), (1.0, 0.711), (1.1, 0.434)] {
            // the spacings and energies in the table are rounded to three digits
            assert!((lattice_energy(spacing) / energy - 1.0).abs() < 0.005, "{spacing}: {}", lattice_energy(spacing));
            assert!((lattice_energy(spacing) / energy_by_rows(spacing) - 1.0).abs() < 1e-12, "{spacing}");
            assert!((lattice_spacing(lattice_energy(spacing)) - spacing).abs() < 1e-14, "{spacing}");
        }
        assert_eq!(lattice_energy(1.0), ideal_energy());
        assert_eq!(lattice_spacing(ideal_energy()), 1.0);
        assert!((lattice_spacing(PRINTED_IDEAL_ENERGY) - 0.657).abs() < 5e-4);
        assert_eq!([1e300, f64::MIN_POSITIVE].map(|e| (lattice_spacing(e) * 100.0).round()), [5.0, 173.0]);
    }

    #[test]
    fn derivatives_equal_differences() {
        for n in 1..99 {
            let d = f64::from(n) * 0.01;
            let e = 1e-5 * d;
            let (energy, first, second) = pair_energy_derivatives(d);
            assert!((energy - pair_energy(d)).abs() < 1e-14);
            let (up, down) = (pair_energy_derivatives(d + e), pair_energy_derivatives(d - e));
            assert!(((up.0 - down.0) / (2.0 * e) / first - 1.0).abs() < 1e-5, "first at {d}");
            assert!(((up.1 - down.1) / (2.0 * e) / second - 1.0).abs() < 1e-5, "second at {d}");
        }
        assert_eq!(pair_energy_derivatives(1.0), (0.0, 0.0, 0.0));
    }

    #[test]
    fn forces_equal_finite_differences_of_the_energy() {
        for n in 0..200 {
            let random = |stream| uniform(3, stream, n) - 0.5;
            let (hi, hj) = (0.8 + 0.4 * random(4), 0.8 + 0.4 * random(5));
            let offset = DVec3::new(random(0), random(1), random(2)).normalize()
                * (0.2 + 0.75 * uniform(3, 6, n))
                * SUPPORT
                * hi.min(hj);
            let (energy, gradient, hessian) = pair_jet(offset, hi, hj);
            let e = 1e-6;
            for a in 0..3 {
                let step = DVec3::AXES[a] * e;
                let (up, gu, _) = pair_jet(offset + step, hi, hj);
                let (down, gd, _) = pair_jet(offset - step, hi, hj);
                let scale = 1.0 + gradient.length();
                assert!(((up - down) / (2.0 * e) - gradient[a]).abs() < 1e-5 * scale);
                let scale = 1.0 + hessian.col(a).length();
                assert!(((gu - gd) / (2.0 * e) - hessian.col(a)).length() < 1e-5 * scale);
            }
            let pair = |size: f64| pair_energy(scaled_distance(offset.length(), size, hj));
            assert!((energy - pair(hi)).abs() < 1e-12);
            if (hi - hj).abs() > 2.0 * e {
                let want = (pair(hi + e) - pair(hi - e)) / (2.0 * e);
                assert!((pair_size_derivative(offset.length(), hi, hj) - want).abs() < 1e-5 * (1.0 + want.abs()));
            }
        }
    }

    /// Returns the energy and its first and second derivatives at eight squared scaled distances,
    /// computed with [`Pairs`].
    fn by_lanes(level: Level, squared: [f64; 8]) -> [[f64; 8]; 3] {
        #[inline(always)]
        fn jets<S: Simd>(simd: S, squared: [f64; 8]) -> [[f64; 8]; 3] {
            let pairs = Pairs::new(f64x8::simd_from(simd, squared));
            let (first, second) = pairs.derivatives();
            [*pairs.energy(), *first, *second]
        }
        dispatch!(level, simd => jets(simd, squared))
    }

    #[test]
    fn simd_lanes_match_the_exact_functions_at_every_level() {
        let levels = [Level::new(), Level::baseline()];
        let mut worst = [0.0f64; 3];
        for n in 0..20_000 {
            let d: [f64; 8] = std::array::from_fn(|lane| {
                let part = (f64::from(n) + lane as f64 / 8.0) / 20_000.0;
                // distances that are evenly spread, or clustered at one end of the range
                [part, 1e-6f64.powf(part), 1.0 - 1e-6f64.powf(part)][n as usize % 3].max(LEAST_SCALED_DISTANCE)
            });
            let found = by_lanes(levels[0], d.map(|d| d * d));
            assert_eq!(found, by_lanes(levels[1], d.map(|d| d * d)));
            for (lane, &d) in d.iter().enumerate() {
                let (energy, first, second) = pair_energy_derivatives(d);
                worst[0] = worst[0].max((found[0][lane] - energy).abs() / (1.0 + energy));
                for (a, want) in [(1, first), (2, second)] {
                    // d is the root of a rounded square: 1 - d has an error of 1e-16, and the
                    // cotangent has a relative error of 1e-16 / (1 - d)
                    let rounding = 1e-15 / (1.0 - d).max(1e-15);
                    worst[a] = worst[a]
                        .max((found[a][lane] / want.abs().max(f64::MIN_POSITIVE) - want.signum()).abs() - rounding);
                }
            }
        }
        println!("{worst:?}");
        assert!(worst[0] < 4e-13 && worst[1] < 8e-13 && worst[2] < 1.2e-12, "{worst:?}");
        for squared in [1.0, 1.5, 1e200, f64::INFINITY] {
            assert_eq!(by_lanes(levels[0], [squared; 8]), [[0.0; 8]; 3]);
        }
        let least = by_lanes(levels[0], [0.0; 8]);
        assert!(least[0][0].is_finite() && least[1][0].is_finite() && least[2][0].is_finite());
    }
}
