//! Gradation: lowers h until |grad h| <= delta everywhere.
//!
//! The paper's predecessor runs an upwind scheme that only lowers h, time step by time step; its steady state,
//! h(x) = min over y of h0(y) + delta |x - y|, is an Eikonal problem with boundary values. It is solved by marching from
//! small h to large (Sethian 1996) with a queue of buckets (Yatziv, Bartesaghi and Sapiro 2006); a node that a later
//! one of its bucket still lowers is queued again, so the order within a bucket does not matter.

use isoparticles_common::image::Image;
use std::collections::BTreeMap;

/// Width of a bucket over the least change of h from a node to the next.
const BUCKET: f64 = 0.5;

/// A node is lowered when it gains more than this share.
const LEAST_GAIN: f64 = 1e-6;

/// Lowers h to the steady state; infinite values are filled in. Nodes that come to no less than `enough` may be left as
/// they are: they lower none that is below it.
pub fn limit_gradient(h: &mut Image<f32>, delta: f64, enough: f64) {
    let size = h.geometry.size;
    let rise = (h.geometry.spacing * delta).to_array();
    let strides = [1, size[0], size[0] * size[1]];
    let width = BUCKET * rise[0].min(rise[1]).min(rise[2]);
    let bucket = |value: f64| (value / width) as u64;
    // nodes with the values that they were queued with
    let mut queue: BTreeMap<u64, Vec<(u32, f32)>> = BTreeMap::new();
    for (at, &value) in h.data.iter().enumerate().filter(|(_, value)| value.is_finite()) {
        queue.entry(bucket(f64::from(value))).or_default().push((at as u32, value));
    }
    while let Some((key, nodes)) = queue.pop_first() {
        if key as f64 * width >= enough {
            break;
        }
        for (at, queued) in nodes {
            let (at, value) = (at as usize, f64::from(queued));
            if h.data[at] < queued {
                continue;
            }
            for axis in 0..3 {
                let place = at / strides[axis] % size[axis];
                for next in
                    [(place > 0).then(|| at - strides[axis]), (place + 1 < size[axis]).then(|| at + strides[axis])]
                {
                    let Some(next) = next.filter(|&n| f64::from(h.data[n]) > value) else { continue };
                    let new = upwind(smaller_neighbours(h, next, strides), rise);
                    if new < f64::from(h.data[next]) * (1.0 - LEAST_GAIN) {
                        h.data[next] = new as f32;
                        queue.entry(bucket(new).max(key)).or_default().push((next as u32, new as f32));
                    }
                }
            }
        }
    }
}

/// The smaller of the two neighbours of a node along each axis.
fn smaller_neighbours(h: &Image<f32>, at: usize, strides: [usize; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let (stride, size) = (strides[axis], h.geometry.size[axis]);
        let place = at / stride % size;
        let before = if place > 0 { h.data[at - stride] } else { f32::INFINITY };
        let after = if place + 1 < size { h.data[at + stride] } else { f32::INFINITY };
        f64::from(before.min(after))
    })
}

/// Solves sum over axes of (max(u - a, 0) / rise)^2 = 1 for u: the Godunov scheme of |grad u| = delta.
fn upwind(values: [f64; 3], rise: [f64; 3]) -> f64 {
    let mut order = [(values[0], rise[0]), (values[1], rise[1]), (values[2], rise[2])];
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut u = order[0].0 + order[0].1;
    // p u^2 - 2 q u + r = 1 over the axes that take part
    let (mut p, mut q, mut r) = (0.0, 0.0, 0.0);
    for (n, &(a, s)) in order.iter().enumerate() {
        if n > 0 && u <= a {
            break;
        }
        let w = 1.0 / (s * s);
        p += w;
        q += w * a;
        r += w * a * a;
        let discriminant = q * q - p * (r - 1.0);
        u = (q + discriminant.max(0.0).sqrt()) / p;
    }
    u
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_common::geometry::Geometry;

    #[test]
    fn steady_state_is_a_cone_of_slope_delta() {
        let geometry = Geometry::axis_aligned([41, 37, 33], DVec3::new(1.0, 0.8, 1.5));
        let mut h = Image::filled(geometry.clone(), 100.0f32);
        let source = DVec3::new(20.0, 18.0, 16.0);
        h.data[geometry.linear(20, 18, 16)] = 2.0;
        limit_gradient(&mut h, 0.4, f64::INFINITY);
        for (i, j, k) in [(40, 18, 16), (20, 0, 16), (20, 18, 0), (35, 30, 16), (2, 3, 30)] {
            let distance = ((DVec3::new(i as f64, j as f64, k as f64) - source) * geometry.spacing).length();
            let want = 2.0 + 0.4 * distance;
            let got = f64::from(h.at(i, j, k));
            // a point source is the first-order scheme's worst case: it errs towards larger values (measured: 4.9 % at the
            // far corner)
            assert!(got >= want - 1e-4 && got < 1.06 * want, "{i} {j} {k}: {got}, not {want}");
        }
    }

    #[test]
    fn values_on_the_edge_of_a_bucket_are_handed_on() {
        // a value that f32 rounds down into the bucket before its own was once taken for an outdated one
        for (delta, first) in [(0.4, 4.0f32), (0.4, 9.2), (0.3, 1.2), (0.7, 1.0), (0.25, 0.75)] {
            let geometry = Geometry::axis_aligned([60, 3, 3], DVec3::ONE);
            let mut h = Image::filled(geometry.clone(), f32::INFINITY);
            (0..3).for_each(|k| (0..3).for_each(|j| h.data[geometry.linear(0, j, k)] = first));
            limit_gradient(&mut h, delta, f64::INFINITY);
            for (n, &got) in h.data.iter().enumerate() {
                let want = f64::from(first) + delta * (n % 60) as f64;
                assert!((f64::from(got) / want - 1.0).abs() < 1e-4, "delta {delta}, node {n}: {got}, not {want}");
            }
        }
    }

    #[test]
    fn slopes_of_a_plane_source_are_exact_and_small_slopes_stay() {
        let geometry = Geometry::axis_aligned([30, 5, 5], DVec3::splat(0.5));
        let mut h = Image::filled(geometry.clone(), 0.0f32);
        for n in 0..geometry.voxel_count() {
            let i = n % 30;
            h.data[n] = if i < 10 { 1.0 + 0.1 * i as f32 } else { 50.0 };
        }
        let before = h.clone();
        limit_gradient(&mut h, 0.4, f64::INFINITY);
        for i in 0..30 {
            let want = if i < 10 { f64::from(before.at(i, 2, 2)) } else { 1.9 + 0.2 * (i as f64 - 9.0) };
            assert!((f64::from(h.at(i, 2, 2)) - want).abs() < 1e-5);
        }
    }
}
