//! Stores the indicators of all materials of a volume, and an index of the materials that are known
//! in each brick of cells.

use super::bounded::{Bound, Bounded};
use super::error::Error;
use super::indicator::{CELLS, Indicator, bricks_along};
use super::strata::half_difference;
use super::{Indicators, MOST_MATERIALS, Material, MaterialId, Near, far};
use crate::spline::{Jet, Stencil};
use glam::DVec3;
use isoparticles_volume::{Geometry, Space};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Sentinel for a brick that no material fills. The indicator of every material that occurs in such
/// a brick is known there.
const NO_FILL: u16 = u16::MAX;

/// Assumed maximum difference, in voxels, between the two indicators at a position on their
/// interface. A projection onto the interface leaves at most twice its tolerance, which is far
/// smaller.
pub const ON_INTERFACE: f64 = 0.01;

/// A material that is known in a brick.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    material: u16,
    /// Index of the brick among the known bricks of the material's indicator.
    brick: u32,
}

/// The indicators of all materials on one grid. Each indicator is known only near the border of its
/// material.
///
/// The cost of a look-up is proportional to the number of materials near the position. For each
/// brick of 4 x 4 x 4 cells, an index lists the materials known in the brick, and the material, if
/// any, whose indicator is negative in the whole brick. Memory is proportional to the area of the
/// interfaces. At an interface, each indicator stores a layer that is 14 coefficients thick on
/// average. A coefficient takes 4 bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Materials {
    geometry: Geometry,
    table: Vec<Material>,
    indicators: Vec<Indicator>,
    /// Index of the first entry of each brick, followed by the number of entries.
    start: Vec<u32>,
    entries: Vec<Entry>,
    /// Material that fills each brick, or [`NO_FILL`].
    fill: Vec<u16>,
    /// Planes at which the materials end.
    bounds: Vec<Bound>,
}

impl Materials {
    /// Assembles the materials. The third element of each tuple is the list of bricks in which the
    /// indicator is negative throughout. [`Indicator::new`] returns both the indicator and this
    /// list.
    ///
    /// # Errors
    /// If there are no materials, too many materials or too many bricks, or if a brick lies beyond
    /// the grid.
    pub fn new(geometry: Geometry, materials: Vec<(Material, Indicator, Vec<u32>)>) -> Result<Self, Error> {
        let count = bricks_along(geometry.size).iter().product::<usize>();
        let mut fill = vec![NO_FILL; count];
        for (id, (_, _, negative)) in materials.iter().enumerate().take(MOST_MATERIALS) {
            for &brick in negative {
                *fill.get_mut(brick as usize).ok_or(Error::Bricks { count })? = id as u16;
            }
        }
        Self::from_parts(geometry, materials.into_iter().map(|(material, own, _)| (material, own)).collect(), fill)
    }

