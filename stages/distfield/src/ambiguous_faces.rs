//! Finds ambiguous faces: grid faces whose opposite corners are on the same side and whose adjacent
//! corners are not. At such a face, two parts of the object touch only along a voxel edge.
//!
//! The signs at the nodes do not determine whether these parts are connected. Marching cubes uses
//! the sign of F at the saddle of the face. [`make_agree`] changes F until its saddle has the same
//! sign as the saddle of the source. For labels, [`crate::labels`] states which parts the source
//! connects.

use isoparticles_field::marching_cubes::saddle_value;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// An ambiguous face: four nodes of a grid face, with opposite nodes on the same side and adjacent
/// nodes on different sides.
#[derive(Clone, Copy, Debug)]
pub struct AmbiguousFace {
    /// The two nodes inside the object.
    pub inside: [usize; 2],
    /// The two nodes outside.
    pub outside: [usize; 2],
    /// True if the inside nodes are connected across the face.
    pub joined: bool,
}

/// Factor by which each pass multiplies the values at the two nodes to be connected and divides the
/// values at the other two nodes. For `heart_ct` at iso value 250, the 99th percentile of the shift
/// of the zero set is 0.0526 voxel with a factor of 1.02 and 0.0493 voxel with 1.005.
const TIP_FACTOR: f32 = 1.005;

/// Maximum number of passes over the faces. The sign at the saddle depends on the ratio of the two
/// products of the values at opposite corners. One pass changes this ratio by a factor of
/// `TIP_FACTOR^4` = 1.02, and 100 passes by a factor of seven. Faces that share nodes can undo each
/// other's changes.
const MOST_PASSES: usize = 100;

/// Returns the ambiguous faces of an implicit function, given by its values at the nodes (negative
/// inside). The saddle of each face decides whether its inside nodes are connected.
pub fn ambiguous_faces(nodes: &Image<f32>) -> Vec<AmbiguousFace> {
    let [nx, ny, nz] = nodes.geometry.size;
    let (data, stride) = (&nodes.data, [1, nx, nx * ny]);
    (0..nz)
        .into_par_iter()
        .flat_map_iter(|k| {
            let mut found = Vec::new();
            for (axis, last) in [(0, nz - 1), (1, nz - 1), (2, nz)] {
                if k >= last {
                    continue;
                }
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let rows = ny - usize::from(axis != 1);
                let columns = nx - usize::from(axis != 0);
                for j in 0..rows {
                    for at in (k * ny + j) * nx..(k * ny + j) * nx + columns {
                        let corners = [at, at + stride[u], at + stride[u] + stride[v], at + stride[v]];
                        let side = corners.map(|n| data[n] < 0.0);
                        if side[0] == side[2] && side[1] == side[3] && side[0] != side[1] {
                            let (even, odd) = ([corners[0], corners[2]], [corners[1], corners[3]]);
                            let (inside, outside) = if side[0] { (even, odd) } else { (odd, even) };
                            found.push(AmbiguousFace { inside, outside, joined: is_joined(nodes, inside, outside) });
                        }
                    }
                }
            }
            found
        })
        .collect()
}

fn is_joined(nodes: &Image<f32>, inside: [usize; 2], outside: [usize; 2]) -> bool {
    saddle_value(nodes, inside, outside) < 0.0
}

/// Changes `field` at ambiguous faces whose saddle disagrees with `joined`, without lowering |F|
/// below `least` at any node. Returns the number of faces that still disagree.
pub fn make_agree(
    field: &mut Image<f32>,
    ambiguous_faces: &[AmbiguousFace],
    least: &(impl Fn(usize) -> f32 + Sync),
) -> usize {
    let mut differing = 0;
    for _ in 0..MOST_PASSES {
        differing = 0;
        for AmbiguousFace { inside, outside, joined } in ambiguous_faces {
            if is_joined(field, *inside, *outside) == *joined {
                continue;
            }
            differing += 1;
            let (winners, losers) = if *joined { (inside, outside) } else { (outside, inside) };
            for &node in winners {
                field.data[node] *= TIP_FACTOR;
            }
            for &node in losers {
                let value = field.data[node];
                field.data[node] = (value.abs() / TIP_FACTOR).max(least(node)).copysign(value);
            }
        }
        if differing == 0 {
            break;
        }
    }
    differing
}
