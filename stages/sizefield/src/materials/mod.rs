//! The target edge length of many materials: one h on the grid that all share.

mod program;

pub(crate) use program::run;
