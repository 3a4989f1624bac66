//! Computes the exact signs of the orientation and in-sphere determinants in integer arithmetic.
//! This module handles the inputs that the floating-point filters cannot decide, such as
//! cospherical and coplanar points.
//!
//! Every double is an integer times a power of two. In units of the lowest set bit of all
//! coordinates, the coordinate differences of nearby points therefore have few bits. They fit in 62
//! bits unless some coordinate is tiny compared with the distances between the points. The two
//! determinants then fit in 189 and 317 bits, and a few dozen multiplications evaluate them
//! exactly. Adaptive floating-point expansions are about a hundred times slower. The cofactors are
//! the same as in the filters of [`super::predicates`].

use glam::DVec3;

/// Maximum number of bits of a coordinate difference, excluding the sign. The orientation
/// determinant, a sum of 6 products of 3 differences, then has 3 * 62 + log2(6) < 189 bits. The
/// in-sphere determinant, a sum of 72 products of 5 differences, has 5 * 62 + log2(72) < 317 bits.
const DIFFERENCE_BITS: u32 = 62;

/// Maximum number of bits per difference for which the in-sphere determinant fits in an `i64`: the
/// determinant then has at most 5 * 11 + log2(72) < 62 bits. Differences of grid points are usually
/// this small.
const SMALL_BITS: u32 = 11;

type Difference = [i64; 3];

/// Returns the sign of (b - a) x (c - a) . (d - a), or `None` if the differences have too many
/// bits.
pub(super) fn orientation_sign(points: &[DVec3; 4]) -> Option<f64> {
    let [p, q, r] = differences::<4, 3>(points)?;
    // The differences are relative to d instead of a, so the determinant has the opposite sign.
    Some(sign(-i32::from(volume(p, q, r).signum())))
}

/// Returns the sign of the in-sphere determinant of five points. The sign is positive if the last
/// point lies inside the sphere through the first four, which must be positively oriented. Returns
/// `None` if the differences have too many bits.
pub(super) fn in_sphere_sign(points: &[DVec3; 5]) -> Option<f64> {
    let [p, q, r, s] = differences::<5, 4>(points)?;
    if [p, q, r, s].as_flattened().iter().all(|x| x.unsigned_abs() >> SMALL_BITS == 0) {
        return Some(sign(small_in_sphere(p, q, r, s).signum() as i32));
    }
    let mut sum = Sum::default();
    sum.add(length_squared(r), volume(s, p, q), 1);
    sum.add(length_squared(s), volume(p, q, r), -1);
    sum.add(length_squared(p), volume(q, r, s), 1);
    sum.add(length_squared(q), volume(r, s, p), -1);
    Some(sign(sum.signum()))
}

fn sign(signum: i32) -> f64 {
    f64::from(signum)
}

/// Returns the coordinates of the other points relative to the last point, as integers in units of
/// the lowest set bit. Returns `None` if a difference has more than [`DIFFERENCE_BITS`] bits.
fn differences<const POINTS: usize, const OTHERS: usize>(points: &[DVec3; POINTS]) -> Option<[Difference; OTHERS]> {
    let last = points[POINTS - 1].to_array();
    let mut rounded = [[0.0; 3]; OTHERS];
    let mut exact = true;
    for (point, to) in points.iter().zip(&mut rounded) {
        for ((to, x), base) in to.iter_mut().zip(point.to_array()).zip(last) {
            *to = x - base;
            // exact rounding error of the subtraction (Knuth 1969)
            let taken = x - *to;
            exact &= (x - (*to + taken)) + (taken - base) == 0.0;
        }
    }
    if !exact {
        return differences_of_integers(points);
    }
    let scale = scale(rounded.iter().flatten())?;
    let mut all = [[0i64; 3]; OTHERS];
    for (to, x) in all.iter_mut().flatten().zip(rounded.iter().flatten()) {
        let x = x * scale;
        if x.abs() >= (1u64 << DIFFERENCE_BITS) as f64 {
            return None;
        }
        *to = x as i64;
    }
    Some(all)
}

