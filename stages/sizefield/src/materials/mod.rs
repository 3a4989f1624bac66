//! Computes the target edge length h for several materials on one grid.
//!
//! As for one object, h depends on the shape. On interfaces, it depends on the curvature and on the
//! thickness of the layers on both sides. On junction curves, it depends on the curvature and
//! length of the curve. Layers are always thin where interfaces meet at a junction curve, so these
//! wedges are ignored.

mod compute;
mod features;
mod lines;

pub(crate) use compute::compute;
