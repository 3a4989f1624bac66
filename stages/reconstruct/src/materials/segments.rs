//! The segments of junction curves. A segment is a pair of consecutive points on a curve of three
//! materials, or of four materials where two curves are merged. Finds the segments at a point, and
//! the segment upon which a position encroaches (Ruppert 1995).

use crate::interfaces::{Segment, segment};
use glam::DVec3;
use isoparticles_field::materials::Stratum;
use isoparticles_mesh::spatial::Bins;
use std::collections::{BTreeMap, HashMap};

/// Segments, indexed by both ends, by each end and by midpoint.
#[derive(Clone, Debug)]
pub struct Segments {
    curve: BTreeMap<Segment, Stratum>,
    /// The other ends of the segments at each point.
    ends: HashMap<u32, Vec<u32>>,
    /// Segments by midpoint, in bins of half the maximum length. The midpoint of a segment upon
    /// which a position encroaches is in the bin of this position or an adjacent one.
    middles: Bins<Segment>,
    /// Maximum length of the initial segments, mm.
    longest: f64,
}

impl Segments {
    /// Creates the segments from pairs of points and their curves.
    pub fn new(pairs: impl IntoIterator<Item = (Segment, Stratum)>, points: &[DVec3]) -> Self {
        let pairs: BTreeMap<Segment, Stratum> = pairs.into_iter().collect();
        let length = |[a, b]: &Segment| points[*a as usize].distance(points[*b as usize]);
        let longest = pairs.keys().map(length).fold(0.0, f64::max);
        let middles = Bins::new(if longest > 0.0 { 0.5 * longest } else { 1.0 });
        let mut new = Self { curve: BTreeMap::new(), ends: HashMap::new(), middles, longest };
        pairs.into_iter().for_each(|(pair, curve)| new.add(pair, curve, points));
        new
    }

    /// Adds a segment, which must not be longer than `longest`. A segment that exists already gets
    /// the materials of both curves.
    fn add(&mut self, pair: Segment, curve: Stratum, points: &[DVec3]) {
        if let Some(known) = self.curve.get_mut(&pair) {
            *known = known.joined(&curve).unwrap_or(*known);
            return;
        }
        self.curve.insert(pair, curve);
        let [a, b] = pair;
        self.ends.entry(a).or_default().push(b);
        self.ends.entry(b).or_default().push(a);
        self.middles.add(points[a as usize].midpoint(points[b as usize]), pair);
    }

    /// Replaces a segment by two through a point.
    pub fn split(&mut self, pair: Segment, by: u32, points: &[DVec3]) {
        let Some(curve) = self.curve(pair) else { return };
        self.remove(pair, points);
        pair.iter().for_each(|&end| self.add(segment(end, by), curve, points));
    }

    /// Adds an edge of the triangulation whose ends lie on a curve, if it is not a segment yet and
    /// not longer than `longest`. Returns whether it was added.
    pub fn adopt(&mut self, edge: Segment, curve: Stratum, points: &[DVec3]) -> bool {
        let [a, b] = edge.map(|v| points[v as usize]);
        let is_new = !self.curve.contains_key(&edge) && a.distance(b) <= self.longest;
        if is_new {
            self.add(edge, curve, points);
        }
        is_new
    }

    /// Removes a segment.
    pub fn remove(&mut self, pair: Segment, points: &[DVec3]) {
        self.curve.remove(&pair);
        let [a, b] = pair;
        for (from, to) in [(a, b), (b, a)] {
            self.ends.entry(from).or_default().retain(|&end| end != to);
        }
        self.middles.remove(points[a as usize].midpoint(points[b as usize]), &pair);
    }

    /// Returns whether the segments at a point can move to another point: none gets more than four
    /// materials.
    pub fn can_merge(&self, gone: u32, keep: u32) -> bool {
        let fits = |pair: Segment| {
            let [Some(curve), other] = [pair, moved(pair, gone, keep)].map(|pair| self.curve(pair)) else {
                return false;
            };
            other.is_none_or(|other| other.joined(&curve).is_some())
        };
        self.at(gone).filter(|pair| !pair.contains(&keep)).all(fits)
    }

