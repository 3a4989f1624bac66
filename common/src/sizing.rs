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

    /// The image of edge lengths.
    pub fn image(&self) -> &Image<f32> {
        &self.image
    }

    /// Edge length (mm) at a grid position, trilinear, clamped at the border of the volume.
    pub fn at(&self, grid: DVec3) -> f64 {
        let g = &self.image.geometry;
        let index = g.grid_to_index(grid);
        let mut base = [0usize; 3];
        let mut fraction = [0.0f64; 3];
        for axis in 0..3 {
            let last = (g.size[axis] - 1) as f64;
            let x = index[axis].clamp(0.0, last);
            let b = (x.floor() as usize).min(g.size[axis].saturating_sub(2));
            base[axis] = b;
            fraction[axis] = x - b as f64;
        }
        let step = [1, g.size[0], g.size[0] * g.size[1]];
        let start = g.linear(base[0], base[1], base[2]);
        let mut sum = 0.0;
        for corner in 0..8usize {
            let mut weight = 1.0;
            let mut at = start;
            for axis in 0..3 {
                if corner >> axis & 1 == 1 {
                    weight *= fraction[axis];
                    at += step[axis];
                } else {
                    weight *= 1.0 - fraction[axis];
                }
            }
            if weight > 0.0 {
                sum += weight * f64::from(self.image.data[at]);
            }
        }
        sum
    }
}
