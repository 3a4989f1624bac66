//! Finds the nearest sample of every node of a grid, given samples stored at some of the nodes.
//!
//! The axes are processed one after the other. Along each axis, every node takes the nearest of the
//! samples on its line. The squared distance to a sample is a parabola along the line, and the
//! lower envelope of the parabolas gives the nearest samples (Felzenszwalb and Huttenlocher 2012).
//! The cost per node does not depend on the distance to the surface.

use glam::Vec3;
use isoparticles_volume::Geometry;
use rayon::prelude::*;

/// Sample number of a node without a sample.
pub const NO_SAMPLE: u32 = u32::MAX;

/// Replaces the sample index of every node (x fastest) with the index of the nearest sample stored
/// at any node. If no node has a sample, all indices stay [`NO_SAMPLE`]. Samples are in the grid
/// frame (mm).
///
/// The result is exact if every sample lies on the node that stores its index. Otherwise, a nearer
/// sample can be missed; the error is of the order of the distance from a sample to its node.
pub(crate) fn spread(geometry: &Geometry, samples: &[Vec3], sample: &mut [u32]) {
    let [nx, ny, _] = geometry.size;
    let spacing = geometry.spacing;
    sample.par_chunks_mut(nx).enumerate().for_each_init(Envelope::default, |envelope, (row, line)| {
        let (y, z) = ((row % ny) as f64 * spacing.y, (row / ny) as f64 * spacing.z);
        envelope.fill(line, spacing.x, |p| Parabola::new(samples, p, [0, 1, 2], [y, z]));
    });
    sample.par_chunks_mut(nx * ny).enumerate().for_each_init(Envelope::default, |envelope, (k, slice)| {
        let mut rows: Vec<&mut [u32]> = slice.chunks_mut(nx).collect();
        let z = k as f64 * spacing.z;
        envelope
            .fill_across(&mut rows, spacing.y, |i, p| Parabola::new(samples, p, [1, 0, 2], [i as f64 * spacing.x, z]));
    });
    let mut tasks: Vec<Vec<&mut [u32]>> = (0..ny).map(|_| Vec::new()).collect();
    for slice in sample.chunks_mut(nx * ny) {
        tasks.iter_mut().zip(slice.chunks_mut(nx)).for_each(|(task, row)| task.push(row));
    }
    tasks.into_par_iter().enumerate().for_each_init(Envelope::default, |envelope, (j, mut rows)| {
        let y = j as f64 * spacing.y;
        envelope
            .fill_across(&mut rows, spacing.z, |i, p| Parabola::new(samples, p, [2, 0, 1], [i as f64 * spacing.x, y]));
    });
}

/// Squared distance (mm^2) to a sample, as a function of the position on a line.
#[derive(Clone, Copy)]
struct Parabola {
    number: u32,
    /// Position of the minimum on the line, mm.
    centre: f64,
    /// Minimum value, mm^2.
    least: f64,
}

impl Parabola {
    /// Returns the parabola along the first of the three axes. `at` contains the coordinates (mm)
    /// of the line along the other two axes.
    fn new(samples: &[Vec3], number: u32, [along, u, v]: [usize; 3], at: [f64; 2]) -> Self {
        let position = samples[number as usize].as_dvec3();
        Self { number, centre: position[along], least: (position[u] - at[0]).powi(2) + (position[v] - at[1]).powi(2) }
    }
}

/// Workspace for one line.
#[derive(Default)]
struct Envelope {
    column: Vec<u32>,
    all: Vec<Parabola>,
    /// The parabolas of the lower envelope, each with the position (mm) from which it is the
    /// lowest.
    lowest: Vec<(Parabola, f64)>,
}

impl Envelope {
    /// Applies [`Self::fill`] to each column across the rows.
    fn fill_across(&mut self, rows: &mut [&mut [u32]], spacing: f64, parabola: impl Fn(usize, u32) -> Parabola) {
        let width = rows.first().map_or(0, |row| row.len());
        let mut column = std::mem::take(&mut self.column);
        for i in 0..width {
            column.clear();
            column.extend(rows.iter().map(|row| row[i]));
            self.fill(&mut column, spacing, |number| parabola(i, number));
            rows.iter_mut().zip(&column).for_each(|(row, &number)| row[i] = number);
        }
        self.column = column;
    }

