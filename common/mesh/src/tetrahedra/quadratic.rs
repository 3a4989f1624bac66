//! Quadratic tetrahedra: a node on each edge, on the interface of two materials where the edge
//! belongs to one, on the junction curve where more materials meet, and at the midpoint elsewhere.
//! The surface of one object is the interface of the materials 1 and 0.
//!
//! The Jacobian determinant of a quadratic tetrahedron is a cubic polynomial. Its minimum is at
//! least the smallest of its 20 Bezier coefficients, whose mean is six times the volume (Johnen,
//! Remacle and Geuzaine 2013, Geometrical validity of curvilinear finite elements, J. Comput. Phys.
//! 233). A node that would reduce this bound too far is moved back towards the midpoint.

use glam::DVec3;
use rayon::prelude::*;

/// The edges of a tetrahedron, in the order in which VTK, Abaqus, FEBio and XDMF list its nodes 5
/// to 10.
const EDGES: [[usize; 2]; 6] = [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]];

/// The edges of a triangle, in the order of its nodes 4 to 6.
const FACE_EDGES: [[usize; 2]; 3] = [[0, 1], [1, 2], [2, 0]];

/// Smallest allowed lower bound of the Jacobian, relative to the Jacobian of the straight
/// tetrahedron. Nodes that reduce the bound further are moved back. Gmsh optimises high-order
/// elements below this value (`Mesh.HighOrderThresholdMin`).
pub const LEAST_JACOBIAN: f64 = 0.1;

/// Maximum distance of a node from the midpoint of its edge, relative to the edge length: the
/// height of an arc that turns by 106 degrees. A surface farther away belongs to another part of
/// the object.
const LONGEST_MOVE: f64 = 0.25;

/// Number of times that the distance of a node from the midpoint is halved before it is set to 0.
/// The last value is 3 % of the height of the arc.
const HALVINGS: i32 = 5;

/// An edge or a vertex where materials meet, and these materials, ascending.
pub type Meeting = (u32, Vec<u32>);

/// Returns the corners of triangles, ascending, with the materials of their triangles. `between`
/// contains the two materials of each triangle, or none for a flat triangle, whose corners are left
/// out.
pub fn meetings(triangles: &[[u32; 3]], between: &[Option<[u32; 2]>]) -> Vec<Meeting> {
    let of_triangle = |(corners, sides): (&[u32; 3], &Option<[u32; 2]>)| {
        let sides = sides.map_or([None; 2], |pair| pair.map(Some));
        corners.map(|corner| sides.map(|side| (corner, side)))
    };
    let mut all: Vec<(u32, Option<u32>)> = triangles.iter().zip(between).flat_map(of_triangle).flatten().collect();
    all.par_sort_unstable();
    all.dedup();
    // no material precedes all materials
    let curved = all.chunk_by(|a, b| a.0 == b.0).filter(|own| own[0].1.is_some());
    curved.map(|own| (own[0].0, own.iter().filter_map(|(_, id)| *id).collect())).collect()
}

/// The nodes on the edges of a mesh, and the elements that they form.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Quadratic {
    /// The nodes, one per edge.
    pub nodes: Vec<DVec3>,
    /// Midpoint of each edge.
    pub midpoints: Vec<DVec3>,
    /// The nodes of each tetrahedron, in VTK order.
    pub of_cells: Vec<[u32; 6]>,
    /// The nodes of each triangle of the interfaces.
    pub of_triangles: Vec<[u32; 3]>,
    /// The edges whose nodes should lie on an interface or a junction curve.
    pub on_surface: Vec<Meeting>,
    /// Number of these nodes that were moved back from it.
    pub drawn_back: usize,
    /// Number of these nodes that could not be moved onto it.
    pub not_reached: usize,
    /// Smallest Bezier coefficient of the Jacobian of each element, relative to that of the
    /// straight tetrahedron; 1 if the element is straight.
    pub jacobian: Vec<f64>,
    /// Volume of each element, mm^3.
    pub volumes: Vec<f64>,
    /// Volume of each straight tetrahedron, mm^3.
    pub straight_volumes: Vec<f64>,
}

