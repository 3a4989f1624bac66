//! A balanced k-d tree of points for nearest-neighbour queries (Bentley 1975). Every node stores
//! the bounding box of its points.
//!
//! The points are reordered into an implicit median tree. For each point, the tree therefore stores
//! only its position, its index and, on average, about ten bytes of boxes. Any number of points may
//! have equal coordinates, which is common because points often lie on grid planes. The boxes
//! exclude the empty space around surface points, so a ball that touches a surface intersects few
//! boxes.

use crate::spatial::Bounds;
use glam::DVec3;
use std::ops::Range;

/// Maximum number of points in a leaf. With 3, 6, 12, 24 and 48 points per leaf, a search for the
/// nearest of 300,000 points on a bumpy sphere takes 8.0, 7.6, 6.2, 5.4 and 4.0 us. The query
/// positions are at most 5 % of the radius away from the sphere (medians of three runs with
/// `rustc -O` on a busy machine with 2 cores, 2026-11-27). Larger leaves are faster, but callers
/// that limit the number of visited leaves rely on a size of 12.
const LEAF_POINTS: usize = 12;

/// A k-d tree over a fixed set of points.
#[derive(Clone, Debug, Default)]
pub struct KdTree {
    points: Vec<DVec3>,
    index: Vec<u32>,
    /// Bounding box of each node. The children of node n are `2 * n + 1` and `2 * n + 2`.
    boxes: Vec<Bounds>,
}

impl KdTree {
    /// Builds the tree. Results identify a point by its index in `points`.
    pub fn new(points: &[DVec3]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        split(points, &mut order);
        let mut tree =
            Self { points: order.iter().map(|&i| points[i as usize]).collect(), index: order, boxes: Vec::new() };
        tree.bound(0..points.len(), 0);
        tree
    }

    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Returns whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Returns the index and distance of the nearest point, or `None` for an empty tree. If several
    /// points are equally close, returns the lowest index.
    pub fn nearest(&self, query: DVec3) -> Option<(usize, f64)> {
        self.nearest_within(query, f64::INFINITY)
    }

    /// Returns the index and distance of the nearest point that is closer than `radius`.
    pub fn nearest_within(&self, query: DVec3, radius: f64) -> Option<(usize, f64)> {
        self.nearest_of_leaves(query, radius, usize::MAX)
    }

    /// Works like [`KdTree::nearest_within`], but visits at most `leaves` leaves, closest first.
    /// The result is therefore not always the nearest point. From the centre of a ball, for
    /// example, all points of its surface are at about the same distance, and an exact search would
    /// visit every leaf.
    pub fn nearest_of_leaves(&self, query: DVec3, radius: f64, leaves: usize) -> Option<(usize, f64)> {
        let mut search = Search { query, best: (u32::MAX, radius * radius), leaves };
        self.search(&mut search, 0..self.points.len(), 0);
        let (index, squared) = search.best;
        (index != u32::MAX).then(|| (index as usize, squared.sqrt()))
    }

    /// Calls `found` with the index and position of every point in a ball (centre, radius). Visits
    /// the closer child of each node first. `found` may return a smaller ball inside the current
    /// ball; the search then continues with that ball. Returns false if it stops because `leaves`
    /// leaves have been visited.
    pub fn each_within(
        &self,
        ball: (DVec3, f64),
        leaves: usize,
        found: &mut impl FnMut(u32, DVec3) -> Option<(DVec3, f64)>,
    ) -> bool {
        let mut visit = Visit { centre: ball.0, squared: ball.1 * ball.1, leaves };
        self.is_empty() || self.visit(&mut visit, found, 0..self.points.len(), 0)
    }

    fn visit(
        &self,
        visit: &mut Visit,
        found: &mut impl FnMut(u32, DVec3) -> Option<(DVec3, f64)>,
        part: Range<usize>,
        number: usize,
    ) -> bool {
        let mut look = |visit: &mut Visit, range: Range<usize>| {
            for at in range {
                if self.points[at].distance_squared(visit.centre) < visit.squared
                    && let Some((centre, radius)) = found(self.index[at], self.points[at])
                {
                    (visit.centre, visit.squared) = (centre, radius * radius);
                }
            }
        };
        if part.len() <= LEAF_POINTS {
            let is_allowed = visit.leaves > 0;
            if is_allowed {
                visit.leaves -= 1;
                look(visit, part);
            }
            return is_allowed;
        }
        let middle = middle(&part);
        look(visit, middle..middle + 1);
        let far = |visit: &Visit, number: usize| distance_squared(&self.boxes[number], visit.centre);
        let (left, right) = ((part.start..middle, 2 * number + 1), (middle + 1..part.end, 2 * number + 2));
        let is_left_first = far(visit, left.1) <= far(visit, right.1);
        let halves = if is_left_first { [left, right] } else { [right, left] };
        halves
            .into_iter()
            .all(|(part, number)| far(visit, number) >= visit.squared || self.visit(visit, found, part, number))
    }

