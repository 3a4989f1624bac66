//! Signed distance from closest points: every node knows its nearest surface sample ([`crate::nearest`]); in a band round the surface
//! Newton's method then finds the closest point of the zero set itself, and farther out the surface round the sample is taken to
//! second order.

use crate::field::Source;
use crate::nearest::{NONE, nearest_samples};
use crate::samples::{Implicit, project};
use glam::{DMat3, DVec3, Mat3, Vec3};
use isoparticles_common::geometry::Geometry;
use isoparticles_common::image::Image;
use rayon::prelude::*;

/// Unsigned distance (mm) of every node to the nearest of the samples, good to a small part of the sample spacing, within
/// `limit` mm; farther away some larger number, possibly infinite.
pub fn distance_to_samples(geometry: &Geometry, samples: &[DVec3], limit: f64) -> Image<f32> {
    let nearest = nearest_samples(geometry, samples, limit);
    let data = nearest.squared.into_par_iter().map(f32::sqrt).collect();
    Image { geometry: geometry.clone(), data }
}

/// Beyond the band the distance to a sample stands where it is too large by no more than this if the surface there is flat,
/// in voxels.
const FAR_TOLERANCE: f64 = 0.004;

/// How far from the sample the foot of a node may lie for the surface round the sample to be taken to second order, in voxels.
const PATCH_REACH: f64 = 1.5;

/// A step of Newton's method as short as this (voxels) is the last one: what remains is of the order of its square.
const LAST_STEP: f64 = 1e-3;

/// Unsigned distance (mm) of every node to the surface of `source`, of which `samples` is a dense sampling. Exact within
/// `band` mm, by Newton's method for the closest point; beyond, the distance to the sample's patch.
pub fn distance_to_zero_set(source: &Source, samples: &[DVec3], band: f64) -> Image<f32> {
    let geometry = source.spline.geometry();
    let nearest = nearest_samples(geometry, samples, f64::INFINITY);
    let patches: Vec<Patch> = samples.par_iter().map(|&p| Patch::new(source, p)).collect();
    let [nx, ny, _] = geometry.size;
    let enough = (2.0 * FAR_TOLERANCE * geometry.mean_spacing()) as f32;
    let reach = (PATCH_REACH * geometry.min_spacing()) as f32;
    let mut data = nearest.squared;
    data.par_chunks_mut(nx).enumerate().for_each(|(row, values)| {
        for (i, value) in values.iter_mut().enumerate() {
            let at = [i, row % ny, row / ny];
            let mut sample = nearest.sample[row * nx + i];
            *value = value.sqrt();
            if sample == NONE {
                continue;
            }
            let node = geometry.index_to_grid(DVec3::from_array(at.map(|n| n as f64)));
            if f64::from(*value) > band {
                let foot = |sample: u32| {
                    let to_node = (node - samples[sample as usize]).as_vec3();
                    patches[sample as usize].distance(to_node, enough, reach)
                };
                let mut found = foot(sample);
                if found.is_none() {
                    sample = nearest_around(geometry, &nearest.sample, samples, at, node);
                    found = foot(sample);
                }
                if let Some(distance) = found {
                    *value = distance;
                    continue;
                }
            }
            let start = samples[sample as usize];
            *value = match &source.cap {
                Some(cap) if !cap.leaves(start) => slide(source, node, start),
                _ => refine(source, node, start).unwrap_or_else(|| {
                    let far = f64::from(*value) > band;
                    let to_node = node - start;
                    if far { patches[sample as usize].flat_distance(to_node, reach) } else { to_node.length() }
                }),
            } as f32;
        }
    });
    Image { geometry: geometry.clone(), data }
}

/// The sample nearest to a node, of its own and those of the nodes around.
fn nearest_around(geometry: &Geometry, sample: &[u32], samples: &[DVec3], at: [usize; 3], node: DVec3) -> u32 {
    let range = |axis: usize| at[axis].saturating_sub(1)..(at[axis] + 2).min(geometry.size[axis]);
    let own = sample[geometry.linear(at[0], at[1], at[2])];
    let mut best = (own, node.distance_squared(samples[own as usize]));
    for k in range(2) {
        for j in range(1) {
            for i in range(0) {
                let other = sample[geometry.linear(i, j, k)];
                if other != NONE && other != best.0 {
                    let squared = node.distance_squared(samples[other as usize]);
                    if squared < best.1 {
                        best = (other, squared);
                    }
                }
            }
        }
    }
    best.0
}

