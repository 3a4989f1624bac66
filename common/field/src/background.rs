//! The size field in the forms that tetrahedralizers read: on a grid along the world axes, and on
//! tetrahedra that cover an object.

use crate::sizing::SizingField;
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::inside::nodes_on_wrong_side;
use isoparticles_mesh::measure::measure;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;

/// A cube divided into five tetrahedra in the two possible ways, by corners 4 z + 2 y + x.
/// Neighbouring cubes alternate, so their faces match.
const FIVE_TETRAHEDRA: [[[usize; 4]; 5]; 2] = [
    [[0, 1, 2, 4], [1, 3, 2, 7], [1, 2, 4, 7], [1, 4, 5, 7], [2, 4, 7, 6]],
    [[0, 1, 3, 5], [0, 3, 2, 6], [0, 3, 5, 6], [0, 4, 5, 6], [3, 5, 7, 6]],
];

/// Minimum factor between the spacings of two attempts at a grid with few enough nodes. It bounds
/// the number of attempts.
const LEAST_GROWTH: f64 = 1.01;

/// Edge lengths on a grid along the world axes.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldGrid {
    /// Number of nodes along each axis.
    pub size: [usize; 3],
    /// World position of the first node, mm.
    pub origin: DVec3,
    /// Distance between adjacent nodes, mm.
    pub spacing: f64,
    /// Edge lengths in mm, z fastest.
    pub values: Vec<f64>,
}

impl WorldGrid {
    /// Samples a size field over the bounding box of some world positions. The spacing is the
    /// smallest of the field, or larger if the grid would have more than `max_nodes` nodes.
    pub fn new(field: &SizingField, positions: &[DVec3], max_nodes: usize) -> Self {
        let geometry = &field.image().geometry;
        let origin = positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let extent = positions.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max) - origin;
        let mut spacing = geometry.min_spacing();
        let size = loop {
            let size = (extent / spacing).ceil() + 1.0;
            let excess = size.x * size.y * size.z / max_nodes as f64;
            if excess <= 1.0 {
                break size.to_array().map(|n| n as usize);
            }
            spacing *= excess.cbrt().max(LEAST_GROWTH);
        };
        let at = |node: usize| {
            let index = [node / size[2] / size[1], node / size[2] % size[1], node % size[2]].map(|n| n as f64);
            field.at(geometry.world_to_grid(origin + spacing * DVec3::from_array(index)))
        };
        let values = (0..size.iter().product()).into_par_iter().map(at).collect();
        Self { size, origin, spacing, values }
    }
}

/// Edge lengths on tetrahedra that cover an object.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BackgroundMesh {
    /// World positions, mm.
    pub points: Vec<DVec3>,
    /// The tetrahedra, in either orientation.
    pub cells: Vec<[u32; 4]>,
    /// Edge length at each point, mm.
    pub values: Vec<f64>,
    /// Distance between adjacent points, in voxels.
    pub stride: usize,
}

impl BackgroundMesh {
    /// Covers a closed surface (in the world frame) with cubes of five tetrahedra, and with one
    /// more layer of cubes beyond it. The size of the cubes is the smallest whole number of voxels
    /// that gives at most `max_nodes` points.
    pub fn new(field: &SizingField, surface: &TriangleMesh, max_nodes: usize) -> Self {
        // The cubes cover the object, and there are at least as many points as cubes.
        let geometry = &field.image().geometry;
        let voxels = measure(surface).volume.abs() / geometry.spacing.element_product();
        let least = ((voxels / max_nodes as f64).cbrt() as usize).max(1);
        for stride in least.. {
            let grid = covering_grid(geometry, &surface.vertices, stride);
            let cubes = cubes_around(surface, &grid);
            let mut used = vec![false; grid.voxel_count()];
            cubes.iter().flat_map(|&cube| corners(cube, &grid)).for_each(|node| used[node] = true);
            let nodes: Vec<usize> = (0..used.len()).filter(|&node| used[node]).collect();
            if nodes.len() <= max_nodes {
                return Self::on_grid(field, &grid, &cubes, &nodes, stride);
            }
        }
        Self::default()
    }

