//! Euler characteristics of the surfaces of regions, computed from the indicators alone on a
//! lattice of half voxels.
//!
//! Two parts of a region may share an edge or a corner of the lattice cubes, but no face. The
//! lattice cannot tell whether they are connected. Two results are computed: all such parts are
//! connected (26 neighbours), or all are separate (6 neighbours; Kong and Rosenfeld, Digital
//! topology, CVGIP 48, 1989). For smooth surfaces whose sheets are several cubes apart, the two are
//! equal. If some parts are connected and others are not, the true value can lie beyond both.

use super::{Indicators, MaterialId};
use glam::DVec3;
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Marks a point of the lattice whose region has not been computed.
const UNKNOWN: u16 = u16::MAX;

/// The two results for the Euler characteristic of the surface of a region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EulerPair {
    /// The result if parts that share only an edge or a corner of a cube are separate.
    pub separate: i64,
    /// The result if they are connected.
    pub connected: i64,
    /// Number of cubes of half a voxel at which the two results differ. A single contact of two
    /// parts has one or more of them.
    pub undecided: usize,
}

impl EulerPair {
    /// Returns the smaller and the larger result.
    pub fn ascending(&self) -> [i64; 2] {
        [self.separate.min(self.connected), self.separate.max(self.connected)]
    }

    fn add(&mut self, other: Self) {
        self.separate += other.separate;
        self.connected += other.connected;
        self.undecided += other.undecided;
    }
}

/// Computes the Euler characteristics of all regions of a grid. `regions` contains the region of
/// each node, x fastest; `is_near` returns for a node whether one of its cells may contain an
/// interface. All nodes on the border of the grid must be in the outside. The border is not part of
/// the surface of the outside.
pub fn euler_pairs(
    indicators: &dyn Indicators,
    geometry: &Geometry,
    regions: &[u16],
    is_near: &(dyn Fn(usize) -> bool + Sync),
) -> BTreeMap<MaterialId, EulerPair> {
    let [nx, ny, nz] = geometry.size.map(|n| n.saturating_sub(1));
    let table: [i64; 256] = std::array::from_fn(eightfold_euler);
    let [width, height] = [nx, ny].map(|n| 2 * n + 1);
    let corner = |[x, y, z]: [usize; 3], c: usize| [x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)];
    // sums eight times the contributions of the cubes in a slab of cells
    let slab = |z: usize| {
        let cells = (0..ny).flat_map(|y| (0..nx).map(move |x| [x, y, z]));
        let mut near =
            cells.filter(|&cell| (0..8).map(|c| corner(cell, c)).any(|[x, y, z]| is_near(geometry.linear(x, y, z))));
        let mut found: BTreeMap<MaterialId, EulerPair> = BTreeMap::new();
        let Some(first) = near.next() else { return found };
        let mut known = vec![UNKNOWN; 3 * width * height];
        // a point of the lattice, in half voxels from the first node of the slab
        let mut region = |[x, y, dz]: [usize; 3]| {
            let cached = &mut known[(dz * height + y) * width + x];
            if *cached == UNKNOWN {
                *cached = if (x | y | dz) & 1 == 0 {
                    regions[geometry.linear(x / 2, y / 2, z + dz / 2)]
                } else {
                    let index = DVec3::new(x as f64, y as f64, (2 * z + dz) as f64) / 2.0;
                    indicators.region(indicators.material_at(geometry.index_to_grid(index))).0
                };
            }
            *cached
        };
        for [x, y, _] in std::iter::once(first).chain(near) {
            for cube in 0..8 {
                let lowest = corner([2 * x, 2 * y, 0], cube);
                let corners: [u16; 8] = std::array::from_fn(|c| region(corner(lowest, c)));
                if corners.iter().any(|&id| id != corners[0]) {
                    add_cube(&mut found, corners, &table);
                }
            }
        }
        found
    };
    let sum = |mut all: BTreeMap<MaterialId, EulerPair>, found: BTreeMap<MaterialId, EulerPair>| {
        found.into_iter().for_each(|(id, own)| all.entry(id).or_default().add(own));
        all
    };
    let mut pairs = (0..nz).into_par_iter().map(slab).reduce(BTreeMap::new, sum);
    for own in pairs.values_mut() {
        // the surface of a solid has twice its Euler characteristic
        own.separate /= 4;
        own.connected /= 4;
    }
    pairs
}

/// Adds eight times the contribution of a cube with the given regions at its corners.
fn add_cube(found: &mut BTreeMap<MaterialId, EulerPair>, corners: [u16; 8], table: &[i64; 256]) {
    for (c, id) in corners.into_iter().enumerate().filter(|(c, id)| !corners[..*c].contains(id)) {
        let mask = (c..8).filter(|&other| corners[other] == id).fold(0usize, |mask, other| mask | 1 << other);
        // the complement has 6 neighbours where the region has 26
        let [separate, connected] = [table[mask], table[255 - mask]];
        let own = EulerPair { separate, connected, undecided: usize::from(separate != connected) };
        found.entry(MaterialId(id)).or_default().add(own);
    }
}

