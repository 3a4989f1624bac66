//! Computes signed distances from closest points.
//!
//! The computation starts from the nearest surface sample of every node ([`crate::nearest`]).
//! Within a band around the surface, Newton's method finds the closest point on the zero set.
//! Farther out, a second-order approximation of the surface at the sample gives the distance. If
//! the foot of the perpendicular from the node is too far from the sample for this approximation,
//! steps along the surface first find a nearer point.

use crate::bits::Bits;
use crate::nearest::{NO_SAMPLE, Slab, nearest_samples};
use crate::samples::{Source, ValueGradient, project};
use glam::{DMat3, DVec3, Mat3, Vec3};
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;

/// Minimum determinant of the Hessian of half the squared distance at a closest point. For a node
/// at height D above a surface with the principal curvatures k1 and k2, this is
/// `(1 + D k1) (1 + D k2)`: 1 for a plane, and 0 at a focal point of the surface, where the
/// second-order approximation fails. At this limit, the distance from the sample to the foot can be
/// 100 times the distance from the node to the normal line at the sample. Rounding to single
/// precision then changes the former distance by about 1e-5 of its length. With limits of 0.001 and
/// 0.1, the distances within 1.5 voxels of the surface change by at most 0.003 mm for
/// `heart_label`, `tooth_ct` at iso value 600 and label 13 of `frog_tissue_labels`
/// (`make distfield`).
const LEAST_DETERMINANT: f32 = 0.01;

/// Maximum number of patches visited on the way to the closest point. If one of them contains the
/// foot of the node, two patches are visited on average (`tests/labels.rs`, `tests/scalar.rs`).
/// Otherwise, the distance to the nearest point found is used.
const MAX_PATCHES: usize = 8;

/// Maximum length of a step from patch to patch, in units of the minimum voxel spacing. A step of
/// this length in the tangent plane of a sphere of radius R voxels ends about 2^2 / (2 R) voxels
/// from the sphere. [`project`] moves a point by at most 0.75 voxel, so it can move this point back
/// to the sphere if R is above 2.7.
const LONGEST_SURFACE_STEP: f32 = 2.0;

/// Maximum distance between a sample and the foot of a node for the second-order approximation, in
/// units of the minimum voxel spacing. Every cell that the surface crosses contains samples, so
/// every point of the surface is within a cell diagonal (1.7) of a sample. A foot beyond the limit
/// usually lies nearer to another sample.
const PATCH_REACH: f64 = 1.5;

const _: () =
    assert!(LONGEST_SURFACE_STEP as f64 > PATCH_REACH, "a step to a foot beyond the patch would be cut within it");

/// Maximum number of Newton steps per node. In the tests listed at [`MAX_PATCHES`], the method
/// takes 2.7 steps on average where it converges. It does not converge at less than 2 % of the
/// nodes; the distance to the sample is used there.
const MAX_NEWTON_STEPS: usize = 8;

/// Length of the step after which Newton's method stops, in units of the minimum voxel spacing. The
/// remaining error is of the order of this length squared.
const LAST_STEP: f64 = 1e-3;

/// Maximum number of moves along the cap. One move reaches the foot on a flat cap; further moves
/// are needed at the fillets along its edges.
const CAP_MOVES: usize = 3;

/// Computes the signed distance (mm) from every node to the surface of `source`, negative at the
/// `inside` nodes. `samples` are dense samples of the surface.
///
/// Within `band` mm, Newton's method finds the closest point. Beyond the band, the result is the
/// distance to the second-order approximation of the surface at the nearest sample. If the nearest
/// sample lies on the cap, steps along tangent planes replace both methods. Distances are clamped
/// to `limit` mm, which must be at least `band` and may be infinite.
pub fn distance_to_zero_set(
    geometry: Geometry,
    inside: &Bits,
    source: &Source,
    samples: &[DVec3],
    band: f64,
    limit: f64,
) -> Image<f32> {
    // A zeroed allocation takes no memory until it is written. The slabs are written one by one,
    // while the coarse grid of nearest samples shrinks.
    let mut data = vec![0.0; geometry.voxel_count()];
    let patches: Vec<Patch> = samples.par_iter().map(|&p| Patch::new(source, p)).collect();
    let surface = Surface { source, samples, patches, band, reach: PATCH_REACH * geometry.min_spacing() };
    let [nx, ny, _] = geometry.size;
    nearest_samples(&geometry, samples, limit, band, &mut data, |slab, own| {
        own.par_chunks_mut(nx).enumerate().for_each(|(row, values)| {
            let (j, k) = (row % ny, slab.own.start + row / ny);
            for (i, value) in values.iter_mut().enumerate() {
                let sign = if inside.holds((k * ny + j) * nx + i) { -1.0 } else { 1.0 };
                let distance = surface.distance(&geometry, slab, [i, j, k], *value);
                *value = distance.min(limit as f32).copysign(sign);
            }
        });
    });
    Image { geometry, data }
}

