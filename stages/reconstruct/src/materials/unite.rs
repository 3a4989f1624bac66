//! The final changes to the strata of a complex, after the last point is inserted. Edges on which
//! three or four materials meet become segments if their curve passes both ends within the
//! tolerance ([`Complex::tolerance`]). Superfluous segments are dropped.

use super::complex::Complex;
use super::refine::Refinement;
use super::topology::Simplices;
use crate::interfaces::Segment;
use crate::queue::{Reason, Simplex};

impl Refinement<'_> {
    /// Adopts edges as segments, and drops superfluous segments. No tetrahedron changes its
    /// material.
    pub(super) fn unite(&mut self) {
        let complex = &mut self.complex;
        let wrong = |complex: &Complex| complex.wrong(&Simplices::all(complex, complex.labelled.facets()));
        for (_, simplex) in wrong(complex) {
            if let Simplex::Edge(edge) = simplex {
                self.report.adopted += usize::from(complex.adopt(edge));
            }
        }
        for (reason, simplex) in wrong(complex) {
            if let (Simplex::Edge(pair), Reason::Segment | Reason::Ring) = (simplex, reason)
                && is_superfluous(complex, pair)
            {
                self.report.superfluous += 1;
                complex.segments.remove(pair, complex.labelled.points());
            }
        }
    }
}

/// Returns whether a segment that is not an edge between its materials is superfluous: its curve
/// has three materials, each of its ends has two other segments of this curve that are such edges,
/// and the topology at the edge is right without the segment. Such segments exist where `seed`
/// follows a curve from one of two close branches to the other.
fn is_superfluous(complex: &Complex, pair: Segment) -> bool {
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
    use super::super::prepare::Prepared;
    use super::super::scenes::stratum;
    use super::super::segments::Segments;
    use super::*;
    use crate::interfaces::segment;
    use crate::options::Options;
    use crate::prepare::PrepareReport;
    use glam::DVec3;
    use isoparticles_delaunay::Delaunay;
    use isoparticles_field::materials::{Analytic, Indicators, ball, half_space, maximum, negative};

    /// Returns a ball of three sectors around the z axis, and points of which the first five are on
    /// the axis.
    fn three_sectors() -> (Analytic, Vec<DVec3>) {
        let normal =
            |turns: f64| DVec3::new((turns * std::f64::consts::TAU).cos(), (turns * std::f64::consts::TAU).sin(), 0.0);
        let sector = |n: f64| {
            let [from, to] = [n / 3.0, (n + 1.0) / 3.0].map(|turns| normal(turns + 0.25));
            maximum(ball(DVec3::ZERO, 6.0), maximum(half_space(DVec3::ZERO, -from), half_space(DVec3::ZERO, to)))
        };
        let analytic =
            Analytic::new(vec![negative(ball(DVec3::ZERO, 6.0)), sector(0.0), sector(1.0), sector(2.0)], 1.0);
        let mut points = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|z| DVec3::Z * z).to_vec();
        for ring in 0..3 {
            for (z, shift) in [(-1.6, 0.01), (-0.6, -0.01), (0.45, 0.02), (1.55, -0.03)] {
                let turns = f64::from(ring) / 3.0;
                points.push((1.0 + shift) * normal(turns) + z * DVec3::Z);
                points.push((1.0 + shift) * normal(turns + 1.0 / 6.0) + (z + shift) * DVec3::Z);
            }
        }
        (analytic, points)
    }

    /// Returns the complex of these points with segments of the axis, at a scale.
    fn complex_of<'a>(analytic: &'a Analytic, points: &[DVec3], pairs: &[Segment]) -> Complex<'a> {
        complex_with(analytic, points, pairs, (1.0, false))
    }

    /// Returns the complex for a target edge length h, and whether voxel centres keep their
    /// materials.
    fn complex_with<'a>(
        analytic: &'a Analytic,
        points: &[DVec3],
        pairs: &[Segment],
        (h, keeps_voxels): (f64, bool),
    ) -> Complex<'a> {
        let curve = stratum(&[1, 2, 3]);
        let interface = |p: &DVec3| {
            let near = analytic.near(*p);
            let ids: Vec<u16> = near.entries()[..2].iter().map(|(id, _)| id.0).collect();
            stratum(&ids)
        };
        let prepared = Prepared {
            delaunay: Delaunay::new(points).expect("points in space"),
            sizes: vec![h; points.len()],
            strata: (0..).zip(points).map(|(v, p)| if v < 5 { curve } else { interface(p) }).collect(),
            segments: Segments::new(pairs.iter().map(|&[a, b]| (segment(a, b), curve)), points),
            report: PrepareReport::default(),
        };
        let options = Options { keeps_voxels, ..Options::default() };
        Complex::new(prepared, analytic, DVec3::splat(6.0), &options)
    }

    #[test]
    fn at_a_scale_curves_pass_points_within_a_share_of_h() {
        let (analytic, mut points) = three_sectors();
        // off the axis by more than 0.05 voxel and less than 0.05 h for h = 4
        points[3] += DVec3::new(0.1, 0.0, -0.1);
        let adopted = |h: f64, keeps_voxels: bool| {
            let mut complex = complex_with(&analytic, &points, &[[0, 1], [1, 2]], (h, keeps_voxels));
            complex.strata[3] = stratum(&[1, 2]);
            (complex.adopt([2, 3]), complex.joined.contains(&3), complex.tolerance(3))
        };
        assert_eq!(adopted(1.0, false), (false, false, 0.05));
        assert_eq!(adopted(4.0, true), (false, false, 0.05), "scale 0");
        assert_eq!(adopted(4.0, false), (true, true, 0.2));
    }

    #[test]
    fn segments_bypassed_by_others_are_superfluous() {
        let (analytic, points) = three_sectors();
        let axis = [[0, 1], [1, 2], [2, 3], [3, 4]];
        let extra = |pair: Segment| {
            let complex = complex_of(&analytic, &points, &[&axis[..], &[pair]].concat());
            let curve = complex.segments.curve(pair).expect("a segment");
            assert!(
                complex.wrong_segment(pair, curve, complex.at_edge(pair)).is_some(),
                "{pair:?} is no edge of the curve"
            );
            is_superfluous(&complex, pair)
        };
        assert!(extra([1, 3]));
        assert!(!extra([0, 2]), "0 is an end");
        let complex = complex_of(&analytic, &points, &axis);
        assert!(axis.iter().all(|&pair| !is_superfluous(&complex, pair)), "what is right stays");
    }
}
