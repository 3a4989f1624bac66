//! Building blocks of the torso: tubes along curves, ellipsoids, and smooth set operations.

use glam::{DMat3, DVec3};

/// Upper limit of approximate distances, in mm of the reference frame. All edge profiles and blends
/// are narrower than this distance, so pieces farther away have no effect and are skipped.
pub(super) const FAR: f64 = 25.0;

/// Returns the polynomial smooth minimum of two values: the union of two shapes, rounded over a
/// width of `blend`. Where the values differ by more than `blend`, the result is the exact minimum.
pub(super) fn smooth_union(a: f64, b: f64, blend: f64) -> f64 {
    let overlap = (blend - (a - b).abs()).max(0.0) / blend;
    a.min(b) - 0.25 * overlap * overlap * blend
}

/// Returns the smooth maximum of two values: the intersection of two shapes, rounded over a width
/// of `blend`.
pub(super) fn smooth_intersection(a: f64, b: f64, blend: f64) -> f64 {
    -smooth_union(-a, -b, blend)
}

/// An ellipsoid. Its value is an approximate signed distance: zero on the surface, with a gradient
/// of about 1 nearby.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ellipsoid {
    pub(super) centre: DVec3,
    pub(super) semi_axes: DVec3,
    /// Matrix whose columns are the ellipsoid's axes.
    pub(super) axes: DMat3,
}

impl Ellipsoid {
    pub(super) fn aligned(centre: [f64; 3], semi_axes: [f64; 3]) -> Self {
        Self { centre: centre.into(), semi_axes: semi_axes.into(), axes: DMat3::IDENTITY }
    }

    pub(super) fn turned(self, axis: DVec3, degrees: f64) -> Self {
        Self { axes: DMat3::from_axis_angle(axis.normalize(), degrees.to_radians()) * self.axes, ..self }
    }

    pub(super) fn value(&self, q: DVec3) -> f64 {
        let p = self.axes.transpose() * (q - self.centre);
        let level = (p / self.semi_axes).length();
        let slope = (p / (self.semi_axes * self.semi_axes)).length();
        if slope < 1e-9 { -self.semi_axes.min_element() } else { level * (level - 1.0) / slope }
    }
}

/// Number of consecutive segments of a tube that share a bounding box. It affects only the run
/// time.
const RUN: usize = 8;

/// A tube along a polyline, with a radius at each point.
#[derive(Clone, Debug)]
pub(super) struct Tube {
    points: Vec<(DVec3, f64)>,
    /// Lower and upper corners of the bounding box of each group of `RUN` segments. A distant group
    /// then costs only one comparison.
    boxes: Vec<(DVec3, DVec3)>,
}

impl Tube {
    /// Returns a tube through points with radii.
    pub(super) fn new(points: Vec<(DVec3, f64)>) -> Self {
        let boxes = (0..points.len() - 1)
            .step_by(RUN)
            .map(|start| {
                let run = &points[start..points.len().min(start + RUN + 1)];
                let low = run.iter().fold(DVec3::INFINITY, |m, (p, r)| m.min(*p - DVec3::splat(*r)));
                let high = run.iter().fold(DVec3::NEG_INFINITY, |m, (p, r)| m.max(*p + DVec3::splat(*r)));
                (low, high)
            })
            .collect();
        Self { points, boxes }
    }

    /// Returns a tube along a Catmull-Rom curve through control points, with `pieces` segments per
    /// span.
    pub(super) fn smooth(control: &[([f64; 3], f64)], pieces: usize) -> Self {
        let at = |i: isize| {
            let (point, radius) = control[i.clamp(0, control.len() as isize - 1) as usize];
            (DVec3::from_array(point), radius)
        };
        let mut points = Vec::new();
        for span in 0..control.len() - 1 {
            let i = span as isize;
            let ((p0, _), (p1, r1), (p2, r2), (p3, _)) = (at(i - 1), at(i), at(i + 1), at(i + 2));
            for piece in 0..pieces {
                let t = piece as f64 / pieces as f64;
                let curve = p1
                    + 0.5
                        * t
                        * ((p2 - p0) + t * ((2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3) + t * (3.0 * (p1 - p2) + p3 - p0)));
                points.push((curve, r1 + t * (r2 - r1)));
            }
        }
        points.push(at(control.len() as isize - 1));
        Self::new(points)
    }

    /// Returns the approximate signed distance to the tube, or `give_up` if that value is smaller.
    pub(super) fn value(&self, q: DVec3, give_up: f64) -> f64 {
        let mut best = give_up;
        for (run, (low, high)) in self.boxes.iter().enumerate() {
            let to_box = (*low - q).max(q - *high).max(DVec3::ZERO).length_squared();
            if best > 0.0 && to_box >= best * best {
                continue;
            }
            let start = run * RUN;
            for pair in self.points[start..self.points.len().min(start + RUN + 1)].windows(2) {
                let ((from, from_radius), (to, to_radius)) = (pair[0], pair[1]);
                let along = to - from;
                let t = ((q - from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
                best = best.min(q.distance(from + t * along) - (from_radius + t * (to_radius - from_radius)));
            }
        }
        best
    }
}