impl Quadratic {
    /// Places the nodes. `triangles` are the faces between the materials `between` ([`meetings`]);
    /// an edge of a flat triangle remains straight. `project` moves a point to where the given
    /// materials meet, by at most a given distance.
    pub fn new(
        points: &[DVec3],
        cells: &[[u32; 4]],
        triangles: &[[u32; 3]],
        between: &[Option<[u32; 2]>],
        project: impl Fn(&[u32], DVec3, f64) -> Option<DVec3> + Sync,
    ) -> Self {
        let (edges, mut new) = Self::number_edges(cells, triangles);
        let ends = |edge: &[u32; 2]| edge.map(|v| points[v as usize]);
        new.midpoints = edges.par_iter().map(|edge| ends(edge).iter().sum::<DVec3>() / 2.0).collect();
        new.on_surface = meetings(&new.of_triangles, between);
        let target = |(edge, materials): &Meeting| {
            let [a, b] = ends(&edges[*edge as usize]);
            project(materials, new.midpoints[*edge as usize], LONGEST_MOVE * a.distance(b))
        };
        let targets: Vec<Option<DVec3>> = new.on_surface.par_iter().map(target).collect();
        let mut moves = vec![DVec3::ZERO; edges.len()];
        for ((edge, _), target) in new.on_surface.iter().zip(targets) {
            match target {
                Some(target) => moves[*edge as usize] = target - new.midpoints[*edge as usize],
                None => new.not_reached += 1,
            }
        }
        new.place(points, cells, &moves);
        new
    }

    /// Returns the edges (vertices ascending), and their numbers in the tetrahedra and triangles.
    fn number_edges(cells: &[[u32; 4]], triangles: &[[u32; 3]]) -> (Vec<[u32; 2]>, Self) {
        let edge = |a: u32, b: u32| [a.min(b), a.max(b)];
        let of_cell = |cell: &[u32; 4]| EDGES.map(|[i, j]| edge(cell[i], cell[j]));
        let mut edges: Vec<[u32; 2]> = cells.par_iter().flat_map_iter(of_cell).collect();
        // a mesh that misses a triangle may lack its edges
        edges.extend(triangles.iter().flat_map(|t| FACE_EDGES.map(|[i, j]| edge(t[i], t[j]))));
        edges.par_sort_unstable();
        edges.dedup();
        let number = |edge: [u32; 2]| edges.partition_point(|other| *other < edge) as u32;
        let of_triangle = |t: &[u32; 3]| FACE_EDGES.map(|[i, j]| number(edge(t[i], t[j])));
        let numbers = Self {
            of_cells: cells.par_iter().map(|cell| of_cell(cell).map(number)).collect(),
            of_triangles: triangles.par_iter().map(of_triangle).collect(),
            ..Self::default()
        };
        (edges, numbers)
    }

