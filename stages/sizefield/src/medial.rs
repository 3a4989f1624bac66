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
//! The distance field tells a ball that is surely too large without any search, so that only the last steps look at samples. Balls that touch the
//! surface at one sample in one direction lie inside each other, so that one look finds the samples for all further steps.

use glam::DVec3;
use isoparticles_field::sizing::trilinear;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Balls whose two touching points are seen from the centre under less than this (radians) are pruned.
pub const MIN_SEPARATION_ANGLE: f64 = 40.0 * std::f64::consts::PI / 180.0;

/// A ball is pruned whose cap between the touching points is lower than this many times the noise.
const PLAIN_BUMP: f64 = 2.0;

/// Leaves of the tree of samples that one look for a sample inside a ball may take: a ball that fits the surface all round has
/// every sample at its rim.
const MOST_LEAVES: usize = 400;

/// The same for a look for all samples inside a ball.
const MOST_LEAVES_FOR_ALL: usize = 100;

/// A ball is shrunk so many times at most.
const MOST_STEPS: usize = 60;

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
        .map_init(Vec::new, |inside, i| {
            let normal = surface.normals[i];
            [normal, -normal].map(|direction| surface.shrink(&tree, i, direction, largest, inside))
        })
        .collect()
}

/// A sample as the balls see it that touch the surface at another one, in one direction.
struct Seen {
    /// Offset along that direction, mm.
    height: f64,
    /// Squared distance, mm squared.
    squared: f64,
    index: u32,
}

impl Seen {
    /// Squared distance from the centre of the ball of a radius, less that radius squared.
    fn beyond(&self, radius: f64) -> f64 {
        self.squared - 2.0 * self.height * radius
    }

    /// Radius of the ball that has the sample on it.
    fn radius(&self) -> f64 {
        0.5 * self.squared / self.height
    }
}

impl Surface<'_> {
    /// Centre of the largest empty ball that touches sample i and lies in `direction`, unless it is pruned or larger than
    /// `largest`.
    fn shrink(&self, tree: &KdTree, i: usize, direction: DVec3, largest: f64, inside: &mut Vec<Seen>) -> Option<DVec3> {
        let p = self.points[i];
        let seen = |q: u32, at: DVec3| {
            let offset = at - p;
            Seen { height: direction.dot(offset), squared: offset.length_squared(), index: q }
        };
        let (mut radius, mut touching) = (self.upper_bound(p, direction, largest), None);
        for _ in 0..MOST_STEPS {
            let (centre, empty) = (p + direction * radius, radius - self.blur[i]);
            let Some((q, _)) = tree.nearest_of_leaves(centre, empty, MOST_LEAVES) else { break };
            let next = seen(q as u32, self.points[q]);
            if next.height <= 0.0 {
                break;
            }
            (radius, touching) = (next.radius(), Some(q));
            inside.clear();
            let (centre, empty) = (p + direction * radius, radius - self.blur[i]);
            if tree.each_within(centre, empty, MOST_LEAVES_FOR_ALL, &mut |q, at| inside.push(seen(q, at))) {
                // a smaller ball lies inside this one, and so do the samples in it
                (radius, touching) = shrink_to_fit(inside, radius, self.blur[i], touching);
                break;
            }
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

/// Shrinks a ball of which the samples inside are known until none lies deeper in it than `blur` (mm): to the one nearest to its
/// centre, again and again. Returns its radius and the sample that it then touches, `touching` where it holds none.
fn shrink_to_fit(inside: &[Seen], mut radius: f64, blur: f64, mut touching: Option<usize>) -> (f64, Option<usize>) {
    for _ in 0..MOST_STEPS {
        let nearer = |a: &Seen, b: &Seen| {
            let (near, far) = (a.beyond(radius), b.beyond(radius));
            near < far || (near == far && a.index < b.index)
        };
        let nearest = inside.iter().reduce(|best, next| if nearer(next, best) { next } else { best });
        let Some(nearest) = nearest else { break };
        let is_inside = nearest.beyond(radius) < blur * (blur - 2.0 * radius);
        if !is_inside || nearest.height <= 0.0 {
            break;
        }
        (radius, touching) = (nearest.radius(), Some(nearest.index as usize));
    }
    (radius, touching)
}
