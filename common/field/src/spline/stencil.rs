//! The coefficients that determine F at a position, their weights, and the weighted sums for the
//! value, gradient and Hessian.

use super::Jet;
use glam::{DMat3, DVec3};
use isoparticles_volume::Geometry;

/// B-spline weights and their first and second derivatives (per index) for the four nodes around a
/// cell along one axis.
type Weights = ([f64; 4], [f64; 4], [f64; 4]);

#[derive(Clone)]
pub(crate) struct Stencil {
    /// Lowest node of the cell that contains the position.
    cell: [usize; 3],
    x: Weights,
    y: Weights,
    z: Weights,
    ix: [usize; 4],
    iy: [usize; 4],
    iz: [usize; 4],
    nx: usize,
    ny: usize,
}

impl Stencil {
    /// Creates the stencil at a grid position (clamped to the volume).
    #[inline(always)]
    pub(crate) fn new(g: &Geometry, grid: DVec3) -> Self {
        let index = g.grid_to_index(grid);
        let axis = |a: usize| {
            let n = g.size[a];
            let x = index[a].clamp(0.0, (n - 1) as f64);
            // x is not negative, so the cast rounds down
            let base = (x as usize).min(n.saturating_sub(2));
            let t = x - base as f64;
            let at: [usize; 4] = std::array::from_fn(|k| mirror(base as isize + k as isize - 1, n));
            (base, weights(t), at)
        };
        let (i, x, ix) = axis(0);
        let (j, y, iy) = axis(1);
        let (k, z, iz) = axis(2);
        Self { cell: [i, j, k], x, y, z, ix, iy, iz, nx: g.size[0], ny: g.size[1] }
    }

    /// Returns the lowest node of the cell that contains the position.
    #[inline]
    pub(crate) fn cell(&self) -> [usize; 3] {
        self.cell
    }

    /// Returns the stencil with indices into a block of `side` coefficients along each axis. The
    /// first coefficient of the block belongs to the node before `first` along each axis.
    #[inline(always)]
    pub(super) fn within_block(mut self, first: [usize; 3], side: usize) -> Self {
        for (at, first) in [&mut self.ix, &mut self.iy, &mut self.iz].into_iter().zip(first) {
            *at = at.map(|n| n + 1 - first);
        }
        (self.nx, self.ny) = (side, side);
        self
    }

    /// Returns, for each axis, the indices of the nodes whose coefficients the stencil uses.
    #[inline]
    pub(crate) fn indices(&self) -> [[usize; 4]; 3] {
        [self.ix, self.iy, self.iz]
    }

    /// Returns the stencil with indices into a contiguous copy of the 64 coefficients that it uses,
    /// x fastest.
    #[inline]
    pub(crate) fn gathered(mut self) -> Self {
        (self.ix, self.iy, self.iz) = ([0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 2, 3]);
        (self.nx, self.ny) = (4, 4);
        self
    }

    /// Returns the value.
    #[inline(always)]
    pub(crate) fn value(&self, coefficients: &[f32]) -> f64 {
        let mut value = [0.0; 4];
        for c in 0..4 {
            let mut plane = [0.0; 4];
            for b in 0..4 {
                add(&mut plane, self.y.0[b], &self.row(coefficients, b, c));
            }
            add(&mut value, self.z.0[c], &plane);
        }
        dot(&self.x.0, &value)
    }

    /// Returns the value and the gradient. Sums over y and then over z, for four coefficients along
    /// x at a time, and finally over x. Inlined, so that it is compiled for the instruction set of
    /// the caller. Multiplications and additions are not fused, so every instruction set gives the
    /// same bits.
    #[inline(always)]
    pub(crate) fn value_gradient(&self, coefficients: &[f32], spacing: DVec3) -> (f64, DVec3) {
        self.sums(spacing, |b, c| self.row(coefficients, b, c))
    }

    /// Returns the value and the gradient from the 64 coefficients of the stencil, stored
    /// contiguously, x fastest.
    #[inline(always)]
    pub(crate) fn value_gradient_of(&self, coefficients: &[f64; 64], spacing: DVec3) -> (f64, DVec3) {
        self.sums(spacing, |b, c| std::array::from_fn(|a| coefficients[16 * c + 4 * b + a]))
    }

