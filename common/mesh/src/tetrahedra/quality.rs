//! Quality of tetrahedra, as defined by the Verdict library (Stimpson et al., SAND2007-1751). The
//! radius ratio is the reciprocal of Verdict's, so it lies in [0, 1] like that of a triangle.

use super::FACES;
use glam::DVec3;
use rayon::prelude::*;

/// Minimum number of tetrahedra per task: at 0.1 us each, a task takes 0.1 ms.
const TASK_CELLS: usize = 1 << 10;

/// Positions of the ends of the six edges. The edges `k` and `5 - k` are opposite.
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// For each vertex, the three edges that meet there.
const CORNERS: [[usize; 3]; 4] = [[0, 1, 2], [0, 3, 4], [1, 3, 5], [2, 4, 5]];

/// Quality of one tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TetrahedronQuality {
    /// Signed volume in mm^3, positive in VTK's vertex order.
    pub volume: f64,
    /// Three times the inradius over the circumradius, in [0, 1]. 0 if flat.
    pub radius_ratio: f64,
    /// sqrt(2) times the Jacobian over the largest product of the three edges at a vertex, in
    /// [-1, 1]. Negative if inverted, 0 if flat, 1 if regular.
    pub scaled_jacobian: f64,
    /// Minimum dihedral angle in degrees.
    pub min_dihedral: f64,
    /// Maximum dihedral angle in degrees.
    pub max_dihedral: f64,
    /// Longest edge over 2 sqrt(6) inradii, at least 1. Infinite if flat.
    pub aspect_ratio: f64,
    /// Longest over shortest edge, at least 1.
    pub edge_ratio: f64,
    /// Mean edge length in mm.
    pub edge_length: f64,
}

/// Lengths, areas and angles from which the measures are computed.
pub(super) struct Sizes {
    /// Six times the signed volume.
    pub(super) six_volumes: f64,
    /// Lengths of the edges, in the order of [`EDGES`].
    edges: [f64; 6],
    /// Twice the areas of the faces, in the order of [`FACES`].
    doubled_areas: [f64; 4],
    /// Minimum and maximum cosine of the dihedral angles. An angle at a face without area is 0.
    pub(super) cosines: [f64; 2],
}

impl Sizes {
    #[inline]
    pub(super) fn of(corners: &[DVec3; 4]) -> Self {
        let sides = EDGES.map(|[i, j]| corners[j] - corners[i]);
        // area vectors that point out of a positive tetrahedron
        let normals = FACES.map(|[i, j, k]| (corners[j] - corners[i]).cross(corners[k] - corners[i]));
        let doubled_areas = normals.map(DVec3::length);
        let mut cosines = [f64::INFINITY, f64::NEG_INFINITY];
        for i in 1..4 {
            for j in 0..i {
                let cosine = ratio(-normals[i].dot(normals[j]), doubled_areas[i] * doubled_areas[j], 1.0);
                cosines = [cosines[0].min(cosine), cosines[1].max(cosine)];
            }
        }
        Self { six_volumes: -normals[0].dot(sides[2]), edges: sides.map(DVec3::length), doubled_areas, cosines }
    }

    /// Returns the scaled Jacobian.
    #[inline]
    pub(super) fn scaled_jacobian(&self) -> f64 {
        let products = CORNERS.map(|at| at.into_iter().map(|edge| self.edges[edge]).product());
        ratio(std::f64::consts::SQRT_2 * self.six_volumes, products.into_iter().fold(0.0, f64::max), 0.0)
    }
}

impl TetrahedronQuality {
    /// Measures the tetrahedron with these vertices.
    pub fn of(corners: &[DVec3; 4]) -> Self {
        let sizes = Sizes::of(corners);
        let edges = sizes.edges;
        let volume = sizes.six_volumes / 6.0;
        let surface = 0.5 * sizes.doubled_areas.iter().sum::<f64>();
        let inradius = ratio(3.0 * volume.abs(), surface, 0.0);
        // With the products p, q, r of opposite edges, the circumradius R satisfies
        // (24 V R)^2 = (p + q + r) (p + q - r) (p - q + r) (q + r - p).
        let [p, q, r] = [0, 1, 2].map(|k| edges[k] * edges[5 - k]);
        let heron = ((p + q + r) * (p + q - r) * (p - q + r) * (q + r - p)).max(0.0);
        let (shortest, longest) =
            edges.iter().fold((f64::INFINITY, 0.0), |(low, high), &edge| (edge.min(low), edge.max(high)));
        Self {
            volume,
            radius_ratio: ratio(72.0 * volume.abs() * inradius, heron.sqrt(), 0.0).clamp(0.0, 1.0),
            scaled_jacobian: sizes.scaled_jacobian(),
            min_dihedral: degrees(sizes.cosines[1]),
            max_dihedral: degrees(sizes.cosines[0]),
            aspect_ratio: ratio(longest, 2.0 * 6f64.sqrt() * inradius, f64::INFINITY),
            edge_ratio: ratio(longest, shortest, f64::INFINITY),
            edge_length: edges.iter().sum::<f64>() / 6.0,
        }
    }
}

