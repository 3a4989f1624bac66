//! Which nodes of a label map are inside the object, one bit each.

use crate::Border;
use crate::bits::Bits;
use crate::runs::Runs;
use isoparticles_volume::{Geometry, Image};

/// The inside nodes of a grid.
pub struct Mask {
    /// The grid.
    pub geometry: Geometry,
    /// The nodes inside.
    pub inside: Bits,
}

impl From<&Image<bool>> for Mask {
    fn from(image: &Image<bool>) -> Self {
        Self { geometry: image.geometry.clone(), inside: Bits::of(image.data.len(), |n| image.data[n]) }
    }
}

impl Mask {
    /// The same with `margin` more nodes on each face: outside ones where the object is capped, else those of the nearest node.
    pub fn padded(&self, border: Border, margin: usize) -> Self {
        let [nx, ny, nz] = self.geometry.size;
        let geometry = self.geometry.padded(margin);
        let [px, py, pz] = geometry.size;
        let runs = Runs::of(self.geometry.size, |n| self.inside.holds(n));
        let is_open = border == Border::Open;
        let source = |padded: usize, n: usize| match padded.checked_sub(margin) {
            Some(i) if i < n => Some(i),
            Some(_) => is_open.then_some(n - 1),
            None => is_open.then_some(0),
        };
        let mut inside = Bits::none(geometry.voxel_count());
        for row in 0..py * pz {
            let Some((j, k)) = source(row % py, ny).zip(source(row / py, nz)) else { continue };
            for columns in runs.row(k * ny + j).iter().map(|run| run.columns()) {
                let first = if is_open && columns.start == 0 { 0 } else { columns.start + margin };
                let end = if is_open && columns.end == nx { px } else { columns.end + margin };
                inside.insert(row * px + first..row * px + end);
            }
        }
        Self { geometry, inside }
    }

    /// Whether a node lies in no block of 2 x 2 x 2 nodes of its own side: what an opening by such a block would remove. Nodes on the rim of
    /// the grid never do.
    pub fn is_thin(&self, node: usize) -> bool {
        let [nx, ny, nz] = self.geometry.size;
        let plane = nx * ny;
        let (i, j, k) = (node % nx, node / nx % ny, node / plane);
        let on_rim = i == 0 || j == 0 || k == 0 || i + 1 == nx || j + 1 == ny || k + 1 == nz;
        if on_rim {
            return false;
        }
        let own = self.inside.holds(node);
        let corners = [0, 1, nx, nx + 1, plane, plane + 1, plane + nx, plane + nx + 1];
        let is_own = |lowest: usize| corners.iter().all(|corner| self.inside.holds(lowest + corner) == own);
        !corners.iter().any(|corner| is_own(node - corner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_field::random::uniform;

    #[test]
    fn beyond_the_border_the_mask_is_empty_or_goes_on() {
        let size = [6, 5, 4];
        let geometry = Geometry::axis_aligned(size, DVec3::ONE);
        let data = (0..geometry.voxel_count()).map(|n| uniform(9, 0, n as u64) < 0.5).collect();
        let image = Image { geometry, data };
        let margin = 3;
        for border in [Border::Cap, Border::Open] {
            let padded = Mask::from(&image).padded(border, margin);
            let [px, py, pz] = padded.geometry.size;
            for n in 0..px * py * pz {
                let at = [n % px, n / px % py, n / (px * py)];
                let nearest = [0, 1, 2].map(|a| at[a].saturating_sub(margin).min(size[a] - 1));
                let is_within = [0, 1, 2].into_iter().all(|a| nearest[a] + margin == at[a]);
                let expected = (is_within || border == Border::Open) && image.at(nearest[0], nearest[1], nearest[2]);
                assert_eq!(padded.inside.holds(n), expected, "{border:?} {at:?}");
            }
        }
    }

    #[test]
    fn plates_and_slits_of_one_node_are_thin() {
        let geometry = Geometry::axis_aligned([9, 9, 9], DVec3::ONE);
        for is_slit in [false, true] {
            // a layer of one node at z = 2, one of two at z = 5 and 6
            let is_layer = |n: usize| matches!(n / 81, 2 | 5 | 6);
            let data = (0..geometry.voxel_count()).map(|n| is_layer(n) != is_slit).collect();
            let mask = Mask::from(&Image { geometry: geometry.clone(), data });
            for (k, is_thin) in [(1, false), (2, true), (3, false), (5, false), (6, false)] {
                assert_eq!(mask.is_thin(geometry.linear(4, 4, k)), is_thin, "slit {is_slit}, slice {k}");
                assert!(!mask.is_thin(geometry.linear(0, 4, k)));
            }
        }
    }
}
