//! Labels: the side of the surface that every node is on, and how near the surface may come to it.

use crate::Clearance;
use crate::mask::Mask;
use crate::runs::Runs;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Sides and least distances of the nodes. The least distance is a constant but at nodes where the object or a gap is thin, which the mask
/// tells, and within the tightening radius of the staircase.
pub struct Sides {
    /// The nodes inside.
    pub mask: Mask,
    /// Least distance, mm.
    usual: f32,
    /// The same at thin places.
    thin: f32,
    /// Nodes with a least distance of their own, and those (mm, below zero where a node may leave its side).
    relaxed: Option<(Runs, Vec<f32>)>,
}

impl Sides {
    /// Every node keeps its side by its clearance.
    pub fn new(mask: Mask, clearance: Clearance) -> Self {
        let voxel = mask.geometry.min_spacing();
        let (usual, thin) = ((clearance.usual * voxel) as f32, (clearance.thin * voxel) as f32);
        Self { mask, usual, thin, relaxed: None }
    }

    /// The largest least distance, mm.
    pub fn most(&self) -> f32 {
        self.usual.max(self.thin)
    }

    /// Least distance of a node, mm.
    pub fn least(&self, node: usize) -> f32 {
        let relaxed = self.relaxed.as_ref().and_then(|(runs, least)| Some(least[runs.number(node)?]));
        relaxed.unwrap_or_else(|| self.clearance(node))
    }

    /// Smallest and largest F at a node, mm.
    pub fn range(&self, node: usize) -> (f32, f32) {
        let least = self.least(node);
        if self.mask.inside.holds(node) { (f32::NEG_INFINITY, -least) } else { (least, f32::INFINITY) }
    }

    fn clearance(&self, node: usize) -> f32 {
        if self.mask.is_thin(node) { self.thin } else { self.usual }
    }

    /// Lets nodes within the radius of the staircase (voxels) come nearer to the surface than their least distance, and leave their side: the
    /// surface then stays within that radius of the staircase, the distance to which is `binary`.
    pub fn relax(&mut self, binary: &Image<f32>, radius: f64) {
        if radius > 0.0 {
            let radius = (radius * binary.geometry.min_spacing()) as f32;
            let reach = radius + 2.0 * self.most();
            let runs = Runs::of(binary.geometry.size, |n| binary.data[n].abs() < reach);
            let least = runs.values(|n| self.clearance(n).min(binary.data[n].abs() - radius));
            self.relaxed = Some((runs, least));
        }
    }

    /// Puts every node on its side of zero, by its least distance, where `field` has the signs of the mask.
    pub fn hold(&self, field: &mut Image<f32>) {
        let most = self.most();
        field.data.par_iter_mut().enumerate().filter(|(_, f)| f.abs() < most).for_each(|(n, f)| {
            let (low, high) = self.range(n);
            *f = f.max(low).min(high);
        });
    }
}
