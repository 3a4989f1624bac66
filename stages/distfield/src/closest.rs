//! Signed distance from closest points: surface samples are handed from node to node by sweeps over planes (a vector
//! distance transform after Danielsson 1980), and in a band round the surface Newton's method then finds the closest point of
//! the zero set itself.

use crate::field::Source;
use crate::samples::{Implicit, project};
use glam::{DMat3, DVec3, Vec3};
use isoparticles_common::geometry::Geometry;
use isoparticles_common::image::Image;
use rayon::prelude::*;

const NONE: u32 = u32::MAX;

/// Closest sample of every node, and its squared distance.
struct Closest {
    sample: Vec<u32>,
    squared: Vec<f32>,
}

/// Unsigned distance (mm) of every node to the nearest of the samples, good to a small part of the sample spacing, within
/// `limit` mm; farther away some larger number, possibly infinite.
pub fn distance_to_samples(geometry: &Geometry, samples: &[DVec3], limit: f64) -> Image<f32> {
    let closest = closest_samples(geometry, samples, limit);
    let data = closest.squared.into_par_iter().map(f32::sqrt).collect();
    Image { geometry: geometry.clone(), data }
}

/// Beyond the band the distance to a sample stands where it looks this good, as a share of the distance. The true error is
/// smaller by as much as the surface bends between the sample and the closest point.
const FAR_TOLERANCE: f64 = 0.006;

/// Unsigned distance (mm) of every node to the surface of `source`, of which `samples` is a dense sampling. Exact within
/// `band` mm, by Newton's method for the closest point; beyond, the distance to the nearest sample where that sample looks
/// straight at the node.
pub fn distance_to_zero_set(source: &Source, samples: &[DVec3], band: f64) -> Image<f32> {
    let geometry = source.spline.geometry();
    let closest = closest_samples(geometry, samples, f64::INFINITY);
    let normals: Vec<Vec3> =
        samples.par_iter().map(|&p| source.value_gradient(p).1.normalize_or_zero().as_vec3()).collect();
    let [nx, ny, _] = geometry.size;
    let mut data = closest.squared;
    data.par_chunks_mut(nx).zip(closest.sample.par_chunks(nx)).enumerate().for_each(|(row, (values, nearest))| {
        for (i, (value, &sample)) in values.iter_mut().zip(nearest).enumerate() {
            let squared = f64::from(*value);
            let distance = squared.sqrt();
            *value = distance as f32;
            if sample == NONE {
                continue;
            }
            let node = geometry.index_to_grid(DVec3::new(i as f64, (row % ny) as f64, (row / ny) as f64));
            let start = samples[sample as usize];
            if distance > band {
                // the sample is that far aside from the foot of the node: an estimate of the error
                let along = (node - start).dot(normals[sample as usize].as_dvec3());
                if squared - along * along < 2.0 * FAR_TOLERANCE * squared {
                    continue;
                }
            }
            *value = match &source.cap {
                Some(cap) if !cap.leaves(start) => slide(source, node, start),
                _ => refine(source, node, start),
            } as f32;
        }
    });
    Image { geometry: geometry.clone(), data }
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
/// than `start`, the distance to `start` stands.
fn refine(source: &Source, node: DVec3, start: DVec3) -> f64 {
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
            return first;
        }
        let to_node = node - p;
        let multiplier = lambda.unwrap_or(to_node.dot(g) / slope);
        let curved = DMat3::IDENTITY + jet.hessian * multiplier;
        let inverse = if is_positive_definite(&curved) { curved.inverse() } else { DMat3::IDENTITY };
        let next = (g.dot(inverse * to_node) + jet.value) / g.dot(inverse * g);
        let step = inverse * (to_node - g * next);
        lambda = Some(next);
        let length = step.length();
        if length <= 1e-5 * voxel {
            let distance = node.distance(p);
            let on_surface = jet.value.abs() <= 1e-3 * voxel * slope.sqrt();
            let within = source.cap.as_ref().is_none_or(|cap| cap.leaves(p));
            return if on_surface && within && distance < first { distance } else { first };
        }
        p += step * (0.5 * voxel / length).min(1.0);
        if !p.is_finite() || p.distance(start) > 2.0 * voxel {
            return first;
        }
    }
    first
}

