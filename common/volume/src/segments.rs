//! What labels are called, and the layers that let segments overlap.
//!
//! 3D Slicer writes segments that overlap into several layers: one label volume each, on the same grid. A label then means something
//! within its layer alone; [`LayerLabel`] says both. A volume with one layer is the ordinary case and costs nothing more.

use crate::error::{Error, Result};
use crate::volume::Volume;
use crate::voxels::Voxels;
use serde::{Deserialize, Serialize};

/// Most names that an error message lists.
const MOST_LISTED: usize = 40;

/// A label and the layer that it lies in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct LayerLabel {
    /// The layer, counted from 0; 0 in a volume with one layer.
    pub layer: usize,
    /// The label, a value of that layer's voxels.
    pub label: i64,
}

/// A label with a name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Segment {
    /// What it is called, such as `left lung`.
    pub name: String,
    /// Where it lies.
    #[serde(flatten)]
    pub at: LayerLabel,
}

impl Volume {
    /// Number of layers, at least 1.
    pub fn layer_count(&self) -> usize {
        1 + self.more_layers.len()
    }

    /// The layers in order; the first one is [`Volume::voxels`].
    pub fn layers(&self) -> impl Iterator<Item = &Voxels> {
        std::iter::once(&self.voxels).chain(&self.more_layers)
    }

    /// What is assumed of NaN among labels, in words, if there is any.
    pub fn nan_remark(&self) -> Option<String> {
        let count: usize = self.layers().map(Voxels::nan_count).sum();
        (count > 0).then(|| format!("{count} voxels are NaN and taken as background (label 0)"))
    }

    /// The name of a label, if the file gives one.
    pub fn name_of(&self, at: LayerLabel) -> Option<&str> {
        self.segments.iter().find(|segment| segment.at == at).map(|segment| segment.name.as_str())
    }

    /// Every label with its layer, in increasing order, NaN as 0. Fails when another value is not a
    /// whole number.
    pub fn label_set(&self) -> Result<Vec<LayerLabel>> {
        let mut all = Vec::new();
        for (layer, voxels) in self.layers().enumerate() {
            all.extend(voxels.label_set()?.into_iter().map(|label| LayerLabel { layer, label }));
        }
        Ok(all)
    }

    /// The segment of a name, letter by letter or else in other case.
    ///
    /// # Errors
    /// When no segment has the name, or more than one has it; the error lists what there is.
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

    /// Where a label lies, for a label given as a number.
    ///
    /// # Errors
    /// When several layers hold the label, so that its number does not say which one is meant, and when a value is no label. A label
    /// that occurs nowhere is taken to be in the first layer.
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

    /// Which voxels carry one of the labels, in any layer: the union where segments overlap.
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

    /// Names with their numbers, for a message.
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
    use crate::geometry::Geometry;
    use glam::DVec3;

    /// Two layers: lung 1 and heart 2, and a vessel 1 that lies in both.
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
    fn several_segments_are_their_union() {
        let volume = overlapping();
        let at = |name: &str| volume.segment_named(name).expect("there");
        let mask = volume.label_mask(&[at("heart"), at("vessel")]);
        assert_eq!(mask, [false, true, true, true, false, false, false, false]);
        assert_eq!(volume.label_mask(&[at("vessel")]), [false, true, true, false, false, false, false, false]);
    }
}
