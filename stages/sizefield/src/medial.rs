//! Points of the medial axis, by the shrinking-ball algorithm (Ma, Bae and Choi 2012) on dense samples of the surface.
//!
//! A ball that touches the surface at a sample is shrunk until no other sample lies inside it; its centre is then on the
//! medial axis, inside or outside the object. Each sample gives two balls. Two kinds of balls are pruned, because the part of the axis that
//! they stand for moves with every small change of the surface (the axis of a surface and of one next to it differ by just such
//! branches: Chazal and Lieutier 2005). A ball that touches the surface at two points seen from its centre under a
//! small angle tells of ripple, or of the last bit before an end of the axis; what that takes off an end is small (the tip of an ellipsoid
//! reads 0.4 % too large). And where there is noise ([`crate::noise`]), a ball whose cap between the two points is no higher than
//! twice the noise tells of a bump of it.
//!
//! The distance field tells a ball that is surely too large without any search, so that only the last steps look at samples.

use glam::DVec3;
use isoparticles_common::image::Image;
use isoparticles_common::kd_tree::KdTree;
use isoparticles_common::sizing::trilinear;
use rayon::prelude::*;

/// Balls whose two touching points are seen from the centre under less than this (radians) are pruned.
pub const MIN_SEPARATION_ANGLE: f64 = 40.0 * std::f64::consts::PI / 180.0;

/// A ball is pruned whose cap between the touching points is lower than this many times the noise.
const PLAIN_BUMP: f64 = 2.0;

/// Leaves of the tree of samples that one look for a sample inside a ball may take: a ball that fits the surface all round has
/// every sample at its rim.
const MOST_LEAVES: usize = 400;

/// A ball is surely not empty when its radius exceeds the distance field at its centre by half the diagonal of a cell (what
/// interpolation may take off the tip of a cone) and this share of the largest spacing (for the error of the samples).
const SURE: f64 = 0.2;

/// The samples of the surface and their distance field.
pub struct Surface<'a> {
    /// Positions (grid frame, mm).
    pub points: &'a [DVec3],
    /// Unit normals, outward.
    pub normals: &'a [DVec3],
    /// How deep other samples may lie inside the ball of each (mm) without shrinking it: next to the touching point that is ripple
    /// or what is left of the noise, not shape.
    pub blur: &'a [f64],
    /// How high noise stands at each (mm).
    pub noise: &'a [f64],
    /// Signed distance, mm.
    pub distance: &'a Image<f32>,
}

/// Centres of the medial balls of both sides of every sample, pruned. `largest` bounds the radius looked for (mm).
pub fn medial_points(surface: &Surface<'_>, largest: f64) -> Vec<[Option<DVec3>; 2]> {
    let tree = KdTree::new(surface.points);
    (0..surface.points.len())
        .into_par_iter()
        .map(|i| {
            let normal = surface.normals[i];
            [normal, -normal].map(|direction| surface.shrink(&tree, i, direction, largest))
        })
        .collect()
}

impl Surface<'_> {
    /// Centre of the largest empty ball that touches sample i and lies in `direction`, unless it is pruned or larger than
    /// `largest`.
    fn shrink(&self, tree: &KdTree, i: usize, direction: DVec3, largest: f64) -> Option<DVec3> {
        let p = self.points[i];
        let (mut radius, mut touching) = (self.upper_bound(p, direction, largest), None);
        for _ in 0..60 {
            let centre = p + direction * radius;
            let Some((q, _)) = tree.nearest_of_leaves(centre, radius - self.blur[i], MOST_LEAVES) else { break };
            let offset = self.points[q] - p;
            let height = direction.dot(offset);
            if q == i || height <= 0.0 {
                break;
            }
            radius = 0.5 * offset.length_squared() / height;
            touching = Some(q);
        }
        let q = touching?;
        let centre = p + direction * radius;
        let angle = (p - centre).angle_between(self.points[q] - centre);
        let height = radius * (1.0 - (0.5 * angle).cos());
        (angle >= MIN_SEPARATION_ANGLE && height >= PLAIN_BUMP * self.noise[i]).then_some(centre)
    }

    /// A radius of which the distance field says that the ball holds samples, little above the largest empty one; `largest`
    /// where it does not say so.
    fn upper_bound(&self, p: DVec3, direction: DVec3, largest: f64) -> f64 {
        let geometry = &self.distance.geometry;
        let sure = 0.5 * geometry.spacing.length() + SURE * geometry.spacing.max_element();
        let corner = geometry.upper_corner();
        let is_full = |radius: f64| {
            let centre = p + direction * radius;
            let is_within = centre.cmpge(DVec3::ZERO).all() && centre.cmple(corner).all();
            is_within.then(|| radius - trilinear(self.distance, centre).abs() > sure)
        };
        let (mut low, mut high) = (0.0, geometry.mean_spacing());
        while is_full(high) == Some(false) && high < largest {
            (low, high) = (high, 1.5 * high);
        }
        if high >= largest || is_full(high).is_none() {
            return largest;
        }
        for _ in 0..3 {
            let middle = 0.5 * (low + high);
            if is_full(middle) == Some(true) { high = middle } else { low = middle }
        }
        high
    }
}
