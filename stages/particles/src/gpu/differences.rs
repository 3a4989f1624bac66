//! Multi-material data on the device: half differences of indicators, G = (F_high - F_low) / 2,
//! where `high` is the material with the higher number. A difference is stored for every pair of
//! materials whose interface has particles, in all bricks where both indicators are stored. Where a
//! third material may be equally close (its indicator equally small), the difference between the
//! third material and `high` is also stored.
//!
//! Where materials end at a plane ([`isoparticles_field::materials::Bounded`]), the half difference
//! of a material and the space beyond the plane is the distance from the plane, with the opposite
//! sign. Its spline has this distance at the nodes as coefficients. It is not exact in cells at the
//! border of the grid, where splines are mirrored; `distfield` adds a margin, so no interface
//! crosses these cells.
//!
//! A particle therefore reads one coefficient per node, as with a single object. Two look-ups find
//! the coefficients: the entry of the brick, and a record of the eight blocks of coefficients that
//! the cells of the brick read. The entry and the record apply to the whole brick of 4 x 4 x 4
//! cells. For most cells, the record rules out a closer third material. Storing both indicators of
//! an interface instead of their difference would need twice the memory.
//!
//! The index consists of groups of four words:
//!
//! - Group 0: index of the first stratum, and three unused words.
//! - From [`INDEX_BRICKS`]: one entry for each brick of the grid, with x varying fastest. An entry
//!   contains two pairs; the pair of the interface closest to the brick centre comes first. A pair
//!   consists of the index of an interface (or [`NO_INTERFACE`]) and the index of its record. If
//!   the brick has more than two interfaces, the second pair is [`MORE_INTERFACES`] and the index
//!   of the next entry.
//! - The additional entries of bricks with more than two interfaces.
//! - Records of four groups each. Groups 0 and 1: the indices of the eight blocks, with x varying
//!   fastest. Group 2: two bit masks of two words each for the 64 cells of the brick. The first
//!   mask marks the cells where both indicators are stored, the second the cells where a third
//!   material may be equally close. Group 3: index of the first check, number of checks or
//!   [`NEVER_REAL`], and two unused words.
//! - Checks of one group each. Word 0: index of the record of the difference between a third
//!   material and `high`. The interface exists where this difference is positive. Word 1: 1 if the
//!   difference is stored with the opposite sign, otherwise 0. Words 2 and 3: bit mask of the cells
//!   where the third material may be equally close. If the indicator of the third material is not
//!   stored in a cell of the mask, the cell lies inside that material.
//! - Strata: the four materials of each stratum, padded with 65535.

use glam::DVec3;
use isoparticles_field::materials::{
    BLOCK, Bound, CELLS, Indicator, Indicators, MaterialId, Materials, ON_INTERFACE, Stratum,
};
use rayon::prelude::*;

/// Index of the first brick entry.
pub(crate) const INDEX_BRICKS: usize = 1;
/// Marks an empty pair in an entry.
const NO_INTERFACE: u32 = u32::MAX;
/// Marks a pair that links to the next entry.
pub(crate) const MORE_INTERFACES: u32 = u32::MAX - 1;
/// Value that replaces the number of checks if a third material fills the brick. No point of the
/// brick then lies on the interface.
pub(crate) const NEVER_REAL: u32 = u32::MAX;

/// Marks a brick that no material fills. Also pads the materials of strata.
const NO_MATERIAL: u16 = u16::MAX;

/// Number of nodes along each axis that the cells of a brick read.
const NODES_PER_AXIS: usize = CELLS + 3;

/// Coefficients of the differences, and the index that locates them.
pub(super) struct Differences {
    pub coefficients: Vec<f32>,
    pub index: Vec<[u32; 4]>,
}

/// A pair of materials whose difference is known in a brick: the indicators of both are stored
/// there, or `high` is the space beyond a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Pair {
    low: u16,
    high: u16,
    brick: u32,
    /// Indices of the brick among the stored bricks of `low` and of `high`. Not used with a plane.
    numbers: [u32; 2],
}

impl Pair {
    fn new(brick: usize, a: (MaterialId, usize), b: (MaterialId, usize)) -> Self {
        let (low, high) = if a.0 < b.0 { (a, b) } else { (b, a) };
        Self { low: low.0.0, high: high.0.0, brick: brick as u32, numbers: [low.1 as u32, high.1 as u32] }
    }

