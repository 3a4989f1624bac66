//! Euler characteristics of the surfaces of regions, computed from the indicators alone on a
//! lattice of half voxels.
//!
//! Two parts of a region may share an edge or a corner of the lattice cubes, but no face. The
//! lattice cannot tell whether they are connected. Two results are computed: all such parts are
//! connected (26 neighbours), or all are separate (6 neighbours; Kong and Rosenfeld, Digital
//! topology, CVGIP 48, 1989). For smooth surfaces whose sheets are several cubes apart, the two are
//! equal. If some parts are connected and others are not, the true value can lie beyond both.

use super::Indicators;
use glam::DVec3;
use isoparticles_volume::Geometry;
use rayon::prelude::*;

/// Marks a point of the lattice whose region has not been computed.
const UNKNOWN: u16 = u16::MAX;

/// Euler characteristic of the surface of a region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EulerRange {
    /// The value if parts that share only an edge or a corner of a cube are separate.
    pub separate: i64,
    /// The value if they are connected.
    pub connected: i64,
    /// Number of cubes of half a voxel at which the two results differ. A single contact of two
    /// parts has one or more of them.
    pub undecided: usize,
}

impl EulerRange {
    /// Returns the smaller and the larger result.
    pub fn bounds(&self) -> [i64; 2] {
        [self.separate.min(self.connected), self.separate.max(self.connected)]
    }
}

/// Computes the Euler characteristics of all regions of a grid, by region number. `regions`
/// contains the region of each node, x fastest; `near` is true for a node if one of its cells may
/// contain an interface. All nodes on the border of the grid must be in the outside. The border is
/// not part of the surface of the outside.
pub fn euler_ranges(
    indicators: &dyn Indicators,
    geometry: &Geometry,
    regions: &[u16],
    near: &[bool],
) -> Vec<EulerRange> {
    let size = geometry.size;
    let [nx, ny, nz] = size;
    let table: [i64; 256] = std::array::from_fn(eightfold_euler);
    let count = regions.iter().max().map_or(0, |&most| usize::from(most) + 1);
    let [width, height] = [nx, ny].map(|n| 2 * n - 1);
    let cubes = |z: usize| {
        let mut known = vec![UNKNOWN; 3 * width * height];
        let mut region = |x: usize, y: usize, dz: usize| {
            let own = &mut known[(dz * height + y) * width + x];
            if *own == UNKNOWN {
                *own = if (x | y | dz) & 1 == 0 {
                    regions[geometry.linear(x / 2, y / 2, z + dz / 2)]
                } else {
                    let index = DVec3::new(x as f64, y as f64, (2 * z + dz) as f64) / 2.0;
                    indicators.region(indicators.material_at(geometry.index_to_grid(index))).0
                };
            }
            *own
        };
        // eight times the characteristics of the regions
        let mut found = vec![EulerRange::default(); count];
        for (y, x) in (0..ny - 1).flat_map(|y| (0..nx - 1).map(move |x| (y, x))) {
            if !(0..8).any(|c| near[geometry.linear(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2))]) {
                continue;
            }
            for cube in 0..8 {
                let [x, y, dz] = [2 * x + (cube & 1), 2 * y + (cube >> 1 & 1), cube >> 2];
                let corners: [u16; 8] = std::array::from_fn(|c| region(x + (c & 1), y + (c >> 1 & 1), dz + (c >> 2)));
                if corners.iter().any(|&id| id != corners[0]) {
                    add(&mut found, corners, &table);
                }
            }
        }
        found
    };
    let sum = |mut all: Vec<EulerRange>, found: Vec<EulerRange>| {
        all.resize(all.len().max(found.len()), EulerRange::default());
        for (all, found) in all.iter_mut().zip(found) {
            all.separate += found.separate;
            all.connected += found.connected;
            all.undecided += found.undecided;
        }
        all
    };
    let mut all =
        (0..nz.saturating_sub(1)).into_par_iter().map(cubes).reduce(|| vec![EulerRange::default(); count], sum);
    for own in &mut all {
        // the surface of a solid has twice its Euler characteristic
        [own.separate, own.connected] = [own.separate, own.connected].map(|eightfold| eightfold / 4);
    }
    all
}

/// Adds a cube with the given regions at its corners.
fn add(found: &mut Vec<EulerRange>, corners: [u16; 8], table: &[i64; 256]) {
    for (c, id) in corners.into_iter().enumerate().filter(|(c, id)| !corners[..*c].contains(id)) {
        if usize::from(id) >= found.len() {
            // a region that contains no node
            found.resize(usize::from(id) + 1, EulerRange::default());
        }
        let mask = (c..8).filter(|&other| corners[other] == id).fold(0usize, |mask, other| mask | 1 << other);
        // the complement has 6 neighbours where the region has 26
        let [separate, connected] = [table[mask], table[255 - mask]];
        let own = &mut found[usize::from(id)];
        own.separate += separate;
        own.connected += connected;
        own.undecided += usize::from(separate != connected);
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
    fn of(objects: &[fn(DVec3) -> f64]) -> Vec<EulerRange> {
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
        euler_ranges(&indicators, &geometry, &nodes.collect::<Vec<_>>(), &vec![true; 25usize.pow(3)])
    }

    fn ball(p: DVec3, x: f64, radius: f64) -> f64 {
        p.distance(DVec3::new(x, 11.7, 12.2)) - radius
    }

    fn certain(euler: i64) -> EulerRange {
        EulerRange { separate: euler, connected: euler, undecided: 0 }
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
        assert_eq!((outside.connected, outside.bounds()), (4, object.bounds()), "gaps of the object join the outside");
    }
}
