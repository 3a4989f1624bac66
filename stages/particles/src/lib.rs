//! The `particles` stage.
