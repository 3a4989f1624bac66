//! The `sizefield` stage.