/// The surface, its samples and the second-order patch at each sample.
struct Surface<'a> {
    source: &'a Source,
    samples: &'a [DVec3],
    patches: Vec<Patch>,
    /// Distance within which Newton's method finds closest points, mm.
    band: f64,
    /// Maximum distance between a sample and a foot on its patch, mm.
    reach: f64,
}

impl Surface<'_> {
    /// Returns the distance (mm) from the node `at` to the surface, or infinity if the node has no
    /// sample. `squared` is the squared distance (mm^2) to its sample.
    fn distance(&self, geometry: &Geometry, slab: &Slab, at: [usize; 3], squared: f32) -> f32 {
        let mut sample = slab.sample[geometry.linear(at[0], at[1], at[2] - slab.first)];
        if sample == NO_SAMPLE {
            return f32::INFINITY;
        }
        let is_far = f64::from(squared.sqrt()) > self.band;
        let node = geometry.index_to_grid(DVec3::from_array(at.map(|n| n as f64)));
        if is_far {
            let foot = |sample: u32| {
                let to_node = (node - self.samples[sample as usize]).as_vec3();
                self.patches[sample as usize].distance(to_node, self.reach as f32)
            };
            let mut found = foot(sample);
            if found.is_none() {
                sample = self.nearest_around(geometry, slab, at, node);
                found = foot(sample);
            }
            if let Some(distance) = found {
                return distance;
            }
        }
        let start = self.samples[sample as usize];
        let distance = match &self.source.cap {
            Some(cap) if !cap.leaves(start) => slide(self.source, node, start),
            _ if is_far => walk(self.source, node, start, self.reach as f32),
            _ => refine(self.source, node, start).unwrap_or_else(|| node.distance(start)),
        };
        distance as f32
    }

    /// Returns the sample nearest to a node. The candidates are the samples of the node and of its
    /// 26 neighbours.
    fn nearest_around(&self, geometry: &Geometry, slab: &Slab, at: [usize; 3], node: DVec3) -> u32 {
        let range = |axis: usize| at[axis].saturating_sub(1)..(at[axis] + 2).min(geometry.size[axis]);
        let own = slab.sample[geometry.linear(at[0], at[1], at[2] - slab.first)];
        let mut best = (own, node.distance_squared(self.samples[own as usize]));
        for k in range(2) {
            for j in range(1) {
                for i in range(0) {
                    let other = slab.sample[geometry.linear(i, j, k - slab.first)];
                    if other != NO_SAMPLE && other != best.0 {
                        let squared = node.distance_squared(self.samples[other as usize]);
                        if squared < best.1 {
                            best = (other, squared);
                        }
                    }
                }
            }
        }
        best.0
    }
}

/// Second-order approximation of the surface at a point.
struct Patch {
    /// Outward unit normal.
    normal: Vec3,
    /// Curvature tensor (Goldman 2005) in 1/mm: xx, yy, zz, xy, yz, zx. NaN where the border box
    /// cuts the surface.
    shape: [f32; 6],
}

impl Patch {
    fn new(source: &Source, sample: DVec3) -> Self {
        if source.cap.as_ref().is_some_and(|cap| !cap.leaves(sample)) {
            let normal = source.value_gradient(sample).1.normalize_or_zero().as_vec3();
            return Self { normal, shape: [f32::NAN; 6] };
        }
        let jet = source.spline.jet(sample);
        let (normal, slope) = (jet.gradient.normalize_or_zero(), jet.gradient.length());
        let across = DMat3::IDENTITY - DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        let shape = (across * jet.hessian * across * (1.0 / slope)).as_mat3();
        let Mat3 { x_axis: x, y_axis: y, z_axis: z } = shape;
        Self { normal: normal.as_vec3(), shape: [x.x, y.y, z.z, x.y, y.z, x.z] }
    }

    /// Returns the curvature tensor, or `None` where it is not defined.
    fn curvature(&self) -> Option<Mat3> {
        let [xx, yy, zz, xy, yz, zx] = self.shape;
        let shape = Mat3::from_cols(Vec3::new(xx, xy, zx), Vec3::new(xy, yy, yz), Vec3::new(zx, yz, zz));
        shape.is_finite().then_some(shape)
    }

    /// Returns the vector in the tangent plane from the patch's point to the foot of a node, given
    /// the vector to the node. Returns `None` if the surface curves so strongly that the foot does
    /// not minimise the distance.
    ///
    /// For a node at height D above the tangent plane and at offset t in this plane, the foot on
    /// the surface z = -u.Su/2 is at u = (I + D S)^-1 t, where S is the curvature tensor. S maps
    /// the tangent plane to itself, so the formula for 2 x 2 matrices gives the inverse
    /// (Cayley-Hamilton).
    fn foot(&self, to_node: Vec3) -> Option<Vec3> {
        let shape = self.curvature()?;
        let height = to_node.dot(self.normal);
        let aside = to_node - self.normal * height;
        let [x, y, z] = [shape.x_axis, shape.y_axis, shape.z_axis];
        let trace = height * (x.x + y.y + z.z);
        let minors = x.x * y.y - x.y * x.y + y.y * z.z - y.z * y.z + z.z * x.x - x.z * x.z;
        let determinant = 1.0 + trace + height * height * minors;
        let is_minimum = 2.0 + trace > 0.0 && determinant > LEAST_DETERMINANT;
        is_minimum.then(|| (aside * (1.0 + trace) - shape * aside * height) / determinant)
    }

