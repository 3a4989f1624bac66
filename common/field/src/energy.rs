//! The inter-particle energy: Eq. 1, 2 and 4 of Kim, Chen and Hansen 2012 (after Meyer, Georgel and Whitaker 2005).
//!
//! With x = d pi/2 and c = cot x the pair energy is `c + x - pi/2`, its first derivative in d `-(pi/2) c^2` (Eq. 4
//! rewritten by 1 - 1/sin^2 = -cot^2) and its second `(pi^2/2) c (1 + c^2)`: one tangent serves all three.
//! Eq. 2 prints 2 cos(pi/2), which is zero; the factor is 2 cos(pi/6) = sqrt(3), which puts the second ring of the
//! hexagonal lattice of spacing h exactly at the cut-off d = 1.

use glam::{DMat3, DVec3};
use std::f64::consts::{FRAC_PI_2, PI};

/// 2 cos(pi/6): interactions reach this many target edge lengths (Eq. 2).
pub const SUPPORT: f64 = 1.732_050_807_568_877_2;

/// Two particles nearer than this share of their support count as this far apart, so that energy and forces are finite.
pub const LEAST_SCALED_DISTANCE: f64 = 1e-6;

/// The printed ideal energy of section 3.3; six times the ideal *distance*, not the energy of Eq. 1.
pub const PRINTED_IDEAL_ENERGY: f64 = 3.462;

/// Energy of a particle whose six neighbours lie on the hexagonal lattice of spacing h: 6 E(1/sqrt(3)) = 0.7108.
pub fn ideal_energy() -> f64 {
    6.0 * pair_energy(1.0 / SUPPORT)
}

/// Distance of two particles scaled by the smaller of their target edge lengths (Eq. 2), dimensionless.
pub fn scaled_distance(distance: f64, size_i: f64, size_j: f64) -> f64 {
    distance / (SUPPORT * size_i.min(size_j))
}

/// Pair energy at scaled distance d (Eq. 1); infinite at d = 0, zero from d = 1 on.
pub fn pair_energy(d: f64) -> f64 {
    if d >= 1.0 {
        return 0.0;
    }
    let x = d * FRAC_PI_2;
    1.0 / x.tan() + x - FRAC_PI_2
}

/// Pair energy with its first and second derivative in the scaled distance (Eq. 1 and 4).
pub fn pair_energy_derivatives(d: f64) -> (f64, f64, f64) {
    if d >= 1.0 {
        return (0.0, 0.0, 0.0);
    }
    let x = d * FRAC_PI_2;
    let c = 1.0 / x.tan();
    (c + x - FRAC_PI_2, -FRAC_PI_2 * c * c, 0.5 * PI * PI * c * (1.0 + c * c))
}

/// Energy, gradient (per mm) and Hessian (per mm squared) of one pair with respect to the first particle's position,
/// both sizes held fixed. `offset` is p_i - p_j (mm).
///
/// The Hessian has both terms: the second derivative along the pair and the first derivative over the distance
/// across it.
pub fn pair_jet(offset: DVec3, size_i: f64, size_j: f64) -> (f64, DVec3, DMat3) {
    let reach = SUPPORT * size_i.min(size_j);
    // Two particles on one spot still need a direction to part along: any will do, the damping bounds the step.
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

/// Derivative of a pair's energy with respect to the first particle's size (per mm): zero where the other is smaller.
///
/// Eq. 3 holds the sizes fixed; but a particle that moves changes its own h, and steps that leave this out are refused
/// by the energy test wherever h varies.
pub fn pair_size_derivative(distance: f64, size_i: f64, size_j: f64) -> f64 {
    let d = scaled_distance(distance, size_i, size_j);
    if size_i > size_j || d >= 1.0 { 0.0 } else { -pair_energy_derivatives(d).1 * d / size_i }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;

    /// Energy of an infinite hexagonal lattice of the given spacing (in units of h), every ring summed.
    fn lattice_energy(spacing: f64) -> f64 {
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
            // the table is rounded to three digits, in the spacing too
            assert!((lattice_energy(spacing) / energy - 1.0).abs() < 0.005, "{spacing}: {}", lattice_energy(spacing));
        }
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
}
