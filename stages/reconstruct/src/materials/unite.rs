//! What lies nearer together than `ONE_CURVE` is one, which points cannot tell: when none are added any more, the strata of the complex are brought in line with its tetrahedra
//! there. Edges on which three or four materials meet become segments of the curve that passes their ends; segments beside others of their curve, which are edges, are one with
//! these; segments between places that their curve passes by others, however long, are too many; and a vertex at a facet of a sheet that passes it is on that sheet, too.

use super::complex::Complex;
use super::refine::Refinement;
use super::segments::Segment;
use super::topology::Simplices;
use super::way::{self, ONE_CURVE};
use crate::queue::{Reason, Simplex};
use isoparticles_field::materials::Stratum;
use std::collections::BTreeSet;

/// Most segments that are one with others at a place: those of the parts of `brain_parcellation` in which some are missing are two at most.
const MOST: usize = 8;

/// Segments that are one are no farther apart, in voxels: the points of either may lie `ONE_CURVE` off the curve that passes them.
const APART: f64 = 2.0 * ONE_CURVE;

impl Refinement<'_> {
    /// Takes edges as segments, segments as one with others, and vertices as points of sheets, where they are nearer than `ONE_CURVE`. No tetrahedron changes its material.
    pub(super) fn unite(&mut self) {
        let complex = &mut self.complex;
        let wrong = |complex: &Complex| complex.wrong(&Simplices::all(complex, complex.labelled.facets()));
        for (_, simplex) in wrong(complex) {
            if let Simplex::Edge(edge) = simplex {
                complex.adopt(edge);
            }
        }
        complex.give_up_adopted();
        let found = wrong(complex);
        let missing = found.iter().filter_map(|(reason, simplex)| match simplex {
            Simplex::Edge(pair) if matches!(reason, Reason::Segment | Reason::Ring) => Some(*pair),
            _ => None,
        });
        for group in groups(missing.collect()) {
            let is_superfluous = is_superfluous(complex, &group);
            if is_superfluous || is_one_with_others(complex, &group) {
                *(if is_superfluous { &mut self.report.superfluous } else { &mut self.report.united }) += group.len();
                for pair in group {
                    complex.segments.remove(pair, complex.labelled.points());
                }
            }
        }
        for (_, simplex) in found {
            if let Simplex::Facet(vertices) = simplex {
                complex.join_facet(vertices);
            }
        }
    }
}

/// Segments by those that hang together.
fn groups(mut segments: BTreeSet<Segment>) -> Vec<Vec<Segment>> {
    let mut groups = Vec::new();
    while let Some(first) = segments.pop_first() {
        let mut group = vec![first];
        let mut next = 0;
        while let Some(&own) = group.get(next) {
            let touches = |other: &&Segment| other.iter().any(|v| own.contains(v));
            let found: Vec<Segment> = segments.iter().filter(touches).copied().collect();
            found.iter().for_each(|pair| _ = segments.remove(pair));
            group.extend(found);
            next += 1;
        }
        groups.push(group);
    }
    groups
}

/// Whether segments that are no edges between their materials are one with others that are: these lead, no farther from them than [`APART`], from each of their ends at which others
/// go on to each other one, past all of their points.
fn is_one_with_others(complex: &Complex, group: &[Segment]) -> bool {
    let (points, segments) = (complex.points(), &complex.segments);
    let reach = APART * complex.indicators.voxel();
    let Some(curve) = segments.curve(group[0]) else { return false };
    let is_plain =
        |&pair: &Segment| complex.at_edge(pair).is_none_or(|start| complex.runs_round(pair, start).len() < 3);
    let is_same = |other: Stratum| other.curves().any(|own| curve.is_on(&own));
    if group.len() > MOST || !group.iter().all(|pair| is_plain(pair) && segments.curve(*pair).is_some_and(is_same)) {
        return false;
    }
    let distance = |v: u32, to: &[Segment]| {
        let at = |pair: &Segment| way::foot(&pair.map(|v| points[v as usize]), points[v as usize]).1;
        to.iter().map(at).fold(f64::INFINITY, f64::min)
    };
    // those that are edges, of the same curve, and near
    let leads = |pair: &Segment| {
        let known = segments.curve(*pair).filter(|&own| is_same(own));
        !group.contains(pair)
            && pair.iter().all(|&v| distance(v, group) < reach)
            && known.is_some_and(|own| complex.wrong_segment(*pair, own, complex.at_edge(*pair)).is_none())
    };
    let all: BTreeSet<u32> = group.iter().flatten().copied().collect();
    let goes_on = |&v: &u32| segments.at(v).any(|pair| !group.contains(&pair));
    let ends: Vec<u32> = all.iter().copied().filter(goes_on).collect();
    let Some(&first) = ends.first() else { return false };
    let (mut reached, mut others) = (vec![first], Vec::new());
    let mut next = 0;
    while let Some(&v) = reached.get(next) {
        for pair in segments.at(v).filter(leads) {
            others.push(pair);
            reached.extend(pair.iter().filter(|v| !reached.contains(v)).copied().collect::<Vec<_>>());
        }
        next += 1;
    }
    ends.iter().all(|end| reached.contains(end)) && all.iter().all(|&v| distance(v, &others) < reach)
}

