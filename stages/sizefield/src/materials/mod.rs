//! The target edge length h of many materials, on one grid.
//!
//! As for one object, h follows the shape: on interfaces the curvature and the thickness of the
//! layers on both sides, on junction curves the curvature and length. Interfaces meet at junction
//! curves with given angles, so layers are necessarily thin there. Such wedges are ignored.

mod features;
mod given;
mod lines;
mod program;

pub(crate) use given::Given;
pub use given::GivenSize;
pub(crate) use program::run;
