//! Finds where a surface itself allows no good tetrahedron: where facets meet at a small angle or
//! lie close in front of each other, and on facets with a small angle.
//!
//! A tetrahedron on a facet whose three dihedral angles at the facet are at least X contains the
//! *roof* of the facet: the tetrahedron whose other faces rise from the edges of the facet at the
//! angle X. If another facet enters the roof, no tetrahedron on this side of the facet has such
//! angles. The side is *forced*, and the largest X whose roof is free bounds the minimum dihedral
//! angle of its tetrahedron.

use crate::spatial::{Bounds, BoxTree};
use glam::DVec3;
use rayon::prelude::*;

/// Depth, relative to the longest side of the facet, up to which another facet only touches its
/// roof. Rounding errors are smaller by a factor of about 10^6.
const TOUCHING: f64 = 1e-9;

/// Bisection steps for the largest angle of a free roof. The error is below 10^-4 degrees.
const HALVINGS: usize = 20;

/// Length of a vector product, relative to the lengths of its factors, below which the factors
/// count as parallel. A separating axis from a shorter product has fewer than ten correct digits.
const PARALLEL: f64 = 1e-6;

/// Side of a facet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Side {
    /// The facet is clockwise as seen from this side.
    Behind,
    /// The facet is counter-clockwise as seen from this side.
    Before,
}

/// A side of a facet on which no tetrahedron reaches a given dihedral angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForcedSide {
    /// Index of the facet.
    pub facet: u32,
    /// Side of the facet.
    pub side: Side,
    /// Upper bound of the minimum dihedral angle of a tetrahedron there, in degrees.
    pub bound: f64,
}

/// A facet, and the values that determine its roofs.
struct Frame {
    corners: [DVec3; 3],
    normal: DVec3,
    /// For the edge that begins at each corner, the unit vector in the plane of the facet that is
    /// perpendicular to the edge and points inwards.
    inward: [DVec3; 3],
    /// Centre and radius of the inscribed circle.
    centre: DVec3,
    radius: f64,
    /// Length of the longest side.
    longest: f64,
}

impl Frame {
    fn of(corners: [DVec3; 3]) -> Self {
        let sides = [0, 1, 2].map(|k| corners[(k + 1) % 3] - corners[k]);
        let lengths = sides.map(DVec3::length);
        let doubled = sides[0].cross(sides[1]);
        let normal = doubled.normalize();
        let perimeter = lengths.iter().sum::<f64>();
        // the weight of each corner is the length of the opposite side
        let weighted = lengths[1] * corners[0] + lengths[2] * corners[1] + lengths[0] * corners[2];
        Self {
            corners,
            normal,
            inward: [0, 1, 2].map(|k| normal.cross(sides[k] / lengths[k])),
            centre: weighted / perimeter,
            radius: doubled.length() / perimeter,
            longest: lengths.into_iter().fold(0.0, f64::max),
        }
    }

    /// Returns the tip of the roof on one side. `slope` is the tangent of its angle.
    fn tip(&self, side: Side, slope: f64) -> DVec3 {
        self.centre + way(side) * slope * self.radius * self.normal
    }

    /// Returns whether another triangle enters the roof on one side (separating axis theorem).
    fn is_entered(&self, other: &[DVec3; 3], side: Side, slope: f64) -> bool {
        !self.is_apart_by_faces(other, side, slope) && !self.is_apart_by_edges(other, side, slope)
    }

    /// Returns whether the plane of a face of the roof separates the other triangle from the roof.
    fn is_apart_by_faces(&self, other: &[DVec3; 3], side: Side, slope: f64) -> bool {
        let touching = TOUCHING * self.longest;
        let height = other.map(|p| way(side) * (p - self.corners[0]).dot(self.normal));
        let is_beyond = |k: usize| {
            let within = |p: DVec3| (p - self.corners[k]).dot(self.inward[k]);
            other.iter().zip(height).all(|(&p, height)| height >= slope * within(p) - touching)
        };
        height.into_iter().all(|height| height <= touching) || (0..3).any(is_beyond)
    }

