//! The sizing field h: target edge length, read by trilinear interpolation.

use crate::image::Image;
use glam::DVec3;

/// Target edge length h over the grid frame of a distance field.
#[derive(Clone, Debug)]
pub struct SizingField {
    image: Image<f32>,
}

impl SizingField {
    /// Wraps an image of edge lengths (mm) whose geometry is that of the distance field.
    pub fn new(image: Image<f32>) -> Self {
        Self { image }
    }

    /// The field whose edge lengths are `factor` times as long.
    pub fn scaled(&self, factor: f64) -> Self {
        let data = self.image.data.iter().map(|&h| (factor * f64::from(h)) as f32).collect();
        Self { image: Image { geometry: self.image.geometry.clone(), data } }
    }

    /// The image of edge lengths.
    pub fn image(&self) -> &Image<f32> {
        &self.image
    }

    /// Edge length (mm) at a grid position, trilinear, clamped at the border of the volume.
    pub fn at(&self, grid: DVec3) -> f64 {
        self.value_gradient(grid).0
    }

    /// Edge length (mm) and its gradient (dimensionless) at a grid position. The gradient is that of the trilinear cell,
    /// so it jumps from cell to cell.
    pub fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        let cell = Cell::around(&self.image, grid);
        let value = |x: usize, y: usize, z: usize| cell.value([x, y, z]);
        let [tx, ty, tz] = cell.fraction;
        // along x first: the four edges of the cell
        let (e00, e10) = (mix(value(0, 0, 0), value(1, 0, 0), tx), mix(value(0, 1, 0), value(1, 1, 0), tx));
        let (e01, e11) = (mix(value(0, 0, 1), value(1, 0, 1), tx), mix(value(0, 1, 1), value(1, 1, 1), tx));
        let slope = |y: usize, z: usize| value(1, y, z) - value(0, y, z);
        let gradient = DVec3::new(
            mix(mix(slope(0, 0), slope(1, 0), ty), mix(slope(0, 1), slope(1, 1), ty), tz),
            mix(e10 - e00, e11 - e01, tz),
            mix(e01, e11, ty) - mix(e00, e10, ty),
        );
        (mix(mix(e00, e10, ty), mix(e01, e11, ty), tz), gradient / self.image.geometry.spacing)
    }
}

/// Value of an image at a grid position, trilinear, clamped at the border of the volume.
pub fn trilinear(image: &Image<f32>, grid: DVec3) -> f64 {
    let cell = Cell::around(image, grid);
    let [tx, ty, tz] = cell.fraction;
    let along_x = |y: usize, z: usize| mix(cell.value([0, y, z]), cell.value([1, y, z]), tx);
    mix(mix(along_x(0, 0), along_x(1, 0), ty), mix(along_x(0, 1), along_x(1, 1), ty), tz)
}

fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// The eight voxels round a position.
struct Cell<'a> {
    data: &'a [f32],
    start: usize,
    step: [usize; 3],
    fraction: [f64; 3],
}

impl<'a> Cell<'a> {
    fn around(image: &'a Image<f32>, grid: DVec3) -> Self {
        let g = &image.geometry;
        let index = g.grid_to_index(grid);
        let mut base = [0usize; 3];
        let mut fraction = [0.0f64; 3];
        let mut step = [0usize; 3];
        let stride = [1, g.size[0], g.size[0] * g.size[1]];
        for axis in 0..3 {
            let last = (g.size[axis] - 1) as f64;
            let x = index[axis].clamp(0.0, last);
            base[axis] = (x.floor() as usize).min(g.size[axis].saturating_sub(2));
            fraction[axis] = x - base[axis] as f64;
            // an axis of one voxel has no neighbour to blend with
            step[axis] = if g.size[axis] > 1 { stride[axis] } else { 0 };
        }
        Self { data: &image.data, start: g.linear(base[0], base[1], base[2]), step, fraction }
    }

    fn value(&self, corner: [usize; 3]) -> f64 {
        let at: usize = (0..3).map(|axis| corner[axis] * self.step[axis]).sum();
        f64::from(self.data[self.start + at])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Geometry;
    use crate::random::uniform;

    #[test]
    fn trilinear_functions_are_met_exactly_with_their_gradient() {
        let geometry = Geometry::axis_aligned([5, 4, 6], DVec3::new(0.5, 2.0, 1.25));
        let h = |p: DVec3| 3.0 + 0.5 * p.x - 0.2 * p.y + 0.1 * p.z + 0.25 * p.x * p.y - 0.125 * p.x * p.y * p.z;
        let mut image = Image::filled(geometry.clone(), 0.0f32);
        for n in 0..image.data.len() {
            let (i, j, k) = (n % 5, n / 5 % 4, n / 20);
            image.data[n] = h(geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64))) as f32;
        }
        let field = SizingField::new(image);
        for n in 0..200 {
            let p = geometry.upper_corner() * DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n));
            let (value, gradient) = field.value_gradient(p);
            assert!((value - h(p)).abs() < 1e-5, "{p}");
            let want = DVec3::new(
                0.5 + 0.25 * p.y - 0.125 * p.y * p.z,
                -0.2 + 0.25 * p.x - 0.125 * p.x * p.z,
                0.1 - 0.125 * p.x * p.y,
            );
            assert!((gradient - want).length() < 2e-5, "{p}: {gradient}, not {want}");
        }
        // clamped outside
        assert_eq!(field.at(DVec3::splat(-3.0)), field.at(DVec3::ZERO));
        assert_eq!(field.at(2.0 * geometry.upper_corner()), field.at(geometry.upper_corner()));
    }
}
