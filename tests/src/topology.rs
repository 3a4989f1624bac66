//! Computes the digital topology of a set of voxels: the components, cavities and Euler
//! characteristic of the cubical complex. This module shares no code with the meshing stages, so
//! tests can compare meshes with its results.
//!
//! For a solid with `b0` components, `b2` cavities and `b1` handles, `euler = b0 - b1 + b2`. The
//! genera of all its `b0 + b2` surfaces sum to `b1`.

use isoparticles_volume::Image;

/// Topology of a union of closed voxels. Voxels are connected across faces, edges and corners.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Topology {
    /// Connected components of the object.
    pub components: usize,
    /// Components of the background that do not reach the border. The background is connected
    /// across faces only.
    pub cavities: usize,
    /// Euler characteristic of the solid.
    pub euler: i64,
}

impl Topology {
    /// Returns the number of handles, which is the sum of the genera of all surfaces.
    pub fn handles(&self) -> i64 {
        self.components as i64 + self.cavities as i64 - self.euler
    }

    /// Returns the number of closed surfaces.
    pub fn surfaces(&self) -> usize {
        self.components + self.cavities
    }
}

/// Returns the topology of the voxels that are `true`. Everything outside the image is background.
pub fn of_voxels(mask: &Image<bool>) -> Topology {
    let [nx, ny, nz] = mask.geometry.size;
    let padded = mask.geometry.padded(1);
    let mut inside = vec![false; padded.voxel_count()];
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                inside[padded.linear(i + 1, j + 1, k + 1)] = mask.at(i, j, k);
            }
        }
    }
    let every_neighbour = offsets(|taxicab| taxicab > 0);
    let face_neighbours = offsets(|taxicab| taxicab == 1);
    let components = count_pieces(&inside, padded.size, &every_neighbour);
    let background: Vec<bool> = inside.iter().map(|v| !v).collect();
    let cavities = count_pieces(&background, padded.size, &face_neighbours) - 1;
    Topology { components, cavities, euler: euler(&inside, padded.size) }
}

/// Returns the Euler characteristic of the cubical complex: vertices - edges + faces - voxels. A
/// cell belongs to the complex if at least one voxel that contains it is inside.
fn euler(inside: &[bool], size: [usize; 3]) -> i64 {
    let stride = [1, size[0], size[0] * size[1]];
    let mut sum = 0;
    for k in 1..size[2] {
        for j in 1..size[1] {
            for i in 1..size[0] {
                let here = i + j * stride[1] + k * stride[2];
                // Bit a of `cell` is set if the cell extends along axis a. Along such an axis, all
                // voxels that contain the cell have the index of `here`. Along the other axes, the
                // voxel at `here` and the voxel before it contain the cell.
                for cell in 0..8_u32 {
                    let present = (0..8_u32).filter(|corner| corner & cell == 0).any(|corner| {
                        inside[here - (0..3).map(|a| ((corner >> a & 1) as usize) * stride[a]).sum::<usize>()]
                    });
                    if present {
                        sum += if cell.count_ones() % 2 == 0 { 1 } else { -1 };
                    }
                }
            }
        }
    }
    sum
}

fn offsets(accept: impl Fn(i64) -> bool) -> Vec<[i64; 3]> {
    let range = -1..=1_i64;
    let mut offsets = Vec::new();
    for z in range.clone() {
        for y in range.clone() {
            for x in range.clone() {
                if accept(x.abs() + y.abs() + z.abs()) {
                    offsets.push([x, y, z]);
                }
            }
        }
    }
    offsets
}

fn count_pieces(member: &[bool], size: [usize; 3], neighbours: &[[i64; 3]]) -> usize {
    let mut seen = vec![false; member.len()];
    let mut stack = Vec::new();
    let mut pieces = 0;
    for start in 0..member.len() {
        if !member[start] || seen[start] {
            continue;
        }
        pieces += 1;
        seen[start] = true;
        stack.push(start);
        while let Some(voxel) = stack.pop() {
            let at = [voxel % size[0], voxel / size[0] % size[1], voxel / (size[0] * size[1])];
            for offset in neighbours {
                let moved = [0, 1, 2].map(|a| at[a] as i64 + offset[a]);
                if (0..3).any(|a| moved[a] < 0 || moved[a] >= size[a] as i64) {
                    continue;
                }
                let next = moved[0] as usize + size[0] * (moved[1] as usize + size[1] * moved[2] as usize);
                if member[next] && !seen[next] {
                    seen[next] = true;
                    stack.push(next);
                }
            }
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Options, Shape, build};
    use crate::volume;
    use glam::DVec3;
    use isoparticles_volume::Geometry;

    #[test]
    fn solids_have_the_topology_their_truth_states() {
        let grid = Geometry::axis_aligned([40, 40, 40], DVec3::ONE);
        for shape in [Shape::Ball, Shape::Torus, Shape::BumpyTorus, Shape::ThinShell, Shape::TwoBalls, Shape::Cylinder]
        {
            let scene = build(shape, &grid, &Options::for_grid(&grid));
            let truth = scene.truth();
            let topology = of_voxels(&volume::mask(scene.as_ref(), &grid));
            assert_eq!(topology.handles(), truth.genus.unwrap() as i64, "{shape:?}: {topology:?}");
            assert_eq!(topology.surfaces(), truth.components.unwrap(), "{shape:?}: {topology:?}");
        }
    }
}
