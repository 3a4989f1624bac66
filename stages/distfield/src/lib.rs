//! The `distfield` stage: a volume and an iso value, or a set of labels, become the signed distance field F of section 3.1
//! of the paper (Kim, Chen and Hansen 2012): negative inside, in mm, and read everywhere as the interpolating cubic
//! B-spline through its samples.
//!
//! [`mod@unshear`] resamples a sheared volume. [`crop`] takes the object's box out of the volume.
//! [`scalar`] and [`labels`] say what the surface is; labels and scales are level sets of smoothed
//! voxel shares ([`mask`], [`occupancy`], `level`). [`field`] turns the surface into distances
//! ([`samples`], [`nearest`], [`closest`]), pins the zero set of the spline on it ([`fit`]), joins
//! what touches as the source does ([`junctions`]) and closes it at the border ([`cap`]). [`keep`]
//! drops parts, [`topology`] counts what came out and [`run`] is the program. [`materials`] makes a
//! field for each of many materials. [`input`] refuses labels of a scan and iso values of labels.

pub mod bits;
pub mod cap;
pub mod changes;
mod check;
pub mod choose;
pub mod closest;
pub mod crop;
mod envelope;
pub mod field;
pub mod fit;
pub mod gaussian;
pub mod input;
pub mod junctions;
pub mod keep;
pub mod labels;
mod level;
pub mod mask;
pub mod materials;
pub mod nearest;
pub mod occupancy;
pub mod run;
pub mod runs;
pub mod samples;
pub mod scalar;
pub mod scale;
pub mod topology;
pub mod unshear;

pub use isoparticles_survey::Inside;

pub use field::{Redistanced, Shift};
pub use keep::Keep;
pub use labels::{LabelOptions, from_labels, from_mask};
pub use scalar::{ScalarOptions, from_scalar};

/// What happens to the surface where the object meets the border of the volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Border {
    /// The object is closed half a voxel beyond the outermost voxel centres.
    Cap,
    /// The surface runs on straight and leaves the volume.
    Open,
}