    /// Returns whether the plane of the other triangle, or a plane parallel to an edge of each,
    /// separates them.
    fn is_apart_by_edges(&self, other: &[DVec3; 3], side: Side, slope: f64) -> bool {
        let touching = TOUCHING * self.longest;
        let [a, b, c] = self.corners;
        let roof = [a, b, c, self.tip(side, slope)];
        let edges = [b - a, c - b, a - c, roof[3] - a, roof[3] - b, roof[3] - c];
        let sides = [0, 1, 2].map(|k| other[(k + 1) % 3] - other[k]);
        let longest = sides.iter().map(|side| side.length()).fold(0.0, f64::max);
        let usable = PARALLEL * (longest + self.longest).powi(2);
        let crossed = edges.iter().flat_map(|edge| sides.iter().map(|side| edge.cross(*side)));
        std::iter::once(sides[0].cross(sides[1])).chain(crossed).any(|axis| {
            let length = axis.length();
            let extent = |points: &[DVec3]| {
                let along = points.iter().map(|p| p.dot(axis) / length);
                along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
            };
            let (own, others) = (extent(&roof), extent(other));
            length > usable && (others.0 >= own.1 - touching || others.1 <= own.0 + touching)
        })
    }

    /// Returns the largest angle below `angle`, in degrees, whose roof the other triangle leaves
    /// free, or `None` if it leaves the roof of `angle` free.
    fn free_angle(&self, other: &[DVec3; 3], side: Side, angle: f64) -> Option<f64> {
        let is_entered = |angle: f64| self.is_entered(other, side, angle.to_radians().tan());
        is_entered(angle).then(|| {
            let (mut low, mut high) = (0.0, angle);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                if is_entered(middle) { high = middle } else { low = middle }
            }
            high
        })
    }
}

/// Returns 1 in front of a facet and -1 behind it.
fn way(side: Side) -> f64 {
    if side == Side::Before { 1.0 } else { -1.0 }
}

/// Finds the sides of facets on which every tetrahedron has a dihedral angle below `angle`
/// (degrees, between 0 and 90). Every facet must have an area, and no two may cross. The result is
/// in the order of the facets and their sides.
pub fn forced_sides(points: &[DVec3], facets: &[[u32; 3]], angle: f64) -> Vec<ForcedSide> {
    let frame = |facet: &[u32; 3]| Frame::of(facet.map(|v| points[v as usize]));
    let frames: Vec<Frame> = facets.par_iter().map(frame).collect();
    let slope = angle.to_radians().tan();
    let extent = |frame: &Frame| {
        let tips = [Side::Behind, Side::Before].map(|side| frame.tip(side, slope));
        Bounds::of(&frame.corners).merged(Bounds::of(&tips))
    };
    let boxes: Vec<Bounds> = frames.par_iter().map(extent).collect();
    let ways = |a: u32, b: u32| {
        [[a, b], [b, a]].into_iter().flat_map(|pair| [Side::Behind, Side::Before].map(|side| (pair, side)))
    };
    let entered = |([own, other], side): ([u32; 2], Side)| {
        frames[own as usize].is_entered(&frames[other as usize].corners, side, slope)
    };
    let pairs = BoxTree::new(&boxes).pairs(|a, b| ways(a, b).any(entered));
    let bound = |([facet, other], side): ([u32; 2], Side)| {
        let bound = frames[facet as usize].free_angle(&frames[other as usize].corners, side, angle)?;
        Some(ForcedSide { facet, side, bound })
    };
    let mut found: Vec<ForcedSide> = pairs.par_iter().flat_map_iter(|&[a, b]| ways(a, b).filter_map(bound)).collect();
    found.par_sort_unstable_by(|a, b| {
        (a.facet, a.side).cmp(&(b.facet, b.side)).then_with(|| a.bound.total_cmp(&b.bound))
    });
    found.dedup_by_key(|forced| (forced.facet, forced.side));
    found
}

