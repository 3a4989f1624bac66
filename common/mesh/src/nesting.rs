//! Finds which closed surfaces enclose a point: a ray from the point leaves an enclosing surface
//! more often than it enters it. The signs come from exact predicates. The ray is parallel to x and
//! shifted symbolically, as in [`crate::inside`], so it hits no edges or vertices.

use crate::TriangleMesh;
use crate::inside::moved_turn;
use crate::intersect::orientation;
use crate::measure::{Measure, measure_components};
use glam::DVec3;
use rayon::prelude::*;
use robust::Coord;

/// The components of a closed surface. A component that lies in an even number of others bounds a
/// body from outside, and its volume is positive. The other components bound cavities.
#[derive(Clone, Debug, PartialEq)]
pub struct Nesting {
    /// Area and signed volume of each component.
    pub measures: Vec<Measure>,
    /// Number of other components that enclose each component.
    pub depths: Vec<usize>,
    /// The smallest component that encloses each component.
    pub parents: Vec<Option<u32>>,
}

/// Measures the components of a closed surface, and finds their nesting. Components must not
/// intersect each other. `component_of_triangle` contains numbers below `count`, each at least
/// once.
pub fn nest(mesh: &TriangleMesh, component_of_triangle: &[u32], count: usize) -> Nesting {
    let measures = measure_components(mesh, component_of_triangle, count);
    let mut starts: Vec<Option<DVec3>> = vec![None; count];
    for (corners, &component) in mesh.triangles.iter().zip(component_of_triangle) {
        starts[component as usize].get_or_insert(mesh.vertices[corners[0] as usize]);
    }
    let mut nesting = Nesting { measures, depths: vec![0; count], parents: vec![None; count] };
    if count > 1 {
        let starts: Vec<DVec3> = starts.into_iter().flatten().collect();
        let around = enclosing(mesh, component_of_triangle, &starts);
        let volume = |component: u32| nesting.measures[component as usize].volume.abs();
        for (own, around) in around.into_iter().enumerate() {
            let others: Vec<u32> = around.into_iter().filter(|&other| other as usize != own).collect();
            nesting.depths[own] = others.len();
            nesting.parents[own] = others.into_iter().min_by(|&a, &b| volume(a).total_cmp(&volume(b)));
        }
    }
    nesting
}

/// Returns the closed surfaces that enclose each point, ascending. `surface_of_triangle` contains
/// the number of the surface to which each triangle belongs. For a point on a surface, it is
/// unspecified whether the result contains this surface.
pub fn enclosing(mesh: &TriangleMesh, surface_of_triangle: &[u32], starts: &[DVec3]) -> Vec<Vec<u32>> {
    let mut by_y: Vec<usize> = (0..starts.len()).collect();
    by_y.sort_by(|&a, &b| starts[a].y.total_cmp(&starts[b].y));
    let hits_of = |(t, &surface): (usize, &u32)| {
        let corners = mesh.corners(t);
        let low = corners[0].min(corners[1]).min(corners[2]);
        let high = corners[0].max(corners[1]).max(corners[2]);
        let first = by_y.partition_point(|&n| starts[n].y < low.y);
        let near = by_y[first..].iter().take_while(move |&&n| starts[n].y <= high.y);
        near.filter_map(move |&n| {
            let p = starts[n];
            let is_near = low.z <= p.z && p.z <= high.z && p.x <= high.x;
            let side = if is_near { ray_side(corners, p) } else { 0 };
            (side != 0).then_some((n, surface, i32::from(side)))
        })
    };
    let mut hits: Vec<(usize, u32, i32)> = surface_of_triangle.par_iter().enumerate().flat_map_iter(hits_of).collect();
    hits.par_sort_unstable();
    let mut around = vec![Vec::new(); starts.len()];
    for own in hits.chunk_by(|a, b| a.0 == b.0 && a.1 == b.1) {
        if own.iter().map(|hit| hit.2).sum::<i32>() != 0 {
            around[own[0].0].push(own[0].1);
        }
    }
    around
}

/// Returns 1 if the ray from p along x leaves through a triangle (along its normal), -1 if it
/// enters, and 0 if it misses the triangle.
fn ray_side(corners: [DVec3; 3], p: DVec3) -> i8 {
    let [a, b, c] = corners.map(|corner| Coord { x: corner.y, y: corner.z });
    let at = Coord { x: p.y, y: p.z };
    let side = moved_turn(a, b, at);
    let misses = side == 0 || side != moved_turn(b, c, at) || side != moved_turn(c, a, at);
    let is_ahead = || orientation(corners[0], corners[1], corners[2], p) * side < 0;
    if !misses && is_ahead() { side } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::super::{shapes, topology};
    use super::*;

    /// Returns concentric spheres of alternating orientation and one sphere beside them.
    fn nested() -> TriangleMesh {
        let mut beside = shapes::icosphere(0.5, 2);
        beside.vertices.iter_mut().for_each(|p| p.x += 6.0);
        let mut parts = vec![beside];
        for (n, radius) in [4.0, 3.0, 2.0].into_iter().enumerate() {
            let mut sphere = shapes::icosphere(radius, 2);
            sphere.triangles.iter_mut().filter(|_| n == 1).for_each(|t| t.swap(1, 2));
            parts.push(sphere);
        }
        shapes::union(&parts)
    }

    #[test]
    fn nested_spheres_lie_in_each_other() {
        let mesh = nested();
        let found = topology::analyse(&mesh);
        let nesting = nest(&mesh, &found.component_of_triangle, found.components.len());
        assert_eq!(nesting.depths, [0, 0, 1, 2]);
        assert_eq!(nesting.parents, [None, None, Some(1), Some(2)]);
        let signs: Vec<bool> = nesting.measures.iter().map(|measure| measure.volume > 0.0).collect();
        assert_eq!(signs, [true, true, false, true]);
    }

    #[test]
    fn points_are_found_in_the_spheres_around_them() {
        let mesh = nested();
        let component = topology::analyse(&mesh).component_of_triangle;
        let starts = [DVec3::ZERO, DVec3::X * 2.5, DVec3::Y * 3.5, DVec3::X * 6.0, DVec3::X * 5.0, -DVec3::X * 9.0];
        let expected: [&[u32]; 6] = [&[1, 2, 3], &[1, 2], &[1], &[0], &[], &[]];
        assert_eq!(enclosing(&mesh, &component, &starts), expected);
    }
}
