//! Computes points of the medial axis from dense samples of the surface with the shrinking-ball
//! algorithm (Ma, Bae and Choi 2012).
//!
//! A ball that touches the surface at a sample is shrunk until no other sample lies inside it. The
//! centre of the ball is then on the medial axis. Each sample gives two balls, one inside and one
//! outside the object. Balls on unstable branches of the axis are pruned (Chazal and Lieutier 2005)
//! if they meet one of two criteria:
//!
//! - The angle between the two touching points, seen from the centre, is small. Such a ball results
//!   from ripple, or its centre lies at the very end of a branch of the axis. Pruning shortens
//!   branches only slightly: the feature size at the tip of an ellipsoid is 0.4 % too large.
//! - The surface has noise ([`crate::noise`]), and the cap of the ball between the touching points
//!   is lower than twice the height of the noise. Such a ball results from a bump in the noise.
//!
//! Two upper bounds on the radius save time: one from the distance field, and one from the sample
//! that the previous ball touches. All balls that touch a sample on one side are nested, so a
//! single query that shrinks the ball as it proceeds finds the largest empty ball.

use glam::DVec3;
use isoparticles_field::sizing::trilinear;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Minimum angle in radians between the two touching points of a ball, seen from its centre. Balls
/// with smaller angles are pruned. With 20 degrees, the minimum feature size in the test
/// `a_half_noisy_ball_has_its_radius_everywhere` falls from 17.4 to 13.9 voxels. With 80 degrees,
/// ends of the axis are lost: the 5th percentile of the feature size on an ellipsoid with semi-axes
/// of 20, 10 and 10 voxels rises from 5.3 to 6.3 voxels.
pub const MIN_SEPARATION_ANGLE: f64 = 40.0 * std::f64::consts::PI / 180.0;

/// Minimum height of the cap of a ball between the touching points, as a multiple of the height of
/// the noise. Balls with lower caps are pruned. With 1, the minimum feature size in the test
/// `a_half_noisy_ball_has_its_radius_everywhere` falls from 17.4 to 1.3 voxels; 4 gives the same
/// result as 2.
const LEAST_CAP: f64 = 2.0;

/// Maximum number of leaves that one query visits in the k-d tree of samples, nearest leaf first.
/// The limit is needed if a ball fits the whole surface, because all samples are then near its
/// boundary. Measured with 400 and 100: the sizing field of label 2 of `lungs_label_big` predicts
/// 238,911 and 238,902 particles, and a ball in a volume of 256^3 voxels takes 4.7 and 3.5 s.
const MOST_LEAVES: usize = 100;

/// Number of consecutive samples that one task processes in order. Consecutive samples are mostly
/// neighbours, so each search starts with the sample that the previous ball on the same side
/// touches. The first searches of a task have no such start.
const RUN: usize = 64;

/// Allowance for errors of the samples, as a fraction of the maximum spacing. A ball is assumed to
/// contain samples if its radius exceeds the interpolated distance at its centre by more than the
/// sum of this allowance, half a cell diagonal and the blur. Half a diagonal covers the
/// interpolation error at the tip of a cone. Fractions of 0 and 0.4 give the same feature sizes for
/// balls, tori, an ellipsoid and a slab.
const SAMPLE_ERROR: f64 = 0.2;

/// The samples of the surface and their distance field.
pub struct Surface<'a> {
    /// Positions in mm in the grid frame.
    pub points: &'a [DVec3],
    /// Unit normals, outward.
    pub normals: &'a [DVec3],
    /// For each sample, the depth in mm to which other samples may lie inside its medial ball
    /// without shrinking it. Near the touching point, such samples result from ripple or noise.
    pub blur: &'a [f64],
    /// Height in mm of the noise at each sample.
    pub noise: &'a [f64],
    /// Signed distance, mm.
    pub distance: &'a Image<f32>,
}

