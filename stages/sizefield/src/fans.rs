//! Averages along the surface, from triangle to triangle.

use rayon::prelude::*;
use std::ops::{Add, Mul};

/// The triangles at every vertex of a surface.
pub(crate) struct Fans<'a> {
    triangles: &'a [[u32; 3]],
    /// Where the triangles of each vertex start, and where those of the last one end.
    start: Vec<u32>,
    /// Numbers of the triangles, vertex by vertex, in their order.
    at: Vec<u32>,
}

impl<'a> Fans<'a> {
    /// Those of triangles over so many vertices.
    pub(crate) fn new(vertices: usize, triangles: &'a [[u32; 3]]) -> Self {
        let mut start = vec![0u32; vertices + 1];
        for &v in triangles.iter().flatten() {
            start[v as usize + 1] += 1;
        }
        for v in 0..vertices {
            start[v + 1] += start[v];
        }
        let mut next = start.clone();
        let mut at = vec![0; 3 * triangles.len()];
        for (n, t) in triangles.iter().enumerate() {
            for &v in t {
                at[next[v as usize] as usize] = n as u32;
                next[v as usize] += 1;
            }
        }
        Self { triangles, start, at }
    }

    /// The triangles.
    pub(crate) fn triangles(&self) -> &[[u32; 3]] {
        self.triangles
    }

    /// Replaces each vertex's value by the mean over the triangles at it, round by round. The result does not depend on the number of threads.
    pub(crate) fn average<T>(&self, values: &mut [T], zero: T, rounds: usize)
    where
        T: Copy + Add<Output = T> + Mul<f64, Output = T> + Send + Sync,
    {
        let mut before = values.to_vec();
        for _ in 0..rounds {
            before.copy_from_slice(values);
            values.par_iter_mut().enumerate().for_each(|(v, value)| {
                let fan = &self.at[self.start[v] as usize..self.start[v + 1] as usize];
                if !fan.is_empty() {
                    let mean = |t: u32| {
                        let [a, b, c] = self.triangles[t as usize].map(|v| before[v as usize]);
                        (a + b + c) * (1.0 / 3.0)
                    };
                    let sum = fan.iter().fold(zero, |sum, &t| sum + mean(t));
                    *value = sum * (1.0 / fan.len() as f64);
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_becomes_the_mean_of_the_triangles_at_it() {
        // two triangles on one edge, and a vertex of none
        let fans_of = [[0, 1, 2], [2, 1, 3]];
        let mut values = [3.0, 0.0, 6.0, 9.0, 7.0];
        Fans::new(5, &fans_of).average(&mut values, 0.0, 1);
        assert_eq!(values, [3.0, 4.0, 4.0, 5.0, 7.0]);
        Fans::new(5, &fans_of).average(&mut values, 0.0, 100);
        let mean = values[0];
        assert!(values[..4].iter().all(|v| (v - mean).abs() < 1e-12) && values[4] == 7.0, "{values:?}");
    }
}
