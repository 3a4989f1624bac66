//! Gradation: lowers h until |grad h| <= delta everywhere.
//!
//! Meyer et al. (2007) lower h in time steps with an upwind scheme. The steady state is `h(x) = min
//! over y of (h0(y) + delta |x - y|)`, where h0 is the initial field. It solves an Eikonal
//! equation, so this module computes it by marching from small h to large h (Sethian 1996) with a
//! bucket queue (Yatziv, Bartesaghi and Sapiro 2006). A node is queued again whenever its value
//! drops, so the order within a bucket does not matter.
//!
//! `blocks.rs` marches over the grid block by block, several buckets at a time. `scheme.rs` solves
//! |grad h| = delta at a single node.

use crate::blocks::Blocks;
pub use crate::scheme::NodeSet;
use crate::scheme::{Scheme, Values};
use isoparticles_volume::Image;

/// Lowers h to the steady state. h may be infinite where it is not given. If `asked` is given, only
/// the nodes in it are guaranteed to reach the steady state; other nodes may remain above it or
/// infinite. The result does not depend on the number of threads.
pub fn limit_gradient(h: &mut Image<f32>, delta: f64, asked: Option<&NodeSet>) {
    let size = h.geometry.size;
    let scheme = Scheme::new(size, (h.geometry.spacing * delta).to_array());
    let values = Values::new(std::mem::take(&mut h.data), size);
    Blocks::new(size, &scheme, &values, asked).march();
    h.data = values.into_data(size);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_field::random::uniform;
    use isoparticles_volume::Geometry;

    #[test]
    fn steady_state_is_a_cone_of_slope_delta() {
        let geometry = Geometry::axis_aligned([41, 37, 33], DVec3::new(1.0, 0.8, 1.5));
        let mut h = Image::filled(geometry.clone(), 100.0f32);
        let source = DVec3::new(20.0, 18.0, 16.0);
        h.data[geometry.linear(20, 18, 16)] = 2.0;
        limit_gradient(&mut h, 0.4, None);
        for (i, j, k) in [(40, 18, 16), (20, 0, 16), (20, 18, 0), (35, 30, 16), (2, 3, 30)] {
            let distance = ((DVec3::new(i as f64, j as f64, k as f64) - source) * geometry.spacing).length();
            let want = 2.0 + 0.4 * distance;
            let got = f64::from(h.at(i, j, k));
            // the first-order scheme overestimates h, most of all around a point source (measured:
            // by 4.9 % at the far corner)
            assert!(got >= want - 1e-4 && got < 1.06 * want, "{i} {j} {k}: {got}, not {want}");
        }
    }

    /// Repeated sweeps over all nodes converge to the same values as the march in blocks.
    #[test]
    fn blocks_come_to_the_steady_state_of_plain_sweeps() {
        let size = [71, 40, 35];
        let geometry = Geometry::axis_aligned(size, DVec3::new(1.0, 0.7, 1.9));
        let mut h = Image::filled(geometry.clone(), f32::INFINITY);
        for n in 0..40 {
            let at: [usize; 3] = std::array::from_fn(|a| (uniform(3, a as u64, n) * size[a] as f64) as usize);
            h.data[geometry.linear(at[0], at[1], at[2])] = (1.0 + 30.0 * uniform(3, 3, n)) as f32;
        }
        let scheme = Scheme::new(size, (geometry.spacing * 0.4).to_array());
        let swept = Values::new(h.data.clone(), size);
        // the border contains no finite value
        let finite = |values: &[f32]| values.iter().filter(|value| value.is_finite()).count();
        let bordered: Vec<f32> = (0..size.map(|n| n + 2).iter().product()).map(|n| swept.get(n)).collect();
        assert_eq!(finite(&bordered), finite(&h.data));
        let [sx, sy, sz] = scheme.strides;
        let nodes: Vec<usize> = (1..=size[2])
            .flat_map(|k| (1..=size[1]).flat_map(move |j| (1..=size[0]).map(move |i| i * sx + j * sy + k * sz)))
            .collect();
        let is_reached = |n: usize| scheme.strides.iter().any(|s| swept.get(n - s).min(swept.get(n + s)).is_finite());
        let lower = |n: usize| is_reached(n) && scheme.lower(&swept, n).is_some();
        // each iteration runs both sweeps, even if the first one changes something
        while nodes.iter().filter(|&&n| lower(n)).count() + nodes.iter().rev().filter(|&&n| lower(n)).count() > 0 {}
        let want = swept.into_data(size);
        let on = |threads: usize| {
            let mut h = h.clone();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| limit_gradient(&mut h, 0.4, None));
            h.data
        };
        let alone = on(1);
        assert!(alone == on(4), "the values depend on the number of threads");
        for (n, (&got, &want)) in alone.iter().zip(&want).enumerate() {
            // both methods skip decreases below 1e-6 of the value, so their results differ slightly
            assert!((got / want - 1.0).abs() < 2e-5, "node {n}: {got}, not {want}");
        }
    }

    #[test]
    fn requested_nodes_get_the_values_of_a_full_sweep() {
        let geometry = Geometry::axis_aligned([70, 51, 44], DVec3::new(1.0, 0.8, 1.3));
        let mut h = Image::filled(geometry.clone(), f32::INFINITY);
        let mut asked = NodeSet::new(h.data.len());
        // random sizes in a plane; they differ by more than delta allows, so distant nodes
        // determine most of the final values
        for (i, j) in (0..70).flat_map(|i| (0..51).map(move |j| (i, j))) {
            let node = geometry.linear(i, j, 20);
            h.data[node] = (1.0 + 30.0 * uniform(1, 0, (i / 9 + 100 * (j / 7)) as u64)) as f32;
            asked.insert(node);
        }
        let mut whole = h.clone();
        limit_gradient(&mut whole, 0.4, None);
        let changed = h.data.iter().zip(&whole.data).filter(|(before, after)| before.is_finite() && before > after);
        assert!(changed.count() > 2000);
        limit_gradient(&mut h, 0.4, Some(&asked));
        assert!((0..h.data.len()).filter(|&n| asked.contains(n)).all(|n| h.data[n] == whole.data[n]));
        let left = h.data.iter().filter(|value| value.is_infinite()).count();
        assert!(left > h.data.len() / 10, "{left} of {} were left alone", h.data.len());
    }

    #[test]
    fn values_on_the_edge_of_a_bucket_are_handed_on() {
        // regression: a value that f32 rounds into the previous bucket must not be treated as
        // outdated
        for (delta, first) in [(0.4, 4.0f32), (0.4, 9.2), (0.3, 1.2), (0.7, 1.0), (0.25, 0.75)] {
            let geometry = Geometry::axis_aligned([60, 3, 3], DVec3::ONE);
            let mut h = Image::filled(geometry.clone(), f32::INFINITY);
            (0..3).for_each(|k| (0..3).for_each(|j| h.data[geometry.linear(0, j, k)] = first));
            limit_gradient(&mut h, delta, None);
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
        limit_gradient(&mut h, 0.4, None);
        for i in 0..30 {
            let want = if i < 10 { f64::from(before.at(i, 2, 2)) } else { 1.9 + 0.2 * (i as f64 - 9.0) };
            assert!((f64::from(h.at(i, 2, 2)) - want).abs() < 1e-5);
        }
    }
}
