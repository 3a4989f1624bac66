//! The voxels of a segment as masks of slices.

use crate::error::Result;
use crate::geometry::Geometry;
use crate::layers::{Label, Part};
use crate::limit::voxel_count;
use isoparticles_file::limit::check_memory;
use rayon::prelude::*;
use std::path::Path;

/// The voxels of a segment in one slice: the index of the slice, and a mask of its pixels.
pub(super) type Mask = (usize, Vec<bool>);

/// The voxels of a segment, with at most one mask per slice.
pub(super) struct Masks<'a> {
    masks: &'a [Mask],
    /// Number of pixels of a slice.
    plane: usize,
}

impl<'a> Masks<'a> {
    pub(super) fn new(masks: &'a [Mask], grid: &Geometry) -> Self {
        Self { masks, plane: grid.size[0] * grid.size[1] }
    }
}

impl Part for Masks<'_> {
    fn is_free<L: Label>(&self, layer: &[L]) -> bool {
        self.masks.par_iter().all(|(slice, mask)| {
            let labels = &layer[slice * self.plane..(slice + 1) * self.plane];
            labels.iter().zip(mask).all(|(label, inside)| !inside || *label == L::default())
        })
    }

    fn paint<L: Label>(&self, layer: &mut [L], label: L) -> usize {
        let mut slices: Vec<Option<&mut [L]>> = layer.chunks_exact_mut(self.plane).map(Some).collect();
        let own: Vec<_> =
            self.masks.iter().filter_map(|(slice, mask)| Some((slices.get_mut(*slice)?.take()?, mask))).collect();
        let painted = own.into_par_iter().map(|(labels, mask)| {
            labels.iter_mut().zip(mask).filter(|(_, inside)| **inside).map(|(to, _)| *to = label).count()
        });
        painted.sum()
    }
}

/// Fails unless the masks of a segment and a layer of type `L` fit in memory.
pub(super) fn check_room<L: Label>(path: &Path, grid: &Geometry) -> Result<()> {
    let count = voxel_count(path, grid.size)?;
    Ok(check_memory(path, count.saturating_mul(1 + size_of::<L>()) as u64)?)
}
