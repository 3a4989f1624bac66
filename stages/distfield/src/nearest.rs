//! Finds the nearest, or nearly the nearest, surface sample of every node. Samples propagate from
//! node to node (a vector distance transform after Danielsson 1980).
//!
//! Far from the surface, many samples are about equally near. The region where one of them is the
//! nearest can be thinner than a voxel, and propagation misses such regions. The far field is
//! therefore first computed on a coarse grid of every second node, where the nearest samples are
//! found line by line (`envelope.rs`). Every node of the fine grid then tests the samples of the
//! surrounding coarse nodes. During propagation, nodes far from the surface take samples only from
//! the adjacent slices. The fine grid is processed in slabs, so only the coarse grid is in memory
//! as a whole.

pub use crate::envelope::NO_SAMPLE;
use crate::envelope::spread;
use glam::{DVec3, Vec3};
use isoparticles_volume::{Geometry, reverse_slices};
use rayon::prelude::*;
use std::ops::Range;

/// Ratio of the coarse spacing to the fine spacing along each axis. With 2, the coarse grid has an
/// eighth of the nodes.
pub(crate) const STRIDE: usize = 2;

/// Distance beyond `near`, in units of the maximum spacing, from which nodes take no samples from
/// other nodes of their own slice. If `near` is the half-width of the exact band of `crate::field`
/// (4 voxels), the total distance from the surface is twice the half-width. On three volumes, F
/// within this total distance changes by 0.004 voxel (root mean square) if nodes beyond it take no
/// samples from their neighbours.
const FAR_BEYOND: f64 = 4.0;

/// Approximate number of nodes of a slab. It bounds the memory: the sample indices of a slab take
/// 40 MiB. Smaller grids form a single slab.
const SLAB_NODES: usize = 10 << 20;

/// Minimum number of slices in a slab. With isotropic voxels and a band of 4 voxels, a slab
/// computes six more slices than it returns: one before and five after its own slices. With at
/// least eight slices of its own, the total work is less than doubled.
const LEAST_SLICES: usize = 8;

/// The nearest samples of the nodes in a range of slices.
pub struct Slab {
    /// The slices of the grid that belong to the slab.
    pub own: Range<usize>,
    /// Index of the first slice in `sample`: one before `own`, if there is one.
    pub first: usize,
    /// Sample indices of the nodes (x fastest), or [`NO_SAMPLE`], from slice `first` to a few
    /// slices beyond `own`.
    pub sample: Vec<u32>,
}

/// Computes the nearest sample of every node within `limit` mm of the surface, slab by slab from
/// the first slice to the last. Nodes farther away have an arbitrary sample or none. If `limit` is
/// infinite, the sample of a node is the nearest one if it is within `near` mm of the node, and
/// nearly the nearest one otherwise.
///
/// `values` has one entry per node. For each slab, `visit` receives the entries of the slab's own
/// nodes. These entries contain the squared distances (mm^2) from the nodes to their samples, or
/// infinity where there is no sample. Values that `visit` writes there are kept.
pub fn nearest_samples(
    geometry: &Geometry,
    samples: &[DVec3],
    limit: f64,
    near: f64,
    values: &mut [f32],
    mut visit: impl FnMut(&Slab, &mut [f32]),
) {
    let single: Vec<Vec3> = samples.par_iter().map(|p| p.as_vec3()).collect();
    let far = if limit.is_infinite() { near + FAR_BEYOND * geometry.spacing.max_element() } else { limit };
    let square = |length: f64| (length * length) as f32;
    let fine = Transform { geometry, first: 0, samples: &single, limit: square(limit), far: square(far) };
    let mut coarse = limit.is_infinite().then(|| fine.coarse());
    let by_slice = fine.by_slice();
    let [nx, ny, nz] = geometry.size;
    let plane = nx * ny;
    // a sample propagates from a corner of its cell, which may be a voxel farther from the node
    let ahead = (limit.min(near) / geometry.spacing.z).ceil() as usize + 1;
    let slices = (SLAB_NODES / plane).max(LEAST_SLICES);
    let mut slab = Slab { own: 0..0, first: 0, sample: Vec::new() };
    while slab.own.end < nz {
        let own = slab.own.end..(slab.own.end + slices).min(nz);
        let first = own.start.saturating_sub(1);
        let end = (own.end + ahead).min(nz);
        slab.keep(first..own.start, plane);
        slab.sample.resize((end - first) * plane, NO_SAMPLE);
        slab.own = own.clone();
        let part = Geometry { size: [nx, ny, end - first], ..geometry.clone() };
        let transform = Transform { geometry: &part, first, ..fine };
        let before = values[first * plane..own.start * plane].to_vec();
        let squared = &mut values[first * plane..end * plane];
        transform.measure(&slab.sample, squared);
        let mut nearest = Nearest { sample: &mut slab.sample, squared };
        transform.assign_in_cells(&mut nearest, &by_slice);
        if let Some(coarse) = &mut coarse {
            transform.take_from_coarse(&mut nearest, coarse);
            coarse.free_below(own.end - 1);
        }
        transform.propagate(&mut nearest);
        values[first * plane..own.start * plane].copy_from_slice(&before);
        visit(&slab, &mut values[own.start * plane..own.end * plane]);
    }
}

