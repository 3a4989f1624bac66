//! The implicit functions whose zero sets a surface lies on: F of one object, or one for each sheet between two of many materials.

use super::surface::Surface;
use glam::DVec3;
use isoparticles_field::spline::{CubicSpline, Jet};
use std::f64::consts::FRAC_PI_3;

/// How a vertex may move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// On its sheet.
    Sheet,
    /// Along the junction curve of three sheets that it lies on.
    Curve,
    /// It stays.
    None,
    /// It stays, as a junction point, at which curves end.
    Point,
}

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

    /// The point near `start` of the junction curve at which three sheets meet, of which two are given; limit and tolerance as for [`Self::project`]. `None` as there, and
    /// where sheets do not meet.
    fn project_onto_curve(&self, _sheets: [u32; 2], _start: DVec3, _limit: f64, _tolerance: f64) -> Option<DVec3> {
        None
    }

    /// What lies inside and outside of a sheet, by number.
    fn sides(&self, _sheet: u32) -> [u32; 2] {
        [1, 0]
    }

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
        CubicSpline::voxel(self)
    }
}

impl Surface<'_> {
    /// Whether a vertex moves on a sheet.
    pub(super) fn is_free(&self, vertex: u32) -> bool {
        self.freedom[vertex as usize] == Freedom::Sheet
    }

    /// The sheet that a vertex lies on, which is free and has triangles.
    pub(super) fn sheet_at(&self, vertex: u32) -> u32 {
        self.around[vertex as usize].first().map_or(0, |&t| self.sheet[t as usize])
    }

    /// Whether a vertex cannot spare a triangle. One that is not free always can: where an edge inside a sheet ends there, it has two in that sheet.
    pub(super) fn has_few(&self, vertex: u32) -> bool {
        self.is_free(vertex) && self.degree(vertex) < 4
    }

    /// Whether a corner of a triangle is not free: what is wrong with it then is mostly the length of a junction curve's segment, or a corner between two
    /// of them, which few other triangles mend.
    pub(super) fn is_held(&self, triangle: u32) -> bool {
        self.triangles[triangle as usize].iter().any(|&v| v != u32::MAX && !self.is_free(v))
    }

    /// Whether all corners of a triangle, which none may be moved off, lie on other sheets as well: on junction curves.
    pub(super) fn is_between_curves(&self, triangle: u32) -> bool {
        let own = self.sheet[triangle as usize];
        let is_on_others = |v: u32| self.around[v as usize].iter().any(|&t| self.sheet[t as usize] != own);
        self.triangles[triangle as usize].iter().all(|&v| v != u32::MAX && !self.is_free(v) && is_on_others(v))
    }

    /// How many more triangles than six a vertex has; one that is not free in the sheet of a triangle at it, more than sixths of a turn in the angle there.
    pub(super) fn surplus(&self, vertex: u32, triangle: u32) -> i64 {
        if self.is_free(vertex) {
            return self.degree(vertex) as i64 - 6;
        }
        let sheet = self.sheet[triangle as usize];
        let own = self.around[vertex as usize].iter().filter(|&&t| self.sheet[t as usize] == sheet);
        let (mut count, mut angle) = (0, 0.0);
        for &t in own {
            let corners = self.triangles[t as usize];
            let at = corners.iter().position(|&v| v == vertex).unwrap_or(0);
            let [p, q, r] = [0, 1, 2].map(|k| self.positions[corners[(at + k) % 3] as usize]);
            angle += (q - p).angle_between(r - p);
            count += 1;
        }
        count - (angle / FRAC_PI_3).round().max(1.0) as i64
    }
}
