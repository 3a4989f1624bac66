//! A balanced k-d tree over points, for nearest-neighbour queries (Bentley 1975).
//!
//! The points are reordered in place into an implicit median tree, so the tree costs one index a point and stands any
//! number of equal coordinates (points on grid planes are the rule here, and some published trees refuse them).

use glam::DVec3;
use std::ops::Range;

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
        self.nearest_of_leaves(query, radius, usize::MAX)
    }

    /// As [`KdTree::nearest_within`], but no more than so many leaves are looked at, the likeliest first: where all points are
    /// about equally far, as at the centre of a ball, an exact search would look at every one. The answer is then a point
    /// nearly as near as the nearest.
    pub fn nearest_of_leaves(&self, query: DVec3, radius: f64, leaves: usize) -> Option<(usize, f64)> {
        let mut search = Search { query, best: (u32::MAX, radius * radius), leaves };
        self.search(&mut search, 0..self.points.len(), 0, DVec3::ZERO);
        let (index, squared) = search.best;
        (index != u32::MAX).then(|| (index as usize, squared.sqrt()))
    }

    /// Searches a part of the tree that is `offset` away from the query, by axis (Arya and Mount 1993).
    fn search(&self, search: &mut Search, part: Range<usize>, depth: usize, offset: DVec3) {
        if search.leaves == 0 {
            return;
        }
        if part.len() <= LEAF {
            search.leaves -= 1;
            part.for_each(|at| search.consider(self.points[at], self.index[at]));
            return;
        }
        let middle = part.start + part.len() / 2;
        let (point, axis) = (self.points[middle], depth % 3);
        search.consider(point, self.index[middle]);
        let side = search.query[axis] - point[axis];
        let (left, right) = (part.start..middle, middle + 1..part.end);
        let (near, far) = if side < 0.0 { (left, right) } else { (right, left) };
        self.search(search, near, depth + 1, offset);
        let mut offset = offset;
        offset[axis] = side;
        if offset.length_squared() <= search.best.1 {
            self.search(search, far, depth + 1, offset);
        }
    }
}

/// A search under way.
struct Search {
    query: DVec3,
    /// Index and squared distance of the nearest point so far.
    best: (u32, f64),
    /// Leaves that may still be looked at.
    leaves: usize,
}

impl Search {
    fn consider(&mut self, point: DVec3, index: u32) {
        let d = point.distance_squared(self.query);
        if d < self.best.1 || (d == self.best.1 && index < self.best.0 && self.best.0 != u32::MAX) {
            self.best = (index, d);
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
    }

    #[test]
    fn a_search_of_few_leaves_ends_soon_and_near_the_truth() {
        let points: Vec<DVec3> = (0..20_000)
            .map(|n| {
                let (z, turn) = (2.0 * uniform(3, 0, n) - 1.0, std::f64::consts::TAU * uniform(3, 1, n));
                DVec3::new((1.0 - z * z).sqrt() * turn.cos(), (1.0 - z * z).sqrt() * turn.sin(), z) * 10.0
            })
            .collect();
        let tree = KdTree::new(&points);
        let centre = DVec3::new(1e-3, 0.0, 0.0);
        let (_, exact) = tree.nearest(centre).unwrap();
        let (_, near) = tree.nearest_of_leaves(centre, f64::INFINITY, 20).unwrap();
        assert!(near >= exact && near < exact + 2e-3, "{near} against {exact}");
        assert!(tree.nearest_of_leaves(centre, 9.0, 20).is_none());
        assert!(KdTree::new(&[]).nearest(DVec3::ZERO).is_none());
    }
}
