//! The indicators of all materials of a volume, and the index that tells which of them are known at a place.

use super::error::Error;
use super::indicator::{CELLS, Indicator, bricks_along};
use super::strata::half_difference;
use super::{Indicators, MOST_MATERIALS, Material, MaterialId, Near, far};
use crate::spline::{Jet, Stencil};
use glam::DVec3;
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// In place of a material that fills a brick where none does: all that are there are known.
const NONE: u16 = u16::MAX;

/// The two indicators of a sheet are taken to differ by less than this share of a voxel at a place on it: far more than any projection leaves.
pub const ON_SHEET: f64 = 0.01;

/// A material that is known in a brick.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    material: u16,
    /// Number of the brick among those of the material's indicator.
    brick: u32,
}

/// The indicators of all materials, each known near its own border, on one grid.
///
/// A look-up costs what the materials near the place cost: an index tells of each brick of 4 x 4 x 4 cells which are known in it, and which one fills it
/// otherwise. Memory goes with the area of the interfaces: 14 coefficients of 4 bytes deep on average on each side.
#[derive(Clone, Debug, PartialEq)]
pub struct Materials {
    geometry: Geometry,
    table: Vec<Material>,
    indicators: Vec<Indicator>,
    /// Where the entries of each brick start, and the end.
    start: Vec<u32>,
    entries: Vec<Entry>,
    /// The material that fills each brick, or [`NONE`].
    fill: Vec<u16>,
}

impl Materials {
    /// Puts indicators together; `negative` are the bricks all over which one is negative ([`Indicator::new`] gives both).
    ///
    /// # Errors
    /// When there are none or too many.
    pub fn new(geometry: Geometry, materials: Vec<(Material, Indicator, Vec<u32>)>) -> Result<Self, Error> {
        let count = bricks_along(geometry.size).iter().product::<usize>();
        let mut fill = vec![NONE; count];
        for (id, (_, _, negative)) in materials.iter().enumerate().take(MOST_MATERIALS) {
            for &brick in negative {
                *fill.get_mut(brick as usize).ok_or(Error::Bricks { count })? = id as u16;
            }
        }
        Self::from_parts(geometry, materials.into_iter().map(|(material, own, _)| (material, own)).collect(), fill)
    }

    /// Puts together what [`Self::indicators`] and [`Self::fill`] gave.
    ///
    /// # Errors
    /// When the parts do not belong together.
    pub fn from_parts(
        geometry: Geometry,
        materials: Vec<(Material, Indicator)>,
        fill: Vec<u16>,
    ) -> Result<Self, Error> {
        let found = materials.len();
        if !(1..=MOST_MATERIALS).contains(&found) {
            return Err(Error::Count { found, most: MOST_MATERIALS });
        }
        let bricks: usize = bricks_along(geometry.size).iter().product();
        if u32::try_from(bricks).is_err() {
            return Err(Error::Grid { size: geometry.size });
        }
        let largest = fill.iter().copied().filter(|&id| id != NONE).max();
        if fill.len() != bricks || largest.is_some_and(|id| usize::from(id) >= found) {
            return Err(Error::Fill { found: fill.len(), largest, bricks, materials: found });
        }
        let mut start = vec![0u32; bricks + 1];
        for (_, indicator) in &materials {
            for &brick in indicator.bricks() {
                *start.get_mut(brick as usize + 1).ok_or(Error::Bricks { count: bricks })? += 1;
            }
        }
        let mut sum = 0u32;
        for entry in &mut start {
            sum = sum.checked_add(*entry).ok_or(Error::Grid { size: geometry.size })?;
            *entry = sum;
        }
        let mut next = start.clone();
        let mut entries = vec![Entry { material: 0, brick: 0 }; sum as usize];
        for (material, (_, indicator)) in materials.iter().enumerate() {
            for (number, &brick) in indicator.bricks().iter().enumerate() {
                let place = &mut next[brick as usize];
                entries[*place as usize] = Entry { material: material as u16, brick: number as u32 };
                *place += 1;
            }
        }
        let (table, indicators) = materials.into_iter().unzip();
        Ok(Self { geometry, table, indicators, start, entries, fill })
    }