/// Whether a segment that is no edge between its materials is one too many: a curve of three materials passes a point once, and both of its ends lie on two others of its curve that are such
/// edges. Where two ways of a curve come near to each other, it may have been followed from one to the other.
fn is_superfluous(complex: &Complex, group: &[Segment]) -> bool {
    let &[pair] = group else { return false };
    let Some(curve) = complex.segments.curve(pair).filter(|curve| curve.dimension() == 1) else { return false };
    let is_right = |other: &Segment| {
        let is_of_curve = *other != pair && complex.segments.curve(*other) == Some(curve);
        is_of_curve && complex.wrong_segment(*other, curve, complex.at_edge(*other)).is_none()
    };
    let is_passed = |&v: &u32| complex.segments.at(v).filter(is_right).count() > 1;
    let is_plain = complex.at_edge(pair).is_none_or(|start| complex.wrong_plain_edge(pair, start).is_none());
    is_plain && pair.iter().all(is_passed)
}

#[cfg(test)]
mod tests {
    use super::super::prepare::{Prepared, Taken};
    use super::super::scenes::stratum;
    use super::super::segments::{Segments, segment};
    use super::*;
    use glam::DVec3;
    use isoparticles_delaunay::Delaunay;
    use isoparticles_field::materials::{Analytic, Indicators, ball, half_space, maximum, negative};

    /// A ball of three sectors round the z axis, with two points beside the axis a hair apart, and segments from both of them to both neighbours on the axis.
    fn lens(hair: f64) -> (Analytic, Vec<DVec3>, [Segment; 4]) {
        let normal =
            |turns: f64| DVec3::new((turns * std::f64::consts::TAU).cos(), (turns * std::f64::consts::TAU).sin(), 0.0);
        let sector = |n: f64| {
            let [from, to] = [n / 3.0, (n + 1.0) / 3.0].map(|turns| normal(turns + 0.25));
            maximum(ball(DVec3::ZERO, 6.0), maximum(half_space(DVec3::ZERO, -from), half_space(DVec3::ZERO, to)))
        };
        let analytic =
            Analytic::new(vec![negative(ball(DVec3::ZERO, 6.0)), sector(0.0), sector(1.0), sector(2.0)], 1.0);
        let mut points = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|z| DVec3::Z * z).to_vec();
        // the other point of the axis
        points.push(DVec3::new(hair * 0.9, hair * 0.1, 0.02 * hair));
        for ring in 0..3 {
            for (z, shift) in [(-1.6, 0.01), (-0.6, -0.01), (0.45, 0.02), (1.55, -0.03)] {
                let turns = f64::from(ring) / 3.0;
                points.push((1.0 + shift) * normal(turns) + z * DVec3::Z);
                points.push((1.0 + shift) * normal(turns + 1.0 / 6.0) + (z + shift) * DVec3::Z);
            }
        }
        (analytic, points, [[1, 2], [2, 3], [1, 5], [3, 5]])
    }

    /// A complex of these points, of which so many are on the axis, with segments of it.
    fn complex_of<'a>(analytic: &'a Analytic, points: &[DVec3], on_axis: usize, pairs: &[Segment]) -> Complex<'a> {
        let curve = stratum(&[1, 2, 3]);
        let sheet = |p: &DVec3| {
            let near = analytic.near(*p);
            let ids: Vec<u16> = near.entries()[..2].iter().map(|(id, _)| id.0).collect();
            stratum(&ids)
        };
        let prepared = Prepared {
            delaunay: Delaunay::new(points).expect("points in space"),
            sizes: vec![1.0; points.len()],
            strata: (0..).zip(points).map(|(v, p)| if v < on_axis { curve } else { sheet(p) }).collect(),
            segments: Segments::new(pairs.iter().map(|&[a, b]| (segment(a, b), curve)), points),
            report: Taken::default(),
        };
        Complex::new(prepared, analytic, DVec3::splat(6.0), None)
    }

    #[test]
    fn a_curve_that_was_followed_twice_is_one_where_its_two_ways_are_nearer_than_points_can_tell() {
        for (hair, is_one) in [(0.01, true), (0.3, false)] {
            let (analytic, points, pairs) = lens(hair);
            let curve = stratum(&[1, 2, 3]);
            let all: Vec<Segment> = pairs.into_iter().chain([[0, 1], [3, 4]]).collect();
            let complex = complex_of(&analytic, &points, 6, &all);
            let missing: BTreeSet<Segment> = pairs
                .into_iter()
                .filter(|&pair| complex.wrong_segment(pair, curve, complex.at_edge(pair)).is_some())
                .collect();
            let groups = groups(missing);
            assert!(groups.len() == 1 && groups[0].len() == 2, "one of the two ways: {groups:?}");
            assert_eq!(is_one_with_others(&complex, &groups[0]), is_one);
        }
    }

    #[test]
    fn a_segment_between_points_that_their_curve_passes_already_is_one_too_many() {
        let (analytic, mut points, _) = lens(0.3);
        points.remove(5);
        let axis = [[0, 1], [1, 2], [2, 3], [3, 4]];
        let extra = |pair: Segment| {
            let complex = complex_of(&analytic, &points, 5, &[&axis[..], &[pair]].concat());
            let curve = complex.segments.curve(pair).expect("a segment");
            assert!(
                complex.wrong_segment(pair, curve, complex.at_edge(pair)).is_some(),
                "{pair:?} is no edge of the curve"
            );
            is_superfluous(&complex, &[pair])
        };
        assert!(extra([1, 3]));
        assert!(!extra([0, 2]), "0 is an end");
        let complex = complex_of(&analytic, &points, 5, &axis);
        assert!(axis.iter().all(|&pair| !is_superfluous(&complex, &[pair])), "what is right stays");
    }

    #[test]
    fn segments_that_touch_are_one_group() {
        let groups = groups([[0, 1], [1, 2], [4, 7], [2, 9], [5, 7]].into());
        assert_eq!(groups, [vec![[0, 1], [1, 2], [2, 9]], vec![[4, 7], [5, 7]]]);
    }
}
