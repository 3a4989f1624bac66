use super::*;
use crate::shapes;
use glam::DVec3;

/// A box from 0 to 3 (material 1) with a hollow from 1 to 2, which is filled with `inner`.
fn nested_boxes(inner: u32) -> (TriangleMesh, Vec<[u32; 2]>) {
    let mut core = shapes::cuboid(DVec3::ONE);
    core.vertices.iter_mut().for_each(|p| *p += 1.0);
    let count = core.triangles.len();
    if inner == OUTSIDE {
        core.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    let mesh = shapes::union(&[shapes::cuboid(DVec3::splat(3.0)), core]);
    let own = if inner == OUTSIDE { [1, OUTSIDE] } else { [inner, 1] };
    (mesh, [vec![[1, OUTSIDE]; count], vec![own; count]].concat())
}

/// Two unit cubes (materials 1 and 2) that share a face; the wall between them belongs to both.
fn two_rooms() -> (TriangleMesh, Vec<[u32; 2]>) {
    let room = shapes::cuboid(DVec3::ONE);
    let is_wall = |t: &[u32; 3]| t.iter().all(|&v| room.vertices[v as usize].x == 1.0);
    let beside = |v: u32| {
        let p = room.vertices[v as usize] + DVec3::X;
        room.vertices.iter().position(|&q| q == p).map_or(v + room.vertices.len() as u32, |n| n as u32)
    };
    let shifted = room.vertices.iter().map(|&p| p + DVec3::X);
    let mut mesh = TriangleMesh { vertices: room.vertices.iter().copied().chain(shifted).collect(), triangles: vec![] };
    let mut between = Vec::new();
    for t in &room.triangles {
        // the wall is counter-clockwise as seen from material 1
        mesh.triangles.push(if is_wall(t) { [t[0], t[2], t[1]] } else { *t });
        between.push(if is_wall(t) { [2, 1] } else { [1, OUTSIDE] });
    }
    let is_far = |t: &[u32; 3]| !t.iter().all(|&v| room.vertices[v as usize].x == 0.0);
    for t in room.triangles.iter().filter(|t| is_far(t)) {
        mesh.triangles.push(t.map(beside));
        between.push([2, OUTSIDE]);
    }
    (mesh, between)
}

#[test]
fn a_hollow_box_has_one_volume_without_its_hollow() {
    let (mesh, between) = nested_boxes(OUTSIDE);
    let complex = Complex::new(&mesh, &between, 2);
    assert!(complex.open_edges().is_empty());
    let shells = complex.shells();
    assert_eq!((shells.materials, shells.mixed, shells.inside_out), (vec![1], 0, 0));
    assert!((shells.sizes[0] - 26.0).abs() < 1e-12);
    assert_eq!((shells.of_triangle[0], shells.of_triangle[12]), ([0, -1], [0, -2]));
    // the box from inside its corners, and the hollow from outside its edges
    assert!((shells.narrowest[1] - 90.0).abs() < 1e-12 && (shells.narrowest[0] - 90.0).abs() < 1e-12);
}

#[test]
fn a_box_in_a_box_fills_its_cavity() {
    let (mesh, between) = nested_boxes(2);
    let complex = Complex::new(&mesh, &between, 3);
    let shells = complex.shells();
    assert_eq!((shells.materials, shells.inside_out), (vec![1, 2], 0));
    assert!((shells.sizes[0] - 26.0).abs() < 1e-12 && (shells.sizes[1] - 1.0).abs() < 1e-12);
    let described = complex.describe();
    assert_eq!((described.junction_edges, described.junction_vertices), (0, 0));
    assert_eq!(described.vertices_by_materials, [(2, 16)].into());
    let euler: Vec<i64> = described.materials.iter().map(|material| material.topology.euler).collect();
    assert_eq!(euler, [2, 4, 2]);
}

#[test]
fn rooms_share_their_wall() {
    let (mesh, between) = two_rooms();
    let complex = Complex::new(&mesh, &between, 3);
    assert!(complex.open_edges().is_empty());
    let shells = complex.shells();
    assert_eq!((shells.materials, shells.mixed, shells.inside_out), (vec![1, 2], 0, 0));
    assert!(shells.sizes.iter().all(|size| (size - 1.0).abs() < 1e-12));
    let described = complex.describe();
    assert_eq!((described.junction_edges, described.junction_vertices), (4, 0));
    assert_eq!(described.edges_by_triangles[&3], 4);
    let pieces: Vec<_> = described.interfaces.iter().map(|own| (own.between, own.pieces)).collect();
    assert_eq!(pieces, [([1, 0], 1), ([2, 0], 1), ([2, 1], 1)]);
    assert_eq!(described.interfaces[2].rms_turn, Some(0.0));
}

#[test]
fn faults_are_counted() {
    let (mesh, mut between) = two_rooms();
    let wall = between.iter().position(|pair| *pair == [2, 1]).unwrap_or(0);
    // one of the two triangles of the wall separates other materials
    between[wall] = [2, OUTSIDE];
    assert_eq!(Complex::new(&mesh, &between, 3).open_edges(), [(0, 3), (1, 3)].into());
    let mut hollow = nested_boxes(OUTSIDE);
    hollow.0.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let shells = Complex::new(&hollow.0, &hollow.1, 2).shells();
    assert_eq!((shells.materials, shells.inside_out), (vec![1], 1));
}