/// Computes the same result as [`differences`] for points whose differences are inexact in double
/// precision. The coordinates are converted to integers before the subtraction.
fn differences_of_integers<const POINTS: usize, const OTHERS: usize>(
    points: &[DVec3; POINTS],
) -> Option<[Difference; OTHERS]> {
    let points = points.map(|p| p.to_array());
    let scale = scale(points.iter().flatten())?;
    // Numbers below 2^100 can be subtracted in an `i128` without overflow. For points with larger
    // coordinates, the caller uses the adaptive expansion.
    let whole = |x: f64| Some(x * scale).filter(|x| x.abs() < 2f64.powi(100)).map(|x| x as i128);
    let mut base = [0i128; 3];
    for (to, x) in base.iter_mut().zip(points[POINTS - 1]) {
        *to = whole(x)?;
    }
    let mut all = [[0i64; 3]; OTHERS];
    for (point, to) in points.iter().zip(&mut all) {
        for ((to, &x), base) in to.iter_mut().zip(point).zip(base) {
            let difference = whole(x)? - base;
            if difference.unsigned_abs() >> DIFFERENCE_BITS != 0 {
                return None;
            }
            *to = difference as i64;
        }
    }
    Some(all)
}

/// Returns the smallest power of two that scales all numbers to integers, or `None` if this power
/// is out of range.
fn scale<'a>(numbers: impl Iterator<Item = &'a f64>) -> Option<f64> {
    let least = numbers.filter(|&&x| x != 0.0).map(|&x| least_exponent(x)).min().unwrap_or(0);
    u64::try_from(1023 - least).ok().filter(|&biased| biased < 2047).map(|biased| f64::from_bits(biased << 52))
}

/// Returns the exponent of the lowest set bit of a normal number.
fn least_exponent(x: f64) -> i32 {
    let bits = x.to_bits();
    let exponent = ((bits >> 52) & 0x7ff) as i32 - 1023;
    exponent - 52 + ((bits | 1 << 52).trailing_zeros() as i32)
}

/// A wide integer with the value `high` * 2^64 + `low`.
#[derive(Clone, Copy)]
struct Wide {
    high: i128,
    low: u64,
}

impl Wide {
    fn signum(self) -> i8 {
        if self.high == 0 { i8::from(self.low != 0) } else { self.high.signum() as i8 }
    }
}

/// Computes p x q . r, with the sign convention of the 3 x 3 minors in the filter.
fn volume(p: Difference, q: Difference, r: Difference) -> Wide {
    let minor =
        |a: Difference, b: Difference| i128::from(a[0]) * i128::from(b[1]) - i128::from(b[0]) * i128::from(a[1]);
    let (mut high, mut low) = (0i128, 0u128);
    for (z, minor) in [(r[2], minor(p, q)), (p[2], minor(q, r)), (q[2], minor(r, p))] {
        let z = i128::from(z);
        let least = z * i128::from(minor as u64);
        high += z * (minor >> 64) + (least >> 64);
        low += u128::from(least as u64);
    }
    Wide { high: high + (low >> 64) as i128, low: low as u64 }
}

/// Computes the in-sphere determinant of differences that have at most [`SMALL_BITS`] bits.
fn small_in_sphere(p: Difference, q: Difference, r: Difference, s: Difference) -> i64 {
    let minor = |a: Difference, b: Difference| a[0] * b[1] - b[0] * a[1];
    let volume = |p, q, r| -> i64 {
        let [top, middle, bottom]: [Difference; 3] = [p, q, r];
        bottom[2] * minor(p, q) + top[2] * minor(q, r) + middle[2] * minor(r, p)
    };
    let length_squared = |p: Difference| p.iter().map(|x| x * x).sum::<i64>();
    length_squared(r) * volume(s, p, q) - length_squared(s) * volume(p, q, r) + length_squared(p) * volume(q, r, s)
        - length_squared(q) * volume(r, s, p)
}

fn length_squared(p: Difference) -> u128 {
    p.iter().map(|&x| u128::from(x.unsigned_abs()).pow(2)).sum()
}

/// A sum of products in base 2^64. Each digit is an `i128`, so many terms can be added before
/// carries are propagated.
#[derive(Default)]
struct Sum([i128; 5]);

impl Sum {
    fn add(&mut self, length: u128, volume: Wide, sign: i128) {
        let length = [length as u64, (length >> 64) as u64].map(i128::from);
        let volume = [i128::from(volume.low), i128::from(volume.high as u64), volume.high >> 64];
        for (i, l) in length.into_iter().enumerate() {
            // only the highest word of the volume is signed; products of the other words need all
            // 128 bits
            for (j, v) in volume[..2].iter().enumerate() {
                let product = (l as u128) * (*v as u128);
                self.0[i + j] += sign * i128::from(product as u64);
                self.0[i + j + 1] += sign * (product >> 64) as i128;
            }
            let product = l * volume[2];
            self.0[i + 2] += sign * i128::from(product as u64);
            self.0[i + 3] += sign * (product >> 64);
        }
    }

