//! Limits h according to the curvature and length of junction curves.

use glam::DVec3;
use isoparticles_field::materials::complex::{Complex, End};

/// Minimum distance in voxels from a vertex to the two other vertices that define its circle of
/// curvature. All radii of at least half this distance can be measured. With the defaults of every
/// quality level, radii below 1.5 voxels do not change h, because `minimum h / epsilon` is at least
/// 1.5 voxels.
const CHORD: f64 = 1.5;

/// Minimum number of edges of a curve between two junction points. With a single edge, two curves
/// between the same points would coincide.
const OPEN_STEPS: f64 = 2.0;

/// Minimum number of edges of a closed curve: the boundary of the smallest disc in a hexagonal
/// lattice, six equilateral triangles around a vertex.
const CLOSED_STEPS: f64 = 6.0;

/// Returns the maximum edge length (mm) at a radius of curvature (mm). As on interfaces, an edge is
/// at most `epsilon` times the radius and deviates from the curve by at most `max_deviation`. A
/// chord of length h deviates by `h^2 / (8 * radius)`.
fn by_radius(radius: f64, epsilon: f64, max_deviation: f64) -> f64 {
    (epsilon * radius).min((8.0 * max_deviation * radius).sqrt())
}

/// Lowers the sizes (mm) at the vertices of junction curves to the bounds given by the curvature
/// and length of the curves.
pub(super) fn lower(complex: &Complex, voxel: f64, epsilon: f64, max_deviation: f64, sizes: &mut [f64]) {
    for chain in &complex.chains {
        let line = complex.line(chain);
        let length = complex.length(chain);
        let by_length = match chain.ends {
            [End::Point(_), End::Point(_)] => length / OPEN_STEPS,
            [End::Closed, _] => length / CLOSED_STEPS,
            _ => f64::INFINITY,
        };
        let skipped = usize::from(matches!(chain.ends[0], End::Point(_)));
        for (n, &v) in chain.vertices.iter().enumerate() {
            let radius = radius(&line, n + skipped, chain.is_closed(), CHORD * voxel);
            let own = &mut sizes[v as usize];
            *own = own.min(by_length).min(by_radius(radius, epsilon, max_deviation));
        }
    }
}

/// Returns the radius in mm of the circle through a vertex of a line and the first vertex in each
/// direction that is at least `chord` away. The radius is infinite if the line ends earlier.
fn radius(line: &[DVec3], at: usize, is_closed: bool, chord: f64) -> f64 {
    let count = line.len();
    let beyond = |forth: bool| {
        let place = |step: usize| match (is_closed, forth) {
            (true, true) => Some((at + step) % count),
            (true, false) => Some((at + count - step % count) % count),
            (false, true) => Some(at + step).filter(|&n| n < count),
            (false, false) => at.checked_sub(step),
        };
        (1..count).map_while(place).map(|n| line[n]).find(|p| p.distance(line[at]) >= chord)
    };
    let (Some(a), Some(b)) = (beyond(false), beyond(true)) else { return f64::INFINITY };
    let (u, v, w) = (line[at] - a, b - line[at], b - a);
    let doubled = u.cross(v).length();
    if doubled > 0.0 { u.length() * v.length() * w.length() / (2.0 * doubled) } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    #[test]
    fn a_circle_has_its_radius_everywhere_and_a_straight_line_none() {
        let ring: Vec<DVec3> =
            (0..40).map(|n| 7.0 * DVec2::from_angle(f64::from(n) * std::f64::consts::TAU / 40.0).extend(0.0)).collect();
        for n in 0..40 {
            assert!((radius(&ring, n, true, 1.5) - 7.0).abs() < 1e-9);
        }
        assert!(radius(&ring, 0, false, 1.5).is_infinite());
        let straight: Vec<DVec3> = (0..9).map(|n| DVec3::X * f64::from(n)).collect();
        assert!(radius(&straight, 4, false, 1.5).is_infinite());
    }
}