    /// Returns the pair of a material and the space beyond a plane.
    fn at_plane(brick: usize, id: MaterialId, beyond: MaterialId) -> Self {
        Self { low: id.0, high: beyond.0, brick: brick as u32, numbers: [0; 2] }
    }

    /// Returns the plane, if there is one.
    fn plane<'m>(&self, materials: &'m Materials) -> Option<&'m Bound> {
        materials.bounds().get(usize::from(self.high).checked_sub(materials.indicators().len())?)
    }

    fn indicators<'m>(&self, materials: &'m Materials) -> [&'m Indicator; 2] {
        [self.low, self.high].map(|id| &materials.indicators()[usize::from(id)])
    }
}

/// Checks whether a particular third material is closer than the two materials of an interface, in
/// a brick that may contain that interface.
struct Check {
    pair: Pair,
    is_negative: bool,
    /// One bit for each cell, set if the third material may be as close there as the two materials
    /// of the interface.
    near: u64,
}

/// An interface in a brick.
struct Entry {
    interface: u32,
    pair: Pair,
    /// Checks for a third material; `None` if the brick contains no part of the interface.
    checks: Option<Vec<Check>>,
}

impl Differences {
    /// Builds the differences for particles on these strata. The first `interfaces` strata are
    /// interfaces, in ascending order.
    pub(super) fn new(materials: &Materials, strata: &[Stratum], interfaces: usize) -> Self {
        let bricks = materials.fill().len();
        let entries: Vec<Entry> = (0..bricks)
            .into_par_iter()
            .flat_map_iter(|brick| entries_of(materials, &strata[..interfaces], brick))
            .collect();
        let checks = || entries.iter().flat_map(|entry| entry.checks.iter().flatten());
        let mut pairs: Vec<Pair> = entries.iter().map(|e| e.pair).chain(checks().map(|c| c.pair)).collect();
        pairs.par_sort_unstable();
        pairs.dedup();
        let (coefficients, blocks) = coefficients(materials, &pairs);

        // the parts follow the layout in the module comment
        let mut index = vec![[0; 4]; INDEX_BRICKS];
        index.resize(INDEX_BRICKS + bricks, [NO_INTERFACE, 0, NO_INTERFACE, 0]);
        let of_bricks = || entries.chunk_by(|a, b| a.pair.brick == b.pair.brick);
        // an entry contains two interfaces, or one interface and a link to the next entry
        let further: usize = of_bricks().map(|interfaces| interfaces.len().saturating_sub(2)).sum();
        let first_record = index.len() + further;
        let record_of = |pair: &Pair| {
            let number = pairs.binary_search(pair).expect("the pairs of all entries and checks are there");
            (first_record + 4 * number) as u32
        };
        let records: Vec<u32> = entries.par_iter().map(|entry| record_of(&entry.pair)).collect();
        let mut named = entries.iter().zip(&records).map(|(entry, &record)| [entry.interface, record]);
        for of_brick in of_bricks() {
            let mut at = INDEX_BRICKS + of_brick[0].pair.brick as usize;
            let interfaces: Vec<[u32; 2]> = named.by_ref().take(of_brick.len()).collect();
            let (before, last) = interfaces.split_at(interfaces.len().saturating_sub(2));
            for [interface, record] in before {
                index[at] = [*interface, *record, MORE_INTERFACES, index.len() as u32];
                at = index.len();
                index.push([NO_INTERFACE, 0, NO_INTERFACE, 0]);
            }
            for (half, two) in last.iter().enumerate() {
                index[at][2 * half..2 * half + 2].copy_from_slice(two);
            }
        }
        index.par_extend(pairs.par_iter().zip(&blocks).flat_map_iter(|(pair, b)| {
            let [low, high] = words_of(known_cells(materials, pair));
            [[b[0], b[1], b[2], b[3]], [b[4], b[5], b[6], b[7]], [low, high, 0, 0], [0; 4]]
        }));
        for (entry, &record) in entries.iter().zip(&records) {
            let record = record as usize;
            let near = entry.checks.as_ref().map_or(u64::MAX, |checks| checks.iter().fold(0, |all, c| all | c.near));
            index[record + 2][2..].copy_from_slice(&words_of(near));
            index[record + 3][0] = index.len() as u32;
            index[record + 3][1] = entry.checks.as_ref().map_or(NEVER_REAL, |checks| checks.len() as u32);
            for check in entry.checks.iter().flatten() {
                let [low, high] = words_of(check.near);
                index.push([record_of(&check.pair), u32::from(check.is_negative), low, high]);
            }
        }
        index[0][0] = index.len() as u32;
        index.extend(strata.iter().map(materials_of));
        Self { coefficients, index }
    }
}

