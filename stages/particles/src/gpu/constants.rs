//! Constants of the kernels. They stand once, in Rust: every kernel's text begins with a declaration of each under its Rust name, made
//! here from its value. A second copy in a `.wgsl` file would be a redefinition, which naga refuses.

use super::commands::ROW;
use super::differences::{INDEX_BRICKS, MORE_SHEETS, NEVER_REAL};
use super::parameters::MOST_LEVELS;
use super::shaders::Variant;
use crate::constants::{
    EIGENVALUE_FLOOR, FARTHEST_MOVE, LAMBDA_FALL, LAMBDA_GROWTH, LARGEST_LAMBDA, LATTICE_NEIGHBOURS, LEAST_LAMBDA,
    LONGEST_STEP, PROJECTION_REACH, REBUILD_MOVE, SKIN,
};
use isoparticles_field::energy::{LEAST_SCALED_DISTANCE, SUPPORT};
use isoparticles_field::spline::{LEAST_SQUARED_GRADIENT, PROJECTION_STEPS};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Invocations in a workgroup of a kernel that looks at neighbours, one a particle.
pub(crate) const NARROW: u32 = 64;
/// Invocations in a workgroup of a kernel that shares a sum.
pub(crate) const WIDE: u32 = 256;
/// Numbers that an invocation of a prefix sum or of the totals takes.
pub(crate) const EACH: u32 = 8;
/// Numbers that a workgroup of these takes.
pub(crate) const BLOCK: u32 = WIDE * EACH;

/// Classes of particles that may move together: the bits of a word.
pub(crate) const CLASSES: u32 = 32;
/// The class of a particle that has none.
pub(crate) const UNCLASSED: u32 = u32::MAX;

/// Every so manieth bin along each axis has one colour, so that two bins lie between two of a colour and the 27 bins round one share none with the 27 round the
/// other. What a bin's particles may touch must lie in those 27: see [`BIN_REACH`].
pub(crate) const COLOUR_STRIDE: u32 = 3;

/// Least edge of a bin, in the largest h of its level: the reach of the lists. So all that is in the lists of a bin's particles is in that bin and the next ones, and two bins of a colour
/// touch no common particle. (In print the edge is max(h), from which interactions reach on into the bin after the next.)
pub(crate) const BIN_REACH: f64 = SUPPORT * (1.0 + SKIN);

const _: () = assert!(
    BIN_REACH >= SUPPORT + FARTHEST_MOVE,
    "a particle could go in a pass to where it interacts with those beyond the next bin"
);

/// In the word `outcome` of a particle, beside the number of steps tried: that one was taken.
const STEP_TAKEN: u32 = 1 << 31;
/// In the same word: that the particle is a lattice defect.
const LATTICE_DEFECT: u32 = 1 << 30;

/// In place of the power of ten of its damping, of a particle that is held: larger than any.
pub(crate) const HELD_CODE: u32 = 15;

/// In place of the number of a brick: none is open.
const NO_BRICK: u32 = u32::MAX;

/// Of the third materials at a place on a sheet: none is as near as the two.
const CHECKS_PASS: u32 = 0;
/// One is.
const CHECKS_FAIL: u32 = 1;
/// One is to be looked at.
const CHECKS_GO_ON: u32 = 2;

/// A particle rests when its step promises to lower its energy by less than this share: f32 could not tell.
const REST: f64 = 1e-6;
/// Gap between the eigenvalues of a Hessian below which they count as equal, as a share of their mean: f32 has no direction for it.
const EQUAL_EIGENVALUES: f64 = 1e-6;

/// The words that the host reads after a pass: energy, bits of an f32.
pub(crate) const WORD_ENERGY: usize = 0;
/// Particles that took a step.
pub(crate) const WORD_MOVED: usize = 1;
/// Steps tried.
pub(crate) const WORD_TRIES: usize = 2;
/// Longest way since the lists were made over h, bits of an f32.
pub(crate) const WORD_LONGEST_WAY: usize = 3;
/// Members of all lists.
pub(crate) const WORD_LISTED: usize = 4;
/// Particles after density control.
pub(crate) const WORD_COUNT: usize = 5;
/// Particles kept of the old ones.
pub(crate) const WORD_KEPT: usize = 6;
/// Lattice defects.
pub(crate) const WORD_DEFECTS: usize = 7;
/// Members of the longest list.
pub(crate) const WORD_LONGEST_LIST: usize = 8;
/// One more than the number of the last class that has particles.
pub(crate) const WORD_CLASSES: usize = 9;
/// How many words there are.
pub(crate) const WORDS: usize = 10;

/// In place of the number of a pass's particles: as many as the pass before has left, which the host does not know yet.
pub(crate) const AS_LEFT: u32 = u32::MAX;

/// Particles whose neighbour lists lie side by side: as many as work together on most adapters.
pub(crate) const LIST_TILE: u32 = 32;

/// Members that each neighbour list has room for at first. Those of a lattice have 18 (its first three rings are nearer than `SUPPORT (1 + SKIN)`), and none of the seeds of
/// `make bench-gpu` has more than this. Crowds, and particles at junctions of many sheets, have: then all get more room and the pass is done again.
pub(crate) const FIRST_LIST_ROOM: u32 = 32;

/// Value of a constant, of the type that it has in WGSL.
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

/// Name and value of every constant.
pub(crate) fn constants(variant: Variant) -> Vec<(&'static str, Value)> {
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
        EQUAL_EIGENVALUES,
        REST,
        PROJECTION_REACH,
        LEAST_SQUARED_GRADIENT,
    ]);
    all.extend(wholes![
        PROJECTION_STEPS,
        LATTICE_NEIGHBOURS,
        MOST_LEVELS,
        NARROW,
        WIDE,
        EACH,
        BLOCK,
        ROW,
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
        AS_LEFT,
        LIST_TILE,
        HELD_CODE,
        NO_BRICK,
        INDEX_BRICKS,
        MORE_SHEETS,
        NEVER_REAL,
        CHECKS_PASS,
        CHECKS_FAIL,
        CHECKS_GO_ON,
    ]);
    let (lanes, teams) = variant.team();
    all.extend([("TEAM", Value::Whole(lanes)), ("TEAMS", Value::Whole(teams))]);
    all
}

/// Their declarations in WGSL, one a line.
pub(crate) fn declarations(variant: Variant) -> String {
    constants(variant)
        .iter()
        .map(|(name, value)| match value {
            // the shortest digits that give the same f32
            Value::Real(value) => format!("const {name}: f32 = {value:?};\n"),
            Value::Whole(value) => format!("const {name}: u32 = {value}u;\n"),
        })
        .collect()
}
