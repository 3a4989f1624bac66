//! Which coefficients a place reads, their weights, and the sums of value, gradient and Hessian.

use super::Jet;
use glam::{DMat3, DVec3};
use isoparticles_volume::Geometry;

/// B-spline weights and their first and second derivatives (per index) for the four samples around a cell.
type Weights = ([f64; 4], [f64; 4], [f64; 4]);

pub(super) struct Stencil {
    /// The cell that the place lies in: its lowest node.
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
    /// The stencil at a grid position (clamped to the volume).
    #[inline]
    pub(super) fn new(g: &Geometry, grid: DVec3) -> Self {
        let index = g.grid_to_index(grid);
        let axis = |a: usize| {
            let n = g.size[a];
            let x = index[a].clamp(0.0, (n - 1) as f64);
            let base = (x.floor() as usize).min(n.saturating_sub(2));
            let t = x - base as f64;
            let at: [usize; 4] = std::array::from_fn(|k| mirror(base as isize + k as isize - 1, n));
            (base, weights(t), at)
        };
        let (i, x, ix) = axis(0);
        let (j, y, iy) = axis(1);
        let (k, z, iz) = axis(2);
        Self { cell: [i, j, k], x, y, z, ix, iy, iz, nx: g.size[0], ny: g.size[1] }
    }

    /// The cell that the place lies in: its lowest node.
    #[inline]
    pub(super) fn cell(&self) -> [usize; 3] {
        self.cell
    }

    /// The same, for coefficients of a block of `side` in each direction whose first is one below `first` along each axis.
    #[inline]
    pub(super) fn within_block(mut self, first: [usize; 3], side: usize) -> Self {
        for (at, first) in [&mut self.ix, &mut self.iy, &mut self.iz].into_iter().zip(first) {
            *at = at.map(|n| n + 1 - first);
        }
        (self.nx, self.ny) = (side, side);
        self
    }

    /// Value.
    #[inline]
    pub(super) fn value(&self, coefficients: &[f32]) -> f64 {
        let mut sum = 0.0;
        self.each_row(|wy, wz, base| sum += wy.0 * wz.0 * dot(&self.x.0, &coefficients[base..], &self.ix));
        sum
    }

    /// Value and gradient.
    #[inline]
    pub(super) fn value_gradient(&self, coefficients: &[f32], spacing: DVec3) -> (f64, DVec3) {
        let (mut value, mut gradient) = (0.0, DVec3::ZERO);
        self.each_row(|wy, wz, base| {
            let row = &coefficients[base..];
            let c0 = dot(&self.x.0, row, &self.ix);
            let c1 = dot(&self.x.1, row, &self.ix);
            value += wy.0 * wz.0 * c0;
            gradient += DVec3::new(wy.0 * wz.0 * c1, wy.1 * wz.0 * c0, wy.0 * wz.1 * c0);
        });
        (value, gradient / spacing)
    }

    /// Value, gradient and Hessian.
    #[inline]
    pub(super) fn jet(&self, coefficients: &[f32], s: DVec3) -> Jet {
        let (mut value, mut gradient) = (0.0, DVec3::ZERO);
        let (mut diagonal, mut mixed) = (DVec3::ZERO, DVec3::ZERO);
        self.each_row(|wy, wz, base| {
            let row = &coefficients[base..];
            let c0 = dot(&self.x.0, row, &self.ix);
            let c1 = dot(&self.x.1, row, &self.ix);
            let c2 = dot(&self.x.2, row, &self.ix);
            value += wy.0 * wz.0 * c0;
            gradient += DVec3::new(wy.0 * wz.0 * c1, wy.1 * wz.0 * c0, wy.0 * wz.1 * c0);
            diagonal += DVec3::new(wy.0 * wz.0 * c2, wy.2 * wz.0 * c0, wy.0 * wz.2 * c0);
            // mixed: yz, xz, xy
            mixed += DVec3::new(wy.1 * wz.1 * c0, wy.0 * wz.1 * c1, wy.1 * wz.0 * c1);
        });
        let (yz, xz, xy) = (mixed.x / (s.y * s.z), mixed.y / (s.x * s.z), mixed.z / (s.x * s.y));
        let d = diagonal / (s * s);
        Jet {
            value,
            gradient: gradient / s,
            hessian: DMat3::from_cols(DVec3::new(d.x, xy, xz), DVec3::new(xy, d.y, yz), DVec3::new(xz, yz, d.z)),
        }
    }

    #[inline(always)]
    fn each_row(&self, mut row: impl FnMut((f64, f64, f64), (f64, f64, f64), usize)) {
        for c in 0..4 {
            let wz = (self.z.0[c], self.z.1[c], self.z.2[c]);
            for b in 0..4 {
                let wy = (self.y.0[b], self.y.1[b], self.y.2[b]);
                row(wy, wz, (self.iz[c] * self.ny + self.iy[b]) * self.nx);
            }
        }
    }
}

#[inline(always)]
fn dot(w: &[f64; 4], row: &[f32], at: &[usize; 4]) -> f64 {
    w[0] * f64::from(row[at[0]])
        + w[1] * f64::from(row[at[1]])
        + w[2] * f64::from(row[at[2]])
        + w[3] * f64::from(row[at[3]])
}

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

pub(crate) fn mirror(i: isize, n: usize) -> usize {
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
