//! Computes the target edge length h for several materials on one grid.
//!
//! h follows the shape, as for one object. On interfaces, h depends on the curvature and on the
//! thickness of the layers on both sides; on junction curves, h depends on the curvature and
//! length. Layers are always thin where interfaces meet at a junction curve, so these wedges are
//! ignored.

mod features;
mod lines;
mod program;

pub(crate) use program::run;