/// The surface round a sample, to second order.
struct Patch {
    /// Unit normal, outward.
    normal: Vec3,
    /// Curvature tensor (Goldman 2005), per mm; none where the surface is cut at the border.
    shape: Option<Mat3>,
}

impl Patch {
    fn new(source: &Source, sample: DVec3) -> Self {
        if source.cap.as_ref().is_some_and(|cap| !cap.leaves(sample)) {
            let normal = source.value_gradient(sample).1.normalize_or_zero().as_vec3();
            return Self { normal, shape: None };
        }
        let jet = source.spline.jet(sample);
        let (normal, slope) = (jet.gradient.normalize_or_zero(), jet.gradient.length());
        let across = DMat3::IDENTITY - DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        let shape = (across * jet.hessian * across * (1.0 / slope)).as_mat3();
        Self { normal: normal.as_vec3(), shape: shape.is_finite().then_some(shape) }
    }

    /// Distance of a node to the tangent plane, given the way to it from the sample; that to the sample where the foot is farther
    /// than `reach` (mm). Where the sample is no closest point, because the surface bends round the node, the truth is smaller still.
    fn flat_distance(&self, to_node: DVec3, reach: f32) -> f64 {
        let height = to_node.dot(self.normal.as_dvec3());
        let aside = (to_node.length_squared() - height * height).max(0.0).sqrt();
        if aside <= f64::from(reach) { height.abs() } else { to_node.length() }
    }

    /// Distance of a node to the patch, given the way to it from the sample; `None` where the patch does not tell.
    ///
    /// With the node at height D over the sample's tangent plane and t aside of the normal, the closest point of the surface
    /// -u.Su/2 is at u = (I + D S)^-1 t, nearer by t.u in the square. The sample will do where |t|^2 is at most `enough` |D|
    /// (mm), the patch where |u| is at most `reach` (mm).
    fn distance(&self, to_node: Vec3, enough: f32, reach: f32) -> Option<f32> {
        let height = to_node.dot(self.normal);
        let aside = to_node - self.normal * height;
        if aside.length_squared() <= enough * height.abs() {
            return Some(to_node.length());
        }
        let curved = Mat3::IDENTITY + self.shape? * height;
        if !is_positive_definite(&curved.as_dmat3()) {
            return None;
        }
        let foot = curved.inverse() * aside;
        let squared = (to_node.length_squared() - aside.dot(foot)).max(0.0);
        (foot.length_squared() <= reach * reach).then(|| squared.sqrt())
    }
}

/// Distance of `node` to the surface, from a point `start` of it on the cap: slides along the tangent plane towards the foot of
/// the node and back onto the surface, as long as that comes nearer.
fn slide(source: &Source, node: DVec3, start: DVec3) -> f64 {
    let voxel = source.spline.geometry().min_spacing();
    let (mut p, mut best) = (start, node.distance(start));
    for _ in 0..3 {
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

/// Distance of `node` to the zero set, from a point `start` of it that is nearly the closest.
///
/// Newton's method on the Lagrange conditions p - node + lambda grad f = 0, f(p) = 0; where it does not come nearer
/// than `start`, there is no answer.
fn refine(source: &Source, node: DVec3, start: DVec3) -> Option<f64> {
    let spline = &source.spline;
    let voxel = spline.geometry().min_spacing();
    let first = node.distance(start);
    let mut p = start;
    let mut lambda = None;
    for _ in 0..8 {
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

/// Sylvester's criterion, with room to rounding.
fn is_positive_definite(m: &DMat3) -> bool {
    let two = m.x_axis.x * m.y_axis.y - m.x_axis.y * m.y_axis.x;
    m.x_axis.x > 0.05 && two > 0.0025 && m.determinant() > 1e-4
}
