//! From the voxels of all materials to an indicator of each, by the method of one object ([`crate::labels`]) on the box of each, one after the other: memory goes
//! with the largest box and with the area of all borders.

use super::choice::Chosen;
use super::contacts::{Contacts, keep_contacts};
use super::grid::{Extent, LabelGrid};
use super::scaled::{Levels, Made};
use crate::changes::Changes;
use crate::crop::VoxelBox;
use crate::field::{Demands, Redistanced};
use crate::labels::{LabelOptions, from_mask_with, room_of_labels};
use crate::scale::Scale;
use crate::topology::Parts;
use crate::{Border, Keep};
use isoparticles_field::materials::{Indicator, Material, MaterialId, Materials};
use isoparticles_stage::error::{Error, Result};
use isoparticles_stage::monitor::{Counter, Interrupted, Monitor, Phase, Silent};
use isoparticles_volume::Image;
use rayon::prelude::*;

/// What is asked of each indicator: distances up to 7 voxels, for what is known of one reaches two to three voxels and a brick of four cells from its border; and fewer conjugate-gradient steps that pin the
/// border than for one object, since sheets lie where two indicators are equal, between their zero sets, so that these need not be pinned to the last digit. With 160 as for one object
/// `brain_parcellation` takes 165 processor seconds, with 40 it takes 89.
const DEMANDS: Demands = Demands { limit: 7.0, pinned: 0.0005, pin_steps: 40 };

/// How labels become indicators.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaterialOptions {
    /// Least distance of each border from voxel centres, in voxels (smallest spacing).
    pub clearance: f64,
    /// What is smoothed away, in place of all this; `None` keeps every voxel centre.
    pub scale: Option<Scale>,
}

/// What is known of one material's indicator.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Voxels of the material.
    pub voxels: usize,
    /// Parts of its voxels, and of what its indicator is negative in before contacts are made plain; those of the outside are of its complement.
    pub parts: [Parts; 2],
    /// Voxel centres that the indicator alone puts on the other side.
    pub changed: usize,
    /// Places where two parts touch along an edge and the indicator, by itself, does not join or
    /// part them as its level set does.
    pub undecided: usize,
    /// What a scale changed; `None` without one, and where nothing is left of the material.
    pub changes: Option<Changes>,
}

/// The indicators of all materials and what is known of each.
pub struct Extracted {
    /// The indicators.
    pub materials: Materials,
    /// What is known of each, by their numbers.
    pub tallies: Vec<Tally>,
    /// What was made plain where several meet.
    pub contacts: Contacts,
}

/// Lets nobody see the phases of single materials, but stops when asked to.
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