/// The planes at which the materials of a brick end.
struct Planes {
    /// The spaces beyond the planes that cross the brick.
    crossing: Vec<MaterialId>,
    /// Whether the brick lies beyond a plane.
    is_beyond: bool,
}

impl Planes {
    fn of(materials: &Materials, brick: usize) -> Self {
        let half = 0.5 * CELLS as f64 * materials.geometry().spacing;
        let centre = node_position(materials, brick, [0.5 * CELLS as f64; 3]);
        let first = materials.indicators().len() as u16;
        let is_crossed = |(_, bound): &(u16, &Bound)| bound.side_of_box(centre, half).is_eq();
        Self {
            crossing: (first..).zip(materials.bounds()).filter(is_crossed).map(|(id, _)| MaterialId(id)).collect(),
            is_beyond: materials.bounds().iter().any(|bound| bound.side_of_box(centre, half).is_gt()),
        }
    }

    /// Returns the checks that the spaces beyond the planes, except that of the interface itself,
    /// are not closer than a material.
    fn checks(&self, brick: usize, id: MaterialId, except: MaterialId) -> impl Iterator<Item = Check> {
        let others = self.crossing.iter().filter(move |&&beyond| beyond != except);
        others.map(move |&beyond| Check { pair: Pair::at_plane(brick, id, beyond), is_negative: false, near: u64::MAX })
    }
}

/// Returns the position (grid frame, mm) at a distance in nodes from the first node of a brick.
fn node_position(materials: &Materials, brick: usize, nodes: [f64; 3]) -> DVec3 {
    let [bx, by, _] = isoparticles_field::materials::bricks_along(materials.geometry().size);
    let at = [brick % bx, brick / bx % by, brick / (bx * by)].map(|n| (n * CELLS) as f64);
    (DVec3::from_array(at) + DVec3::from_array(nodes)) * materials.geometry().spacing
}

/// Returns the interfaces of materials and the spaces beyond planes that cross a brick.
fn entries_at_planes(materials: &Materials, interfaces: &[Stratum], planes: &Planes, brick: usize) -> Vec<Entry> {
    let known = materials.known_in(brick);
    let fill = Some(materials.fill()[brick]).filter(|&fill| fill != NO_MATERIAL).map(MaterialId);
    // the brick does not store the indicator of a material deep inside it
    let deep = fill.filter(|&fill| known.clone().all(|(id, _)| id != fill));
    let mut entries = Vec::new();
    for (id, own) in known.clone().map(|own| (own.0, Some(own))).chain(deep.map(|id| (id, None))) {
        let is_real = !planes.is_beyond && fill.is_none_or(|fill| fill == id);
        // deep inside a material, no other one is as close
        let others = own.map_or_else(Vec::new, |own| {
            known.clone().filter(|other| other.0 != id).map(|other| Pair::new(brick, other, own)).collect()
        });
        let check = |&pair: &Pair| Check { pair, is_negative: pair.high == id.0, near: known_cells(materials, &pair) };
        for &beyond in &planes.crossing {
            let Ok(interface) = interfaces.binary_search(&Stratum::interface(id, beyond)) else { continue };
            let checks = is_real.then(|| others.iter().map(check).chain(planes.checks(brick, id, beyond)).collect());
            entries.push(Entry { interface: interface as u32, pair: Pair::at_plane(brick, id, beyond), checks });
        }
    }
    entries
}

