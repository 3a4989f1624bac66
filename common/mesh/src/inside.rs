//! Finds the grid nodes inside a closed mesh, and the nodes where the mesh and F disagree.
//!
//! The method counts crossings along the grid lines parallel to x. Where a line crosses a triangle,
//! all nodes beyond the crossing change sides. The grid line at `(y, z)` is shifted symbolically to
//! `(y + e, z + e^2)`, where e is infinitesimal, so a crossing at a shared vertex or edge counts
//! only once. All signs come from exact predicates. For each triangle, only the grid lines near its
//! yz projection are tested.

use super::TriangleMesh;
use super::intersect::{orientation, turn};
use glam::DVec3;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;
use robust::Coord;

/// Returns the linear indices of the grid nodes at which a closed mesh (in the grid frame) and the
/// sign of F (negative inside) disagree, in ascending order. Nodes with F = 0 are never included.
pub fn nodes_on_wrong_side(mesh: &TriangleMesh, image: &Image<f32>) -> Vec<usize> {
    let geometry = &image.geometry;
    let nx = geometry.size[0];
    if image.data.is_empty() {
        return Vec::new();
    }
    let crossings = sorted_crossings(mesh, geometry);
    image
        .data
        .par_chunks(nx)
        .enumerate()
        .flat_map_iter(|(row, samples)| {
            let mut toggles = toggles_of_row(&crossings, row).iter().peekable();
            let mut inside = false;
            let mut wrong = Vec::new();
            for (i, &sample) in samples.iter().enumerate() {
                while toggles.next_if(|toggle| toggle.first <= i).is_some() {
                    inside = !inside;
                }
                if (inside && sample > 0.0) || (!inside && sample < 0.0) {
                    wrong.push(row * nx + i);
                }
            }
            wrong
        })
        .collect()
}

/// Returns the number of grid nodes inside a closed mesh (in the grid frame).
pub fn count_nodes_inside(mesh: &TriangleMesh, geometry: &Geometry) -> usize {
    let nx = geometry.size[0];
    let crossings = sorted_crossings(mesh, geometry);
    let rows = geometry.size[1] * geometry.size[2];
    (0..rows)
        .into_par_iter()
        .map(|row| {
            let firsts = toggles_of_row(&crossings, row).iter().map(|toggle| toggle.first.min(nx));
            firsts.enumerate().map(|(n, first)| if n % 2 == 0 { -(first as i64) } else { first as i64 }).sum::<i64>()
                as usize
        })
        .sum()
}

/// A crossing of a triangle and a grid line. In the row of the line, all nodes with index `first`
/// or above change sides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Crossing {
    /// Row number, `k * ny + j`.
    pub row: usize,
    /// Index i of the first node beyond the crossing, or the number of nodes in the row if there is
    /// no such node.
    pub first: usize,
}

/// Calls `found` with every crossing of a triangle (in the grid frame) and a grid line parallel to
/// x.
pub fn crossings(corners: [DVec3; 3], geometry: &Geometry, mut found: impl FnMut(Crossing)) {
    let spacing = geometry.spacing;
    let low = corners[0].min(corners[1]).min(corners[2]);
    let high = corners[0].max(corners[1]).max(corners[2]);
    // the range of lines is slightly too wide; the exact signs below decide
    let range = |axis: usize| {
        let from = (low[axis] / spacing[axis] - 1e-6).ceil().max(0.0);
        let to = (high[axis] / spacing[axis] + 1e-6).floor().min(geometry.size[axis] as f64 - 1.0);
        if from <= to { from as usize..to as usize + 1 } else { 0..0 }
    };
    let shadow = corners.map(|p| Coord { x: p.y, y: p.z });
    for k in range(2) {
        for j in range(1) {
            let at = Coord { x: j as f64 * spacing.y, y: k as f64 * spacing.z };
            let side = moved_turn(shadow[0], shadow[1], at);
            if side == 0 || side != moved_turn(shadow[1], shadow[2], at) || side != moved_turn(shadow[2], shadow[0], at)
            {
                continue;
            }
            let first = first_beyond(corners, side, at, geometry);
            found(Crossing { row: k * geometry.size[1] + j, first });
        }
    }
}

/// Returns the side of a point relative to the line through a and b, after the symbolic shift. The
/// result is 0 only if a = b.
pub(crate) fn moved_turn(a: Coord<f64>, b: Coord<f64>, p: Coord<f64>) -> i8 {
    let difference = |x: f64, y: f64| i8::from(x > y) - i8::from(x < y);
    match turn(a, b, p) {
        0 => match difference(a.y, b.y) {
            0 => difference(b.x, a.x),
            side => side,
        },
        side => side,
    }
}

/// Returns the index of the first node beyond the plane of a triangle, in the row whose (y, z)
/// position is `at`. The row must cross the triangle.
fn first_beyond(corners: [DVec3; 3], side: i8, at: Coord<f64>, geometry: &Geometry) -> usize {
    let spacing = geometry.spacing.x;
    let count = geometry.size[0];
    let [a, b, c] = corners;
    let beyond = |i: usize| orientation(a, b, c, DVec3::new(i as f64 * spacing, at.x, at.y)) * side > 0;
    // a floating-point estimate, corrected below with the exact sign
    let normal = (b - a).cross(c - a);
    let x = a.x - (normal.y * (at.x - a.y) + normal.z * (at.y - a.z)) / normal.x;
    let low = a.x.min(b.x).min(c.x);
    let x = if x.is_finite() { x.clamp(low, a.x.max(b.x).max(c.x)) } else { low };
    let mut first = (x / spacing).ceil().clamp(0.0, count as f64) as usize;
    while first > 0 && beyond(first - 1) {
        first -= 1;
    }
    while first < count && !beyond(first) {
        first += 1;
    }
    first
}