/// Returns the centres of the medial balls on both sides of every sample; `None` for a ball that is
/// pruned or not found. `largest` is the maximum radius (mm).
pub fn medial_points(surface: &Surface<'_>, largest: f64) -> Vec<[Option<DVec3>; 2]> {
    let tree = KdTree::new(surface.points);
    let count = surface.points.len();
    let of_run = |start: usize| -> Vec<[Option<DVec3>; 2]> {
        let mut hints = [None; 2];
        let of_sample = |i: usize| {
            let normal = surface.normals[i];
            [(0, normal), (1, -normal)].map(|(side, direction)| {
                let ball = surface.largest_empty(&tree, i, direction, largest, hints[side]);
                hints[side] = ball.map(|(_, touching)| touching);
                ball.and_then(|(radius, touching)| surface.kept_centre(i, direction, radius, touching))
            })
        };
        (start..count.min(start + RUN)).map(of_sample).collect()
    };
    // runs start at fixed indices, so they do not depend on the number of threads
    let runs: Vec<usize> = (0..count).step_by(RUN).collect();
    runs.into_par_iter().flat_map_iter(of_run).collect()
}

impl Surface<'_> {
    /// Finds the largest ball in `direction` that touches the surface at sample i and contains no
    /// other sample deeper than the blur. Returns the radius of the ball that exactly touches the
    /// limiting sample, and the index of that sample. Returns `None` if no sample limits the ball
    /// up to the radius `largest`. `hint` is a sample that may limit the ball.
    fn largest_empty(
        &self,
        tree: &KdTree,
        i: usize,
        direction: DVec3,
        largest: f64,
        hint: Option<usize>,
    ) -> Option<(f64, usize)> {
        let (p, blur) = (self.points[i], self.blur[i]);
        // a ball of radius r contains q at depth d if
        // |q - p|^2 - 2 r direction . (q - p) + r^2 = (r - d)^2
        let fitting = |at: DVec3| {
            let offset = at - p;
            0.5 * (offset.length_squared() - blur * blur) / (direction.dot(offset) - blur)
        };
        let mut ball = (largest, None::<usize>);
        let place = |radius: f64| (p + direction * radius, radius - blur);
        let shrink = |(radius, touching): &mut (f64, Option<usize>), q: usize, at: DVec3| {
            let fits = fitting(at);
            let is_smaller = fits < *radius || (fits == *radius && touching.is_none_or(|touching| q < touching));
            let is_ahead = direction.dot(at - p) > blur && fits > 0.0;
            (is_ahead && is_smaller).then(|| {
                (*radius, *touching) = (fits, Some(q));
                place(fits)
            })
        };
        let hinted = hint.filter(|&hint| hint != i).and_then(|hint| shrink(&mut ball, hint, self.points[hint]));
        if hinted.is_none() {
            ball.0 = self.upper_bound(i, direction, largest);
        }
        tree.each_within(place(ball.0), MOST_LEAVES, &mut |q, at| shrink(&mut ball, q as usize, at));
        // radius of the ball whose boundary contains the limiting sample
        let touched = |q: usize| {
            let offset = self.points[q] - p;
            (0.5 * offset.length_squared() / direction.dot(offset), q)
        };
        ball.1.map(touched)
    }

    /// Returns the centre of the ball in `direction` that touches the surface at sample i and at
    /// the sample `touching`, or `None` if the ball is pruned.
    fn kept_centre(&self, i: usize, direction: DVec3, radius: f64, touching: usize) -> Option<DVec3> {
        let p = self.points[i];
        let centre = p + direction * radius;
        let angle = (p - centre).angle_between(self.points[touching] - centre);
        let height = radius * (1.0 - (0.5 * angle).cos());
        (angle >= MIN_SEPARATION_ANGLE && height >= LEAST_CAP * self.noise[i]).then_some(centre)
    }

    /// Returns an upper bound on the radius of the largest empty ball, derived from the distance
    /// field, or `largest` if the field gives no bound.
    fn upper_bound(&self, i: usize, direction: DVec3, largest: f64) -> f64 {
        let (p, geometry) = (self.points[i], &self.distance.geometry);
        let margin = 0.5 * geometry.spacing.length() + SAMPLE_ERROR * geometry.spacing.max_element() + self.blur[i];
        let corner = geometry.upper_corner();
        let is_full = |radius: f64| {
            let centre = p + direction * radius;
            let is_within = centre.cmpge(DVec3::ZERO).all() && centre.cmple(corner).all();
            is_within.then(|| radius - trilinear(self.distance, centre).abs() > margin)
        };
        let (mut low, mut high) = (0.0, geometry.mean_spacing());
        while is_full(high) == Some(false) && high < largest {
            (low, high) = (high, 1.5 * high);
        }
        if high >= largest || is_full(high).is_none() {
            return largest;
        }
        // once the loop has run, `high` is 1.5 times `low`, and three halvings reduce the interval
        // to 1 / 24 = 4 % of `high`
        for _ in 0..3 {
            let middle = 0.5 * (low + high);
            if is_full(middle) == Some(true) { high = middle } else { low = middle }
        }
        high
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;
    use isoparticles_volume::Geometry;

    #[test]
    fn balls_stop_at_the_sample_of_a_full_search() {
        // two balls, both with random bumps
        let centres = [(DVec3::new(12.0, 12.0, 12.0), 7.0), (DVec3::new(24.0, 12.0, 12.5), 3.0)];
        let distance = |p: DVec3| {
            centres.iter().map(|(centre, radius)| p.distance(*centre) - radius).fold(f64::INFINITY, f64::min)
        };
        let image = Image::sampled(Geometry::axis_aligned([32, 25, 25], DVec3::ONE), |p| distance(p) as f32);
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        for n in 0..700u64 {
            let (centre, radius) = centres[usize::from(n >= 500)];
            let (z, turn) = (2.0 * uniform(1, 0, n) - 1.0, std::f64::consts::TAU * uniform(1, 1, n));
            let way = DVec3::new((1.0 - z * z).sqrt() * turn.cos(), (1.0 - z * z).sqrt() * turn.sin(), z);
            points.push(centre + (radius + 0.05 * uniform(1, 2, n)) * way);
            normals.push(way);
        }
        let (blur, noise) = (vec![0.02; points.len()], vec![0.0; points.len()]);
        let surface = Surface { points: &points, normals: &normals, blur: &blur, noise: &noise, distance: &image };
        let tree = KdTree::new(&points);
        let mut stopped = 0;
        for i in 0..points.len() {
            for direction in [normals[i], -normals[i]] {
                let offsets = (0..points.len()).filter(|&q| q != i).map(|q| (q, points[q] - points[i]));
                let fits = offsets.filter(|(_, offset)| direction.dot(*offset) > blur[i]).map(|(q, offset)| {
                    (0.5 * (offset.length_squared() - blur[i] * blur[i]) / (direction.dot(offset) - blur[i]), q)
                });
                let least = fits.filter(|(fits, _)| *fits > 0.0).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                let want = least.filter(|(fits, _)| *fits <= 20.0).map(|(_, q)| q);
                for hint in [None, Some((i + 1) % points.len()), Some((i + 350) % points.len()), want] {
                    let found = surface.largest_empty(&tree, i, direction, 20.0, hint);
                    assert_eq!(found.map(|(_, q)| q), want, "sample {i}, hint {hint:?}");
                    if let Some((radius, q)) = found {
                        let centre = points[i] + radius * direction;
                        assert!((centre.distance(points[q]) - radius).abs() < 1e-9 * radius);
                    }
                }
                stopped += usize::from(want.is_some());
            }
        }
        assert!(stopped > points.len() && stopped < 2 * points.len(), "{stopped}");
    }
}
