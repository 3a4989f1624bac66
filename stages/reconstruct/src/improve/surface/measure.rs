//! Measures triangles: quality, normal deviation, deviation from F = 0, and edge lengths.

use super::{DEAD, Facts, Surface};
use crate::improve::constants::{AIM, AIM_ANGLES, FIRST_ORDER, FIT, FIT_ANGLES, POOR, SHORT_SIDE, SURELY_WIDE};
use crate::improve::functions::Freedom;
use glam::DVec3;
use isoparticles_field::spline::distance_estimate;
use isoparticles_mesh::quality::radius_ratio;

/// Returns the quality of a triangle: the minimum of its radius ratio and the ratings of its
/// minimum and maximum angle. The rating of an angle is [`FIT`] and [`AIM`] at its two limits and
/// linear between and above them. Below, it is proportional to the angle (or to 180 degrees minus
/// it). The quality is 0 if the area is zero.
pub(in crate::improve) fn quality_of(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let ratio = radius_ratio(a, b, c);
    if ratio > SURELY_WIDE {
        return ratio;
    }
    // the minimum and maximum angles are opposite the shortest and longest sides; the law of
    // cosines is accurate near all limits
    let mut squares = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    squares.sort_unstable_by(f64::total_cmp);
    let [short, middle, long] = squares;
    let angle = |opposite: f64, p: f64, q: f64| {
        ((p + q - opposite) / (2.0 * (p * q).sqrt())).clamp(-1.0, 1.0).acos().to_degrees()
    };
    let (smallest, largest) = (angle(short, middle, long), angle(long, short, middle));
    let by_angle = |angle: f64, fit: f64, aim: f64| {
        if angle < fit { FIT * angle / fit } else { FIT + (AIM - FIT) * (angle - fit) / (aim - fit) }
    };
    ratio.min(by_angle(smallest, FIT_ANGLES[0], AIM_ANGLES[0])).min(by_angle(
        180.0 - largest,
        180.0 - FIT_ANGLES[1],
        180.0 - AIM_ANGLES[1],
    ))
}

/// Returns the quality of a triangle, reduced by 1 if the triangle is turned against a normal.
pub(in crate::improve) fn quality_facing([p, a, b]: [DVec3; 3], normal: DVec3) -> f64 {
    let quality = quality_of(p, a, b);
    if (a - p).cross(b - p).dot(normal) > 0.0 { quality } else { quality - 1.0 }
}

impl Surface<'_> {
    /// Returns the present quality of a triangle. If a short fixed side ([`Self::is_short_side`])
    /// prevents a triangle of this height from passing the check, a side of length h replaces it.
    pub(in crate::improve) fn quality(&self, triangle: u32) -> f64 {
        let corners = self.triangles[triangle as usize];
        let [a, b, c] = corners.map(|v| self.positions[v as usize]);
        let longest = || a.distance(b).max(b.distance(c)).max(c.distance(a));
        for k in 0..3 {
            let (from, to) = (corners[k], corners[(k + 1) % 3]);
            // no replacement if the third corner is near the side: a better position may be even
            // nearer
            if let Some((p, q)) = self.stretched(from, to)
                && 2.0 * self.length(from, to) < POOR * longest()
            {
                return quality_of(p, q, self.positions[corners[(k + 2) % 3] as usize]);
            }
        }
        quality_of(a, b, c)
    }

    /// Returns the ends of a side of length h that replaces a short side between two junction
    /// points, or `None` for any other side. No position of the third corner makes a triangle on a
    /// short side good.
    fn stretched(&self, a: u32, b: u32) -> Option<(DVec3, DVec3)> {
        if !self.is_short_side(a, b) {
            return None;
        }
        let (p, q) = (self.positions[a as usize], self.positions[b as usize]);
        let (middle, half) = (p.midpoint(q), 0.5 * self.target_between(a, b) * (q - p).normalize_or_zero());
        Some((middle - half, middle + half))
    }

    /// Returns whether an edge between two vertices, which need not exist, is short: it joins two
    /// junction points at a distance far below h ([`SHORT_SIDE`]).
    pub(in crate::improve) fn is_short_side(&self, a: u32, b: u32) -> bool {
        let is_point = |v: u32| self.freedom[v as usize] == Freedom::Point;
        is_point(a) && is_point(b) && self.relative_length(a, b) < SHORT_SIDE
    }

    /// Returns the ends of a side (mm), for a search for the position of the third corner. A side
    /// of length h replaces a short side. The third corner then moves to the height of a good
    /// triangle. Next to the short side, it would degrade the other triangles around it.
    pub(in crate::improve) fn side(&self, a: u32, b: u32) -> (DVec3, DVec3) {
        self.stretched(a, b).unwrap_or_else(|| (self.positions[a as usize], self.positions[b as usize]))
    }

    /// Returns the present facts of a triangle, [`Facts::NONE`] if it is removed.
    pub(in crate::improve) fn measure(&self, triangle: u32) -> Facts {
        let corners = self.triangles[triangle as usize];
        if corners == DEAD {
            return Facts::NONE;
        }
        let [a, b, c] = self.corners(triangle);
        let centroid = (a + b + c) / 3.0;
        let pair = self.pair[triangle as usize];
        let (value, gradient) = self.field.value_gradient(pair, centroid);
        let normal = self.normal_of(corners);
        let mean_target = corners.iter().map(|&v| self.target[v as usize]).sum::<f64>() / 3.0;
        let mut deviation = distance_estimate(value, gradient).abs() / mean_target;
        if deviation > FIRST_ORDER
            && let Some(foot) = self.field.projected_facing(pair, centroid, normal, deviation.min(1.0) * mean_target)
        {
            deviation = foot.distance(centroid) / mean_target;
        }
        let lengths = [0, 1, 2].map(|e| self.relative_length(corners[e], corners[(e + 1) % 3]));
        Facts {
            quality: self.quality(triangle),
            agreement: normal.dot(gradient.normalize_or_zero()),
            deviation,
            lengths: [lengths[0].min(lengths[1]).min(lengths[2]), lengths[0].max(lengths[1]).max(lengths[2])],
            normal,
        }
    }
}
