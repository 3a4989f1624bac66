//! The `distfield` program.
fn main() {}
