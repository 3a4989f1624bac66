//! Fits least-squares patches to the surface. A patch is a quadric over the tangent plane of a
//! sample, fitted to the samples around it.
//!
//! This is a second-order jet fit (Cazals and Pouget 2005). The residual of a patch consists of
//! noise and of shape that a quadric cannot represent.

use crate::connections::Connections;
use glam::{DMat3, DVec2, DVec3};

/// Minimum cosine of the angle between the normal of a sample and the normal of the central sample.
/// Samples with larger angles are assumed to belong to another part of the surface. On a ball, the
/// angle is 60 degrees if the chord equals the radius, so the radius of a patch can be as large as
/// the radius of curvature.
const LEAST_COSINE: f64 = 0.5;

/// Minimum number of samples of a patch: three more than the number of unknowns, so that the
/// residual has degrees of freedom. A minimum of 7 gives the same feature sizes on balls, tori and
/// an ellipsoid.
const FEWEST_SAMPLES: usize = UNKNOWNS + 3;

/// Number of coefficients of a patch: height, two slopes and three second derivatives.
const UNKNOWNS: usize = 6;

/// The surface around a sample, to second order.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Point of the patch on the line through the sample along the mean normal, in mm in the grid
    /// frame.
    pub point: DVec3,
    /// Outward unit normal at the point.
    pub normal: DVec3,
    /// Curvature tensor at the point, in 1/mm. The eigenvalues are 0 (along the normal) and the
    /// principal curvatures, which are positive on a ball.
    pub curvature: DMat3,
    /// Weighted root mean square distance from the samples to the patch along the mean normal, mm.
    pub residual: f64,
}

/// Samples of a surface and their connections.
pub struct Samples<'a> {
    /// Positions in mm in the grid frame.
    pub points: &'a [DVec3],
    /// Unit normals, outward.
    pub normals: &'a [DVec3],
    /// Adjacency by triangle edges.
    pub connections: &'a Connections,
}

/// Marks of the samples that a breadth-first search has visited.
pub struct Marks {
    seen: Vec<u32>,
    now: u32,
    found: Vec<u32>,
}

impl Marks {
    /// Returns marks for `samples` samples.
    pub fn new(samples: usize) -> Self {
        Self { seen: vec![0; samples], now: 0, found: Vec::new() }
    }
}

impl Samples<'_> {
    /// Fits a patch to the samples that lie within `radius` (mm) of sample i and are connected to
    /// it. Returns `None` if there are too few samples or the system is singular.
    pub fn patch(&self, i: usize, radius: f64, marks: &mut Marks) -> Option<Patch> {
        self.gather(i, radius, marks);
        if marks.found.len() < FEWEST_SAMPLES {
            return None;
        }
        let origin = self.points[i];
        let weight = |p: DVec3| 1.0 - p.distance_squared(origin) / (radius * radius);
        let sum: DVec3 = marks.found.iter().map(|&j| self.normals[j as usize] * weight(self.points[j as usize])).sum();
        let up = sum.try_normalize()?;
        let (e1, e2) = up.any_orthonormal_pair();
        let mut system = [[0.0; UNKNOWNS + 1]; UNKNOWNS];
        let (mut weights, mut squares) = (0.0, 0.0);
        for &j in &marks.found {
            let offset = self.points[j as usize] - origin;
            let (at, height) = (DVec2::new(offset.dot(e1), offset.dot(e2)), offset.dot(up));
            let w = weight(self.points[j as usize]);
            let basis = basis(at / radius, height / radius);
            let z = height / radius;
            for (row, b) in system.iter_mut().zip(basis) {
                for (entry, c) in row.iter_mut().zip(basis) {
                    *entry += w * b * c;
                }
                row[UNKNOWNS] += w * b * z;
            }
            weights += w;
            squares += w * z * z;
        }
        let right = system.map(|row| row[UNKNOWNS]);
        let a = solve(system)?;
        let explained: f64 = a.iter().zip(right).map(|(a, r)| a * r).sum();
        let residual = radius * ((squares - explained).max(0.0) / weights).sqrt();
        let (t1, t2) = (e1 + up * a[1], e2 + up * a[2]);
        let normal = (up - e1 * a[1] - e2 * a[2]).normalize();
        Some(Patch {
            point: origin + up * (a[0] * radius),
            normal,
            curvature: tensor([t1, t2], [a[3], a[4], a[5]].map(|c| -c / radius * normal.dot(up))),
            residual,
        })
    }

    /// Collects the samples within `radius` of sample i that have a similar normal and are
    /// connected to it through such samples.
    fn gather(&self, i: usize, radius: f64, marks: &mut Marks) {
        marks.now += 1;
        marks.found.clear();
        marks.found.push(i as u32);
        marks.seen[i] = marks.now;
        let mut next = 0;
        while let Some(&from) = marks.found.get(next) {
            next += 1;
            for &to in self.connections.of(from as usize) {
                let at = to as usize;
                if marks.seen[at] != marks.now {
                    marks.seen[at] = marks.now;
                    let near = self.points[at].distance_squared(self.points[i]) < radius * radius;
                    if near && self.normals[at].dot(self.normals[i]) > LEAST_COSINE {
                        marks.found.push(to);
                    }
                }
            }
        }
    }
}

/// Returns the basis functions at the tangent coordinates (u, v) = `at`: 1, u, v and the three
/// second-order terms. With r^2 = u^2 + v^2 and z = `height`, the second-order terms are multiplied
/// by (r^2 + z^2) / r^2. This factor makes the fit of a ball exact: a ball of curvature k has the
/// height z = (r^2 + z^2) k / 2.
fn basis(at: DVec2, height: f64) -> [f64; UNKNOWNS] {
    let stretch = 1.0 + height * height / at.length_squared().max(1e-6).max(height * height);
    [1.0, at.x, at.y, 0.5 * stretch * at.x * at.x, stretch * at.x * at.y, 0.5 * stretch * at.y * at.y]
}