    /// Divides the cubes of a grid into tetrahedra. `nodes` contains their corners, ascending.
    fn on_grid(field: &SizingField, grid: &Geometry, cubes: &[[usize; 3]], nodes: &[usize], stride: usize) -> Self {
        let mut number = vec![0; grid.voxel_count()];
        (0..).zip(nodes).for_each(|(n, &node)| number[node] = n);
        let divide = |&cube: &[usize; 3]| {
            let corners = corners(cube, grid).map(|node| number[node]);
            FIVE_TETRAHEDRA[cube.iter().sum::<usize>() % 2].map(|cell| cell.map(|k| corners[k]))
        };
        let points: Vec<DVec3> = nodes.par_iter().map(|&node| grid.grid_to_world(grid.node_to_grid(node))).collect();
        let geometry = &field.image().geometry;
        Self {
            cells: cubes.iter().flat_map(divide).collect(),
            values: points.par_iter().map(|&p| field.at(geometry.world_to_grid(p))).collect(),
            points,
            stride,
        }
    }
}

/// Returns a grid whose nodes are `stride` voxels apart. It extends two steps beyond the world
/// positions, but not beyond the volume.
fn covering_grid(geometry: &Geometry, positions: &[DVec3], stride: usize) -> Geometry {
    let indices = || positions.iter().map(|&p| geometry.grid_to_index(geometry.world_to_grid(p)));
    let margin = DVec3::splat(2.0 * stride as f64);
    let low = indices().fold(DVec3::INFINITY, DVec3::min).floor() - margin;
    let high = indices().fold(DVec3::NEG_INFINITY, DVec3::max).ceil() + margin;
    let low = low.max(DVec3::ZERO);
    let high = high.min(geometry.grid_to_index(geometry.upper_corner()));
    let cubes = ((high - low) / stride as f64).ceil().max(DVec3::ONE);
    Geometry {
        size: (cubes + 1.0).to_array().map(|n| n as usize),
        spacing: geometry.spacing * stride as f64,
        origin: geometry.grid_to_world(geometry.index_to_grid(low)),
        ..geometry.clone()
    }
}

/// Returns the cubes of a grid that a closed surface (in the world frame) touches or encloses, and
/// their neighbours. A cube is given by its lowest corner.
fn cubes_around(surface: &TriangleMesh, grid: &Geometry) -> Vec<[usize; 3]> {
    let vertices = surface.vertices.iter().map(|&p| grid.world_to_grid(p)).collect();
    let surface = TriangleMesh { vertices, triangles: surface.triangles.clone() };
    let cubes = grid.size.map(|n| n - 1);
    let cell = |cube: [usize; 3]| cube[0] + cubes[0] * (cube[1] + cubes[1] * cube[2]);
    // the cubes `low` to `high` cells beyond a position, within the grid
    let around = |at: [usize; 3], below: usize, above: usize| {
        let range = move |axis: usize| at[axis].saturating_sub(below)..(at[axis] + above + 1).min(cubes[axis]);
        range(2).flat_map(move |z| range(1).flat_map(move |y| range(0).map(move |x| [x, y, z])))
    };
    let mut wanted = vec![false; cubes.iter().product()];
    // nodes that lie inside are on the wrong side of a field that is positive everywhere
    for node in nodes_on_wrong_side(&surface, &Image::filled(grid.clone(), 1.0)) {
        let at = [node % grid.size[0], node / grid.size[0] % grid.size[1], node / grid.size[0] / grid.size[1]];
        around(at, 1, 0).for_each(|cube| wanted[cell(cube)] = true);
    }
    for &p in &surface.vertices {
        let index = grid.grid_to_index(p).floor().max(DVec3::ZERO).to_array().map(|n| n as usize);
        wanted[cell([0, 1, 2].map(|axis| index[axis].min(cubes[axis] - 1)))] = true;
    }
    let all = (0..cubes[2]).flat_map(|z| (0..cubes[1]).flat_map(move |y| (0..cubes[0]).map(move |x| [x, y, z])));
    all.filter(|&cube| around(cube, 1, 1).any(|other| wanted[cell(other)])).collect()
}

