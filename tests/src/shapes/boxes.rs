//! Boxes of whole voxels: a plate, a rod, and two boxes that touch along an edge. The plate and the
//! rod are one voxel thick.

use crate::scene::{Scene, Truth};
use glam::DVec3;
use isoparticles_volume::Geometry;
use std::collections::BTreeMap;

/// A union of boxes whose faces lie halfway between voxel centres.
#[derive(Clone, Debug)]
pub struct Boxes {
    name: &'static str,
    boxes: Vec<(DVec3, DVec3)>,
    truth: Truth,
}

impl Boxes {
    /// Returns a plate one voxel thick in the middle slice, with 60 % of the volume's width and
    /// depth.
    pub fn plate(grid: &Geometry) -> Self {
        let [nx, ny, nz] = grid.size;
        Self::single("plate", grid, [[nx / 5, nx - nx / 5], [ny / 5, ny - ny / 5], [nz / 2, nz / 2 + 1]])
    }

    /// Returns a rod along x: a row of voxels, 60 % as long as the volume.
    pub fn rod(grid: &Geometry) -> Self {
        let [nx, ny, nz] = grid.size;
        Self::single("rod", grid, [[nx / 5, nx - nx / 5], [ny / 2, ny / 2 + 1], [nz / 2, nz / 2 + 1]])
    }

    /// Returns two boxes that share only an edge along z.
    pub fn touching(grid: &Geometry) -> Self {
        let [nx, ny, nz] = grid.size;
        let along_z = [nz / 5, nz - nz / 5];
        let boxes =
            [[[nx / 5, nx / 2], [ny / 5, ny / 2], along_z], [[nx / 2, nx - nx / 5], [ny / 2, ny - ny / 5], along_z]];
        let boxes: Vec<_> = boxes.iter().map(|ranges| corners(grid, ranges)).collect();
        let volume = boxes.iter().map(|(low, high)| (*high - *low).element_product()).sum();
        let truth = Truth {
            shape: "touching-boxes".into(),
            method: "closed form; whether the two boxes become one component is the smoothing's choice".into(),
            volume: Some(volume),
            genus: Some(0),
            centre_grid: (0.5 * grid.upper_corner()).to_array(),
            ..Truth::default()
        };
        Self { name: "touching-boxes", boxes, truth }
    }

    fn single(name: &'static str, grid: &Geometry, ranges: [[usize; 2]; 3]) -> Self {
        let (low, high) = corners(grid, &ranges);
        let size = high - low;
        let truth = Truth {
            shape: name.into(),
            method: "closed form of the voxels' own box".into(),
            area: Some(2.0 * (size.x * size.y + size.y * size.z + size.z * size.x)),
            volume: Some(size.element_product()),
            components: Some(1),
            genus: Some(0),
            centre_grid: (0.5 * (low + high)).to_array(),
            dimensions: BTreeMap::from([
                ("size_x".into(), size.x),
                ("size_y".into(), size.y),
                ("size_z".into(), size.z),
            ]),
            ..Truth::default()
        };
        Self { name, boxes: vec![(low, high)], truth }
    }
}

/// Returns the lower and upper corners (mm, grid frame) of a box of whole voxels. `ranges` are the
/// half-open index ranges of the voxels.
fn corners(grid: &Geometry, ranges: &[[usize; 2]; 3]) -> (DVec3, DVec3) {
    let bound = |side: usize| DVec3::from_array(ranges.map(|range| range[side] as f64 - 0.5));
    (grid.index_to_grid(bound(0)), grid.index_to_grid(bound(1)))
}

impl Scene for Boxes {
    fn value(&self, position: DVec3) -> f64 {
        let to_box = |(low, high): &(DVec3, DVec3)| {
            let outside = (*low - position).max(position - *high);
            outside.max(DVec3::ZERO).length() + outside.max_element().min(0.0)
        };
        self.boxes.iter().map(to_box).fold(f64::INFINITY, f64::min)
    }

    fn truth(&self) -> Truth {
        Truth { shape: self.name.into(), ..self.truth.clone() }
    }
}
