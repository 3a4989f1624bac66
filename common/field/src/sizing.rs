//! The sizing field h: the target edge length, interpolated trilinearly. Also predicts the number
//! of particles from h.

use crate::spline::CubicSpline;
use crate::surface_integral::integrate;
use glam::DVec3;
use isoparticles_volume::Image;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::sync::Arc;

/// Target edge length h on the grid of a distance field. Clones share the image.
#[derive(Clone, Debug)]
pub struct SizingField {
    image: Arc<Image<f32>>,
}

impl SizingField {
    /// Wraps an image of edge lengths (mm) that has the geometry of the distance field.
    pub fn new(image: impl Into<Arc<Image<f32>>>) -> Self {
        Self { image: image.into() }
    }

    /// Returns the field with all edge lengths multiplied by `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        let data = self.image.data.par_iter().map(|&h| (factor * f64::from(h)) as f32).collect();
        Self::new(Image { geometry: self.image.geometry.clone(), data })
    }

    /// Returns the image of edge lengths.
    pub fn image(&self) -> &Image<f32> {
        &self.image
    }

    /// Returns the image of edge lengths without a copy.
    pub fn into_image(self) -> Arc<Image<f32>> {
        self.image
    }

    /// Returns the edge length (mm) at a grid position, interpolated trilinearly and clamped at the
    /// border of the volume.
    #[inline(always)]
    pub fn at(&self, grid: DVec3) -> f64 {
        trilinear(&self.image, grid)
    }

    /// Returns the edge length (mm) and its gradient (dimensionless) at a grid position. The
    /// gradient of the trilinear interpolant is discontinuous at the faces of cells.
    #[inline(always)]
    pub fn value_gradient(&self, grid: DVec3) -> (f64, DVec3) {
        let cell = Cell::around(&self.image, grid);
        let value = |x: usize, y: usize, z: usize| cell.value([x, y, z]);
        let [tx, ty, tz] = cell.fraction;
        // the values are interpolated first along the four edges of the cell that are parallel to x
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

    /// Returns the number of particles per mm^2 of a surface with the given unit normal at a grid
    /// position. This number is 2 / (sqrt(3) e^2), the density of the hexagonal lattice of edge
    /// length e.
    ///
    /// The distance between two particles is the smaller of their sizes h (Eq. 2), so a step
    /// towards larger h has the length h. Where h has the directional derivative d, each step
    /// multiplies h by 1 + d, and the mean step is h ln(1 + d) / d. At an angle t to the tangential
    /// gradient, whose magnitude is s, d = s |cos t|. The mean step over all t is
    /// `e = h (asin s / s) (1 - asin s / pi)`.
    pub fn lattice_density(&self, grid: DVec3, normal: DVec3) -> f64 {
        let (h, gradient) = self.value_gradient(grid);
        2.0 / (3f64.sqrt() * (h * edge_over_size(gradient.reject_from_normalized(normal).length())).powi(2))
    }

    /// Predicts the number of particles that settle on F = 0: the integral of
    /// [`Self::lattice_density`].
    pub fn predicted_count(&self, surface: &CubicSpline) -> f64 {
        integrate(surface, |point, normal| self.lattice_density(point, normal))
    }

    /// Estimates [`Self::predicted_count`] from triangles that approximate F = 0, such as the
    /// output of marching cubes. This is faster but misses features between the samples.
    pub fn count_on(&self, points: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
        let on = |corners: &[u32; 3]| {
            let [a, b, c] = corners.map(|v| points[v as usize]);
            let doubled = (b - a).cross(c - a);
            0.5 * doubled.length() * self.lattice_density((a + b + c) / 3.0, doubled.normalize_or_zero())
        };
        // summed in order, so that the result does not depend on the number of threads
        triangles.par_iter().map(on).collect::<Vec<f64>>().iter().sum()
    }
}

/// Returns the value of an image at a grid position, interpolated trilinearly and clamped at the
/// border of the volume.
#[inline(always)]
pub fn trilinear(image: &Image<f32>, grid: DVec3) -> f64 {
    let cell = Cell::around(image, grid);
    let [tx, ty, tz] = cell.fraction;
    let along_x = |y: usize, z: usize| mix(cell.value([0, y, z]), cell.value([1, y, z]), tx);
    mix(mix(along_x(0, 0), along_x(1, 0), ty), mix(along_x(0, 1), along_x(1, 1), ty), tz)
}

