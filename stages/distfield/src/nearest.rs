//! The nearest surface sample of every node, or one nearly as near: samples are handed on from node to node (a vector distance
//! transform after Danielsson 1980).
//!
//! Far from the surface many samples are about equally near, each nearest to a region thinner than a voxel, and what is handed on in
//! few steps strays. So the far field starts from a grid of every second node, on which thorough sweeps along all axes are
//! cheap; every node is then offered the samples of the coarse nodes round it.

use glam::{DVec3, Vec3};
use isoparticles_common::geometry::Geometry;
use rayon::prelude::*;
use std::ops::Range;

/// In place of the number of a sample where a node has none.
pub const NONE: u32 = u32::MAX;

/// Nodes of the grid to one of the coarse grid, along each axis.
const STRIDE: usize = 2;

/// Nearest sample of every node (x fastest), and its squared distance (mm squared).
pub struct Nearest {
    /// Number of the sample, or [`NONE`].
    pub sample: Vec<u32>,
    /// Squared distance; infinite where there is no sample.
    pub squared: Vec<f32>,
}

/// The nearest sample of every node within `limit` mm of the surface; farther away some other sample or none.
pub fn nearest_samples(geometry: &Geometry, samples: &[DVec3], limit: f64) -> Nearest {
    if samples.is_empty() {
        return Nearest::none(geometry);
    }
    let single: Vec<Vec3> = samples.par_iter().map(|p| p.as_vec3()).collect();
    let mut nearest = Nearest::none(geometry);
    let fine = Transform { geometry, samples: &single, limit: (limit * limit) as f32 };
    fine.offer_to_cells(&mut nearest);
    if limit.is_infinite() {
        let coarse_geometry = Geometry {
            size: geometry.size.map(|n| (n - 1).div_ceil(STRIDE) + 1),
            spacing: geometry.spacing * STRIDE as f64,
            ..geometry.clone()
        };
        let mut coarse = Nearest::none(&coarse_geometry);
        let transform = Transform { geometry: &coarse_geometry, ..fine };
        transform.offer_to_cells(&mut coarse);
        // A node may hear of its sample along one axis from a node that hears of it along another: hence the second round.
        for diagonal in [false, true] {
            for axis in 0..3 {
                transform.sweep(&mut coarse, Sweep { axis, upward: true, diagonal });
                transform.sweep(&mut coarse, Sweep { axis, upward: false, diagonal });
            }
        }
        fine.take_from_coarse(&mut nearest, &coarse, &coarse_geometry);
    }
    fine.within_planes(&mut nearest);
    fine.sweep(&mut nearest, Sweep { axis: 2, upward: true, diagonal: true });
    fine.sweep(&mut nearest, Sweep { axis: 2, upward: false, diagonal: true });
    fine.within_planes(&mut nearest);
    nearest
}

impl Nearest {
    fn none(geometry: &Geometry) -> Self {
        let count = geometry.voxel_count();
        Self { sample: vec![NONE; count], squared: vec![f32::INFINITY; count] }
    }

    /// Planes of constant z, or rows along x, `length` nodes each.
    fn chunks(&mut self, length: usize) -> impl IndexedParallelIterator<Item = (&mut [u32], &mut [f32])> {
        self.sample.par_chunks_mut(length).zip(self.squared.par_chunks_mut(length))
    }
}

/// Along which axis, which way, and whether the four nodes across the corners are asked as well.
#[derive(Clone, Copy)]
struct Sweep {
    axis: usize,
    upward: bool,
    diagonal: bool,
}

/// The samples on their way over a grid.
#[derive(Clone, Copy)]
struct Transform<'a> {
    geometry: &'a Geometry,
    samples: &'a [Vec3],
    /// Squared distance (mm squared) up to which a node is asked.
    limit: f32,
}

