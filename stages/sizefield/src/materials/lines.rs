//! Bounds h by the curvature and length of junction curves.

use glam::DVec3;
use isoparticles_field::materials::complex::{Complex, End};

/// Half the length in voxels of the piece of a curve over which curvature is measured. Vertices of
/// a chain are at most one voxel apart.
const REACH: f64 = 1.5;

/// Minimum number of steps on a curve between two junction points, and on a closed curve.
const STEPS: [f64; 2] = [2.0, 6.0];

/// Returns the edge length for a radius of curvature (mm), from the same two criteria as on
/// interfaces: `epsilon` times the radius, and the height of a chord above the curve, h^2 / (8 R).
fn by_radius(radius: f64, epsilon: f64, max_deviation: f64) -> f64 {
    (epsilon * radius).min((8.0 * max_deviation * radius).sqrt())
}

/// Lowers the sizes (mm) of the vertices of junction curves to the bounds from curvature and
/// length.
pub(super) fn lower(complex: &Complex, voxel: f64, epsilon: f64, max_deviation: f64, sizes: &mut [f64]) {
    for chain in &complex.chains {
        let line = complex.line(chain);
        let length = complex.length(chain);
        let by_length = match chain.ends {
            [End::Point(_), End::Point(_)] => length / STEPS[0],
            [End::Closed, _] => length / STEPS[1],
            _ => f64::INFINITY,
        };
        let skipped = usize::from(matches!(chain.ends[0], End::Point(_)));
        for (n, &v) in chain.vertices.iter().enumerate() {
            let radius = radius(&line, n + skipped, chain.is_closed(), REACH * voxel);
            let own = &mut sizes[v as usize];
            *own = own.min(by_length).min(by_radius(radius, epsilon, max_deviation));
        }
    }
}

/// Returns the radius in mm of the circle through a vertex of a line and the vertices at least
/// `reach` before and behind it. The radius is infinite if the line ends earlier.
fn radius(line: &[DVec3], at: usize, is_closed: bool, reach: f64) -> f64 {
    let count = line.len();
    let beyond = |forth: bool| {
        let place = |step: usize| match (is_closed, forth) {
            (true, true) => Some((at + step) % count),
            (true, false) => Some((at + count - step % count) % count),
            (false, true) => Some(at + step).filter(|&n| n < count),
            (false, false) => at.checked_sub(step),
        };
        (1..count).map_while(place).map(|n| line[n]).find(|p| p.distance(line[at]) >= reach)
    };
    let (Some(a), Some(b)) = (beyond(false), beyond(true)) else { return f64::INFINITY };
    let (u, v, w) = (line[at] - a, b - line[at], b - a);
    let doubled = u.cross(v).length();
    if doubled > 0.0 { u.length() * v.length() * w.length() / (2.0 * doubled) } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    use glam::DVec2;
}
