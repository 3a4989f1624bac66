//! Least-squares patches of the surface: a quadric over the tangent plane, fitted to the samples round one of them.
//!
//! A jet of the surface by least squares (Cazals and Pouget 2005), of second order. What a patch misses its samples by is
//! noise, or shape finer than the patch.

use crate::connections::Connections;
use glam::{DMat3, DVec2, DVec3};

/// Samples whose normal is more than this far from that of the middle one (cosine) are not of the patch.
const SAME_SHEET: f64 = 0.5;

/// Fewest samples that a patch is fitted to; it has six unknowns.
const FEWEST: usize = 9;

const UNKNOWNS: usize = 6;

/// The surface round a sample, to second order.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// The point of the patch straight over the sample, grid frame, mm.
    pub point: DVec3,
    /// Unit normal there, outward.
    pub normal: DVec3,
    /// Curvature tensor there, per mm: its eigenvalues are 0 (along the normal) and the principal curvatures, positive on a ball.
    pub curvature: DMat3,
    /// Weighted root-mean-square of what the samples are off the patch, mm.
    pub residual: f64,
}

/// Samples of a surface and their connections.
pub struct Samples<'a> {
    /// Positions, grid frame, mm.
    pub points: &'a [DVec3],
    /// Unit normals, outward.
    pub normals: &'a [DVec3],
    /// Who is joined with whom by a triangle's edge.
    pub connections: &'a Connections,
}

/// Marks of the samples that a walk has seen, so that each is taken once.
pub struct Marks {
    seen: Vec<u32>,
    now: u32,
    found: Vec<u32>,
}

impl Marks {
    /// Room for so many samples.
    pub fn new(samples: usize) -> Self {
        Self { seen: vec![0; samples], now: 0, found: Vec::new() }
    }
}

impl Samples<'_> {
    /// Fits a patch to the samples within `radius` (mm) of sample i that are connected with it; `None` where they are too few or
    /// do not tell.
    pub fn patch(&self, i: usize, radius: f64, marks: &mut Marks) -> Option<Patch> {
        self.gather(i, radius, marks);
        if marks.found.len() < FEWEST {
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

    /// The samples within `radius` of sample i on its sheet that it is connected with through such samples.
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
                    if near && self.normals[at].dot(self.normals[i]) > SAME_SHEET {
                        marks.found.push(to);
                    }
                }
            }
        }
    }
}

/// 1, u, v and the three of second order. Those are stretched by (r^2 + z^2) / r^2, with which a ball, whose height is z = (r^2 + z^2) k / 2,
/// fits without an error.
fn basis(at: DVec2, height: f64) -> [f64; UNKNOWNS] {
    let stretch = 1.0 + height * height / at.length_squared().max(1e-6).max(height * height);
    [1.0, at.x, at.y, 0.5 * stretch * at.x * at.x, stretch * at.x * at.y, 0.5 * stretch * at.y * at.y]
}

/// Curvature tensor from the second fundamental form over a tangent basis.
fn tensor([t1, t2]: [DVec3; 2], [l, m, n]: [f64; 3]) -> DMat3 {
    let (e, f, g) = (t1.length_squared(), t1.dot(t2), t2.length_squared());
    let determinant = e * g - f * f;
    // the dual basis
    let (d1, d2) = ((t1 * g - t2 * f) / determinant, (t2 * e - t1 * f) / determinant);
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    outer(d1, d1) * l + (outer(d1, d2) + outer(d2, d1)) * m + outer(d2, d2) * n
}

/// Solves a symmetric positive system with its right side as the last column, by elimination; `None` where it is singular.
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