/// Returns the curvature tensor, given the second fundamental form in a tangent basis.
fn tensor([t1, t2]: [DVec3; 2], [l, m, n]: [f64; 3]) -> DMat3 {
    let (e, f, g) = (t1.length_squared(), t1.dot(t2), t2.length_squared());
    let determinant = e * g - f * f;
    // the dual basis
    let (d1, d2) = ((t1 * g - t2 * f) / determinant, (t2 * e - t1 * f) / determinant);
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    outer(d1, d1) * l + (outer(d1, d2) + outer(d2, d1)) * m + outer(d2, d2) * n
}

/// Solves a symmetric positive definite system by elimination. The last column is the right-hand
/// side. Returns `None` if the system is singular.
fn solve(mut rows: [[f64; UNKNOWNS + 1]; UNKNOWNS]) -> Option<[f64; UNKNOWNS]> {
    for at in 0..UNKNOWNS {
        let pivot = rows[at];
        if pivot[at] <= 1e-9 {
            return None;
        }
        for row in &mut rows[at + 1..] {
            let factor = row[at] / pivot[at];
            for (entry, p) in row.iter_mut().zip(pivot).skip(at) {
                *entry -= factor * p;
            }
        }
    }
    let mut solution = [0.0; UNKNOWNS];
    for at in (0..UNKNOWNS).rev() {
        let known: f64 = (at + 1..UNKNOWNS).map(|k| rows[at][k] * solution[k]).sum();
        solution[at] = (rows[at][UNKNOWNS] - known) / rows[at][at];
    }
    Some(solution)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;

    /// Lifts the points of a planar grid onto a surface, moves point n along its normal by
    /// `moved(n)`, and fits a patch at the central point. Returns the patch and the exact normal.
    fn patch_of(
        radius: f64,
        surface: impl Fn(f64, f64) -> (DVec3, DVec3),
        moved: impl Fn(usize) -> f64,
    ) -> (Patch, DVec3) {
        let n = 41u32;
        let place = |i: u32| (f64::from(i) - 20.0) * 0.6 + 0.1;
        let (mut points, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
        for j in 0..n {
            for i in 0..n {
                let (point, normal) = surface(place(i), place(j));
                points.push(point + normal * moved(points.len()));
                normals.push(normal);
                if i + 1 < n && j + 1 < n {
                    let at = j * n + i;
                    triangles.extend([[at, at + 1, at + n + 1], [at, at + n + 1, at + n]]);
                }
            }
        }
        let connections = Connections::new(points.len(), &triangles);
        let samples = Samples { points: &points, normals: &normals, connections: &connections };
        let middle = (20 * n + 20) as usize;
        let patch = samples.patch(middle, radius, &mut Marks::new(points.len())).expect("a patch");
        (patch, normals[middle])
    }

    fn ball(r: f64) -> impl Fn(f64, f64) -> (DVec3, DVec3) {
        move |x, y| {
            let normal = DVec3::new((x / r).sin() * (y / r).cos(), (y / r).sin(), (x / r).cos() * (y / r).cos());
            (normal * r, normal)
        }
    }

    /// Returns the maximum error of the curvature tensor relative to 1 / r, the curvature of the
    /// ball.
    fn off_ball(patch: &Patch, r: f64) -> f64 {
        let (u, v) = patch.normal.any_orthonormal_pair();
        let at = |a: DVec3, b: DVec3| r * a.dot(patch.curvature * b);
        (at(u, u) - 1.0).abs().max((at(v, v) - 1.0).abs()).max(at(u, v).abs())
    }

    #[test]
    fn a_wide_patch_of_a_ball_has_its_curvature() {
        for radius in [2.0, 4.0, 6.0] {
            let (patch, normal) = patch_of(radius, ball(10.0), |_| 0.0);
            // measured 4e-9, 9e-8 and 4e-7
            assert!(off_ball(&patch, 10.0) < 1e-3 && patch.residual < 1e-4, "{radius}: {patch:?}");
            assert!(patch.normal.dot(normal) > 1.0 - 1e-8 && (patch.point.length() - 10.0).abs() < 1e-4);
        }
    }

    #[test]
    fn a_tube_has_its_two_curvatures() {
        let tube = |x: f64, y: f64| {
            let normal = DVec3::new((x / 8.0).sin(), 0.0, (x / 8.0).cos());
            (normal * 8.0 + DVec3::Y * y, normal)
        };
        let (patch, _) = patch_of(3.0, tube, |_| 0.0);
        let across = patch.normal.cross(DVec3::Y);
        assert!((across.dot(patch.curvature * across) * 8.0 - 1.0).abs() < 0.01, "{patch:?}");
        assert!(DVec3::Y.dot(patch.curvature * DVec3::Y).abs() < 1e-3, "{patch:?}");
    }

    #[test]
    fn the_residual_is_the_noise_and_a_wide_patch_averages_it() {
        let noise = |n: usize| 0.35 * (uniform(5, 0, n as u64) - 0.5);
        let (patch, normal) = patch_of(6.0, ball(20.0), noise);
        // uniform noise in an interval 0.35 mm wide has a standard deviation of 0.101 mm
        assert!((patch.residual / 0.101 - 1.0).abs() < 0.15, "{patch:?}");
        assert!(off_ball(&patch, 20.0) < 0.2 && patch.normal.dot(normal) > 0.9998, "{patch:?}");
    }
}
