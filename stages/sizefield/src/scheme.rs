//! Solves |grad h| = delta at the nodes of a grid with an upwind scheme.
//!
//! [`Values`] stores h at the nodes, with a border of one node on each side. [`Scheme`] lowers h at
//! one node to the value that the adjacent nodes allow (Godunov scheme; Rouy and Tourin 1992).
//! [`NodeSet`] marks the nodes whose final values are requested.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Minimum relative decrease at which a node is lowered: 8 to 17 ulps of f32 (an ulp is 2^-24 to
/// 2^-23 of the value). Rounding alone therefore cannot lower a node, and the march ends. The
/// result deviates from the steady state by less than 2e-5; with a minimum decrease of 1e-5, the
/// deviation is larger (test `blocks_come_to_the_steady_state_of_plain_sweeps`).
const LEAST_GAIN: f64 = 1e-6;

/// A set of grid nodes, one bit each.
pub struct NodeSet(Vec<u64>);

impl NodeSet {
    /// Returns an empty set for a grid with `count` nodes.
    pub fn new(count: usize) -> Self {
        Self(vec![0; count.div_ceil(u64::BITS as usize)])
    }

    /// Adds a node by its number.
    pub fn insert(&mut self, node: usize) {
        self.0[node / u64::BITS as usize] |= 1 << (node % u64::BITS as usize);
    }

    /// Returns whether the set contains a node.
    pub fn contains(&self, node: usize) -> bool {
        self.0[node / u64::BITS as usize] >> (node % u64::BITS as usize) & 1 == 1
    }
}

/// h at the nodes, with a border of infinite values. Threads can read and write different values
/// concurrently.
pub(crate) struct Values(Vec<AtomicU32>);

impl Values {
    /// Adds the border to the values of a grid, in place.
    pub(crate) fn new(mut data: Vec<f32>, [nx, ny, nz]: [usize; 3]) -> Self {
        let row_start = Self::row_start([nx, ny]);
        let total = (nx + 2) * (ny + 2) * (nz + 2);
        data.reserve_exact(total - data.len());
        data.resize(total, f32::INFINITY);
        let mut end = data.len();
        for row in (0..ny * nz).rev() {
            let start = row_start(row);
            data.copy_within(row * nx..(row + 1) * nx, start);
            data[start + nx..end].fill(f32::INFINITY);
            end = start;
        }
        data[..end].fill(f32::INFINITY);
        Self(data.into_iter().map(|value| AtomicU32::new(value.to_bits())).collect())
    }

    /// Returns the values without the border.
    pub(crate) fn into_data(self, [nx, ny, nz]: [usize; 3]) -> Vec<f32> {
        let mut data: Vec<f32> = self.0.into_iter().map(|value| f32::from_bits(value.into_inner())).collect();
        let row_start = Self::row_start([nx, ny]);
        for row in 0..ny * nz {
            let start = row_start(row);
            data.copy_within(start..start + nx, row * nx);
        }
        data.truncate(nx * ny * nz);
        data
    }

    /// Returns a function that maps the index of a row to the index of its first node in the
    /// bordered grid.
    fn row_start([nx, ny]: [usize; 2]) -> impl Fn(usize) -> usize {
        move |row| ((row / ny + 1) * (ny + 2) + row % ny + 1) * (nx + 2) + 1
    }

    /// Returns the value of a node, given its index in the bordered grid.
    #[inline]
    pub(crate) fn get(&self, at: usize) -> f32 {
        f32::from_bits(self.0[at].load(Relaxed))
    }

    #[inline]
    fn set(&self, at: usize, value: f32) {
        self.0[at].store(value.to_bits(), Relaxed);
    }
}

/// Upwind scheme for |grad h| = delta on a grid with a border of one node.
pub(crate) struct Scheme {
    /// Difference between the indices of adjacent nodes along each axis.
    pub(crate) strides: [usize; 3],
    /// Maximum change of h in mm between adjacent nodes along each axis.
    pub(crate) rise: [f64; 3],
    /// 1 / rise^2.
    weight: [f64; 3],
}

impl Scheme {
    pub(crate) fn new(size: [usize; 3], rise: [f64; 3]) -> Self {
        let strides = [1, size[0] + 2, (size[0] + 2) * (size[1] + 2)];
        Self { strides, rise, weight: rise.map(|rise| 1.0 / (rise * rise)) }
    }

    /// Lowers a node to the value that its neighbours allow, if this decreases its value by at
    /// least the fraction [`LEAST_GAIN`]. Returns the new value, or `None` if nothing changes.
    #[inline]
    pub(crate) fn lower(&self, h: &Values, at: usize) -> Option<f32> {
        let smaller = |axis: usize| {
            let (before, after) = (h.get(at - self.strides[axis]), h.get(at + self.strides[axis]));
            f64::from(if before < after { before } else { after })
        };
        let smaller = [smaller(0), smaller(1), smaller(2)];
        // most calls change nothing; this test detects them without a square root
        let worth = f64::from(h.get(at)) * (1.0 - LEAST_GAIN);
        let steepness = |axis: usize| {
            let drop = if smaller[axis] < worth { worth - smaller[axis] } else { 0.0 };
            self.weight[axis] * drop * drop
        };
        let is_steep = steepness(0) + steepness(1) + steepness(2) > 1.0;
        is_steep.then(|| {
            let new = self.upwind(smaller) as f32;
            h.set(at, new);
            new
        })
    }

    /// Returns the value u at which the sum of `(max(u - a, 0) / rise)^2` over the axes is 1, where
    /// a is the smaller neighbour value along the axis. At least one of these values must be
    /// finite.
    #[inline]
    fn upwind(&self, [x, y, z]: [f64; 3]) -> f64 {
        let ordered = |a: (f64, f64), b: (f64, f64)| if b.0 < a.0 { (b, a) } else { (a, b) };
        let (x, y) = ordered((x, self.weight[0]), (y, self.weight[1]));
        let (y, z) = ordered(y, (z, self.weight[2]));
        let ((least, wa), y) = ordered(x, y);
        // Solve p u^2 - 2 q u + r = 1, with u relative to `least`. Axes contribute in ascending
        // order of value, as long as the solution for the previous axes exceeds the value of the
        // next axis.
        let (mut p, mut q, mut r) = (wa, 0.0, 0.0);
        for (value, weight) in [y, z] {
            let over = value - least;
            // an axis contributes if the left-hand side at its value is below 1; an infinite value
            // gives NaN, which ends the loop
            let takes_part = p * over * over - 2.0 * q * over + r < 1.0;
            if !takes_part {
                break;
            }
            p += weight;
            q += weight * over;
            r += weight * over * over;
        }
        least + (q + (q * q - p * (r - 1.0)).max(0.0).sqrt()) / p
    }
}
