//! JunctionPoint curves that end where no fourth material meets them: none does, and what lies between two such ends could not be followed, where sheets are all but tangent.

use super::prepare::Point;
use super::segments::{Segment, segment};
use glam::DVec3;
use std::collections::BTreeMap;

/// Open ends are joined up to so many target edge lengths apart: neighbours on a curve are one apart.
const FARTHEST: f64 = 2.0;

/// Pairs that join the open ends of curves in a volume that ends at `upper`, nearest first: each with one of the same curve, or with a junction point at which all its
/// materials meet. Curves end at the border of the volume, too.
pub(super) fn joined(points: &[Point], pairs: &[Segment], upper: DVec3) -> Vec<Segment> {
    let mut times: BTreeMap<u32, usize> = BTreeMap::new();
    pairs.iter().flatten().for_each(|&v| *times.entry(v).or_default() += 1);
    let is_inside = |p: DVec3| p.cmpgt(DVec3::ZERO).all() && p.cmplt(upper).all();
    let is_open = |v: &u32| {
        let point = &points[*v as usize];
        point.stratum.dimension() == 1 && times.get(v) == Some(&1) && is_inside(point.place)
    };
    let open: Vec<u32> = times.keys().copied().filter(is_open).collect();
    let others = (0..points.len() as u32).filter(|&v| points[v as usize].stratum.dimension() == 0);
    let others: Vec<u32> = if open.is_empty() { Vec::new() } else { open.iter().copied().chain(others).collect() };
    let mut found: Vec<(f64, u32, u32)> = Vec::new();
    for &end in &open {
        let own = &points[end as usize];
        for &other in others.iter().filter(|&&v| v != end && points[v as usize].stratum.is_on(&own.stratum)) {
            let distance = own.place.distance(points[other as usize].place);
            if distance < FARTHEST * own.size && !pairs.contains(&segment(end, other)) {
                found.push((distance, end, other));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut left = open;
    let mut joined = Vec::new();
    for (_, end, other) in found {
        let is_left = |v: u32| left.contains(&v) || points[v as usize].stratum.dimension() == 0;
        if is_left(end) && is_left(other) {
            left.retain(|&v| v != end && v != other);
            joined.push(segment(end, other));
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::materials::{MaterialId, Stratum};

    #[test]
    fn open_ends_are_joined_to_the_nearest_of_their_curve_or_to_a_junction_point_of_it() {
        let stratum =
            |ids: &[u16]| Stratum::new(&ids.iter().map(|&id| MaterialId(id)).collect::<Vec<_>>()).expect("valid");
        let (curve, other, point) = (stratum(&[0, 1, 2]), stratum(&[0, 1, 3]), stratum(&[0, 1, 2, 3]));
        let at = |x: f64, stratum: Stratum| Point { place: DVec3::new(x, 1.0, 1.0), stratum, size: 1.0 };
        // two chains of a curve 1.5 apart, one of another between them, and an end 0.5 before a junction point
        let points = [
            (1.0, curve),
            (2.0, curve),
            (3.5, curve),
            (4.5, curve),
            (2.5, other),
            (2.7, other),
            (5.0, point),
            (0.0, curve),
        ];
        let points: Vec<Point> = points.iter().map(|&(x, stratum)| at(x, stratum)).collect();
        let pairs = [[0, 7], [0, 1], [2, 3], [4, 5]];
        assert_eq!(joined(&points, &pairs, DVec3::splat(9.0)), [[3, 6], [1, 2]]);
        // the first point lies on the border of the volume
        assert_eq!(joined(&points[..2], &[[0, 1]], DVec3::new(9.0, 1.0, 9.0)), [[0; 2]; 0]);
    }
}
