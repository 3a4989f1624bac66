//! Signed distance from closest points: every node knows its nearest surface sample ([`crate::nearest`]); in a band round the surface
//! Newton's method then finds the closest point of the zero set itself, and farther out the surface round the sample is taken to
//! second order, after a walk over the surface where the foot lies too far from the sample for that.

use crate::bits::Bits;
use crate::field::Source;
use crate::nearest::{NONE, Slab, nearest_samples};
use crate::samples::{Implicit, project};
use glam::{DMat3, DVec3, Mat3, Vec3};
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;

/// Least determinant of the Hessian of half the squared distance, relative to that to a plane, for a closest point: at less the node is at a
/// focal point of the surface, where the second order does not tell.
const LEAST_DETERMINANT: f32 = 0.01;

/// Steps from patch to patch towards the closest point, at most.
const MOST_WALKS: usize = 8;

/// Longest step of them, in voxels.
const LONGEST_WALK: f32 = 2.0;

/// How far from the sample the foot of a node may lie for the surface round the sample to be taken to second order, in voxels.
const PATCH_REACH: f64 = 1.5;

/// A step of Newton's method as short as this (voxels) is the last one: what remains is of the order of its square.
const LAST_STEP: f64 = 1e-3;

/// The distance (mm) of every node to the surface of `source`, of which `samples` is a dense sampling, negative at the `inside` ones. Exact
/// within `band` mm, by Newton's method for the closest point; beyond, the distance to the surface round the nearest sample, and from `limit` mm on, which
/// may be infinite and is no less than `band`, that.
pub fn distance_to_zero_set(
    geometry: Geometry,
    inside: &Bits,
    source: &Source,
    samples: &[DVec3],
    band: f64,
    limit: f64,
) -> Image<f32> {
    // zeros take no memory until they are written over, slab by slab, while the coarse grid of the nearest samples shrinks
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

/// A surface and what is known of it at its samples.
struct Surface<'a> {
    source: &'a Source,
    samples: &'a [DVec3],
    patches: Vec<Patch>,
    /// Within this distance, in mm, closest points are found by Newton's method.
    band: f64,
    /// How far from a sample its patch is asked, in mm.
    reach: f64,
}

impl Surface<'_> {
    /// Distance of a node whose nearest sample is `squared` mm squared away; infinite where there is no sample.
    fn distance(&self, geometry: &Geometry, slab: &Slab, at: [usize; 3], squared: f32) -> f32 {
        let mut sample = slab.sample[geometry.linear(at[0], at[1], at[2] - slab.first)];
        if sample == NONE {
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

    /// The sample nearest to a node, of its own and those of the nodes around.
    fn nearest_around(&self, geometry: &Geometry, slab: &Slab, at: [usize; 3], node: DVec3) -> u32 {
        let range = |axis: usize| at[axis].saturating_sub(1)..(at[axis] + 2).min(geometry.size[axis]);
        let own = slab.sample[geometry.linear(at[0], at[1], at[2] - slab.first)];
        let mut best = (own, node.distance_squared(self.samples[own as usize]));
        for k in range(2) {
            for j in range(1) {
                for i in range(0) {
                    let other = slab.sample[geometry.linear(i, j, k - slab.first)];
                    if other != NONE && other != best.0 {
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

/// The surface round a point of it, to second order.
struct Patch {
    /// Unit normal, outward.
    normal: Vec3,
    /// Curvature tensor (Goldman 2005), per mm: its diagonal and xy, yz, zx; NaN where the surface is cut at the border.
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

    /// The curvature tensor, where there is one.
    fn curvature(&self) -> Option<Mat3> {
        let [xx, yy, zz, xy, yz, zx] = self.shape;
        let shape = Mat3::from_cols(Vec3::new(xx, xy, zx), Vec3::new(xy, yy, yz), Vec3::new(zx, yz, zz));
        shape.is_finite().then_some(shape)
    }

    /// The way along the tangent plane to the foot of a node, given the way to it from the patch's point. `None` where the surface bends
    /// so strongly that this point is no closest one.
    ///
    /// With the node at height D over the tangent plane and t aside of the normal, the closest point of the surface -u.Su/2 is at
    /// u = (I + D S)^-1 t; S maps the tangent plane to itself, so the inverse is that of a 2 x 2 matrix (Cayley-Hamilton).
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

    /// Distance of a node to the patch, given the way to it from the patch's point; `None` where the patch does not tell: it is to
    /// be asked no farther away than `reach` (mm). The foot u is nearer than the patch's point by t.u in the square.
    fn distance(&self, to_node: Vec3, reach: f32) -> Option<f32> {
        let foot = self.foot(to_node)?;
        let squared = (to_node.length_squared() - to_node.dot(foot)).max(0.0);
        (foot.length_squared() <= reach * reach).then(|| squared.sqrt())
    }
}

/// Distance of `node` to the surface, from a point `start` of it that is nearly the closest, but not so nearly that the surroundings of
/// `start` tell: walks over the surface, from patch to patch, as long as that comes nearer.
fn walk(source: &Source, node: DVec3, start: DVec3, reach: f32) -> f64 {
    let voxel = source.spline.geometry().min_spacing();
    let (mut p, mut nearest) = (start, node.distance(start));
    for _ in 0..MOST_WALKS {
        let patch = Patch::new(source, p);
        let to_node = (node - p).as_vec3();
        if let Some(distance) = patch.distance(to_node, reach) {
            return nearest.min(distance.into());
        }
        // where the point is no closest one, any way downhill
        let step = patch.foot(to_node).unwrap_or_else(|| to_node - patch.normal * to_node.dot(patch.normal));
        let Some(next) = project(source, p + step.clamp_length_max(LONGEST_WALK * voxel as f32).as_dvec3(), voxel)
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