/// Returns the mean edge length of the lattice divided by h, for a given slope of h along the
/// surface. Slopes above 1 count as 1.
fn edge_over_size(slope: f64) -> f64 {
    if slope < 1e-6 {
        return 1.0;
    }
    let angle = slope.min(1.0).asin();
    angle / slope.min(1.0) * (1.0 - angle / PI)
}

#[inline(always)]
fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// The eight voxels around a position.
struct Cell {
    /// The two values in each of the four rows along x, y fastest.
    rows: [[f64; 2]; 4],
    fraction: [f64; 3],
}

impl Cell {
    #[inline(always)]
    fn around(image: &Image<f32>, grid: DVec3) -> Self {
        let g = &image.geometry;
        let index = g.grid_to_index(grid);
        let mut base = [0usize; 3];
        let mut fraction = [0.0f64; 3];
        let mut step = [0usize; 3];
        let stride = [1, g.size[0], g.size[0] * g.size[1]];
        for axis in 0..3 {
            let last = (g.size[axis] - 1) as f64;
            let x = index[axis].clamp(0.0, last);
            // x is not negative, so the cast rounds down
            base[axis] = (x as usize).min(g.size[axis].saturating_sub(2));
            fraction[axis] = x - base[axis] as f64;
            // an axis with a single voxel has no neighbour to interpolate with
            step[axis] = if g.size[axis] > 1 { stride[axis] } else { 0 };
        }
        let start = g.linear(base[0], base[1], base[2]);
        let row = |at: usize| {
            let row = &image.data[at..=at + step[0]];
            [f64::from(row[0]), f64::from(row[step[0]])]
        };
        let rows = [row(start), row(start + step[1]), row(start + step[2]), row(start + step[1] + step[2])];
        Self { rows, fraction }
    }

    #[inline(always)]
    fn value(&self, [x, y, z]: [usize; 3]) -> f64 {
        self.rows[2 * z + y][x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;
    use isoparticles_volume::Geometry;

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
        // positions outside the volume are clamped to it
        assert_eq!(field.at(DVec3::splat(-3.0)), field.at(DVec3::ZERO));
        assert_eq!(field.at(2.0 * geometry.upper_corner()), field.at(geometry.upper_corner()));
    }

    #[test]
    fn the_edge_is_the_mean_over_all_directions() {
        for slope in [1e-7, 0.01, 0.2, 0.4, 0.7, 1.0] {
            let steps = 20_000;
            let mean = (0..steps)
                .map(|n| slope * (std::f64::consts::FRAC_PI_2 * (f64::from(n) + 0.5) / f64::from(steps)).cos())
                .map(|s| s.ln_1p() / s)
                .sum::<f64>()
                / f64::from(steps);
            assert!(
                (edge_over_size(slope) / mean - 1.0).abs() < 1e-6,
                "{slope}: {}, not {mean}",
                edge_over_size(slope)
            );
        }
        assert_eq!(edge_over_size(2.0), edge_over_size(1.0));
    }

    #[test]
    fn the_predicted_count_is_the_integral_of_the_density() {
        let geometry = Geometry::axis_aligned([33; 3], DVec3::splat(0.8));
        let centre = 0.5 * geometry.upper_corner();
        let sampled = |f: &dyn Fn(DVec3) -> f64| Image::sampled(geometry.clone(), |p| f(p - centre) as f32);
        let radius = 10.0;
        let surface = CubicSpline::new(&sampled(&|p| p.length() - radius));
        let area = 4.0 * PI * radius * radius;
        for slope in [0.0, 0.1, 0.3] {
            let size = |x: f64| 4.0 + slope * x;
            // bands of a sphere between equidistant planes have equal areas
            let rings = 2000;
            let want: f64 = (0..rings)
                .map(|n| -1.0 + (2.0 * f64::from(n) + 1.0) / f64::from(rings))
                .map(|t| (size(radius * t), slope * (1.0 - t * t).sqrt()))
                .map(|(h, along)| 2.0 / (3f64.sqrt() * (h * edge_over_size(along)).powi(2)) * area / f64::from(rings))
                .sum();
            let count = SizingField::new(sampled(&|p| size(p.x))).predicted_count(&surface);
            assert!((count / want - 1.0).abs() < 0.002, "slope {slope}: {count}, not {want}");
        }
    }
}
