//! Exact orientation and in-sphere tests. A floating-point filter decides most cases. The remaining
//! cases are decided in integer arithmetic (`exact.rs`), or by Shewchuk's adaptive predicates
//! (crate `robust`) if the integers would have too many bits. The symbolic perturbation of
//! Devillers and Teillaud (2003) breaks exact ties of the in-sphere test.
//!
//! Filter bounds: a determinant is a sum of monomials, and each monomial undergoes a known number
//! of roundings. Let mx, my and mz bound the absolute coordinate differences along the three axes,
//! and let m be the largest of these bounds. The orientation has 6 monomials with at most 8
//! roundings each, so its error is at most 48 * 2^-53 mx my mz. The in-sphere determinant has 72
//! monomials with at most 16 roundings each, so its error is at most 1152 * 2^-53 mx my mz m^2. The
//! in-sphere test first tries a coarser bound, which replaces mx, my, mz and m with the length of
//! the longest difference. The constants below are rounded up by more than the rounding errors of
//! the bounds themselves.

use super::exact;
use glam::DVec3;
use robust::Coord3D;

/// Error bound of the orientation: 48 * 2^-53 = 5.33e-15, rounded up.
const ORIENTATION_BOUND: f64 = 5.5e-15;
/// Error bound of the in-sphere determinant: 1152 * 2^-53 = 1.279e-13, rounded up.
const IN_SPHERE_BOUND: f64 = 1.3e-13;

fn coordinates(p: DVec3) -> Coord3D<f64> {
    Coord3D { x: p.x, y: p.y, z: p.z }
}

/// Returns a number with the exact sign of (b - a) x (c - a) . (d - a). The sign is positive if b,
/// c, d are counter-clockwise as seen from the side of their plane that does not contain a (VTK's
/// vertex order). Only the sign is meaningful; use [`volume`] for the value.
#[inline]
pub fn orientation(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    let (u, v, w) = (b - a, c - a, d - a);
    let determinant = w.dot(u.cross(v));
    let m = u.abs().max(v.abs()).max(w.abs());
    let bound = ORIENTATION_BOUND * (m.x * m.y * m.z);
    if determinant.abs() > bound {
        return determinant;
    }
    orientation_of_flat(a, b, c, d)
}

/// Computes (b - a) x (c - a) . (d - a), six times the signed volume of the tetrahedron. The sign
/// is exact. The relative error of the value is small even for flat tetrahedra.
pub fn volume(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    -robust::orient3d(coordinates(a), coordinates(b), coordinates(c), coordinates(d))
}

#[cold]
#[inline(never)]
fn orientation_of_flat(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    exact::orientation_sign(&[a, b, c, d]).unwrap_or_else(|| volume(a, b, c, d))
}

/// Returns a number with the exact sign of the in-sphere determinant. The sign is positive if e
/// lies inside the circumsphere of the positively oriented tetrahedron a, b, c, d. The result is
/// zero if e lies on the sphere.
#[inline]
pub fn in_sphere(a: DVec3, b: DVec3, c: DVec3, d: DVec3, e: DVec3) -> f64 {
    let (p, q, r, s) = (a - e, b - e, c - e, d - e);
    let pq = p.x * q.y - q.x * p.y;
    let qr = q.x * r.y - r.x * q.y;
    let rs = r.x * s.y - s.x * r.y;
    let sp = s.x * p.y - p.x * s.y;
    let pr = p.x * r.y - r.x * p.y;
    let qs = q.x * s.y - s.x * q.y;
    let pqr = p.z * qr - q.z * pr + r.z * pq;
    let qrs = q.z * rs - r.z * qs + s.z * qr;
    let rsp = r.z * sp + s.z * pr + p.z * rs;
    let spq = s.z * pq + p.z * qs + q.z * sp;
    let (p2, q2, r2, s2) = (p.length_squared(), q.length_squared(), r.length_squared(), s.length_squared());
    let determinant = (r2 * spq - s2 * pqr) + (p2 * qrs - q2 * rsp);
    // the length of the longest difference bounds the coordinates of all differences
    let longest = p2.max(q2).max(r2.max(s2));
    if determinant.abs() > IN_SPHERE_BOUND * (longest * longest) * longest.sqrt() {
        return determinant;
    }
    in_sphere_near_zero(determinant, [a, b, c, d, e])
}

/// Computes [`in_sphere`] where the coarse bound does not decide the sign of the determinant.
#[cold]
#[inline(never)]
fn in_sphere_near_zero(determinant: f64, [a, b, c, d, e]: [DVec3; 5]) -> f64 {
    if determinant != 0.0 {
        let (p, q, r, s) = (a - e, b - e, c - e, d - e);
        let m = p.abs().max(q.abs()).max(r.abs()).max(s.abs());
        let largest = m.max_element();
        if determinant.abs() > IN_SPHERE_BOUND * (m.x * m.y * m.z) * (largest * largest) {
            return determinant;
        }
    }
    let expansion =
        || -robust::insphere(coordinates(a), coordinates(b), coordinates(c), coordinates(d), coordinates(e));
    exact::in_sphere_sign(&[a, b, c, d, e]).unwrap_or_else(expansion)
}

