//! Points to be added, and the choice among them.

use super::{Refinement, component_at};
use glam::DVec3;
use isoparticles_stage::error::Result;
use std::collections::HashMap;

/// A new point keeps this part of h from all others where the topology asks for it.
const NEAREST_FOR_TOPOLOGY: f64 = 0.02;

/// Why a point is to be inserted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Reason {
    Missing,
    Manifold,
    Bridge,
    Genus,
    Deviation,
    Node,
}

/// A point that may be inserted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) reason: Reason,
    /// Place on F = 0, grid frame, mm.
    pub(super) point: DVec3,
    /// Distance from the nearest vertices known, mm.
    pub(super) radius: f64,
    /// Target edge length h, mm.
    pub(super) size: f64,
    /// A vertex not far away.
    pub(super) near: u32,
}

impl Candidate {
    /// How far it keeps from points inserted in the same round, mm.
    fn clearance(&self) -> f64 {
        if self.reason == Reason::Missing { 0.99 * self.radius } else { 0.8 * self.radius }
    }
}

impl Refinement<'_> {
    /// Inserts candidates, the most needed and the roomiest first, none too near to one inserted in the same round; returns how many. That is
    /// a round, if there are any.
    pub(super) fn insert_all(&mut self, candidates: Vec<Candidate>) -> Result<usize> {
        let inserted = self.insert_those(candidates)?;
        self.report.rounds += usize::from(inserted > 0);
        Ok(inserted)
    }

    /// Inserts candidates like [`Refinement::insert_all`], in no round of their own.
    pub(super) fn insert_those(&mut self, mut candidates: Vec<Candidate>) -> Result<usize> {
        candidates.retain(|c| c.radius >= NEAREST_FOR_TOPOLOGY * c.size);
        candidates.sort_by(|a, b| {
            a.reason.cmp(&b.reason).then(b.radius.total_cmp(&a.radius)).then_with(|| {
                let (p, q) = (a.point.to_array(), b.point.to_array());
                p.partial_cmp(&q).unwrap_or(std::cmp::Ordering::Equal)
            })
        });
        let mut taken = Taken::new(candidates.iter().map(Candidate::clearance));
        let mut inserted = 0;
        for candidate in candidates {
            if taken.any_within(candidate.point, candidate.clearance())
                || self.restricted.insert(candidate.point, candidate.near)?.is_none()
            {
                continue;
            }
            taken.add(candidate.point);
            self.sizes.push(candidate.size);
            self.component_of.push(component_at(candidate.point, self.restricted.field(), self.topology));
            inserted += 1;
            let report = &mut self.report;
            *match candidate.reason {
                Reason::Missing => &mut report.inserted_missing,
                Reason::Manifold => &mut report.inserted_manifold,
                Reason::Bridge => &mut report.inserted_bridges,
                Reason::Genus => &mut report.inserted_genus,
                Reason::Deviation => &mut report.inserted_deviation,
                Reason::Node => &mut report.inserted_nodes,
            } += 1;
        }
        if inserted > 0 {
            self.restricted.decide_sides();
            self.report.inserted += inserted;
        }
        Ok(inserted)
    }
}

/// Points in grids of cells, each grid twice as coarse as the one before: a search looks into the grid whose cells are just as large as its
/// radius. With one grid for the largest radius all points of a large surface may lie in a few cells.
struct Taken {
    /// Binary logarithm of the cell size of each grid, ascending.
    levels: Vec<i32>,
    cells: HashMap<(i32, [i64; 3]), Vec<DVec3>>,
}

impl Taken {
    /// For searches within these radii.
    fn new(radii: impl Iterator<Item = f64>) -> Self {
        let mut levels: Vec<i32> = radii.map(level).collect();
        levels.sort_unstable();
        levels.dedup();
        Self { levels, cells: HashMap::new() }
    }

    fn add(&mut self, p: DVec3) {
        for &level in &self.levels {
            self.cells.entry((level, cell(p, level))).or_default().push(p);
        }
    }

    /// Whether a point is nearer than a radius, which must be one of those given.
    fn any_within(&self, p: DVec3, radius: f64) -> bool {
        let level = level(radius);
        let at = cell(p, level);
        (0..27i64)
            .filter_map(|n| self.cells.get(&(level, [at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1])))
            .flatten()
            .any(|q| q.distance(p) < radius)
    }
}

/// The least power of two that a length does not exceed, unless it is so short that cells could not be counted.
fn level(length: f64) -> i32 {
    length.max(1e-12).log2().ceil() as i32
}

fn cell(p: DVec3, level: i32) -> [i64; 3] {
    (p / f64::powi(2.0, level)).floor().to_array().map(|x| x as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::uniform;

    #[test]
    fn points_within_a_radius_are_those_of_a_plain_search() {
        let point = |stream, n| DVec3::new(uniform(stream, 0, n), uniform(stream, 1, n), uniform(stream, 2, n)) * 9.0;
        let radii: Vec<f64> = (0..300).map(|n| 0.01 * 700f64.powf(uniform(3, 0, n))).chain([0.0, 1.0, 2.0]).collect();
        let mut taken = Taken::new(radii.iter().copied());
        let mut points = Vec::new();
        let mut near = 0;
        for n in 0..300 {
            points.push(point(1, n));
            taken.add(points[n as usize]);
            let (p, radius) = (point(2, n), radii[(n as usize * 7) % radii.len()]);
            let any = points.iter().any(|q| q.distance(p) < radius);
            assert_eq!(taken.any_within(p, radius), any);
            near += usize::from(any);
        }
        assert!((50..250).contains(&near), "{near}");
    }
}
