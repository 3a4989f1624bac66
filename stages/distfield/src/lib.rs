//! The `distfield` stage.
