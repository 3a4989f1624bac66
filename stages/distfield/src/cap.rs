//! Closes the object at the border of the volume: intersects it with the box of the voxels and
//! rounds the edges of the intersection.
//!
//! The box extends half a voxel beyond the outermost voxel centres, and the fillets have a radius
//! of half a voxel. The surface between voxel centres is therefore unchanged.

use glam::DVec3;
use isoparticles_volume::Geometry;

/// The box of the input voxels, in the grid frame of the padded grid (mm).
#[derive(Clone, Debug)]
pub struct BorderBox {
    low: DVec3,
    high: DVec3,
    radius: f64,
    reach: f64,
}

impl BorderBox {
    /// Returns the box of an input. `padded` is the grid of the input, extended by `margin` voxels
    /// on each face. `closed` has one entry for the low and one for the high face along each axis;
    /// the box is unbounded at faces that are not closed.
    pub fn new(padded: &Geometry, margin: usize, closed: [[bool; 2]; 3]) -> Self {
        let first = padded.index_to_grid(DVec3::splat(margin as f64 - 0.5));
        let mut low = first;
        let mut high = padded.upper_corner() - first;
        for axis in 0..3 {
            let [low_closed, high_closed] = closed[axis];
            low[axis] = if low_closed { low[axis] } else { f64::NEG_INFINITY };
            high[axis] = if high_closed { high[axis] } else { f64::INFINITY };
        }
        Self { low, high, radius: 0.5 * padded.min_spacing(), reach: padded.spacing.max_element() }
    }

    /// Returns the signed distance (mm) and the gradient of the intersection of the object with the
    /// box. `value` and `gradient` describe the object at the position `grid`, without the box.
    pub fn intersect(&self, grid: DVec3, value: f64, gradient: DVec3) -> (f64, DVec3) {
        let (below, above) = (self.low - grid, grid - self.high);
        let mut result = (value, gradient);
        for axis in 0..3 {
            result = self.rounded_maximum(result, (below[axis], -DVec3::AXES[axis]));
            result = self.rounded_maximum(result, (above[axis], DVec3::AXES[axis]));
        }
        result
    }

    /// Returns whether a point is more than three voxels (of the maximum spacing) inside the box.
    /// The box then leaves the surface unchanged, both there and in the neighbouring cells.
    pub fn is_deep(&self, grid: DVec3) -> bool {
        (self.low - grid).max(grid - self.high).max_element() < -3.0 * self.reach
    }

    /// Returns whether the box leaves the surface at a point unchanged.
    pub fn leaves(&self, grid: DVec3) -> bool {
        (self.low - grid).max(grid - self.high).max_element() <= -self.radius
    }

    /// Returns the maximum of two signed distances, with a circular fillet where both distances
    /// exceed `-radius`.
    fn rounded_maximum(&self, a: (f64, DVec3), b: (f64, DVec3)) -> (f64, DVec3) {
        let (u, v) = (a.0 + self.radius, b.0 + self.radius);
        if u > 0.0 && v > 0.0 {
            let length = u.hypot(v);
            (length - self.radius, (a.1 * u + b.1 * v) / length)
        } else if a.0 >= b.0 {
            a
        } else {
            b
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_surface_between_voxel_centres_stays() {
        let padded = Geometry::axis_aligned([20, 20, 20], DVec3::new(0.7, 0.7, 3.0)).padded(4);
        let border = BorderBox::new(&padded, 4, [[true; 2]; 3]);
        let first = padded.index_to_grid(DVec3::splat(4.0));
        let gradient = DVec3::new(0.6, 0.0, 0.8);
        let (value, direction) = border.intersect(first, 0.0, gradient);
        assert_eq!(value, 0.0);
        assert_eq!(direction, gradient);
        // deep inside the object, the face of the box is the surface
        let (value, direction) = border.intersect(first - DVec3::X * 0.35, -5.0, gradient);
        assert!(value.abs() < 1e-12 && direction == -DVec3::X);
        // beyond a right-angled edge, the fillet is the nearest surface
        let corner = DVec3::new(border.low.x - 1.0, border.low.y - 1.0, 20.0);
        let (value, _) = border.intersect(corner, -9.0, gradient);
        let r = 0.35;
        assert!((value - ((1.0f64 + r).hypot(1.0 + r) - r)).abs() < 1e-12);
    }
}