    /// Assembles the materials from stored parts, as returned by [`Self::indicators`] and
    /// [`Self::fill`].
    ///
    /// # Errors
    /// If the parts do not fit together.
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
        let largest = fill.iter().copied().filter(|&id| id != NO_FILL).max();
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
        Ok(Self { geometry, table, indicators, start, entries, fill, bounds: Vec::new() })
    }

    /// Ends the materials at planes. The space beyond each plane becomes a material at the end of
    /// the table, without labels ([`Bounded`]).
    #[must_use]
    pub fn with_bounds(mut self, bounds: Vec<Bound>) -> Self {
        let named = bounds.iter().map(|bound| Material { name: bound.name.clone(), labels: Vec::new() });
        self.table.truncate(self.indicators.len());
        self.table.extend(named);
        self.bounds = bounds;
        self
    }

    /// Returns the planes at which the materials end.
    pub fn bounds(&self) -> &[Bound] {
        &self.bounds
    }

    /// Returns the materials with their grid in another anatomical frame ([`Geometry::in_space`]).
    #[must_use]
    pub fn in_space(self, space: Space) -> Self {
        Self { geometry: self.geometry.in_space(space), ..self }
    }

    /// Returns the grid that all indicators share.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Returns the names and labels of the materials, and the names of the planes at which they
    /// end, indexed by material number.
    pub fn table(&self) -> &[Material] {
        &self.table
    }

    /// Returns the names of the materials, indexed by material number.
    pub fn names(&self) -> Vec<String> {
        self.table.iter().map(|material| material.name.clone()).collect()
    }

    /// Returns the indicators, indexed by material number. The space beyond a plane has none.
    pub fn indicators(&self) -> &[Indicator] {
        &self.indicators
    }

    /// Returns, for each brick (x fastest), the number of the material whose indicator is negative
    /// in the whole brick. The number is 65535 if there is no such material.
    pub fn fill(&self) -> &[u16] {
        &self.fill
    }

    /// Returns the materials that are known in a brick, in ascending order. `brick` is the index of
    /// the brick in the grid, x fastest. Each material is paired with the index of the brick among
    /// the bricks of its indicator.
    pub fn known_in(&self, brick: usize) -> impl ExactSizeIterator<Item = (MaterialId, usize)> + Clone + '_ {
        self.known(brick).iter().map(|entry| (MaterialId(entry.material), entry.brick as usize))
    }

    /// Returns the material called `name`.
    pub fn named(&self, name: &str) -> Option<MaterialId> {
        self.table.iter().position(|material| material.name == name).map(|n| MaterialId(n as u16))
    }

    /// Returns the bricks that contain all strata: those in which more than one material is known,
    /// and those that a plane can cross. Each is given by its first cell and its number of cells
    /// along each axis.
    pub fn bricks_of_many(&self) -> Vec<([usize; 3], [usize; 3])> {
        let [bx, by, _] = bricks_along(self.geometry.size);
        let half = 0.5 * CELLS as f64 * self.geometry.spacing;
        let is_crossed = |brick: usize| {
            let first = [brick % bx, brick / bx % by, brick / (bx * by)].map(|n| (n * CELLS) as f64);
            let centre = DVec3::from_array(first) * self.geometry.spacing + half;
            self.bounds.iter().any(|bound| bound.side_of_box(centre, half).is_eq())
        };
        let many = (0..self.fill.len()).filter(|&brick| self.known(brick).len() > 1 || is_crossed(brick));
        let extent = |brick: usize| {
            let first = [brick % bx, brick / bx % by, brick / (bx * by)].map(|n| n * CELLS);
            let count = |axis: usize| CELLS.min(self.geometry.size[axis].saturating_sub(1).saturating_sub(first[axis]));
            (first, std::array::from_fn(count))
        };
        many.map(extent).collect()
    }

    /// Adds changes (mm) to indicators at nodes of the grid ([`Indicator::add_at_nodes`]). The set
    /// of known bricks does not change.
    pub fn add_at_nodes(&mut self, changes: &BTreeMap<MaterialId, Vec<([usize; 3], f64)>>) {
        let size = self.geometry.size;
        self.indicators.par_iter_mut().enumerate().for_each(|(id, indicator)| {
            if let Some(own) = changes.get(&MaterialId(id as u16)) {
                indicator.add_at_nodes(own, size);
            }
        });
    }

    /// Returns the memory usage in bytes.
    pub fn bytes(&self) -> usize {
        let index = size_of_val(self.start.as_slice())
            + size_of_val(self.entries.as_slice())
            + size_of_val(self.fill.as_slice());
        self.indicators.iter().map(Indicator::bytes).sum::<usize>() + index
    }

    /// Returns the index of the brick that contains the cell of a stencil.
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

    /// Returns the coefficients of a material at the nodes of a stencil. If some of them are
    /// unknown, returns as an error whether the position is inside the material.
    #[inline(always)]
    fn gathered(&self, entry: Entry, stencil: &Stencil) -> Result<[f32; 64], bool> {
        let indicator = &self.indicators[usize::from(entry.material)];
        indicator.gather(entry.brick, stencil, self.geometry.size).ok_or(indicator.surrounds())
    }

    /// Returns the stencil of a position and the coefficients of a material at its nodes. If some
    /// coefficients are unknown, returns as an error whether the position is inside the material.
    #[inline]
    fn of(&self, id: MaterialId, grid: DVec3) -> Result<(Stencil, [f32; 64]), bool> {
        let stencil = Stencil::new(&self.geometry, grid);
        let brick = self.brick(&stencil);
        self.read(id, brick, &stencil).map(|read| (stencil.gathered(), read))
    }

    /// Returns the coefficients of a material at the nodes of a stencil in a brick. If some of them
    /// are unknown, returns as an error whether the position is inside the material.
    #[inline(always)]
    fn read(&self, id: MaterialId, brick: usize, stencil: &Stencil) -> Result<[f32; 64], bool> {
        match self.known(brick).iter().find(|entry| entry.material == id.0) {
            Some(&entry) => self.gathered(entry, stencil),
            None => Err(self.fill[brick] == id.0),
        }
    }
}

/// The materials as if they continued beyond the planes at which they end.
struct Unbounded<'a>(&'a Materials);

