//! The faces of the volume that an object touches, where planes close it.

use glam::DVec3;
use isoparticles_field::materials::Bound;
use isoparticles_stage::meta::{CapPlane, Side};
use isoparticles_volume::Geometry;

/// Returns the planes half a voxel beyond the outermost voxel centres, at the faces of the volume
/// that the object touches. Positions are in the frame of `grid`, mm. `whole` is the grid of the
/// volume, and `is_inside` tells whether a node of `grid` is inside the object.
pub(crate) fn touched_faces(
    grid: &Geometry,
    whole: &Geometry,
    is_inside: impl Fn([usize; 3]) -> bool,
) -> Vec<CapPlane> {
    let size = grid.size;
    // index of the first voxel of the volume, from the world positions of both grids
    let first = grid.grid_to_index(grid.world_to_grid(whole.origin)).round();
    let mut faces = Vec::new();
    for axis in 0..3 {
        let low = first[axis] as isize;
        for (side, layer) in [(Side::Low, low), (Side::High, low + whole.size[axis] as isize - 1)] {
            let Some(layer) = usize::try_from(layer).ok().filter(|&layer| layer < size[axis]) else { continue };
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let is_touched = |a: usize, b: usize| {
                let mut node = [0; 3];
                (node[axis], node[u], node[v]) = (layer, a, b);
                is_inside(node)
            };
            if (0..size[v]).any(|b| (0..size[u]).any(|a| is_touched(a, b))) {
                let beyond = if side == Side::Low { -0.5 } else { 0.5 };
                faces.push(CapPlane { axis, side, position: (layer as f64 + beyond) * grid.spacing[axis] });
            }
        }
    }
    faces
}

/// Returns the plane of a face. Its name is x0, x1, y0, y1, z0 or z1.
pub(crate) fn face_plane(face: &CapPlane) -> Bound {
    let (axis, is_high) = (DVec3::AXES[face.axis], face.side == Side::High);
    Bound {
        name: format!("{}{}", ["x", "y", "z"][face.axis], u8::from(is_high)),
        point: axis * face.position,
        normal: if is_high { axis } else { -axis },
    }
}
