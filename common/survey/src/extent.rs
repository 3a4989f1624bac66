//! Computes the bounding box of each class.

use crate::classes::{Classes, OUTSIDE};
use glam::DVec3;
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use serde::Serialize;

/// The bounding box of the voxels of one class, aligned with the world axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorldBox {
    /// Minimum of x, y and z, mm.
    pub low: [f64; 3],
    /// Maximum of x, y and z, mm.
    pub high: [f64; 3],
    /// Centre of the box, mm.
    pub centre: [f64; 3],
}

/// Minimum and maximum voxel index of one class along each axis.
type Indices = [[usize; 3]; 2];

/// Indices of a class without voxels.
const NONE: Indices = [[usize::MAX; 3], [0; 3]];

/// Returns the bounding box of each class except [`OUTSIDE`], or `None` for a class without voxels.
/// The boxes enclose whole voxels, not only their centres.
pub fn boxes(classes: &Classes<'_>) -> Vec<Option<WorldBox>> {
    let [nx, ny, nz] = classes.geometry.size;
    let slice = |k: usize| {
        let (mut found, mut row) = (vec![NONE; classes.count + 1], vec![OUTSIDE; nx]);
        for j in 0..ny {
            classes.copy_row(j, k, &mut row);
            let mut first = 0;
            for run in row.chunk_by(|a, b| a == b) {
                let last = first + run.len() - 1;
                found[usize::from(run[0])] = join(found[usize::from(run[0])], [[first, j, k], [last, j, k]]);
                first = last + 1;
            }
        }
        found
    };
    let found = (0..nz).into_par_iter().map(slice).reduce(
        || vec![NONE; classes.count + 1],
        |mut a, b| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = join(*a, b));
            a
        },
    );
    let to_world = |indices: &Indices| (indices[0] <= indices[1]).then(|| world_box(*indices, classes.geometry));
    found[1..].iter().map(to_world).collect()
}

fn join(a: Indices, b: Indices) -> Indices {
    let of = |end: usize, choose: fn(usize, usize) -> usize| [0, 1, 2].map(|axis| choose(a[end][axis], b[end][axis]));
    [of(0, usize::min), of(1, usize::max)]
}

fn world_box([first, last]: Indices, geometry: &Geometry) -> WorldBox {
    let index = |at: [usize; 3]| DVec3::from_array(at.map(|n| n as f64));
    let ends = [index(first) - 0.5, index(last) + 0.5].map(|at| geometry.index_to_grid(at));
    let [low, high] = geometry.world_box(ends);
    WorldBox { low: low.to_array(), high: high.to_array(), centre: (0.5 * (low + high)).to_array() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classes::Rule;
    use isoparticles_volume::Voxels;

    #[test]
    fn boxes_are_in_world_coordinates() {
        // the x axis of the grid points along the y axis of the world
        let geometry = Geometry {
            directions: glam::DMat3::from_cols(DVec3::Y, -DVec3::X, DVec3::Z),
            origin: DVec3::new(10.0, 20.0, 30.0),
            ..Geometry::axis_aligned([4, 3, 2], DVec3::new(1.0, 2.0, 4.0))
        };
        let mut values = vec![0u8; 24];
        values[geometry.linear(1, 1, 0)] = 7;
        values[geometry.linear(3, 2, 0)] = 7;
        let voxels = Voxels::U8(values);
        let classes = Classes::new(&geometry, vec![(&voxels, Rule::each_of(&[7, 8]))], 2);
        let expected = WorldBox { low: [5.0, 20.5, 28.0], high: [9.0, 23.5, 32.0], centre: [7.0, 22.0, 30.0] };
        assert_eq!(boxes(&classes), [Some(expected), None]);
    }
}
