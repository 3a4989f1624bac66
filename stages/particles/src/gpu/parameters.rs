//! Uniform blocks of the kernels, as bytes: named words in the order of the WGSL structs
//! (`shaders/shared/parameters.wgsl`). The tests compare the layouts with naga's.

use super::constants::BLOCK;
use super::levels::Levels;
use crate::constants::{FIRST_RING, INITIAL_LAMBDA, NEWCOMER_DISTANCE, PARENT_DISTANCE, PASS_TOLERANCE};
use crate::settle::Parameters;
use glam::{DVec3, UVec3};
use isoparticles_volume::Geometry;

/// Maximum number of levels; size of an array in the shaders.
pub(crate) const MOST_LEVELS: usize = 12;

/// Named words of a uniform block, in order and without gaps.
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

    /// The block as bytes.
    pub(crate) fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.words)
    }
}

/// Origin of device positions: the centre of this voxel, near the middle of the grid. Near the
/// middle, f32 positions have the best resolution; at a whole voxel, the fraction within a cell is
/// exact.
pub(crate) fn centre_voxel(geometry: &Geometry) -> UVec3 {
    UVec3::from_array(geometry.size.map(|n| n as u32 / 2))
}

/// The same origin in the grid frame, mm.
pub(crate) fn device_origin(geometry: &Geometry) -> DVec3 {
    geometry.index_to_grid(centre_voxel(geometry).as_dvec3())
}

/// Tolerance of |F| = 0 on the device, mm: that of the CPU's passes, or the resolution of f32
/// positions if that is coarser.
pub(crate) fn tolerance(geometry: &Geometry) -> f64 {
    let resolution = geometry.upper_corner().max_element() * f64::from(f32::EPSILON);
    (PASS_TOLERANCE * geometry.min_spacing()).max(2.0 * resolution)
}

/// Block `Parameters`: values that are constant for a run.
pub(crate) fn run_block(
    geometry: &Geometry,
    levels: &Levels,
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

/// Block `Planned`: values of a pass that the host knows at submission. `shaders/begin_pass.wgsl`
/// derives those of the kernels.
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

/// Block `Pass`, which `shaders/begin_pass.wgsl` writes.
#[cfg(test)]
pub(crate) fn pass_block(number: u64, count: u32, allow_insert: bool) -> Block {
    Block::default()
        .whole("number", [number as u32])
        .whole("count", [count])
        .whole("allow_insert", [u32::from(allow_insert)])
        .whole("unused", [0])
}

/// Block `Scan` of a prefix sum over `length` numbers.
pub(crate) fn scan_block(length: u32) -> Block {
    Block::default()
        .whole("length", [length])
        .whole("blocks", [scan_blocks(length)])
        .whole("unused_1", [0])
        .whole("unused_2", [0])
}

/// Number of blocks of a prefix sum over `length` numbers; the result has one number more.
pub(crate) fn scan_blocks(length: u32) -> u32 {
    (length + 1).div_ceil(BLOCK)
}
