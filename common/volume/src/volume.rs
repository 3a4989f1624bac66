//! Volumes as read from files, with voxels in their original number type, and the lookup of labels
//! by name or number.

use crate::error::{Error, Result};
use crate::geometry::{Geometry, Space};
use crate::segments::{LayerLabel, Segment};
use crate::voxels::{Blocks, Pooling, Voxels};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of segments that an error message lists. At an average of 20 characters per name
/// and label, the list fills eight lines of 100 columns.
const MOST_LISTED: usize = 40;

/// A volume with its geometry. The x axis varies fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Grid of the voxels.
    pub geometry: Geometry,
    /// World frame of the file. The grid is in LPS even if the file is in RAS.
    pub file_space: Space,
    /// Voxel values of the first layer.
    pub voxels: Voxels,
    /// The other layers, which are on the same grid and contain overlapping segments. Only
    /// `.seg.nrrd` files of 3D Slicer, folders of masks, and `.vti` files converted from them have
    /// such layers.
    pub more_layers: Vec<Voxels>,
    /// The named labels, in the same order as in the file.
    pub segments: Vec<Segment>,
    /// Messages to the user about assumptions made by the reader.
    pub remarks: Vec<String>,
}

impl Volume {
    /// Creates a volume with one layer, without names or remarks. `voxels` must contain one value
    /// per voxel of `geometry`.
    pub fn new(geometry: Geometry, voxels: Voxels) -> Self {
        Self {
            file_space: geometry.space,
            geometry,
            voxels,
            more_layers: Vec::new(),
            segments: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// Returns the volume with its grid converted to LPS from any anatomical frame.
    #[must_use]
    pub fn in_lps(self) -> Self {
        Self { geometry: self.geometry.in_space(Space::Lps), ..self }
    }

    /// Crops all layers in place to the box of `size` voxels whose first voxel is `first`.
    pub fn crop(&mut self, first: [usize; 3], size: [usize; 3]) {
        let whole = self.geometry.size;
        for voxels in std::iter::once(&mut self.voxels).chain(&mut self.more_layers) {
            voxels.crop(whole, first, size);
        }
        self.geometry = self.geometry.cropped(first, size);
    }

    /// Replaces each block of `factors` voxels by one voxel at the centre of the block, in all
    /// layers. Drops the voxels at the far ends of the axes that do not fill a block.
    pub fn downsample(&mut self, factors: [usize; 3], how: Pooling) {
        let blocks = Blocks { grid: self.geometry.size, factors };
        for voxels in std::iter::once(&mut self.voxels).chain(&mut self.more_layers) {
            *voxels = voxels.pool(blocks, how);
        }
        self.geometry = self.geometry.downsampled(factors);
    }

    /// Returns the number of layers, which is at least 1.
    pub fn layer_count(&self) -> usize {
        1 + self.more_layers.len()
    }

    /// Returns the layers in order. The first layer is [`Volume::voxels`].
    pub fn layers(&self) -> impl Iterator<Item = &Voxels> {
        std::iter::once(&self.voxels).chain(&self.more_layers)
    }

    /// Returns a remark on the treatment of NaN voxels, or `None` if no voxel is NaN.
    pub fn nan_remark(&self) -> Option<String> {
        let count: usize = self.layers().map(Voxels::nan_count).sum();
        (count > 0).then(|| format!("{count} voxels are NaN and are treated as background (label 0)"))
    }

    /// Returns the name of a label, if it has one.
    pub fn name_of(&self, at: LayerLabel) -> Option<&str> {
        self.segments.iter().find(|segment| segment.at == at).map(|segment| segment.name.as_str())
    }

    /// Returns all labels and their layers, sorted by layer and then by label. NaN counts as label
    /// 0.
    ///
    /// # Errors
    /// If a value is neither an integer nor NaN.
    pub fn label_set(&self) -> Result<Vec<LayerLabel>> {
        let mut all = Vec::new();
        for (layer, voxels) in self.layers().enumerate() {
            all.extend(voxels.label_set()?.into_iter().map(|label| LayerLabel { layer, label }));
        }
        Ok(all)
    }

    /// Finds the segment called `name`. If no name matches exactly, the search ignores case.
    ///
    /// # Errors
    /// If no segment or several segments match. The error lists the candidates.
    pub fn segment_named(&self, name: &str) -> Result<LayerLabel> {
        let exact: Vec<&Segment> = self.segments.iter().filter(|segment| segment.name == name).collect();
        let found = if exact.is_empty() {
            let lower = name.to_lowercase();
            self.segments.iter().filter(|segment| segment.name.to_lowercase() == lower).collect()
        } else {
            exact
        };
        match found.as_slice() {
            [one] => Ok(one.at),
            [] => Err(Error::SegmentMissing { name: name.to_owned(), present: self.listed(&self.segments) }),
            several => Err(Error::SegmentAmbiguous {
                name: name.to_owned(),
                count: several.len(),
                present: self.listed(several.iter().copied()),
            }),
        }
    }

    /// Returns a label with the layer that contains it. Uses the first layer if no layer contains
    /// the label.
    ///
    /// # Errors
    /// If several layers contain the label, or if the volume has several layers and a value is not
    /// a label.
    pub fn label_numbered(&self, label: i64) -> Result<LayerLabel> {
        if self.more_layers.is_empty() {
            return Ok(LayerLabel { layer: 0, label });
        }
        let found: Vec<LayerLabel> = self.label_set()?.into_iter().filter(|at| at.label == label).collect();
        match found.as_slice() {
            [] => Ok(LayerLabel { layer: 0, label }),
            [one] => Ok(*one),
            _ => {
                let segments: Vec<&Segment> =
                    self.segments.iter().filter(|segment| segment.at.label == label).collect();
                Err(Error::LabelAmbiguous {
                    label,
                    found: found.len(),
                    layers: self.layer_count(),
                    present: self.listed(segments),
                })
            }
        }
    }

    /// Counts the voxels by the numbers that `number` assigns to their labels in all layers. Each
    /// set of numbers is in ascending order, without 0 and duplicates.
    pub fn combinations(&self, number: impl Fn(LayerLabel) -> u16 + Sync) -> BTreeMap<Vec<u16>, usize> {
        let [nx, ny, nz] = self.geometry.size;
        let of_slice = |k: usize| {
            // for each voxel, the numbers in all layers
            let layers = self.layer_count();
            let mut numbers = vec![0; nx * ny * layers];
            for (layer, voxels) in self.layers().enumerate() {
                let mut voxel = 0;
                voxels.each_run(k * nx * ny..(k + 1) * nx * ny, |label, count| {
                    let own = label.map_or(0, |label| number(LayerLabel { layer, label }));
                    (voxel..voxel + count).for_each(|voxel| numbers[voxel * layers + layer] = own);
                    voxel += count;
                });
            }
            let mut counts: BTreeMap<Vec<u16>, usize> = BTreeMap::new();
            let numbers: Vec<&[u16]> = numbers.chunks(layers).collect();
            for run in numbers.chunk_by(|a, b| a == b) {
                let set: BTreeSet<u16> = run[0].iter().copied().filter(|&number| number != 0).collect();
                *counts.entry(set.into_iter().collect()).or_default() += run.len();
            }
            counts
        };
        (0..nz).into_par_iter().map(of_slice).reduce(BTreeMap::new, |mut all, counts| {
            counts.into_iter().for_each(|(set, count)| *all.entry(set).or_default() += count);
            all
        })
    }

    /// Returns a mask of the voxels that have any of the given labels in the layer of that label.
    pub fn label_mask(&self, labels: &[LayerLabel]) -> Vec<bool> {
        let of_layer =
            |layer: usize| -> Vec<i64> { labels.iter().filter(|at| at.layer == layer).map(|at| at.label).collect() };
        let mut mask = self.voxels.label_mask(&of_layer(0));
        for (layer, voxels) in self.layers().enumerate().skip(1) {
            let wanted = of_layer(layer);
            if !wanted.is_empty() {
                mask.iter_mut().zip(voxels.label_mask(&wanted)).for_each(|(mask, more)| *mask |= more);
            }
        }
        mask
    }

    /// Lists segments and their labels for a message.
    fn listed<'a>(&self, segments: impl IntoIterator<Item = &'a Segment>) -> String {
        let of = |segment: &Segment| match self.more_layers.is_empty() {
            true => format!("'{}' ({})", segment.name, segment.at.label),
            false => format!("'{}' ({} of layer {})", segment.name, segment.at.label, segment.at.layer),
        };
        let all: Vec<String> = segments.into_iter().map(of).collect();
        match all.len() {
            n if n > MOST_LISTED => format!("{}, ... ({n} in all)", all[..MOST_LISTED].join(", ")),
            _ => all.join(", "),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};

    /// Creates a volume with two layers. The first contains a lung (1) and a heart (2), and the
    /// second a vessel (1) that overlaps both.
    fn overlapping() -> Volume {
        let segment = |name: &str, layer, label| Segment { name: name.to_owned(), at: LayerLabel { layer, label } };
        Volume {
            more_layers: vec![Voxels::U8(vec![0, 1, 1, 0, 0, 0, 0, 0])],
            segments: vec![segment("Lung", 0, 1), segment("heart", 0, 2), segment("vessel", 1, 1)],
            ..Volume::new(Geometry::axis_aligned([2, 2, 2], DVec3::ONE), Voxels::U8(vec![1, 1, 2, 2, 0, 0, 0, 0]))
        }
    }

    #[test]
    fn segments_are_found_by_name_and_where_it_is_clear_by_number() {
        let volume = overlapping();
        assert_eq!(volume.segment_named("vessel").expect("there"), LayerLabel { layer: 1, label: 1 });
        assert_eq!(volume.segment_named("lung").expect("in other case"), LayerLabel { layer: 0, label: 1 });
        assert_eq!(volume.label_numbered(2).expect("in one layer"), LayerLabel { layer: 0, label: 2 });
        let error = volume.label_numbered(1).expect_err("in two layers");
        assert!(error.remedy().contains("'Lung' (1 of layer 0), 'vessel' (1 of layer 1)"), "{error}");
        let error = volume.segment_named("liver").expect_err("not there");
        assert!(error.remedy().contains("'heart'"), "{error}");
        assert_eq!(volume.label_numbered(9).expect("nowhere"), LayerLabel { layer: 0, label: 9 });
        let twice = Volume { segments: [volume.segments.clone(), volume.segments.clone()].concat(), ..volume };
        assert!(twice.segment_named("heart").is_err());
    }

    #[test]
    fn voxels_are_counted_by_their_labels_in_all_layers() {
        let number = |at: LayerLabel| if at.label == 0 { 0 } else { 10 * at.layer as u16 + at.label as u16 };
        let counts = [(vec![], 4), (vec![1], 1), (vec![1, 11], 1), (vec![2], 1), (vec![2, 11], 1)];
        assert_eq!(overlapping().combinations(number), BTreeMap::from(counts));
        let same = [(vec![], 4), (vec![7], 4)];
        assert_eq!(overlapping().combinations(|at| 7 * u16::from(at.label != 0)), BTreeMap::from(same));
    }

    #[test]
    fn blocks_of_voxels_keep_their_place_in_the_world() {
        let geometry = Geometry {
            directions: DMat3::from_cols(DVec3::new(0.8, 0.6, 0.0), DVec3::new(-0.6, 0.8, 0.0), DVec3::Z),
            origin: DVec3::new(-120.5, 33.25, 700.0),
            ..Geometry::axis_aligned([7, 8, 5], DVec3::new(0.7, 0.9, 2.5))
        };
        let mut volume = Volume::new(geometry.clone(), Voxels::U8(vec![0; 280]));
        volume.more_layers.push(volume.voxels.clone());
        volume.downsample([3, 4, 1], Pooling::MostFrequent);
        let small = &volume.geometry;
        assert_eq!((small.size, volume.layers().map(Voxels::len).collect()), ([2, 2, 5], vec![20, 20]));
        for n in 0..20 {
            let [i, j, k] = [n % 2 * 3, n / 2 % 2 * 4, n / 4];
            let of_block = (0..12).map(|m| geometry.linear(i + m % 3, j + m / 3, k));
            let mean = of_block.map(|n| geometry.grid_to_world(geometry.node_to_grid(n))).sum::<DVec3>() / 12.0;
            assert!(small.grid_to_world(small.node_to_grid(n)).distance(mean) < 1e-9, "block {n}");
        }
    }

    #[test]
    fn several_segments_are_their_union() {
        let volume = overlapping();
        let at = |name: &str| volume.segment_named(name).expect("there");
        let mask = volume.label_mask(&[at("heart"), at("vessel")]);
        assert_eq!(mask, [false, true, true, true, false, false, false, false]);
        assert_eq!(volume.label_mask(&[at("vessel")]), [false, true, true, false, false, false, false, false]);
    }
}
