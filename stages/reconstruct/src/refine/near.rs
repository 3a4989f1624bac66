//! The vertex nearest to a place, while points are being added.

use glam::DVec3;
use isoparticles_mesh::kd_tree::KdTree;

/// The tree of all points is built anew when this many for each of its own have been added, one in eight.
const OUTGROWN: usize = 8;

/// Points by place: a tree of most of them, and a small one of those added since.
#[derive(Default)]
pub(super) struct Nearest {
    first: KdTree,
    added: KdTree,
}

impl Nearest {
    /// Takes in the points added since the last call; those before must be the same.
    pub(super) fn update(&mut self, points: &[DVec3]) {
        let known = self.first.len();
        if OUTGROWN * (points.len() - known) > known {
            (self.first, self.added) = (KdTree::new(points), KdTree::default());
        } else if points.len() > known + self.added.len() {
            self.added = KdTree::new(&points[known..]);
        }
    }

    /// The nearest point and its distance, mm; the lowest number wins a tie.
    pub(super) fn to(&self, place: DVec3) -> Option<(u32, f64)> {
        self.accepted(place, f64::INFINITY, |_| true)
    }

    /// The nearest point that `accept` takes and its distance, mm, if it is below `radius`.
    pub(super) fn accepted(&self, place: DVec3, radius: f64, accept: impl Fn(u32) -> bool) -> Option<(u32, f64)> {
        let offset = self.first.len();
        let first = self.first.nearest_accepted(place, radius, &accept);
        let radius = first.map_or(radius, |(_, distance)| distance);
        let added = self.added.nearest_accepted(place, radius, |v| accept(v + offset as u32));
        let added = added.map(|(v, distance)| (v + offset, distance));
        added.or(first).map(|(v, distance)| (v as u32, distance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;

    #[test]
    fn points_added_are_found_like_the_first_ones() {
        let points: Vec<DVec3> =
            (0..900).map(|n| DVec3::new(uniform(1, 0, n), uniform(1, 1, n), uniform(1, 2, n))).collect();
        let mut nearest = Nearest::default();
        for count in [500, 500, 501, 540, 900] {
            nearest.update(&points[..count]);
            for n in 0..200 {
                let place = DVec3::new(uniform(2, 0, n), uniform(2, 1, n), uniform(2, 2, n));
                let brute = |accept: &dyn Fn(usize) -> bool| {
                    let all = (0..count).filter(|v| accept(*v)).map(|v| (points[v].distance(place), v as u32));
                    all.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, v)| v)
                };
                assert_eq!(nearest.to(place).map(|(v, _)| v), brute(&|_| true));
                let even = nearest.accepted(place, f64::INFINITY, |v| v % 2 == 0);
                assert_eq!(even.map(|(v, _)| v), brute(&|v| v % 2 == 0));
            }
        }
    }
}
