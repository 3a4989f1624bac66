//! Meshes for the tests of this module, and tests of [`conform`].

use super::FACES;
use super::conform::{NOBODY, conform};
use glam::DVec3;
use std::collections::BTreeMap;

/// A mesh of tetrahedra and the interfaces between its regions.
pub(super) struct Example {
    pub(super) points: Vec<DVec3>,
    pub(super) cells: Vec<[u32; 4]>,
    /// Material of each tetrahedron.
    pub(super) regions: Vec<u32>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) between: Vec<[u32; 2]>,
}

impl Example {
    /// Divides a block of unit cubes into six tetrahedra per cube. The material of a tetrahedron
    /// depends on its centroid.
    pub(super) fn block(size: [u32; 3], material: impl Fn(DVec3) -> u32) -> Self {
        let count = size.map(|n| n + 1);
        let at = |x: u32, y: u32, z: u32| x + count[0] * (y + count[1] * z);
        let grid = |size: [u32; 3]| {
            (0..size[2]).flat_map(move |z| (0..size[1]).flat_map(move |y| (0..size[0]).map(move |x| [x, y, z])))
        };
        let points: Vec<DVec3> = grid(count).map(|[x, y, z]| DVec3::new(x.into(), y.into(), z.into())).collect();
        let mut cells = Vec::new();
        for [x, y, z] in grid(size) {
            for path in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
                let mut place = [x, y, z];
                let mut cell = [at(x, y, z); 4];
                for (vertex, axis) in cell[1..].iter_mut().zip(path) {
                    place[axis] += 1;
                    *vertex = at(place[0], place[1], place[2]);
                }
                let [a, b, c, d] = cell.map(|v| points[v as usize]);
                if (b - a).cross(c - a).dot(d - a) < 0.0 {
                    cell.swap(1, 2);
                }
                cells.push(cell);
            }
        }
        Self::new(points, cells, material)
    }

    /// Finds the interfaces of a mesh.
    pub(super) fn new(points: Vec<DVec3>, cells: Vec<[u32; 4]>, material: impl Fn(DVec3) -> u32) -> Self {
        let centre = |cell: &[u32; 4]| cell.iter().map(|&v| points[v as usize]).sum::<DVec3>() / 4.0;
        let regions: Vec<u32> = cells.iter().map(|cell| material(centre(cell))).collect();
        let mut faces: BTreeMap<[u32; 3], Vec<([u32; 3], u32)>> = BTreeMap::new();
        for (cell, &region) in cells.iter().zip(&regions) {
            for face in FACES {
                let face = face.map(|k| cell[k]);
                let mut key = face;
                key.sort_unstable();
                faces.entry(key).or_default().push((face, region));
            }
        }
        let sides = faces.into_values().map(|sides| (sides[0].0, [sides[0].1, sides.get(1).map_or(0, |side| side.1)]));
        let (triangles, between) = sides.filter(|(_, [inside, outside])| inside != outside).unzip();
        Self { points, cells, regions, triangles, between }
    }

    pub(super) fn conform(&self) -> super::conform::Conformity {
        conform(self.points.len(), &self.cells, &self.triangles, &self.between)
    }
}

/// Two materials, one above the other.
fn layers() -> Example {
    Example::block([2, 2, 2], |centre| if centre.z < 1.0 { 1 } else { 2 })
}

#[test]
fn regions_follow_from_the_interfaces() {
    let example = layers();
    let found = example.conform();
    assert_eq!((found.missing, found.added, found.crowded, found.undecided), (0, 0, 0, 0));
    assert_eq!(found.regions, example.regions);
    assert_eq!(found.parts, example.regions.iter().map(|region| region - 1).collect::<Vec<_>>());
    for (k, [inside, outside]) in example.between.iter().enumerate() {
        assert_eq!(example.regions[found.behind[k] as usize], *inside);
        match found.before[k] {
            NOBODY => assert_eq!(*outside, 0),
            cell => assert_eq!(example.regions[cell as usize], *outside),
        }
    }
}

#[test]
fn faults_are_counted() {
    // an interface triangle less: the two regions are one part with two materials
    let mut example = layers();
    let inner = example.between.iter().position(|&pair| pair == [1, 2]).expect("an interface");
    example.triangles.remove(inner);
    example.between.remove(inner);
    let found = example.conform();
    assert_eq!((found.undecided, found.added, found.crowded), (example.cells.len(), 0, 0));
    assert_eq!(found.missing, example.triangles.len());
    // an outer triangle less
    let mut example = layers();
    let outer = example.between.iter().position(|&pair| pair == [1, 0]).expect("a triangle of the boundary");
    example.triangles.remove(outer);
    example.between.remove(outer);
    let found = example.conform();
    assert_eq!((found.undecided, found.missing, found.added, found.crowded), (0, 0, 1, 0));
    // a tetrahedron twice: its inner faces have three tetrahedra
    let mut example = layers();
    let outer = example.conform();
    let owner = |cell: u32| outer.behind.iter().chain(&outer.before).filter(|&&own| own == cell).count();
    let cell = (0..example.cells.len() as u32).find(|&cell| owner(cell) == 1).expect("a tetrahedron with one triangle");
    example.cells.push(example.cells[cell as usize]);
    assert_eq!(example.conform().crowded, 3);
    // the two materials of a triangle exchanged
    let mut example = layers();
    example.between[0].reverse();
    let found = example.conform();
    assert!(found.missing > 0 && found.undecided == example.cells.len() / 2);
}