    /// Replaces each sample index on a line with the index of the nearest sample on the line.
    fn fill(&mut self, line: &mut [u32], spacing: f64, parabola: impl Fn(u32) -> Parabola) {
        self.all.clear();
        let mut last = NO_SAMPLE;
        for &number in line.iter() {
            if number != NO_SAMPLE && number != last {
                self.all.push(parabola(number));
                last = number;
            }
        }
        // centres may be out of order because a sample need not lie on the node that stores it
        if !self.all.is_sorted_by(|a, b| a.centre <= b.centre) {
            self.all.sort_by(|a, b| a.centre.total_cmp(&b.centre));
        }
        self.lowest.clear();
        for &next in &self.all {
            let mut from = f64::NEG_INFINITY;
            while let Some(&(before, begins)) = self.lowest.last() {
                from = crossing(before, next);
                if from > begins {
                    break;
                }
                self.lowest.pop();
                from = f64::NEG_INFINITY;
            }
            if from < f64::INFINITY {
                self.lowest.push((next, from));
            }
        }
        let mut lowest = self.lowest.iter().peekable();
        let mut number = NO_SAMPLE;
        for (n, own) in line.iter_mut().enumerate() {
            while let Some((parabola, _)) = lowest.next_if(|(_, from)| *from <= n as f64 * spacing) {
                number = parabola.number;
            }
            *own = number;
        }
    }
}

/// Returns the position on the line beyond which the second parabola is lower than the first. The
/// second centre must not be smaller than the first. For equal centres, returns minus infinity
/// (lower everywhere) or infinity (lower nowhere).
fn crossing(first: Parabola, second: Parabola) -> f64 {
    if first.centre == second.centre {
        return if second.least < first.least { f64::NEG_INFINITY } else { f64::INFINITY };
    }
    let height = |p: Parabola| p.centre * p.centre + p.least;
    (height(second) - height(first)) / (2.0 * (second.centre - first.centre))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_field::random::uniform;

    #[test]
    fn every_node_has_the_nearest_sample() {
        // the distance is exact if the samples lie on their nodes; otherwise its error is at most
        // twice the offset
        for (n, count, off) in [(0u64, 1, 0.0), (1, 7, 0.0), (2, 60, 0.0), (3, 60, 0.1)] {
            let geometry = Geometry::axis_aligned([13, 9, 11], DVec3::new(1.0, 0.7, 1.6));
            // place at most one sample at each node, so that no sample is lost
            let mut sample = vec![NO_SAMPLE; geometry.voxel_count()];
            let mut samples = Vec::new();
            for s in 0..count {
                let random = |axis: u64| uniform(5, axis, 1000 * n + s);
                let index = [0, 1, 2].map(|a| (random(a as u64) * geometry.size[a] as f64) as usize);
                let at = geometry.linear(index[0], index[1], index[2]);
                if sample[at] == NO_SAMPLE {
                    sample[at] = samples.len() as u32;
                    let off = off * DVec3::new(random(3) - 0.5, random(4) - 0.5, random(5) - 0.5);
                    let index = DVec3::from_array(index.map(|i| i as f64));
                    samples.push((geometry.index_to_grid(index) + off).as_vec3());
                }
            }
            spread(&geometry, &samples, &mut sample);
            let [nx, ny, _] = geometry.size;
            for (at, &number) in sample.iter().enumerate() {
                let index = DVec3::new((at % nx) as f64, (at / nx % ny) as f64, (at / (nx * ny)) as f64);
                let node = geometry.index_to_grid(index).as_vec3();
                let distance = |p: &Vec3| node.distance(*p);
                let nearest = samples.iter().map(distance).fold(f32::INFINITY, f32::min);
                assert!(
                    distance(&samples[number as usize]) <= nearest + 2.0 * off as f32 + 1e-5,
                    "{count}: node {index}"
                );
            }
        }
    }

    #[test]
    fn without_samples_no_node_has_a_sample() {
        let geometry = Geometry::axis_aligned([3, 2, 2], DVec3::ONE);
        let mut sample = vec![NO_SAMPLE; 12];
        spread(&geometry, &[], &mut sample);
        assert!(sample.iter().all(|&number| number == NO_SAMPLE));
    }
}
