//! The `distfield` stage computes the signed distance field F of section 3.1 of the paper (Kim,
//! Chen and Hansen 2012) from a volume and an iso value, or from labels. F is in mm and negative
//! inside. Between its samples, F is the interpolating cubic B-spline.
//!
//! [`mod@unshear`] resamples sheared volumes, and [`crop`] crops the volume to the object.
//! [`scalar`] and [`labels`] define the surface; for labels and with a scale, the surface is a
//! level set of the smoothed occupancy ([`mask`], [`occupancy`], `level`). [`field`] computes the
//! distances to the surface ([`samples`], [`nearest`], [`closest`]) and fits the zero set of the
//! spline to the surface ([`fit`]). At ambiguous faces, F connects the same nodes as its source
//! ([`ambiguous_faces`]). A box closes the object at the border ([`cap`]). [`keep`] drops parts,
//! and [`topology`] counts the parts of the result. [`materials`] computes one field for each of
//! several materials. [`run`] contains the program and [`args`] its options. [`input`] rejects
//! labels for a scan and iso values for a label map.

pub mod ambiguous_faces;
pub mod args;
pub mod bits;
pub mod cap;
pub mod changes;
mod check;
pub mod choose;
pub mod closest;
pub mod crop;
mod envelope;
mod faces;
pub mod field;
pub mod fit;
pub mod gaussian;
pub mod input;
pub mod keep;
pub mod labels;
mod level;
pub mod mask;
pub mod materials;
pub mod nearest;
pub mod occupancy;
mod reduce;
mod report;
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

/// Treatment of the object at the border of the volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Border {
    /// Close the object half a voxel beyond the outermost voxel centres.
    Cap,
    /// Extend the surface straight out of the volume.
    Open,
}