fn sorted_crossings(mesh: &TriangleMesh, geometry: &Geometry) -> Vec<Crossing> {
    let mut all: Vec<Crossing> = (0..mesh.triangles.len())
        .into_par_iter()
        .flat_map_iter(|t| {
            let mut own = Vec::new();
            crossings(mesh.corners(t), geometry, |crossing| own.push(crossing));
            own
        })
        .collect();
    all.par_sort_unstable();
    all
}

fn toggles_of_row(crossings: &[Crossing], row: usize) -> &[Crossing] {
    let from = crossings.partition_point(|c| c.row < row);
    &crossings[from..from + crossings[from..].partition_point(|c| c.row == row)]
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use super::*;
    use std::f64::consts::PI;

    /// Returns the sum of the solid angles of all triangles divided by 4 pi (van Oosterom and
    /// Strackee 1983).
    fn winding_number(mesh: &TriangleMesh, p: DVec3) -> f64 {
        let mut sum = 0.0;
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t).map(|q| q - p);
            let (la, lb, lc) = (a.length(), b.length(), c.length());
            let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
            sum += 2.0 * a.dot(b.cross(c)).atan2(below);
        }
        sum / (4.0 * PI)
    }

    fn image(size: [usize; 3], spacing: DVec3, f: impl Fn(DVec3) -> f64) -> Image<f32> {
        let geometry = Geometry::axis_aligned(size, spacing);
        let mut image = Image::filled(geometry, 0.0f32);
        for k in 0..size[2] {
            for j in 0..size[1] {
                for i in 0..size[0] {
                    let p = DVec3::new(i as f64, j as f64, k as f64) * spacing;
                    let at = image.geometry.linear(i, j, k);
                    image.data[at] = f(p) as f32;
                }
            }
        }
        image
    }

    fn moved(mut mesh: TriangleMesh, by: DVec3) -> TriangleMesh {
        for p in &mut mesh.vertices {
            *p += by;
        }
        mesh
    }

    #[test]
    fn agrees_with_the_winding_number() {
        let parts = [
            moved(shapes::icosphere(3.0, 2), DVec3::new(5.02, 5.0, 5.0)),
            moved(shapes::icosphere(1.3, 1), DVec3::new(5.0, 5.3, 5.0)),
            moved(shapes::torus(3.0, 0.8, 20, 9), DVec3::new(6.0, 5.0, 11.0)),
        ];
        let mut mesh = shapes::union(&parts);
        let hollow = parts[0].triangles.len()..parts[0].triangles.len() + parts[1].triangles.len();
        for t in &mut mesh.triangles[hollow] {
            t.swap(0, 1);
        }
        let size = [23, 17, 19];
        let spacing = DVec3::new(0.5, 0.7, 0.8);
        let truth = image(size, spacing, |p| if winding_number(&mesh, p) > 0.5 { -1.0 } else { 1.0 });
        assert!(nodes_on_wrong_side(&mesh, &truth).is_empty());
        let inside = truth.data.iter().filter(|&&x| x < 0.0).count();
        assert_eq!(count_nodes_inside(&mesh, &truth.geometry), inside);
        assert!(inside > 200);
        // if F is positive everywhere, all nodes inside the mesh are on the wrong side
        let outside = Image::filled(truth.geometry.clone(), 1.0f32);
        assert_eq!(nodes_on_wrong_side(&mesh, &outside).len(), inside);
    }

    #[test]
    fn names_the_one_node_that_is_wrong() {
        let mesh = moved(shapes::icosphere(3.25, 3), DVec3::splat(5.0));
        let mut field = image([11; 3], DVec3::ONE, |p| p.distance(DVec3::splat(5.0)) - 3.24);
        assert!(nodes_on_wrong_side(&mesh, &field).is_empty());
        let at = field.geometry.linear(7, 5, 4);
        field.data[at] = 0.5;
        assert_eq!(nodes_on_wrong_side(&mesh, &field), [at]);
        field.data[at] = 0.0;
        assert!(nodes_on_wrong_side(&mesh, &field).is_empty());
    }

    #[test]
    fn lines_through_vertices_edges_and_faces_count_once() {
        // all corners lie on grid nodes, so some grid lines run along edges and within faces of the
        // box
        let mesh = moved(shapes::cuboid(DVec3::new(4.0, 3.0, 2.0)), DVec3::ONE);
        let field = image([8; 3], DVec3::ONE, |p| {
            let d = (p - DVec3::new(3.0, 2.5, 2.0)).abs() - DVec3::new(2.0, 1.5, 1.0);
            d.max_element()
        });
        assert!(nodes_on_wrong_side(&mesh, &field).is_empty());
        // an octahedron whose corners lie on grid nodes
        let sphere = TriangleMesh {
            vertices: [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z].map(|p| p * 3.0 + 4.0).to_vec(),
            triangles: vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]],
        };
        let field = image([9; 3], DVec3::ONE, |p| (p - DVec3::splat(4.0)).abs().element_sum() - 3.0);
        assert!(nodes_on_wrong_side(&sphere, &field).is_empty());
    }

    #[test]
    fn a_mesh_reaching_out_of_the_grid_is_followed_inside_it() {
        let mesh = moved(shapes::icosphere(4.0, 3), DVec3::new(-1.0, 2.0, 5.0));
        let field = image([6; 3], DVec3::ONE, |p| winding_number(&mesh, p) * -2.0 + 1.0);
        assert!(nodes_on_wrong_side(&mesh, &field).is_empty());
    }
}