impl Indicators for Unbounded<'_> {
    fn near(&self, grid: DVec3) -> Near {
        let Self(own) = self;
        let stencil = Stencil::new(&own.geometry, grid);
        let brick = own.brick(&stencil);
        let mut near = Near::default();
        if own.fill[brick] != NO_FILL {
            near.insert(MaterialId(own.fill[brick]), f64::NEG_INFINITY);
        }
        let known = own.known(brick);
        if known.is_empty() {
            return near;
        }
        let side_by_side = stencil.clone().gathered();
        for &entry in known {
            match own.gathered(entry, &stencil) {
                Ok(read) => near.insert(MaterialId(entry.material), side_by_side.value(&read)),
                Err(true) => near.insert(MaterialId(entry.material), f64::NEG_INFINITY),
                Err(false) => {}
            }
        }
        near
    }

    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3) {
        match self.0.of(id, grid) {
            Ok((stencil, read)) => stencil.value_gradient(&read, self.0.geometry.spacing),
            Err(inside) => (far(inside).value, DVec3::ZERO),
        }
    }

    /// Evaluates the difference as a single spline, whose coefficients are half the differences
    /// between the coefficients of the two materials.
    #[inline(always)]
    fn difference_gradient(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> (f64, DVec3) {
        let Self(own) = self;
        let stencil = Stencil::new(&own.geometry, grid);
        let brick = own.brick(&stencil);
        let [a, b] = [i, j].map(|id| own.read(id, brick, &stencil));
        match (a, b) {
            (Ok(a), Ok(b)) => {
                let half = std::array::from_fn(|n| 0.5 * (f64::from(a[n]) - f64::from(b[n])));
                stencil.value_gradient_of(&half, self.0.geometry.spacing)
            }
            _ => half_difference(self.value_gradient(i, grid), self.value_gradient(j, grid)),
        }
    }

    #[inline(always)]
    fn is_real_interface(&self, own: [MaterialId; 2], grid: DVec3) -> bool {
        let Self(all) = self;
        let stencil = Stencil::new(&all.geometry, grid);
        let brick = all.brick(&stencil);
        let is_own = |material: u16| material == own[0].0 || material == own[1].0;
        let is_filled_by_other = all.fill[brick] != NO_FILL && !is_own(all.fill[brick]);
        let mut others = all.known(brick).iter().filter(|entry| !is_own(entry.material)).peekable();
        // in most bricks no third material is known, and no indicator needs to be evaluated
        if others.peek().is_none() && !is_filled_by_other {
            return true;
        }
        // a spline value is never below the minimum of the coefficients at the nodes of its stencil
        let own_value = || Some(stencil.clone().gathered().value(&all.read(own[0], brick, &stencil).ok()?));
        let is_far = |limit: f64| {
            others.all(|&entry| match all.gathered(entry, &stencil) {
                Ok(read) => f64::from(read.iter().copied().fold(f32::INFINITY, f32::min)) > limit,
                Err(inside) => !inside,
            })
        };
        let limit = own_value().map(|value| value + ON_INTERFACE * self.voxel());
        (!is_filled_by_other && limit.is_some_and(is_far)) || self.clearance(grid, &own) > 0.0
    }

    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet {
        match self.0.of(id, grid) {
            Ok((stencil, read)) => stencil.jet(&read, self.0.geometry.spacing),
            Err(inside) => far(inside),
        }
    }

    fn voxel(&self) -> f64 {
        self.0.geometry.mean_spacing()
    }
}

impl Materials {
    /// Returns the indicators of the materials, ended at the planes.
    #[inline(always)]
    fn bounded(&self) -> Bounded<'_, Unbounded<'_>> {
        let first = MaterialId(self.indicators.len() as u16);
        Bounded::new(Unbounded(self), &self.bounds, first, self.geometry.spacing.length())
    }
}

impl Indicators for Materials {
    #[inline]
    fn near(&self, grid: DVec3) -> Near {
        self.bounded().near(grid)
    }

    fn value_gradient(&self, id: MaterialId, grid: DVec3) -> (f64, DVec3) {
        self.bounded().value_gradient(id, grid)
    }

    fn jet(&self, id: MaterialId, grid: DVec3) -> Jet {
        self.bounded().jet(id, grid)
    }

    fn voxel(&self) -> f64 {
        self.geometry.mean_spacing()
    }

    fn first_beyond(&self) -> Option<MaterialId> {
        self.bounded().first_beyond()
    }

    #[inline(always)]
    fn difference_of(&self, near: &Near, grid: DVec3, i: MaterialId, j: MaterialId) -> f64 {
        self.bounded().difference_of(near, grid, i, j)
    }

    fn difference(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> Jet {
        self.bounded().difference(i, j, grid)
    }

    #[inline(always)]
    fn difference_gradient(&self, i: MaterialId, j: MaterialId, grid: DVec3) -> (f64, DVec3) {
        self.bounded().difference_gradient(i, j, grid)
    }

    #[inline(always)]
    fn is_real_interface(&self, own: [MaterialId; 2], grid: DVec3) -> bool {
        self.bounded().is_real_interface(own, grid)
    }
}