    /// Moves the nodes from the midpoints, and moves them back where an element would fold.
    fn place(&mut self, points: &[DVec3], cells: &[[u32; 4]], moves: &[DVec3]) {
        let corners = |cell: usize| cells[cell].map(|v| points[v as usize]);
        let volume = |[a, b, c, d]: [DVec3; 4]| (b - a).cross(c - a).dot(d - a) / 6.0;
        self.straight_volumes = (0..cells.len()).into_par_iter().map(|cell| volume(corners(cell))).collect();
        self.volumes = self.straight_volumes.clone();
        self.jacobian = vec![1.0; cells.len()];
        let mut share: Vec<f64> = moves.iter().map(|&own| if own == DVec3::ZERO { 0.0 } else { 1.0 }).collect();
        let mut moved: Vec<bool> = share.iter().map(|&share| share > 0.0).collect();
        loop {
            let is_changed = |cell: &usize| {
                self.straight_volumes[*cell] > 0.0 && self.of_cells[*cell].iter().any(|&node| moved[node as usize])
            };
            let changed: Vec<usize> = (0..cells.len()).into_par_iter().filter(is_changed).collect();
            if changed.is_empty() {
                break;
            }
            let measure = |&cell: &usize| {
                let middles = self.of_cells[cell]
                    .map(|node| self.midpoints[node as usize] + share[node as usize] * moves[node as usize]);
                let coefficients = jacobian_coefficients(corners(cell), middles);
                let least = coefficients.into_iter().fold(f64::INFINITY, f64::min);
                (least / (6.0 * self.straight_volumes[cell]), coefficients.iter().sum::<f64>() / 120.0)
            };
            let measured: Vec<(f64, f64)> = changed.par_iter().map(measure).collect();
            moved.fill(false);
            for (&cell, (jacobian, volume)) in changed.iter().zip(measured) {
                (self.jacobian[cell], self.volumes[cell]) = (jacobian, volume);
                if jacobian < LEAST_JACOBIAN {
                    self.of_cells[cell].iter().for_each(|&node| moved[node as usize] = share[node as usize] > 0.0);
                }
            }
            for (share, _) in share.iter_mut().zip(&moved).filter(|(_, moved)| **moved) {
                *share = if *share > 0.5f64.powi(HALVINGS) { 0.5 * *share } else { 0.0 };
            }
        }
        self.drawn_back = share.iter().zip(moves).filter(|(share, own)| **share < 1.0 && **own != DVec3::ZERO).count();
        self.nodes = self.midpoints.iter().zip(share).zip(moves).map(|((&p, share), &own)| p + share * own).collect();
    }

    /// Returns the number of elements whose Jacobian may not be positive everywhere.
    pub fn folded(&self) -> usize {
        let is_folded = |(jacobian, volume): &(&f64, &f64)| **jacobian <= 0.0 || **volume <= 0.0;
        self.jacobian.iter().zip(&self.straight_volumes).filter(is_folded).count()
    }
}