/// Returns the largest scaled Jacobian of a tetrahedron on each facet whose dihedral angles are at
/// least `angle` (degrees, below 180; 0 allows all angles). Every facet must have an area.
///
/// At a corner with the angle a, the third edge rises at some angle e over the facet, and the
/// scaled Jacobian is at most sqrt(2) sin a sin e. The dihedral angle d at this edge is largest if
/// the edge rises over the bisector: tan(a/2) = sin e tan(d/2) in the right spherical triangle. So
/// a steep edge makes the dihedral angle small, and a flat one the scaled Jacobian.
pub fn largest_jacobians(points: &[DVec3], facets: &[[u32; 3]], angle: f64) -> Vec<f64> {
    let half = (0.5 * angle).to_radians().tan();
    let of_facet = |facet: &[u32; 3]| {
        let corners = facet.map(|v| points[v as usize]);
        let at_corner = |k: usize| {
            let (ahead, back) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            let product = ahead.length() * back.length();
            let (sine, cosine) = (ahead.cross(back).length() / product, ahead.dot(back) / product);
            // tan(a/2) = sin a / (1 + cos a)
            std::f64::consts::SQRT_2 * sine * (sine / (1.0 + cosine) / half).min(1.0)
        };
        (0..3).map(at_corner).fold(f64::INFINITY, f64::min)
    };
    facets.par_iter().map(of_facet).collect()
}

#[cfg(test)]
mod tests {
    use super::super::quality::TetrahedronQuality;
    use super::*;
    use isoparticles_field::random::uniform;

    const FACETS: [[u32; 3]; 2] = [[0, 1, 2], [1, 0, 3]];

    /// An equilateral triangle with the normal +z. Its inscribed circle has the radius 1 / sqrt(3).
    fn flat() -> [DVec3; 3] {
        [DVec3::ZERO, 2.0 * DVec3::X, DVec3::new(1.0, 3f64.sqrt(), 0.0)]
    }

    /// Returns the triangle and the apex of a neighbour across its first edge, in front of it at
    /// this angle. [`FACETS`] are counter-clockwise as seen from the wedge.
    fn with_neighbour(degrees: f64) -> Vec<DVec3> {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        [&flat()[..], &[DVec3::new(1.0, 3f64.sqrt() * cosine, 3f64.sqrt() * sine)]].concat()
    }

    fn copy_moved_by(shift: DVec3) -> Vec<DVec3> {
        flat().into_iter().chain(flat().map(|p| p + shift)).collect()
    }

    #[test]
    fn facets_that_meet_at_an_angle_allow_no_larger_one() {
        let points = with_neighbour(8.0);
        let sides = |facets: &[[u32; 3]], expected: Side| {
            let found = forced_sides(&points, facets, 12.0);
            assert_eq!(
                found.iter().map(|own| (own.facet, own.side)).collect::<Vec<_>>(),
                [(0, expected), (1, expected)]
            );
            assert!(found.iter().all(|own| (own.bound - 8.0).abs() < 1e-3));
        };
        sides(&FACETS, Side::Before);
        sides(&FACETS.map(|[a, b, c]| [a, c, b]), Side::Behind);
        assert_eq!(forced_sides(&points, &FACETS, 7.9), []);
        for degrees in [60.0, 179.0, 180.0, 181.0, 300.0] {
            assert_eq!(forced_sides(&with_neighbour(degrees), &FACETS, 12.0), [], "{degrees} degrees");
        }
    }

    #[test]
    fn opposite_facets_allow_no_more_than_the_gap_is_high() {
        let facets = [[0, 1, 2], [3, 5, 4]];
        for gap in [0.02, 0.1] {
            let found = forced_sides(&copy_moved_by(gap * DVec3::Z), &facets, 12.0);
            assert_eq!(found.iter().map(|own| own.facet).collect::<Vec<_>>(), [0, 1]);
            let expected = (gap * 3f64.sqrt()).atan().to_degrees();
            assert!(found.iter().all(|own| (own.bound - expected).abs() < 1e-3));
        }
        assert_eq!(forced_sides(&copy_moved_by(0.2 * DVec3::Z), &facets, 12.0), []);
        // a triangle beside the roof
        assert_eq!(forced_sides(&copy_moved_by(DVec3::new(1.9, 0.0, 0.05)), &facets, 12.0), []);
    }