impl Slab {
    /// Keeps the samples of `slices` only.
    fn keep(&mut self, slices: Range<usize>, plane: usize) {
        let range = (slices.start - self.first) * plane..(slices.end - self.first) * plane;
        self.sample.copy_within(range.clone(), 0);
        self.sample.truncate(range.len());
        self.first = slices.start;
    }
}

/// Nearest samples of nodes (x fastest), with their squared distances.
struct Nearest<'a> {
    /// Index of the sample, or [`NO_SAMPLE`].
    sample: &'a mut [u32],
    /// Squared distance, mm^2; infinite where there is no sample.
    squared: &'a mut [f32],
}

impl Nearest<'_> {
    /// Returns chunks of `length` nodes: slices of constant z, or rows along x.
    fn chunks(&mut self, length: usize) -> impl IndexedParallelIterator<Item = (&mut [u32], &mut [f32])> {
        self.sample.par_chunks_mut(length).zip(self.squared.par_chunks_mut(length))
    }
}

/// The nearest samples of the nodes of the coarse grid. Slices are stored from last to first, so
/// that slices no longer needed are at the end and their memory can be freed.
struct Coarse {
    geometry: Geometry,
    sample: Vec<u32>,
}

impl Coarse {
    /// Returns the samples of the row at y index `j` and z index `k`.
    fn row(&self, j: usize, k: usize) -> &[u32] {
        let [nx, ny, nz] = self.geometry.size;
        &self.sample[((nz - 1 - k) * ny + j) * nx..][..nx]
    }

    /// Frees the coarse slices that are needed only for fine slices below `k`.
    fn free_below(&mut self, k: usize) {
        let [nx, ny, nz] = self.geometry.size;
        self.sample.truncate(nz.saturating_sub(k / STRIDE) * nx * ny);
        self.sample.shrink_to_fit();
    }
}

/// Sample indices sorted by slice of the grid.
struct BySlice {
    start: Vec<usize>,
    numbers: Vec<u32>,
}

/// A distance transform that propagates samples over a grid or a slab of a grid.
#[derive(Clone, Copy)]
struct Transform<'a> {
    geometry: &'a Geometry,
    /// Index of the first slice in the whole grid.
    first: usize,
    samples: &'a [Vec3],
    /// Squared distance (mm^2) beyond which a node's sample does not propagate.
    limit: f32,
    /// Squared distance (mm^2) beyond which a node takes no sample from its own slice. Its sample
    /// then comes from the coarse grid or an adjacent slice.
    far: f32,
}

