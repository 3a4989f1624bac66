//! Looks up labels at positions: the label of the voxel, or that of the nearest voxel with a wanted
//! label.

use glam::DVec3;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;

/// Returns the label at each world position: that of the voxel that contains it, or of the voxel at
/// the border of the volume that is nearest to it. If this label is not wanted, returns that of the
/// nearest voxel with a wanted label, if there is any.
pub fn labels_at(labels: &Image<i32>, is_wanted: impl Fn(i32) -> bool + Sync, positions: &[DVec3]) -> Vec<i32> {
    let geometry = &labels.geometry;
    let own = |&p: &DVec3| {
        let last = geometry.grid_to_index(geometry.upper_corner());
        let [i, j, k] = index(geometry, p).clamp(DVec3::ZERO, last).to_array().map(|n| n as usize);
        labels.at(i, j, k)
    };
    let mut found: Vec<i32> = positions.par_iter().map(own).collect();
    if found.par_iter().all(|&label| is_wanted(label)) {
        return found;
    }
    let rim = rim(labels, &is_wanted);
    let centre = |&voxel: &u32| geometry.grid_to_world(geometry.node_to_grid(voxel as usize));
    let tree = KdTree::new(&rim.iter().map(centre).collect::<Vec<_>>());
    found.par_iter_mut().zip(positions).filter(|(label, _)| !is_wanted(**label)).for_each(|(label, &p)| {
        if let Some((nearest, _)) = tree.nearest(p) {
            *label = labels.data[rim[nearest] as usize];
        }
    });
    found
}

/// Returns the index of the voxel that contains a world position; it may lie outside the grid.
fn index(geometry: &Geometry, p: DVec3) -> DVec3 {
    geometry.grid_to_index(geometry.world_to_grid(p)).round()
}

/// Returns the voxels with a wanted label that have a face in common with another voxel or with the
/// border of the volume. The nearest voxel of a position outside of the wanted voxels is one of
/// these.
fn rim(labels: &Image<i32>, is_wanted: &(impl Fn(i32) -> bool + Sync)) -> Vec<u32> {
    let [nx, ny, nz] = labels.geometry.size;
    let is_inner = |i: usize, j: usize, k: usize| {
        let neighbours = |at: usize, count: usize| (at > 0 && at + 1 < count).then_some([at.wrapping_sub(1), at + 1]);
        let (x, y, z) = (neighbours(i, nx), neighbours(j, ny), neighbours(k, nz));
        x.is_some_and(|x| x.iter().all(|&i| is_wanted(labels.at(i, j, k))))
            && y.is_some_and(|y| y.iter().all(|&j| is_wanted(labels.at(i, j, k))))
            && z.is_some_and(|z| z.iter().all(|&k| is_wanted(labels.at(i, j, k))))
    };
    let of_slice = |k: usize| {
        (0..ny)
            .flat_map(move |j| (0..nx).map(move |i| (i, j, k)))
            .filter(|&(i, j, k)| is_wanted(labels.at(i, j, k)) && !is_inner(i, j, k))
    };
    let voxels = (0..nz).into_par_iter().flat_map_iter(of_slice);
    voxels.map(|(i, j, k)| labels.geometry.linear(i, j, k) as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn unwanted_labels_are_replaced_by_the_nearest_wanted_label() {
        // label 1 in a slab at low x, label 2 in a slab at high x, label 3 between them
        let directions = DMat3::from_rotation_z(0.3);
        let geometry = Geometry {
            directions,
            origin: DVec3::splat(7.0),
            ..Geometry::axis_aligned([10, 4, 3], DVec3::new(0.5, 1.0, 2.0))
        };
        let data = (0..geometry.voxel_count())
            .map(|n| match n % 10 {
                0..3 => 1,
                3..7 => 3,
                _ => 2,
            })
            .collect();
        let labels = Image { geometry, data };
        let at = |x: f64| labels.geometry.grid_to_world(labels.geometry.index_to_grid(DVec3::new(x, 1.2, 0.9)));
        let positions = [-4.0, 0.0, 2.4, 3.0, 4.4, 4.6, 6.0, 8.0, 20.0].map(at);
        assert_eq!(labels_at(&labels, |label| label != 0, &positions), [1, 1, 1, 3, 3, 3, 3, 2, 2]);
        assert_eq!(labels_at(&labels, |label| label != 3, &positions), [1, 1, 1, 1, 1, 2, 2, 2, 2]);
        assert_eq!(labels_at(&labels, |label| label == 2, &positions), [2; 9]);
        assert_eq!(labels_at(&labels, |_| false, &positions[..1]), [1]);
    }
}