/// Returns the Bezier coefficients of the Jacobian determinant of a quadratic tetrahedron in mm^3,
/// given its vertices and the nodes on its edges.
pub fn jacobian_coefficients(corners: [DVec3; 4], middles: [DVec3; 6]) -> [f64; 20] {
    // The position is the sum of c_ij l_i l_j over the barycentric coordinates l. Its derivative
    // along l_i - l_0 is 2 times the sum of (c_ik - c_0k) l_k.
    let mut control = [[DVec3::ZERO; 4]; 4];
    (0..4).for_each(|i| control[i][i] = corners[i]);
    for ([i, j], middle) in EDGES.into_iter().zip(middles) {
        control[i][j] = 2.0 * middle - 0.5 * (corners[i] + corners[j]);
        control[j][i] = control[i][j];
    }
    let column = |i: usize| std::array::from_fn::<DVec3, 4, _>(|k| 2.0 * (control[i][k] - control[0][k]));
    let [first, second, third] = [column(1), column(2), column(3)];
    let crossed = second.map(|b| third.map(|c| b.cross(c)));
    let determinant = |a: usize, b: usize, c: usize| first[a].dot(crossed[b][c]);
    let mut coefficients = [0.0; 20];
    let triples = (0..4).flat_map(|a| (a..4).flat_map(move |b| (b..4).map(move |c| [a, b, c])));
    for (coefficient, [a, b, c]) in coefficients.iter_mut().zip(triples) {
        let orders = [[a, b, c], [b, c, a], [c, a, b], [a, c, b], [c, b, a], [b, a, c]];
        *coefficient = orders.map(|[a, b, c]| determinant(a, b, c)).iter().sum::<f64>() / 6.0;
    }
    coefficients
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: [DVec3; 4] = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];

    fn midpoints(corners: [DVec3; 4]) -> [DVec3; 6] {
        EDGES.map(|[i, j]| 0.5 * (corners[i] + corners[j]))
    }

    #[test]
    fn the_jacobian_of_a_straight_element_is_constant() {
        let coefficients = jacobian_coefficients(UNIT, midpoints(UNIT));
        assert!(coefficients.iter().all(|value| (value - 1.0).abs() < 1e-14));
    }

    #[test]
    fn one_moved_node_gives_a_linear_jacobian() {
        // x = u + 4 d u v with the node of the edge from 1 to 2 moved by (d, 0, 0): the Jacobian is
        // 1 + 4 d v, so the coefficients lie between its values 1 and 1 + 4 d at the vertices
        let mut middles = midpoints(UNIT);
        middles[1].x += 0.1;
        let coefficients = jacobian_coefficients(UNIT, middles);
        let [least, largest] =
            [coefficients.into_iter().fold(9.0, f64::min), coefficients.into_iter().fold(0.0, f64::max)];
        assert!((least - 1.0).abs() < 1e-14 && (largest - 1.4).abs() < 1e-14);
        // the integral of v over the unit tetrahedron is 1 / 24
        assert!((coefficients.iter().sum::<f64>() / 120.0 - (1.0 / 6.0 + 0.4 / 24.0)).abs() < 1e-14);
    }

    /// Returns the tetrahedron whose base lies in a sphere of radius 1 around the origin, with the
    /// apex at a height inside.
    fn on_sphere(height: f64) -> Quadratic {
        let base = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| (axis + DVec3::splat(0.3)).normalize());
        let points = [base[0], base[2], base[1], base.iter().sum::<DVec3>() / 3.0 - DVec3::splat(height)];
        let project = |_: &[u32], p: DVec3, _| Some(p.normalize());
        Quadratic::new(&points, &[[0, 1, 2, 3]], &[[0, 2, 1]], &[Some([1, 0])], project)
    }

    #[test]
    fn nodes_lie_on_the_sphere_unless_they_fold_the_element() {
        let high = on_sphere(0.5);
        assert_eq!((high.on_surface.len(), high.drawn_back, high.not_reached, high.folded()), (3, 0, 0, 0));
        assert!(high.on_surface.iter().all(|(node, _)| (high.nodes[*node as usize].length() - 1.0).abs() < 1e-14));
        assert!(high.volumes[0] > high.straight_volumes[0]);
    }

    #[test]
    fn nodes_that_bulge_into_an_element_are_moved_back() {
        // the apex lies outside the sphere, so the curved base bulges into the element
        let points = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| (axis + DVec3::splat(0.3)).normalize());
        let apex = points.iter().sum::<DVec3>() / 3.0 + DVec3::splat(0.02);
        let points = [points[0], points[1], points[2], apex];
        let of = |between, project: fn(&[u32], DVec3, f64) -> Option<DVec3>| {
            Quadratic::new(&points, &[[0, 1, 2, 3]], &[[0, 2, 1]], &[between], project)
        };
        let found = of(Some([1, 0]), |_, p, _| Some(p.normalize()));
        assert_eq!((found.drawn_back, found.folded()), (3, 0));
        assert!(found.jacobian[0] >= LEAST_JACOBIAN && found.jacobian[0] < 1.0);
        let straight = of(None, |_, p, _| Some(p.normalize()));
        assert_eq!((straight.on_surface.len(), straight.jacobian[0]), (0, 1.0));
        let far = of(Some([1, 0]), |_, _, _| None);
        assert_eq!((far.not_reached, far.drawn_back, far.nodes == far.midpoints), (3, 0, true));
    }

    #[test]
    fn meetings_list_the_materials_except_at_flat_triangles() {
        // three materials meet at 0 and 1; the flat triangle has the corners 3, 4 and 5
        let triangles = [[0, 1, 2], [0, 1, 3], [1, 0, 6], [3, 4, 5]];
        let found = meetings(&triangles, &[Some([2, 1]), Some([1, 0]), Some([2, 0]), None]);
        assert_eq!(found, [(0, vec![0, 1, 2]), (1, vec![0, 1, 2]), (2, vec![1, 2]), (6, vec![0, 2])]);
    }
}