impl Transform<'_> {
    fn node(&self, i: usize, j: usize, k: usize) -> Vec3 {
        self.geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64)).as_vec3()
    }

    /// Gives a node at `place` the sample of another where that is nearer than its own.
    #[inline(always)]
    fn take(&self, place: Vec3, own: &mut (u32, f32), other: (u32, f32)) {
        if other.0 == NONE || other.0 == own.0 || other.1 > self.limit {
            return;
        }
        let squared = place.distance_squared(self.samples[other.0 as usize]);
        if squared < own.1 {
            *own = (other.0, squared);
        }
    }

    /// Offers every sample to the eight nodes of its cell.
    fn offer_to_cells(&self, nearest: &mut Nearest) {
        let [nx, ny, nz] = self.geometry.size;
        let step = self.geometry.spacing.recip().as_vec3();
        let cell = |sample: Vec3| {
            let index = sample * step;
            [0, 1, 2].map(|a| (index[a].max(0.0) as usize).min(self.geometry.size[a] - 1))
        };
        let mut by_plane: Vec<Vec<u32>> = vec![Vec::new(); nz];
        for (number, &sample) in self.samples.iter().enumerate() {
            by_plane[cell(sample)[2]].push(number as u32);
        }
        nearest.chunks(nx * ny).enumerate().for_each(|(k, (sample, squared))| {
            for number in by_plane[k.saturating_sub(1)..=k].iter().flatten() {
                let [i0, j0, _] = cell(self.samples[*number as usize]);
                for j in j0..(j0 + 2).min(ny) {
                    for i in i0..(i0 + 2).min(nx) {
                        let at = j * nx + i;
                        let mut own = (sample[at], squared[at]);
                        self.take(self.node(i, j, k), &mut own, (*number, 0.0));
                        (sample[at], squared[at]) = own;
                    }
                }
            }
        });
    }

    /// Every node takes the nearest of the samples of the coarse nodes round it.
    fn take_from_coarse(&self, nearest: &mut Nearest, coarse: &Nearest, geometry: &Geometry) {
        let [nx, ny, _] = self.geometry.size;
        let around = |n: usize| [n / STRIDE, n.div_ceil(STRIDE)];
        nearest.chunks(nx).enumerate().for_each(|(row, (sample, squared))| {
            let (j, k) = (row % ny, row / ny);
            let mut lines = around(k).map(|c| around(j).map(|b| geometry.linear(0, b, c))).concat();
            lines.dedup();
            for i in 0..nx {
                let (place, mut own) = (self.node(i, j, k), (sample[i], squared[i]));
                for line in &lines {
                    for a in around(i) {
                        self.take(place, &mut own, (coarse.sample[line + a], 0.0));
                    }
                }
                (sample[i], squared[i]) = own;
            }
        });
    }

    /// Hands samples on within each plane of constant z: from row to row both ways, each row along itself both ways.
    fn within_planes(&self, nearest: &mut Nearest) {
        let [nx, ny, _] = self.geometry.size;
        nearest.chunks(nx * ny).enumerate().for_each(|(k, (sample, squared))| {
            let rows = (0..ny).map(|j| (j, j.checked_sub(1)));
            let back = (0..ny).rev().map(|j| (j, Some(j + 1).filter(|&before| before < ny)));
            for (j, before) in rows.chain(back) {
                let mut ask = |i: usize, others: Range<usize>| {
                    let (place, mut own) = (self.node(i, j, k), (sample[j * nx + i], squared[j * nx + i]));
                    for n in others {
                        self.take(place, &mut own, (sample[n], squared[n]));
                    }
                    (sample[j * nx + i], squared[j * nx + i]) = own;
                };
                if let Some(before) = before {
                    let row = before * nx;
                    (0..nx).for_each(|i| ask(i, row + i.saturating_sub(1)..row + (i + 2).min(nx)));
                }
                let row = j * nx;
                (1..nx).for_each(|i| ask(i, row + i - 1..row + i));
                (0..nx - 1).rev().for_each(|i| ask(i, row + i + 1..row + i + 2));
            }
        });
    }

    /// Hands samples on along an axis, plane by plane: each node asks the nearest nodes of the plane before, five or nine.
    fn sweep(&self, nearest: &mut Nearest, how: Sweep) {
        let Sweep { axis, upward, diagonal } = how;
        let size = self.geometry.size;
        let stride = [1, size[0], size[0] * size[1]];
        // rows of a plane run along `u`, the axis with the smaller stride
        let (u, v) = [(1, 2), (0, 2), (0, 1)][axis];
        let mut plane: Vec<(u32, f32)> = vec![(NONE, f32::INFINITY); size[u] * size[v]];
        for n in 1..size[axis] {
            let (from, to) = if upward { (n - 1, n) } else { (size[axis] - n, size[axis] - 1 - n) };
            let (sample, squared) = (&nearest.sample, &nearest.squared);
            plane.par_chunks_mut(size[u]).enumerate().for_each(|(b, row)| {
                let mut index = [0; 3];
                index[axis] = to;
                index[v] = b;
                for (a, best) in row.iter_mut().enumerate() {
                    let at = to * stride[axis] + b * stride[v] + a * stride[u];
                    *best = (sample[at], squared[at]);
                    index[u] = a;
                    let [i, j, k] = index;
                    let place = self.node(i, j, k);
                    for near_b in b.saturating_sub(1)..(b + 2).min(size[v]) {
                        for near_a in a.saturating_sub(1)..(a + 2).min(size[u]) {
                            if !diagonal && near_a != a && near_b != b {
                                continue;
                            }
                            let near = from * stride[axis] + near_b * stride[v] + near_a * stride[u];
                            self.take(place, best, (sample[near], squared[near]));
                        }
                    }
                }
            });
            for (b, row) in plane.chunks(size[u]).enumerate() {
                for (a, &(number, distance)) in row.iter().enumerate() {
                    let at = to * stride[axis] + b * stride[v] + a * stride[u];
                    nearest.sample[at] = number;
                    nearest.squared[at] = distance;
                }
            }
        }
    }
}
