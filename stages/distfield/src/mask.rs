//! The mask of a label map: one bit per node, set if the node is inside the object.

use crate::bits::Bits;
use crate::runs::Runs;
use isoparticles_volume::{CutFaces, Geometry, Image};

/// The inside nodes of a grid.
pub struct Mask {
    /// The grid.
    pub geometry: Geometry,
    /// The inside nodes.
    pub inside: Bits,
}

impl From<&Image<bool>> for Mask {
    fn from(image: &Image<bool>) -> Self {
        Self { geometry: image.geometry.clone(), inside: Bits::of(image.data.len(), |n| image.data[n]) }
    }
}

impl Mask {
    /// Returns the mask extended by `margin` nodes on each face. Beyond a face where the volume was
    /// cut, the new nodes are outside; beyond the other faces, they copy the nearest node.
    pub fn padded(&self, margin: usize, cut: CutFaces) -> Self {
        let [nx, ny, nz] = self.geometry.size;
        let geometry = self.geometry.padded(margin);
        let [px, py, pz] = geometry.size;
        let runs = Runs::of(self.geometry.size, |n| self.inside.holds(n));
        let source = |padded: usize, n: usize, [low, high]: [bool; 2]| match padded.checked_sub(margin) {
            Some(i) if i < n => Some(i),
            Some(_) => (!high).then_some(n - 1),
            None => (!low).then_some(0),
        };
        let mut inside = Bits::none(geometry.voxel_count());
        for row in 0..py * pz {
            let Some((j, k)) = source(row % py, ny, cut[1]).zip(source(row / py, nz, cut[2])) else { continue };
            for columns in runs.row(k * ny + j).iter().map(|run| run.columns()) {
                let first = if columns.start == 0 && !cut[0][0] { 0 } else { columns.start + margin };
                let end = if columns.end == nx && !cut[0][1] { px } else { columns.end + margin };
                inside.insert(row * px + first..row * px + end);
            }
        }
        Self { geometry, inside }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use isoparticles_field::random::uniform;

    #[test]
    fn the_padded_mask_is_empty_only_beyond_cuts() {
        let size = [6, 5, 4];
        let geometry = Geometry::axis_aligned(size, DVec3::ONE);
        let data = (0..geometry.voxel_count()).map(|n| uniform(9, 0, n as u64) < 0.5).collect();
        let image = Image { geometry, data };
        let (margin, cut) = (3, [[false, true], [true, false], [false, false]]);
        let padded = Mask::from(&image).padded(margin, cut);
        let [px, py, pz] = padded.geometry.size;
        for n in 0..px * py * pz {
            let at = [n % px, n / px % py, n / (px * py)];
            let nearest = [0, 1, 2].map(|a| at[a].saturating_sub(margin).min(size[a] - 1));
            let is_beyond_cut = (0..3).any(|a| cut[a][0] && at[a] < margin || cut[a][1] && at[a] >= margin + size[a]);
            let expected = !is_beyond_cut && image.at(nearest[0], nearest[1], nearest[2]);
            assert_eq!(padded.inside.holds(n), expected, "{at:?}");
        }
    }
}
