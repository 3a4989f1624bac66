//! The `reconstruct` stage.

pub mod improve;