    /// Returns the distance (mm) from a node to the patch, given the vector from the patch's point
    /// to the node. Returns `None` if the foot u is undefined or farther than `reach` (mm) from the
    /// patch's point. The squared distance to the foot is the squared distance to the patch's point
    /// minus t.u, with t as in [`Self::foot`].
    fn distance(&self, to_node: Vec3, reach: f32) -> Option<f32> {
        let foot = self.foot(to_node)?;
        let squared = (to_node.length_squared() - to_node.dot(foot)).max(0.0);
        (foot.length_squared() <= reach * reach).then(|| squared.sqrt())
    }
}

/// Returns the distance (mm) from `node` to the surface. Starts at an approximate closest point
/// `start`, whose patch does not contain the foot, and steps over the surface from patch to patch
/// while the distance decreases.
fn walk(source: &Source, node: DVec3, start: DVec3, reach: f32) -> f64 {
    let voxel = source.spline.geometry().min_spacing();
    let (mut p, mut nearest) = (start, node.distance(start));
    for _ in 0..MAX_PATCHES {
        let patch = Patch::new(source, p);
        let to_node = (node - p).as_vec3();
        if let Some(distance) = patch.distance(to_node, reach) {
            return nearest.min(distance.into());
        }
        // without a foot, move along the tangential part of the vector to the node, which is a
        // descent direction
        let step = patch.foot(to_node).unwrap_or_else(|| to_node - patch.normal * to_node.dot(patch.normal));
        let Some(next) =
            project(source, p + step.clamp_length_max(LONGEST_SURFACE_STEP * voxel as f32).as_dvec3(), voxel)
        else {
            break;
        };
        let distance = node.distance(next);
        if distance >= nearest {
            break;
        }
        (p, nearest) = (next, distance);
    }
    nearest
}

/// Returns the distance (mm) from `node` to the surface. Starts at a point `start` on the cap, and
/// moves along the tangent plane towards the foot of the node and back onto the surface while the
/// distance decreases.
fn slide(source: &Source, node: DVec3, start: DVec3) -> f64 {
    let voxel = source.spline.geometry().min_spacing();
    let (mut p, mut best) = (start, node.distance(start));
    for _ in 0..CAP_MOVES {
        let normal = source.value_gradient(p).1.normalize_or_zero();
        let to_node = node - p;
        let Some(next) = project(source, p + (to_node - normal * to_node.dot(normal)), voxel) else {
            break;
        };
        let distance = node.distance(next);
        if distance >= best {
            break;
        }
        (p, best) = (next, distance);
    }
    best
}

/// Returns the distance (mm) from `node` to the zero set, given an approximate closest point
/// `start`.
///
/// Applies Newton's method to the Lagrange conditions p - node + lambda grad f = 0, f(p) = 0.
/// Returns `None` if it does not converge to a point nearer than `start`.
fn refine(source: &Source, node: DVec3, start: DVec3) -> Option<f64> {
    let spline = &source.spline;
    let voxel = spline.geometry().min_spacing();
    let first = node.distance(start);
    let mut p = start;
    let mut lambda = None;
    for _ in 0..MAX_NEWTON_STEPS {
        let jet = spline.jet(p);
        let g = jet.gradient;
        let slope = g.length_squared();
        if slope.is_nan() || slope <= 1e-24 {
            return None;
        }
        let to_node = node - p;
        let multiplier = lambda.unwrap_or(to_node.dot(g) / slope);
        let curved = DMat3::IDENTITY + jet.hessian * multiplier;
        let inverse = if is_positive_definite(&curved) { curved.inverse() } else { DMat3::IDENTITY };
        let next = (g.dot(inverse * to_node) + jet.value) / g.dot(inverse * g);
        let step = inverse * (to_node - g * next);
        lambda = Some(next);
        let length = step.length();
        if length <= LAST_STEP * voxel {
            p += step;
            let distance = node.distance(p);
            let on_surface = jet.value.abs() <= 1e-3 * voxel * slope.sqrt();
            let within = source.cap.as_ref().is_none_or(|cap| cap.leaves(p));
            return (on_surface && within && distance < first).then_some(distance);
        }
        p += step * (0.5 * voxel / length).min(1.0);
        if !p.is_finite() || p.distance(start) > 2.0 * voxel {
            return None;
        }
    }
    None
}

/// Tests whether a matrix is positive definite, by Sylvester's criterion. The thresholds are above
/// zero to exclude nearly singular matrices. They are close to the leading minors of 0.05 I: 0.05,
/// 0.05^2 and 0.05^3.
fn is_positive_definite(m: &DMat3) -> bool {
    let two = m.x_axis.x * m.y_axis.y - m.x_axis.y * m.y_axis.x;
    m.x_axis.x > 0.05 && two > 0.0025 && m.determinant() > 1e-4
}