/// Sylvester's criterion, with room to rounding.
fn is_positive_definite(m: &DMat3) -> bool {
    let two = m.x_axis.x * m.y_axis.y - m.x_axis.y * m.y_axis.x;
    m.x_axis.x > 0.05 && two > 0.0025 && m.determinant() > 1e-4
}

fn closest_samples(geometry: &Geometry, samples: &[DVec3], limit: f64) -> Closest {
    let count = geometry.voxel_count();
    let mut closest = Closest { sample: vec![NONE; count], squared: vec![f32::INFINITY; count] };
    let [nx, ny, nz] = geometry.size;
    let single: Vec<Vec3> = samples.iter().map(|p| p.as_vec3()).collect();
    // every sample is offered to the eight nodes of its cell
    for (number, &sample) in samples.iter().enumerate() {
        let index = geometry.grid_to_index(sample);
        let base = [0, 1, 2].map(|a| index[a].floor().clamp(0.0, geometry.size[a] as f64 - 1.0) as usize);
        for k in base[2]..(base[2] + 2).min(nz) {
            for j in base[1]..(base[1] + 2).min(ny) {
                for i in base[0]..(base[0] + 2).min(nx) {
                    let node = geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64));
                    let squared = node.distance_squared(sample) as f32;
                    let at = geometry.linear(i, j, k);
                    if squared < closest.squared[at] {
                        closest.squared[at] = squared;
                        closest.sample[at] = number as u32;
                    }
                }
            }
        }
    }
    if samples.is_empty() {
        return closest;
    }
    // A node may hear of its sample along one axis from a node that hears of it along another: hence the second round.
    for diagonal in [false, true] {
        for axis in 0..3 {
            for upward in [true, false] {
                sweep(geometry, &single, &mut closest, Sweep { axis, upward, diagonal, limit: (limit * limit) as f32 });
            }
        }
    }
    closest
}

/// Along which axis, which way, whether the four nodes across the corners are asked as well, and up to which squared
/// distance a node is asked.
#[derive(Clone, Copy)]
struct Sweep {
    axis: usize,
    upward: bool,
    diagonal: bool,
    limit: f32,
}

/// Hands closest samples on along an axis, plane by plane: each node asks the nearest nodes of the plane before, five or nine.
fn sweep(geometry: &Geometry, samples: &[Vec3], closest: &mut Closest, how: Sweep) {
    let Sweep { axis, upward, diagonal, limit } = how;
    let size = geometry.size;
    let stride = [1, size[0], size[0] * size[1]];
    // rows of a plane run along `u`, the axis with the smaller stride
    let (u, v) = [(1, 2), (0, 2), (0, 1)][axis];
    let mut plane: Vec<(u32, f32)> = vec![(NONE, f32::INFINITY); size[u] * size[v]];
    for n in 1..size[axis] {
        let (from, to) = if upward { (n - 1, n) } else { (size[axis] - n, size[axis] - 1 - n) };
        let (sample, squared) = (&closest.sample, &closest.squared);
        plane.par_chunks_mut(size[u]).enumerate().for_each(|(b, row)| {
            let mut index = [0.0; 3];
            index[axis] = to as f64;
            index[v] = b as f64;
            for (a, best) in row.iter_mut().enumerate() {
                let at = to * stride[axis] + b * stride[v] + a * stride[u];
                *best = (sample[at], squared[at]);
                index[u] = a as f64;
                let node = geometry.index_to_grid(DVec3::from_array(index)).as_vec3();
                let mut asked = best.0;
                for near_b in b.saturating_sub(1)..(b + 2).min(size[v]) {
                    for near_a in a.saturating_sub(1)..(a + 2).min(size[u]) {
                        if !diagonal && near_a != a && near_b != b {
                            continue;
                        }
                        let near = from * stride[axis] + near_b * stride[v] + near_a * stride[u];
                        let other = sample[near];
                        if other == NONE || other == asked || other == best.0 || squared[near] > limit {
                            continue;
                        }
                        asked = other;
                        let candidate = node.distance_squared(samples[other as usize]);
                        if candidate < best.1 {
                            *best = (other, candidate);
                        }
                    }
                }
            }
        });
        for (b, row) in plane.chunks(size[u]).enumerate() {
            for (a, &(nearest, distance)) in row.iter().enumerate() {
                let at = to * stride[axis] + b * stride[v] + a * stride[u];
                closest.sample[at] = nearest;
                closest.squared[at] = distance;
            }
        }
    }
}