/// Returns the interfaces whose difference is known in a brick. The interface closest to the centre
/// of the brick comes first.
fn entries_of(materials: &Materials, interfaces: &[Stratum], brick: usize) -> Vec<Entry> {
    let known = materials.known_in(brick);
    let planes = Planes::of(materials, brick);
    let mut entries = entries_at_planes(materials, interfaces, &planes, brick);
    for (k, low) in known.clone().enumerate() {
        for high in known.clone().skip(k + 1) {
            let Ok(interface) = interfaces.binary_search(&Stratum::interface(low.0, high.0)) else { continue };
            let pair = Pair::new(brick, low, high);
            let fill = materials.fill()[brick];
            let is_filled_by_other = fill != NO_MATERIAL && fill != low.0.0 && fill != high.0.0;
            let checks = (!is_filled_by_other && !planes.is_beyond).then(|| {
                let thirds = known.clone().filter(|third| third.0 != low.0 && third.0 != high.0);
                let check = |third: (MaterialId, usize)| Check {
                    pair: Pair::new(brick, third, high),
                    is_negative: third.0 < high.0,
                    near: near_cells(materials, &pair, third),
                };
                let at_planes = planes.checks(brick, high.0, MaterialId(NO_MATERIAL));
                thirds.map(check).filter(|check| check.near != 0).chain(at_planes).collect()
            });
            entries.push(Entry { interface: interface as u32, pair, checks });
        }
    }
    // sort key: the larger of the two indicators at the centre of the brick, or the distance of the
    // centre from the plane
    let centre = node_position(materials, brick, [0.5 * CELLS as f64; 3]);
    let farther = |entry: &Entry| {
        if let Some(plane) = entry.pair.plane(materials) {
            return plane.distance(centre).abs() as f32;
        }
        let [low, high] = entry.pair.indicators(materials);
        let [a, b] = entry.pair.numbers.map(|number| number as usize);
        coefficient(low, a, [NODES_PER_AXIS / 2; 3]).max(coefficient(high, b, [NODES_PER_AXIS / 2; 3]))
    };
    entries.sort_by(|a, b| farther(a).total_cmp(&farther(b)));
    entries
}

/// Returns one bit for each cell of a brick, set if a third material may be as close there as the
/// two materials of an interface. On the interface both indicators equal their mean. The test
/// therefore subtracts the coefficients of this mean from the coefficients of the third indicator.
/// A spline is nowhere below its minimum coefficient.
fn near_cells(materials: &Materials, pair: &Pair, (third, number): (MaterialId, usize)) -> u64 {
    let indicator = &materials.indicators()[usize::from(third.0)];
    let [low, high] = pair.indicators(materials);
    let [a, b] = pair.numbers.map(|number| number as usize);
    let mut least: Vec<f32> = (0..NODES_PER_AXIS * NODES_PER_AXIS * NODES_PER_AXIS)
        .map(|n| {
            let node = [n % NODES_PER_AXIS, n / NODES_PER_AXIS % NODES_PER_AXIS, n / (NODES_PER_AXIS * NODES_PER_AXIS)];
            coefficient(indicator, number, node) - 0.5 * (coefficient(low, a, node) + coefficient(high, b, node))
        })
        .collect();
    // takes the minimum over the four nodes that a cell reads along each axis: first x, then y,
    // then z; each iteration makes its axis the slowest-varying one
    for _ in 0..3 {
        let rows = least.len() / NODES_PER_AXIS;
        least = (0..CELLS * rows)
            .map(|n| {
                let (first, row) = (n / rows, n % rows);
                least[row * NODES_PER_AXIS + first..][..4].iter().copied().fold(f32::INFINITY, f32::min)
            })
            .collect();
    }
    let limit = (ON_INTERFACE * materials.voxel()) as f32;
    let bits = least.iter().enumerate().fold(0, |bits, (n, &least)| bits | u64::from(least <= limit) << n);
    let within = cells_within(materials, indicator, pair.brick);
    let beyond = if indicator.surrounds() { !within } else { 0 };
    known_cells(materials, pair) & (bits & within | beyond)
}

/// Returns the coefficient of an indicator at a node that the cells of a brick read.
fn coefficient(indicator: &Indicator, brick: usize, node: [usize; 3]) -> f32 {
    let [x, y, z] = node.map(|n| (n / CELLS, n % CELLS));
    let block = indicator.blocks()[brick][4 * z.0 + 2 * y.0 + x.0] as usize;
    indicator.coefficients()[BLOCK * block + (z.1 * CELLS + y.1) * CELLS + x.1]
}

/// Returns one bit for each cell of a brick, with x varying fastest. A bit is set if all nodes that
/// the cell reads lie in the box of the indicator.
fn cells_within(materials: &Materials, indicator: &Indicator, brick: u32) -> u64 {
    let size = materials.geometry().size;
    let [bx, by, _] = isoparticles_field::materials::bricks_along(size);
    let brick = brick as usize;
    let at = [brick % bx, brick / bx % by, brick / (bx * by)].map(|n| n * CELLS);
    (0..BLOCK).fold(0, |bits, n| {
        let cell = [at[0] + n % CELLS, at[1] + n / CELLS % CELLS, at[2] + n / (CELLS * CELLS)];
        bits | u64::from(indicator.is_within(cell, size)) << n
    })
}