/// Returns whether `points[4]` lies inside the circumsphere of the positively oriented tetrahedron
/// `points[0..4]`, and breaks ties by rank. Each point is raised above the paraboloid
/// `(x, y, z, x^2 + y^2 + z^2)` by an infinitesimal amount; a larger rank means an infinitely
/// larger amount. The amount depends only on the rank, so all results are consistent with one
/// regular triangulation. The cells of this triangulation are never flat, and its cavities are
/// star-shaped. Points and ranks must be distinct.
#[inline]
pub fn in_sphere_perturbed(points: &[DVec3; 5], ranks: impl FnOnce() -> [u32; 5]) -> bool {
    let [a, b, c, d, e] = *points;
    let exact = in_sphere(a, b, c, d, e);
    if exact != 0.0 { exact > 0.0 } else { break_tie(points, ranks()) }
}

#[cold]
fn break_tie(points: &[DVec3; 5], ranks: [u32; 5]) -> bool {
    let [a, b, c, d, e] = *points;
    let mut largest = None;
    for _ in 0..5 {
        // the point with the next lower rank; the first point usually decides
        let below = (0..5).filter(|&i| largest.is_none_or(|above| ranks[i] < ranks[above]));
        largest = below.max_by_key(|&i| ranks[i]);
        // If a vertex is raised, the hyperplane through the vertices rises at e in proportion to
        // the barycentric coordinate of e for that vertex. The result has the sign of that
        // coordinate.
        let sign = match largest {
            Some(0) => orientation(e, b, c, d),
            Some(1) => orientation(a, e, c, d),
            Some(2) => orientation(a, b, e, d),
            Some(3) => orientation(a, b, c, e),
            _ => return false,
        };
        if sign != 0.0 {
            return sign > 0.0;
        }
    }
    false
}

/// Returns whether three points lie exactly on one line.
pub fn collinear(a: DVec3, b: DVec3, c: DVec3) -> bool {
    let flat = |i: usize, j: usize| {
        let at = |p: DVec3| robust::Coord { x: p[i], y: p[j] };
        robust::orient2d(at(a), at(b), at(c)) == 0.0
    };
    flat(0, 1) && flat(1, 2) && flat(0, 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;

    fn point(seed: u64, n: u64) -> DVec3 {
        DVec3::new(uniform(seed, 0, n), uniform(seed, 1, n), uniform(seed, 2, n))
    }

    #[test]
    fn signs_follow_the_convention() {
        let (a, b, c, d) = (DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z);
        assert!(orientation(a, b, c, d) > 0.0 && orientation(a, c, b, d) < 0.0);
        assert!(in_sphere(a, b, c, d, DVec3::splat(0.4)) > 0.0);
        assert!(in_sphere(a, b, c, d, DVec3::splat(1.1)) < 0.0);
        assert_eq!(in_sphere(a, b, c, d, DVec3::ONE), 0.0);
        assert!(collinear(DVec3::ZERO, DVec3::ONE, DVec3::splat(3.0)) && !collinear(a, b, c));
    }

    #[test]
    fn the_filter_never_contradicts_the_exact_predicates() {
        // at points slightly off degenerate positions, a wrong error bound would give wrong signs
        for n in 0..20_000u64 {
            let q = |k: u64| {
                let coarse = (point(1, 5 * n + k) * 4.0).floor();
                coarse + point(2, 5 * n + k) * 10f64.powi(-((n % 18) as i32))
            };
            let p: [DVec3; 5] = std::array::from_fn(|k| q(k as u64));
            let [a, b, c, d, e] = p.map(coordinates);
            let sign = |x: f64| if x == 0.0 { 0.0 } else { x.signum() };
            assert_eq!(sign(orientation(p[0], p[1], p[2], p[3])), -sign(robust::orient3d(a, b, c, d)));
            assert_eq!(sign(in_sphere(p[0], p[1], p[2], p[3], p[4])), -sign(robust::insphere(a, b, c, d, e)));
        }
    }

    /// The test must be symmetric for two adjacent tetrahedra: e is in conflict with the
    /// tetrahedron abcd if and only if d is in conflict with the tetrahedron with vertices a, b, c
    /// and e.
    #[test]
    fn perturbed_test_is_symmetric() {
        let mut ties = 0;
        for n in 0..40_000u64 {
            let p: [DVec3; 5] = std::array::from_fn(|k| (point(3, 5 * n + k as u64) * 3.0).floor());
            let [a, b, c, d, e] = p;
            if orientation(a, b, c, d) > 0.0 && orientation(a, b, c, e) < 0.0 {
                ties += u32::from(in_sphere(a, b, c, d, e) == 0.0);
                let one = in_sphere_perturbed(&[a, b, c, d, e], || [0, 1, 2, 3, 4]);
                let other = in_sphere_perturbed(&[a, c, b, e, d], || [0, 2, 1, 4, 3]);
                assert_eq!(one, other, "{p:?}");
            }
        }
        assert!(ties > 500, "only {ties} ties were met");
    }
}