/// Returns the eight corners of a cube as nodes of the grid.
fn corners([x, y, z]: [usize; 3], grid: &Geometry) -> [usize; 8] {
    std::array::from_fn(|k| grid.linear(x + (k & 1), y + (k >> 1 & 1), z + (k >> 2)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use isoparticles_mesh::shapes;
    use isoparticles_mesh::tetrahedra::faces::boundary;

    /// Returns a size field that is linear in the world, on an oblique grid around the origin.
    fn linear() -> (SizingField, impl Fn(DVec3) -> f64) {
        let value = |p: DVec3| 5.0 + p.dot(DVec3::new(0.1, -0.05, 0.2));
        let directions = DMat3::from_rotation_z(0.4) * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        let mut geometry = Geometry { directions, ..Geometry::axis_aligned([31, 32, 33], DVec3::new(0.9, 1.0, 1.1)) };
        geometry.origin = -geometry.grid_to_world(0.5 * geometry.upper_corner());
        let nodes = 0..geometry.voxel_count();
        let data = nodes.map(|node| value(geometry.grid_to_world(geometry.node_to_grid(node))) as f32).collect();
        (SizingField::new(Image { geometry, data }), value)
    }

    #[test]
    fn background_covers_a_ball_without_gaps() {
        let (field, value) = linear();
        let ball = shapes::icosphere(8.0, 3);
        for max_nodes in [100_000, 800] {
            let mesh = BackgroundMesh::new(&field, &ball, max_nodes);
            assert!(mesh.points.len() <= max_nodes && (mesh.stride == 1) == (max_nodes > 10_000));
            assert!(mesh.points.iter().zip(&mesh.values).all(|(&p, h)| (value(p) / h - 1.0).abs() < 1e-5));
            let volume = |cell: &[u32; 4]| {
                let [a, b, c, d] = cell.map(|v| mesh.points[v as usize]);
                ((b - a).cross(c - a).dot(d - a) / 6.0).abs()
            };
            let cube = 0.99 * (mesh.stride as f64).powi(3);
            for own in mesh.cells.chunks(5) {
                assert!((own.iter().map(volume).sum::<f64>() / cube - 1.0).abs() < 1e-9);
            }
            // neighbouring cubes share faces, and the boundary lies outside the ball
            let outside = boundary(&mesh.cells, mesh.points.len());
            assert!(outside.bodies.iter().all(|&body| body == 0));
            let on_boundary = outside.triangles.as_flattened();
            assert!(on_boundary.iter().all(|&v| mesh.points[v as usize].length() > 8.0));
            assert!(outside.triangles.len() < mesh.cells.len());
        }
    }

    #[test]
    fn world_grid_covers_the_bounding_box() {
        let (field, value) = linear();
        let ball = shapes::icosphere(8.0, 3);
        for max_nodes in [100_000, 800] {
            let grid = WorldGrid::new(&field, &ball.vertices, max_nodes);
            assert!(grid.values.len() <= max_nodes && (grid.spacing == 0.9) == (max_nodes > 10_000));
            for (node, h) in grid.values.iter().enumerate() {
                let [_, ny, nz] = grid.size;
                let index = DVec3::new((node / nz / ny) as f64, (node / nz % ny) as f64, (node % nz) as f64);
                let p = grid.origin + grid.spacing * index;
                assert!(p.abs().max_element() > 11.0 || (h / value(p) - 1.0).abs() < 1e-5);
            }
            let end = grid.origin + grid.spacing * DVec3::from_array(grid.size.map(|n| n as f64 - 1.0));
            assert!(grid.origin.max_element() <= -7.5 && end.min_element() >= 7.5);
        }
    }
}
