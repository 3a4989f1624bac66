//! The segments of junction curves: pairs of points that follow each other, each on a curve of its own three materials, or of four where two curves coincide.

use crate::interfaces::{Segment, segment};
use glam::DVec3;
use isoparticles_field::materials::Stratum;
use isoparticles_mesh::spatial::Bins;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Segments by their ends, by each end, and by place.
#[derive(Clone, Debug)]
pub struct Segments {
    curve: BTreeMap<Segment, Stratum>,
    /// The other ends of the segments at each point.
    ends: HashMap<u32, Vec<u32>>,
    /// Segments by their middles; none is longer than two bins.
    middles: Bins<Segment>,
    /// The longest of the first ones, mm.
    longest: f64,
    /// Those that were taken from the triangulation: they last no longer than they are edges of their materials.
    adopted: BTreeSet<Segment>,
}

impl Segments {
    /// Of pairs of points with their curves.
    pub fn new(pairs: impl IntoIterator<Item = (Segment, Stratum)>, points: &[DVec3]) -> Self {
        let pairs: BTreeMap<Segment, Stratum> = pairs.into_iter().collect();
        let length = |[a, b]: &Segment| points[*a as usize].distance(points[*b as usize]);
        let longest = pairs.keys().map(length).fold(0.0, f64::max);
        let middles = Bins::new(if longest > 0.0 { 0.5 * longest } else { 1.0 });
        let mut new = Self { curve: BTreeMap::new(), ends: HashMap::new(), middles, longest, adopted: BTreeSet::new() };
        pairs.into_iter().for_each(|(pair, curve)| new.add(pair, curve, points));
        new
    }

    /// Adds a segment no longer than the longest of the first ones. One that is there already is of both curves.
    fn add(&mut self, pair: Segment, curve: Stratum, points: &[DVec3]) {
        if self.curve.contains_key(&pair) {
            self.widen(pair, curve);
            return;
        }
        self.curve.insert(pair, curve);
        let [a, b] = pair;
        self.ends.entry(a).or_default().push(b);
        self.ends.entry(b).or_default().push(a);
        self.middles.add(points[a as usize].midpoint(points[b as usize]), pair);
    }

    /// Has a segment be of the materials of another stratum, too, if they are four in all at most.
    pub fn widen(&mut self, pair: Segment, stratum: Stratum) {
        if let Some(known) = self.curve.get_mut(&pair) {
            *known = known.joined(&stratum).unwrap_or(*known);
        }
    }

    /// Whether a segment can give way to two by way of a point: they are not too long, and no more than four materials meet on either.
    pub fn can_pass(&self, [a, b]: Segment, by: u32, points: &[DVec3]) -> bool {
        let Some(curve) = self.curve([a, b]) else { return false };
        let fits = |end: u32| {
            let known = self.curve(segment(end, by)).unwrap_or(curve);
            points[end as usize].distance(points[by as usize]) <= self.longest && known.joined(&curve).is_some()
        };
        by != a && by != b && fits(a) && fits(b)
    }

    /// Whether there are segments from a point to both ends of another one that are of its curve as well.
    pub fn is_covered(&self, pair: Segment, by: u32) -> bool {
        let Some(curve) = self.curve(pair) else { return false };
        pair.iter().all(|&end| self.curve(segment(end, by)).is_some_and(|known| known.is_on(&curve)))
    }

    /// Puts two segments by way of a point in the place of one.
    pub fn split(&mut self, pair: Segment, by: u32, points: &[DVec3]) {
        let Some(curve) = self.curve(pair) else { return };
        let is_adopted = self.remove(pair, points);
        for end in pair {
            let new = segment(end, by);
            if !is_adopted {
                self.adopted.remove(&new);
            } else if !self.curve.contains_key(&new) {
                self.adopted.insert(new);
            }
            self.add(new, curve, points);
        }
    }

    /// Adds an edge of the triangulation whose ends lie on a curve, if it is no segment yet and no longer than the longest of the first ones; true when it did.
    pub fn adopt(&mut self, edge: Segment, curve: Stratum, points: &[DVec3]) -> bool {
        let [a, b] = edge.map(|v| points[v as usize]);
        let is_new = !self.curve.contains_key(&edge) && a.distance(b) <= self.longest;
        if is_new {
            self.adopted.insert(edge);
            self.add(edge, curve, points);
        }
        is_new
    }

    /// Those that were adopted, ascending.
    pub fn adopted(&self) -> Vec<Segment> {
        self.adopted.iter().copied().collect()
    }

    /// Takes a segment away; true when it was adopted.
    pub fn remove(&mut self, pair: Segment, points: &[DVec3]) -> bool {
        self.curve.remove(&pair);
        let [a, b] = pair;
        for (from, to) in [(a, b), (b, a)] {
            self.ends.entry(from).or_default().retain(|&end| end != to);
        }
        self.middles.remove(points[a as usize].midpoint(points[b as usize]), &pair);
        self.adopted.remove(&pair)
    }

    /// The curve of a pair of points, if they are a segment.
    pub fn curve(&self, pair: Segment) -> Option<Stratum> {
        self.curve.get(&pair).copied()
    }

    /// All segments with their curves, ascending.
    pub fn all(&self) -> impl Iterator<Item = (Segment, Stratum)> + '_ {
        self.curve.iter().map(|(&pair, &curve)| (pair, curve))
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.curve.len()
    }

    /// The segments at a point.
    pub fn at(&self, point: u32) -> impl Iterator<Item = Segment> + '_ {
        self.ends.get(&point).into_iter().flatten().map(move |&end| segment(point, end))
    }

    /// The segment on which a place encroaches: it lies in the ball of which the segment is a diameter (Ruppert 1995), the deepest of several.
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

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::materials::MaterialId;

    #[test]
    fn what_is_in_the_ball_on_a_segment_encroaches_on_it_until_it_is_split() {
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
        // what is adopted stays so when it is split, until another segment comes to lie on it
        points.extend([DVec3::new(1.0, 1.0, 0.0), DVec3::new(0.5, 0.5, 0.0)]);
        assert!(segments.adopt([0, 4], curve, &points) && !segments.adopt([0, 3], curve, &points));
        segments.split([0, 4], 5, &points);
        assert_eq!(segments.adopted(), [[0, 5], [4, 5]]);
        segments.split([0, 3], 5, &points);
        assert_eq!(segments.adopted(), [[4, 5]]);
        assert!(segments.remove([4, 5], &points) && !segments.remove([0, 5], &points));
        assert_eq!((segments.curve([4, 5]), segments.count()), (None, 3));
    }
}
