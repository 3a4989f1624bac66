//! The occupancy is the fraction of each voxel that is inside the object. It is 0 or 1 for labels,
//! and a first-order estimate for a scalar volume.
//!
//! `--scale` smooths the occupancy rather than the intensity. Values far above or below the iso
//! value (metal, air) therefore have little effect. Labels and scalar volumes are handled alike.

use crate::Inside;
use crate::mask::Mask;
use isoparticles_volume::{Geometry, VoxelBox, Voxels};
use rayon::prelude::*;

/// Occupancy of a voxel that is entirely inside.
pub const WHOLE: u8 = u8::MAX;

/// Minimum occupancy of a voxel whose centre is inside.
const CENTRE_INSIDE: u8 = WHOLE / 2 + 1;

/// Occupancy of the voxels of a grid.
pub struct Occupancy {
    /// The grid.
    pub geometry: Geometry,
    /// Occupancy of each voxel (x fastest), 0 to [`WHOLE`].
    pub shares: Vec<u8>,
}

impl Occupancy {
    /// Returns the occupancy of a mask, 0 or [`WHOLE`].
    pub fn of_mask(mask: &Mask) -> Self {
        let mut shares = vec![0; mask.geometry.voxel_count()];
        shares.par_iter_mut().enumerate().for_each(|(n, share)| *share = if mask.inside.holds(n) { WHOLE } else { 0 });
        Self { geometry: mask.geometry.clone(), shares }
    }

    /// Estimates the occupancy of one side of an iso value. If the value exceeds the iso value by v
    /// at the voxel centre and changes by w across the voxel, the fraction 1/2 + v / w of the voxel
    /// is above the iso value.
    pub fn of_scalar(voxels: &Voxels, geometry: &Geometry, iso: f64, inside: Inside) -> Self {
        let [nx, ny, nz] = geometry.size;
        let plane = nx * ny;
        let sign = if inside == Inside::Above { 1.0 } else { -1.0 };
        let mut shares = vec![0; geometry.voxel_count()];
        shares.par_chunks_mut(plane).enumerate().for_each(|(k, own)| {
            let slice = |k: usize| {
                let mut values = vec![0.0; plane];
                voxels.copy_as_f32(k * plane, &mut values);
                values
            };
            let (below, here, above) = (slice(k.saturating_sub(1)), slice(k), slice((k + 1).min(nz - 1)));
            for (n, share) in own.iter_mut().enumerate() {
                let (i, j) = (n % nx, n / nx);
                let own = f64::from(here[n]);
                let (x, y) = (usize::from(i > 0), nx * usize::from(j > 0));
                let neighbours = [
                    [here[n - x], here[n + usize::from(i + 1 < nx)]],
                    [here[n - y], here[n + nx * usize::from(j + 1 < ny)]],
                    [below[n], above[n]],
                ];
                let neighbours = neighbours.map(|pair| pair.map(|near| f64::from(near) - iso));
                let width = change_across(own - iso, &neighbours);
                let value = sign * (own - iso);
                let part = (0.5 + value / width.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                let whole = (part * f64::from(WHOLE)).round() as u8;
                *share = if value > 0.0 { whole.max(CENTRE_INSIDE) } else { whole.min(CENTRE_INSIDE - 1) };
            }
        });
        Self { geometry: geometry.clone(), shares }
    }

    /// Returns whether the centre of a voxel is inside.
    pub fn is_inside(&self, voxel: usize) -> bool {
        self.shares[voxel] >= CENTRE_INSIDE
    }

    /// Returns the volume inside, mm^3.
    pub fn volume(&self) -> f64 {
        let sum: u64 = self.shares.par_iter().map(|&share| u64::from(share)).sum();
        sum as f64 / f64::from(WHOLE) * self.geometry.spacing.element_product()
    }

    /// Returns the occupancy on voxels twice as long along each axis. Voxels at the upper faces may
    /// extend beyond the grid.
    pub fn halved(&self) -> Self {
        let [nx, ny, nz] = self.geometry.size;
        let size = self.geometry.size.map(|n| n.div_ceil(2));
        let mut shares = vec![0; size.iter().product()];
        shares.par_iter_mut().enumerate().for_each(|(n, share)| {
            let (i, j, k) = (2 * (n % size[0]), 2 * (n / size[0] % size[1]), 2 * (n / (size[0] * size[1])));
            let (mut sum, mut count) = (0u32, 0);
            for k in k..(k + 2).min(nz) {
                for j in j..(j + 2).min(ny) {
                    let row = &self.shares[(k * ny + j) * nx..][..nx];
                    row[i..(i + 2).min(nx)]
                        .iter()
                        .for_each(|&share| (sum, count) = (sum + u32::from(share), count + 1));
                }
            }
            *share = (sum / count) as u8;
        });
        Self { geometry: Geometry { size, spacing: 2.0 * self.geometry.spacing, ..self.geometry.clone() }, shares }
    }

    /// Returns the bounding box of all voxels that are partly inside, or `None` if there are none.
    pub fn extent(&self) -> Option<VoxelBox> {
        let nx = self.geometry.size[0];
        VoxelBox::of_rows(self.geometry.size, |row| {
            let shares = &self.shares[row * nx..(row + 1) * nx];
            let first = shares.iter().position(|&share| share > 0)?;
            Some((first, shares.iter().rposition(|&share| share > 0)?))
        })
    }
}

/// Returns the change of the value across a voxel, summed over the axes. All values are relative to
/// the iso value; `neighbours` contains the values of the two neighbours along each axis.
///
/// Along an axis with a neighbour beyond the surface, the change is the difference from that
/// neighbour. Along the other axes, the change is the smaller of the two differences, limited to
/// the maximum change along the former axes, so that metal or air farther away has no effect. The
/// result is 0 if no neighbour is beyond the surface.
fn change_across(own: f64, neighbours: &[[f64; 2]; 3]) -> f64 {
    let beyond = |pair: &[f64; 2]| {
        pair.iter().filter(|&&near| near * own <= 0.0).map(|near| (near - own).abs()).fold(0.0, f64::max)
    };
    let largest = neighbours.iter().map(beyond).fold(0.0, f64::max);
    let along = |pair: &[f64; 2]| {
        let least = pair.iter().map(|near| (near - own).abs()).fold(f64::INFINITY, f64::min);
        if beyond(pair) > 0.0 { beyond(pair) } else { least.min(largest) }
    };
    neighbours.iter().map(along).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn occupancy_of_a_plane_is_the_share_below_it() {
        let geometry = Geometry::axis_aligned([4, 4, 8], DVec3::new(1.0, 2.0, 0.5));
        let values = (0..geometry.voxel_count()).map(|n| 10.0 * (n / 16) as f32).collect();
        for (inside, want) in
            [(Inside::Above, [0, 0, 0, 51, 255, 255, 255, 255]), (Inside::Below, [255, 255, 255, 204, 0, 0, 0, 0])]
        {
            let occupancy = Occupancy::of_scalar(&Voxels::F32(Vec::clone(&values)), &geometry, 33.0, inside);
            let column: Vec<u8> = (0..8).map(|k| occupancy.shares[16 * k + 5]).collect();
            assert_eq!(column, want, "{inside:?}");
            assert_eq!(occupancy.is_inside(16 * 3 + 5), inside == Inside::Below);
            let depth = if inside == Inside::Above { 4.2 } else { 3.8 };
            assert!((occupancy.volume() / (16.0 * depth) - 1.0).abs() < 1e-9);
        }
    }
}
