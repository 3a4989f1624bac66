//! Label layers of parts, such as masks or the segments of a file. A part that overlaps others goes
//! to another layer, so every part keeps all its voxels.

use crate::error::{Result, bad};
use crate::geometry::Geometry;
use crate::limit::voxel_count;
use crate::segments::{LayerLabel, Segment};
use crate::volume::Volume;
use crate::voxels::Voxels;
use isoparticles_file::limit::check_memory;
use std::path::Path;

/// A number type for labels.
pub(crate) trait Label: Copy + Default + PartialEq + Send + Sync + TryFrom<u16> {
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

/// The voxels of a part.
pub(crate) trait Part {
    /// Returns whether a layer is 0 throughout the part.
    fn is_free<L: Label>(&self, layer: &[L]) -> bool;

    /// Sets the voxels of the part to a label. Returns their number.
    fn paint<L: Label>(&self, layer: &mut [L], label: L) -> usize;
}

/// The parts added so far. All layers have the same grid.
#[derive(Default)]
pub(crate) struct Layers<L> {
    layers: Vec<Vec<L>>,
    segments: Vec<Segment>,
    /// The names of the parts without a voxel.
    empty: Vec<String>,
}

impl<L: Label> Layers<L> {
    /// Returns the number of parts.
    pub(crate) fn part_count(&self) -> usize {
        self.segments.len()
    }

    /// Adds a part with the label `number`. `path` is its file.
    ///
    /// # Errors
    /// If the number is 0 or too large for a label, or if another layer does not fit in memory.
    pub(crate) fn add(
        &mut self,
        path: &Path,
        grid: &Geometry,
        (number, name): (u16, String),
        part: &impl Part,
    ) -> Result<()> {
        let Some(label) = L::try_from(number).ok().filter(|label| *label != L::default()) else {
            return Err(bad(
                path,
                format!("has the segment '{name}' with number {number}"),
                "the numbers of segments start at 1",
                "write the file again",
            ));
        };
        let layer = self.layers.iter().position(|layer| part.is_free(layer)).unwrap_or(self.layers.len());
        if layer == self.layers.len() {
            self.layers.push(empty_layer(path, grid)?);
        }
        if part.paint(&mut self.layers[layer], label) == 0 {
            self.empty.push(name.clone());
        }
        self.segments.push(Segment { name, at: LayerLabel { layer, label: number.into() } });
        Ok(())
    }

    /// Returns the volume of all parts. `kind` is what a remark calls them.
    ///
    /// # Errors
    /// If there are no parts, and an empty layer does not fit in memory.
    pub(crate) fn join(mut self, path: &Path, grid: Geometry, kind: &str) -> Result<Volume> {
        if self.layers.is_empty() {
            self.layers.push(empty_layer(path, &grid)?);
        }
        let Self { layers, segments, empty } = self;
        let mut remarks = Vec::new();
        if !empty.is_empty() {
            remarks.push(format!("{} of {} {kind} are empty: {}", empty.len(), segments.len(), empty.join(", ")));
        }
        let mut layers = layers.into_iter().map(L::voxels);
        let first = layers.next().unwrap_or_else(|| L::voxels(Vec::new()));
        Ok(Volume { more_layers: layers.collect(), segments, remarks, ..Volume::new(grid, first) })
    }
}

fn empty_layer<L: Label>(path: &Path, grid: &Geometry) -> Result<Vec<L>> {
    let count = voxel_count(path, grid.size)?;
    check_memory(path, count.saturating_mul(size_of::<L>()) as u64)?;
    Ok(vec![L::default(); count])
}
