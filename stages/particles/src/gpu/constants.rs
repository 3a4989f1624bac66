//! Constants of the kernels, defined once in Rust. The source of every kernel begins with
//! declarations of the same names. A second definition in a `.wgsl` file causes a redefinition
//! error in naga.

use super::differences::{INDEX_BRICKS, MORE_INTERFACES, NEVER_REAL};
use crate::constants::{
    EIGENVALUE_FLOOR, FARTHEST_MOVE, LAMBDA_FALL, LAMBDA_GROWTH, LARGEST_LAMBDA, LATTICE_NEIGHBOURS, LEAST_LAMBDA,
    LONGEST_STEP, PROJECTION_REACH, REBUILD_MOVE, SKIN,
};
use isoparticles_field::energy::{LEAST_SCALED_DISTANCE, SUPPORT};
use isoparticles_field::spline::{LEAST_SQUARED_GRADIENT, PROJECTION_STEPS};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Maximum number of workgroups along the first axis of a dispatch: WebGPU's default for
/// `maxComputeWorkgroupsPerDimension`. Larger dispatches also extend along the second axis.
pub(crate) const GROUPS_PER_ROW: u32 = 65_535;

/// Workgroup size of kernels that use one invocation per particle and no workgroup-wide sums: two
/// subgroups of 32 lanes, or one of 64.
pub(crate) const PARTICLE_GROUP: u32 = 64;
/// Workgroup size of kernels with workgroup-wide sums: the maximum that every WebGPU adapter
/// supports (default of `maxComputeInvocationsPerWorkgroup`).
pub(crate) const SUM_GROUP: u32 = 256;
/// Number of elements per invocation in prefix sums and in the computation of the totals. With
/// eight, the single workgroup of `scan_sums` processes the block sums of 524,288 elements (8 x 256
/// x 256) in one round.
pub(crate) const SUM_ELEMENTS: u32 = 8;
/// Number of elements per workgroup in prefix sums and in the computation of the totals.
pub(crate) const SUM_BLOCK: u32 = SUM_GROUP * SUM_ELEMENTS;

/// Maximum number of classes: one for each bit of a word.
pub(crate) const CLASSES: u32 = 32;
/// Marks a particle without a class.
pub(crate) const UNCLASSED: u32 = u32::MAX;

/// Distance, in bins along each axis, between bins of the same colour. Two bins of other colours
/// lie between them, so their neighbourhoods of 3 x 3 x 3 bins are disjoint. A moving particle must
/// read and write only data in the neighbourhood of its bin; see [`BIN_REACH`].
pub(crate) const COLOUR_STRIDE: u32 = 3;

/// Minimum edge of a bin, in units of the largest h of its level: the reach of the neighbour lists.
/// The members of a particle's list are therefore in the bin of the particle or in an adjacent bin.
/// With the paper's bin edge, max(h), they can be two bins away.
pub(crate) const BIN_REACH: f64 = SUPPORT * (1.0 + SKIN);

const _: () = assert!(
    BIN_REACH >= SUPPORT + FARTHEST_MOVE,
    "a particle could go in a pass to where it interacts with those beyond the next bin"
);

/// Maximum number of bin levels, which is the length of the array `levels` in the shaders. Twelve
/// octaves cover a ratio of 4096 between maximum and minimum h. Particles with smaller h use the
/// last level, whose bins then contain more particles.
pub(crate) const MOST_LEVELS: usize = 12;

/// Flag in the word `outcome` of a particle: the particle took a step. The low bits contain the
/// number of attempted steps.
const STEP_TAKEN: u32 = 1 << 31;
/// Flag in the word `outcome` of a particle: the particle is a lattice defect.
const LATTICE_DEFECT: u32 = 1 << 30;

/// Damping code of a held particle (see `shaders/shared/carried_materials.wgsl`). The codes of
/// other particles are 0 to 7, log10(damping / [`LEAST_LAMBDA`]).
pub(crate) const HELD_CODE: u32 = 15;

/// Brick index if no record is loaded.
const NO_BRICK: u32 = u32::MAX;

/// Result of the check for third materials: no third material is as close as the two materials of
/// the interface.
const CHECKS_PASS: u32 = 0;
/// Result of the check for third materials: a third material is at least as close as the two
/// materials of the interface.
const CHECKS_FAIL: u32 = 1;
/// Result of the check for third materials: another difference must be evaluated.
const CHECKS_GO_ON: u32 = 2;

/// Minimum relative energy decrease, as predicted by the quadratic model, for which a particle
/// moves. The value is eight ulps of f32 (eight times 2^-23). An energy is a sum over about 18
/// neighbours, so its rounding error is a few ulps.
const LEAST_DECREASE: f64 = 1e-6;
/// Maximum difference between an eigenvalue of a 2 x 2 Hessian and the mean of both, as a fraction
/// of the mean, at which the kernels treat the two as equal. At this difference the rounding error
/// of the eigenvectors in f32 is about 1.2e-7 / 1e-6 = 0.1 radians.
const EQUAL_EIGENVALUES_F32: f64 = 1e-6;

