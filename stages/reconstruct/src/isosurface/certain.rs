//! Where the sign of F is known without reading the spline: within a cell F is a mean of the 64 coefficients around
//! (the convex hull property of B-splines), so that coefficients of one sign leave F no other. Most of a box round a
//! surface is like that, and a finer sampling of the box need not be taken there.

use glam::DVec3;
use isoparticles_field::spline::CubicSpline;

/// Coefficients before and behind a cell that reach into it or into a cell next to it.
const REACH: (usize, usize) = (2, 3);

/// Signs of F by voxel cell of a box.
pub(crate) struct CertainSigns {
    /// First cell of the box.
    first: [usize; 3],
    /// Cells.
    size: [usize; 3],
    /// 1 or -1 where F has that sign all over the cell and the 26 around it, 0 elsewhere.
    signs: Vec<i8>,
}

impl CertainSigns {
    /// Of the cells that hold the points between two corners (grid frame).
    pub(crate) fn new(field: &CubicSpline, low: DVec3, high: DVec3) -> Self {
        let volume = field.geometry().size;
        let spacing = field.geometry().spacing;
        let cell = |p: DVec3, axis: usize| {
            let at = (p[axis] / spacing[axis]).floor().max(0.0) as usize;
            at.min(volume[axis] - 1)
        };
        let first = [0, 1, 2].map(|axis| cell(low, axis));
        let size = [0, 1, 2].map(|axis| cell(high, axis) - first[axis] + 1);
        // the coefficients that reach into the box, then one axis after the other what reaches into its cells
        let from = first.map(|cell| cell.saturating_sub(REACH.0));
        let mut extent = [0, 1, 2].map(|axis| (first[axis] + size[axis] + REACH.1).min(volume[axis]) - from[axis]);
        let coefficients = field.coefficients();
        let mut signs: Vec<i8> = Vec::with_capacity(extent.iter().product());
        for z in from[2]..from[2] + extent[2] {
            for y in from[1]..from[1] + extent[1] {
                let row = &coefficients[(z * volume[1] + y) * volume[0] + from[0]..][..extent[0]];
                signs.extend(row.iter().map(|&c| i8::from(c > 0.0) - i8::from(c < 0.0)));
            }
        }
        for axis in 0..3 {
            let stride: usize = extent[..axis].iter().product();
            let mut wider = extent;
            wider[axis] = size[axis];
            let agreed = |number: usize| {
                let (inner, rest) = (number % stride, number / stride);
                let (at, outer) = (rest % size[axis], rest / size[axis]);
                let cell = first[axis] + at;
                let begin = cell.saturating_sub(REACH.0) - from[axis];
                let end = (cell + REACH.1 + 1).min(volume[axis]) - from[axis];
                let of = |k: usize| signs[(outer * extent[axis] + k) * stride + inner];
                let sign = of(begin);
                if (begin..end).all(|k| of(k) == sign) { sign } else { 0 }
            };
            signs = (0..wider.iter().product()).map(agreed).collect();
            extent = wider;
        }
        Self { first, size, signs }
    }

    /// A number of the sign of F at a point of the box (grid frame; `index` is that divided by the spacing) and everywhere
    /// within a voxel of it; `None` where that is not certain.
    pub(crate) fn at(&self, index: DVec3) -> Option<f32> {
        let mut number = 0;
        for axis in (0..3).rev() {
            let cell = index[axis].floor().max(0.0) as usize;
            let cell = cell.checked_sub(self.first[axis])?.min(self.size[axis] - 1);
            number = number * self.size[axis] + cell;
        }
        Some(self.signs[number]).filter(|&sign| sign != 0).map(f32::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;

    #[test]
    fn signs_are_those_of_the_spline() {
        let mut certain = 0;
        for scene in [scenes::gyroid(), scenes::shell(), scenes::torus()] {
            let field = &scene.field;
            let spacing = field.geometry().spacing;
            let whole = field.geometry().upper_corner();
            for (low, high) in [(DVec3::ZERO, whole), (whole * 0.31, whole * 0.77)] {
                let signs = CertainSigns::new(field, low, high);
                let steps = 41;
                for n in 0..steps * steps * steps {
                    let share = DVec3::new((n % steps) as f64, (n / steps % steps) as f64, (n / steps / steps) as f64);
                    let p = low + (high - low) * share / (steps - 1) as f64;
                    let Some(sign) = signs.at(p / spacing) else { continue };
                    certain += 1;
                    let around = [DVec3::ZERO, spacing, -spacing, spacing * DVec3::new(1.0, -1.0, 0.0)];
                    for q in around.map(|step| (p + step).clamp(DVec3::ZERO, whole)) {
                        assert!(field.value(q) * f64::from(sign) > 0.0, "{p} and {q}");
                    }
                }
            }
        }
        // the gyroid has none
        assert!(certain > 1000, "{certain}");
    }
}