    #[test]
    fn a_facet_at_a_common_corner_may_enter_a_roof() {
        // The facet rises from the origin by 5 degrees along the bisector, below the ridge of the
        // roof. A ridge rises by tan(X) sin(30 degrees).
        let (sine, cosine) = 30f64.to_radians().sin_cos();
        let rise = DVec3::new(cosine, sine, 5f64.to_radians().tan());
        let mut points = flat().to_vec();
        points.extend([rise, rise + DVec3::new(-0.001 * sine, 0.001 * cosine, 1.0)]);
        let found = forced_sides(&points, &[[0, 1, 2], [0, 3, 4]], 12.0);
        assert_eq!(found.iter().map(|own| own.facet).collect::<Vec<_>>(), [0]);
        let expected = (5f64.to_radians().tan() / sine).atan().to_degrees();
        assert!((found[0].bound - expected).abs() < 0.05);
    }

    #[test]
    fn no_tetrahedron_on_a_forced_side_is_better_than_its_bound() {
        let points = with_neighbour(8.0);
        let bound = forced_sides(&points, &FACETS, 12.0)[0].bound;
        let best = (0..20_000).map(|n| DVec3::from_array([0, 1, 2].map(|axis| uniform(1, axis, n))));
        let apexes = best.map(|p| p * DVec3::new(4.0, 4.0, 1.0) - DVec3::new(1.0, 1.0, 0.0));
        let below = apexes.filter(|p| p.z < 8f64.to_radians().tan() * p.y);
        let [a, b, c] = flat();
        let best = below.map(|p| TetrahedronQuality::of(&[a, b, c, p]).min_dihedral).fold(0.0, f64::max);
        assert!(0.9 * bound < best && best <= bound + 1e-3, "{best} of {bound}");
    }

    #[test]
    fn a_facet_with_a_small_angle_limits_the_scaled_jacobian() {
        let half = 1.3f64.to_radians();
        let needle = [DVec3::ZERO, DVec3::new(1.0, -half.tan(), 0.0), DVec3::new(1.0, half.tan(), 0.0)];
        let possible = largest_jacobians(&needle, &[[0, 1, 2]], 5.0)[0];
        // random apexes, and apexes on the ray on which the bound is attained
        let rise = (half.tan() / 2.5f64.to_radians().tan()).asin();
        let anywhere = (0..200_000).map(|n| {
            let [x, y, z] = [0, 1, 2].map(|axis| uniform(5, axis, n));
            DVec3::new(2.0 * x - 0.5, y - 0.5, z)
        });
        let on_ray = (0..200).map(|n| (0.1 + 0.8 * uniform(6, 0, n)) * DVec3::new(rise.cos(), 0.0, rise.sin()));
        let [a, b, c] = needle;
        let all: Vec<_> = anywhere.chain(on_ray).map(|p| TetrahedronQuality::of(&[a, b, c, p])).collect();
        let wide = all.iter().filter(|own| own.min_dihedral >= 4.999);
        assert!(wide.clone().count() > 50);
        let best = wide.map(|own| own.scaled_jacobian).fold(0.0, f64::max);
        assert!(0.95 * possible < best && best < 1.001 * possible, "{best} of {possible}");
        // without a minimum angle, the third edge may be perpendicular to the facet
        let free = largest_jacobians(&needle, &[[1, 2, 0]], 0.0)[0];
        assert!((free - 2f64.sqrt() * (2.0 * half).sin()).abs() < 1e-12);
        // on an equilateral triangle, the minimum angle has no effect
        assert!((largest_jacobians(&flat(), &[[0, 1, 2]], 5.0)[0] - 1.5f64.sqrt()).abs() < 1e-12);
    }
}