    /// Moves the segments at a point to another point, and removes the one between the two. The
    /// moved segments may be longer than `longest`, so [`Self::encroached`] no longer finds all.
    pub fn merge(&mut self, gone: u32, keep: u32, points: &[DVec3]) {
        for pair in self.at(gone).collect::<Vec<_>>() {
            let curve = self.curve(pair);
            self.remove(pair, points);
            if let Some(curve) = curve.filter(|_| !pair.contains(&keep)) {
                self.add(moved(pair, gone, keep), curve, points);
            }
        }
    }

    /// Returns the curve of a pair of points, if the pair is a segment.
    pub fn curve(&self, pair: Segment) -> Option<Stratum> {
        self.curve.get(&pair).copied()
    }

    /// Returns all segments with their curves, ascending.
    pub fn all(&self) -> impl Iterator<Item = (Segment, Stratum)> + '_ {
        self.curve.iter().map(|(&pair, &curve)| (pair, curve))
    }

    /// Returns the number of segments.
    pub fn count(&self) -> usize {
        self.curve.len()
    }

    /// Returns the segments at a point.
    pub fn at(&self, point: u32) -> impl Iterator<Item = Segment> + '_ {
        self.ends.get(&point).into_iter().flatten().map(move |&end| segment(point, end))
    }

    /// Returns the segment upon which a position encroaches: the position lies in its diametral
    /// ball (Ruppert 1995). Of several, returns the one with the minimum distance from the centre
    /// of the ball relative to its radius.
    pub fn encroached(&self, place: DVec3, points: &[DVec3]) -> Option<Segment> {
        let depth = |&pair: &Segment| {
            let [a, b] = pair.map(|v| points[v as usize]);
            let radius = 0.5 * a.distance(b);
            (a.midpoint(b).distance(place) / radius, pair)
        };
        let deepest = self
            .middles
            .near(place)
            .map(depth)
            .filter(|(depth, _)| *depth < 1.0)
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        deepest.map(|(_, pair)| pair)
    }
}

/// Returns a segment with the end `gone` replaced.
fn moved([a, b]: Segment, gone: u32, keep: u32) -> Segment {
    segment(keep, if a == gone { b } else { a })
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::materials::MaterialId;

    #[test]
    fn positions_in_the_diametral_ball_encroach_until_a_split() {
        let mut points = vec![DVec3::ZERO, DVec3::X * 2.0, DVec3::new(2.0, 1.0, 0.0)];
        let curve = Stratum::new(&[0, 1, 2].map(MaterialId)).expect("three");
        let mut segments = Segments::new([([0, 1], curve), ([1, 2], curve)], &points);
        let place = DVec3::new(1.0, 0.8, 0.0);
        assert_eq!(segments.encroached(place, &points), Some([0, 1]));
        assert_eq!(segments.encroached(DVec3::new(1.0, 1.1, 0.0), &points), None);
        assert_eq!(segments.encroached(DVec3::new(2.2, 0.5, 0.0), &points), Some([1, 2]));
        points.push(DVec3::X);
        segments.split([0, 1], 3, &points);
        assert_eq!(segments.encroached(place, &points), None);
        assert_eq!(segments.encroached(DVec3::new(0.5, 0.3, 0.1), &points), Some([0, 3]));
        assert_eq!(segments.all().map(|(pair, _)| pair).collect::<Vec<_>>(), [[0, 3], [1, 2], [1, 3]]);
        assert_eq!(segments.at(1).collect::<Vec<_>>(), [[1, 2], [1, 3]]);
        assert_eq!((segments.curve([0, 1]), segments.curve([1, 3])), (None, Some(curve)));
        points.push(DVec3::new(1.0, 1.0, 0.0));
        assert!(segments.adopt([0, 4], curve, &points) && !segments.adopt([0, 3], curve, &points));
        segments.remove([0, 4], &points);
        assert_eq!((segments.curve([0, 4]), segments.count()), (None, 3));
    }
}
