//! The implicit functions whose zero sets a surface lies on: F of one object, or one for each sheet between two of many materials.

use glam::DVec3;
use isoparticles_field::spline::{CubicSpline, Jet};

/// Functions of a grid position, mm, by the number of the sheet that each is zero on; negative inside, where the triangles of the sheet face away from.
pub trait Sheets: Sync {
    /// The value.
    fn value(&self, sheet: u32, p: DVec3) -> f64;

    /// Value and gradient.
    fn value_gradient(&self, sheet: u32, p: DVec3) -> (f64, DVec3);

    /// Value, gradient and Hessian.
    fn jet(&self, sheet: u32, p: DVec3) -> Jet;

    /// The point of the sheet near `start`, with the gradient there; `None` where it is farther than `limit`, is not found to `tolerance` (mm), or the sheet
    /// has ended before.
    fn project(&self, sheet: u32, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)>;

    /// Mean spacing of the voxels, mm.
    fn voxel(&self) -> f64;
}

/// One object: its only sheet is F = 0.
impl Sheets for CubicSpline {
    fn value(&self, _: u32, p: DVec3) -> f64 {
        CubicSpline::value(self, p)
    }

    fn value_gradient(&self, _: u32, p: DVec3) -> (f64, DVec3) {
        CubicSpline::value_gradient(self, p)
    }

    fn jet(&self, _: u32, p: DVec3) -> Jet {
        CubicSpline::jet(self, p)
    }

    fn project(&self, _: u32, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        self.project_with_gradient(start, limit, tolerance)
    }

    fn voxel(&self) -> f64 {
        self.geometry().mean_spacing()
    }
}
