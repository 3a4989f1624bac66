//! Tests of [`conform`] and of mending, which need a mesh and its interfaces.

use super::FACES;
use super::conform::{Conformity, NOBODY, conform};
use super::faces::boundary;
use super::mend::{Filled, Mended, mend};
use super::patch::{Limited, Patch};
use super::quality::{TetrahedronQuality, qualities};
use super::target::Goal;
use glam::DVec3;
use isoparticles_field::random::uniform;
use std::collections::BTreeMap;

const GOAL: Goal = Goal { limit_dihedral: 5.0, limit_jacobian: 0.05, aim_dihedral: 12.0 };

/// A mesh of tetrahedra and the interfaces between its regions.
struct Example {
    points: Vec<DVec3>,
    cells: Vec<[u32; 4]>,
    /// Material of each tetrahedron.
    regions: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    between: Vec<[u32; 2]>,
}

impl Example {
    /// Divides a block of unit cubes into six tetrahedra per cube. The material of a tetrahedron
    /// depends on its centroid.
    fn block(size: [u32; 3], material: impl Fn(DVec3) -> u32) -> Self {
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
    fn new(points: Vec<DVec3>, cells: Vec<[u32; 4]>, material: impl Fn(DVec3) -> u32) -> Self {
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

    fn conform(&self) -> Conformity {
        conform(self.points.len(), &self.cells, &self.triangles, &self.between)
    }

    fn filled(&self) -> Filled<'_> {
        Filled { points: &self.points, cells: &self.cells, triangles: &self.triangles, between: &self.between }
    }

    /// Numbers the vertices of the interfaces first.
    fn with_interfaces_first(mut self) -> Self {
        let mut is_on_interface = vec![false; self.points.len()];
        self.triangles.iter().flatten().for_each(|&v| is_on_interface[v as usize] = true);
        let mut order: Vec<u32> = (0..self.points.len() as u32).collect();
        order.sort_by_key(|&v| !is_on_interface[v as usize]);
        let mut number = vec![0; order.len()];
        order.iter().zip(0..).for_each(|(&v, n)| number[v as usize] = n);
        self.points = order.iter().map(|&v| self.points[v as usize]).collect();
        self.cells.iter_mut().for_each(|cell| *cell = cell.map(|v| number[v as usize]));
        self.triangles.iter_mut().for_each(|triangle| *triangle = triangle.map(|v| number[v as usize]));
        self
    }

    fn patch(&self, parts: &[u32], limited: Limited) -> Patch {
        let cells: Vec<([u32; 4], u32)> = self.cells.iter().copied().zip(parts.iter().copied()).collect();
        Patch::new(self.points.clone(), &cells, limited, &GOAL)
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
fn bodies_are_connected_across_interfaces() {
    // two halves of a block, and a separate tetrahedron
    let mut example = layers();
    let points = example.points.len() as u32;
    example.points.extend([DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p + DVec3::splat(5.0)));
    example.cells.push([points, points + 1, points + 2, points + 3]);
    let example = Example::new(example.points, example.cells, |centre| if centre.z < 1.0 { 1 } else { 2 });
    assert_eq!(example.conform().faults(), 0);
    let bodies = boundary(&example.cells, example.points.len()).bodies;
    let (last, halves) = bodies.split_last().expect("tetrahedra");
    assert!(*last == 1 && halves.iter().all(|&body| body == 0));
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

/// A flat tetrahedron between four others. Its corners lie alternately above and below z = 0.
fn sliver() -> Example {
    let points =
        [[1.0, 0.0, 0.02], [0.0, 1.0, -0.02], [-1.0, 0.0, 0.02], [0.0, -1.0, -0.02], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    let cells = vec![[0, 2, 1, 3], [0, 1, 2, 4], [0, 2, 3, 4], [0, 3, 1, 5], [1, 3, 2, 5]];
    let example = Example::new(points.map(DVec3::from_array).to_vec(), cells, |_| 1);
    assert!(qualities(&example.points, &example.cells).iter().all(|own| own.volume > 0.0));
    example
}

#[test]
fn a_sliver_between_vertices_of_the_surface_is_removed() {
    let example = sliver();
    let mut patch = example.patch(&[0; 5], Limited::new());
    assert_eq!(patch.poor(), [0]);
    let filling = patch.better_filling(0).expect("a filling");
    patch.fill(&filling);
    assert!(patch.poor().is_empty());
    let cells: Vec<[u32; 4]> = patch.cells.iter().filter(|cell| cell.exists).map(|cell| cell.vertices).collect();
    let after = Example::new(patch.points, cells, |_| 1);
    let sorted = |example: &Example| {
        let mut triangles: Vec<[u32; 3]> = example.triangles.clone();
        triangles.iter_mut().for_each(|own| own.sort_unstable());
        triangles.sort_unstable();
        triangles
    };
    assert_eq!(sorted(&after), sorted(&example));
    let volumes =
        |example: &Example| qualities(&example.points, &example.cells).iter().map(|own| own.volume).sum::<f64>();
    assert!((volumes(&after) - volumes(&example)).abs() < 1e-12);
}

#[test]
fn a_cavity_does_not_cross_an_interface() {
    let patch = sliver().patch(&[1, 0, 0, 0, 0], Limited::new());
    assert_eq!(patch.poor(), [0]);
    assert!(patch.better_filling(0).is_none());
}

#[test]
fn a_limited_face_reduces_the_targets_in_its_part() {
    let example = sliver();
    let corners = example.cells[0].map(|v| example.points[v as usize]);
    let TetrahedronQuality { min_dihedral: angle, scaled_jacobian: jacobian, .. } = TetrahedronQuality::of(&corners);
    let poor = |face: [u32; 3], part: u32, bound: f64| {
        example.patch(&[0; 5], Limited::from([((face, part), GOAL.beside(bound))])).poor().len()
    };
    assert_eq!(poor([0, 1, 2], 0, angle), 0);
    assert_eq!(poor([0, 1, 2], 0, 1.2 * angle), 1, "nine tenths of the bound");
    assert_eq!(poor([0, 1, 2], 1, angle), 1, "another part");
    assert_eq!(poor([0, 1, 4], 0, angle), 1, "a face of another tetrahedron");
    // only the scaled Jacobian is limited
    let possible = GOAL.with_jacobian(jacobian).least(GOAL.beside(angle));
    assert_eq!(example.patch(&[0; 5], Limited::from([(([0, 1, 2], 0), possible)])).poor().len(), 0);
}

/// A block of two materials, in which inner vertices are moved close to a face.
fn crooked() -> Example {
    let mut example = Example::block([9, 9, 10], |centre| if centre.z < 5.0 { 1 } else { 2 }).with_interfaces_first();
    for place in [[2.0, 2.0, 2.0], [6.0, 5.0, 4.0], [4.0, 4.0, 7.0]].map(DVec3::from_array) {
        let vertex = example.points.iter().position(|&p| p == place).expect("a grid point");
        example.points[vertex].z += 0.9;
    }
    example
}

#[test]
fn the_rest_of_the_mesh_stays() {
    let example = crooked();
    let before = qualities(&example.points, &example.cells);
    let poor = before.iter().filter(|own| own.min_dihedral < 12.0).count();
    let Mended { points, cells, conformity, changes } = mend(example.filled(), &GOAL, &|| false).expect("better cells");
    assert_eq!(changes.below, [poor, 0]);
    let after = qualities(&points, &cells);
    assert!(after.iter().all(|own| own.min_dihedral >= 12.0 && own.volume > 0.0));
    let surface = 1 + *example.triangles.as_flattened().iter().max().expect("triangles") as usize;
    assert_eq!(points[..surface], example.points[..surface]);
    assert_eq!(conformity.faults(), 0);
    let kept = cells.len() - changes.cells[1];
    assert_eq!(kept + changes.cells[0], example.cells.len());
    assert_eq!(points.len() + changes.vertices[0], example.points.len() + changes.vertices[1]);
    for material in [1, 2] {
        let volume = |regions: &[u32], all: &[TetrahedronQuality]| {
            regions.iter().zip(all).filter(|(region, _)| **region == material).map(|(_, own)| own.volume).sum::<f64>()
        };
        let expected = volume(&example.regions, &before);
        assert!((volume(&conformity.regions, &after) - expected).abs() < 1e-9 * expected);
    }
}

/// A block whose inner vertices are moved at random.
fn shaken() -> Example {
    let mut example = Example::block([12, 12, 12], |centre| if centre.x < 7.0 { 1 } else { 2 });
    let is_inner = |p: &DVec3| p.cmpgt(DVec3::ZERO).all() && p.cmplt(DVec3::splat(12.0)).all() && p.x != 7.0;
    for (n, point) in (0..).zip(&mut example.points) {
        if is_inner(point) {
            *point += DVec3::from_array([0, 1, 2].map(|axis| 0.52 * (uniform(9, axis, n) - 0.5)));
        }
    }
    assert!(qualities(&example.points, &example.cells).iter().all(|own| own.volume > 0.0));
    example.with_interfaces_first()
}

#[test]
fn many_poor_tetrahedra_get_better_on_any_number_of_threads() {
    let example = shaken();
    let made = [1, 2, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| mend(example.filled(), &Goal { aim_dihedral: 20.0, ..GOAL }, &|| false)).expect("better cells")
    });
    assert!(made[0] == made[1] && made[0] == made[2]);
    let [before, after] = made[0].changes.below;
    assert!(before > 50 && after * 20 < before, "{before} to {after}");
    assert_eq!(made[0].conformity.faults(), 0);
    assert!(qualities(&made[0].points, &made[0].cells).iter().all(|own| own.volume > 0.0));
}

#[test]
fn a_mesh_that_cannot_or_need_not_be_mended_stays() {
    let example = crooked();
    let mended = |example: &Example, goal: &Goal| mend(example.filled(), goal, &|| false);
    // most tetrahedra have a dihedral angle of 45 degrees
    assert_eq!(mended(&example, &Goal { aim_dihedral: 50.0, ..GOAL }), None);
    assert_eq!(mended(&Example::block([2, 2, 2], |_| 1), &GOAL), None);
    let mut open = crooked();
    open.triangles.pop();
    open.between.pop();
    assert_eq!(mended(&open, &GOAL), None);
    assert_eq!(mend(example.filled(), &GOAL, &|| true), None);
}
