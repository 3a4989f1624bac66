//! The target edge length of many materials: one h on the grid that all share.
//!
//! As for one object h goes by the shape: of sheets by their curvature and by how thick the layers on both sides are, of junction curves by their curvature and
//! length. Sheets meet at junction curves with angles that the data decides, so that layers are thin there of necessity: what touches does not count.

mod features;
mod given;
mod lines;
mod program;

pub(crate) use given::Given;
pub use given::GivenSize;
pub(crate) use program::run;
