//! The `seed` stage.
