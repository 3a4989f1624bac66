//! Label layers of segments. A segment that overlaps others goes to another layer, so every
//! segment keeps all its voxels.

use crate::error::{Result, bad};
use crate::geometry::Geometry;
use crate::limit::voxel_count;
use crate::segments::{LayerLabel, Segment};
use crate::volume::Volume;
use crate::voxels::Voxels;
use isoparticles_file::limit::check_memory;
use rayon::prelude::*;
use std::path::Path;

/// A number type for labels.
pub(super) trait Label: Copy + Default + PartialEq + Send + Sync + TryFrom<u16> {
    /// Returns the labels as voxels.
    fn voxels(labels: Vec<Self>) -> Voxels;
}

impl Label for u8 {
    fn voxels(labels: Vec<Self>) -> Voxels {
        Voxels::U8(labels)
    }
}

impl Label for u16 {
    fn voxels(labels: Vec<Self>) -> Voxels {
        Voxels::U16(labels)
    }
}

/// The voxels of a segment in one slice: the index of the slice, and a mask of its pixels.
pub(super) type Mask = (usize, Vec<bool>);

/// The segments added so far.
pub(super) struct Layers<'a, L> {
    path: &'a Path,
    grid: Geometry,
    layers: Vec<Vec<L>>,
    segments: Vec<Segment>,
    empty: Vec<String>,
}

impl<'a, L: Label> Layers<'a, L> {
    /// Creates layers without segments. `path` is the file of the segments.
    ///
    /// # Errors
    /// If the masks of a segment and a layer do not fit in memory.
    pub(super) fn new(path: &'a Path, grid: Geometry) -> Result<Self> {
        let count = voxel_count(path, grid.size)?;
        check_memory(path, count.saturating_mul(1 + size_of::<L>()) as u64)?;
        Ok(Self { path, grid, layers: Vec::new(), segments: Vec::new(), empty: Vec::new() })
    }

    /// Adds a segment. `masks` has at most one mask per slice.
    pub(super) fn add(&mut self, number: u16, name: String, masks: &[Mask]) -> Result<()> {
        let Some(label) = L::try_from(number).ok().filter(|label| *label != L::default()) else {
            return Err(bad(
                self.path,
                format!("has the segment '{name}' with number {number}"),
                "the numbers of segments start at 1",
                "write the file again",
            ));
        };
        let plane = self.grid.size[0] * self.grid.size[1];
        let is_free = |layer: &Vec<L>| {
            masks.par_iter().all(|(slice, mask)| {
                let labels = &layer[slice * plane..(slice + 1) * plane];
                labels.iter().zip(mask).all(|(label, inside)| !inside || *label == L::default())
            })
        };
        let layer = self.layers.iter().position(is_free).unwrap_or(self.layers.len());
        if layer == self.layers.len() {
            self.layers.push(self.empty_layer()?);
        }
        let mut slices: Vec<Option<&mut [L]>> = self.layers[layer].chunks_exact_mut(plane).map(Some).collect();
        let own: Vec<_> =
            masks.iter().filter_map(|(slice, mask)| Some((slices.get_mut(*slice)?.take()?, mask))).collect();
        let painted: usize = own
            .into_par_iter()
            .map(|(labels, mask)| {
                labels.iter_mut().zip(mask).filter(|(_, inside)| **inside).map(|(to, _)| *to = label).count()
            })
            .sum();
        if painted == 0 {
            self.empty.push(name.clone());
        }
        self.segments.push(Segment { name, at: LayerLabel { layer, label: number.into() } });
        Ok(())
    }

    fn empty_layer(&self) -> Result<Vec<L>> {
        let count = voxel_count(self.path, self.grid.size)?;
        check_memory(self.path, count.saturating_mul(size_of::<L>()) as u64)?;
        Ok(vec![L::default(); count])
    }

    /// Returns the volume of all segments.
    pub(super) fn join(mut self) -> Result<Volume> {
        if self.layers.is_empty() {
            self.layers.push(self.empty_layer()?);
        }
        let Self { grid, layers, segments, empty, .. } = self;
        let mut remarks = Vec::new();
        if !empty.is_empty() {
            remarks.push(format!("{} of {} segments are empty: {}", empty.len(), segments.len(), empty.join(", ")));
        }
        let mut layers = layers.into_iter().map(L::voxels);
        let first = layers.next().unwrap_or_else(|| L::voxels(Vec::new()));
        Ok(Volume { more_layers: layers.collect(), segments, remarks, ..Volume::new(grid, first) })
    }
}
