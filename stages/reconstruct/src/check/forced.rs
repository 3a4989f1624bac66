//! Triangles that the junction curves force below the minimum radius ratio.

use crate::interfaces::{Interfaces, segment};

/// Returns whether the junction curves force the radius ratio of a triangle below a limit.
/// `meeting` is the number of materials at each vertex.
pub(super) fn is_forced(interfaces: &Interfaces, meeting: &[u8], limit: f64, triangle: u32) -> bool {
    let corners = interfaces.mesh.triangles[triangle as usize];
    let places = interfaces.mesh.corners(triangle as usize);
    let sides = [[0, 1], [1, 2], [2, 0]];
    let length = |[a, b]: [usize; 2]| places[a].distance(places[b]);
    let longest = sides.into_iter().map(length).fold(0.0, f64::max);
    let is_short_curve = |side: [usize; 2]| {
        let [a, b] = side.map(|k| corners[k]);
        let is_whole = [a, b].iter().all(|&v| meeting[v as usize] > 3);
        let is_segment = || interfaces.segments.binary_search_by_key(&segment(a, b), |(pair, _)| *pair).is_ok();
        // 2r/R of a triangle with a side of length a and two sides of length b is at most 2a/b
        is_whole && 2.0 * length(side) < limit * longest && is_segment()
    };
    corners.iter().all(|&v| meeting[v as usize] > 2) || sides.into_iter().any(is_short_curve)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_field::materials::{MaterialId, Stratum};
    use isoparticles_mesh::TriangleMesh;

    #[test]
    fn triangles_between_or_on_short_curves_are_forced() {
        let at = |x: f64| DVec3::new(x, 0.0, 0.0);
        let vertices = vec![at(0.0), at(0.1), at(0.2), DVec3::Y];
        let mesh = TriangleMesh { vertices, triangles: vec![[0, 1, 3], [1, 2, 3]] };
        let curve = Stratum::new(&[0, 1, 2].map(MaterialId)).expect("three");
        let segments = vec![([0, 1], curve), ([1, 2], curve)];
        let between = vec![[MaterialId(1), MaterialId(0)]; 2];
        let interfaces = Interfaces { mesh, between, segments, ..Interfaces::default() };
        let forced = |meeting: [u8; 4], limit: f64| [0, 1].map(|t| is_forced(&interfaces, &meeting, limit, t));
        assert_eq!(forced([3, 3, 3, 2], 0.3), [false, false], "a segment can be made longer");
        assert_eq!(forced([4, 4, 3, 2], 0.3), [true, false], "a whole curve cannot");
        assert_eq!(forced([4, 4, 4, 2], 0.15), [false, false], "0.1 is long enough for a ratio of 0.15");
        assert_eq!(forced([4, 4, 3, 3], 0.15), [true, true], "all corners on curves");
        let none = Interfaces { segments: Vec::new(), ..interfaces.clone() };
        assert!(!is_forced(&none, &[4, 4, 4, 2], 0.3, 0), "no curve joins the two points");
    }
}
