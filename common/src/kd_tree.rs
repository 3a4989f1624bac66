//! A balanced k-d tree over points, for nearest-neighbour queries (Bentley 1975).
//!
//! The points are reordered in place into an implicit median tree, so the tree costs one index a point and stands any
//! number of equal coordinates (points on grid planes are the rule here, and some published trees refuse them).

use glam::DVec3;

const LEAF: usize = 12;

/// Static tree over a set of points.
#[derive(Clone, Debug, Default)]
pub struct KdTree {
    points: Vec<DVec3>,
    index: Vec<u32>,
}

impl KdTree {
    /// Builds the tree; answers name points by their index in `points`.
    pub fn new(points: &[DVec3]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        split(points, &mut order);
        Self { points: order.iter().map(|&i| points[i as usize]).collect(), index: order }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Index and distance of the nearest point; `None` for an empty tree. The lowest index wins a tie.
    pub fn nearest(&self, query: DVec3) -> Option<(usize, f64)> {
        self.nearest_within(query, f64::INFINITY)
    }

    /// Index and distance of the nearest point closer than `radius`.
    pub fn nearest_within(&self, query: DVec3, radius: f64) -> Option<(usize, f64)> {
        let mut best = (u32::MAX, radius * radius);
        self.search(query, 0, self.points.len(), 0, &mut best);
        (best.0 != u32::MAX).then(|| (best.0 as usize, best.1.sqrt()))
    }

    fn search(&self, query: DVec3, low: usize, high: usize, depth: usize, best: &mut (u32, f64)) {
        if high - low <= LEAF {
            for at in low..high {
                let d = self.points[at].distance_squared(query);
                if d < best.1 || (d == best.1 && self.index[at] < best.0 && best.0 != u32::MAX) {
                    *best = (self.index[at], d);
                }
            }
            return;
        }
        let middle = low + (high - low) / 2;
        let (point, axis) = (self.points[middle], depth % 3);
        let d = point.distance_squared(query);
        if d < best.1 || (d == best.1 && self.index[middle] < best.0 && best.0 != u32::MAX) {
            *best = (self.index[middle], d);
        }
        let side = query[axis] - point[axis];
        let (near, far) =
            if side < 0.0 { ((low, middle), (middle + 1, high)) } else { ((middle + 1, high), (low, middle)) };
        self.search(query, near.0, near.1, depth + 1, best);
        if side * side <= best.1 {
            self.search(query, far.0, far.1, depth + 1, best);
        }
    }
}

fn split(points: &[DVec3], order: &mut [u32]) {
    fn recurse(points: &[DVec3], order: &mut [u32], depth: usize) {
        if order.len() <= LEAF {
            return;
        }
        let (middle, axis) = (order.len() / 2, depth % 3);
        order.select_nth_unstable_by(middle, |&a, &b| {
            points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
        });
        let (left, right) = order.split_at_mut(middle);
        rayon::join(|| recurse(points, left, depth + 1), || recurse(points, &mut right[1..], depth + 1));
    }
    recurse(points, order, 0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;

    #[test]
    fn nearest_equals_brute_force_also_on_grid_planes() {
        for (count, snap) in [(1, 0.0), (5, 0.0), (700, 0.0), (900, 4.0)] {
            let random = |stream, n| {
                let x = uniform(11, stream, n);
                if snap > 0.0 { (x * snap).floor() } else { x }
            };
            let points: Vec<DVec3> = (0..count).map(|n| DVec3::new(random(0, n), random(1, n), random(2, n))).collect();
            let tree = KdTree::new(&points);
            for n in 0..300 {
                let q = DVec3::new(uniform(5, 0, n), uniform(5, 1, n), uniform(5, 2, n))
                    * if snap > 0.0 { snap } else { 1.0 };
                let want = points.iter().map(|p| p.distance(q)).fold(f64::INFINITY, f64::min);
                let (at, got) = tree.nearest(q).unwrap();
                assert!((got - want).abs() < 1e-12 && (points[at].distance(q) - want).abs() < 1e-12);
                assert!(tree.nearest_within(q, 0.5 * want).is_none());
            }
        }
        assert!(KdTree::new(&[]).nearest(DVec3::ZERO).is_none());
    }
}