/// Returns one bit for each cell of a brick, set if the difference is known there.
fn known_cells(materials: &Materials, pair: &Pair) -> u64 {
    if pair.plane(materials).is_some() {
        return u64::MAX;
    }
    pair.indicators(materials)
        .iter()
        .fold(u64::MAX, |bits, indicator| bits & cells_within(materials, indicator, pair.brick))
}

/// Blocks of the difference of one pair of materials: for each block, the two numbers from which it
/// is computed, and for each brick, the blocks that its cells read. The numbers are the blocks of
/// the two indicators or, with a plane, a brick and the index of one of the eight blocks that its
/// cells read.
type Part = (Vec<[u32; 2]>, Vec<[u32; 8]>);

/// Returns the coefficients of the differences in blocks, and the eight blocks that the cells of
/// each pair's brick read. `pairs` must be sorted.
fn coefficients(materials: &Materials, pairs: &[Pair]) -> (Vec<f32>, Vec<[u32; 8]>) {
    let runs: Vec<&[Pair]> = pairs.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)).collect();
    let parts: Vec<Part> = runs
        .par_iter()
        .map(|run| {
            if run[0].plane(materials).is_some() {
                let sources = run.iter().flat_map(|pair| (0..8).map(|block| [pair.brick, block])).collect();
                let blocks = (0..run.len() as u32).map(|n| std::array::from_fn(|c| 8 * n + c as u32)).collect();
                return (sources, blocks);
            }
            let [low, high] = run[0].indicators(materials);
            let mut numbers = vec![u32::MAX; high.coefficients().len() / BLOCK];
            let mut sources = Vec::new();
            let blocks = run
                .iter()
                .map(|pair| {
                    let [low, high] = [low.blocks()[pair.numbers[0] as usize], high.blocks()[pair.numbers[1] as usize]];
                    std::array::from_fn(|c| {
                        let number = &mut numbers[high[c] as usize];
                        if *number == u32::MAX {
                            *number = sources.len() as u32;
                            sources.push([low[c], high[c]]);
                        }
                        *number
                    })
                })
                .collect();
            (sources, blocks)
        })
        .collect();
    let mut blocks: Vec<[u32; 8]> = Vec::with_capacity(pairs.len());
    let mut sources = Vec::new();
    for (run, (own, numbers)) in runs.iter().zip(parts) {
        let first = sources.len() as u32;
        blocks.extend(numbers.iter().map(|eight| eight.map(|number| first + number)));
        sources.extend(own.into_iter().map(|own| (run[0], own)));
    }
    let mut coefficients = vec![0.0; BLOCK * sources.len()];
    coefficients.par_chunks_mut(BLOCK).zip(&sources).for_each(|(to, (pair, numbers))| {
        if let Some(plane) = pair.plane(materials) {
            let [brick, block] = numbers.map(|number| number as usize);
            for (n, to) in to.iter_mut().enumerate() {
                // along each axis, the two blocks of a brick contain the nodes from -1 to 6
                let within = [n % CELLS, n / CELLS % CELLS, n / (CELLS * CELLS)];
                let node = std::array::from_fn(|a| (within[a] + CELLS * (block >> a & 1)) as f64 - 1.0);
                *to = -plane.distance(node_position(materials, brick, node)) as f32;
            }
            return;
        }
        let indicators = pair.indicators(materials);
        let [low, high] =
            [0, 1].map(|side| &indicators[side].coefficients()[BLOCK * numbers[side] as usize..][..BLOCK]);
        for ((to, low), high) in to.iter_mut().zip(low).zip(high) {
            *to = 0.5 * (high - low);
        }
    });
    (coefficients, blocks)
}

/// Splits the bits of 64 cells into two words.
fn words_of(cells: u64) -> [u32; 2] {
    [cells as u32, (cells >> 32) as u32]
}

/// Returns the materials of a stratum, padded with 65535.
fn materials_of(stratum: &Stratum) -> [u32; 4] {
    let mut ids = [u32::from(NO_MATERIAL); 4];
    ids.iter_mut().zip(stratum.materials()).for_each(|(to, id)| *to = u32::from(id.0));
    ids
}