/// Returns eight times the contribution of a cube to the Euler characteristic of a set of lattice
/// points, with all edges, faces and cubes whose corners are in it. Bit c of `mask` is set if
/// corner c of the cube is in the set. Corners belong to eight cubes, edges to four and faces to
/// two.
fn eightfold_euler(mask: usize) -> i64 {
    let count = |cells: &[usize]| cells.iter().filter(|&&cell| mask & cell == cell).count() as i64;
    let corners: Vec<usize> = (0..8).map(|c| 1 << c).collect();
    let along = |axis: usize| (0..8).filter(move |c| c >> axis & 1 == 0).map(move |c| 1 << c | 1 << (c | 1 << axis));
    let edges: Vec<usize> = (0..3).flat_map(along).collect();
    let face = |axis: usize, side: usize| (0..8).filter(|c| c >> axis & 1 == side).map(|c| 1 << c).sum();
    let faces: Vec<usize> = (0..3).flat_map(|axis| [face(axis, 0), face(axis, 1)]).collect();
    count(&corners) - 2 * count(&edges) + 4 * count(&faces) - 8 * count(&[255])
}

#[cfg(test)]
mod tests {
    use super::super::{Analytic, far};
    use super::*;
    use crate::spline::Jet;

    /// Returns the characteristics of the outside and of objects that are given by their signed
    /// distances, in a cube of 24 mm with voxels of 1 mm. All cells are searched.
    fn of(objects: &[fn(DVec3) -> f64]) -> Vec<EulerPair> {
        let geometry = Geometry::axis_aligned([25; 3], DVec3::ONE);
        let jet = |value: f64| Jet { value, ..far(false) };
        let all = objects.to_vec();
        let outside = move |p| jet(-all.iter().map(|object| object(p)).fold(f64::INFINITY, f64::min));
        let mut functions: Vec<Box<dyn Fn(DVec3) -> Jet + Send + Sync>> = vec![Box::new(outside)];
        for &object in objects {
            functions.push(Box::new(move |p| jet(object(p))));
        }
        let indicators = Analytic::new(functions, 1.0);
        let nodes = (0..25usize.pow(3)).map(|node| indicators.material_at(geometry.node_to_grid(node)).0);
        euler_pairs(&indicators, &geometry, &nodes.collect::<Vec<_>>(), &|_| true).into_values().collect()
    }

    fn ball(p: DVec3, x: f64, radius: f64) -> f64 {
        p.distance(DVec3::new(x, 11.7, 12.2)) - radius
    }

    fn certain(euler: i64) -> EulerPair {
        EulerPair { separate: euler, connected: euler, undecided: 0 }
    }

    #[test]
    fn euler_characteristics_of_shapes_are_exact() {
        assert_eq!(of(&[|p| ball(p, 12.1, 8.3)]), [certain(2); 2], "ball");
        assert_eq!(of(&[|p| ball(p, 12.1, 8.3).max(-ball(p, 11.0, 4.0))]), [certain(4); 2], "shell");
        assert_eq!(of(&[|p| ball(p, 6.0, 4.0).min(ball(p, 17.0, 4.0))]), [certain(4); 2], "two balls");
        let ring = |p: DVec3| {
            let p = p - DVec3::new(12.3, 11.6, 12.1);
            (p.x.hypot(p.y) - 6.0).hypot(p.z) - 2.2
        };
        assert_eq!(of(&[ring]), [certain(0); 2], "ring");
        let halves: [fn(DVec3) -> f64; 2] =
            [|p| ball(p, 12.1, 8.3).max(p.x - 12.1), |p| ball(p, 12.1, 8.3).max(12.1 - p.x)];
        assert_eq!(of(&halves), [certain(2); 3], "two halves");
        let core: [fn(DVec3) -> f64; 2] = [|p| ball(p, 12.1, 4.37), |p| ball(p, 12.1, 8.3).max(-ball(p, 12.1, 4.37))];
        assert_eq!(of(&core), [certain(2), certain(2), certain(4)], "core");
    }

    #[test]
    fn touching_parts_are_undecided() {
        // along a diagonal of the lattice, the gap between the balls is narrower than a cube
        let balls = |p: DVec3| {
            let centre = |sign: f64| DVec3::splat(12.25) + sign * DVec3::new(3.0, 3.0, 0.0);
            (p.distance(centre(1.0)) - 4.0).min(p.distance(centre(-1.0)) - 4.0)
        };
        let [outside, object] = of(&[balls])[..] else { panic!("two regions") };
        assert_eq!(object.separate, 4, "two balls");
        assert!(object.connected < 4 && object.undecided > 0, "{object:?}");
        assert_eq!(
            (outside.connected, outside.ascending()),
            (4, object.ascending()),
            "gaps of the object join the outside"
        );
    }
}