/// Makes the indicators.
///
/// # Errors
/// When a material has no border, or the run is interrupted.
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
            "it has no border, and no place in the mesh",
            "leave it out; another material or layer may have taken its voxels",
        ));
    }
    // the outside by all others together, whose box holds all boxes
    let all = extents[1..].iter().copied().reduce(Extent::joined).unwrap_or(extents[0]);
    let box_size = |extent: &Extent| (0..3).map(|a| extent.high[a] + 1 - extent.low[a]).product::<usize>();
    // the largest first, as long as there is room: what is kept of each adds up
    let mut order: Vec<usize> = (1..extents.len()).collect();
    order.sort_by_key(|&id| (std::cmp::Reverse(box_size(&extents[id])), id));
    let mut made: Vec<Option<(Indicator, Vec<u32>)>> = vec![None; extents.len()];
    let mut tallies = vec![Tally::default(); extents.len()];
    let levels = options.scale.map(|scale| Levels::new(grid, &extents, scale, monitor)).transpose()?;
    let progress = monitor.counter("materials", Some(extents.len() as u64));
    for id in std::iter::once(0).chain(order) {
        monitor.check()?;
        let extent = if id == 0 { all } else { extents[id] };
        let name = &chosen.table[id].name;
        let no_outside = id == 0 && grid.border == Border::Open && all.count == grid.numbers.len();
        let (indicator, negative) = if no_outside {
            (Indicator::constant(false), Vec::new())
        } else {
            let one = One { grid, id: MaterialId(id as u16), extent };
            let made = match (&levels, options.scale) {
                // an outside without voxels is what lies beyond the volume, at any scale
                (Some(levels), Some(scale)) if extents[id].count > 0 => one.scaled(levels, scale, &Quiet(monitor)),
                _ => one.make(options, &Quiet(monitor)).map(|(own, tally)| (Some(own), one.kept().low, tally)),
            };
            let (own, first, tally) =
                made.map_err(|error| Error { what: format!("material '{name}': {}", error.what), ..error })?;
            tallies[id] = tally;
            match own {
                Some(own) => Indicator::new(&own, first, padded.size, id == 0),
                // all others together are gone, or the material is
                None => (Indicator::constant(id == 0), Vec::new()),
            }
        };
        tallies[id].voxels = extents[id].count;
        made[id] = Some((indicator, negative));
        progress.add(1);
    }
    let table = chosen.table.iter().cloned().zip(made);
    let parts: Vec<(Material, Indicator, Vec<u32>)> = table
        .filter_map(|(material, made)| made.map(|(indicator, negative)| (material, indicator, negative)))
        .collect();
    let mut materials = Materials::new(padded, parts).map_err(|error| {
        Error::input(
            format!("the indicators do not fit together: {error}"),
            "nothing can be read of them",
            "crop the volume, or name fewer materials",
        )
    })?;
    let contacts = keep_contacts(&mut materials, options.scale.is_some(), monitor)?;
    Ok(Extracted { materials, tallies, contacts })
}

/// One material to be made; the outside as the complement of all others together, so that the border of a volume with one material has one indicator and
/// its negative.
struct One<'a> {
    grid: &'a LabelGrid,
    id: MaterialId,
    extent: Extent,
}

impl One<'_> {
    /// The box that is looked at: that of the voxels, with the room that their smoothed shares
    /// reach.
    fn kept(&self) -> VoxelBox {
        let Extent { low, high, .. } = self.extent;
        VoxelBox { low, high }.with_room(room_of_labels(self.grid.margin), self.grid.geometry.size).on_coarse_nodes()
    }

    /// The indicator at a scale with the first voxel of its box; none where nothing is left.
    fn scaled(
        &self,
        levels: &Levels,
        scale: Scale,
        monitor: &dyn Monitor,
    ) -> Result<(Option<Image<f32>>, [usize; 3], Tally)> {
        let Made { result, first, changes } = levels.indicator(self.id, scale.length, &DEMANDS, monitor)?;
        let Some(Redistanced { mut field, parts_before, parts_after, undecided, .. }) = result else {
            return Ok((None, first, Tally::default()));
        };
        self.turn(&mut field);
        // of the data, not of what was smoothed
        let components = changes.as_ref().map_or(parts_before.components, |changes| changes.components[0]);
        let before = Parts { components, ..parts_before };
        let tally = Tally { voxels: 0, parts: [before, parts_after], changed: 0, undecided, changes };
        Ok((Some(field), first, tally))
    }

    /// What was made of the outside is made of all others together.
    fn turn(&self, field: &mut Image<f32>) {
        if self.id == MaterialId::OUTSIDE {
            field.data.par_iter_mut().for_each(|f| *f = -*f);
        }
    }

    fn make(&self, options: &MaterialOptions, monitor: &dyn Monitor) -> Result<(Image<f32>, Tally)> {
        let kept = self.kept();
        let (size, id, numbers) = (kept.size(), self.id.0, &self.grid.numbers);
        let is_outside = self.id == MaterialId::OUTSIDE;
        let mask = self.grid.mask(kept.low, kept.high, |number| (number == id) != is_outside);
        let number = |n: usize| {
            let [i, j, k] = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
            numbers[self.grid.geometry.linear(kept.low[0] + i, kept.low[1] + j, kept.low[2] + k)]
        };
        // where two materials alternate round an edge, the one named first is joined; the outside
        // never
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
        self.turn(&mut field);
        let parts = [parts_before, parts_after];
        Ok((field, Tally { voxels: 0, parts, changed: changed.unwrap_or(0), undecided, changes: None }))
    }
}