    fn signum(mut self) -> i32 {
        let mut zero = true;
        for k in 0..4 {
            zero &= self.0[k] as u64 == 0;
            self.0[k + 1] += self.0[k] >> 64;
        }
        if self.0[4] == 0 && !zero { 1 } else { self.0[4].signum() as i32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::{bits, uniform};
    use robust::Coord3D;

    fn shewchuk(points: &[DVec3; 5]) -> (f64, f64) {
        let [a, b, c, d, e] = points.map(|p| Coord3D { x: p.x, y: p.y, z: p.z });
        let sign = |x: f64| if x == 0.0 { 0.0 } else { -x.signum() };
        (sign(robust::orient3d(a, b, c, d)), sign(robust::insphere(a, b, c, d, e)))
    }

    fn compare(points: &[DVec3; 5]) -> (Option<f64>, Option<f64>) {
        let (side, inside) = shewchuk(points);
        let [a, b, c, d, _] = *points;
        let ours = (orientation_sign(&[a, b, c, d]), in_sphere_sign(points));
        assert!(ours.0.is_none_or(|s| s == side), "{points:?}: {ours:?}, {side}");
        assert!(ours.1.is_none_or(|s| s == inside), "{points:?}: {ours:?}, {inside}");
        ours
    }

    #[test]
    fn integers_agree_with_expansions_near_and_at_ties() {
        let (mut decided, mut ties) = (0, 0);
        for n in 0..20_000u64 {
            let points: [DVec3; 5] = std::array::from_fn(|k| {
                let number = 5 * n + k as u64;
                let at = |stream| (uniform(1, stream, number) * 4.0).floor() - 1.0;
                let off = |stream| uniform(2, stream, number) * 10f64.powi(-((n % 17) as i32));
                let share = if n % 3 == 0 { 0.0 } else { 1.0 };
                DVec3::new(at(0) + share * off(0), at(1) + share * off(1), at(2) + share * off(2))
            });
            let (_, inside) = compare(&points);
            decided += u32::from(inside.is_some());
            ties += u32::from(inside == Some(0.0));
        }
        assert!(decided > 8_000 && ties > 500, "{decided} decided, {ties} ties");
    }

    #[test]
    fn rounded_spheres_are_decided() {
        let mut decided = 0;
        for n in 0..4000u64 {
            let points: [DVec3; 5] = std::array::from_fn(|k| {
                let coordinate = |stream| uniform(7, stream, 5 * n + k as u64) - 0.5;
                DVec3::new(coordinate(0), coordinate(1), coordinate(2)).normalize() * 50.0 + 100.0
            });
            decided += u32::from(compare(&points).1.is_some());
        }
        assert!(decided > 3900, "{decided}");
    }

    #[test]
    fn the_largest_differences_do_not_overflow() {
        // corners of a box with an edge of 2^62 - 1024 units; a random bit decides whether 1 unit
        // (at the lower end) or 512 units (at the upper end) are added to each coordinate
        let edge = 2f64.powi(62);
        for n in 0..4000u64 {
            let points: [DVec3; 5] = std::array::from_fn(|k| {
                let random = bits(9, k as u64, n);
                let coordinate = |axis: u64| {
                    let (corner, step) = if random >> axis & 1 == 0 { (0.0, 1.0) } else { (edge - 1024.0, 512.0) };
                    corner + (random >> (8 + 8 * axis) & 1) as f64 * step
                };
                DVec3::new(coordinate(0), coordinate(1), coordinate(2)) * 2f64.powi((n % 200) as i32 - 160)
            });
            compare(&points);
        }
        for n in 0..4000u64 {
            let points: [DVec3; 5] = std::array::from_fn(|k| {
                let random = bits(10, k as u64, n);
                let coordinate =
                    |axis: u64| if random >> axis & 1 == 0 { 0.0 } else { 2047.0 + (random >> 9 & 1) as f64 };
                DVec3::new(coordinate(0), coordinate(1), coordinate(2))
            });
            assert!(compare(&points).1.is_some());
        }
        let wide = [DVec3::ZERO, DVec3::X * 1e30, DVec3::Y, DVec3::Z, DVec3::splat(1e-30)];
        assert_eq!(compare(&wide), (None, None));
    }
}