/// Index, in the buffer `words`, of the word with the total energy (the bits of an f32). The host
/// reads this buffer after each pass.
pub(crate) const WORD_ENERGY: usize = 0;
/// Index of the word with the number of particles that took a step.
pub(crate) const WORD_MOVED: usize = 1;
/// Index of the word with the number of attempted steps.
pub(crate) const WORD_TRIES: usize = 2;
/// Index of the word with the maximum displacement of a particle since the lists were built, in
/// units of its h (the bits of an f32).
pub(crate) const WORD_LONGEST_WAY: usize = 3;
/// Index of the word with the total length of all lists.
pub(crate) const WORD_LISTED: usize = 4;
/// Index of the word with the number of particles after density control.
pub(crate) const WORD_COUNT: usize = 5;
/// Index of the word with the number of particles that density control kept.
pub(crate) const WORD_KEPT: usize = 6;
/// Index of the word with the number of lattice defects.
pub(crate) const WORD_DEFECTS: usize = 7;
/// Index of the word with the length of the longest list.
pub(crate) const WORD_LONGEST_LIST: usize = 8;
/// Index of the word with the number of classes: the index of the last non-empty class plus one.
pub(crate) const WORD_CLASSES: usize = 9;
/// Number of words.
pub(crate) const WORDS: usize = 10;

/// Value of `count` in the block `Planned` if the host does not know the number of particles yet.
pub(crate) const COUNT_ON_DEVICE: u32 = u32::MAX;

/// Number of particles whose neighbour lists are interleaved: the subgroup size of most adapters.
pub(crate) const LIST_TILE: u32 = 32;

/// Initial capacity of each neighbour list. In the lattice a list has 18 members (three rings are
/// within `SUPPORT (1 + SKIN)`), and with the seeds of `make bench-gpu` no list has more than 32.
/// If a list is longer (very dense particles, junctions of many interfaces), the capacity of all
/// lists is increased and the pass is repeated.
pub(crate) const FIRST_LIST_ROOM: u32 = 32;

/// Value of a constant together with its WGSL type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value {
    Real(f32),
    Whole(u32),
}

macro_rules! reals {
    ($($name:ident),* $(,)?) => { [$((stringify!($name), Value::Real($name as f32))),*] };
}

macro_rules! wholes {
    ($($name:ident),* $(,)?) => { [$((stringify!($name), Value::Whole($name as u32))),*] };
}

/// Returns the name and value of every constant.
pub(crate) fn constants((lanes, teams): (u32, u32)) -> Vec<(&'static str, Value)> {
    let mut all = Vec::new();
    all.extend(reals![
        SUPPORT,
        LEAST_SCALED_DISTANCE,
        FRAC_PI_2,
        TAU,
        SKIN,
        REBUILD_MOVE,
        FARTHEST_MOVE,
        LONGEST_STEP,
        LEAST_LAMBDA,
        LARGEST_LAMBDA,
        LAMBDA_GROWTH,
        LAMBDA_FALL,
        EIGENVALUE_FLOOR,
        EQUAL_EIGENVALUES_F32,
        LEAST_DECREASE,
        PROJECTION_REACH,
        LEAST_SQUARED_GRADIENT,
    ]);
    all.extend(wholes![
        PROJECTION_STEPS,
        LATTICE_NEIGHBOURS,
        MOST_LEVELS,
        PARTICLE_GROUP,
        SUM_GROUP,
        SUM_ELEMENTS,
        SUM_BLOCK,
        GROUPS_PER_ROW,
        CLASSES,
        UNCLASSED,
        COLOUR_STRIDE,
        STEP_TAKEN,
        LATTICE_DEFECT,
        WORD_ENERGY,
        WORD_MOVED,
        WORD_TRIES,
        WORD_LONGEST_WAY,
        WORD_LISTED,
        WORD_COUNT,
        WORD_KEPT,
        WORD_DEFECTS,
        WORD_LONGEST_LIST,
        WORD_CLASSES,
        COUNT_ON_DEVICE,
        LIST_TILE,
        HELD_CODE,
        NO_BRICK,
        INDEX_BRICKS,
        MORE_INTERFACES,
        NEVER_REAL,
        CHECKS_PASS,
        CHECKS_FAIL,
        CHECKS_GO_ON,
    ]);
    all.extend([("TEAM", Value::Whole(lanes)), ("TEAMS", Value::Whole(teams))]);
    all
}

/// Returns the WGSL declarations of the constants, one per line.
pub(crate) fn declarations(team: (u32, u32)) -> String {
    constants(team)
        .iter()
        .map(|(name, value)| match value {
            // `{:?}` prints the shortest decimal number that parses to the same f32
            Value::Real(value) => format!("const {name}: f32 = {value:?};\n"),
            Value::Whole(value) => format!("const {name}: u32 = {value}u;\n"),
        })
        .collect()
}