impl Transform<'_> {
    fn node(&self, i: usize, j: usize, k: usize) -> Vec3 {
        self.geometry.index_to_grid(DVec3::new(i as f64, j as f64, (self.first + k) as f64)).as_vec3()
    }

    /// Computes the nearest samples of the nodes of a coarse grid that covers the whole grid.
    fn coarse(&self) -> Coarse {
        let geometry = Geometry {
            size: self.geometry.size.map(|n| (n - 1).div_ceil(STRIDE) + 1),
            spacing: self.geometry.spacing * STRIDE as f64,
            ..self.geometry.clone()
        };
        let mut sample = vec![NO_SAMPLE; geometry.voxel_count()];
        let mut squared = vec![f32::INFINITY; geometry.voxel_count()];
        let transform = Transform { geometry: &geometry, far: f32::INFINITY, ..*self };
        transform.assign_in_cells(&mut Nearest { sample: &mut sample, squared: &mut squared }, &transform.by_slice());
        spread(&geometry, self.samples, &mut sample);
        transform.measure(&sample, &mut squared);
        transform.propagate(&mut Nearest { sample: &mut sample, squared: &mut squared });
        drop(squared);
        reverse_slices(&mut sample, geometry.size[0] * geometry.size[1]);
        Coarse { geometry, sample }
    }

    /// Returns the lowest node, in the whole grid, of the cell that contains a sample.
    fn cell(&self, sample: Vec3) -> [usize; 3] {
        let index = sample * self.geometry.spacing.recip().as_vec3();
        [0, 1, 2].map(|a| index[a].max(0.0) as usize)
    }

    /// Sorts the sample indices by the slice of the cell that contains the sample, in ascending
    /// order within a slice. Samples beyond the last slice are assigned to the last slice.
    fn by_slice(&self) -> BySlice {
        let nz = self.geometry.size[2];
        let slice = |sample: Vec3| self.cell(sample)[2].min(nz - 1);
        let mut start = vec![0; nz + 1];
        self.samples.iter().for_each(|&sample| start[slice(sample) + 1] += 1);
        (0..nz).for_each(|k| start[k + 1] += start[k]);
        let mut next = start.clone();
        let mut numbers = vec![0; self.samples.len()];
        for (number, &sample) in self.samples.iter().enumerate() {
            let index = &mut next[slice(sample)];
            numbers[*index] = number as u32;
            *index += 1;
        }
        BySlice { start, numbers }
    }

    /// Replaces a node's sample with the sample of another node if that sample is nearer.
    /// `position` returns the position of the node. It is called only if the samples differ,
    /// because most neighbours have the same sample.
    #[inline(always)]
    fn take(&self, position: impl Fn() -> Vec3, own: &mut (u32, f32), other: (u32, f32)) {
        if other.0 == own.0 || other.0 == NO_SAMPLE || other.1 > self.limit {
            return;
        }
        let squared = position().distance_squared(self.samples[other.0 as usize]);
        if squared < own.1 {
            *own = (other.0, squared);
        }
    }

    /// Computes the squared distances (mm^2) from the nodes to their samples.
    fn measure(&self, sample: &[u32], squared: &mut [f32]) {
        let [nx, ny, _] = self.geometry.size;
        squared.par_chunks_mut(nx).zip(sample.par_chunks(nx)).enumerate().for_each(|(row, (squared, sample))| {
            for (i, (squared, &number)) in squared.iter_mut().zip(sample).enumerate() {
                *squared = match number {
                    NO_SAMPLE => f32::INFINITY,
                    number => self.node(i, row % ny, row / ny).distance_squared(self.samples[number as usize]),
                };
            }
        });
    }

    /// Tests every sample at the eight nodes of its cell.
    fn assign_in_cells(&self, nearest: &mut Nearest, by_slice: &BySlice) {
        let [nx, ny, _] = self.geometry.size;
        nearest.chunks(nx * ny).enumerate().for_each(|(k, (sample, squared))| {
            let slice = self.first + k;
            let numbers = by_slice.start[slice.saturating_sub(1)]..by_slice.start[slice + 1];
            for number in &by_slice.numbers[numbers] {
                let [i0, j0, _] = self.cell(self.samples[*number as usize]);
                for j in j0.min(ny - 1)..(j0 + 2).min(ny) {
                    for i in i0.min(nx - 1)..(i0 + 2).min(nx) {
                        let at = j * nx + i;
                        let mut own = (sample[at], squared[at]);
                        self.take(|| self.node(i, j, k), &mut own, (*number, 0.0));
                        (sample[at], squared[at]) = own;
                    }
                }
            }
        });
    }

    /// Tests, at every node, the samples of the surrounding coarse nodes.
    fn take_from_coarse(&self, nearest: &mut Nearest, coarse: &Coarse) {
        let [nx, ny, _] = self.geometry.size;
        let around = |n: usize| [n / STRIDE, n.div_ceil(STRIDE)];
        nearest.chunks(nx).enumerate().for_each(|(row, (sample, squared))| {
            let (j, k) = (row % ny, row / ny);
            let mut lines = around(self.first + k).map(|c| around(j).map(|b| (b, c))).concat();
            lines.dedup();
            let lines: Vec<&[u32]> = lines.into_iter().map(|(b, c)| coarse.row(b, c)).collect();
            for i in 0..nx {
                let mut own = (sample[i], squared[i]);
                for line in &lines {
                    for a in around(i) {
                        self.take(|| self.node(i, j, k), &mut own, (line[a], 0.0));
                    }
                }
                (sample[i], squared[i]) = own;
            }
        });
    }

    /// Propagates samples over the grid.
    fn propagate(&self, nearest: &mut Nearest) {
        self.within_planes(nearest);
        self.between_planes(nearest, true);
        self.between_planes(nearest, false);
        self.within_planes(nearest);
    }

    /// Propagates samples within each slice of constant z: from row to row in both directions, and
    /// along each row in both directions.
    fn within_planes(&self, nearest: &mut Nearest) {
        let [nx, ny, _] = self.geometry.size;
        nearest.chunks(nx * ny).enumerate().for_each(|(k, (sample, squared))| {
            let rows = (0..ny).map(|j| (j, j.checked_sub(1)));
            let back = (0..ny).rev().map(|j| (j, Some(j + 1).filter(|&before| before < ny)));
            for (j, before) in rows.chain(back) {
                let mut visit = |i: usize, others: Range<usize>| {
                    let mut own = (sample[j * nx + i], squared[j * nx + i]);
                    // a node without a sample is at infinite distance but still needs a sample
                    if own.0 != NO_SAMPLE && own.1 > self.far {
                        return;
                    }
                    for n in others {
                        self.take(|| self.node(i, j, k), &mut own, (sample[n], squared[n]));
                    }
                    (sample[j * nx + i], squared[j * nx + i]) = own;
                };
                if let Some(before) = before {
                    let row = before * nx;
                    (0..nx).for_each(|i| visit(i, row + i.saturating_sub(1)..row + (i + 2).min(nx)));
                }
                let row = j * nx;
                (1..nx).for_each(|i| visit(i, row + i - 1..row + i));
                (0..nx - 1).rev().for_each(|i| visit(i, row + i + 1..row + i + 2));
            }
        });
    }

    /// Propagates samples from slice to slice: each node tests the samples of the nine nearest
    /// nodes in the previous slice.
    fn between_planes(&self, nearest: &mut Nearest, upward: bool) {
        let [nx, ny, nz] = self.geometry.size;
        let plane = nx * ny;
        for n in 1..nz {
            let k = if upward { n } else { nz - 1 - n };
            let cut = if upward { k } else { k + 1 } * plane;
            let (low_sample, high_sample) = nearest.sample.split_at_mut(cut);
            let (low_squared, high_squared) = nearest.squared.split_at_mut(cut);
            let (sample, squared, from_sample, from_squared) = if upward {
                let from = cut - plane..;
                (high_sample, high_squared, &low_sample[from.clone()], &low_squared[from])
            } else {
                let own = cut - plane..;
                (&mut low_sample[own.clone()], &mut low_squared[own], &*high_sample, &*high_squared)
            };
            let rows = sample[..plane].par_chunks_mut(nx).zip(squared[..plane].par_chunks_mut(nx));
            rows.enumerate().for_each(|(j, (sample, squared))| {
                for i in 0..nx {
                    let mut own = (sample[i], squared[i]);
                    let mut tried = NO_SAMPLE;
                    for near_j in j.saturating_sub(1)..(j + 2).min(ny) {
                        for near_i in i.saturating_sub(1)..(i + 2).min(nx) {
                            let near = near_j * nx + near_i;
                            // neighbours often have the same sample
                            if std::mem::replace(&mut tried, from_sample[near]) != from_sample[near] {
                                self.take(|| self.node(i, j, k), &mut own, (from_sample[near], from_squared[near]));
                            }
                        }
                    }
                    (sample[i], squared[i]) = own;
                }
            });
        }
    }
}
