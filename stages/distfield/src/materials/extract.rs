//! Computes one indicator (signed distance) per material from the material of each voxel.
//!
//! Each indicator is computed on the bounding box of its material by the method for a single object
//! ([`crate::labels`], or [`super::scaled`] with a scale). The indicators are computed one after
//! the other, so peak memory depends on the largest box and on the area of all interfaces.
//! [`keep_contacts`] then corrects the indicators where several materials meet.

use super::choice::Chosen;
use super::contacts::{ContactReport, keep_contacts};
use super::grid::{Extent, LabelGrid};
use super::scaled::{Levels, Made};
use super::scales::Scales;
use crate::changes::Changes;
use crate::crop::on_coarse_nodes;
use crate::field::{Demands, Redistanced};
use crate::labels::{LabelOptions, from_mask_with, room_of_labels};
use crate::topology::Parts;
use crate::{Border, Keep};
use isoparticles_field::materials::{Indicator, Material, MaterialId, Materials};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::{Counter, Interrupted, Monitor, Phase, Silent};
use isoparticles_volume::{Image, VoxelBox};
use rayon::prelude::*;

/// Accuracy required of each indicator.
///
/// Distances are needed up to 7 voxels: an indicator is stored for two to three voxels around its
/// zero set, and its bricks extend four cells farther. The tolerance is half the tolerance for a
/// single object, because the deviations of two indicators add up at their interface. Fewer
/// conjugate-gradient steps than for a single object suffice, because an interface lies between the
/// zero sets of its two indicators. The indicators of `brain_parcellation` take 165 s of processor
/// time with 160 steps, as for a single object, and 89 s with 40 steps.
const DEMANDS: Demands = Demands { limit: 7.0, pinned: 0.0005, pin_steps: 40 };

/// Options for computing indicators from labels.
#[derive(Clone, Debug)]
pub struct MaterialOptions {
    /// Minimum distance of the zero set of each indicator from voxel centres, in units of the
    /// minimum voxel spacing. Not used with a scale.
    pub clearance: f64,
    /// The scales of the smoothing; `None` keeps every voxel centre in its material.
    pub scales: Option<Scales>,
}

/// Measurements of one material's indicator.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Number of voxels of the material.
    pub voxels: usize,
    /// Components, cavities and volume of the voxels of the material, and of the region where its
    /// indicator is negative before contacts are corrected. For the outside, both describe its
    /// complement.
    pub parts: [Parts; 2],
    /// Number of voxel centres where the indicator has the wrong sign.
    pub changed: usize,
    /// Number of ambiguous faces at which the indicator and its level set connect the ends of
    /// different diagonals.
    pub undecided: usize,
    /// Changes due to the scale; `None` without a scale, or if the whole material vanishes.
    pub changes: Option<Changes>,
}

/// The indicators of all materials, with measurements.
pub struct Extracted {
    /// The indicators.
    pub materials: Materials,
    /// Measurements of each material, by number.
    pub tallies: Vec<Tally>,
    /// Report of the contacts.
    pub contacts: ContactReport,
}

/// Hides the progress counters of single materials; phases and interrupts pass through.
pub(super) struct Quiet<'a>(pub(super) &'a dyn Monitor);

impl Monitor for Quiet<'_> {
    fn check(&self) -> std::result::Result<(), Interrupted> {
        self.0.check()
    }

    fn phase<'a>(&'a self, name: &str) -> Box<dyn Phase + 'a> {
        self.0.phase(name)
    }

    fn counter<'a>(&'a self, _label: &str, _total: Option<u64>) -> Box<dyn Counter + 'a> {
        Box::new(Silent)
    }
}

/// Computes the indicators of all materials.
///
/// # Errors
/// If a material has no voxel or no border, if the indicators are inconsistent, or if the run is
/// interrupted.
pub fn extract(
    grid: &LabelGrid,
    chosen: &Chosen,
    options: &MaterialOptions,
    monitor: &dyn Monitor,
) -> Result<Extracted> {
    let padded = grid.padded();
    let extents = grid.extents(chosen.table.len());
    if let Some(gone) = (1..extents.len()).find(|&id| extents[id].count == 0) {
        return Err(Error::input(
            format!("the material '{}' has no voxel", chosen.table[gone].name),
            "a material without voxels has no surface",
            "leave it out of MATERIALS (--material); another material or layer may contain its voxels",
        ));
    }
    // the outside is computed from the union of all other materials, whose box contains all their
    // boxes
    let all = extents[1..].iter().copied().reduce(Extent::joined).unwrap_or(extents[0]);
    let box_size = |extent: &Extent| (0..3).map(|a| extent.high[a] + 1 - extent.low[a]).product::<usize>();
    // largest box first, because the results accumulate and leave less memory for later materials
    let mut order: Vec<usize> = (1..extents.len()).collect();
    order.sort_by_key(|&id| (std::cmp::Reverse(box_size(&extents[id])), id));
    let mut made: Vec<Option<(Indicator, Vec<u32>)>> = vec![None; extents.len()];
    let mut tallies = vec![Tally::default(); extents.len()];
    let levels = options.scales.as_ref().map(|scales| Levels::new(grid, &extents, scales, monitor)).transpose()?;
    let progress = monitor.counter("materials", Some(extents.len() as u64));
    for id in std::iter::once(0).chain(order) {
        monitor.check()?;
        let extent = if id == 0 { all } else { extents[id] };
        let no_outside = id == 0 && grid.border == Border::Open && all.count == grid.numbers.len();
        made[id] = Some(if no_outside {
            (Indicator::constant(false), Vec::new())
        } else {
            let one = OneMaterial { grid, id: MaterialId(id as u16), extent };
            // an outside without voxels is the space beyond the volume and needs no scale
            let scaled = levels.as_ref().filter(|_| extents[id].count > 0);
            let (indicator, tally) = one.indicator(scaled, options, &Quiet(monitor)).map_err(|error| Error {
                what: format!("material '{}': {}", chosen.table[id].name, error.what),
                ..error
            })?;
            tallies[id] = tally;
            indicator
        });
        tallies[id].voxels = extents[id].count;
        progress.add(1);
    }
    let table = chosen.table.iter().cloned().zip(made);
    let parts: Vec<(Material, Indicator, Vec<u32>)> = table
        .filter_map(|(material, made)| made.map(|(indicator, negative)| (material, indicator, negative)))
        .collect();
    let mut materials = Materials::new(padded, parts).map_err(|error| {
        Error::input(
            format!("the indicators are inconsistent: {error}"),
            "no mesh can be made from them",
            "crop the volume, or select fewer materials in MATERIALS (--material)",
        )
    })?;
    let contacts = keep_contacts(&mut materials, options.scales.is_some(), monitor)?;
    Ok(Extracted { materials, tallies, contacts })
}

