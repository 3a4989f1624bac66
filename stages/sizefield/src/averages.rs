//! Smooths values at the vertices of a surface by averaging over the adjacent triangles.
//!
//! On a hexagonal lattice with edge length L, one round gives a vertex the weight 1/3 and each of
//! its six neighbours the weight 1/9. The variance of these weights along any tangent direction is
//! (6 / 9) L^2 / 2 = L^2 / 3, so n rounds act like a Gaussian with a standard deviation of
//! L sqrt(n / 3).

use isoparticles_mesh::incidence::Incidence;
use rayon::prelude::*;
use std::ops::{Add, Mul};

/// Replaces the value of each vertex by the mean value of its adjacent triangles, `rounds` times.
/// The value of a triangle is the mean of its corner values. The result does not depend on the
/// number of threads. Vertices without triangles keep their values.
pub(crate) fn average<T>(surface: &Incidence<'_>, values: &mut [T], zero: T, rounds: usize)
where
    T: Copy + Add<Output = T> + Mul<f64, Output = T> + Send + Sync,
{
    let mut before = values.to_vec();
    for _ in 0..rounds {
        before.copy_from_slice(values);
        values.par_iter_mut().enumerate().for_each(|(v, value)| {
            let fan = surface.of(v as u32);
            if !fan.is_empty() {
                let mean = |t: u32| {
                    let [a, b, c] = surface.triangles()[t as usize].map(|v| before[v as usize]);
                    (a + b + c) * (1.0 / 3.0)
                };
                let sum = fan.iter().fold(zero, |sum, &t| sum + mean(t));
                *value = sum * (1.0 / fan.len() as f64);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_becomes_the_mean_of_the_triangles_at_it() {
        // two triangles with a common edge; vertex 4 has no triangle, so it keeps its value
        let triangles = [[0, 1, 2], [2, 1, 3]];
        let mut values = [3.0, 0.0, 6.0, 9.0, 7.0];
        let surface = Incidence::new(&triangles, 5);
        average(&surface, &mut values, 0.0, 1);
        assert_eq!(values, [3.0, 4.0, 4.0, 5.0, 7.0]);
        average(&surface, &mut values, 0.0, 100);
        let mean = values[0];
        assert!(values[..4].iter().all(|v| (v - mean).abs() < 1e-12) && values[4] == 7.0, "{values:?}");
    }
}
