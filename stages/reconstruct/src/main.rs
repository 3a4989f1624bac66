//! The `reconstruct` program.
fn main() {}