/// A material whose indicator is computed. The outside is computed as the complement of the union
/// of all other materials, so a volume with one material has one indicator and its negative.
struct OneMaterial<'a> {
    grid: &'a LabelGrid,
    id: MaterialId,
    extent: Extent,
}

impl OneMaterial<'_> {
    /// Computes the indicator, the bricks where it is negative throughout, and the measurements.
    /// `scaled` contains the level sets, if there is a scale.
    fn indicator(
        &self,
        scaled: Option<&Levels>,
        options: &MaterialOptions,
        monitor: &dyn Monitor,
    ) -> Result<((Indicator, Vec<u32>), Tally)> {
        let is_outside = self.id == MaterialId::OUTSIDE;
        let (own, first, tally) = match scaled {
            Some(levels) => self.scaled(levels, monitor)?,
            None => {
                let (own, tally) = self.make(options, monitor)?;
                (Some(own), self.kept().low, tally)
            }
        };
        let indicator = match own {
            Some(own) => Indicator::new(&own, first, self.grid.padded().size, is_outside),
            // nothing is left of the material, or of the union of all other materials
            None => (Indicator::constant(is_outside), Vec::new()),
        };
        Ok((indicator, tally))
    }

    /// Returns the box in which the indicator is computed without a scale: the bounding box of the
    /// voxels, enlarged by [`room_of_labels`].
    fn kept(&self) -> VoxelBox {
        let Extent { low, high, .. } = self.extent;
        on_coarse_nodes(VoxelBox { low, high }.with_room(room_of_labels(self.grid.margin), self.grid.geometry.size))
    }

    /// Computes the indicator at a scale. Also returns the first voxel of its box. The indicator is
    /// `None` if the whole material vanishes.
    fn scaled(&self, levels: &Levels, monitor: &dyn Monitor) -> Result<(Option<Image<f32>>, [usize; 3], Tally)> {
        let Made { result, first, changes } = levels.indicator(self.id, &DEMANDS, monitor)?;
        let Some(Redistanced { mut field, parts_before, parts_after, undecided, .. }) = result else {
            return Ok((None, first, Tally::default()));
        };
        self.negate_if_outside(&mut field);
        // count the components of the voxels, not of the smoothed object
        let components = changes.as_ref().map_or(parts_before.components, |changes| changes.components[0]);
        let before = Parts { components, ..parts_before };
        let tally = Tally { voxels: 0, parts: [before, parts_after], changed: 0, undecided, changes };
        Ok((Some(field), first, tally))
    }

    /// Negates the field of the outside, which is computed from the union of all other materials.
    fn negate_if_outside(&self, field: &mut Image<f32>) {
        if self.id == MaterialId::OUTSIDE {
            field.data.par_iter_mut().for_each(|f| *f = -*f);
        }
    }

    /// Computes the indicator without a scale.
    fn make(&self, options: &MaterialOptions, monitor: &dyn Monitor) -> Result<(Image<f32>, Tally)> {
        let kept = self.kept();
        let (size, id, numbers) = (kept.size(), self.id.0, &self.grid.numbers);
        let is_outside = self.id == MaterialId::OUTSIDE;
        let mask = self.grid.mask(kept.low, kept.high, |number| (number == id) != is_outside);
        let number = |n: usize| {
            let [i, j, k] = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
            numbers[self.grid.geometry.linear(kept.low[0] + i, kept.low[1] + j, kept.low[2] + k)]
        };
        // where two materials alternate around an edge, the material with the lower number is
        // connected; the outside is never connected
        let gives_way = |[a, b]: [usize; 2]| {
            let other = number(a);
            !is_outside && other == number(b) && (1..id).contains(&other)
        };
        let options = LabelOptions {
            border: self.grid.border,
            margin: self.grid.margin,
            cut: kept.cut_faces(self.grid.geometry.size),
            clearance: options.clearance,
            keep: Keep::All,
        };
        let result = from_mask_with(mask, gives_way, &options, &DEMANDS, monitor)?;
        let Redistanced { mut field, parts_before, parts_after, changed, undecided, .. } = result;
        self.negate_if_outside(&mut field);
        let parts = [parts_before, parts_after];
        Ok((field, Tally { voxels: 0, parts, changed: changed.unwrap_or(0), undecided, changes: None }))
    }
}