    /// Returns the value and the gradient. `row` returns the coefficients along x at a y index and
    /// a z index of the stencil.
    #[inline(always)]
    fn sums(&self, spacing: DVec3, row: impl Fn(usize, usize) -> [f64; 4]) -> (f64, DVec3) {
        let (mut value, mut by_y, mut by_z) = ([0.0; 4], [0.0; 4], [0.0; 4]);
        for c in 0..4 {
            let (mut plane, mut slope) = ([0.0; 4], [0.0; 4]);
            for b in 0..4 {
                let row = row(b, c);
                add(&mut plane, self.y.0[b], &row);
                add(&mut slope, self.y.1[b], &row);
            }
            add(&mut value, self.z.0[c], &plane);
            add(&mut by_y, self.z.0[c], &slope);
            add(&mut by_z, self.z.1[c], &plane);
        }
        let gradient = DVec3::new(dot(&self.x.1, &value), dot(&self.x.0, &by_y), dot(&self.x.0, &by_z));
        (dot(&self.x.0, &value), gradient / spacing)
    }

    /// Returns the value, the gradient and the Hessian.
    #[inline(always)]
    pub(crate) fn jet(&self, coefficients: &[f32], s: DVec3) -> Jet {
        let (x, y, z) = (&self.x, &self.y, &self.z);
        // the value and its derivatives with respect to y, z, yy, zz and yz, not yet summed over x
        let mut sums = [[0.0; 4]; 6];
        for c in 0..4 {
            let (mut plane, mut slope, mut bend) = ([0.0; 4], [0.0; 4], [0.0; 4]);
            for b in 0..4 {
                let row = self.row(coefficients, b, c);
                add(&mut plane, y.0[b], &row);
                add(&mut slope, y.1[b], &row);
                add(&mut bend, y.2[b], &row);
            }
            let parts = [
                (z.0[c], &plane),
                (z.0[c], &slope),
                (z.1[c], &plane),
                (z.0[c], &bend),
                (z.2[c], &plane),
                (z.1[c], &slope),
            ];
            for (sum, (weight, part)) in sums.iter_mut().zip(parts) {
                add(sum, weight, part);
            }
        }
        let [value, by_y, by_z, by_yy, by_zz, by_yz] = &sums;
        let gradient = DVec3::new(dot(&x.1, value), dot(&x.0, by_y), dot(&x.0, by_z));
        let d = DVec3::new(dot(&x.2, value), dot(&x.0, by_yy), dot(&x.0, by_zz)) / (s * s);
        let yz = dot(&x.0, by_yz) / (s.y * s.z);
        let xz = dot(&x.1, by_z) / (s.x * s.z);
        let xy = dot(&x.1, by_y) / (s.x * s.y);
        Jet {
            value: dot(&x.0, value),
            gradient: gradient / s,
            hessian: DMat3::from_cols(DVec3::new(d.x, xy, xz), DVec3::new(xy, d.y, yz), DVec3::new(xz, yz, d.z)),
        }
    }

    /// Returns the four coefficients along x at y index `b` and z index `c` of the stencil.
    #[inline(always)]
    fn row(&self, coefficients: &[f32], b: usize, c: usize) -> [f64; 4] {
        let row = &coefficients[(self.iz[c] * self.ny + self.iy[b]) * self.nx..];
        let [i, .., last] = self.ix;
        if last == i + 3
            && let Some(&four) = row.get(i..).and_then(|row| row.first_chunk::<4>())
        {
            return four.map(f64::from);
        }
        self.ix.map(|i| f64::from(row[i]))
    }
}

/// Adds `weight` times `row` to `sum`.
#[inline(always)]
fn add(sum: &mut [f64; 4], weight: f64, row: &[f64; 4]) {
    for (sum, x) in sum.iter_mut().zip(row) {
        *sum += weight * x;
    }
}

#[inline(always)]
fn dot(w: &[f64; 4], row: &[f64; 4]) -> f64 {
    (w[0] * row[0] + w[1] * row[1]) + (w[2] * row[2] + w[3] * row[3])
}

#[inline(always)]
fn weights(t: f64) -> Weights {
    let u = 1.0 - t;
    (
        [
            u * u * u / 6.0,
            (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
            (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
            t * t * t / 6.0,
        ],
        [-0.5 * u * u, t * (1.5 * t - 2.0), -u * (1.5 * u - 2.0), 0.5 * t * t],
        [u, 3.0 * t - 2.0, 3.0 * u - 2.0, t],
    )
}

#[inline(always)]
pub(crate) fn mirror(i: isize, n: usize) -> usize {
    if (i as usize) < n {
        return i as usize;
    }
    reflected(i, n)
}

fn reflected(i: isize, n: usize) -> usize {
    if n == 1 {
        return 0;
    }
    let last = n as isize - 1;
    let mut i = i;
    while i < 0 || i > last {
        if i < 0 {
            i = -i;
        }
        if i > last {
            i = 2 * last - i;
        }
    }
    i as usize
}
