//! Points of the medial axis, by the shrinking-ball algorithm (Ma, Bae and Choi 2012) on dense samples of the surface.
//!
//! A ball that touches the surface at a sample is shrunk until no other sample lies inside it; its centre is then on the
//! medial axis, inside or outside the object. Each sample gives two balls. A ball that touches the surface at two points
//! seen from its centre under a small angle tells of noise, or of the last bit before an end of the axis: such balls are
//! pruned. What that takes off an end is small (the tip of an ellipsoid reads 0.4 % too large).

use glam::DVec3;
use isoparticles_common::kd_tree::KdTree;
use rayon::prelude::*;

/// Balls whose two touching points are seen from the centre under less than this (radians) are pruned.
pub const MIN_SEPARATION_ANGLE: f64 = 40.0 * std::f64::consts::PI / 180.0;

/// Leaves of the tree of samples that one look for a sample inside a ball may take: a ball that fits the surface all round has
/// every sample at its rim.
const MOST_LEAVES: usize = 400;

/// Centres of the medial balls of both sides, pruned. `largest` bounds the radius looked for (mm); samples that lie inside a
/// ball by no more than `blur` (mm) do not shrink it: next to the touching point that is ripple, not shape.
pub fn medial_points(points: &[DVec3], normals: &[DVec3], largest: f64, blur: f64) -> Vec<DVec3> {
    let tree = KdTree::new(points);
    (0..points.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            [normals[i], -normals[i]].into_iter().filter_map({
                let tree = &tree;
                move |direction| shrink(points, tree, i, direction, [largest, blur])
            })
        })
        .collect()
}

/// Centre of the largest empty ball that touches sample i and lies in `direction`, unless it is pruned or larger than
/// `largest`.
fn shrink(points: &[DVec3], tree: &KdTree, i: usize, direction: DVec3, [largest, blur]: [f64; 2]) -> Option<DVec3> {
    let p = points[i];
    let (mut radius, mut touching) = (largest, None);
    for _ in 0..60 {
        let centre = p + direction * radius;
        let Some((q, _)) = tree.nearest_of_leaves(centre, radius - blur, MOST_LEAVES) else { break };
        let offset = points[q] - p;
        let height = direction.dot(offset);
        if q == i || height <= 0.0 {
            break;
        }
        radius = 0.5 * offset.length_squared() / height;
        touching = Some(q);
    }
    let q = touching?;
    let centre = p + direction * radius;
    ((p - centre).angle_between(points[q] - centre) >= MIN_SEPARATION_ANGLE).then_some(centre)
}
