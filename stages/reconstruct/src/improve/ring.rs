//! Computes the minimum radius ratio of the triangles around a vertex for eight positions of the
//! vertex at once (SIMD). The surface is approximated by a paraboloid.

use super::site::Site;
use fearless_simd::{Simd, f64x8, prelude::*};
use glam::DVec3;

/// Number of positions that are evaluated together.
pub(super) const LANES: usize = 8;

/// The edge opposite the vertex in one triangle. `ends`: coordinates of its ends relative to the
/// vertex, along the two axes of the tangent plane and the normal. `length`: length of the edge.
/// All in mm.
struct Side {
    ends: [[f64; 3]; 2],
    length: f64,
}

/// The triangles around a vertex, and the paraboloid that approximates the surface to second order.
pub(super) struct Ring {
    sides: Vec<Side>,
    /// Second derivatives of the paraboloid (xx, xy, yy; per mm), see [`Site::bend`].
    bend: [f64; 3],
}

impl Ring {
    /// Returns the ring of a site.
    pub(super) fn of(site: &Site) -> Self {
        let [e1, e2] = site.axes;
        let seen = |p: DVec3| [e1.dot(p - site.start), e2.dot(p - site.start), site.normal.dot(p - site.start)];
        let side = |&(a, b): &(DVec3, DVec3)| Side { ends: [seen(a), seen(b)], length: a.distance(b) };
        Self { sides: site.ring.iter().map(side).collect(), bend: site.bend }
    }

    /// Returns the minimum radius ratio of the triangles for each of eight positions of the vertex.
    /// `along` contains the coordinates of the positions in the tangent plane (mm). The ratio of a
    /// triangle turned against the normal is reduced by 1.
    ///
    /// The ratio of a triangle with sides x, y and c is
    /// (y + c - x) (c + x - y) (x + y - c) / (x y c). Multiplications and additions are not fused,
    /// so all instruction sets give identical results.
    #[inline(always)]
    pub(super) fn smallest_ratios<S: Simd>(&self, simd: S, along: [[f64; LANES]; 2]) -> [f64; LANES] {
        let (u, v) = (f64x8::simd_from(simd, along[0]), f64x8::simd_from(simd, along[1]));
        let [xx, xy, yy] = self.bend;
        let w = (u * u * xx + v * v * yy) * -0.5 - u * v * xy;
        let zero = f64x8::splat(simd, 0.0);
        let mut least = zero + 1.0;
        for Side { ends: [a, b], length } in &self.sides {
            let [x, y] = [distance([u, v, w], a), distance([u, v, w], b)];
            let factors = (y - x + *length) * (x - y + *length) * (x + y - *length);
            let ratio = factors / (x * y * *length);
            // twice the area of the projection onto the tangent plane
            let area = zero + (a[0] * b[1] - a[1] * b[0]) - u * (b[1] - a[1]) + v * (b[0] - a[0]);
            least = least.min(area.simd_gt(zero).select(ratio, ratio - 1.0));
        }
        *least
    }
}

/// Returns the distances of eight positions from a point. This is not a closure, because a closure
/// would not be compiled for the selected instruction set.
#[inline(always)]
fn distance<S: Simd>([u, v, w]: [f64x8<S>; 3], end: &[f64; 3]) -> f64x8<S> {
    let (x, y, z) = (u - end[0], v - end[1], w - end[2]);
    (x * x + y * y + z * z).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interfaces::OBJECT;
    use fearless_simd::{Level, dispatch};
    use glam::DVec2;
    use isoparticles_field::random::uniform;
    use isoparticles_mesh::quality::radius_ratio;

    #[test]
    fn all_instruction_sets_give_the_exact_radius_ratios() {
        let random = |n: u64, k: u64| uniform(5, k, n) - 0.5;
        for n in 0..100 {
            let start = DVec3::new(random(n, 0), random(n, 1), random(n, 2));
            let normal = DVec3::new(random(n, 3), random(n, 4), 1.0).normalize();
            let axes = <[DVec3; 2]>::from(normal.any_orthonormal_pair());
            let corner = |k: u64| {
                let place = DVec2::from_angle(std::f64::consts::TAU * k as f64 / 6.0) + 0.5 * random(n, 10 + k);
                start + axes[0] * place.x + axes[1] * place.y + normal * (0.3 * random(n, 20 + k))
            };
            let site = Site {
                start,
                pair: OBJECT,
                normal,
                axes,
                bend: [5, 6, 7].map(|k| random(n, k)),
                ring: (0..6).map(|k| (corner(k), corner((k + 1) % 6))).collect(),
                reach: 1.0,
            };
            let along: [[f64; LANES]; 2] =
                [0, 1].map(|axis| std::array::from_fn(|lane| 1.2 * random(n, 30 + 2 * lane as u64 + axis)));
            let ring = Ring::of(&site);
            let found = dispatch!(Level::new(), simd => ring.smallest_ratios(simd, along));
            assert_eq!(found, dispatch!(Level::baseline(), simd => ring.smallest_ratios(simd, along)));
            for lane in 0..LANES {
                let p = site.place(DVec2::new(along[0][lane], along[1][lane]));
                let is_turned = |a: DVec3, b: DVec3| (a - p).cross(b - p).dot(normal) <= 0.0;
                let worth = |&(a, b): &(DVec3, DVec3)| radius_ratio(p, a, b) - f64::from(u8::from(is_turned(a, b)));
                let expected = site.ring.iter().map(worth).fold(1.0, f64::min);
                assert!((found[lane] - expected).abs() < 1e-12, "{n} {lane}: {} {expected}", found[lane]);
            }
        }
    }
}
