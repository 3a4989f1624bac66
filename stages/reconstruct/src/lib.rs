//! The `reconstruct` stage.
