//! Uniform blocks of the kernels as bytes: named words in the order of the WGSL structs
//! (`shaders/shared/parameters.wgsl`). The tests compare each layout with the layout that naga
//! computes.

use super::constants::{MOST_LEVELS, SUM_BLOCK};
use super::levels::{BinLevels, centre_voxel};
use crate::constants::{FIRST_RING, INITIAL_LAMBDA, NEWCOMER_DISTANCE, PARENT_DISTANCE, PASS_TOLERANCE};
use crate::settle::Parameters;
use glam::DVec3;
use isoparticles_volume::Geometry;

/// Named words of a uniform block, in order and without padding.
#[derive(Clone, Debug, Default)]
pub(crate) struct Block {
    words: Vec<u32>,
    /// Name and byte offset of each member.
    pub members: Vec<(&'static str, usize)>,
}

impl Block {
    fn whole(mut self, name: &'static str, values: impl IntoIterator<Item = u32>) -> Self {
        self.members.push((name, 4 * self.words.len()));
        self.words.extend(values);
        self
    }

    fn real(self, name: &'static str, values: impl IntoIterator<Item = f32>) -> Self {
        self.whole(name, values.into_iter().map(f32::to_bits))
    }

    /// Returns the block as bytes.
    pub(crate) fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.words)
    }
}

/// Returns the maximum |F| (mm) at which the device considers a position to be on F = 0: the
/// tolerance of the passes on the CPU, or twice the resolution of f32 positions if that is larger.
pub(crate) fn tolerance(geometry: &Geometry) -> f64 {
    let resolution = geometry.upper_corner().max_element() * f64::from(f32::EPSILON);
    (PASS_TOLERANCE * geometry.min_spacing()).max(2.0 * resolution)
}

/// Returns the block `Parameters`, which contains the values that are constant during a run.
pub(crate) fn run_block(
    geometry: &Geometry,
    levels: &BinLevels,
    settling: &Parameters,
    slab_length: u32,
    list_room: u32,
) -> Block {
    let spacing = settling.spacing();
    let size = geometry.size.map(|n| n as u32);
    let real = |v: DVec3| v.as_vec3().to_array();
    let seed = (settling.seed as u32) ^ ((settling.seed >> 32) as u32).wrapping_mul(0x9e37_79b9);
    let mut block = Block::default()
        .whole("grid_size", size)
        .whole("level_count", [levels.levels.len() as u32])
        .real("spacing", real(geometry.spacing))
        .real("tolerance", [tolerance(geometry) as f32])
        .real("inverse_spacing", real(1.0 / geometry.spacing))
        .real("projection_step", [0.5 * geometry.mean_spacing() as f32])
        .whole("centre", centre_voxel(geometry).to_array())
        .whole("slab_length", [slab_length])
        .real("bins_origin", levels.origin.to_array())
        .real("normal_agreement", [settling.normal_agreement as f32])
        .real("ideal_energy", [settling.ideal_energy as f32])
        .real("add_below", [settling.add_below as f32])
        .real("delete_above", [settling.delete_above as f32])
        .real("largest_size", [levels.levels[0].largest])
        .whole("bin_total", [levels.bin_total()])
        .whole("list_room", [list_room])
        .whole("seed", [seed])
        .real("initial_lambda", [INITIAL_LAMBDA as f32])
        .real("spacing_in_h", [spacing as f32])
        .real("first_ring", [(FIRST_RING * spacing) as f32])
        .real("newcomer_distance", [(NEWCOMER_DISTANCE * spacing) as f32])
        .real("parent_distance", [(PARENT_DISTANCE * spacing) as f32]);
    let mut words = Vec::new();
    for k in 0..MOST_LEVELS {
        let Some(level) = levels.levels.get(k) else {
            words.extend([0; 8]);
            continue;
        };
        words.extend([level.edge.to_bits(), (1.0 / level.edge).to_bits(), level.largest.to_bits(), level.first_bin]);
        words.extend(level.bins.to_array());
        words.push(0);
    }
    block = block.whole("levels", words);
    block
}

/// Returns the block `Planned`, which contains the values of a pass that the host knows at
/// submission. From these, `shaders/begin_pass.wgsl` computes the values that the other kernels
/// read.
pub(crate) fn plan_block(
    number: u64,
    count: u32,
    allow_insert: bool,
    room: u32,
    (list_room, classes): (u32, u32),
) -> Block {
    Block::default()
        .whole("number", [number as u32])
        .whole("count", [count])
        .whole("allow_insert", [u32::from(allow_insert)])
        .whole("room", [room])
        .whole("list_room", [list_room])
        .whole("classes", [classes])
        .whole("unused_1", [0])
        .whole("unused_2", [0])
}

/// Returns the block `Pass`. Outside tests, `shaders/begin_pass.wgsl` writes this block on the
/// device.
#[cfg(test)]
pub(crate) fn pass_block(number: u64, count: u32, allow_insert: bool) -> Block {
    Block::default()
        .whole("number", [number as u32])
        .whole("count", [count])
        .whole("allow_insert", [u32::from(allow_insert)])
        .whole("unused", [0])
}

/// Returns the block `Scan` for a prefix sum over `length` elements.
pub(crate) fn scan_block(length: u32) -> Block {
    Block::default()
        .whole("length", [length])
        .whole("blocks", [scan_blocks(length)])
        .whole("unused_1", [0])
        .whole("unused_2", [0])
}

/// Returns the number of blocks of a prefix sum over `length` elements. The prefix sum has one
/// element more than its input.
pub(crate) fn scan_blocks(length: u32) -> u32 {
    (length + 1).div_ceil(SUM_BLOCK)
}
