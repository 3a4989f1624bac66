//! Determines the scale of the interface of each pair of materials, from a base scale and the edge
//! lengths of `--size`.

use crate::choose::{FINE_ENOUGH, LEAST_SCALE};
use crate::scale::{SCALE_OVER_SIZE, Scale};
use isoparticles_field::materials::MaterialId;
use isoparticles_stage::material_sizes::Given;

/// The scales of all pairs of materials.
#[derive(Clone, Debug)]
pub struct Scales {
    /// The scale of pairs without an edge length, mm.
    base: f64,
    /// Edge lengths of single materials.
    given: Given,
    /// The minimum scale of pairs with an edge length, mm.
    smallest: f64,
    /// Whether to keep parts that are too thin for a mesh of the edge length that matches the
    /// scale.
    pub(super) keep_thin: bool,
}

impl Scales {
    /// Returns the same scale for all pairs of materials.
    pub fn same(scale: Scale) -> Self {
        Self { base: scale.length, given: Given::default(), smallest: 0.0, keep_thin: scale.keep_thin }
    }

    /// Derives the scales from edge lengths of materials. `base` is the scale of pairs without an
    /// edge length; if it is 0, they use 2.7 voxels. `voxel` is the mean spacing in mm. Returns
    /// `None` if no pair needs a scale: every voxel centre then stays in its material.
    pub fn new(base: Scale, given: Given, voxel: f64) -> Option<Self> {
        let smallest = LEAST_SCALE * voxel;
        let needs = base.length > 0.0 || given.largest().is_some_and(|size| size > FINE_ENOUGH * voxel);
        let length = if base.length > 0.0 { base.length } else { smallest };
        needs.then_some(Self { base: length, given, smallest, keep_thin: base.keep_thin })
    }

    /// Returns the scale (mm) of the interface of two materials, given by the smaller of their edge
    /// lengths. Edge lengths of pairs have no effect, because they would require comparing each
    /// material with all others at every scale.
    pub(super) fn of_pair(&self, a: u16, b: u16) -> f64 {
        let own = [a, b].map(|id| self.own(MaterialId(id)));
        own.into_iter().flatten().min_by(f64::total_cmp).unwrap_or(self.base)
    }

    /// Returns the shortest scale (mm) of the interfaces of a material. `materials` is the number
    /// of materials.
    pub(super) fn shortest_of(&self, id: u16, materials: usize) -> f64 {
        let others = (0..materials as u16).filter(|&other| other != id);
        others.map(|other| self.of_pair(id, other)).min_by(f64::total_cmp).unwrap_or(self.base)
    }

    /// Returns the scale (mm) given by the edge length of a material, or the base scale if it has
    /// none. An interface with another material can have a different scale.
    pub fn of_material(&self, id: MaterialId) -> f64 {
        self.own(id).unwrap_or(self.base)
    }

    fn own(&self, id: MaterialId) -> Option<f64> {
        self.given.of_material(id).map(|size| (SCALE_OVER_SIZE * size).max(self.smallest))
    }

    /// Returns the shortest and the longest scale (mm) of all pairs of materials. `materials` is
    /// the number of materials.
    pub fn range(&self, materials: usize) -> [f64; 2] {
        let lengths = self.lengths(materials);
        [lengths.first(), lengths.last()].map(|length| length.copied().unwrap_or(self.base))
    }

    /// Returns the distinct scales (mm) of all pairs of materials, in ascending order. `materials`
    /// is the number of materials.
    pub fn lengths(&self, materials: usize) -> Vec<f64> {
        let pairs = (0..materials as u16).flat_map(|a| (0..a).map(move |b| (a, b)));
        let mut lengths: Vec<f64> = pairs.map(|(a, b)| self.of_pair(a, b)).collect();
        lengths.sort_by(f64::total_cmp);
        lengths.dedup();
        if lengths.is_empty() { vec![self.base] } else { lengths }
    }
}