    /// Searches one node, which must not be empty.
    fn search(&self, search: &mut Search, part: Range<usize>, number: usize) {
        if search.leaves == 0 {
            return;
        }
        if part.len() <= LEAF_POINTS {
            search.leaves -= 1;
            part.for_each(|at| search.consider(self.points[at], self.index[at]));
            return;
        }
        let middle = middle(&part);
        search.consider(self.points[middle], self.index[middle]);
        let half =
            |part: Range<usize>, number: usize| (distance_squared(&self.boxes[number], search.query), part, number);
        let (left, right) = (half(part.start..middle, 2 * number + 1), half(middle + 1..part.end, 2 * number + 2));
        let halves = if left.0 <= right.0 { [left, right] } else { [right, left] };
        for (squared, part, number) in halves {
            // a point at the same distance may have a lower index
            if squared <= search.best.1 {
                self.search(search, part, number);
            }
        }
    }

    /// Computes the boxes of a node and its descendants, and returns the box of the node.
    fn bound(&mut self, part: Range<usize>, number: usize) -> Bounds {
        let bounds = if part.len() <= LEAF_POINTS {
            Bounds::of(&self.points[part])
        } else {
            let middle = middle(&part);
            let left = self.bound(part.start..middle, 2 * number + 1);
            let right = self.bound(middle + 1..part.end, 2 * number + 2);
            left.merged(right).merged(Bounds::of(&self.points[middle..middle + 1]))
        };
        if number >= self.boxes.len() {
            self.boxes.resize(number + 1, Bounds::EMPTY);
        }
        self.boxes[number] = bounds;
        bounds
    }
}

/// Returns the index of the point that separates the two children of a node.
fn middle(part: &Range<usize>) -> usize {
    part.start + part.len() / 2
}

fn distance_squared(bounds: &Bounds, query: DVec3) -> f64 {
    (bounds.low - query).max(query - bounds.high).max(DVec3::ZERO).length_squared()
}

/// State of [`KdTree::each_within`].
struct Visit {
    centre: DVec3,
    /// Squared radius of the ball.
    squared: f64,
    /// Number of leaves that the search may still visit.
    leaves: usize,
}

/// State of a nearest-point search.
struct Search {
    query: DVec3,
    /// Index and squared distance of the nearest point so far.
    best: (u32, f64),
    /// Number of leaves that the search may still visit.
    leaves: usize,
}

impl Search {
    fn consider(&mut self, point: DVec3, index: u32) {
        let d = point.distance_squared(self.query);
        let is_nearer = d < self.best.1 || (d == self.best.1 && index < self.best.0 && self.best.0 != u32::MAX);
        if is_nearer {
            self.best = (index, d);
        }
    }
}

/// Splits the points recursively at the median of the axis with the largest extent.
fn split(points: &[DVec3], order: &mut [u32]) {
    if order.len() <= LEAF_POINTS {
        return;
    }
    let bounds = order.iter().fold(Bounds::EMPTY, |bounds, &i| {
        let p = points[i as usize];
        bounds.merged(Bounds { low: p, high: p })
    });
    let (middle, axis) = (order.len() / 2, (bounds.high - bounds.low).max_position());
    order.select_nth_unstable_by(middle, |&a, &b| {
        points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
    });
    let (left, right) = order.split_at_mut(middle);
    rayon::join(|| split(points, left), || split(points, &mut right[1..]));
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;

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
                let radius = 1.7 * want;
                let mut found = Vec::new();
                assert!(tree.each_within((q, radius), usize::MAX, &mut |n, p| {
                    assert_eq!(p, points[n as usize]);
                    found.push(n);
                    None
                }));
                found.sort_unstable();
                let near = |n: &u32| points[*n as usize].distance_squared(q) < radius * radius;
                assert_eq!(found, (0..count as u32).filter(near).collect::<Vec<_>>());
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
        let is_done = |tree: &KdTree, ball: (DVec3, f64)| tree.each_within(ball, 20, &mut |_, _| None);
        assert!(!is_done(&tree, (centre, 10.1)) && is_done(&tree, (centre, 9.0)));
        let empty = KdTree::new(&[]);
        assert!(empty.nearest(DVec3::ZERO).is_none() && is_done(&empty, (DVec3::ZERO, 1.0)));
    }
}