/// Measures all tetrahedra, in order.
pub fn qualities(points: &[DVec3], cells: &[[u32; 4]]) -> Vec<TetrahedronQuality> {
    let of_cell = |cell: &[u32; 4]| TetrahedronQuality::of(&cell.map(|v| points[v as usize]));
    cells.par_iter().with_min_len(TASK_CELLS).map(of_cell).collect()
}

/// Divides, or returns `degenerate` if the denominator is not positive.
#[inline]
fn ratio(numerator: f64, denominator: f64, degenerate: f64) -> f64 {
    if denominator > 0.0 { numerator / denominator } else { degenerate }
}

/// Returns the angle with this cosine, in degrees.
#[inline]
pub(super) fn degrees(cosine: f64) -> f64 {
    cosine.clamp(-1.0, 1.0).acos().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: f64, expected: f64) -> bool {
        (found - expected).abs() < 1e-12 * expected.abs().max(1.0)
    }

    #[test]
    fn regular_tetrahedron() {
        let corners = [[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]];
        let corners = corners.map(DVec3::from_array);
        let found = TetrahedronQuality::of(&corners);
        assert!(close(found.volume, 8.0 / 3.0), "{found:?}");
        for value in [found.radius_ratio, found.scaled_jacobian, found.aspect_ratio, found.edge_ratio] {
            assert!(close(value, 1.0), "{found:?}");
        }
        let angle = (1.0f64 / 3.0).acos().to_degrees();
        assert!(close(found.min_dihedral, angle) && close(found.max_dihedral, angle));
        assert!(close(found.edge_length, 8f64.sqrt()));
        let [a, b, c, d] = corners;
        let inverted = TetrahedronQuality::of(&[b, a, c, d]);
        assert!(close(inverted.volume, -8.0 / 3.0) && close(inverted.scaled_jacobian, -1.0));
    }

    #[test]
    fn corner_of_a_cube() {
        let found = TetrahedronQuality::of(&[DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
        assert!(close(found.volume, 1.0 / 6.0));
        // sqrt(2) over the largest product of edges at a vertex, 2
        assert!(close(found.scaled_jacobian, 0.5f64.sqrt()));
        assert!(close(found.min_dihedral, 3f64.sqrt().recip().acos().to_degrees()));
        assert!(close(found.max_dihedral, 90.0));
        // inradius 1 / (3 + sqrt 3), circumradius sqrt(3) / 2
        let inradius = (3.0 + 3f64.sqrt()).recip();
        assert!(close(found.radius_ratio, 3.0 * inradius / (0.5 * 3f64.sqrt())));
        assert!(close(found.aspect_ratio, 2f64.sqrt() / (2.0 * 6f64.sqrt() * inradius)));
        assert!(close(found.edge_ratio, 2f64.sqrt()));
    }

    #[test]
    fn degenerate_tetrahedra_have_the_worst_values() {
        let flat = TetrahedronQuality::of(&[DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X + DVec3::Y]);
        assert_eq!((flat.volume, flat.radius_ratio, flat.scaled_jacobian), (0.0, 0.0, 0.0));
        assert_eq!((flat.min_dihedral, flat.max_dihedral, flat.aspect_ratio), (0.0, 180.0, f64::INFINITY));
        let point = TetrahedronQuality::of(&[DVec3::ONE; 4]);
        assert_eq!((point.min_dihedral, point.edge_ratio, point.edge_length), (0.0, f64::INFINITY, 0.0));
        let cells = vec![[0, 1, 2, 3]; 3 * TASK_CELLS];
        let points = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let all = qualities(&points, &cells);
        assert_eq!(all, vec![TetrahedronQuality::of(&points); cells.len()]);
    }
}