    /// The grid that all indicators share.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Names and labels of the materials, by their numbers.
    pub fn table(&self) -> &[Material] {
        &self.table
    }

    /// The indicators, by their numbers.
    pub fn indicators(&self) -> &[Indicator] {
        &self.indicators
    }

    /// The number of the material that fills each brick where it is not known, x fastest; 65535 where none does.
    pub fn fill(&self) -> &[u16] {
        &self.fill
    }

    /// The materials that are known in a brick (its number goes x fastest), ascending, each with the number of the brick among those of its indicator.
    pub fn known_in(&self, brick: usize) -> impl ExactSizeIterator<Item = (MaterialId, usize)> + Clone + '_ {
        self.known(brick).iter().map(|entry| (MaterialId(entry.material), entry.brick as usize))
    }

    /// The material of a name.
    pub fn named(&self, name: &str) -> Option<MaterialId> {
        self.table.iter().position(|material| material.name == name).map(|n| MaterialId(n as u16))
    }

    /// The bricks in which more than one material is known, so that all strata lie in them: first cell, and cells along each axis.
    pub fn bricks_of_many(&self) -> Vec<([usize; 3], [usize; 3])> {
        let [bx, by, _] = bricks_along(self.geometry.size);
        let many = (0..self.fill.len()).filter(|&brick| self.known(brick).len() > 1);
        let extent = |brick: usize| {
            let first = [brick % bx, brick / bx % by, brick / (bx * by)].map(|n| n * CELLS);
            let count = |axis: usize| CELLS.min(self.geometry.size[axis].saturating_sub(1).saturating_sub(first[axis]));
            (first, std::array::from_fn(count))
        };
        many.map(extent).collect()
    }

    /// Adds to what indicators are at nodes of the grid ([`Indicator::add_at_nodes`]), mm; what is known where stays.
    pub fn add_at_nodes(&mut self, changes: &BTreeMap<MaterialId, Vec<([usize; 3], f64)>>) {
        let size = self.geometry.size;
        self.indicators.par_iter_mut().enumerate().for_each(|(id, indicator)| {
            if let Some(own) = changes.get(&MaterialId(id as u16)) {
                indicator.add_at_nodes(own, size);
            }
        });
    }

    /// Memory that it takes, bytes.
    pub fn bytes(&self) -> usize {
        let index = size_of_val(self.start.as_slice())
            + size_of_val(self.entries.as_slice())
            + size_of_val(self.fill.as_slice());
        self.indicators.iter().map(Indicator::bytes).sum::<usize>() + index
    }

    /// Which brick a stencil's cell lies in.
    #[inline(always)]
    fn brick(&self, stencil: &Stencil) -> usize {
        let [i, j, k] = stencil.cell().map(|n| n / CELLS);
        let [bx, by, _] = bricks_along(self.geometry.size);
        (k * by + j) * bx + i
    }

    #[inline(always)]
    fn known(&self, brick: usize) -> &[Entry] {
        &self.entries[self.start[brick] as usize..self.start[brick + 1] as usize]
    }

    /// The coefficients that a stencil reads of a material, or whether the place is inside it, far from its border.
    #[inline(always)]
    fn gathered(&self, entry: Entry, stencil: &Stencil) -> Result<[f32; 64], bool> {
        let indicator = &self.indicators[usize::from(entry.material)];
        indicator.gather(entry.brick, stencil, self.geometry.size).ok_or(indicator.surrounds())
    }

    /// The stencil of a place and the coefficients of a material, or whether the place is inside it, far from its border.
    #[inline]
    fn of(&self, id: MaterialId, grid: DVec3) -> Result<(Stencil, [f32; 64]), bool> {
        let stencil = Stencil::new(&self.geometry, grid);
        let brick = self.brick(&stencil);
        self.read(id, brick, &stencil).map(|read| (stencil.gathered(), read))
    }

    /// The coefficients that a stencil reads of a material in a brick, or whether the place is inside it, far from its border.
    #[inline(always)]
    fn read(&self, id: MaterialId, brick: usize, stencil: &Stencil) -> Result<[f32; 64], bool> {
        match self.known(brick).iter().find(|entry| entry.material == id.0) {
            Some(&entry) => self.gathered(entry, stencil),
            None => Err(self.fill[brick] == id.0),
        }
    }
}

impl Indicators for Materials {
    fn near(&self, grid: DVec3) -> Near {
        let stencil = Stencil::new(&self.geometry, grid);
        let brick = self.brick(&stencil);
        let mut near = Near::default();
        if self.fill[brick] != NONE {
            near.insert(MaterialId(self.fill[brick]), f64::NEG_INFINITY);
        }
        let known = self.known(brick);
        if known.is_empty() {
            return near;
        }
        let side_by_side = stencil.clone().gathered();
        for &entry in known {
            match self.gathered(entry, &stencil) {
                Ok(read) => near.insert(MaterialId(entry.material), side_by_side.value(&read)),
                Err(true) => near.insert(MaterialId(entry.material), f64::NEG_INFINITY),
                Err(false) => {}
            }
        }
        near
    }

    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3) {
        match self.of(id, grid) {
            Ok((stencil, read)) => stencil.value_gradient(&read, self.geometry.spacing),
            Err(inside) => (far(inside).value, DVec3::ZERO),
        }
    }

    /// The coefficients of the two are subtracted, and summed once.
    #[inline(always)]
    fn difference_gradient(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> (f64, DVec3) {
        let stencil = Stencil::new(&self.geometry, grid);
        let brick = self.brick(&stencil);
        let [a, b] = [i, j].map(|id| self.read(id, brick, &stencil));
        match (a, b) {
            (Ok(a), Ok(b)) => {
                let half = std::array::from_fn(|n| 0.5 * (f64::from(a[n]) - f64::from(b[n])));
                stencil.value_gradient_of(&half, self.geometry.spacing)
            }
            _ => half_difference(self.value_gradient(i, grid), self.value_gradient(j, grid)),
        }
    }

    #[inline(always)]
    fn is_real_sheet(&self, own: [MaterialId; 2], grid: DVec3) -> bool {
        let stencil = Stencil::new(&self.geometry, grid);
        let brick = self.brick(&stencil);
        let is_own = |material: u16| material == own[0].0 || material == own[1].0;
        let is_filled_by_other = self.fill[brick] != NONE && !is_own(self.fill[brick]);
        let mut others = self.known(brick).iter().filter(|entry| !is_own(entry.material)).peekable();
        // most bricks know no third material, and no indicator is summed there
        if others.peek().is_none() && !is_filled_by_other {
            return true;
        }
        // a spline is nowhere below the least of the coefficients that it reads
        let own_value = || Some(stencil.clone().gathered().value(&self.read(own[0], brick, &stencil).ok()?));
        let is_far = |limit: f64| {
            others.all(|&entry| match self.gathered(entry, &stencil) {
                Ok(read) => f64::from(read.iter().copied().fold(f32::INFINITY, f32::min)) > limit,
                Err(inside) => !inside,
            })
        };
        let limit = own_value().map(|value| value + ON_SHEET * self.voxel());
        (!is_filled_by_other && limit.is_some_and(is_far)) || self.clearance(grid, &own) > 0.0
    }

    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet {
        match self.of(id, grid) {
            Ok((stencil, read)) => stencil.jet(&read, self.geometry.spacing),
            Err(inside) => far(inside),
        }
    }

    fn voxel(&self) -> f64 {
        self.geometry.mean_spacing()
    }
}
